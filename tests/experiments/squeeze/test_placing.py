"""An arm that places the hand, on a simulated clock: its way, its supervisor, and what is told of faults."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr

from deformscope.experiments.squeeze.placing import STUCK_S, Withdraw
from deformscope.lab.container_setup import T_ARM_HAND
from deformscope.log.squeeze.results import prepare_squeeze_results
from deformscope.robot.advice import advice
from deformscope.robot.placement import best_joints
from deformscope.robot.readings import ArmSample, ForceSample, RobotObservation
from deformscope.robot.squeeze_plan import GripShape, draw_grasps, grasp_at
from deformscope.robot.supervisor import Fault, Supervisor
from deformscope.rows import differing, from_components, to_components
from deformscope_drivers.arm.kinematics import transform
from deformscope_drivers.errors import LinkLost
from deformscope_drivers.jaco import JacoDouble
from studies.placing import PlacedTrial
from tests.cases import slow_but
from tests.experiments.toy_squeeze import spoil_arrays

S = 1_000_000_000
NEAR = "box-03"
"""A container to which the KUKA's way is short."""


@pytest.fixture(scope="module")
def good() -> PlacedTrial:
    trial = PlacedTrial()
    trial.go()
    return trial


def test_the_arm_brings_the_hand_squeezes_and_withdraws(good: PlacedTrial) -> None:
    found = good.found
    assert found.stop is None
    assert found.withdrawal is None
    assert good.phases[:3] == ["pre-shape", "travel", "approach"]
    assert good.phases[-2:] == ["open", "retreat"]
    assert found.placement.reached == "retreat"
    assert found.placement.refused[-1] == ""
    assert all(found.placement.refused[:-1])
    assert [one.change and one.change.kind for one in found.sightings] == [None, "stands", "stands"]
    assert found.features.features.vision is not None
    assert good.preflight.passed


def test_what_is_found_is_where_it_stands(good: PlacedTrial) -> None:
    assert good.found.sightings[0].fit is not None
    after = good.found.sightings[-1].fit
    truth = good.lab.simulated.T_table_container[:3, 3]
    assert (np.abs(after.center_m - truth) < 4.0 * np.append(after.deviation_m[:2], 1e-3)).all()


def test_the_pads_press_where_the_grasp_was_drawn(good: PlacedTrial) -> None:
    """By the simulated container, which nobody but the laboratory knows."""
    nominal, true = good.found.placement.T_hand_container, good.lab.simulated.world.T_hand_container
    np.testing.assert_allclose(true[:3, 3], nominal[:3, 3], atol=0.004)
    assert np.degrees(np.arccos(np.clip(true[:3, 2] @ nominal[:3, 2], -1.0, 1.0))) < 1.0


def test_grasps_are_the_same_for_the_same_seed(good: PlacedTrial) -> None:
    placed = good.found.placement
    drawn = draw_grasps(good.setup.container, good.setup.squeeze, good.seed, len(placed.refused))
    np.testing.assert_array_equal(placed.tried, [(one.along_m, one.tilt_deg, one.turn_deg) for one in drawn])
    others = draw_grasps(good.setup.container, good.setup.squeeze, good.seed + 1, len(placed.refused))
    assert others[0].along_m != drawn[0].along_m


def test_something_on_the_way_stops_the_arm_and_it_backs_off() -> None:
    trial = PlacedTrial("kuka", NEAR)
    trial.at("approach", lambda: trial.lab.simulated.injected_n.__setitem__(0, 2.5))
    found = trial.go()
    assert found.stop.kind == "force above the soft stop"
    assert found.stop.stands
    assert "back off" in trial.phases
    assert "close" not in trial.phases
    assert found.placement.reached == "approach"
    assert found.features is None


def test_a_hard_push_stops_it_where_it_is() -> None:
    trial = PlacedTrial("kuka")
    trial.at("travel", lambda: trial.lab.simulated.injected_n.__setitem__(1, 9.0))
    assert trial.go().stop.kind == "force above the hard stop"
    assert "back off" not in trial.phases
    before = trial.lab.simulated.T_table_hand
    trial.lab.wait_until(trial.lab.clock() + S)
    np.testing.assert_allclose(trial.lab.simulated.T_table_hand, before, atol=1e-9)


def test_an_arm_whose_controller_holds_the_last_value_is_stopped() -> None:
    trial = PlacedTrial("jaco")
    assert trial.lab.functions is not None
    functions = trial.lab.functions
    trial.at("travel", lambda: setattr(functions, "frozen", True))
    assert trial.go().stop.kind == "arm frozen"
    assert "close" not in trial.phases


