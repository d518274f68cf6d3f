"""A bad wire: what a double sends comes noisy, flipped, cut, twice, late or in pieces, under a seed."""

import random
from dataclasses import dataclass

from deformscope_drivers.doubles import Double


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong on a wire. Each is a chance for every piece that the double sends, 0 to 1.

    noise: random bytes before it; flip: one bit turned; cut: its last bytes missing; twice: sent twice
    stall, stall_s: nothing comes for that long, then all at once; split: it comes in two parts, 1 ms apart"""

    noise: float = 0.0
    flip: float = 0.0
    cut: float = 0.0
    twice: float = 0.0
    split: float = 0.0
    stall: float = 0.0
    stall_s: float = 0.2


class FaultyDouble:
    """A double on a bad wire; the same faults every time under the same seed.

    counts: how often each fault was done"""

    def __init__(self, double: Double, faults: Faults, seed: int = 0) -> None:
        self.double = double
        self.faults = faults
        self.counts: dict[str, int] = {}
        self._random = random.Random(seed)
        self._held: list[tuple[int, bytes]] = []

    def power_up(self, now_ns: int) -> None:
        self._held.clear()
        self.double.power_up(now_ns)

    def receive(self, data: bytes, now_ns: int) -> None:
        self.double.receive(data, now_ns)

    def next_ns(self, now_ns: int) -> int | None:
        moments = [
            moment for moment in (self.double.next_ns(now_ns), *(at for at, _ in self._held)) if moment is not None
        ]
        return min(moments, default=None)

    def due(self, now_ns: int) -> bytes:
        piece = self.double.due(now_ns)
        if piece:
            at = max(now_ns, max((held for held, _ in self._held), default=0))
            self._held += [(max(at, moment), data) for moment, data in self._spoil(piece, now_ns)]
        out = b"".join(data for moment, data in self._held if moment <= now_ns)
        self._held = [(moment, data) for moment, data in self._held if moment > now_ns]
        return out

    def _spoil(self, piece: bytes, now_ns: int) -> list[tuple[int, bytes]]:
        if self._happens("noise"):
            piece = self._random.randbytes(self._random.randint(1, 40)) + piece
        if self._happens("flip"):
            at, bit = self._random.randrange(len(piece)), self._random.randrange(8)
            piece = piece[:at] + bytes([piece[at] ^ 1 << bit]) + piece[at + 1 :]
        if self._happens("cut"):
            piece = piece[: self._random.randrange(len(piece))]
        if self._happens("twice"):
            piece = piece * 2
        if self._happens("stall"):
            return [(now_ns + round(self.faults.stall_s * 1e9), piece)]
        if len(piece) > 1 and self._happens("split"):
            at = self._random.randrange(1, len(piece))
            return [(now_ns, piece[:at]), (now_ns + 1_000_000, piece[at:])]
        return [(now_ns, piece)]

    def _happens(self, fault: str) -> bool:
        happens: bool = self._random.random() < getattr(self.faults, fault)
        if happens:
            self.counts[fault] = self.counts.get(fault, 0) + 1
        return happens
