"""Thesis chapter 4: look, choose a place, touch, estimate, update the map, repeat; until the map is complete.

`explore` is an experiment (`deformscope.session`): it commands a robot, has `ExplorationStages` computed, and yields
their results. The loop is the same for simulated, recorded and real robots and stages."""

import logging
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import BrokenExecutor, Future
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, Protocol

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.explorer import Computed, ExplorationStages, Result
from deformscope.experiments.explore.options import PLAN_CELL_M
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.session import Answer, Compute, Inline, Moment, RigExperiment, Step, ask
from deformscope.stages.map import exploration
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement

_logger = logging.getLogger(__name__)

ESTIMATES_FAILED = "estimates failed"
AT_END = "recording at its end"
DRY_RUN = "dry run"
"""Kind of the stop at the end of a dry run, which is no fault."""
AFTER_S = 0.5
"""Duration of a recording after the robot was stopped."""


@dataclass(frozen=True, slots=True)
class Look:
    """A command: look at the surface while the robot does not move."""


@dataclass(frozen=True, slots=True)
class Wait:
    """A command: record the devices for a while, whether or not the robot was stopped."""

    seconds: float


class ExplorationStopped(InputError):
    """The robot must stop, or its command failed. stop: why, and when on the robot's clock"""

    def __init__(self, stop: exploration.ExplorationStop, time_ns: int) -> None:
        super().__init__("an exploration that ends normally", f"{stop.kind}: {stop.reason}", stop.advice)
        self.stop, self.time_ns = stop, time_ns


class TouchHeld(Exception):
    """A touch was stopped before it measured anything; the robot is at rest, and accepts another target."""


@dataclass(frozen=True, slots=True, eq=False)
class NextMove:
    """The next step: go on = as planned; veto = plan again without xy_m; touch = at xy_m, after a confirmation; replan
    = plan again. xy_m: (2,) [m]"""

    kind: Literal["go on", "veto", "touch", "replan"] = "go on"
    xy_m: FloatArray = field(default_factory=lambda: np.zeros(2))


class Steering(Protocol):
    """A person who may change the next step: consulted before each touch."""

    def choose(self, plan: exploration.PlannedTouch | None, touches: int) -> Future[NextMove]:
        """plan: the plan, None if no touch could be planned; touches: touches made so far"""

    def confirm(self, forecast: exploration.TouchForecast) -> Future[bool]:
        """Whether this touch is to be made."""

    def refuse(self, reason: str) -> None:
        """Report that the chosen touch cannot be made."""

    def look(self) -> None:
        """Called from time to time during a wait for an answer: if none can come, its future has to fail."""


class Unsteered:
    """No person steers: every touch is made as planned."""

    def choose(self, plan: exploration.PlannedTouch | None, touches: int) -> Future[NextMove]:
        return _resolved(NextMove())

    def confirm(self, forecast: exploration.TouchForecast) -> Future[bool]:
        return _resolved(True)

    def refuse(self, reason: str) -> None: ...

    def look(self) -> None: ...


class TouchPlanner(Protocol):
    """An own planner, for `deformscope.explore(..., planner=...)`. The planner's touches are checked like any
    others and recorded, so that a replay repeats them."""

    def __call__(self, planned: exploration.PlannedTouch, so_far: "Exploration") -> Sequence[float] | None:
        """The next place (x, y) on the surface [m]; None = as planned.

        planned: by "regions", with gain, cost [s] and exclusion of each cell; so_far: the surface, touches and maps.
        A place that cannot be touched leaves the planned one."""


class PlannedBy(Unsteered):
    """Touches the places that a planner chooses."""

    def __init__(self, planner: TouchPlanner, so_far: "Exploration") -> None:
        self._planner, self._so_far, self._refused = planner, so_far, False

    def choose(self, plan: exploration.PlannedTouch | None, touches: int) -> Future[NextMove]:
        refused, self._refused = self._refused, False
        if plan is None or plan.target_m is None or refused:
            return _resolved(NextMove())
        place = self._planner(plan, self._so_far)
        return _resolved(NextMove() if place is None else NextMove("touch", np.asarray(place, np.float64)))

    def refuse(self, reason: str) -> None:
        _logger.warning("no touch at the place of the planner, but as planned: %s", reason)
        self._refused = True


class RecordedSteering(Unsteered):
    """Repeats the recorded decisions."""

    def __init__(self, decisions: Sequence[exploration.SteeringDecision]) -> None:
        # of a touch that was broken off nothing is left to replay
        self._left = [
            one
            for one, then in pairwise([*decisions, None])
            if one is not None and not (one.kind == "touch" and then is not None and then.kind == "held")
        ]

    def choose(self, plan: exploration.PlannedTouch | None, touches: int) -> Future[NextMove]:
        if not self._left or self._left[0].touch != touches:
            return _resolved(NextMove())
        one = self._left.pop(0)
        return _resolved(NextMove("replan" if one.kind == "held" else one.kind, one.xy_m))


