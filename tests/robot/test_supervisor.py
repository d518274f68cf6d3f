"""The supervisor notices each fault in its time, never by mistake, and never resets itself."""

from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.robot.latch import Action
from deformscope.robot.readings import ArmSample, CameraSample, ForceSample, RobotObservation
from deformscope.robot.supervisor import Fault, Limits, SafetyDecision, Supervisor
from deformscope_drivers.arm.kinematics import rotation_from_rpy, transform
from deformscope_drivers.jaco.chains import J2N6S300

MS = 1_000_000
PERIOD = 10 * MS


def force(time_ns: int, newtons: float = 1.0, *, pattern: object = None, usable: bool = True) -> ForceSample:
    return ForceSample(time_ns, np.array([0.0, 0.0, newtons]), time_ns if pattern is None else str(pattern), usable)


def arm(time_ns: int, x_m: float = 0.0, *, joints: float | None = None, fifo: int = 0) -> ArmSample:
    pose = np.eye(4)
    pose[0, 3] = x_m
    return ArmSample(time_ns, pose, (x_m if joints is None else joints,), fifo)


def judged(supervisor: Supervisor, now_ns: int, **changed: object) -> SafetyDecision:
    commanded = float(changed.pop("commanded_m_s", 0.0))  # type: ignore[arg-type]
    needed = bool(changed.pop("camera_needed", False))
    rotation: Any = changed.pop("commanded_rotation", None)
    well: dict[str, object] = {"forces": (force(now_ns),), "arms": (arm(now_ns),)}
    seen = RobotObservation(now_ns, **(well | changed))  # type: ignore[arg-type]
    return supervisor.judge(seen, commanded_m_s=commanded, commanded_rotation=rotation, camera_needed=needed)


def test_all_well_goes_on() -> None:
    supervisor = Supervisor(Limits(), 0)
    assert all(judged(supervisor, k * PERIOD).action is Action.GO_ON for k in range(1, 500))


@pytest.mark.parametrize(
    ("newtons", "action", "fault"),
    [
        (7.9, Action.GO_ON, Fault.NONE),
        (-8.1, Action.BACK_OFF, Fault.FORCE_SOFT),
        (15.1, Action.STOP, Fault.FORCE_HARD),
        (np.nan, Action.STOP, Fault.FORCE_INVALID),
        (np.inf, Action.STOP, Fault.FORCE_INVALID),
    ],
)
def test_one_force_is_enough(newtons: float, action: Action, fault: Fault) -> None:
    verdict = judged(Supervisor(Limits(), 0), PERIOD, forces=(force(1), force(2, newtons), force(3)))
    assert (verdict.action, verdict.fault) == (action, fault)


def test_the_worse_wins_and_holds_until_acknowledged() -> None:
    supervisor = Supervisor(Limits(), 0)
    assert judged(supervisor, PERIOD, forces=(force(1, 9.0),)).action is Action.BACK_OFF
    assert judged(supervisor, 2 * PERIOD).fault is Fault.FORCE_SOFT
    assert judged(supervisor, 3 * PERIOD, forces=(force(3, 20.0),)).action is Action.STOP
    assert judged(supervisor, 4 * PERIOD).fault is Fault.FORCE_HARD
    assert supervisor.verdict.time_ns == 3 * PERIOD
    supervisor.acknowledge(5 * PERIOD)
    assert judged(supervisor, 6 * PERIOD).action is Action.GO_ON


def when(supervisor: Supervisor, begins_ns: int, fault: Fault, **changed: object) -> int:
    """Run well until a moment, then changed: how long until it is noticed [ns]."""
    now_ns = 0
    while now_ns < begins_ns:
        now_ns += PERIOD
        assert (
            judged(
                supervisor, now_ns, **{k: v for k, v in changed.items() if k.endswith("needed")} | PICTURES(now_ns)
            ).action
            is Action.GO_ON
        )
    while now_ns < begins_ns + 1000 * MS:
        now_ns += PERIOD
        verdict = judged(supervisor, now_ns, **(PICTURES(now_ns) | changed))
        if verdict.action is not Action.GO_ON:
            assert verdict.fault is fault
            return now_ns - begins_ns
    raise AssertionError("never noticed")


def PICTURES(now_ns: int) -> dict[str, object]:
    """One every 30 ms."""
    return {"pictures": (CameraSample(now_ns, now_ns),)} if now_ns % (3 * PERIOD) == 0 else {}


