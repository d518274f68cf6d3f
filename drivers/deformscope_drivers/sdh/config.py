"""How the hand is connected and polled, and the limits of its commands, checked before anything is sent."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.errors import OutOfLimits
from deformscope_drivers.sdh import codes
from deformscope_drivers.transport import Transport, check_way, serial_or_can

ByAxis = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of the seven axes. Velocities and accelerations are the hand's own where its firmware reports them.

    position_min_deg, position_max_deg, velocity_max_deg_s, acceleration_max_deg_s2, current_max_a: (7,) by axis"""

    position_min_deg: ByAxis = codes.POSITION_MIN_DEG
    position_max_deg: ByAxis = codes.POSITION_MAX_DEG
    velocity_max_deg_s: ByAxis = codes.VELOCITY_MAX_DEG_S
    acceleration_max_deg_s2: ByAxis = codes.ACCELERATION_MAX_DEG_S2
    current_max_a: ByAxis = (codes.CURRENT_MAX_A,) * codes.AXIS_COUNT

    def positions(self, values_deg: Sequence[float], where: object = "") -> ByAxis:
        """Target angles, (7,). Raises OutOfLimits."""
        return _checked("angle", "deg", values_deg, self.position_min_deg, self.position_max_deg, where)

    def speeds(self, values_deg_s: Sequence[float] | float, where: object = "") -> ByAxis:
        """Speeds of a pose move, above 0; one for all or (7,). Raises OutOfLimits."""
        values = _for_all(values_deg_s)
        return _positive("speed", "deg/s", values, self.velocity_max_deg_s, where)

    def velocities(self, values_deg_s: Sequence[float], where: object = "") -> ByAxis:
        """Velocities with sign, (7,). Raises OutOfLimits."""
        lows = tuple(-value for value in self.velocity_max_deg_s)
        return _checked("velocity", "deg/s", values_deg_s, lows, self.velocity_max_deg_s, where)

    def accelerations(self, values_deg_s2: Sequence[float] | float, where: object = "") -> ByAxis:
        """Accelerations, above 0; one for all or (7,). Raises OutOfLimits."""
        values = _for_all(values_deg_s2)
        return _positive("acceleration", "deg/s2", values, self.acceleration_max_deg_s2, where)

    def currents(self, values_a: Sequence[float] | float, where: object = "") -> ByAxis:
        """Limits of motor currents; one for all or (7,). Raises OutOfLimits."""
        return _checked("motor current", "A", _for_all(values_a), (0.0,) * codes.AXIS_COUNT, self.current_max_a, where)


def within(name: str, unit: str, value: float, low: float, high: float, where: object = "") -> float:
    """Check a number of a command that is not for an axis. Raises OutOfLimits."""
    if not low <= value <= high:  # not so for NaN either
        raise OutOfLimits(f"{name} of {low:g} to {high:g}{unit and ' ' + unit}", f"{value:g}", where=where)
    return float(value)


def _for_all(values: Sequence[float] | float) -> Sequence[float]:
    return (float(values),) * codes.AXIS_COUNT if isinstance(values, int | float) else values


def _positive(name: str, unit: str, values: Sequence[float], highs: ByAxis, where: object) -> ByAxis:
    checked = _checked(name, unit, values, (0.0,) * codes.AXIS_COUNT, highs, where)
    for axis, value in enumerate(checked):
        if value == 0.0:
            raise OutOfLimits(f"{name} of axis {axis} above 0 {unit}", "0", where=where)
    return checked


def _checked(name: str, unit: str, values: Sequence[float], lows: ByAxis, highs: ByAxis, where: object) -> ByAxis:
    if len(values) != codes.AXIS_COUNT:
        raise OutOfLimits(f"{codes.AXIS_COUNT} values, one per axis, for {name}", f"{len(values)}", where=where)
    for axis, (value, low, high) in enumerate(zip(values, lows, highs, strict=True)):
        if not math.isfinite(value) or not low <= value <= high:
            raise OutOfLimits(f"{name} of axis {axis} within {low:g} to {high:g} {unit}", f"{value:g}", where=where)
    return tuple(float(value) for value in values)


BAUDRATE = 115_200
CAN_BITRATE = 1_000_000
CAN_HOST_ID = 42  # the host writes
CAN_HAND_ID = 43  # the hand replies


@dataclass(frozen=True, slots=True)
class SdhConfig:
    """port: serial port or URL (`/dev/ttyUSB0`; over TCP `socket://192.168.1.1:23`, firmware 0.0.3.1 and later); or
    bus: CAN bus (`socketcan:can0`); exactly one of them

    send_id, receive_id: CAN identifiers of the host and of the hand
    protocol: `auto` uses binary if firmware (0.0.2.15) and command support it, else ASCII
    checksum: checksum of binary messages; None = on serial ports, not on CAN and `socket://`
    rate_hz: rate of requests for positions, velocities and states (RS-232 has room for about 90 Hz)
    temperature_period_s: period of requests for temperatures
    reply_timeout_s: time limit of one attempt of a command; there are three attempts
    leave_powered: close() leaves axes on that this session switched on (Schunk's library switches them off as well)"""

    port: str = ""
    bus: str = ""
    send_id: int = CAN_HOST_ID
    receive_id: int = CAN_HAND_ID
    bitrate: int = CAN_BITRATE
    baudrate: int = BAUDRATE
    protocol: Literal["auto", "ascii", "binary"] = "auto"
    checksum: bool | None = None
    rate_hz: float = 25.0
    temperature_period_s: float = 2.0
    reply_timeout_s: float = 0.2
    leave_powered: bool = False
    reconnect: Reconnect | None = RECONNECT

    def __post_init__(self) -> None:
        check_way(self.port, self.bus)
        if not 0.0 < self.rate_hz <= 1000.0:
            raise OutOfLimits("rate_hz above 0, up to 1000", f"{self.rate_hz:g}")
        if self.protocol not in ("auto", "ascii", "binary"):
            raise OutOfLimits("protocol auto, ascii or binary", repr(self.protocol))
        if not self.reply_timeout_s > 0.0 or not self.temperature_period_s > 0.0:
            raise OutOfLimits("times above 0", f"{self.reply_timeout_s:g} s, {self.temperature_period_s:g} s")

    def checksummed(self) -> bool:
        """Whether binary messages carry a checksum."""
        if self.checksum is not None:
            return self.checksum
        return not self.bus and not self.port.startswith("socket://")

    def transport(self) -> Transport:
        """The transport to the hand, not opened. Raises NotConnected unless there is exactly one of port and bus."""
        return serial_or_can(
            self.port,
            self.bus,
            baudrate=self.baudrate,
            receive_id=self.receive_id,
            send_id=self.send_id,
            bitrate=self.bitrate,
        )
