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
import shutil
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

from deformscope import provenance
from deformscope.arrays import FloatArray, ImageArray
from deformscope.errors import InputError
from deformscope.frames import ColorFrame, DepthFrame, Frame, HealthReport, Item, LinkChange, RawBytes, Stream
from deformscope.images import encode_jpeg, encode_png
from deformscope.ledger import ledger_path, write_ledger
from deformscope.live import (
    PERIODS_S,
    LiveFeed,
    Viewer,
    ViewerKind,
    check_answers,
    check_running,
    start_viewer,
    wait_for_viewer,
)
from deformscope.losses import losses_of
from deformscope.recording_lock import create_locked, is_being_written, one_at_a_time
from deformscope.session import Step
from deformscope.stages.exploration import NextTouch, StageFailed

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.blueprint import Layout

    RecordingLayout = Layout | Literal["rig", "exploration"]
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
}
"""rerun's application of each layout: a viewer keeps one set of views an application, and these differ."""
SUFFIX = ".rrd"
FREE_BYTES = 64 << 20
BEAT_S = 1.0
BEAT_FRAMES = 32
FLUSH_TIMEOUT_S = 20.0
CLOSE_TIMEOUT_S = 60.0
LIVE_TIMEOUT_S = 3.0

_logger = logging.getLogger(__name__)


