"""Settings of a KUKA, its six-axis arms as chains of joints, and the files that set its controller up.

Lengths, ranges and speeds are facts of the published description (ros-industrial kuka_experimental, kuka_kr6_support,
BSD-3). Angles are those of the controller: at (0, -90, 90, 0, 90, 0) upper arm upright, forearm level, flange down."""

import ipaddress
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deformscope_drivers.arm.kinematics import Chain, Joint

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
_PI = float(np.pi)


def kuka_chain(
    name: str,
    lengths_m: tuple[float, float, float, float, float, float],
    ranges_deg: tuple[tuple[float, float], ...],
    speeds_deg_s: tuple[float, ...],
) -> Chain:
    """lengths_m: height of the second axis, its distance from the first, upper arm, offset and length of the forearm,
    flange from the wrist [m]; ranges_deg, speeds_deg_s: ranges and speeds of each axis

    The description's axes are -z, y, y, -x, y, -x of frames parallel at angle 0; here each is its frame's z."""
    high, out, upper, offset, forearm, flange = lengths_m
    frames = (
        ((0.0, 0.0, high), (_PI, 0.0, 0.0)),
        ((out, 0.0, 0.0), (_PI / 2, 0.0, 0.0)),
        ((upper, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, -offset, 0.0), (_PI / 2, 0.0, -_PI / 2)),
        ((0.0, 0.0, -forearm), (-_PI / 2, _PI / 2, 0.0)),
        ((flange, 0.0, 0.0), (_PI / 2, 0.0, -_PI / 2)),
    )
    joints = tuple(
        Joint(xyz_m, rpy_rad, low_deg, high_deg, speed_deg_s, 0.0, 0.0)
        for (xyz_m, rpy_rad), (low_deg, high_deg), speed_deg_s in zip(frames, ranges_deg, speeds_deg_s, strict=True)
    )
    return Chain(name, joints, (0.0, 0.0, 0.0), (_PI, 0.0, _PI), HOME_DEG)


_AGILUS_DEG = ((-170.0, 170.0), (-190.0, 45.0), (-120.0, 156.0), (-185.0, 185.0), (-120.0, 120.0), (-350.0, 350.0))
_AGILUS_DEG_S = (360.0, 300.0, 360.0, 381.0, 388.0, 615.0)

KR6R700 = kuka_chain("kr6r700sixx", (0.4, 0.025, 0.315, 0.035, 0.365, 0.08), _AGILUS_DEG, _AGILUS_DEG_S)
KR6R900 = kuka_chain("kr6r900sixx", (0.4, 0.025, 0.455, 0.035, 0.42, 0.08), _AGILUS_DEG, _AGILUS_DEG_S)
CHAINS = {chain.name: chain for chain in (KR6R700, KR6R900)}


@dataclass(frozen=True, slots=True)
class KukaConfig:
    """Settings of an arm, needed before it is opened.

    address, port: address and port of this computer, where the controller sends to (IP_NUMBER and PORT of RSI's
    ethernet configuration); controller: the only address that is answered, empty = whoever speaks first
    model: the arm; sen_type: SENTYPE of the configuration; cycle_s: cycle of RSI: 0.012 (#IPO) or 0.004 (#IPO_FAST)
    linear_limit_m_s, angular_limit_rad_s: greatest speed of the flange that a command may ask for
    joint_limit_deg_s: greatest speed of any axis that a command may ask for
    command_deadline_s: default duration of a velocity
    wait_s: how long opening waits for the controller's program to be started
    check_pose: refuse a controller that reports the flange elsewhere than the model has it
    own_process: a separate process answers the controller, so that it answers even while this one is busy"""

    address: str = "0.0.0.0"
    port: int = 59152
    controller: str = ""
    model: str = "kr6r900sixx"
    sen_type: str = "ImFree"
    cycle_s: float = 0.012
    linear_limit_m_s: float = 0.05
    angular_limit_rad_s: float = 0.35
    joint_limit_deg_s: float = 20.0
    command_deadline_s: float = 0.1
    wait_s: float = 30.0
    check_pose: bool = True
    own_process: bool = True

    def __post_init__(self) -> None:
        for address in (self.address, self.controller):
            if address:
                ipaddress.IPv4Address(address)
        if not 0 <= self.port <= 65535:
            raise ValueError(f"expected a port from 0 to 65535; came {self.port!r}")
        if self.model not in CHAINS:
            raise ValueError(f"expected a model among {', '.join(sorted(CHAINS))}; came {self.model!r}")
        if not (self.sen_type.isascii() and self.sen_type.isalnum() and len(self.sen_type) <= 32):
            raise ValueError(f"expected sen_type of letters and digits; came {self.sen_type!r}")
        if self.cycle_s not in (0.004, 0.012):
            raise ValueError(f"expected cycle_s 0.004 or 0.012; came {self.cycle_s!r}")
        for name in ("linear_limit_m_s", "angular_limit_rad_s", "joint_limit_deg_s", "wait_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"expected {name} above 0; came {value!r}")
        if not 0.02 <= self.command_deadline_s <= 5.0:
            raise ValueError(f"expected command_deadline_s from 0.02 to 5; came {self.command_deadline_s!r}")

    @property
    def state_hz(self) -> float:
        """The controller reports in each of its cycles."""
        return 1.0 / self.cycle_s


FOLDER = Path(__file__).parent / "controller_files"
"""The shipped files belong to KukaConfig(address="192.168.1.25")."""
TIMEOUT_S = 0.06
"""Time of missing answers after which RSI ends; opening leaves two out. Chosen."""


def controller_files(config: KukaConfig) -> dict[str, str]:
    """Name and text of each file: with the configuration's address (the shipped one if it is 0.0.0.0), port and
    sen_type, and its cycle. joint_limit_deg_s gives the limit of a cycle's correction, TIMEOUT_S of missing answers."""
    address = "192.168.1.25" if config.address == "0.0.0.0" else config.address
    limit = f'{config.joint_limit_deg_s * config.cycle_s:.4g}"'
    timeout = f'="{round(TIMEOUT_S / config.cycle_s)}"'
    changes = (
        ("<IP_NUMBER>192.168.1.25<", f"<IP_NUMBER>{address}<"),
        ("<PORT>59152<", f"<PORT>{config.port}<"),
        ("<SENTYPE>ImFree<", f"<SENTYPE>{config.sen_type}<"),
        ("#IPO)", "#IPO)" if config.cycle_s == 0.012 else "#IPO_FAST)"),
        ('0.24"', limit),
        ('"Timeout" ParamID="1" ParamValue="5"', f'"Timeout" ParamID="1" ParamValue{timeout}'),
        ('"Timeout" value="5"', f'"Timeout" value{timeout}'),
    )
    texts = {path.name: path.read_text("utf-8") for path in sorted(FOLDER.iterdir())}
    for shipped, wanted in changes:
        texts = {name: text.replace(shipped, wanted) for name, text in texts.items()}
    return texts