@pytest.mark.parametrize(
    ("fault", "changed", "within_ms"),
    [
        (Fault.FORCE_SILENT, {"forces": ()}, 50),
        (Fault.ARM_SILENT, {"arms": ()}, 100),
        (Fault.LINK, {"lost_links": (("arm", "cable"),)}, 10),
        (Fault.CAMERA_SILENT, {"pictures": (), "camera_needed": True}, 66),
    ],
)
def test_silence_is_noticed_in_time(fault: Fault, changed: dict[str, object], within_ms: int) -> None:
    assert when(Supervisor(Limits(), 0), 300 * MS, fault, **changed) <= within_ms * MS


def test_a_silent_camera_is_nothing_where_it_is_not_needed() -> None:
    supervisor = Supervisor(Limits(), 0)
    assert all(judged(supervisor, k * PERIOD).action is Action.GO_ON for k in range(1, 100))
    assert judged(supervisor, 101 * PERIOD, camera_needed=True).action is Action.GO_ON


def test_the_same_picture_twice_is_a_frozen_camera() -> None:
    supervisor = Supervisor(Limits(), 0)
    judged(supervisor, PERIOD, pictures=(CameraSample(1, "a"),), camera_needed=True)
    verdict = judged(supervisor, 2 * PERIOD, pictures=(CameraSample(2, "a"),), camera_needed=True)
    assert verdict.fault is Fault.CAMERA_FROZEN


def test_a_frozen_force_is_noticed_in_time() -> None:
    supervisor = Supervisor(Limits(), 0)
    for k in range(1, 100):
        frozen = tuple(force(k * PERIOD - j * MS, pattern="same") for j in range(9, -1, -1))
        if judged(supervisor, k * PERIOD, forces=frozen).action is Action.STOP:
            break
    assert supervisor.verdict.fault is Fault.FORCE_FROZEN
    assert k * PERIOD <= 50 * MS