class RecordingError(InputError):
    """The recording cannot go on: the disk is full, or gone."""


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
    not_shown: results of an exploration that were recorded, but could not be shown
    deterministic: two runs of one input give recordings that `rerun rrd compare --unordered` finds equal; leaves
    out what differs between runs (start time, command line, versions, git state) and writes in larger portions
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
    ) -> None:
        self._target = None if file is None else _followed(Path(file))
        self._viewer_kind = viewer
        self._settings = dict(settings or {})
        self._layout: RecordingLayout = layout
        self._application = f"{APPLICATIONS[layout]}-{variant}" if variant else APPLICATIONS[layout]
        self._overwrite = overwrite
        self._deterministic = deterministic
        self._part: Path | None = None
        self._reserved: BinaryIO | None = None
        self._file: rr.RecordingStream | None = None
        self._feed: LiveFeed[LiveStream] | None = None
        self._viewer: Viewer | None = None
        self._canvas: Canvas | None = None
        self._session_ns: dict[int, int] = {}
        self._first_ns = 0
        self._last_frame = 0
        self._arranged = False
        self._range: tuple[float, float] | None = None
        self._frames = self._steps = self._inputs = 0
        self._streams: tuple[Stream, ...] = ()
        self._lossless: frozenset[str] = frozenset()
        self._exploring = False
        self.not_shown: list[StageFailed] = []
        self._touch = 0
        self._pictures_ns: list[int] = []
        self._scales: dict[str, tuple[object, int]] = {}
        self._counts: dict[str, int] = {}
        self._losses: dict[str, dict[str, float]] = {}
        self._beat_at = self._beats = 0.0
        self._broken = False
        self._lock = threading.RLock()
        self._stopped = ""
        self._finished: RecordingSummary | None = None

    @property
    def active(self) -> bool:
        """Whether anything is recorded or shown."""
        return self._target is not None or self._viewer_kind != "none"

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
                _require_space(self._target.parent, "another disk", self._target)
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
        if self._canvas is None:
            self._canvas = _canvas_of(frame.image)
            if not self._layout.startswith("pair"):
                self._arrange()
        image = frame.image
        png = encode_png(image)
        times = self._times(frame.index)
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
        from deformscope.log import canvas_with, log_result
        from deformscope.log.canvas import Canvas

        times = self._times(self._last_frame if step.frame is None else step.frame)
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

        self._emit(log, sum(_size(result) for result in step.results))

    def start_rig(self, streams: Sequence[Stream], start_ns: int, lossless: Collection[str] = ()) -> None:
        """From here on it is the devices of a rig that are recorded.

        start_ns: the host's clock at session time 0; lossless: devices whose colour images stages will compute on
        """
        self._streams, self._first_ns, self._lossless = tuple(streams), start_ns, frozenset(lossless)
        if not self.active:
            return
        from deformscope.log.rig import log_streams, rig_blueprint

        views, told = rig_blueprint(self._streams), self._streams
        self._emit(lambda rec: rec.send_blueprint(views), 0)
        self._emit(lambda rec: log_streams(rec, told), 0)

    def write_items(self, items: Sequence[Item]) -> None:
        """Record a batch of what a rig's devices gave, without loss."""
        if self._file is not None:
            self._beat()
        if not items:
            return
        for item in items:
            kind = _counted_as(item)
            self._counts[kind] = self._counts.get(kind, 0) + 1
            if isinstance(item, HealthReport):
                self._losses = losses_of(item)
        self._frames += sum(isinstance(item, Frame) for item in items)
        if not self.active:
            return
        from deformscope.log.rig import prepare_items

        camera = next((stream.device for stream in self._streams if stream.kind == "depth"), None)
        pictures = [item for item in items if isinstance(item, DepthFrame) and item.device == camera]
        self._pictures_ns += [item.stamp.host_ns - self._first_ns for item in pictures]
        place = self._place(self._touch) if self._exploring else None
        kept, start_ns, streams = list(items), self._first_ns, self._streams
        size = sum(_item_size(item) for item in kept)
        self._show(lambda live: live.add_items(kept, start_ns, streams, place), size)
        if self._file is not None:
            self._keep(prepare_items(kept, start_ns, streams, self._lossless, place, self._scales).send)

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
        self._emit(lambda rec: rec.send_blueprint(views), 0)
        self._emit(lambda rec: log_streams(rec, told), 0)
        self._emit(lambda rec: log_exploration_start(rec, told, base_from_surface), 0)

    def write_results(
        self, results: Sequence[object], now_ns: int, touch: int, cell_m: float, seen_ns: int | None = None
    ) -> None:
        """Record results of an exploration.

        now_ns: the robot's clock; touch: 0 before the first touch, then its number from 1; cell_m: of the maps
        seen_ns: when the camera saw what they are of: they stand at that picture on `frame`; None = now
        """
        # what the devices give from the plan of a touch on belongs to that touch
        self._touch = touch + any(isinstance(result, NextTouch) and result.target_m is not None for result in results)
        self._steps += 1
        if not self.active:
            return
        from deformscope.log.exploration import prepare_results

        if self._file is not None:
            self._beat()
        place = self._place(touch, seen_ns)
        batch = prepare_results(results, now_ns - self._first_ns, place, cell_m=cell_m, failed=self.not_shown)
        self._keep(batch.send)
        self._show(lambda live: live.send(batch), sum(_size(result) for result in results), lasting=True)

    def _place(self, touch: int, seen_ns: int | None = None) -> Place:
        """On an exploration's timelines."""
        from deformscope.log.rig import Place

        place = Place(touch, np.array(self._pictures_ns, np.int64))
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
        times = self._times(self._last_frame)
        path = f"input/{name}"
        if isinstance(content, bytes):
            raw = np.frombuffer(content, np.uint8)
            self._keep(lambda rec: _log_blob(rec, times, path, raw))  # no view shows it
        else:
            png = encode_png(content)
            self._emit(lambda rec: _log_image(rec, path, png), len(png))

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
            self._file = _file_stream(self._application, recording_id, self._part, self._deterministic)
            self._file.send_property("session", _any_values(told))
            if not self._deterministic and self._target is not None:
                self._file.send_recording_name(self._target.stem)
            self._flush()

    def _emit(self, job: Callable[[rr.RecordingStream], None], size: int) -> None:
        """To the file first and at once; to the live view when it comes to it. From any thread."""
        with self._lock:
            self._keep(job)
            self._show(lambda live: job(live.rec), size, lasting=True)

    def _keep(self, job: Callable[[rr.RecordingStream], None]) -> None:
        """To the file alone."""
        with self._lock:
            if self._file is not None:
                self._beat()
                job(self._file)

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

        if self._layout == "rig" or self._layout == "exploration":
            raise ValueError("the views of a rig come when it starts")
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

    def _beat(self) -> None:
        """Notice now and then that the disk is full or gone: rerun would go on without a word."""
        with self._lock:
            self._look_at_disk()

    def _look_at_disk(self) -> None:
        if self._broken:
            raise RecordingError("a recording that goes on", "one that has failed", where=self._part)
        if self._deterministic:  # by count, since every flush ends a portion of the file
            self._beats += 1
            due = self._beats % BEAT_FRAMES == 0
        else:
            due = time.monotonic() - self._beat_at > BEAT_S
        if due:
            self._flush()

    def _flush(self) -> None:
        assert self._file is not None
        assert self._part is not None
        try:
            _require_space(self._part.parent, self._kept_hint, self._part)
        except RecordingError:
            self._broken = True
            raise
        try:
            self._file.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except Exception as error:
            self._broken = True
            came = "a disk that is full, gone or too slow"
            raise RecordingError("a disk that takes the recording", came, self._kept_hint, self._part) from error
        self._beat_at = time.monotonic()

    def _close(self, *, complete: bool) -> None:
        """End both streams, each within its time; give the file its name where all went well."""
        failure: RecordingError | None = None
        try:
            if self._file is not None and not self._broken:
                self._flush()  # safe on the disk before anything waits for a viewer
        except RecordingError as error:
            failure = error
        dropped = self._close_live()
        if self._file is not None and not self._broken:
            outcome: dict[str, object] = {"frames": self._frames, "steps": self._steps}
            outcome |= {"live_dropped": dropped, "complete": complete}
            if self._stopped:
                outcome["stopped"] = self._stopped
            if self._counts:
                outcome["counts"] = json.dumps(self._counts)
                outcome["losses"] = json.dumps(self._losses)
            self._file.send_property("outcome", _any_values(outcome))
            try:
                self._flush()
            except RecordingError as error:
                failure = error
        file, self._file = self._file, None
        if file is not None and not _within(file.disconnect, CLOSE_TIMEOUT_S if not self._broken else 2.0):
            self._broken = True
            _leave_streams_alone()
        path = self._part
        if complete and not self._broken and self._part is not None:
            path = self._publish(self._part)
        elif self._part is not None:
            path = self._keep_unfinished(self._part)
        size = path.stat().st_size if path is not None else 0
        self._finished = RecordingSummary(path, self._frames, self._steps, dropped, size)
        if complete and failure is not None:
            raise failure

    def _close_live(self) -> int:
        if self._feed is None:
            return 0
        if not self._feed.close(LIVE_TIMEOUT_S):
            _leave_streams_alone()
        return self._feed.dropped

    def _publish(self, part: Path) -> Path:
        assert self._target is not None
        if self._target.exists() and not self._overwrite:
            raise RecordingError(
                "no file of that name", "one made during the run", f"the new one: {part}", self._target
            )
        _sync(part)
        # An older recording's ledger goes first: a ledger that fits no recording must never stand beside one.
        ledger_path(self._target).unlink(missing_ok=True)
        part.replace(self._target)
        counts = {"frames": self._frames, "steps": self._steps, "inputs": self._inputs, **self._counts}
        write_ledger(self._target, counts, self._losses)
        _sync(self._target.parent)
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

    def _keep_unfinished(self, part: Path) -> Path | None:
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
            except OSError as error:
                came = (error.strerror or str(error)).lower()
                raise InputError("a folder that can be written to", came, "another folder", target.parent) from error
    raise InputError("fewer unfinished recordings", "1000", "rename or delete some", target.parent)


