"""Robotiq FT 300 (`driver = "ft300"`): six axes in a serial stream at 100 Hz."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import ROUND_S, StreamDevice
from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.framing import FrameDecoder
from deformscope_drivers.health import Description, Identity
from deformscope_drivers.interface import DeviceDriver, FloatArray, Redecoder, Wrench
from deformscope_drivers.transport import Transport, check_port, serial_or_can
from deformscope_ft300.double import Ft300Double
from deformscope_ft300.protocol import BAUDRATE, PER_COUNT, RATE_HZ, START, STOP, Decoder, Packet

SILENCE_S = 1.0
REPLY_S = 2.0
STILL_READINGS, STILL_COUNTS = 50, 60.0
"""Readings of a zero, and the largest standard deviation of an axis [counts]."""


@dataclass(frozen=True, slots=True)
class Ft300Config:
    """A sensor at its adapter.

    port: serial port or address (`socket://host:port`); rate_hz: that of its stream, 100
    stuck_after_s: None = readings may stay the same for ever. Raises ValueError, NotConnected"""

    port: str = ""
    rate_hz: float = RATE_HZ
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        check_port(self.port)
        if self.rate_hz != RATE_HZ:
            raise ValueError(f"expected rate_hz = {RATE_HZ:g}; got {self.rate_hz:g}")


def measure(packet: Packet, host_ns: int, offset: FloatArray | None = None) -> Wrench:
    """The reading of a packet. offset: (6,) counts that are subtracted, None = none"""
    counts = np.array(packet.counts, float)
    load = (counts if offset is None else counts - offset) * PER_COUNT
    return Wrench(Stamp(host_ns), (packet.counts,), load[None, :3], load[None, 3:])


class Ft300(StreamDevice[Wrench]):
    """`with Ft300(Ft300Config(port="/dev/ttyUSB0")) as sensor:`

    transport, clock: used instead of the configuration's port and the host's clock (in a simulated laboratory)"""

    def __init__(self, config: Ft300Config, *, transport: Transport | None = None, clock: Clock = monotonic_ns) -> None:
        self.config = config
        self._offset: FloatArray | None = None
        super().__init__(
            transport or serial_or_can(config.port, "", baudrate=BAUDRATE),
            silence_s=SILENCE_S,
            stuck_after_s=config.stuck_after_s,
            clock=clock,
        )

    def identity(self) -> Identity:
        return Identity("Robotiq FT 300")

    def describe(self) -> Description:
        return Description(self.config.rate_hz, torques=True)

    def zero(self) -> None:
        """Take the present load for zero, here. Raises SettingsRefused where the readings vary."""
        self._do(self._zero, 30.0)

    def _make_decoder(self) -> Decoder:
        return Decoder()

    def _start(self) -> None:
        self._send(STOP)
        self._transport.drain(ROUND_S, ROUND_S)
        self._expect(RATE_HZ)
        self._send(START)
        self._next(1)

    def _stop(self) -> None:
        self._send(STOP)

    def _measure(self, event: Any, host_ns: int) -> Iterable[Wrench]:
        return [measure(event, host_ns, self._offset)] if isinstance(event, Packet) else []

    def _fingerprint(self, reading: Wrench) -> tuple[tuple[int, ...], ...]:
        return reading.counts

    # Within: all in the device's thread ------------------------------------------------------------------------------

    def _next(self, count: int) -> list[Wrench]:
        return self._gather(count, REPLY_S + 2.0 * count / RATE_HZ, "check 24 V supply, cable and port")

    def _zero(self) -> None:
        counts = np.array([one.counts[0] for one in self._next(STILL_READINGS)], float)
        varies = float(counts.std(axis=0).max())
        if varies > STILL_COUNTS:
            advice = "keep what touches the sensor at rest"
            raise SettingsRefused(f"readings within {STILL_COUNTS:g} counts", f"{varies:.3g}", advice, self.name)
        self._offset = counts.mean(axis=0)


class Ft300Again(Redecoder):
    """Decodes the stream of a sensor."""

    left_out = "forces, from which the driver may have subtracted a zero"
    compares = ("counts",)

    def begin(self) -> FrameDecoder[Any]:
        return Decoder()

    def measure(self, event: Any, host_ns: int) -> Any:
        return measure(event, host_ns) if isinstance(event, Packet) else None


DRIVER = DeviceDriver(
    "wrench", Ft300Config, Ft300, double=lambda config, scene: Ft300Double(scene), redecoder=Ft300Again
)
