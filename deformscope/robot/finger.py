"""A finger presses the tip before a motion, if only the force at the tip guards the arm."""

import math
from collections.abc import Callable

import numpy as np

from deformscope.robot.checks import Check
from deformscope.robot.robot import Robot
from deformscope.robot.supervisor import Fault
from deformscope_drivers.arm.kinematics import FloatArray

PRESS_N, THIRD = 8.0, 1.5
"""Requested force of a person's press [N], and the factor by which it may be less or more, because a person with a
kitchen scale is within a third. The least is above a touch's set force, so that a sensor which saturates below it is
refused, and the most is below the hard stop. A wider band accepts a scale that is wrong by two, a narrower one refuses
correct presses."""
ASTRAY_DEG = 30.0
"""Greatest angle between the person's push and straight up. Exchanged or reversed axes appear at 90 or 180 deg, and no
person presses exactly upright. A smaller limit refuses correct presses."""
BEGUN_N = 0.3
"""Force [N] from which a push has begun: six deviations of the noisiest sensor that passes (`preflight.NOISE_N`)."""
HELD_PERIODS = 40
"""Control periods for which a push is held, 0.4 s: the median of the second half counts, once the finger has come to
its force. A knock would satisfy a shorter time; people release before the end of a longer one."""
PATIENCE_S, PUSHES = 60.0, 3
"""Time for a person's press [s], and number of pushes, before the check fails. More only wait for longer."""
FINGER = (
    "Press the tip straight up from below with a finger, with about {0:g} N ({1:.0f} g on a kitchen scale), and hold "
    "it for a second. This arm has no joint torques: its force sensor is its only guard."
)
WAITS = f"waits for a finger that presses the tip from below, with {PRESS_N:g} N"


def press_by_finger(
    robot: Robot,
    press: Callable[[FloatArray], None] | None = None,
    say: Callable[[str], None] = lambda words: None,
    *,
    set_n: float = 0.0,
) -> Check:
    """Whether the force sensor measures the requested push from below, in size and direction; nothing moves.

    press: in a laboratory, a finger that presses with (3,) [N, surface frame]; None = a person, whom `say` instructs
    set_n: greatest set force of the touches that follow, which the push must exceed [N]
    The soft stop that the push meets is acknowledged at the end. Raises RobotStopped above the hard stop, and where
    readings are equal under the push, as those of a sensor that saturates."""
    patience_s = PATIENCE_S if press is None else 4e-2 * HELD_PERIODS
    say, press = (say, lambda force_n: None) if press is None else (lambda words: None, press)
    robot.start()
    press_n = min(PRESS_N, robot.supervisor.limits.hard_force_n / (1.2 * THIRD))
    say(FINGER.format(press_n, 100.0 * press_n))
    rest_n = np.mean([_tip_force_n(robot) for _ in range(HELD_PERIODS)], axis=0)
    least_n, most_n = max(press_n / THIRD, set_n), THIRD * press_n
    begun_n = max(BEGUN_N, robot.placement.tool.contact_n)
    right, came, held, pushes = False, "nothing", list[FloatArray](), 0
    try:
        press(np.array([0.0, 0.0, press_n]))
        for _ in range(round(100 * patience_s)):
            force_n = _tip_force_n(robot) - rest_n
            held = [*held, force_n] if np.linalg.norm(force_n) > begun_n else []
            if not held and (right or pushes == PUSHES):  # the finger is gone
                break
            if len(held) == HELD_PERIODS:
                right, came = _judged(np.median(held[HELD_PERIODS // 2 :], axis=0), least_n, most_n)
                pushes += 1
                say(f"Measured {came}: release{'' if right or pushes == PUSHES else ', and press once more'}.")
                press(np.zeros(3))
    finally:
        press(np.zeros(3))
        if robot.supervisor.verdict.fault is not Fault.ASKED:  # a person's Stop holds
            robot.supervisor.acknowledge(robot.seen.now_ns)
    wanted = f"a finger's {least_n:.1f} to {most_n:.1f} N from below"
    return Check("force sensor: finger", right, wanted, came)


def _tip_force_n(robot: Robot) -> FloatArray:
    """(3,) mean force on the tip in the next control period with readings, surface frame [N]."""
    while not (samples := robot.cycle().forces):  # a slow sensor; for a silent one the supervisor stops the robot
        continue
    return np.asarray(np.mean([robot.force_on_tip_n(sample) for sample in samples], axis=0))


def _judged(force_n: FloatArray, least_n: float, most_n: float) -> tuple[bool, str]:
    """Whether a push (3,) [N, surface frame] has the requested size and direction, and both as text."""
    size_n = float(np.linalg.norm(force_n))
    astray_deg = math.degrees(math.acos(np.clip(force_n[2] / size_n, -1.0, 1.0)))
    right = least_n <= size_n <= most_n and astray_deg <= ASTRAY_DEG
    return right, f"{size_n:.1f} N, {astray_deg:.0f} deg from straight up"