def test_without_a_container_or_an_image_nothing_moves() -> None:
    gone, blind = PlacedTrial("kuka"), PlacedTrial("kuka")
    gone.lab.simulated.shift(3.0, 0.0)
    blind.lab.simulated.blind = True
    for trial in (gone, blind):
        found = trial.go()
        assert found.stop.kind == "container not found"
        assert "nothing that is 4 cm high" in found.stop.reason
        assert "travel" not in trial.phases


@pytest.mark.slow
def test_out_of_reach_every_grasp_has_its_reason() -> None:
    trial = PlacedTrial("kuka")
    trial.lab.simulated.shift(0.3, 0.35)
    found = trial.go()
    assert found.stop.kind == "no grasp is reached"
    assert len(found.placement.refused) == 40
    assert all(found.placement.refused)
    assert found.placement.reached == ""
    assert "travel" not in trial.phases


@pytest.mark.parametrize("fault", ["shift", "topple"])
@pytest.mark.slow
def test_a_container_that_moved_while_the_hand_came_is_noticed(fault: str) -> None:
    trial = PlacedTrial("kuka")
    simulated = trial.lab.simulated
    action = (lambda: simulated.shift(0.012, 0.0)) if fault == "shift" else (lambda: simulated.topple((0.3, 1.0)))
    trial.at("travel", action)
    assert trial.go().stop.kind.startswith("container ")
    assert "close" not in trial.phases


def test_a_hand_that_is_led_into_the_container_topples_or_moves_it() -> None:
    simulated = PlacedTrial("kuka").lab.simulated
    hand = simulated.T_table_hand
    there = simulated.T_table_container.copy()
    there[:3, 3] = hand[:3, 3] + 0.1 * hand[:3, 2] + 0.03 * hand[:3, 0]  # a finger is within
    simulated.place(there)
    simulated.meet()
    assert simulated.toppled


def test_a_grasp_that_a_person_chose_is_taken() -> None:
    trial = PlacedTrial("kuka", "box-03", 3)
    chosen = grasp_at(trial.setup.container, trial.setup.squeeze, 0.005, 1.0, 0.0)
    trial.at("travel", lambda: trial.hand.ask_to_stop("enough"))
    found = trial.go(chosen)
    assert found.placement.seed == -1
    assert found.placement.along_m == 0.005
    assert found.placement.refused == ("",)


def test_what_is_recorded_is_read_again_as_it_was_and_is_shown(good: PlacedTrial) -> None:
    results = [*good.found.sightings, good.found.placement]
    for result in results:
        assert differing(result, from_components(type(result), to_components(result))) is None
    rec = rr.RecordingStream("deformscope-test")
    memory = rec.memory_recording()
    prepare_squeeze_results(results, 0, None).send(rec)
    rec.flush(timeout_sec=10.0)
    assert memory.num_msgs() > len(results)


class Struck:
    """A fault of the arm and when it came. trial: a Jaco's, in whose phase `phase` it comes"""

    def __init__(self, trial: PlacedTrial, phase: str, fault: Callable[[JacoDouble], None], later_s: float) -> None:
        self.trial, self.fault, self.ns, self.angles_deg = trial, fault, 0, np.zeros(7)
        trial.at(phase, self, later_s)

    def __call__(self) -> None:
        self.ns = self.trial.lab.clock()
        self.fault(jaco_of(self.trial))

    @property
    def stopped_s(self) -> float:
        """From the fault until the squeeze was stopped."""
        return (self.trial.found.stop_ns - self.ns) / 1e9


def jaco_of(trial: PlacedTrial) -> JacoDouble:
    """Its arm's double."""
    double = trial.lab.simulated.body
    assert isinstance(double, JacoDouble)
    return double


def turned(joint: int, by_deg: float) -> Callable[[JacoDouble], None]:
    """Somebody turns a joint of the arm."""

    def fault(double: JacoDouble) -> None:
        joints_deg = double.joints_deg.copy()
        joints_deg[joint] += by_deg
        double.put(joints_deg)

    return fault


