"""An exploration that a page steers: paused and continued, and with touches at places that a person picks.

The page starts no motion: the loop of `experiments.explore.explore` queries it before each touch. Its robot checks in
each control period whether the page that confirmed the touch is still present."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

import msgspec
import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.explore import ExplorationStopped, NextMove
from deformscope.page.devices import ShownDevices
from deformscope.page.robot_page import RobotPage
from deformscope.page.server import messages
from deformscope.page.server.page_session import PageSession
from deformscope.robot.supervisor import Fault
from deformscope.stages.map import exploration
from deformscope.terminal import Interruption

SURFACE_ENTITIES = ("surface", "observed", "asked", "target", "contacts", "table")
"""Entities on the surface in the view, below `SCENE`: a click on them selects a place of the surface."""
SCENE = "/display/scene/"
CURVE_POINTS = 60


class PageSteering(RobotPage):
    """`Steering` of an exploration, and `PageRun` of its page.

    arm: its name; set_force_n: set force of a touch; budget: most touches of the exploration; paused: begin paused, and
    touch only on a request of the page"""

    robot, button = "arm", "Explore"

    def __init__(
        self,
        session: PageSession,
        ended: Interruption,
        clock: Callable[[], int],
        shown: ShownDevices | None = None,
        *,
        arm: str,
        set_force_n: float,
        budget: int,
        compliance_m_per_n: float,
        paused: bool = False,
    ) -> None:
        self._clock = clock
        self._arm, self._set_force_n, self._budget = arm, set_force_n, budget
        self._compliance_m_per_n = compliance_m_per_n
        self._paused = paused
        self._touches = 0
        self._plan: exploration.PlannedTouch | None = None
        self._choice: Future[NextMove] | None = None
        self._confirm: Future[bool] | None = None
        super().__init__(session, ended, shown, "devices open and are checked")

    # Before it moves -------------------------------------------------------------------------------------------------

    def wait_for(self, what: str) -> None:
        """See `RobotPage.wait_for`. what: number of touches, and their force"""
        self._what = f"{self._arm} continues: {what}"
        self.session.enter("idle", "press Explore: the arm begins once you confirm it", commands=("stop", "explore"))

    def go_on(self) -> None:
        """From now on the robot may move."""
        self._agreed = True
        self._enter()

    # As `Steering`, from the loop ------------------------------------------------------------------------------------

    def choose(self, plan: exploration.PlannedTouch | None, touches: int) -> Future[NextMove]:
        """See `Steering.choose`."""
        with self._lock:
            self._by_hand = False
            self._plan, self._touches = plan, touches
            place = None
            if plan is not None and plan.target_m is not None:
                x_m, y_m = _floats(plan.target_m)
                place = messages.NextPlace(x_m, y_m, plan.reason)
            self.session.show(next_place=place)
            choice: Future[NextMove] = Future()
            if self._paused:
                self._choice = choice
            else:
                choice.set_result(NextMove())
            self._enter()
            return choice

    def confirm(self, forecast: exploration.TouchForecast) -> Future[bool]:
        """See `Steering.confirm`."""
        with self._lock:
            confirm: Future[bool] = Future()
            self._confirm = confirm
            curve = curve_of(forecast)
            self.session.show(curve=curve)
            place = f"({100 * curve.x_m:.1f}, {100 * curve.y_m:.1f}) cm"
            what = f"{self._arm} goes to {place} and presses with {self._set_force_n:g} N, along the normal there"
            self.session.ask(what, self._confirmed, self._let_be)
            return confirm

    def refuse(self, reason: str) -> None:
        """See `Steering.refuse`."""
        self.session.remark(f"no touch there: {reason}", bad=True)

    def look(self) -> None:
        """See `Steering.look`."""
        if not self._ended.is_set():
            return
        with self._lock:
            stop = exploration.ExplorationStop(Fault.ASKED, self._ended.by or "while paused", "", "stop", self._touches)
            for waiting in (self._choice, self._confirm):
                if waiting is not None and not waiting.done():
                    waiting.set_exception(ExplorationStopped(stop, self._clock()))
            self._choice = self._confirm = None

    def on_results(self, results: Sequence[object]) -> None:
        """Receives results of the loop."""
        for result in results:
            if isinstance(result, exploration.TouchEstimate) and (curve := self.session.state.curve) is not None:
                near = np.hypot(result.xyz_m[0] - curve.x_m, result.xyz_m[1] - curve.y_m) < 1e-3
                shown = add_measured(curve, result, self._compliance_m_per_n) if near else None
                self.session.show(curve=shown)
            elif isinstance(result, exploration.SteeringDecision) and result.kind == "held":
                with self._lock:
                    self._paused = True
                self.session.remark(f"the touch was stopped, the arm is at rest: {result.reason}", bad=True)

    # As `PageRun`, from the server -----------------------------------------------------------------------------------

    def _handle(self, command: messages.PageCommand) -> tuple[messages.Outcome, str]:
        match command:
            case messages.PauseExploring():
                self._paused = True
                self._enter()
                return "done", "no further touch begins"
            case messages.StartExploring():
                return self._start()
            case messages.VetoTouch():
                return self._take(NextMove("veto", self._planned_m()), "the planner looks for another place")
            case messages.TouchNext():
                return self._take(NextMove("touch", self._planned_m()), "planning")
            case messages.TouchAt():
                return self._take(NextMove("touch", np.array([command.x_m, command.y_m])), "planning")
            case messages.TouchPicked():
                if not is_surface(command.entity):
                    return "refused", f"pick a place of the surface; that was {command.entity}"
                return self._take(NextMove("touch", np.array(command.position_m[:2])), "planning")
            case _:
                return "refused", "not during an exploration"

    # Within ----------------------------------------------------------------------------------------------------------

    def _start(self) -> tuple[messages.Outcome, str]:
        if not self._agreed:
            self.session.ask(self._what, self._agree, self.session.remark)
            return "begun", "waits for a confirmation"
        left = max(self._budget - self._touches, 0)
        what = f"{self._arm} continues to touch on its own, {left} times more at most, with {self._set_force_n:g} N"
        self.session.ask(what, self._go_on, self.session.remark)
        return "begun", "waits for a confirmation"

    def _go_on(self) -> None:
        with self._lock:
            self._paused = False
            if self._choice is not None:
                self._take(NextMove(), "")
            self._enter()

    def _planned_m(self) -> FloatArray:
        assert self._plan is not None
        assert self._plan.target_m is not None
        return self._plan.target_m

    def _take(self, choice: NextMove, words: str) -> tuple[messages.Outcome, str]:
        """Give the loop its requested answer."""
        if self._choice is None:
            return "refused", "a touch is planned or under way"
        taken, self._choice = self._choice, None
        taken.set_result(choice)
        self._enter()
        return "begun", words

    def _confirmed(self) -> None:
        with self._lock:
            if self._confirm is not None:
                self._by_hand = True
                self._confirm.set_result(True)
            self._confirm = None

    def _let_be(self, reason: str) -> None:
        with self._lock:
            if self._confirm is not None:
                self._confirm.set_result(False)
            self._confirm = None
        self.session.show(curve=None)
        self.session.remark(reason)

    def _enter(self) -> None:
        """Update the state with the present activity, and the possible requests."""
        if not self._agreed or self.session.state.phase == "stopped":
            return
        commands = ["stop", "explore" if self._paused else "pause"]
        if self._paused and self._choice is not None:
            commands += ["touch-at", "touch-picked"]
            if self._plan is not None and self._plan.target_m is not None:
                commands += ["touch-next", "veto"]
        if not self._paused:
            self.session.enter("exploring", commands=tuple(commands))
        elif self._choice is None:
            self.session.enter("paused", "the present motion ends first", commands=tuple(commands))
        else:
            what = f"press Explore, and the arm touches{' on' * bool(self._touches)} on its own; or choose a place"
            self.session.enter("paused", what, commands=tuple(commands))


def is_surface(entity: str) -> bool:
    """Whether an entity of the view is on the surface."""
    return entity.startswith(SCENE) and entity.removeprefix(SCENE).split("/")[0] in SURFACE_ENTITIES


def curve_of(forecast: exploration.TouchForecast) -> messages.ForceCurve:
    """The force curve in the form that a page draws."""
    known = f"{forecast.touches} touches" if forecast.touches else "the prior of surfaces: no touch was made yet"
    x_m, y_m = _floats(forecast.xyz_m[:2])
    depth, low, high = (
        _floats(1e3 * depth_m) for depth_m in (forecast.depth_m, forecast.depth_low_m, forecast.depth_high_m)
    )
    return messages.ForceCurve(x_m, y_m, known, _floats(forecast.force_n), depth, low, high)


def add_measured(
    curve: messages.ForceCurve, touch: exploration.TouchEstimate, compliance_m_per_n: float
) -> messages.ForceCurve:
    """The force curve with the measured one: the dent without the arm's deflection, from contact to the largest
    force."""
    if not touch.usable:
        return msgspec.structs.replace(curve, words="measured: no stiffness resulted")
    end = int(np.argmax(touch.approach_n)) + 1
    force_n = touch.approach_n[:end]
    dent_m = touch.approach_m[:end] - touch.contact_m - compliance_m_per_n * force_n
    dented = np.flatnonzero(dent_m >= 0.0)
    shown = (
        dented[np.unique(np.linspace(0, len(dented) - 1, min(CURVE_POINTS, len(dented))).astype(int))]
        if len(dented)
        else dented
    )
    at_n, set_n = touch.stiffness_n_per_mm, curve.force_n[-1]
    low, high = set_n / curve.depth_high_mm[-1], set_n / curve.depth_low_mm[-1]
    within = "as expected" if low <= at_n <= high else "outside the forecast's interval"
    expected = f"{set_n / curve.depth_mm[-1]:.2g} N/mm ({low:.2g} to {high:.2g})"
    words = f"measured {'more than ' * touch.rigid}{at_n:.2g} N/mm, {within}: {expected}"
    return msgspec.structs.replace(
        curve, felt_mm=_floats(1e3 * dent_m[shown]), felt_n=_floats(force_n[shown]), words=words
    )


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(round(float(value), 5) for value in values)
