"""Parts that every device has: opening and closing, three ways to read, automatic reconnection, and a report of its
health.

One thread owns the link, from opening to closing: only this thread reads and writes. Calls from other threads are
handed to it (`_do`). So no lock guards a port, no reading is split, and a pulled cable is noticed in one place."""

import contextlib
import dataclasses
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar, cast

from deformscope_drivers.clock import Clock, ClockFit, Stamp, monotonic_ns
from deformscope_drivers.errors import DeviceError, LinkLost, NoReply, NotConnected, Stale
from deformscope_drivers.framing import FrameDecoder, Skipped
from deformscope_drivers.health import Description, Health, Identity, Link, LinkEvent, Tally
from deformscope_drivers.pacing import READING, be_prompt
from deformscope_drivers.subscription import Subscription
from deformscope_drivers.transport import Transport

ROUND_S = 0.05
CLOSE_TIMEOUT_S = 5.0
QUEUE_READINGS = 8192
QUEUE_CHUNKS = 65536
QUEUE_EVENTS = 1024
RAW_DROPPED = "raw_dropped"
"""In `Health.extra`: pieces of raw bytes that a reader was too slow to take."""
JOINING_BYTES = "joining_bytes"
"""In `Health.extra`: skipped bytes that came before the first good frame of a link, as from a device that was sending
already: no reading is lost with them."""


class Measurement(Protocol):
    """Common fields of a device's readings."""

    @property
    def stamp(self) -> Stamp: ...


MeasurementT = TypeVar("MeasurementT", bound=Measurement)
ResultT = TypeVar("ResultT")
ItemT = TypeVar("ItemT")


@dataclass(frozen=True, slots=True)
class Reconnect:
    """How a lost link is opened again: after first_s, then after twice the time before, up to longest_s."""

    first_s: float = 0.05
    longest_s: float = 2.0


RECONNECT = Reconnect()


class EndOfReadings(Exception):
    """Raised by a `_receive` at the end of its data (a file): readers end. Its words are the reason in `health()`."""


@dataclass(frozen=True, slots=True)
class RawChunk:
    """Bytes as they went over the wire. host_ns: when [ns]; sent: the host sent them to the device"""

    host_ns: int
    data: bytes
    sent: bool = False


