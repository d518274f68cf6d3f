"""What a page says while an arm touches: it stops, holds what was confirmed where nobody watches, and decides what is
touched."""

import itertools
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from deformscope.experiments.explore.explore import ExplorationStopped
from deformscope.experiments.explore.touching_robot import CheckFirst
from deformscope.page.server import messages
from deformscope.page.server.page_session import CONFIRM_S, PageSession
from deformscope.page.steering import PageSteering, add_measured, curve_of, is_surface
from deformscope.robot.finger import FINGER
from deformscope.robot.latch import Action
from deformscope.robot.robot import MotionHeld, RobotStopped, TipVelocity
from deformscope.robot.supervisor import Fault
from deformscope.robot.touch import TouchEnding, TouchRecord, run_touch
from deformscope.runs import skeleton
from deformscope.stages.map.exploration import PlannedTouch, TouchForecast
from deformscope.terminal import Interruption
from studies.fault_study import FaultScene, make_scene
from tests.log.synthetic_exploration import touch

PRESSES = 20
SPEED_M_S = 0.02
EXPECTED = np.linspace(0.0, 3.0, 4)
FORECAST = TouchForecast(
    xyz_m=np.array([0.3, 0.2, 0.05]),
    normal=np.array([0.0, 0.0, 1.0]),
    way_m=np.array([[0.3, 0.2, 0.1], [0.3, 0.2, 0.05]]),
    set_force_n=3.0,
    stiffness_n_per_mm=1.0,
    stiffness_interval=(0.5, 2.0),
    force_n=EXPECTED,
    depth_m=1e-3 * EXPECTED,
    depth_low_m=5e-4 * EXPECTED,
    depth_high_m=2e-3 * EXPECTED,
    touches=2,
)


class Steered:
    """A page that steers, and the session between; its time is set by hand."""

    def __init__(self, *, paused: bool = False, begun: bool = True) -> None:
        self.now_s = 0.0
        self.ended = Interruption()
        self.session = PageSession(clock=lambda: self.now_s)
        self.session.come("a")
        self.steering = PageSteering(
            self.session,
            self.ended,
            lambda: 0,
            arm="arm",
            set_force_n=3.0,
            budget=8,
            compliance_m_per_n=0.0,
            paused=paused,
        )
        self.beat()
        if begun:
            self.steering.go_on()

    def beat(self) -> None:
        self.session.beat("a", visible=True)

    def say(self, kind: Callable[..., messages.PageCommand], *fields: object) -> tuple[str, str]:
        reply = self.session.command("a", kind(1, *fields))
        return reply.outcome, reply.words

    def confirm(self) -> str:
        return self.say(messages.ConfirmMove, self.session.state.pending.number)[0]


def planned(x_m: float = 0.15) -> PlannedTouch:
    return PlannedTouch(np.array([x_m, 0.2]), None, None, np.zeros((2, 2), bool), "fills the space")


def test_the_page_asks_for_a_finger_on_the_tip_before_the_arm_may_move() -> None:
    steered = Steered(begun=False)
    nothing = SimpleNamespace()
    first = next(skeleton.permitted(nothing, nothing, nothing, {}, steered.ended, yes=True, page=steered.steering))  # type: ignore[arg-type]
    assert isinstance(first.command, CheckFirst)
    assert first.command.ask_finger is not None
    first.command.ask_finger(FINGER)
    assert [remark.words for remark in steered.session.state.remarks] == [FINGER]


def test_a_real_arm_begins_once_somebody_confirms_it_on_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))  # nobody sits at a terminal
    monkeypatch.setattr(skeleton, "POLL_S", 0.0)
    steered = Steered(begun=False)
    assert (steered.session.state.phase, steered.session.state.commands) == ("idle", ("stop",))
    steered.steering.wait_for("up to 8 touches of 3 N")
    question = skeleton.RunOperator(steered.ended, steered.steering.is_agreed).line("?")
    next(question)
    assert steered.say(messages.StartExploring)[0] == "begun"
    next(question)
    assert steered.session.state.pending.what == "arm continues: up to 8 touches of 3 N"
    assert steered.confirm() == "done"
    with pytest.raises(StopIteration) as answered:
        next(question)
    assert answered.value.value == "yes"
    steered.steering.go_on()
    assert steered.session.state.phase == "exploring"


def presses(count: int) -> list[int]:
    """Velocities above zero that were commanded after the server had received a stop, at so many random moments."""
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    random = np.random.default_rng(20)
    after = [pressed(scene, int(random.integers(1, 12)), looked=bool(random.integers(2))) for _ in range(count)]
    scene.lab.close()
    return after


