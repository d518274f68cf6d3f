"""How a Jaco is connected, and its limits."""

import ipaddress
import math
from dataclasses import dataclass, field
from pathlib import Path

from deformscope_drivers.jaco.chains import CHAINS
from deformscope_drivers.jaco.library import PREFIXES, Connection, library_file
from deformscope_drivers.jaco.structures import ZONES_MAX


@dataclass(frozen=True, slots=True)
class EthernetAddresses:
    """Addresses for an arm on Ethernet; the defaults are those of the vendor's driver, except this computer's address.

    local_ip: this computer's address on the arm's network"""

    local_ip: str = "192.168.100.100"
    subnet_mask: str = "255.255.255.0"
    robot_ip: str = "192.168.100.11"
    local_command_port: int = 25000
    local_broadcast_port: int = 25025
    robot_port: int = 55000
    receive_timeout_s: float = 1.0

    def __post_init__(self) -> None:
        for address in (self.local_ip, self.subnet_mask, self.robot_ip):
            ipaddress.IPv4Address(address)


@dataclass(frozen=True, slots=True)
class Workspace:
    """A box in the base frame that the end effector must not leave by a command.

    low_m, high_m: (x, y, z) its lower and upper corner [m]; base frame: z up, origin at the middle of the base"""

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        corners = (*self.low_m, *self.high_m)
        if not all(map(math.isfinite, corners)) or not all(
            low < high for low, high in zip(self.low_m, self.high_m, strict=True)
        ):
            raise ValueError(f"expected a box with low below high on each axis; came {self.low_m} and {self.high_m}")

    def contains(self, position_m: tuple[float, float, float]) -> bool:
        """Whether a position (x, y, z) [m] is within the box."""
        return all(low <= value <= high for low, value, high in zip(self.low_m, position_m, self.high_m, strict=True))


@dataclass(frozen=True, slots=True)
class JacoConfig:
    """Settings of an arm, needed before it is opened.

    library: the vendor's library, or its folder; None = the system's loader finds it
    connection: "usb", or "ethernet" with `ethernet` addresses
    serial: serial of the arm that is meant; None = the only one there is
    model: "j2n6s300", "j2s6s300" or "j2s7s300"; None = the model that the arm reports
    linear_limit_m_s, angular_limit_rad_s: greatest speed of the end effector that a command may ask for
    joint_limit_deg_s: greatest speed of any joint that a command may ask for; a joint's own limit holds besides
    workspace: box that commands must keep the end effector in; None = no box
    protection_zones: boxes in the base frame that the arm's firmware excludes for the hand: set when it is opened, in
    place of its stored ones (`zones`); None = unchanged; command_deadline_s: default duration of a velocity command,
    and largest delay of the driver's own cycle before it stops the arm
    state_hz: rate of reading the joint angles; lower if the arm's link is too slow
    initialize_fingers: let the fingers open fully when the arm is opened (they move), so that their positions are known
    require_home: move it only if it says that it was homed since it was switched on (`Jaco.home`, or its joystick)
    open_attempts: how often an arm that is not found (1015) is sought before opening fails
    own_process: a child process moves a rig's arm, and loads the vendor's library. That process erases trajectories and
    halts the arm when this program ends, and a velocity expires there when this program is stopped"""

    library: str | None = None
    connection: Connection = "usb"
    ethernet: EthernetAddresses = field(default_factory=EthernetAddresses)
    serial: str | None = None
    model: str | None = None
    linear_limit_m_s: float = 0.05
    angular_limit_rad_s: float = 0.35
    joint_limit_deg_s: float = 20.0
    workspace: Workspace | None = None
    protection_zones: tuple[Workspace, ...] | None = None
    command_deadline_s: float = 0.1
    state_hz: float = 50.0
    initialize_fingers: bool = False
    require_home: bool = True
    open_attempts: int = 3
    own_process: bool = True

    def __post_init__(self) -> None:
        if self.connection not in PREFIXES:
            raise ValueError(f"expected a connection among {', '.join(PREFIXES)}; came {self.connection!r}")
        if self.model is not None and self.model not in CHAINS:
            raise ValueError(f"expected a model among {', '.join(sorted(CHAINS))}; came {self.model!r}")
        for name in ("linear_limit_m_s", "angular_limit_rad_s", "joint_limit_deg_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"expected {name} above 0; came {value!r}")
        if len(self.protection_zones or ()) > ZONES_MAX:
            raise ValueError(f"expected {ZONES_MAX} protection_zones at most; came {len(self.protection_zones or ())}")
        if not 0.02 <= self.command_deadline_s <= 5.0:
            raise ValueError(f"expected command_deadline_s from 0.02 to 5; came {self.command_deadline_s!r}")
        if not 0 < self.state_hz <= 100:
            raise ValueError(f"expected state_hz above 0 and up to 100; came {self.state_hz!r}")
        if self.open_attempts < 1:
            raise ValueError(f"expected open_attempts from 1; came {self.open_attempts!r}")

    def library_file(self) -> Path | None:
        """The file that `library` names; None = what the system's loader finds."""
        return library_file(self.library, self.connection) if self.library else None
