"""A device as small as one can be, to try what all devices share: a counter that counts, and a command that sets it."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass

from deformscope_drivers.clock import ClockFit, Stamp, Unwrap
from deformscope_drivers.device import StreamDevice
from deformscope_drivers.doubles import Line
from deformscope_drivers.framing import FrameDecoder, GoodFrame, Refused, find_start

PERIOD_NS = 2_000_000


@dataclass(frozen=True, slots=True)
class Count:
    """A reading: `#`, the count in two bytes, their sum."""

    count: int


@dataclass(frozen=True, slots=True)
class Set:
    """A reply: `!` and the new count."""

    count: int


@dataclass(frozen=True, slots=True)
class ToyReading:
    stamp: Stamp
    count: int


def frame(kind: bytes, count: int) -> bytes:
    body = (count & 0xFFFF).to_bytes(2, "big")
    return kind + body + bytes([sum(body) & 0xFF])


class ToyDecoder(FrameDecoder[Count | Set]):
    def _find(self, buffer: bytes, start: int) -> int:
        return min(find_start(buffer, start, b"#"), find_start(buffer, start, b"!"))

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[Count | Set] | Refused | None:
        if len(buffer) < start + 4:
            return None
        body = buffer[start + 1 : start + 3]
        if sum(body) & 0xFF != buffer[start + 3]:
            return Refused("checksum")
        kind = Count if buffer[start : start + 1] == b"#" else Set
        return GoodFrame(kind(int.from_bytes(body, "big")), 4)


class ToyDouble:
    """Sends a count every 2 ms; `=` and two bytes set it."""

    def __init__(self) -> None:
        self.count = 0
        self.silent = False
        self.deaf = False
        self.stuck = False
        self._line = Line()
        self._heard = b""
        self._next_ns = 0

    def power_up(self, now_ns: int) -> None:
        self.count = 0
        self._heard = b""
        self._line.clear()
        self._next_ns = now_ns + PERIOD_NS

    def receive(self, data: bytes, now_ns: int) -> None:
        self._heard += data
        while len(self._heard) >= 3:
            if self._heard[:1] != b"=":
                self._heard = self._heard[1:]
                continue
            self.count = int.from_bytes(self._heard[1:3], "big")
            self._heard = self._heard[3:]
            if not self.deaf:
                self._line.send(frame(b"!", self.count), now_ns)

    def due(self, now_ns: int) -> bytes:
        while self._next_ns <= now_ns:
            if not self.silent:
                self._line.send(frame(b"#", self.count), self._next_ns)
            if not self.stuck:
                self.count += 1
            self._next_ns += PERIOD_NS
        return self._line.due(now_ns)

    def next_ns(self, now_ns: int) -> int | None:
        return min(self._next_ns, self._line.next_ns() or self._next_ns)


class Toy(StreamDevice[ToyReading]):
    def __init__(self, transport, **options) -> None:
        super().__init__(transport, **options)
        self._expected: int | None = None
        self.started = 0

    def _make_decoder(self) -> ToyDecoder:
        return ToyDecoder()

    def _start(self) -> None:
        self.started += 1
        self._expected = None
        self._unwrap = Unwrap(1 << 16, PERIOD_NS)
        self._clock_fit = ClockFit(PERIOD_NS)

    def _measure(self, event: Count | Set, host_ns: int) -> Iterable[ToyReading]:
        if isinstance(event, Set):
            self._expected = None
            return []
        if self._expected is not None and event.count != self._expected:
            self._count_lost((event.count - self._expected) % 65536)
        self._expected = (event.count + 1) % 65536
        self._clock_fit.add(self._unwrap(event.count, host_ns), host_ns)
        return [ToyReading(Stamp(host_ns, event.count), event.count)]

    def _fingerprint(self, reading: ToyReading) -> Hashable:
        return reading.count

    def set(self, count: int, timeout_s: float = 1.0) -> int:
        def accept(event: Count | Set) -> int | None:
            return event.count if isinstance(event, Set) else None

        command = b"=" + count.to_bytes(2, "big")
        return self._do(lambda: self._ask(command, accept, timeout_s, tries=2, what="the new count"), 5.0)