def _require_space(folder: Path, hint: str, where: Path) -> None:
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES:
        raise RecordingError(f"{FREE_BYTES >> 20} MiB free on the disk", f"{free >> 20} MiB free", hint, where)


def _file_stream(application: str, recording_id: str, path: Path, deterministic: bool) -> rr.RecordingStream:
    import rerun as rr

    never = 10**9
    batching = rr.ChunkBatcherConfig(never, never, never, never) if deterministic else None
    rec = rr.RecordingStream(
        application, recording_id=recording_id, send_properties=not deterministic, batcher_config=batching
    )
    rec.set_log_time_enabled(not deterministic)
    rec.set_sinks(rr.FileSink(path))
    return rec


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
    return len(item.data) if isinstance(item, RawBytes) else _size(item)


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


def _within(action: Callable[[], object], timeout_s: float) -> bool:
    """Run an action that may hang; whether it ended in time."""
    thread = threading.Thread(target=action, name="deformscope-close", daemon=True)
    thread.start()
    thread.join(timeout_s)
    return not thread.is_alive()


def _leave_streams_alone() -> None:
    """Keep the end of the process from waiting for a stream that hangs."""
    import rerun as rr

    rr.unregister_shutdown()


def _sync(path: Path) -> None:
    """Have the operating system put a file or a folder on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