def pressed(scene: FaultScene, at: int, *, looked: bool) -> int:
    """The same for a stop in a period of a motion. looked: whether the supervisor has looked in it"""
    steered, robot = Steered(), scene.robot
    watch, periods, received = skeleton.Watch(steered.ended, lambda words: None), itertools.count(), list[int]()
    watch.robot = _Watched(scene)

    def cycled(*seen: object) -> None:
        now = next(periods) == at
        for turn in (False, True):
            if turn:
                watch()
            if now and turn is looked:
                received.append(len(robot.commanded))
                assert steered.say(messages.StopRun) == ("done", "the arm stops")

    robot.watch = cycled
    up = 1.0 if scene.lab.contact.center_m[2] < 0.15 else -1.0
    with pytest.raises(RobotStopped, match="a person asked: from the page"):
        go_on(scene, TipVelocity(np.array([0.0, 0.0, up * SPEED_M_S])))
    assert robot.commanded[received[0] - 1] > 0.0  # it moved
    robot.watch = None
    robot.arm.acknowledge_stop()
    robot.start()
    robot.supervisor.acknowledge(scene.lab.clock())
    robot.cycle()
    return sum(speed > 0.0 for speed in robot.commanded[received[0] :])


def go_on(scene: FaultScene, command: TipVelocity) -> None:
    for _ in range(30):
        scene.robot.cycle(command)


class _Watched:
    doing = ""

    def __init__(self, scene: FaultScene) -> None:
        self._scene = scene

    def ask_to_stop(self, reason: str) -> None:
        self._scene.robot.ask_to_stop(reason)

    def halt(self, reason: str) -> bool:
        return self._scene.robot.halt(reason)


def test_stop_leaves_two_periods_at_most() -> None:
    after = presses(PRESSES)
    assert len(after) == PRESSES
    assert max(after) <= 2


@pytest.mark.slow
def test_stop_leaves_two_periods_at_most_in_200_presses(capsys: pytest.CaptureFixture[str]) -> None:
    after = presses(200)
    with capsys.disabled():
        shares = ", ".join(f"{count} in {after.count(count)}" for count in sorted(set(after)))
        print(f"\nvelocities above zero after a stop was received, in {len(after)} presses: {shares}")
    assert len(after) == 200
    assert max(after) <= 2


def test_stop_is_obeyed_from_any_page() -> None:
    steered = Steered()
    assert steered.session.command("b", messages.StopRun(1)).outcome == "done"
    assert steered.ended.is_set()
    assert steered.ended.by == "from the page"


def confirmed() -> Steered:
    """Somebody has confirmed a touch."""
    steered = Steered(paused=True)
    choice = steered.steering.choose(planned(), 0)
    assert steered.say(messages.TouchAt, 0.3, 0.2)[0] == "begun"
    assert choice.result(0).kind == "touch"
    asked = steered.steering.confirm(FORECAST)
    assert not asked.done()
    assert steered.confirm() == "done"
    assert asked.result(0) is True
    return steered


def test_a_confirmed_touch_goes_on_while_its_page_is_there() -> None:
    steered = confirmed()
    assert steered.steering.reason_to_stand() == ""
    steered.now_s += 0.29
    assert steered.steering.reason_to_stand() == ""
    steered.now_s += 0.02
    assert steered.steering.reason_to_stand() == "no heartbeat of the page for 310 ms"
    steered.beat()
    assert steered.steering.reason_to_stand() == ""
    steered.session.beat("a", visible=False)
    assert "hidden" in steered.steering.reason_to_stand()
    steered.session.leave("a")
    assert "no page" in steered.steering.reason_to_stand()


def test_exploring_goes_on_without_a_page() -> None:
    steered = Steered()
    assert steered.steering.choose(planned(), 0).result(0).kind == "go on"
    steered.session.leave("a")
    assert steered.steering.reason_to_stand() == ""
    assert steered.steering.choose(planned(), 1).result(0).kind == "go on"


def held_in(scene: FaultScene, steered: Steered, phase: str) -> TouchRecord:
    """A confirmed touch whose page falls silent as this phase begins."""
    robot, gone = scene.robot, list[int]()
    robot.reason_to_stand = steered.steering.reason_to_stand

    def begin(begun: object, time_ns: int) -> None:
        if begun == phase:
            gone.append(len(robot.commanded))
            steered.now_s += 0.31

    record = run_touch(robot, scene.plan, on_phase=begin)
    assert record.ending is TouchEnding.HELD
    assert record.reason == "no heartbeat of the page for 310 ms"
    assert set(robot.commanded[gone[0] :]) == {0.0}
    assert robot.supervisor.verdict.action is Action.GO_ON
    with pytest.raises(MotionHeld):
        robot.cycle(TipVelocity(np.array([0.0, 0.0, SPEED_M_S])))
    return record


def test_an_arm_whose_page_is_gone_stands_in_the_same_period() -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    assert held_in(scene, confirmed(), "approach").contact_m is None
    scene.lab.close()


@pytest.mark.slow
def test_an_arm_that_stands_in_the_foam_can_be_sent_on() -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    steered = confirmed()
    record = held_in(scene, steered, "press")
    steered.beat()
    again = run_touch(scene.robot, scene.plan)  # up first
    scene.lab.close()
    assert again.ending is TouchEnding.SET_FORCE
    assert again.contact_m == pytest.approx(record.contact_m, abs=1e-3)