def test_damaged_frames_now_and_then_are_no_storm() -> None:
    supervisor = Supervisor(Limits(), 0)
    counted = [judged(supervisor, k * PERIOD, refused=7 + k // 3) for k in range(1, 300)]
    assert counted[-1].action is Action.GO_ON
    assert judged(supervisor, 300 * PERIOD, refused=counted.__len__() + 7).fault is Fault.CHECKSUMS


def test_readings_that_are_not_usable() -> None:
    supervisor = Supervisor(Limits(), 0)
    assert judged(supervisor, PERIOD, forces=(force(PERIOD, usable=False),)).action is Action.GO_ON
    some = tuple(force(2 * PERIOD, usable=False) for _ in range(3))
    assert judged(supervisor, 2 * PERIOD, forces=some).fault is Fault.FORCE_UNUSABLE


def test_an_arm_that_says_the_same_while_it_is_sent_on() -> None:
    supervisor = Supervisor(Limits(), 0)
    for k in range(1, 100):
        if judged(supervisor, k * PERIOD, arms=(arm(k * PERIOD),), commanded_m_s=0.03).action is Action.STOP:
            break
    assert supervisor.verdict.fault is Fault.ARM_FROZEN
    assert k * PERIOD <= 100 * MS


def test_pauses_between_do_not_hide_an_arm_that_says_the_same() -> None:
    supervisor = Supervisor(Limits(), 0)
    for k in range(1, 200):  # five periods of 0.3 mm, five of rest
        judged(supervisor, k * PERIOD, arms=(arm(k * PERIOD),), commanded_m_s=0.03 if k % 10 < 5 else 0.0)
        if supervisor.verdict.action is Action.STOP:
            break
    assert supervisor.verdict.fault is Fault.ARM_FROZEN
    assert k == 20  # the first period in which it has been sent on for 90 ms


def test_an_arm_that_rests_for_long_and_then_begins_late_is_not_frozen() -> None:
    supervisor = Supervisor(Limits(), 0)
    for k in range(1, 100):
        judged(supervisor, k * PERIOD)
    for k in range(100, 108):  # 80 ms: as long as an arm may take to begin
        judged(supervisor, k * PERIOD, arms=(arm(k * PERIOD),), commanded_m_s=0.05)
    judged(supervisor, 108 * PERIOD, arms=(arm(108 * PERIOD, 1e-4),), commanded_m_s=0.05)
    assert supervisor.verdict.action is Action.GO_ON


def test_the_arm() -> None:
    broken = ArmSample(PERIOD, np.full((4, 4), np.nan), (0.0,))
    assert judged(Supervisor(Limits(), 0), PERIOD, arms=(broken,)).fault is Fault.ARM_INVALID
    assert judged(Supervisor(Limits(), 0), PERIOD, arms=(arm(1, fifo=9),)).fault is Fault.ARM_FIFO
    fast = Supervisor(Limits(speed_m_s=0.1), 0)
    for k in range(1, 20):
        judged(fast, k * PERIOD, arms=(arm(k * PERIOD, 0.0015 * k),))
    assert fast.verdict.fault is Fault.ARM_SPEED


def turned(time_ns: int, angle_deg: float) -> ArmSample:
    """An arm whose end has turned about its y axis, in place."""
    return ArmSample(
        time_ns, transform(rotation_from_rpy(0.0, np.radians(angle_deg), 0.0), (0, 0, 0)), (0.1 * angle_deg,)
    )


@pytest.mark.parametrize(("rate_deg_s", "action"), [(35.0, Action.GO_ON), (45.0, Action.STOP)])
def test_an_arm_that_turns_too_fast(rate_deg_s: float, action: Action) -> None:
    """From the differences of its poses: what it reports as its velocity is not asked."""
    supervisor = Supervisor(Limits(turn_deg_s=40.0), 0)
    for k in range(1, 30):
        verdict = judged(supervisor, k * PERIOD, arms=(turned(k * PERIOD, 0.01 * k * rate_deg_s),))
        if verdict.action is not Action.GO_ON:
            break
    assert verdict.action is action
    assert verdict.fault is (Fault.ARM_TURN if action is Action.STOP else Fault.NONE)
    assert k * PERIOD <= 50 * MS or action is Action.GO_ON


@pytest.mark.parametrize(("angle_deg", "fault"), [(4.9, Fault.NONE), (-4.9, Fault.NONE), (5.1, Fault.TILT)])
def test_a_tool_that_stands_otherwise_than_commanded(angle_deg: float, fault: Fault) -> None:
    supervisor = Supervisor(Limits(tilt_deg=5.0), 0)
    commanded = rotation_from_rpy(0.0, np.radians(30.0), 0.0)
    verdict = judged(supervisor, PERIOD, arms=(turned(PERIOD, 30.0 + angle_deg),), commanded_rotation=commanded)
    assert verdict.fault is fault
    assert judged(Supervisor(Limits(), 0), PERIOD, arms=(turned(PERIOD, 90.0),)).fault is Fault.NONE


@pytest.mark.parametrize(
    ("left_deg", "rate_deg_s", "fault"),
    [
        (6.5, -10.0, Fault.NONE),  # slows down in time
        (5.2, -10.0, Fault.JOINT_LIMIT),
        (4.0, -10.0, Fault.JOINT_LIMIT),
        (4.0, 10.0, Fault.NONE),  # on its way back
        (4.0, 0.0, Fault.NONE),  # preflight does not let it move
    ],
)
def test_a_joint_on_its_way_to_its_limit(left_deg: float, rate_deg_s: float, fault: Fault) -> None:
    supervisor = Supervisor(Limits(joint_margin_deg=5.0), 0, chain=J2N6S300)
    for k in range(1, 6):
        joints_deg = J2N6S300.home_deg.copy()
        joints_deg[2] = J2N6S300.lower_deg[2] + left_deg + 0.01 * (k - 5) * rate_deg_s
        verdict = judged(supervisor, k * PERIOD, arms=(ArmSample(k * PERIOD, np.eye(4), tuple(joints_deg)),))
    assert verdict.fault is fault
    assert fault is Fault.NONE or "joint 3" in verdict.reason


def test_the_box_may_be_entered_and_not_left() -> None:
    limits = Limits(low_m=(-1.0, -1.0, -1.0), high_m=(0.1, 1.0, 1.0))
    leaving, entering = Supervisor(limits, 0), Supervisor(limits, 0)
    for k in range(1, 30):
        judged(leaving, k * PERIOD, arms=(arm(k * PERIOD, 0.09 + 0.0005 * k),))
        judged(entering, k * PERIOD, arms=(arm(k * PERIOD, 0.16 - 0.0005 * k),))
    assert leaving.verdict.fault is Fault.WORKSPACE
    assert entering.verdict.fault is Fault.NONE or entering.verdict.fault is Fault.WORKSPACE


def test_the_tip_is_what_has_to_stay_in_the_box() -> None:
    reaches = np.eye(4)
    reaches[0, 3] = 0.2
    supervisor = Supervisor(Limits(low_m=(-1.0, -1.0, -1.0), high_m=(0.1, 1.0, 1.0)), 0, reaches)
    assert judged(supervisor, PERIOD).fault is Fault.WORKSPACE


def test_limits_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputError, match="soft_force_n"):
        Limits(soft_force_n=20.0)
    with pytest.raises(InputError, match="tilt_deg"):
        Limits(tilt_deg=0.0)
