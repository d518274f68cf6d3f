"""How many pairs of flipped bits the DSACON32m's checksum lets pass, and how many are left after the other checks.

    python -m tests.drivers.dsa.flips

prints the table of drivers/dsa.md. The checksum is affine: flipping bit i of a packet changes it by a pattern that
depends on i and on the packet's length alone, the bit's syndrome. A pair of flips passes exactly if both have the same
syndrome, so pairs are counted without trying them (a raw frame has 31 million), and only those that pass are given to
the decoder. Flips in the length field move the checksum itself, so all pairs with one of those are tried.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope_drivers.dsa.double import DsaDouble
from deformscope_drivers.dsa.measurer import TimestampGate, TimestampStatus
from deformscope_drivers.dsa.messages import FRAME_RLE, Ack, Command, Id, Reading, Reply
from deformscope_drivers.dsa.protocol import PREAMBLE, CommandDecoder, Decoder, Faulty, encode, stop
from deformscope_drivers.framing import Skipped, crc16

FRAME_PERIOD_MS = 86
"""Between raw frames at 115 200 baud."""

LEFT = "left"

_LENGTH_BITS = range(8 * 4, 8 * 6)

Bits = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class PairCount:
    """What becomes of all pairs of flipped bits behind a packet's preamble (with a flip in that, none is found).

    bytes: the packet's length; pairs: all there are; pass_checksum: pairs that the checksum lets pass if the length is
    left alone; refused: how many of these which other check refuses; left: how many of all pairs are taken for good"""

    name: str
    bytes: int
    pairs: int
    pass_checksum: int
    refused: Counter[str]
    left: int


@dataclass(frozen=True, slots=True)
class Subject:
    """A packet to flip bits of. cells: of the sensor it comes from; from_host: it is a command"""

    name: str
    packet: bytes
    cells: int | None = None
    from_host: bool = False

    def verdict(self, flips: Bits) -> str:
        """Why the packet with those bits flipped is refused, an intact one behind it; `LEFT` if it is not."""
        decoder = CommandDecoder() if self.from_host else Decoder(self.cells)
        stream = flipped(self.packet, flips) + self.packet
        events: Iterator[Command | Faulty | Reading | Reply | Skipped] = itertools.chain(
            decoder.feed(stream), decoder.finish()
        )
        first = next(events)
        if isinstance(first, Skipped):
            return first.reason
        if isinstance(first, Faulty):
            return "length"
        if isinstance(first, Reading) and self._time_jumps(first.timestamp_ms):
            return "timestamp"
        return LEFT

    def _time_jumps(self, timestamp_ms: int) -> bool:
        gate = TimestampGate()
        gate.check(int.from_bytes(self.packet[6:10], "little") - FRAME_PERIOD_MS)
        return gate.check(timestamp_ms) is not TimestampStatus.NEW


def syndromes(packet: bytes) -> npt.NDArray[np.uint16]:
    """(bits,) by how much each bit behind the preamble changes checksum ^ sent checksum; low bits of a byte first."""
    of_byte = [crc16(bytes([1 << bit]), 0) for bit in range(8)]
    from_the_end = []
    for _ in packet[len(PREAMBLE) : -2]:
        from_the_end.append(of_byte)
        of_byte = [crc16(b"\0", one) for one in of_byte]
    sent = [[1 << bit for bit in range(16)]]
    return np.array(list(itertools.chain(*reversed(from_the_end), *sent)), np.uint16)


def passing_pairs(packet: bytes) -> Iterator[Bits]:
    """Pairs of bits, counted from the packet's first byte on, that the checksum lets pass together."""
    found = syndromes(packet)
    order = np.argsort(found, kind="stable")
    for alike in np.split(order, np.flatnonzero(np.diff(found[order])) + 1):
        yield from itertools.combinations((alike + 8 * len(PREAMBLE)).tolist(), 2)


def flipped(packet: bytes, bits: Bits) -> bytes:
    """The packet with those bits changed."""
    out = bytearray(packet)
    for bit in bits:
        out[bit // 8] ^= 1 << bit % 8
    return bytes(out)


def count_pairs(subject: Subject) -> PairCount:
    """Every pair of flips of a packet, counted exactly."""
    behind = range(8 * len(PREAMBLE), 8 * len(subject.packet))
    passing = set(passing_pairs(subject.packet))
    reasons = Counter(map(subject.verdict, passing))
    moved = {(min(bit, other), max(bit, other)) for bit in _LENGTH_BITS for other in behind if bit != other} - passing
    left = reasons.pop(LEFT, 0) + sum(subject.verdict(pair) == LEFT for pair in moved)
    pairs = len(behind) * (len(behind) - 1) // 2
    return PairCount(subject.name, len(subject.packet), pairs, len(passing), reasons, left)


def typical() -> list[Subject]:
    """Packets as they come and go, frames from a double: idle, and held in a grasp."""
    double = DsaDouble(seed=1)
    cells = double.cells
    idle, grasp = (double.texels(at_s) for at_s in (0.0, 4.0))
    few = Reading(1000, FRAME_RLE, np.array([0] * 20 + [5, 5, 4095], np.uint16))
    return [
        Subject("stop", encode(stop()), from_host=True),
        Subject("ack", encode(Ack(Id.ACQUISITION))),
        Subject("frame of 23 texels, RLE", encode(few), few.texels.size),
        Subject("idle frame, RLE", encode(Reading(60_000, FRAME_RLE, idle)), cells),
        Subject("grasp, RLE", encode(Reading(60_000, FRAME_RLE, grasp)), cells),
        Subject("grasp, raw", encode(Reading(60_000, 0, grasp)), cells),
    ]


COLUMNS: dict[str, Callable[[PairCount], int]] = {
    "bytes": lambda count: count.bytes,
    "pairs of bits": lambda count: count.pairs,
    "pass the CRC": lambda count: count.pass_checksum,
    "refused by id, length": lambda count: sum(
        number for why, number in count.refused.items() if why != "timestamp" and not why.startswith("texel")
    ),
    "12-bit range": lambda count: count.refused["texel range"],
    "texel count": lambda count: count.refused["texel count"],
    "timestamp": lambda count: count.refused["timestamp"],
    "left": lambda count: count.left,
}


def main() -> None:
    """Print the table."""
    print("| packet | " + " | ".join(COLUMNS) + " |")
    print("| --- |" + " --: |" * len(COLUMNS))
    for subject in typical():
        count = count_pairs(subject)
        print(f"| {count.name} | " + " | ".join(str(column(count)) for column in COLUMNS.values()) + " |", flush=True)


if __name__ == "__main__":
    main()
