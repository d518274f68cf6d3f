"""A double in memory, on a simulated clock: no port, no thread, and the same run every time."""

from deformscope_drivers.doubles import Double
from deformscope_drivers.errors import LinkLost, NotConnected
from deformscope_drivers.transport import Transport


class SimulatedClock:
    """A clock that advances by command: `clock()` is its present moment [ns]."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def __call__(self) -> int:
        return self._now_ns

    def advance_to(self, then_ns: int) -> None:
        """Go on to a moment; never back."""
        self._now_ns = max(self._now_ns, then_ns)


class MemoryTransport(Transport):
    """A transport to a double in this process: a read that waits moves the clock on."""

    def __init__(self, double: Double, clock: SimulatedClock, name: str = "memory") -> None:
        self.name = name
        self._double = double
        self._clock = clock
        self._plugged = True
        self._opened = False

    def open(self) -> None:
        if not self._plugged:
            raise NotConnected("a port that is there", "none", where=self.name)
        self._double.due(self._clock())
        self._opened = True

    def close(self) -> None:
        self._opened = False

    def read(self, timeout_s: float) -> bytes:
        self._require()
        until_ns = self._clock() + round(max(timeout_s, 0.0) * 1e9)
        while not (data := self._double.due(self._clock())):
            next_ns = self._double.next_ns(self._clock())
            if self._clock() >= until_ns or next_ns is None or next_ns > until_ns:
                self._clock.advance_to(until_ns)
                return self._double.due(self._clock())
            self._clock.advance_to(max(next_ns, self._clock() + 1))
        return data

    def write(self, data: bytes) -> None:
        self._require()
        self._double.receive(data, self._clock())

    def unplug(self) -> None:
        """Pull the cable out."""
        self._plugged = False

    def plug(self) -> None:
        """Put it back in: the double powers up."""
        self._plugged = True
        self._double.power_up(self._clock())

    def _require(self) -> None:
        if not self._opened:
            raise NotConnected("an open port", "one that is closed", where=self.name)
        if not self._plugged:
            raise LinkLost("bytes from the device", "the end of the port (unplugged?)", where=self.name)
