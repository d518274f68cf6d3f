"""The file of a recording in progress: it is flushed several times a second, and readable however the process ends.

A recording goes to two files. `NAME.part.rrd` has all data after each flush, in many small portions and without a
footer. With one, rerun keeps some kilobytes of memory for each portion until the file is closed (1 MB for each second
of a rig's recording), and a viewer reads a file of many portions slowly. `NAME.part.rrd.merged` gets the same rows in a
hundredth of the portions, with a footer: it becomes the recording at the end. It is optional: if it fails, or the disk
is short, it is left out, and the recording is the first file."""

import json
import logging
import os
import shutil
import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, cast

from deformscope.errors import printable
from deformscope.file_io import utf8_path
from deformscope.recording import lateness
from deformscope.recording.lateness import OTHER_DISK, DiskForecast, RecordingError, check_room, writes_are_held_up
from deformscope.recording.ledger import LedgerWriter, ledger_path

if TYPE_CHECKING:
    import rerun as rr
    from rerun.chunk import Chunk

    from deformscope.log.rig import Batch

BEAT_S = 0.15
BEAT_FRAMES = 32
BEAT_BYTES = 16 << 20
"""Most bytes between two flushes, so that a check of the disk's space misses few pending writes."""
FULL_BYTES = 1 << 20
"""Free space below which a file cannot be completed."""
BEATS_MERGED = 200
"""Number of checks between two flushes of the merged file: each flush ends the portions that rerun gathers."""
FLUSH_TIMEOUT_S = 20.0
CLOSE_TIMEOUT_S = 60.0
NEVER = 10**9

_logger = logging.getLogger(__name__)


def merged_path(part: Path) -> Path:
    """Path of the file with the large portions, next to the other."""
    return part.with_name(part.name + ".merged")