ARM_FAULTS = {
    "cable": (JacoDouble.unplug, "link lost", 0.12),
    "shifted": (turned(0, 1.2), "arm too fast", 0.08),
    "twisted": (turned(5, 3.0), "turns too fast", 0.08),
    "pushed": (lambda double: double.push_link(2, (0.0, 0.0, -60.0)), "something pushes the arm", 0.3),
}
"""What strikes the arm, as what it is noticed, within which time: age of the arm's states, torques that are read by
turns, each with two of the hand's periods."""


QUICK = ("close", "pushed")
"""Phase and fault of what is not slow."""


@pytest.mark.parametrize(
    ("phase", "fault"), slow_but([QUICK], [(phase, fault) for phase in ("close", "hold") for fault in ARM_FAULTS])
)
def test_an_arm_that_does_not_stand_ends_the_squeeze_in_time(fault: str, phase: str) -> None:
    strike, noticed, within_s = ARM_FAULTS[fault]
    trial = PlacedTrial("jaco")
    jaco_of(trial).blur_torques(0.15, 0.1)  # as real ones are: the same reading twice is one that was not read anew
    struck = Struck(trial, phase, strike, 0.2)
    found = trial.go()
    assert found.stop.kind == "arm that carries the hand"
    assert noticed in found.stop.reason
    assert struck.stopped_s <= within_s
    assert found.stop.stands
    assert "retreat" not in trial.phases
    angles = [axis.velocity_deg_s for axis in trial.lab.simulated.hand.motion.axes]
    np.testing.assert_array_equal(angles, 0.0)
    assert trial.lab.arm.stopped_because


@pytest.mark.slow
def test_a_kuka_whose_cable_is_pulled_ends_the_squeeze_in_time() -> None:
    trial = PlacedTrial("kuka")
    wire, when_ns = trial.lab.wire, list[int]()
    assert wire is not None
    trial.at("hold", lambda: (wire.unplug(), when_ns.append(trial.lab.clock())), 0.1)
    found = trial.go()
    assert found.stop.kind == "arm that carries the hand"
    assert found.stop.stands
    assert (found.stop_ns - when_ns[0]) / 1e9 <= 0.12
    assert "open" not in trial.phases


@pytest.mark.slow
def test_an_arm_that_drifts_slowly_ends_the_squeeze_before_the_hand_has_gone_far() -> None:
    """Too slow for the limit of speed, and without a push: by how far it has gone."""
    trial = PlacedTrial("jaco")
    double, lab = jaco_of(trial), trial.lab

    def drift() -> None:
        joints_deg = double.joints_deg.copy()
        joints_deg[0] += 0.02
        double.put(joints_deg)
        lab.schedule(lab.clock() + 10_000_000, drift)

    trial.at("squeeze", drift, 0.0)
    found = trial.go()
    assert found.stop.kind == "arm that carries the hand"
    assert "from the hand's first pose" in found.stop.reason
    assert 5.0 <= float(found.stop.reason.split(" mm")[0]) <= 7.0
    assert "open" not in trial.phases


def test_an_arm_that_stands_is_not_stopped_by_what_the_fingers_press(good: PlacedTrial) -> None:
    assert good.found.features.features.by_name["force_n"] > 2.0  # above what backs the hand off on its way
    assert good.found.stop is None


@pytest.mark.slow
def test_an_arm_that_was_turned_does_not_withdraw() -> None:
    """The wrist alone: the hand is where it was, and points elsewhere."""
    trial = PlacedTrial("jaco")

    def turn() -> None:
        """Between the squeeze and the way back, when nothing looks."""
        before = trial.arm.do

        def do(command: object) -> object:
            if isinstance(command, Withdraw):
                turned(5, 4.0)(jaco_of(trial))
            return before(command)

        trial.arm.do = do  # type: ignore[method-assign]

    trial.at("close", turn, 0.0)
    found = trial.go()
    assert found.stop is None
    assert found.features is not None
    assert found.withdrawal.kind == "arm was moved"
    assert "and 4 deg" in found.withdrawal.reason
    assert "retreat" not in trial.phases


LIMITS = [({"over_squeeze_m": 0.0008}, "container over-squeezed"), ({"still_timeout_s": 0.3}, "no steady state")]


@pytest.mark.slow  # the way of a stop that arrays cause, below
@pytest.mark.parametrize(("limit", "kind"), LIMITS)
def test_after_a_stop_the_fingers_open_though_an_arm_carries_the_hand(limit: dict[str, float], kind: str) -> None:
    trial = PlacedTrial("kuka", NEAR)
    trial.setup = replace(trial.setup, squeeze=replace(trial.setup.squeeze, **limit))
    found = trial.go()
    assert found.stop.kind == kind
    assert "did not open" not in found.stop.advice
    angles = np.array([axis.position_deg for axis in trial.lab.simulated.hand.motion.axes])
    open_deg = np.array(GripShape.of(trial.setup.container, trial.setup.squeeze).open_deg)
    np.testing.assert_allclose(angles, open_deg, atol=1.0)


