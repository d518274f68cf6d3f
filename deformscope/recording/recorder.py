"""Everything that is recorded or shown goes through here: the file, the live view, timelines, provenance.

A recording in progress is `NAME.part.rrd`, a file like any other recording; it becomes `NAME.rrd` when all went well,
or when what it records was stopped and the recording holds that (`stopped_because`). A run that crashes, or that ends
in an error, leaves it there with all it had (a crash: but for the last moments), and whatever `NAME.rrd` was before is
untouched. An unfinished recording is never written over.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import sys
import threading
import time
import uuid
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Literal

import numpy as np

from deformscope.arrays import FloatArray, ImageArray, IntArray
from deformscope.errors import InputError
from deformscope.frames import ColorFrame, DepthFrame, Frame, HealthReport, Item, LinkChange, RawBytes, Stream, host_ns
from deformscope.images import encode_jpeg, encode_png
from deformscope.recording import provenance
from deformscope.recording.ledger import ledger_path, write_ledger
from deformscope.recording.live import (
    PERIODS_S,
    LiveFeed,
    Viewer,
    ViewerKind,
    check_answers,
    check_running,
    start_viewer,
    wait_for_viewer,
)
from deformscope.recording.lock import create_locked, is_being_written, one_at_a_time
from deformscope.recording.losses import losses_of
from deformscope.recording.rrd_file import (
    FLUSH_TIMEOUT_S,
    RecordingError,
    RecordingFile,
    check_room,
    leave_streams_alone,
    merged_path,
    sync,
)
from deformscope.recording.writer import Writer
from deformscope.session import Step
from deformscope.stages.map.exploration import PlannedTouch, StageFailure

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.blueprint import Layout

    RecordingLayout = Layout | Literal["rig", "exploration", "findings"]
    from deformscope.log.canvas import Canvas
    from deformscope.log.live_stream import LiveStream
    from deformscope.log.rig import Place

APPLICATIONS: dict[RecordingLayout, str] = {
    "images": "deformscope",
    "flow": "deformscope-flow",
    "pair": "deformscope-pair",
    "pair-3d": "deformscope-pair-3d",
    "rig": "deformscope-rig",
    "exploration": "deformscope-exploration",
    "findings": "deformscope-findings",
}
"""rerun's application of each layout: a viewer keeps one set of views an application, and these differ."""
SUFFIX = ".rrd"
GATHER_S, GATHER_BYTES = 1.0, 8 << 20
"""What devices give is gathered for so long, or until it is so much, and written together: the cost is by portion."""
BACKLOG_JOBS, BACKLOG_BYTES = 1 << 20, 512 << 20
"""What may wait to be written of devices, which go on by themselves."""
AHEAD_JOBS, AHEAD_BYTES = 16, 64 << 20
"""The same of what can itself wait for its recording."""
ITEM_BYTES = 1 << 10
"""An item costs so much memory beside its arrays."""
TICK_S = 0.1
SETTLE_TIMEOUT_S = 10.0
DRAIN_TIMEOUT_S = 60.0
LIVE_TIMEOUT_S = 3.0

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What was recorded.

    path: the finished file, or the unfinished one after an error; None where nothing was written
    dropped: portions (a frame, a step, an input, what the devices gave in a tenth of a second) that the viewer is not
    known to have got; bytes: size of the file
    """

    path: Path | None
    frames: int
    steps: int
    dropped: int
    bytes: int


class Recorder:
    """`with Recorder(file, "none", settings) as recorder: run(source, experiment, recorder)`.

    file: an `.rrd` to make; None = none. viewer: a window, a page for a browser, or none. Without file and viewer
    it does nothing, and rerun is not even imported.
    settings: everything that decides the results, JSON-able; layout: which views a viewer opens with
    variant: tells apart recordings of one layout whose views differ: a viewer keeps one set of views an application
    deterministic: two runs of one input give recordings that `rerun rrd compare --unordered` finds equal; leaves
    out what differs between runs (start time, command line, versions, git state) and writes in larger portions
    real_time: what is recorded goes on by itself, as devices do: a disk that stays too slow for it ends the recording
    with a RecordingError. Otherwise whoever writes waits, once the disk is far behind

    Nothing is encoded, and no disk waited for, in the thread that calls `write...`: that is done in order in a thread
    of the recorder's own, so what is handed over must not be changed any more. What fails there is raised by the next
    call, or in the end.
    """

    def __init__(
        self,
        file: Path | None,
        viewer: ViewerKind = "none",
        settings: Mapping[str, object] | None = None,
        *,
        layout: RecordingLayout = "images",
        overwrite: bool = False,
        deterministic: bool = False,
        variant: str = "",
        real_time: bool = False,
    ) -> None:
        self._target = None if file is None else _followed(Path(file))
        self._viewer_kind = viewer
        self._settings = dict(settings or {})
        self._layout: RecordingLayout = layout
        self._application = f"{APPLICATIONS[layout]}-{variant}" if variant else APPLICATIONS[layout]
        self._overwrite = overwrite
        self._deterministic = deterministic
        self._real_time = real_time
        self._part: Path | None = None
        self._reserved: BinaryIO | None = None
        self._finished: RecordingSummary | None = None
        self._stopped = ""
        # what who calls knows
        self._session_ns: dict[int, int] = {}
        self._first_ns = 0
        self._last_frame = 0
        self._frames = self._steps = self._inputs = 0
        self._counts: dict[str, int] = {}
        self._losses: dict[str, dict[str, float]] = {}
        self._touch = 0
        self._streams: tuple[Stream, ...] = ()
        self._lossless: frozenset[str] = frozenset()
        self._exploring = False
        # what the writer's thread alone touches, until it has ended
        self._writer: Writer | None = None
        self._file: RecordingFile | None = None
        self._feed: LiveFeed[LiveStream] | None = None
        self._viewer: Viewer | None = None
        self._canvas: Canvas | None = None
        self._arranged = False
        self._range: tuple[float, float] | None = None
        self._pictures_ns = _Times()
        self._scales: dict[str, tuple[object, int]] = {}
        self._not_shown: list[StageFailure] = []
        self._gathered: list[Item] = []
        self._gathered_bytes = self._gathered_touch = 0
        self._gathered_at = 0.0

    @property
    def active(self) -> bool:
        """Whether anything is recorded or shown."""
        return self._target is not None or self._viewer_kind != "none"

    @property
    def not_shown(self) -> tuple[StageFailure, ...]:
        """Results of an exploration that were recorded, but could not be shown; waits until all so far were drawn."""
        if self._writer is not None:
            self._writer.settle(SETTLE_TIMEOUT_S)
        return tuple(self._not_shown)

    @property
    def viewer(self) -> Viewer | None:
        """The viewer that was started."""
        return self._viewer

    def __enter__(self) -> Recorder:
        if not self.active:
            return self
        if self._target is not None:
            self._part, self._reserved = _reserve(self._target, self._overwrite)
        try:
            if self._target is not None:
                check_room(self._target, "another disk")
            self._open()
        except BaseException:
            if self._part is not None:
                self._part.unlink(missing_ok=True)
            self._release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.active and self._finished is None:
            try:
                self._close(complete=kind is None)
            finally:
                self._release()

    def write_frame(self, frame: ColorFrame) -> None:
        """Record one input frame without loss; what follows belongs to it."""
        if not self._frames:
            self._first_ns = frame.stamp.host_ns
        self._session_ns[frame.index] = frame.stamp.host_ns - self._first_ns
        self._last_frame = frame.index
        self._frames += 1
        if not self.active:
            return
        times = self._times(frame.index)
        self._put(lambda: self._write_frame(frame, times), frame.image.nbytes)

    def _write_frame(self, frame: ColorFrame, times: tuple[int, int]) -> None:
        if self._canvas is None:
            self._canvas = _canvas_of(frame.image)
            if not self._layout.startswith("pair"):
                self._arrange()
        image = frame.image
        png = encode_png(image)
        stamp = frame.stamp.host_ns, -1 if frame.stamp.device_ticks is None else frame.stamp.device_ticks
        self._keep(lambda rec: _log_frame(rec, times, png, stamp))
        if image.dtype == np.uint8:  # as JPEG, a tenth of the bytes
            self._show(lambda live: _log_frame(live.rec, times, encode_jpeg(image), stamp, "image/jpeg"), image.nbytes)
        else:
            shown = self._shown(image)
            self._emit(lambda rec: _log_shown(rec, times, shown), len(shown))

    def write(self, step: Step) -> None:
        """Record the results of one step, at the frame that they belong to."""
        self._steps += 1
        if not self.active or not step.results:
            return
        times = self._times(self._last_frame if step.frame is None else step.frame)
        size = sum(_size(result) for result in step.results)
        self._put(lambda: self._write_step(step, times, size), size)

    def _write_step(self, step: Step, times: tuple[int, int], size: int) -> None:
        from deformscope.log import canvas_with, log_result
        from deformscope.log.canvas import Canvas

        canvas = self._canvas or Canvas()
        shown = []
        for result in step.results:
            canvas = canvas_with(result, canvas)
            shown.append((result, canvas))
        self._canvas = canvas
        if self._layout.startswith("pair") and canvas != Canvas():
            self._arrange()

        def log(rec: rr.RecordingStream) -> None:
            _set_times(rec, times)
            for result, drawn_on in shown:
                log_result(rec, result, drawn_on)

        self._emit(log, size)

    def start_rig(self, streams: Sequence[Stream], start_ns: int, lossless: Collection[str] = ()) -> None:
        """From here on it is the devices of a rig that are recorded.

        start_ns: the host's clock at session time 0; lossless: devices whose colour images stages will compute on
        """
        self._streams, self._first_ns, self._lossless = tuple(streams), start_ns, frozenset(lossless)
        if not self.active:
            return
        from deformscope.log.rig import log_streams, rig_blueprint

        views, told = rig_blueprint(self._streams), self._streams
        self._put(lambda: self._emit(lambda rec: rec.send_blueprint(views), 0), 0)
        self._put(lambda: self._emit(lambda rec: log_streams(rec, told), 0), 0)

    def write_items(self, items: Sequence[Item]) -> None:
        """Record a batch of what a rig's devices gave, without loss; an empty one asks whether it can go on."""
        if not items:
            if self._writer is not None:
                self._writer.check()
            return
        for item in items:
            kind = _counted_as(item)
            self._counts[kind] = self._counts.get(kind, 0) + 1
            if isinstance(item, HealthReport):
                self._losses = losses_of(item)
        self._frames += sum(isinstance(item, Frame) for item in items)
        if not self.active:
            return
        given, touch = tuple(items), self._touch
        size = sum(_item_size(item) for item in given)
        self._put(lambda: self._take_items(given, touch, size), size)

    def _take_items(self, items: Sequence[Item], touch: int, size: int) -> None:
        """Gather them with others of the same touch."""
        if touch != self._gathered_touch:
            self._write_gathered()
            self._gathered_touch = touch
        if not self._gathered:
            self._gathered_at = time.monotonic()
        camera = next((stream.device for stream in self._streams if stream.kind == "depth"), None)
        pictures = [item for item in items if isinstance(item, DepthFrame) and item.device == camera]
        self._pictures_ns.add([item.stamp.host_ns - self._first_ns for item in pictures])
        start_ns, streams, place = self._first_ns, self._streams, self._place(touch) if self._exploring else None
        self._show(lambda live: live.add_items(items, start_ns, streams, place), size)
        if self._file is None:
            return
        self._gathered += items
        self._gathered_bytes += size
        if self._gathered_bytes >= GATHER_BYTES or _span_s(self._gathered) >= GATHER_S:
            self._write_gathered()

    def _write_gathered(self) -> None:
        if not self._gathered or self._file is None:
            return
        from deformscope.log.rig import prepare_items

        items = self._gathered
        self._gathered, self._gathered_bytes = [], 0
        place = self._place(self._gathered_touch) if self._exploring else None
        self._file.send(prepare_items(items, self._first_ns, self._streams, self._lossless, place, self._scales))

    def start_exploration(
        self,
        streams: Sequence[Stream],
        start_ns: int,
        size_m: tuple[float, float],
        base_from_surface: FloatArray | None,
        *,
        truth: bool,
    ) -> None:
        """From here on it is an exploration that is recorded, and its devices.

        size_m: of the surface; base_from_surface: (4, 4); truth: whether it is known
        """
        self._streams, self._first_ns, self._exploring = tuple(streams), start_ns, True
        if not self.active:
            return
        from deformscope.log.exploration import exploration_blueprint, log_exploration_start
        from deformscope.log.rig import log_streams

        views, told = exploration_blueprint(self._streams, size_m, truth=truth), self._streams
        self._put(lambda: self._emit(lambda rec: rec.send_blueprint(views), 0), 0)
        self._put(lambda: self._emit(lambda rec: log_streams(rec, told), 0), 0)
        self._put(lambda: self._emit(lambda rec: log_exploration_start(rec, told, base_from_surface), 0), 0)

    def write_results(
        self, results: Sequence[object], now_ns: int, touch: int, cell_m: float, seen_ns: int | None = None
    ) -> None:
        """Record results of an exploration.

        now_ns: the robot's clock; touch: 0 before the first touch, then its number from 1; cell_m: of the maps
        seen_ns: when the camera saw what they are of: they stand at that picture on `frame`; None = now
        """
        # what the devices give from the plan of a touch on belongs to that touch
        self._touch = touch + any(
            isinstance(result, PlannedTouch) and result.target_m is not None for result in results
        )
        self._steps += 1
        if not self.active:
            return
        given, session_ns = tuple(results), now_ns - self._first_ns
        size = sum(_size(result) for result in given)

        def write() -> None:
            from deformscope.log.exploration import prepare_results

            place = self._place(touch, seen_ns)
            batch = prepare_results(given, session_ns, place, cell_m=cell_m, failed=self._not_shown)
            if self._file is not None:
                self._file.send(batch)
            self._show(lambda live: live.send(batch), size, lasting=True)

        self._put(write, size)

    def _place(self, touch: int, seen_ns: int | None = None) -> Place:
        """On an exploration's timelines."""
        from deformscope.log.rig import Place

        place = Place(touch, self._pictures_ns.all)
        if seen_ns is None:
            return place
        return dataclasses.replace(place, frame=int(place.at(np.array([seen_ns - self._first_ns]))[0]))

    def write_input(self, name: str, content: bytes | ImageArray) -> None:
        """Record an input that is no frame, without loss, at `input/NAME`.

        content: the bytes of a file as they are, or an image (a mask), which holds for the whole recording
        """
        self._inputs += 1
        if not self.active:
            return
        times, path = self._times(self._last_frame), f"input/{name}"

        def write() -> None:
            if isinstance(content, bytes):
                raw = np.frombuffer(content, np.uint8)
                self._keep(lambda rec: _log_blob(rec, times, path, raw))  # no view shows it
            else:
                png = encode_png(content)
                self._emit(lambda rec: _log_image(rec, path, png), len(png))

        self._put(write, len(content) if isinstance(content, bytes) else content.nbytes)

    def stopped_because(self, reason: str) -> None:
        """What is recorded ended before its time, and the recording with it: whole, and saying why."""
        self._stopped = reason

    def summary(self) -> RecordingSummary:
        """What was recorded so far, or in the end."""
        if self._finished is not None:
            return self._finished
        size = self._part.stat().st_size if self._part is not None and self._part.exists() else 0
        dropped = self._feed.dropped if self._feed is not None else 0
        return RecordingSummary(self._part, self._frames, self._steps, dropped, size)

    def _open(self) -> None:
        os.environ.setdefault("RUST_LOG", "off")  # what rerun would print, this recorder notices and says itself
        if self._layout in ("rig", "exploration"):
            from deformscope.log.rig import warm_up

            warm_up()  # before any device is opened: a second's delay in a session would overflow its queues
        recording_id = "deterministic" if self._deterministic else uuid.uuid4().hex
        told = _provenance(self._settings, brief=self._deterministic)
        if self._viewer_kind != "none":
            viewer = start_viewer(self._viewer_kind)
            self._viewer = viewer
            print(viewer.where, file=sys.stderr, flush=True)
            application = self._application
            self._feed = LiveFeed(
                lambda give_up: _live_stream(application, recording_id, viewer, told, give_up),
                period_s=PERIODS_S[self._viewer_kind],
            )
            self._feed.start()
        if self._part is not None:
            name = "" if self._deterministic or self._target is None else self._target.stem
            self._file = RecordingFile(
                self._application,
                recording_id,
                self._part,
                told,
                name=name,
                hint=lambda: self._kept_hint,
                deterministic=self._deterministic,
            )
        if self._real_time:
            self._writer = Writer(self._tick, TICK_S, BACKLOG_JOBS, BACKLOG_BYTES, self._too_slow)
        else:
            self._writer = Writer(self._tick, TICK_S, AHEAD_JOBS, AHEAD_BYTES)
        self._writer.start()

    def _put(self, job: Callable[[], None], size: int) -> None:
        """Have the writer's thread do it, in order. From any thread."""
        if self._writer is None:
            raise ValueError("nothing can be written before the recorder's context, or after it")
        self._writer.put(job, size)

    def _too_slow(self, waiting_bytes: int) -> Exception:
        came = f"one that is {waiting_bytes >> 20} MiB behind"
        return RecordingError("a disk that keeps up", came, self._kept_hint, self._part)

    def _tick(self) -> None:
        """Between jobs, and several times a second while there are none."""
        if self._deterministic:
            return
        if self._gathered and time.monotonic() - self._gathered_at >= GATHER_S:
            self._write_gathered()
        if self._file is not None:
            self._file.beat()

    def _emit(self, job: Callable[[rr.RecordingStream], None], size: int) -> None:
        """To the file, and to the live view when it comes to it."""
        self._keep(job)
        self._show(lambda live: job(live.rec), size, lasting=True)

    def _keep(self, job: Callable[[rr.RecordingStream], None]) -> None:
        """To the file alone."""
        if self._file is not None:
            self._file.log(job)

    def _show(self, job: Callable[[LiveStream], None], size: int, *, lasting: bool = False) -> None:
        """To the live view alone. lasting: dropped last where the viewer cannot follow"""
        if self._feed is not None:
            self._feed.put(job, size, lasting=lasting)

    def _arrange(self) -> None:
        """Send the views, once, as soon as it is known what they show."""
        if self._arranged or self._canvas is None:
            return
        self._arranged = True
        from deformscope.log.blueprint import blueprint

        if self._layout == "rig" or self._layout == "exploration" or self._layout == "findings":
            raise ValueError("these views come with what they show")
        views = blueprint(self._layout, self._canvas)
        self._emit(lambda rec: rec.send_blueprint(views), 0)

    def _shown(self, image: ImageArray) -> bytes:
        """A 16 bit image as a viewer can show it: its range, as of the first frame, spread over 8 bits."""
        import cv2

        if self._range is None:
            self._range = float(image.min()), max(float(image.max()), float(image.min()) + 1.0)
        low, high = self._range
        spread = ((image.astype(np.float32) - low) * (255.0 / (high - low))).clip(0, 255).astype(np.uint8)
        ordered = spread if spread.ndim == 2 else spread[..., ::-1]
        return cv2.imencode(".jpg", ordered, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()

    def _times(self, frame: int) -> tuple[int, int]:
        """(frame, session [ns]) of a frame that was written; pairs have frames without images, at time 0."""
        if self._session_ns and frame not in self._session_ns:
            raise ValueError(f"a step belongs to frame {frame}, which was never written")
        return frame, self._session_ns.get(frame, 0)

    def _close(self, *, complete: bool) -> None:
        """End the file and the live view, each within its time; give the file its name where all went well."""
        failure = self._end_writing()  # safe on the disk before anything waits for a viewer
        dropped = self._close_live()
        path = self._part
        if self._file is not None and self._part is not None:
            if not self._file.broken:
                outcome: dict[str, object] = {"frames": self._frames, "steps": self._steps}
                outcome |= {"live_dropped": dropped, "complete": complete and failure is None}
                if self._stopped:
                    outcome["stopped"] = self._stopped
                if self._counts:
                    outcome["counts"] = json.dumps(self._counts)
                    outcome["losses"] = json.dumps(self._losses)
                self._file.write_properties("outcome", outcome)
                try:
                    self._file.flush()
                except RecordingError as error:
                    failure = error
            whole = self._file.close()
            if complete and failure is None and not self._file.broken:
                path = self._publish(self._part, whole)
            else:
                path = self._keep_unfinished(self._part, whole)
        size = path.stat().st_size if path is not None else 0
        self._finished = RecordingSummary(path, self._frames, self._steps, dropped, size)
        if complete and failure is not None:
            raise failure

    def _end_writing(self) -> Exception | None:
        """Have the writer finish; what kept it from that."""
        writer, self._writer = self._writer, None
        if writer is None:
            return None
        if writer.close(DRAIN_TIMEOUT_S, self._write_last):
            return writer.failure
        if self._file is not None:
            self._file.broken = True
        return self._too_slow(writer.waiting_bytes)

    def _write_last(self) -> None:
        self._write_gathered()
        if self._file is not None:
            self._file.flush()

    def _close_live(self) -> int:
        if self._feed is None:
            return 0
        if not self._feed.close(LIVE_TIMEOUT_S):
            leave_streams_alone()
        return self._feed.dropped

    def _publish(self, part: Path, whole: Path) -> Path:
        """whole: what is to be the recording; the part is locked, and goes last."""
        assert self._target is not None
        if self._target.exists() and not self._overwrite:
            whole.replace(part)
            raise RecordingError(
                "no file of that name", "one made during the run", f"the new one: {part}", self._target
            )
        sync(whole)
        # An older recording's ledger goes first: a ledger that fits no recording must never stand beside one.
        ledger_path(self._target).unlink(missing_ok=True)
        whole.replace(self._target)
        part.unlink(missing_ok=True)
        counts = {"frames": self._frames, "steps": self._steps, "inputs": self._inputs, **self._counts}
        write_ledger(self._target, counts, self._losses)
        sync(self._target.parent)
        return self._target

    @property
    def _kept_hint(self) -> str:
        return "another disk; what was recorded is kept" if self._holds_something else "another disk"

    def _release(self) -> None:
        """Let others record to this name."""
        if self._reserved is not None:
            self._reserved.close()

    @property
    def _holds_something(self) -> bool:
        """Whether an unfinished recording is worth keeping."""
        # an exploration whose checks have not passed has nothing to tell but that its devices were there
        return bool(self._steps or self._inputs or (self._frames and not self._exploring))

    def _keep_unfinished(self, part: Path, whole: Path) -> Path | None:
        whole.replace(part)
        if not self._holds_something:
            part.unlink(missing_ok=True)
            return None
        _logger.warning("what was recorded before the error is kept: %s", part)
        return part


def _followed(target: Path) -> Path:
    """Where a link leads: it stays a link, to the new recording, as with every other output."""
    if not target.is_symlink():
        return target
    found = Path(os.path.realpath(target))
    if found.is_symlink():
        raise InputError("a link that leads to a file", "one that leads to itself", where=target)
    return found


def _reserve(target: Path, overwrite: bool) -> tuple[Path, BinaryIO]:
    """An empty file to record into, beside the target, and its lock until it is closed; refuses what cannot work
    before any work is done."""
    if target.suffix.lower() != SUFFIX:
        raise InputError(f"a recording's name that ends in {SUFFIX}", f"{target.suffix or 'no ending'}", where=target)
    if target.is_dir():
        raise InputError("a file to record into", "a folder", where=target)
    if target.exists() and not overwrite:
        raise InputError("a new file to record into", "one that exists", "another name, or --overwrite", target)
    if not target.parent.is_dir():
        raise InputError("a folder to record into", "none", f"mkdir -p {target.parent}", target)
    with one_at_a_time(target.parent):
        for number in range(1, 1000):
            part = target.with_name(f"{target.stem}.part{'' if number == 1 else f'-{number}'}{SUFFIX}")
            try:
                return part, create_locked(part)
            except FileExistsError:
                if is_being_written(part):
                    came = f"one that another run is recording to ({part.name})"
                    raise InputError("a recording of its own", came, "another name", target) from None
                merged_path(part).unlink(missing_ok=True)  # of a run that was killed: of no use without its end
            except OSError as error:
                came = (error.strerror or str(error)).lower()
                raise InputError("a folder that can be written to", came, "another folder", target.parent) from error
    raise InputError("fewer unfinished recordings", "1000", "rename or delete some", target.parent)


def _live_stream(
    application: str, recording_id: str, viewer: Viewer, told: Mapping[str, object], give_up: threading.Event
) -> LiveStream:
    """Connected to the viewer; blocks until it is there."""
    import rerun as rr

    from deformscope.log.live_stream import LiveStream

    def check(timeout_s: float) -> None:
        check_running(viewer)
        check_answers(viewer, timeout_s)

    wait_for_viewer(viewer, give_up)
    rec = rr.RecordingStream(application, recording_id=recording_id)
    rec.set_sinks(rr.GrpcSink(viewer.url))
    rec.send_property("session", _any_values(told))
    return LiveStream(rec, check)


def _canvas_of(image: ImageArray) -> Canvas:
    from deformscope.log.canvas import Canvas

    height, width = image.shape[:2]
    path = "input/image" if image.dtype == np.uint8 else "display/image"
    return Canvas(low=(0.0, 0.0), high=(float(width), float(height)), image=path)


def _set_times(rec: rr.RecordingStream, times: tuple[int, int]) -> None:
    frame, session_ns = times
    rec.set_time("frame", sequence=frame)
    rec.set_time("session", duration=np.timedelta64(session_ns, "ns"))


def _log_frame(
    rec: rr.RecordingStream, times: tuple[int, int], encoded: bytes, stamp: tuple[int, int], kind: str = "image/png"
) -> None:
    """stamp: host clock [ns]; device ticks, -1 where there are none."""
    import rerun as rr

    _set_times(rec, times)
    image = rr.EncodedImage(contents=encoded, media_type=kind, draw_order=-10.0)
    rec.log("input/image", image, rr.AnyValues(host_ns=stamp[0], device_ticks=stamp[1]))


def _log_shown(rec: rr.RecordingStream, times: tuple[int, int], jpeg: bytes) -> None:
    import rerun as rr

    _set_times(rec, times)
    rec.log("display/image", rr.EncodedImage(contents=jpeg, media_type="image/jpeg", draw_order=-10.0))


def _log_image(rec: rr.RecordingStream, path: str, png: bytes) -> None:
    import rerun as rr

    rec.log(path, rr.EncodedImage(contents=png, media_type="image/png"), static=True)


def _log_blob(rec: rr.RecordingStream, times: tuple[int, int], path: str, raw: np.typing.NDArray[np.uint8]) -> None:
    import rerun as rr

    _set_times(rec, times)
    rec.log(path, rr.AnyValues(blob=raw))


def write_outcome(path: Path, application: str, recording: str, outcome: Mapping[str, object]) -> None:
    """How a run ended, as a part of its recording, to be merged with the rest. application, recording: its ids"""
    import rerun as rr

    rec = rr.RecordingStream(application, recording_id=recording, send_properties=False)
    rec.set_sinks(rr.FileSink(path))
    told = {name: json.dumps(value) if isinstance(value, dict) else value for name, value in outcome.items()}
    rec.send_property("outcome", _any_values(told))
    rec.flush(timeout_sec=FLUSH_TIMEOUT_S)
    rec.disconnect()


def _any_values(values: Mapping[str, object]) -> rr.AnyValues:
    import rerun as rr

    return rr.AnyValues(True, **values)


def _size(result: object) -> int:
    """Bytes of the arrays in a result."""
    if not dataclasses.is_dataclass(result):
        return 0
    values = (getattr(result, field.name) for field in dataclasses.fields(result))
    return sum(value.nbytes for value in values if isinstance(value, np.ndarray))


def _counted_as(item: Item) -> str:
    """The count that an item of a rig belongs to: of its device, and of its kind."""
    match item:
        case RawBytes():
            return f"{item.device}/{'sent' if item.sent else 'received'}"
        case LinkChange():
            return f"{item.device}/link"
        case HealthReport():
            return "health"
        case _:
            return f"{item.device}/frames"


def _item_size(item: Item) -> int:
    """Bytes that an item keeps alive."""
    return ITEM_BYTES + (len(item.data) if isinstance(item, RawBytes) else _size(item))


def _span_s(items: Sequence[Item]) -> float:
    """From the first to the last."""
    return (host_ns(items[-1]) - host_ns(items[0])) / 1e9


class _Times:
    """Times that only ever become more: what was read of them stays as it was."""

    def __init__(self) -> None:
        self._held: IntArray = np.zeros(1024, np.int64)
        self._count = 0

    @property
    def all(self) -> IntArray:
        """(n,) so far."""
        return self._held[: self._count]

    def add(self, times: Sequence[int]) -> None:
        count = self._count + len(times)
        if count > len(self._held):
            longer = np.zeros(2 * count, np.int64)
            longer[: self._count] = self.all
            self._held = longer
        self._held[self._count : count] = times
        self._count = count


def _provenance(settings: Mapping[str, object], *, brief: bool) -> dict[str, object]:
    """What made this recording, as text that any tool can read."""
    found: dict[str, object] = {"settings": json.dumps(settings, sort_keys=True, default=str)}
    seed = settings.get("seed")
    if isinstance(seed, int):
        found["seed"] = seed
    if not brief:
        found["versions"] = json.dumps(provenance.versions())
        found["git"] = json.dumps(provenance.git_state())
        found["command"] = json.dumps(provenance.command())
        found["platform"] = provenance.machine()
    return found