class ExploringRobot(Protocol):
    """A robot that looks and touches, one after the other; both raise ExplorationStopped."""

    def look(self) -> Any:
        """Input of `ExplorationStages.look`."""

    def touch(self, command: Touch) -> Any:
        """Input of `ExplorationStages.touch`."""


class AtOnce:
    """A robot that finishes before the loop continues; a `SessionRobot`."""

    def __init__(self, robot: ExploringRobot) -> None:
        self.stopped: Future[None] = Future()
        self._robot = robot

    def carry_out(self, command: object, keep: Callable[[], object]) -> Future[Any]:
        """Look or touch immediately; waiting has no effect."""
        if isinstance(command, Touch):
            return Inline().submit(self._robot.touch, command)
        return Inline().submit((lambda: None) if isinstance(command, Wait) else self._robot.look)

    def reports(self) -> list[Step]:
        return []


@dataclass
class Exploration:
    """Results so far, valid however the exploration ends.

    surface, touches, maps, failures: results, of which `maps` is the newest one
    region_probability: probability of each number of regions, with `maps`
    ended_ns, iou: when each touch ended on the robot's clock, and the IoU of the map after it (None without a truth)
    travel_m: travel over the surface, in straight lines from its corner (0, 0); stop_reason: why it ended, in a word or
    two; missed: inclusions that the touches so far may have missed, None before the first plan; inclusions: newest
    result of their search, None without one; started: number of touches that were started; asked: numbers of touches
    that a person requested, from 1; stop, stop_ns: reason and time of a stop before the plan's end
    compute_s, slowest_s: computing time, and that of the slowest touch [s]"""

    surface: exploration.SurfaceEstimate | None = None
    touches: list[exploration.TouchEstimate] = field(default_factory=list)
    maps: exploration.MapEstimate | None = None
    ended_ns: list[int] = field(default_factory=list)
    iou: list[float | None] = field(default_factory=list)
    failures: list[exploration.StageFailure] = field(default_factory=list)
    region_probability: dict[str, float] | None = None
    travel_m: float = 0.0
    stop_reason: str = ""
    missed: exploration.DetectionLimit | None = None
    inclusions: exploration.InclusionsResult | None = None
    started: int = 0
    asked: list[int] = field(default_factory=list)
    stop: exploration.ExplorationStop | None = None
    stop_ns: int = 0
    compute_s: float = 0.0
    slowest_s: float = 0.0

    def add(self, computed: Computed) -> tuple[Result, ...]:
        """Add a computation; returns its results."""
        self.compute_s += computed.seconds
        self.slowest_s = max(self.slowest_s, computed.seconds)
        for result in computed.results:
            if isinstance(result, exploration.TouchEstimate):
                before = self.touches[-1].xyz_m[:2] if self.touches else np.zeros(2)
                self.travel_m += float(np.hypot(*(result.xyz_m[:2] - before)))
                self.touches.append(result)
            elif isinstance(result, exploration.SurfaceEstimate):
                self.surface = result
            elif isinstance(result, exploration.MapEstimate):
                self.maps, self.region_probability = result, computed.region_probability
            elif isinstance(result, exploration.InclusionsResult):
                self.inclusions = result
            elif isinstance(result, exploration.PlannedTouch):
                self.stop_reason, self.missed = result.stop_reason, result.missed
            elif isinstance(result, exploration.StageFailure):
                self.failures.append(result)
        return computed.results

    def failed(self, touch: int) -> list[str]:
        """Failures on a touch, counted from 1, as text."""
        return [f"{one.stage}: {one.reason}" for one in self.failures if one.touch == touch]


Stage = Callable[..., Compute]
"""Called with the name of a method of `ExplorationStages` and its arguments."""


def explore(
    clock: Callable[[], int],
    stage: Stage,
    found: Exploration,
    permitted: RigExperiment[None] | None = None,
    steering: Steering | None = None,
) -> RigExperiment[None]:
    """Look, then touch until the plan is complete; `found` collects the results.

    clock: the robot's clock [ns]; stage: computes a stage; permitted: steps before the robot may move; steering: may
    change the next touch. The function also returns when the robot must stop or the input is invalid: `found.stop` has
    the reason."""
    try:
        if permitted is not None:
            yield from permitted
        yield from _explore(clock, stage, found, steering or Unsteered())
    except ExplorationStopped as error:
        found.stop, found.stop_ns = error.stop, error.time_ns
        found.stop_reason = f"stopped: {error.stop.kind}"
        results = exploration.PhaseStart(found.stop_reason, error.stop.touch), error.stop
        yield from ask(Wait(AFTER_S), results, Moment(error.time_ns, found.started))


