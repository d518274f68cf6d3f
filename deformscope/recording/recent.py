"""The newest seconds of a rig, held in memory, so that recent events can still be recorded.

Its recording is like any other. Such a recording begins with the devices' health, and counts their losses from then: it
has neither readings nor losses of an earlier time."""

import logging
import threading
from collections import deque
from collections.abc import Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Self

from deformscope.frames import HealthReport, Item, Stream, host_ns
from deformscope.log.layout import RecordingLayout, RigLayout
from deformscope.recording.lateness import RecordingError
from deformscope.recording.losses import since
from deformscope.recording.portions import item_size
from deformscope.recording.recorder import Recorder, RecordingSummary

_logger = logging.getLogger(__name__)

MOST_BYTES = 256 << 20
"""Default limits: pictures are stored as received, about 30 MB for each second and camera."""


@dataclass(slots=True)
class _Stretch:
    """From one health report of the devices to the next."""

    look: HealthReport
    batches: list[list[Item]] = field(default_factory=list)
    bytes: int = 0


class RecentItems:
    """seconds: stored time, from the devices' health before it; most_bytes: limit of the memory, which may shorten that
    time"""

    def __init__(self, seconds: float, most_bytes: int = MOST_BYTES) -> None:
        self.seconds = seconds
        self._most_bytes = most_bytes
        self._stretches: deque[_Stretch] = deque()
        self._newest_ns = 0

    def add(self, items: Sequence[Item]) -> None:
        """Add device items, in their order. Items before their first health are not stored."""
        batch: list[Item] = []
        for item in items:
            if isinstance(item, HealthReport):
                self._gather(batch)
                batch = []
                self._stretches.append(_Stretch(item))
            batch.append(item)
        self._gather(batch)
        self._newest_ns = max([self._newest_ns, *map(host_ns, items)])
        while len(self._stretches) > 1 and (
            self._newest_ns - self._stretches[1].look.host_ns >= self.seconds * 1e9
            or self.held_bytes > self._most_bytes
        ):
            self._stretches.popleft()

    def _gather(self, batch: list[Item]) -> None:
        if batch and self._stretches:
            self._stretches[-1].batches.append(batch)
            self._stretches[-1].bytes += sum(map(item_size, batch))

    @property
    def held_s(self) -> float:
        """How long the stretch is that is held [s]."""
        return (self._newest_ns - self._stretches[0].look.host_ns) / 1e9 if self._stretches else 0.0

    @property
    def held_bytes(self) -> int:
        """Memory of the stored items."""
        return sum(stretch.bytes for stretch in self._stretches)

    def taken(self) -> tuple[HealthReport, list[list[Item]]] | None:
        """The health report at the begin of the stored items, and all later items; None = nothing yet."""
        if not self._stretches:
            return None
        return self._stretches[0].look, [list(batch) for stretch in self._stretches for batch in stretch.batches]


class WatchedRecorder:
    """A session's recorder whose view continues after an error of its file; the error is raised at the end.

    watch: the view of the session; recording: records"""

    def __init__(self, watch: Recorder, recording: Recorder) -> None:
        self._watch, self._recording = watch, recording
        self._failure: RecordingError | None = None
        self._ending: threading.Thread | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self._recording)  # its name is taken before anything is opened
            self._watch.__enter__()
            stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        try:
            if self._ending is not None:
                self._ending.join()
            self._recording.__exit__(kind)  # nothing where it has ended
        finally:
            self._watch.__exit__(kind, *raised)
        if kind is None and self._failure is not None:
            raise self._failure

    def start(self, layout: RecordingLayout, start_ns: int, lossless: Collection[str] = ()) -> None:
        """See `Recorder.start`."""
        for one in (self._watch, self._recording):
            one.start(layout, start_ns, lossless)

    def write(self, items: object) -> None:
        """See `Recorder.write`."""
        self._watch.write(items)
        if self._failure is None:
            try:
                self._recording.write(items)
            except RecordingError as error:
                self._failure = error
                _logger.warning("the recording has ended, the view continues: %s", error)
                self._ending = threading.Thread(target=self._recording.__exit__, args=(type(error),))
                self._ending.start()

    def stopped_because(self, reason: str) -> None:
        """See `Recorder.stopped_because`."""
        for one in (self._watch, self._recording):
            one.stopped_because(reason)

    def summary(self) -> RecordingSummary:
        """Summary of the stored items, and of those that the view lacks."""
        return replace(self._recording.summary(), dropped=self._watch.summary().dropped)


class LastRecorder(WatchedRecorder):
    """A session's recorder that shows the whole session and records its last seconds.

    recording: recorder of the last seconds; it may wait, as all of them are written at once"""

    def __init__(self, watch: Recorder, recording: Recorder, recent: RecentItems) -> None:
        super().__init__(watch, recording)
        self._recent = recent
        self._streams: tuple[Stream, ...] = ()
        self._lossless: Collection[str] = ()

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        try:
            end_with_recent(self._recording, self._recent, self._streams, self._lossless, kind)
        finally:
            self._watch.__exit__(kind, *raised)

    def start(self, layout: RecordingLayout, start_ns: int, lossless: Collection[str] = ()) -> None:
        """See `Recorder.start`."""
        self._streams, self._lossless = layout.streams, lossless
        self._watch.start(layout, start_ns, lossless)

    def write(self, items: object) -> None:
        """See `Recorder.write`."""
        self._watch.write(items)
        if isinstance(items, Sequence):
            self._recent.add(items)

    def stopped_because(self, reason: str) -> None:
        """See `Recorder.stopped_because`."""
        self._watch.stopped_because(reason)
        self._recording.stopped_because(f"{reason}; of it the last {self._recent.held_s:.1f} s")


def write_recent(
    recorder: Recorder,
    taken: tuple[HealthReport, Sequence[Sequence[Item]]],
    streams: Sequence[Stream],
    lossless: Collection[str] = (),
) -> None:
    """Record the stored items. recorder: an open recorder that may wait, as all items are written at once"""
    before, batches = taken
    start_ns = min(host_ns(item) for batch in batches for item in batch)
    recorder.start(RigLayout(tuple(streams)), start_ns, lossless)
    for batch in batches:
        recorder.write([since(item, before) if isinstance(item, HealthReport) else item for item in batch])


def end_with_recent(
    recorder: Recorder,
    recent: RecentItems,
    streams: Sequence[Stream],
    lossless: Collection[str],
    kind: type[BaseException] | None,
) -> None:
    """Record the stored items at a session's end, and close the file. kind: type of the error that ended it, None =
    none did"""
    try:
        if (taken := recent.taken()) is not None:
            write_recent(recorder, taken, streams, lossless)
    except BaseException as error:
        recorder.__exit__(type(error))
        raise
    recorder.__exit__(kind)
