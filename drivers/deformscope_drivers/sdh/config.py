"""How the hand is connected and polled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.errors import OutOfLimits
from deformscope_drivers.transport import Transport, check_way, serial_or_can

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