def _explore(clock: Callable[[], int], stage: Stage, found: Exploration, steering: Steering) -> RigExperiment[None]:
    looked = yield from ask(Look(), (exploration.PhaseStart("look", 0),), Moment(clock()))
    seen = yield from _computed(clock, stage("look", looked), found, (_recorded_input(looked),), Moment(clock()))
    yield Step(found.add(seen), moment=Moment(clock()))
    if not any(not isinstance(result, exploration.StageFailure) for result in seen.results):
        raise _given_up(clock, found)
    while True:
        touch = yield from _next_touch(clock, stage, found, steering)
        if touch is None:
            return
        count = len(found.touches)
        found.started += 1
        try:
            touched = yield from ask(touch)
        except TouchHeld as held:
            found.started -= 1
            found.asked = [number for number in found.asked if number <= count]
            broken_off = exploration.SteeringDecision(kind="held", xy_m=touch.xy_m, touch=count, reason=str(held))
            yield Step((broken_off,), moment=Moment(clock(), count))
            continue
        found.ended_ns.append(clock())
        given = exploration.PhaseStart("plan", count), _recorded_input(touched)
        made = yield from _computed(clock, stage("touch", touched), found, given, Moment(clock(), count + 1))
        results = found.add(made)
        found.iou.append(None if found.maps is None else found.maps.iou)
        yield Step(results, moment=Moment(clock(), count + 1, _recorded_input(touched).seen_ns or None))


def _next_touch(
    clock: Callable[[], int], stage: Stage, found: Exploration, steering: Steering
) -> Generator[Step, Any, Touch | None]:
    """The planned touch, unless a person requests another; None without a next touch."""
    count = len(found.touches)
    plan = yield from _computed(clock, stage("plan"), found)
    while True:
        yield Step(found.add(plan), moment=Moment(clock(), count, cell_m=PLAN_CELL_M))
        planned = next((one for one in plan.results if isinstance(one, exploration.PlannedTouch)), None)
        while True:
            choice = yield from _answer_to(steering, steering.choose(planned, count))
            if choice.kind != "touch":
                break
            aimed = yield from _computed(clock, stage("aim", choice.xy_m), found)
            yield Step(found.add(aimed), moment=Moment(clock(), count))
            forecast = next((one for one in aimed.results if isinstance(one, exploration.TouchForecast)), None)
            if forecast is None or aimed.touch is None:
                steering.refuse(aimed.refused)
            elif (yield from _answer_to(steering, steering.confirm(forecast))):
                yield Step((exploration.SteeringDecision("touch", choice.xy_m, count),), moment=Moment(clock(), count))
                found.asked.append(count + 1)
                return aimed.touch
        if choice.kind == "go on":
            if plan.touch is None and (planned is None or planned.target_m is not None):
                raise _given_up(clock, found, plan.given_up)
            return plan.touch
        if choice.kind == "veto":
            decision = exploration.SteeringDecision("veto", choice.xy_m, count)
            plan = yield from _computed(clock, stage("veto", choice.xy_m), found, (decision,), Moment(clock(), count))
        else:
            plan = yield from _computed(clock, stage("plan"), found)


def _answer_to(steering: Steering, asked: Future[Any]) -> Generator[Step, Any, Any]:
    """A person's answer; the session continues meanwhile."""
    if asked.done():
        return asked.result()
    given = yield Step(command=asked)
    while not isinstance(given, Answer):
        steering.look()
        given = yield Step()
    return given.value


def _resolved(value: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(value)
    return future


def _computed(
    clock: Callable[[], int],
    command: Compute,
    found: Exploration,
    results: tuple[object, ...] = (),
    moment: Moment | None = None,
) -> Generator[Step, Any, Computed]:
    try:
        computed: Computed = yield from ask(command, results, moment)
    except BrokenExecutor as error:
        raise _given_up(clock, found, "the process that computes has ended") from error
    return computed


def _recorded_input(given: Any) -> Any:
    """The recorded input of a robot's action: the frames that it used, or its measurement."""
    return given if isinstance(given, SurfaceMeasurement | TouchMeasurement) else given.used


def _given_up(clock: Callable[[], int], found: Exploration, why: str = "") -> ExplorationStopped:
    reason = why or f"{found.failures[-1].stage}: {found.failures[-1].reason}"
    stop = exploration.ExplorationStop(
        kind=ESTIMATES_FAILED,
        reason=reason,
        advice="the failure, in the recording",
        action="stop",
        touch=len(found.touches),
    )
    return ExplorationStopped(stop, clock())


def within_loop(stages: ExplorationStages) -> Stage:
    """Computes stages in the thread of the loop."""
    return lambda name, *inputs: Compute(getattr(stages, name), inputs, name)


@dataclass
class RecordedRobot:
    """Repeats a recording: the look and the touches of `read_inputs`, in their order."""

    given: list[Any]

    def look(self) -> Any:
        """The recorded look."""
        return self._next()

    def touch(self, command: Touch) -> Any:
        """The next recorded touch, whatever the requested place."""
        return self._next()

    def _next(self) -> Any:
        if not self.given:
            stop = exploration.ExplorationStop(
                kind=AT_END, reason="nothing was recorded after it", advice="", action="stop", touch=0
            )
            raise ExplorationStopped(stop, 0)
        return self.given.pop(0)
