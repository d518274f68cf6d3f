"""Requests and records of RDT, over UDP port 49152, high byte first; and the sensor's page with its calibration.

Source: ATI's Net F/T manual 9610-05-1022, sections "UDP Interface Using RDT" and "System Status Code"; for the commands
of OnRobot's converter its published drivers."""

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from deformscope_drivers.framing import FrameDecoder, GoodFrame, Refused, Skipped

PORT = 49152
HEADER = 0x1234
REQUEST = struct.Struct("!HHI")
RECORD = struct.Struct("!III6i")
WRAP = 1 << 32
SATURATED, MONITOR = 1 << 17, 1 << 16
"""Bits of the status: transducer saturation or A/D error; a monitor condition that the user has set, no fault."""
NEWTONS = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kgf": 9.80665, "Kg": 9.80665}
NEWTON_METRES = {
    "N-m": 1.0,
    "Nm": 1.0,
    "N-mm": 1e-3,
    "Nmm": 1e-3,
    "kN-m": 1e3,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
    "kgf-cm": 0.0980665,
}


class Command(IntEnum):
    """STREAM: records one by one, until STOP (count 0) or for a number of them; BIAS: the present load is zero (at
    OnRobot with the count 255); FILTER, SPEED: OnRobot's alone, number of a filter and period [ms]"""

    STOP = 0x0000
    STREAM = 0x0002
    BIAS = 0x0042
    FILTER = 0x0081
    SPEED = 0x0082


FILTERS_HZ = (0.0, 500.0, 150.0, 50.0, 15.0, 5.0, 1.5)
"""Cut-off frequency of OnRobot's filters by number, 0 = none."""


def request(command: int, count: int = 0) -> bytes:
    """The 8 bytes of a request."""
    return REQUEST.pack(HEADER, command, count)


@dataclass(frozen=True, slots=True)
class Record:
    """rdt_sequence: counts the records that were sent; ft_sequence: counts the sensor's own samples; counts: Fx Fy Fz
    Tx Ty Tz"""

    rdt_sequence: int
    ft_sequence: int
    status: int
    counts: tuple[int, ...]

    def encode(self) -> bytes:
        """Its 36 bytes."""
        return RECORD.pack(self.rdt_sequence % WRAP, self.ft_sequence % WRAP, self.status, *self.counts)


@dataclass(frozen=True, slots=True)
class Calibration:
    """From the sensor's page. counts_per_n, counts_per_nm: counts of 1 N and of 1 N m; rate_hz: records a second, 0 =
    not known"""

    counts_per_n: float
    counts_per_nm: float
    rate_hz: float = 0.0
    serial: str = ""
    model: str = ""


class Decoder(FrameDecoder[Record | Calibration]):
    """One datagram, or the page, in each piece: a datagram of another length has no good record."""

    def feed(self, data: bytes) -> Iterator[Record | Calibration | Skipped]:
        if data.startswith(b"<"):
            page = read_page(data)
            return iter([Skipped(len(data), "page") if page is None else page])
        if len(data) % RECORD.size:
            return iter([Skipped(len(data), "length")])
        return iter(self._scan(data, ended=True)[0])

    def _find(self, buffer: bytes, start: int) -> int:
        return start

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[Record | Calibration] | Refused | None:
        first, samples, status, *counts = RECORD.unpack_from(buffer, start)
        return GoodFrame(Record(first, samples, status, tuple(counts)), RECORD.size)


def read_page(content: bytes) -> Calibration | None:
    """The calibration in `netftapi2.xml`; None where it has none, or in units that are not known."""
    text = content.decode("utf-8", "replace")

    def value(tag: str) -> str:
        found = re.search(rf"<{tag}>\s*([^<]*?)\s*</{tag}>", text)
        return found[1] if found else ""

    try:
        per_unit = float(value("cfgcpf")), float(value("cfgcpt"))
        units = NEWTONS[value("scfgfu")], NEWTON_METRES[value("scfgtu")]
        rate_hz = float(value("comrdtrate") or 0.0)
    except (ValueError, KeyError):
        return None
    if not all(math.isfinite(count) and count > 0 for count in per_unit):
        return None
    return Calibration(per_unit[0] / units[0], per_unit[1] / units[1], rate_hz, value("setserial"), value("prodname"))