class Device(ABC, Generic[MeasurementT]):
    """`with SomeDevice(config) as device:` and then one of the three reads.

    - `for reading in device:` every reading, through a bounded queue; `device.readings()` counts what was dropped
    - `device.next(timeout_s)` the next reading that arrives
    - `device.latest(max_age_s)` the newest reading, refused when it is older than that

    name: name in messages; reconnect: None = a lost link ends the session; stuck_after_s: readings that stay exactly
    the same for this long mean a stuck sensor, None = they may; clock: the host's, or a simulated laboratory's
    late_ns: set before opening, the device's calibrated delay [ns]: the stamps in all queues are earlier by it;
    delay_ns: the part of it that its own filter has. A subclass gives `_connect`, `_receive` and `_disconnect`, all run
    by the device's own thread. A device with large readings sets `queue_readings` too, the default queue length of a
    slow reader; a device in a robot's control loop sets `prompt`."""

    queue_readings: ClassVar[int] = QUEUE_READINGS
    prompt: ClassVar[bool] = False

    def __init__(
        self,
        name: str,
        *,
        reconnect: Reconnect | None = RECONNECT,
        stuck_after_s: float | None = None,
        clock: Clock = monotonic_ns,
    ) -> None:
        self.name = name
        self._reconnect = reconnect
        self._stuck_after_ns = None if stuck_after_s is None else round(stuck_after_s * 1e9)
        self._clock = clock
        self.late_ns = self.delay_ns = 0
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._own_thread = True
        self._closing = threading.Event()
        self._jobs: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._readings: list[Subscription[MeasurementT]] = []
        self._chunks: list[Subscription[RawChunk]] = []
        self._events: list[Subscription[LinkEvent]] = []
        self._link = Link.CLOSED
        self._reason = ""
        self._failure: BaseException | None = None
        self._tally = Tally()
        self._clock_fit: ClockFit | None = None
        self._last: MeasurementT | None = None
        self._asked = False
        self._same: Hashable = None
        self._same_since_ns = 0

    # What a kind of device fills in ----------------------------------------------------------------------------------

    @abstractmethod
    def _connect(self) -> None:
        """Open the link and bring the device into the state that its configuration says. Raises DeviceError."""

    @abstractmethod
    def _receive(self, timeout_s: float) -> Iterable[MeasurementT]:
        """Wait up to `timeout_s` for readings and return them. Raises LinkLost, or EndOfReadings."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Close the link, in whatever state it is; a device that moves is stopped first if it can be."""

    def _fingerprint(self, reading: MeasurementT) -> Hashable:
        """What is the same in two readings of a sensor that is stuck; None = unknown."""
        return None

    def _wake(self) -> None:
        """End a `_receive` that waits, where that is possible."""

    def _extra_health(self) -> dict[str, float]:
        """Counters of this kind of device, by name, which `health()` reports in `extra`."""
        return {}

    # Lifecycle -------------------------------------------------------------------------------------------------------

    def open(self, *, own_thread: bool = True) -> Self:
        """Connect. Raises NotConnected, or another error that prevents the configured operation. own_thread: False = no
        thread; `poll` does one round (a simulated laboratory on its own clock)"""
        if self.is_open:
            raise DeviceError("a device that is closed", "one that is open", "close() first", self.name)
        self._failure, self._last, self._same, self._asked = None, None, None, False
        self._tally = Tally()
        self._closing.clear()
        self._own_thread = own_thread
        if not own_thread:
            self._thread = threading.current_thread()
            try:
                self._connect()
            except BaseException:
                self._thread = None
                self._disconnect_quietly()
                raise
            self._report_link(Link.CONNECTED)
            return self
        opened: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(opened,), name=f"device {self.name}", daemon=True)
        self._thread.start()
        try:
            opened.result()
        except BaseException:
            self._closing.set()
            self._wake()
            self._thread.join(CLOSE_TIMEOUT_S)
            self._thread = None
            raise
        return self

    def close(self) -> None:
        """Stop reading and close the link. All readers then end. Closing twice is nothing."""
        thread = self._thread
        if thread is None:
            return
        with self._changed:
            self._tally.continuity.end(self._clock())
        self._closing.set()
        if not self._own_thread:
            self._end(None)
        else:
            self._wake()
            with self._changed:
                self._changed.notify_all()
            thread.join(CLOSE_TIMEOUT_S)
            if thread.is_alive():
                raise DeviceError("a device that closes", f"one that hangs for {CLOSE_TIMEOUT_S:g} s", where=self.name)
        self._thread = None

    def __enter__(self) -> Self:
        return self if self.is_open else self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether it is between open() and close(), even while the link is lost."""
        return self._thread is not None

    @property
    def link(self) -> Link:
        """Whether the link is connected, lost or closed."""
        return self._link

    # The three reads -------------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[MeasurementT]:
        """Every reading from now on, until the device is closed."""
        self._require_open()
        return iter(self.readings())

    def readings(self, capacity: int | None = None) -> Subscription[MeasurementT]:
        """A queue of every reading from now, or the next opening, on. capacity: readings that wait for a slow reader"""
        return self._subscribe(self._readings, self.queue_readings if capacity is None else capacity)

    def next(self, timeout_s: float) -> MeasurementT:
        """The next reading that arrives after this call. Raises Stale when none does in time."""
        self._require_open()
        asked_ns = self._clock()
        until_ns = asked_ns + round(timeout_s * 1e9)
        seen = self._tally.received

        def come() -> bool:
            # What arrived before the call may be published after it: an image takes milliseconds to decode.
            return self._last is not None and self._tally.received != seen and self._last.stamp.host_ns >= asked_ns

        if not self._own_thread:
            while not come() and (left_ns := until_ns - self._clock()) > 0:
                self.poll(left_ns / 1e9)
        else:
            until = time.monotonic() + timeout_s
            with self._changed:
                self._asked = True
                while (
                    not (come() or self._failure or self._closing.is_set()) and (left := until - time.monotonic()) > 0
                ):
                    self._changed.wait(left)
                self._asked = False
        if not come() or self._last is None:
            self._require_open()
            raise Stale(f"a reading within {timeout_s:g} s", self._silence(), where=self.name)
        return self._last

    def latest(self, max_age_s: float) -> MeasurementT:
        """The newest reading, at once. Raises Stale when it is older than that, or when the sensor is stuck."""
        self._require_open()
        last = self._last
        if last is None or self._clock() - last.stamp.host_ns > max_age_s * 1e9:
            raise Stale(f"a reading of the last {max_age_s:g} s", self._silence(), where=self.name)
        if self._stuck():
            same_s = (self._clock() - self._same_since_ns) / 1e9
            raise Stale("readings that change", f"the same reading for {same_s:.3g} s", "check the sensor", self.name)
        return last

    def poll(self, timeout_s: float = 0.0) -> list[MeasurementT]:
        """Run one round of a device that was opened without a thread, and return the readings that came."""
        if self._own_thread or self._thread is None:
            raise NotConnected("a device opened with own_thread=False", "another", where=self.name)
        self._require_open()
        try:
            found = list(self._receive(timeout_s))
        except LinkLost as error:
            self._report_link(Link.LOST, str(error))
            raise
        except EndOfReadings as end:
            self._end(None, str(end))
            return []
        for reading in found:
            self._publish(reading)
        return found

    # More to look at -------------------------------------------------------------------------------------------------

    def raw(self, capacity: int = QUEUE_CHUNKS) -> Subscription[RawChunk]:
        """A queue of all bytes from now on, in both directions, as recorded; empty for a device without bytes."""
        return self._subscribe(self._chunks, capacity)

    def events(self, capacity: int = QUEUE_EVENTS) -> Subscription[LinkEvent]:
        """A queue of the link's events from now on: the places of gaps in the readings."""
        return self._subscribe(self._events, capacity)

    def health(self) -> Health:
        """The device's health, as of now."""
        now_ns = self._clock()
        last = self._last
        with self._changed:
            missing = self._tally.continuity.at(now_ns)
            counts = {RAW_DROPPED: self._tally.raw_dropped, JOINING_BYTES: self._tally.joining_bytes}
            return Health(
                link=self._link,
                reason=self._reason,
                received=self._tally.received,
                lost=self._tally.lost + missing.count,
                lost_by_time=missing.count,
                silent_s=missing.silent_s,
                dropped=self._tally.dropped,
                skipped_bytes=self._tally.skipped_bytes,
                refused=dict(self._tally.refused),
                resyncs=self._tally.resyncs,
                reconnects=self._tally.reconnects,
                rate_hz=self._tally.rate.at(now_ns),
                jitter_s=self._tally.rate.jitter_s,
                age_s=None if last is None else (now_ns - last.stamp.host_ns) / 1e9,
                stuck=self._stuck(),
                clock=None if self._clock_fit is None else self._clock_fit.relation(),
                extra=self._extra_health() | {name: count for name, count in counts.items() if count},
            )

    @property
    def damaged(self) -> int:
        """Number of damaged frames since it was opened, without the cost of `health`: for every control period."""
        return max(self._tally.resyncs, sum(self._tally.refused.values()))

    def identity(self) -> Identity:
        """Model, serial number and firmware, as far as the device reported them while connecting; touches nothing."""
        return Identity()

    def serial_number(self) -> str:
        """The serial number, which some devices report on request alone. Raises NoReply without an answer."""
        return self.identity().serial

    def describe(self) -> Description:
        """What its readings are like, once it is open; touches nothing."""
        return Description()

    def remarks(self) -> tuple[str, ...]:
        """Remarks for a user on the connected device, though it works; each as text."""
        return ()

    # For subclasses --------------------------------------------------------------------------------------------------

    def _do(self, action: Callable[[], ResultT], timeout_s: float) -> ResultT:
        """Have the device's thread call a function between two rounds, and return its result."""
        self._require_open()
        if threading.current_thread() is self._thread:
            return action()
        if not self._own_thread:
            raise DeviceError("a call from the thread that opened the device", "another thread", where=self.name)
        future: Future[ResultT] = Future()
        with self._changed:
            if self._link is not Link.CONNECTED:
                raise LinkLost("a device that is connected", self._reason or self._link, where=self.name)
            self._jobs.append((action, future))
        self._wake()
        try:
            return future.result(timeout_s)
        except FutureTimeout as error:
            if future.done():  # the action itself ran out of time
                raise
            future.cancel()
            raise NoReply(f"the command done within {timeout_s:g} s", "nothing", where=self.name) from error

    def _publish(self, reading: MeasurementT) -> None:
        """Hand one reading to all readers."""
        fingerprint = self._fingerprint(reading) if self._stuck_after_ns is not None else None
        with self._changed:
            self._tally.receive(reading.stamp.host_ns)
            if fingerprint is None or fingerprint != self._same:
                self._same, self._same_since_ns = fingerprint, reading.stamp.host_ns
            self._last, self._asked = reading, False  # ages, and what comes next, go by arrival
            if self.late_ns:
                stamp = reading.stamp.put_back(self.late_ns)
                reading = cast("MeasurementT", dataclasses.replace(cast("Any", reading), stamp=stamp))
            for queue in self._readings:
                self._tally.dropped += queue.put(reading)
            self._changed.notify_all()

    def _wanted(self) -> bool:
        """Whether a caller waits and no reader would lose a reading, for a device that can wait for its readers."""
        with self._changed:
            if not self._own_thread:
                return True
            return all(len(queue) < queue.capacity for queue in self._readings) and (
                bool(self._readings) or self._asked
            )

    def _expect(self, rate_hz: float | None) -> None:
        """Expected readings from now on, so that silence is counted. rate_hz: as the device was set, 0 = unknown (as
        for a device that never reports it); None = none without request"""
        with self._changed:
            self._tally.continuity.expect(self._clock(), rate_hz)

    def _count_lost(self, count: int) -> None:
        """Readings that the device sent and that never came, by its own counter."""
        with self._changed:
            self._tally.lose(count)

    def _count_skipped(self, skipped: Skipped) -> None:
        """Count bytes that the decoder skipped since they fit no frame."""
        with self._changed:
            self._tally.skip(skipped)

    def _count_refused(self, reason: str) -> None:
        """Count a whole frame that was refused for its content. reason: by which `health()` reports the count"""
        with self._changed:
            self._tally.refuse(reason)

    def _record_raw(self, data: bytes, host_ns: int, *, sent: bool = False) -> None:
        with self._changed:
            for queue in self._chunks:
                self._tally.raw_dropped += queue.put(RawChunk(host_ns, data, sent))

    # Within ----------------------------------------------------------------------------------------------------------

    def _subscribe(self, queues: list[Subscription[ItemT]], capacity: int) -> Subscription[ItemT]:
        if self.is_open:
            self._require_open()

        def leave(queue: Subscription[ItemT]) -> None:
            with self._changed:
                if queue in queues:
                    queues.remove(queue)

        queue: Subscription[ItemT] = Subscription(capacity, leave)
        with self._changed:
            queues.append(queue)
        return queue

    def _run(self, opened: Future[None]) -> None:
        """The device's thread: connect, read, seek a lost link, until it is closed."""
        if self.prompt:
            be_prompt(READING)
        failure: BaseException | None = None
        reason = ""
        try:
            self._connect()
            self._report_link(Link.CONNECTED)
            opened.set_result(None)
            while not self._closing.is_set():
                try:
                    self._rounds()
                except LinkLost as error:
                    self._report_link(Link.LOST, str(error))
                    self._disconnect_quietly()
                    self._refuse_jobs(error)
                    if self._clock_fit is not None:
                        self._clock_fit.reset()
                    if self._reconnect is None:
                        raise
                    self._seek(self._reconnect)
        except EndOfReadings as end:
            reason = str(end)
        except BaseException as error:
            failure = error
            if not opened.done():
                opened.set_exception(error)
        finally:
            self._end(failure, reason)

    def _rounds(self) -> None:
        while not self._closing.is_set():
            while self._jobs:
                action, future = self._jobs.popleft()
                if not future.set_running_or_notify_cancel():
                    continue
                try:
                    future.set_result(action())
                except LinkLost as error:
                    future.set_exception(error)
                    raise
                except BaseException as error:
                    future.set_exception(error)
            for reading in self._receive(ROUND_S):
                self._publish(reading)

    def _seek(self, plan: Reconnect) -> None:
        """Try until the link is there again, or the device is closed."""
        wait_s = plan.first_s
        while not self._closing.wait(wait_s):
            try:
                self._connect()
            except DeviceError as error:
                self._disconnect_quietly()
                with self._changed:
                    self._reason = str(error)
                wait_s = min(2 * wait_s, plan.longest_s)
                continue
            with self._changed:
                self._tally.reconnects += 1
            self._report_link(Link.CONNECTED)
            return

    def _end(self, failure: BaseException | None, reason: str = "") -> None:
        self._closing.set()
        try:
            self._disconnect_quietly()
        except Exception as error:  # whatever happens, readers that wait come to their end
            failure = failure or error
        if failure is None:
            self._report_link(Link.CLOSED, reason or (self._reason if self._link is Link.LOST else ""))
        else:
            self._report_link(Link.FAILED, str(failure) or type(failure).__name__)
        self._refuse_jobs(NotConnected("a device that is open", "one that was closed", where=self.name))
        with self._changed:
            self._failure = failure
            queues: list[Subscription[Any]] = [*self._readings, *self._chunks, *self._events]
            self._readings.clear()
            self._chunks.clear()
            self._events.clear()
            self._changed.notify_all()
        for queue in queues:
            queue.end(failure)

    def _report_link(self, link: Link, reason: str = "") -> None:
        event = LinkEvent(self._clock(), link, reason)
        with self._changed:
            self._tally.follow_link(link, event.host_ns)
            self._link, self._reason = link, reason
            for queue in self._events:
                queue.put(event)
            self._changed.notify_all()

    def _refuse_jobs(self, error: DeviceError) -> None:
        while self._jobs:
            _, future = self._jobs.popleft()
            if future.set_running_or_notify_cancel():
                future.set_exception(error)

    def _disconnect_quietly(self) -> None:
        with contextlib.suppress(DeviceError, OSError):
            self._disconnect()

    def _require_open(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._thread is None or self._closing.is_set():
            came = f"one that is closed ({self._reason})" if self._reason else "one that is closed"
            raise NotConnected("a device that is open", came, "open() it", self.name)

    def _stuck(self) -> bool:
        if self._stuck_after_ns is None or self._same is None or self._last is None:
            return False
        return self._last.stamp.host_ns - self._same_since_ns >= self._stuck_after_ns

    def _silence(self) -> str:
        link = f"the link is {self._link}" + (f": {self._reason}" if self._reason else "")
        if self._last is None:
            return f"none since it was opened ({link})"
        return f"none for {(self._clock() - self._last.stamp.host_ns) / 1e9:.3g} s ({link})"


class StreamDevice(Device[MeasurementT]):
    """A device that speaks in bytes over a transport.

    A subclass gives `_start` (its first commands), `_make_decoder`, and `_measure` (an event of the decoder that is no
    measurement gives none). `_ask` sends a command and waits for its reply.
    silence_s: a device that sent nothing for this long is lost (a bus does not show it); None = it may"""

    prompt = True

    def __init__(
        self,
        transport: Transport,
        *,
        silence_s: float | None = None,
        reconnect: Reconnect | None = RECONNECT,
        stuck_after_s: float | None = None,
        clock: Clock = monotonic_ns,
    ) -> None:
        super().__init__(transport.name, reconnect=reconnect, stuck_after_s=stuck_after_s, clock=clock)
        self._transport = transport
        self._silence_ns = None if silence_s is None else round(silence_s * 1e9)
        self._heard_ns = 0
        self._decoder: FrameDecoder[Any] = self._make_decoder()

    @abstractmethod
    def _make_decoder(self) -> FrameDecoder[Any]:
        """A fresh decoder, for a fresh link."""

    @abstractmethod
    def _start(self) -> None:
        """Bring the opened device into the state that its configuration says; `_ask`, `_send` and `_transport` work."""

    @abstractmethod
    def _measure(self, event: Any, host_ns: int) -> Iterable[MeasurementT]:
        """The readings in one event of the decoder (most often one, or none for a reply)."""

    def _stop(self) -> None:
        """Send the device's last commands before the link is closed; errors are ignored."""

    def _connect(self) -> None:
        self._transport.open()
        self._decoder = self._make_decoder()
        self._start()
        self._heard_ns = self._clock()

    def _disconnect(self) -> None:
        try:
            if self._link is Link.CONNECTED:
                self._stop()
        finally:
            self._transport.close()

    def _wake(self) -> None:
        self._transport.wake()

    def _receive(self, timeout_s: float) -> Iterable[MeasurementT]:
        heard = [reading for event, host_ns in self._listen(timeout_s) for reading in self._measure(event, host_ns)]
        if self._silence_ns is not None and self._clock() - self._heard_ns > self._silence_ns:
            raise LinkLost("bytes from the device", f"none for {self._silence_ns / 1e9:g} s", where=self.name)
        return heard

    def _listen(self, timeout_s: float) -> Iterable[tuple[Any, int]]:
        """One read: the decoder's good events, each with its time of arrival [ns]; bad bytes are counted."""
        try:
            data = self._transport.read(timeout_s)
        except LinkLost:
            for cut in self._decoder.finish():
                if isinstance(cut, Skipped):
                    self._count_skipped(cut)
            raise
        if not data:
            return []
        self._heard_ns = host_ns = self._clock()
        self._record_raw(data, host_ns)
        events = []
        for event in self._decoder.feed(data):
            if isinstance(event, Skipped):
                self._count_skipped(event)
            else:
                self._tally.in_sync()
                events.append((event, host_ns))
        return events

    def _gather(self, count: int, wait_s: float, advice: str) -> list[MeasurementT]:
        """The next readings, a given number, which are published as well. Raises NoReply if they take longer."""
        found: list[MeasurementT] = []
        until_ns = self._clock() + round(wait_s * 1e9)
        while len(found) < count and not self._closing.is_set() and self._clock() < until_ns:
            for event, host_ns in self._listen(ROUND_S):
                for reading in self._measure(event, host_ns):
                    found.append(reading)
                    self._publish(reading)
        if len(found) < count:
            raise NoReply(f"{count} readings within {wait_s:.3g} s", str(len(found)), advice, self.name)
        return found

    def _send(self, data: bytes) -> None:
        """Send bytes, in the device's thread."""
        self._transport.write(data)
        self._record_raw(data, self._clock(), sent=True)

    def _ask(
        self,
        data: bytes,
        accept: Callable[[Any], ResultT | None],
        timeout_s: float,
        *,
        tries: int = 1,
        what: str = "a reply",
    ) -> ResultT:
        """Send a command and wait for the event that `accept` makes something of; readings are published meanwhile.

        Runs in the device's thread: a public method wraps it into `_do`. Raises NoReply after the last try."""
        for _ in range(tries):
            self._send(data)
            until_ns = self._clock() + round(timeout_s * 1e9)
            while (left_ns := until_ns - self._clock()) > 0:
                found: ResultT | None = None
                for event, host_ns in self._listen(min(left_ns / 1e9, ROUND_S)):
                    if found is None and (found := accept(event)) is not None:
                        continue
                    for reading in self._measure(event, host_ns):
                        self._publish(reading)
                if found is not None:
                    return found
                if self._closing.is_set():
                    break
        waited = f"{tries} x {timeout_s:g} s" if tries > 1 else f"{timeout_s:g} s"
        raise NoReply(f"{what} within {waited}", "none", "check power, cable and baud rate", self.name)
