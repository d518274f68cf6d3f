"""Keys of a rig file, and the arms as chains of joints in the controller's frames: base, and flange (a TCP of zero)."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deformscope_drivers.arm.kinematics import Chain, FloatArray, Joint, transform
from deformscope_drivers.arm.kinematics import rotation_from_rpy as by_rpy
from deformscope_drivers.arm.urdf import xyz_rpy
from deformscope_drivers.transport import check_port

RTDE, DASHBOARD, SCRIPT = "rtde", "dashboard", "script"
PORTS = {RTDE: 30004, DASHBOARD: 29999, SCRIPT: 30002}
"""Ports of a controller; with another one for RTDE, the others are as far from it."""
ZEROS = (0.0,) * 6
HOME_DEG = (0.0, -90.0, -90.0, -90.0, 90.0, 0.0)
"""Upper arm upright, forearm level, flange down."""
ALPHA_RAD = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
ELBOW_DEG = 180.0
"""The elbow turns further, but the upper arm is in the way there: ur_description sets the same limit."""
LEAST_HZ = 100.0
"""Slowest reports at which what they show stops the arm within 20 ms."""

_LINES = (Path(__file__).parent / "arms.txt").read_text("utf-8").splitlines()
_ARMS = {line.split()[0]: tuple(map(float, line.split()[1:])) for line in _LINES if line[0] != "#"}
"""By model, the numbers of `arms.txt`."""


def ur_chain(model: str, *deltas: tuple[float, ...]) -> Chain:
    """The chain of a model. deltas: (4, 6) deviations of one arm's theta [rad], a, d [m] and alpha [rad], as calibrated

    A joint's own frame may be anywhere along its axis. The parallel second and third axes may have d of metres
    that cancel; here frames three and four are put next to the frame before them."""
    d_theta, d_a, d_d, d_alpha = deltas or (ZEROS,) * 4
    a2, a3, d1, d4, d5, d6, arm, elbow, wrist, *masses_kg = _ARMS[model]
    a, d = (0.0, a2, a3, 0.0, 0.0, 0.0), (d1, 0.0, 0.0, d4, d5, d6)
    speeds_deg_s, ranges_deg = (arm, arm, elbow, wrist, wrist, wrist), (360.0, 360.0, ELBOW_DEG, 360.0, 360.0, 360.0)
    steps: list[FloatArray] = [np.eye(4)]
    for joint in range(6):
        steps[joint] = steps[joint] @ transform(by_rpy(0.0, 0.0, d_theta[joint]), np.zeros(3))
        alpha = by_rpy(ALPHA_RAD[joint] + d_alpha[joint], 0.0, 0.0)
        steps.append(transform(alpha, (a[joint] + d_a[joint], 0.0, d[joint] + d_d[joint])))
    for joint in (2, 3):
        slide = transform(np.eye(3), (0.0, 0.0, -steps[joint][2, 3] / steps[joint][2, 2]))
        steps[joint], steps[joint + 1] = steps[joint] @ slide, np.linalg.inv(slide) @ steps[joint + 1]
    poses = list(map(xyz_rpy, steps))
    each = zip(poses[:6], ranges_deg, speeds_deg_s, masses_kg, strict=True)
    joints = tuple(Joint(xyz_m, rpy, -end, end, speed, 0.0, mass_kg) for (xyz_m, rpy), end, speed, mass_kg in each)
    return Chain(model, joints, poses[6][0], poses[6][1], HOME_DEG)


CHAINS = {model: ur_chain(model) for model in _ARMS}


@dataclass(frozen=True, slots=True)
class UrConfig:
    """Settings of an arm, needed before it is opened.

    port: RTDE of its controller; its other ports are as far from it as in `PORTS`
    model: the arm; state_hz: reports a second, a divisor of 500 (CB3: of 125), LEAST_HZ or more
    linear_limit_m_s, angular_limit_rad_s: greatest speed of the flange that a command may ask for
    joint_limit_deg_s: greatest speed of any joint; the controller's script stops at a greater one
    command_deadline_s: default duration of a velocity
    delta_theta, delta_a, delta_d, delta_alpha: (6,) the arm's own deviations from its model [rad, m], as in
    calibration.conf of its controller; check_pose: refuse a controller that reports the flange elsewhere
    own_process: a separate process drives it, so that it is served even while this one is busy

    Raises ValueError, NotConnected"""

    port: str = "socket://192.168.56.101:30004"
    model: str = "ur5e"
    state_hz: float = 125.0
    linear_limit_m_s: float = 0.05
    angular_limit_rad_s: float = 0.35
    joint_limit_deg_s: float = 20.0
    command_deadline_s: float = 0.1
    delta_theta: tuple[float, ...] = ZEROS
    delta_a: tuple[float, ...] = ZEROS
    delta_d: tuple[float, ...] = ZEROS
    delta_alpha: tuple[float, ...] = ZEROS
    check_pose: bool = True
    own_process: bool = True

    def __post_init__(self) -> None:
        check_port(self.port)
        hz, cycle_hz = self.state_hz, self.cycle_hz
        speeds = self.linear_limit_m_s, self.angular_limit_rad_s, self.joint_limit_deg_s
        for right, expected, came in (
            (self.port.startswith("socket://"), "port = socket://HOST:30004", self.port),
            (self.model in CHAINS, f"a model among {', '.join(CHAINS)}", self.model),
            (hz >= LEAST_HZ and not cycle_hz % hz, f"state_hz from {LEAST_HZ:g}, a divisor of {cycle_hz:g}", hz),
            (all(math.isfinite(speed) and speed > 0 for speed in speeds), "limits above 0", speeds),
            (0.02 <= self.command_deadline_s <= 5.0, "command_deadline_s from 0.02 to 5", self.command_deadline_s),
            (
                all(len(one) == 6 and all(map(math.isfinite, one)) for one in self.deltas),
                "6 finite deltas",
                self.deltas,
            ),
        ):
            if not right:
                raise ValueError(f"expected {expected}; got {came}")

    @property
    def cycle_hz(self) -> float:
        """The controller's own cycles."""
        return 500.0 if self.model.endswith("e") else 125.0

    @property
    def deltas(self) -> tuple[tuple[float, ...], ...]:
        """(4, 6) as `ur_chain` takes them."""
        return self.delta_theta, self.delta_a, self.delta_d, self.delta_alpha

    @property
    def chain(self) -> Chain:
        """The chain of this very arm."""
        return ur_chain(self.model, *self.deltas)