class RecordingFile:
    """The file of a recording; one thread at a time writes to it.

    part: an empty file for the recording; properties: properties of the whole; name: name of the recording in a viewer
    deterministic: content and portions depend only on the recorded items Raises RecordingError once the disk has too
    little room, with enough left to end the file, or takes no more; `broken` then, and only `close` is left."""

    def __init__(
        self,
        application: str,
        recording_id: str,
        part: Path,
        properties: Mapping[str, object],
        *,
        name: str = "",
        deterministic: bool = False,
    ) -> None:
        from deformscope.log.merged import Merged

        self.path = part
        self.broken = False
        self._deterministic = deterministic
        self._stream = _stream(application, recording_id, part, deterministic, footer=False)
        self._merged_path = merged_path(part)
        self._merged_stream: rr.RecordingStream | None = _stream(
            application, recording_id, self._merged_path, deterministic, footer=True
        )
        self._merged: Merged = Merged()
        self._ledger = LedgerWriter(ledger_path(part), part)
        self._forecast = DiskForecast()
        self._given: dict[str, tuple[float, float]] = {}
        self._beat_at = 0.0
        self._looks = self._beats = self._unflushed = 0
        self.write_properties("session", properties)
        if name:
            self._log(lambda rec: rec.send_recording_name(printable(name)))
        self._flush_merged(self._merged_stream)  # first in the file: without its properties the rest cannot be read
        try:
            self.flush()
        except RecordingError:
            self._merged_path.unlink(missing_ok=True)
            self._ledger.close()
            ledger_path(part).unlink(missing_ok=True)
            raise

    def log(self, job: "Callable[[rr.RecordingStream], None]") -> None:
        """Call a method of the stream, sometimes after a check of the disk."""
        self.beat()
        self._log(job)

    def send(self, batch: "Batch") -> None:
        """Send encoded data, with a check of the disk."""
        from rerun.chunk import Chunk

        self.beat()
        batch.send(self._stream)
        for _, part in batch.parts:
            if isinstance(part, Chunk):
                self._unflushed += self._note(part)
                if self._merged_stream is not None:
                    self._merged_stream.send_chunks(list(self._merged.add(part)))
            elif self._merged_stream is not None:
                part(self._merged_stream)

    def write_properties(self, name: str, values: Mapping[str, object]) -> None:
        """Write named values as properties of the whole recording."""
        import rerun as rr

        self._log(lambda rec: rec.send_property(name, rr.AnyValues(True, **values)))

    def beat(self) -> None:
        """Check from time to time whether the disk is full or gone: rerun would continue without an error."""
        if self.broken:
            raise RecordingError("a recording that continues", "one that has failed", where=self.path)
        if self._deterministic:  # by count, since every flush ends a portion of the file
            self._looks += 1
            due = self._looks % BEAT_FRAMES == 0
        else:
            due = time.monotonic() - self._beat_at > BEAT_S or self._unflushed > BEAT_BYTES
        if due:
            self.flush()

    def flush(self) -> None:
        """Write the data to the disk, if it has enough space."""
        if not self._deterministic:
            free = shutil.disk_usage(self.path.parent).free
            if said := self._forecast.look(free, time.monotonic()):
                _logger.warning("%s: the recording, and a robot with it, is stopped before that", said)
        try:
            check_room(self.path, self._forecast.reserve)
        except RecordingError as error:
            if self._merged_stream is None or self._merged_path.stat().st_size < lateness.FREE_BYTES:
                self.broken = shutil.disk_usage(self.path.parent).free < FULL_BYTES
                raise
            self._do_without_merged(self._merged_stream, str(error))  # and more room for the other
        self.flush_last()

    def flush_last(self) -> None:
        """Write the last data to the disk: the reserved space is for this."""
        try:
            self._stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
            self._commit()
        except Exception as error:
            self.broken = True
            check_room(self.path)
            raise RecordingError("a disk that takes the recording", _refusal(error), OTHER_DISK, self.path) from error
        self._beats += 1
        self._unflushed = 0
        if self._merged_stream is not None and self._beats % BEATS_MERGED == 0:
            self._flush_merged(self._merged_stream)
        self._beat_at = time.monotonic()

    def close(self) -> Path:
        """Complete both files, within a time limit; returns where the recording is: in a separate file, or at `path`.

        Raises no error; `broken` is set if neither file could be completed."""
        if self._merged_stream is not None and not self.broken:
            self._merged_stream.send_chunks(list(self._merged.rest()))
            self._flush_merged(self._merged_stream)
        merged, self._merged_stream = self._merged_stream, None
        timeout_s = 2.0 if self.broken else CLOSE_TIMEOUT_S
        ended = merged is None or within(merged.disconnect, timeout_s)
        whole = merged is not None and ended and not self.broken and has_footer(self._merged_path)
        if not within(self._stream.disconnect, timeout_s):
            ended, self.broken = False, not whole
        with suppress(OSError):  # of a disk that is full or gone
            self._commit()
        self._ledger.close()
        if not ended:
            leave_streams_alone()
        if whole:
            return self._merged_path
        self._merged_path.unlink(missing_ok=True)
        if merged is not None and not self.broken:
            _warn_that_it_stays_small("a file is incomplete")
        return self.path

    def _note(self, part: "Chunk") -> int:
        """Note of which stream and time a portion is, for the ledger; its bytes."""
        batch = part.to_record_batch()
        if "session" in batch.schema.names and batch.num_rows:
            times = batch.column("session").cast("int64")
            first_s, last_s = times[0].as_py() / 1e9, times[-1].as_py() / 1e9
            name = part.entity_path.removeprefix("/")
            before = self._given.get(name)
            self._given[name] = (first_s, last_s) if before is None else (before[0], max(before[1], last_s))
        return int(batch.nbytes)

    def _commit(self) -> None:
        """Have the ledger cover the flushed data."""
        spans = self._given.values()
        span_s = (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None
        self._ledger.commit(self.path.stat().st_size, tuple(self._given), span_s)
        self._given = {}

    def _log(self, job: "Callable[[rr.RecordingStream], None]") -> None:
        streams = [self._stream] if self._merged_stream is None else [self._stream, self._merged_stream]
        job(cast("rr.RecordingStream", _Each(streams)))

    def _flush_merged(self, merged: "rr.RecordingStream") -> None:
        try:
            merged.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except Exception as error:
            self._do_without_merged(merged, str(error))

    def _do_without_merged(self, merged: "rr.RecordingStream", reason: str) -> None:
        self._merged_stream = None
        if not within(merged.disconnect, 2.0):
            leave_streams_alone()
        self._merged_path.unlink(missing_ok=True)
        _warn_that_it_stays_small(reason)


def _refusal(error: Exception) -> str:
    """Error of a disk with room when a flush fails on it. error: the error of the flush"""
    if "shut down" in str(error):
        return "one that refuses it: its quota is full, or it is gone"
    waits = "that takes nothing" if writes_are_held_up() else "or a processor that is so busy that nothing is taken"
    return f"one {waits} for {FLUSH_TIMEOUT_S:g} s"


def _warn_that_it_stays_small(reason: str) -> None:
    _logger.warning("%s: the recording is complete, but in many small portions, which a viewer opens slowly", reason)


class _Each:
    """Every call on it is a call on each stream: the result of a job's function is computed once."""

    def __init__(self, streams: "Sequence[rr.RecordingStream]") -> None:
        self._streams = streams

    def __getattr__(self, name: str) -> Callable[..., None]:
        methods = [getattr(stream, name) for stream in self._streams]

        def call(*arguments: object, **named: object) -> None:
            for method in methods:
                method(*arguments, **named)

        return call


def _stream(
    application: str, recording_id: str, path: Path, deterministic: bool, *, footer: bool
) -> "rr.RecordingStream":
    import rerun as rr

    if deterministic:
        batching: rr.ChunkBatcherConfig | None = rr.ChunkBatcherConfig(NEVER, NEVER, NEVER, NEVER)
    else:  # what is logged one by one goes to the first file at once, to the other in larger portions
        batching = rr.ChunkBatcherConfig(flush_tick=10.0) if footer else None
    rec = rr.RecordingStream(
        application, recording_id=recording_id, send_properties=not deterministic, batcher_config=batching
    )
    rec.set_log_time_enabled(not deterministic)
    rec.set_sinks(rr.FileSink(path, write_footer=footer))
    return rec


def write_outcome(path: Path, application: str, recording_id: str, outcome: Mapping[str, object]) -> None:
    """Write how a run ended as a part of its recording, to be merged with the rest."""
    import rerun as rr

    rec = rr.RecordingStream(application, recording_id=recording_id, send_properties=False)
    rec.set_sinks(rr.FileSink(path))
    texts = {name: json.dumps(value) if isinstance(value, dict) else value for name, value in outcome.items()}
    rec.send_property("outcome", rr.AnyValues(True, **texts))
    rec.flush(timeout_sec=FLUSH_TIMEOUT_S)
    rec.disconnect()


def has_footer(path: Path) -> bool:
    """Whether a file was written to its end."""
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            RrdReader(utf8_path(path)).store()
    except Exception:  # the reader raises what it likes
        return False
    return True


def within(action: Callable[[], object], timeout_s: float) -> bool:
    """Run an action that may hang; returns whether it ended in time."""
    thread = threading.Thread(target=action, name="deformscope-close", daemon=True)
    thread.start()
    thread.join(timeout_s)
    return not thread.is_alive()


def leave_streams_alone() -> None:
    """Keep the end of the process from waiting for a stream that hangs."""
    import rerun as rr

    rr.unregister_shutdown()


def sync(path: Path) -> None:
    """Write a file or a folder from the system's cache to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