@pytest.mark.slow
def test_an_arm_that_is_pushed_while_the_fingers_open_lets_them_open_and_does_not_withdraw() -> None:
    trial = PlacedTrial("jaco")
    trial.at("open", lambda: turned(0, 1.5)(jaco_of(trial)), 0.05)
    found = trial.go()
    assert found.stop is None
    assert found.features is not None
    assert found.withdrawal.kind == "arm was moved"
    assert "retreat" not in trial.phases
    angles = np.array([axis.position_deg for axis in trial.lab.simulated.hand.motion.axes])
    open_deg = np.array(GripShape.of(trial.setup.container, trial.setup.squeeze).open_deg)
    np.testing.assert_allclose(angles, open_deg, atol=1.0)


def test_an_arm_that_cannot_be_watched_any_more_is_a_stop_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = PlacedTrial("kuka", NEAR)

    def lost(**named: bool) -> object:
        raise LinkLost("the arm's port", "it is gone")

    trial.at("approach", lambda: monkeypatch.setattr(trial.arm, "_robot", lost))
    assert "it is gone" in trial.go().stop.reason
    assert "close" not in trial.phases


def test_an_arm_that_was_moved_while_a_person_was_asked_does_not_set_out() -> None:
    trial = PlacedTrial("jaco")
    trial.asks = lambda: turned(3, 4.0)(jaco_of(trial))
    found = trial.go()
    assert found.stop.kind == "checks before motion"
    assert "place: start: 4.0 deg" in found.stop.reason
    assert "start again" in found.stop.advice
    assert "travel" not in trial.phases


@pytest.mark.parametrize(
    ("by_m", "kind"), [(0.02, "moved"), (3.0, "gone"), pytest.param(0.3, "moved", marks=pytest.mark.slow)]
)
def test_a_container_that_was_moved_while_a_person_was_asked_is_not_driven_to(by_m: float, kind: str) -> None:
    trial = PlacedTrial("kuka")
    trial.asks = lambda: trial.lab.simulated.shift(-by_m if by_m == 0.3 else by_m, 0.0)
    found = trial.go()
    assert found.stop.kind == f"container {kind}"
    assert [one.when for one in found.sightings] == ["before", "asked"]
    assert "travel" not in trial.phases


