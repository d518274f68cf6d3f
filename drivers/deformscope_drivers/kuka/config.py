"""Settings of a KUKA: how its controller reaches this computer, and the arm's limits."""

from __future__ import annotations

import ipaddress
import math
from dataclasses import dataclass
from pathlib import Path

from deformscope_drivers.kuka.chains import CHAINS


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