def test_who_is_pushed_away_may_go_whoever_watches() -> None:
    """A force above the soft stop: the arm backs off although the page is gone."""
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    robot = scene.robot
    robot.supervisor._verdict = type(robot.supervisor.verdict)(Action.BACK_OFF, Fault.FORCE_SOFT, "9 N", 0)
    robot.reason_to_stand = lambda: "nobody is there"
    robot.cycle(TipVelocity(np.array([0.0, 0.0, SPEED_M_S])))
    scene.lab.close()
    assert robot.commanded[-1] > 0.0


def test_what_was_not_confirmed_is_not_touched() -> None:
    steered = Steered(paused=True)
    steered.steering.choose(planned(), 0)
    steered.say(messages.TouchAt, 0.3, 0.2)
    asked = steered.steering.confirm(FORECAST)
    state = steered.session.state
    assert state.pending.what == "arm goes to (30.0, 20.0) cm and presses with 3 N, along the normal there"
    assert state.curve is not None
    steered.now_s += CONFIRM_S
    steered.beat()
    assert steered.confirm() == "refused"
    assert asked.result(0) is False
    assert steered.session.state.curve is None
    assert [remark.words for remark in steered.session.state.remarks] == ["not confirmed within 10 s: nothing moved"]
    again = steered.steering.choose(planned(), 0)
    assert not again.done()
    assert steered.say(messages.VetoTouch)[0] == "begun"
    assert again.result(0).kind == "veto"
    assert again.result(0).xy_m.tolist() == [0.15, 0.2]


def test_exploring_pauses_and_goes_on_after_a_confirm() -> None:
    steered = Steered()
    assert steered.session.state.phase == "exploring"
    assert steered.say(messages.TouchAt, 0.3, 0.2)[0] == "refused"
    assert steered.say(messages.PauseExploring) == ("done", "no further touch begins")
    assert steered.session.state.commands == ("stop", "explore")  # the touch under way is ended first
    assert steered.say(messages.StartExploring) == ("begun", "waits for a confirmation")
    assert steered.session.state.phase == "paused"
    waits = steered.steering.choose(planned(), 1)
    assert "touch-next" in steered.session.state.commands
    assert steered.session.state.next_place is not None
    assert steered.say(messages.StartExploring) == ("begun", "waits for a confirmation")
    assert not waits.done()
    assert steered.session.state.pending.what == "arm continues to touch on its own, 7 times more at most, with 3 N"
    assert steered.confirm() == "done"
    assert waits.result(0).kind == "go on"
    assert steered.session.state.phase == "exploring"


def test_places_are_picked_on_the_surface_alone() -> None:
    steered = Steered(paused=True)
    choice = steered.steering.choose(None, 0)
    assert steered.say(messages.TouchNext)[0] == "refused"  # there is no plan
    assert steered.say(messages.TouchPicked, "/display/arm/arm/link_3", (0.3, 0.2, 0.2))[0] == "refused"
    assert not choice.done()
    assert steered.say(messages.TouchPicked, "/display/scene/surface", (0.31, 0.2, 0.05))[0] == "begun"
    assert choice.result(0).xy_m.tolist() == [0.31, 0.2]
    assert steered.say(messages.TouchAt, 0.1, 0.1)[0] == "refused"  # one at a time
    assert is_surface("/display/scene/observed")
    assert not is_surface("/display/scene/base")


def test_a_stop_ends_what_is_waited_for() -> None:
    for waits in ("choice", "confirm"):
        steered = Steered(paused=True)
        future = steered.steering.choose(planned(), 3)
        if waits == "confirm":
            steered.say(messages.TouchNext)
            future = steered.steering.confirm(FORECAST)  # type: ignore[assignment]
        steered.steering.look()
        assert not future.done()
        steered.say(messages.StopRun)
        steered.steering.look()
        with pytest.raises(ExplorationStopped) as stopped:
            future.result(0)
        assert (stopped.value.stop.kind, stopped.value.stop.touch) == (Fault.ASKED, 3)


def test_another_page_takes_over_and_what_waited_is_let_be() -> None:
    steered = Steered(paused=True)
    steered.steering.choose(planned(), 0)
    steered.say(messages.TouchNext)
    asked = steered.steering.confirm(FORECAST)
    steered.session.come("b")
    steered.session.command("b", messages.TakeControls(1))
    assert asked.result(0) is False


def test_felt_stands_beside_expected() -> None:
    felt = touch(1)
    curve = add_measured(curve_of(FORECAST), felt, compliance_m_per_n=0.0)
    assert curve.depth_mm == (0.0, 1.0, 2.0, 3.0)
    assert f"measured {felt.stiffness_n_per_mm:.2g} N/mm, " in curve.words
    assert "1 N/mm (0.5 to 2)" in curve.words
    within = 0.5 <= felt.stiffness_n_per_mm <= 2.0
    assert ("as expected" in curve.words) is within
    assert len(curve.felt_mm) == len(curve.felt_n) > 10
    assert max(curve.felt_n) == pytest.approx(float(felt.approach_n.max()), abs=1e-4)
    deepest = 1e3 * (felt.approach_m[int(np.argmax(felt.approach_n))] - felt.contact_m)
    assert max(curve.felt_mm) == pytest.approx(deepest, abs=0.1)