def test_what_asks_to_stop_while_it_looks_keeps_the_arm_from_setting_out() -> None:
    trial = PlacedTrial("kuka")

    def once_it_looks() -> None:
        if trial.hand.doing:
            trial.lab.schedule(trial.lab.clock() + S // 20, once_it_looks)
        else:
            trial.lab.schedule(trial.lab.clock() + S // 5, lambda: trial.hand.ask_to_stop("the page is hidden"))

    trial.at("pre-shape", once_it_looks)
    assert trial.go().stop.kind == "a person asked"
    assert "travel" not in trial.phases


def test_after_a_question_nothing_moved_and_it_goes_on_until_a_person_stops_it_on_the_way() -> None:
    trial = PlacedTrial("kuka")
    trial.asks = lambda: trial.at("travel", lambda: trial.hand.ask_to_stop("enough"))
    assert trial.go().stop.kind == "a person asked"
    assert trial.phases[-1] == "travel"


def test_fingers_that_are_pressed_do_not_set_out_and_the_words_are_of_a_hand() -> None:
    trial = PlacedTrial("kuka")
    trial.lab.simulated.injected_n[0] = 1.0
    found = trial.go()
    assert found.stop.kind == "checks before motion"
    assert "fingers: tare: 1.0" in found.stop.reason
    assert found.stop.advice == "keep the fingers free of contact, and start again"


def test_an_arm_that_begins_at_the_container_says_so(good: PlacedTrial) -> None:
    trial, placed = PlacedTrial("jaco"), good.found.placement
    beside = placed.T_table_hand @ transform(np.eye(3), (0.0, 0.0, -0.03))  # its fingers on either side of it
    T_base_ee = good.lab.placement.T_base_surface @ beside @ np.linalg.inv(T_ARM_HAND)
    joints_deg = best_joints(trial.lab.chain, [T_base_ee])
    assert joints_deg is not None
    jaco_of(trial).put(joints_deg)
    found = trial.go()
    assert found.stop.kind == "arm begins too near the container"
    assert len(found.placement.refused) == 1
    assert "travel" not in trial.phases


def test_an_arm_that_is_lost_before_its_first_command_stops_the_run_with_its_reason() -> None:
    trial = PlacedTrial("jaco")
    trial.at("pre-shape", jaco_of(trial).unplug, 0.05)
    found = trial.go()
    assert found.stop.kind == "link lost"
    assert found.stop.advice
    assert "travel" not in trial.phases


def test_an_array_that_says_the_same_force_for_long_is_stuck_and_one_at_rest_is_not(good: PlacedTrial) -> None:
    limits = replace(good.setup.placing.limits(good.setup.squeeze, 30.0), low_m=None, high_m=None)
    arms = (ArmSample(0, np.eye(4), (0.0,)),)
    for stuck_n, noticed in ((0.0, False), (0.4, True)):
        supervisor = Supervisor(limits, 0)
        supervisor.axes_frozen_s = np.full(3, STUCK_S)
        fault = Fault.NONE
        for number in range(100):
            now_ns = 30_000_000 * number
            noise_n = np.array([0.05 + 0.01 * (number % 3), stuck_n, 0.0])
            sample = ForceSample(now_ns, noise_n, pattern=number, sensor_n=noise_n)
            arms = (replace(arms[0], time_ns=now_ns),)
            fault = supervisor.judge(RobotObservation(now_ns, forces=(sample,), arms=arms)).fault
        assert (fault is Fault.FORCE_FROZEN) is noticed
        assert ("finger 1" in supervisor.verdict.reason) is noticed


def test_what_a_dead_array_does_not_feel_the_joints_do() -> None:
    """Something holds the hand on its way, and its arrays say 0 all the while."""
    trial = PlacedTrial("jaco")
    struck = Struck(trial, "travel", lambda double: double.push_link(5, (0.0, 0.0, 40.0)), 0.5)
    found = trial.go()
    assert found.stop.kind == "something pushes the arm"
    assert struck.stopped_s <= 0.3
    assert "tip" not in found.stop.advice


@pytest.mark.parametrize("cause", [Fault.FORCE_HARD, Fault.FORCE_SILENT, Fault.TILT, Fault.ARM_BOX])
def test_what_is_told_of_a_hand_is_of_a_hand(cause: Fault) -> None:
    words = advice(cause, hand=True)
    assert not re.search(r"\b(tip|stick|tool|force sensor)\b", words)
    assert words != advice(cause)


ARRAY_FAULTS = [
    ("jaco", "close", "dead", (0, 2), 0.3),
    ("kuka", "squeeze", "dead", (0, 2), 0.0),
    ("jaco", "squeeze", "dead", (0, 2), 0.0),
    ("kuka", "close", "dead", (2,), 0.3),
    ("jaco", "close", "dead", (0,), 0.3),
    ("jaco", "squeeze", "frozen", (0,), 0.1),
    ("kuka", "hold", "frozen", (0, 2), 0.0),
]


@pytest.mark.parametrize(("arm", "phase", "fault", "fingers", "later_s"), slow_but(ARRAY_FAULTS[:1], ARRAY_FAULTS))
def test_arrays_that_contradict_the_fingers_end_the_squeeze_and_stop_the_arm(
    arm: str, phase: str, fault: str, fingers: tuple[int, ...], later_s: float
) -> None:
    """The container is pressed with 4.4 N, which the arrays do not say."""
    trial = PlacedTrial(arm)
    trial.at(phase, lambda: spoil_arrays(trial.lab.simulated.pads, fault, fingers), later_s)
    found = trial.go()
    assert found.stop.kind == "tactile arrays contradict the fingers"
    assert f"finger {fingers[0]}" in found.stop.reason
    assert found.features is None
    assert found.stop.stands
    assert found.stop_ns - trial.lab.simulated.truth().contact_ns < 1.5 * S
    assert "retreat" not in trial.phases
    assert trial.lab.arm.stopped_because
    angles = np.array([axis.position_deg for axis in trial.lab.simulated.hand.motion.axes])
    open_deg = np.array(GripShape.of(trial.setup.container, trial.setup.squeeze).open_deg)
    np.testing.assert_allclose(angles, open_deg, atol=1.0)
