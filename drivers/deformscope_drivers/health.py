"""The health of a device: its readings, its losses with reasons, its rate and age."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from deformscope_drivers.clock import ClockRelation
from deformscope_drivers.continuity import Continuity
from deformscope_drivers.framing import NOISE, Skipped

RATE_WINDOW = 512
RATE_SPAN_NS = 5_000_000_000


class Link(StrEnum):
    """The state of a device's link."""

    CLOSED = "closed"
    CONNECTED = "connected"
    LOST = "lost"  # attempts to get it back go on
    FAILED = "failed"  # they do not


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """The link was made, lost, made again or given up. host_ns: when the host noticed [ns]; reason: in words."""

    host_ns: int
    link: Link
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Health:
    """The health of a device at one time.

    link: the state of the connection; reason: why it is so, in words; received: readings since it was opened
    lost: readings that should have come and never did: by the device's counter, or by time
    dropped: readings that came and that a reader was too slow to take, over all readers
    skipped_bytes: bytes that fit no frame; refused: frames refused, by reason (checksum, length...)
    resyncs: stretches of skipped bytes; reconnects: links made again
    rate_hz: readings a second lately, 0 where none; age_s: time since the last reading, None before the first
    stuck: the same reading came again and again, as from a sensor that has died behind a link that lives
    clock: relation of the device's clock to the host's, None without one; extra: what only this kind of device counts
    lost_by_time: how many of the lost ones are estimated from the device's rate and the time of a lost link or of
    silence, where its counter does not show them; silent_s: how long that was [s]
    jitter_s: standard deviation of the time from one reading to the next, lately, as the host stamps them [s]
    alarms: its readings', each as text that begins with `stuck` or `saturated`; set where they are checked"""

    link: Link
    reason: str = ""
    received: int = 0
    lost: int = 0
    dropped: int = 0
    skipped_bytes: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    resyncs: int = 0
    reconnects: int = 0
    rate_hz: float = 0.0
    age_s: float | None = None
    stuck: bool = False
    clock: ClockRelation | None = None
    extra: Mapping[str, float] = field(default_factory=dict)
    lost_by_time: int = 0
    silent_s: float = 0.0
    jitter_s: float = 0.0
    alarms: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity that a connected device reports; empty fields if it reports none."""

    model: str = ""
    serial: str = ""
    firmware: str = ""


class Rate:
    """Readings a second, over the last few seconds or the last few hundred readings."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=RATE_WINDOW)

    def add(self, host_ns: int) -> None:
        self._times.append(host_ns)

    def at(self, now_ns: int) -> float:
        """The present rate: it falls when readings stop."""
        while self._times and now_ns - self._times[0] > RATE_SPAN_NS:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        count, span = len(self._times) - 1, self._times[-1] - self._times[0]
        silence = now_ns - self._times[-1]
        if count and silence > 3 * span / count:
            span += silence
        return count / span * 1e9 if span > 0 else 0.0

    @property
    def jitter_s(self) -> float:
        """Standard deviation of the time from one reading to the next [s], 0 before the third."""
        return float(np.diff(self._times).std()) / 1e9 if len(self._times) > 2 else 0.0


class Tally:
    """Counts of a device while it is open; `Health` shows them."""

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0  # by the device's own counter
        self.continuity = Continuity()
        self.dropped = 0
        self.raw_dropped = 0
        self.skipped_bytes = 0
        self.joining_bytes = 0
        self.resyncs = 0
        self.reconnects = 0
        self.refused: dict[str, int] = {}
        self.rate = Rate()
        self._skipping = False
        self._joining = True

    def skip(self, skipped: Skipped) -> None:
        """Bytes that fit no frame; those that follow one another are one resync."""
        self.skipped_bytes += skipped.count
        self.joining_bytes += skipped.count if self._joining else 0
        self.resyncs += not self._skipping
        self._skipping = True
        if skipped.reason != NOISE:
            self.refuse(skipped.reason)

    def receive(self, host_ns: int) -> None:
        """Count a reading that arrived at host_ns [ns]."""
        self.received += 1
        self.rate.add(host_ns)
        self.continuity.add(host_ns)

    def follow_link(self, link: Link, host_ns: int) -> None:
        """The link is in this state from host_ns [ns] on."""
        match link:
            case Link.CONNECTED:
                self.continuity.begin(host_ns)
            case Link.CLOSED:
                self.continuity.end(host_ns)
            case _:
                self.continuity.lose_link(host_ns)
                self._joining = True

    def lose(self, count: int) -> None:
        """Readings that the device's counter says were sent and never came; below 0 takes some back."""
        self.lost += count
        self.continuity.count_lost(count)

    def refuse(self, reason: str) -> None:
        """Count a frame that was refused. reason: reason under which it is counted"""
        self.refused[reason] = self.refused.get(reason, 0) + 1

    def in_sync(self) -> None:
        """A good frame came: bytes that are skipped from now on begin a new loss of synchronization."""
        self._skipping = self._joining = False
