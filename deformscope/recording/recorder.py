"""Everything that is recorded or shown goes through here: the file, the live view, timelines, provenance.

A recording in progress is `NAME.part.rrd`, a file like any other recording; it becomes `NAME.rrd` when all went well,
or when what it records was stopped and the recording holds that (`stopped_because`). A run that crashes, or that ends
in an error, leaves it there with all it had (a crash: but for the last moments), and whatever `NAME.rrd` was before is
untouched. An unfinished recording is never written over.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import uuid
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.frames import ColorFrame, DepthFrame, Frame, HealthReport, InputFile, Item, StageResult, Stream
from deformscope.recording import provenance
from deformscope.recording.lateness import Lateness, RecordingError
from deformscope.recording.live import LiveFeed, ViewerKind, live_stream, page_stream, start_viewer
from deformscope.recording.losses import losses_of
from deformscope.recording.portions import Portions, RisingTimes, arrays_size, counted_as, item_size
from deformscope.recording.rrd_file import RecordingFile, leave_streams_alone
from deformscope.recording.target import RecordingTarget
from deformscope.recording.writer import Writer
from deformscope.session import Moment, Step
from deformscope.stages.map.exploration import PlannedTouch, StageFailure

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.blueprint import Layout

    RecordingLayout = Layout | Literal["rig", "exploration", "squeeze", "findings"]
    from deformscope.log.canvas import Canvas
    from deformscope.log.live_stream import LiveStream
    from deformscope.log.rig import Batch, Place
    from deformscope.log.squeeze import Fingertips
    from deformscope.page.server.page_server import PageServer

APPLICATIONS: dict[RecordingLayout, str] = {
    "images": "deformscope",
    "flow": "deformscope-flow",
    "pair": "deformscope-pair",
    "pair-3d": "deformscope-pair-3d",
    "rig": "deformscope-rig",
    "exploration": "deformscope-exploration",
    "squeeze": "deformscope-squeeze",
    "findings": "deformscope-findings",
}
"""rerun's application of each layout: a viewer keeps one set of views an application, and these differ."""
BACKLOG_JOBS, BACKLOG_BYTES = 1 << 20, 512 << 20
"""What may wait to be written of devices, which go on by themselves."""
LATE = 8
"""The recording is late when a share of 1 in so many of it waits."""
AHEAD_JOBS, AHEAD_BYTES = 16, 64 << 20
"""The same of what can itself wait for its recording."""
TICK_S = 0.1
SETTLE_TIMEOUT_S = 10.0
DRAIN_TIMEOUT_S = 60.0
LIVE_TIMEOUT_S = 3.0


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
    variant: distinguishes recordings of one layout whose views differ: a viewer keeps one set of views an application
    deterministic: two runs of one input give recordings that `rerun rrd compare --unordered` finds equal; leaves
    out what differs between runs (start time, command line, versions, git state) and writes in larger portions
    real_time: what is recorded goes on by itself, as devices do: a disk that stays too slow for it ends the recording
    with a RecordingError. Otherwise whoever writes waits, once the disk is far behind

    Nothing is encoded, and no disk waited for, in the thread that calls `write`: that is done in order in a thread
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
        self._target = None if file is None else RecordingTarget(Path(file), overwrite=overwrite)
        self._viewer_kind = viewer
        self._settings = dict(settings or {})
        self._layout: RecordingLayout = layout
        self._application = f"{APPLICATIONS[layout]}-{variant}" if variant else APPLICATIONS[layout]
        self._deterministic = deterministic
        self._real_time = real_time
        self._finished: RecordingSummary | None = None
        self._stopped = ""
        # what who calls knows
        self._session_ns: dict[int, int] = {}
        self._first_ns = self._last_frame = self._touch = 0
        self._frames = self._steps = self._inputs = 0
        self._counts: dict[str, int] = {}
        self._losses: dict[str, dict[str, float]] = {}
        self._streams: tuple[Stream, ...] = ()
        self._fingertips: Fingertips | None = None
        self._lossless: frozenset[str] = frozenset()
        # what the writer's thread alone touches, until it has ended
        self._writer: Writer | None = None
        self._lateness: Lateness | None = None
        self._file: RecordingFile | None = None
        self._feed: LiveFeed[LiveStream] | None = None
        self._page: PageServer | None = None
        self._canvas: Canvas | None = None
        self._arranged = False
        self._limits = 0.0, 1.0
        self._pictures_ns = RisingTimes()
        self._scales: dict[str, tuple[object, int]] = {}
        self._not_shown: list[StageFailure] = []
        self._portions = Portions()
        self._results: list[StageResult] = []
        self._latest: dict[str, StageResult] = {}

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
    def page(self) -> PageServer | None:
        """The page that it is shown on."""
        return self._page

    def __enter__(self) -> Recorder:
        if self.active:
            if self._target is not None:
                self._target.reserve()
            try:
                self._open()
            except BaseException:
                if self._target is not None:
                    self._target.give_up()
                raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        if self.active and self._finished is None:
            try:
                self._close(complete=kind is None)
            finally:
                if self._target is not None:
                    self._target.release()

    # What is handed over ---------------------------------------------------------------------------------------------

    def start_rig(
        self,
        streams: Sequence[Stream],
        start_ns: int,
        lossless: Collection[str] = (),
        stages: Sequence[tuple[str, str]] = (),
    ) -> None:
        """From here on it is the devices of a rig that are recorded.

        start_ns: the host's clock at session time 0; lossless: devices whose colour images are kept without loss
        stages: (name, device) of those whose results will come
        """
        self._lossless = frozenset(lossless)
        if not self.active:
            return
        from deformscope.log.rig import rig_blueprint

        if not stages:
            shown = rig_blueprint(streams, health=False) if self._viewer_kind == "page" else None
            self._start(streams, start_ns, rig_blueprint(streams), shown)
            return
        from deformscope.log.stages import log_stage_streams, stage_blueprint

        self._start(streams, start_ns, stage_blueprint(stages, streams))
        given, running = self._streams, tuple(stages)
        self._put(lambda: self._emit(lambda rec: log_stage_streams(rec, running, given), 0), 0)

    def start_exploration(
        self,
        streams: Sequence[Stream],
        start_ns: int,
        size_m: tuple[float, float],
        base_from_surface: FloatArray | None,
        *,
        truth: bool,
        lumps: bool = False,
        mapped: str = "stiffness",
    ) -> None:
        """From here on it is an exploration that is recorded, and its devices.

        size_m: of the surface; base_from_surface: (4, 4); truth: whether it is known; lumps: whether they are sought
        mapped: as of `MapEstimate`
        """
        if self.active:
            from deformscope.log.exploration import exploration_blueprint, log_exploration_start

            views = partial(exploration_blueprint, streams, size_m, truth=truth, lumps=lumps, mapped=mapped)
            self._start(streams, start_ns, views(), views(tabs=True) if self._viewer_kind == "page" else None)
            given = self._streams
            self._put(lambda: self._emit(lambda rec: log_exploration_start(rec, given, base_from_surface), 0), 0)

    def start_squeeze(
        self,
        streams: Sequence[Stream],
        start_ns: int,
        tactile: str,
        pads: Sequence[int],
        camera: str,
        *,
        around_px: tuple[float, float, float, float] | None = None,
        named: bool = False,
    ) -> None:
        """From here on it is a squeeze that is recorded, and its devices.

        tactile, pads: the device and the pads of the fingertips that squeeze; camera: the depth camera, or empty
        around_px: left, top, right, bottom of what its view shows, None = all; named: a model names the content
        """
        if self.active:
            from deformscope.log.squeeze import fingertips_of, log_squeeze_start, squeeze_blueprint

            self._start(streams, start_ns, squeeze_blueprint(streams, tactile, camera, around_px, named=named))
            self._fingertips = fingertips = fingertips_of(streams, tactile, pads)
            self._put(lambda: self._emit(lambda rec: log_squeeze_start(rec, fingertips), 0), 0)

    def write(self, items: object) -> None:
        """Record one thing, or a sequence of things, without loss; an empty one asks whether it can go on.

        What devices, files and cameras give (`deformscope.frames.Item`) stands at its own stamp, an `InputFile` at the
        frame before it. The results of a `Step` stand at its moment, or at the frame that they belong to, which a
        `StageResult` names.
        """
        given = tuple(items) if isinstance(items, Sequence) else (items,)
        if not given and self._writer is not None:
            self._writer.check()
        if taken := [one for one in given if isinstance(one, Item)]:
            self._take_items(taken)
        for one in given:
            match one:
                case Step(moment=None):
                    self._take_step(one)
                case Step(moment=Moment() as moment):
                    self._take_results(one.results, moment)
                case InputFile():
                    self._take_input(one)

    def stopped_because(self, reason: str) -> None:
        """What is recorded ended before its time, and the recording with it: whole, and saying why."""
        self._stopped = reason

    def summary(self) -> RecordingSummary:
        """What was recorded so far, or in the end."""
        if self._finished is not None:
            return self._finished
        part = None if self._target is None else self._target.part
        size = part.stat().st_size if part is not None and part.exists() else 0
        dropped = self._feed.dropped if self._feed is not None else 0
        return RecordingSummary(part, self._frames, self._steps, dropped, size)

    @property
    def _of_devices(self) -> bool:
        return self._layout in ("rig", "exploration", "squeeze")

    def _start(
        self,
        streams: Sequence[Stream],
        start_ns: int,
        views: rr.blueprint.Blueprint,
        shown: rr.blueprint.Blueprint | None = None,
    ) -> None:
        """shown: the views of the window or page; None: those of the file"""
        from deformscope.log.rig import log_streams

        self._streams, self._first_ns = tuple(streams), start_ns
        given = self._streams
        self._put(lambda: self._lay_out(views, shown or views), 0)
        self._put(lambda: self._emit(lambda rec: log_streams(rec, given), 0), 0)

    def _take_items(self, items: Sequence[Item]) -> None:
        if self._of_devices:
            for kind, count in Counter(map(counted_as, items)).items():
                self._counts[kind] = self._counts.get(kind, 0) + count
        for item in items:
            if isinstance(item, HealthReport):
                self._losses = losses_of(item)
            elif isinstance(item, ColorFrame) and not self._of_devices:
                self._first_ns = self._first_ns if self._session_ns else item.stamp.host_ns
                self._session_ns[item.index] = item.stamp.host_ns - self._first_ns
                self._last_frame = item.index
        self._frames += sum(isinstance(item, Frame) for item in items)
        if self.active:
            touch, size = self._touch, sum(map(item_size, items))
            write = self._write_items if self._of_devices else self._write_images
            self._put(lambda: write(items, touch, size), size)

    def _take_step(self, step: Step) -> None:
        self._steps += 1
        live = tuple(one for one in step.results if isinstance(one, StageResult))
        if self.active and live:
            self._put(lambda: self._take_stage_results(live), sum(arrays_size(one.result) for one in live))
        if self.active and len(step.results) > len(live):
            times = self._times(self._last_frame if step.frame is None else step.frame)
            size = sum(map(arrays_size, step.results))
            self._put(lambda: self._write_step(step, times, size), size)

    def _take_results(self, results: tuple[object, ...], moment: Moment) -> None:
        """Of an exploration, or of a squeeze."""
        # what the devices give from the plan of a touch on belongs to that touch
        self._touch = moment.touch + any(
            isinstance(result, PlannedTouch) and result.target_m is not None for result in results
        )
        self._steps += 1
        if not self.active:
            return
        size, session_ns = sum(map(arrays_size, results)), moment.now_ns - self._first_ns

        def write() -> None:
            if self._layout == "squeeze":
                from deformscope.log.squeeze import prepare_squeeze_results

                batch = prepare_squeeze_results(results, session_ns, self._fingertips)
            else:
                from deformscope.log.exploration import prepare_results

                place = self._place(moment.touch, moment.seen_ns)
                batch = prepare_results(results, session_ns, place, cell_m=moment.cell_m, failed=self._not_shown)
            if self._file is not None:
                self._file.send(batch)
            self._show(lambda live: live.send(batch, lasting=True), size, lasting=True)

        self._put(write, size)

    def _take_input(self, given: InputFile) -> None:
        self._inputs += 1
        if self.active:
            times = self._times(self._last_frame)
            self._put(lambda: self._write_input(given, times), len(given.content))

    def _times(self, frame: int) -> tuple[int, int]:
        """(frame, session [ns]) of a frame that was written; pairs have frames without images, at time 0."""
        if self._session_ns and frame not in self._session_ns:
            raise ValueError(f"a step belongs to frame {frame}, which was never written")
        return frame, self._session_ns.get(frame, 0)

    # In the writer's thread ------------------------------------------------------------------------------------------

    def _write_items(self, items: Sequence[Item], touch: int, size: int) -> None:
        """Of devices: gathered with others of the same touch."""
        camera = next((stream.device for stream in self._streams if stream.kind == "depth"), None)
        pictures = [item for item in items if isinstance(item, DepthFrame) and item.device == camera]
        self._pictures_ns.add([item.stamp.host_ns - self._first_ns for item in pictures])
        start_ns, streams, place = self._first_ns, self._streams, self._place_of(touch)
        self._show(lambda live: live.add_items(items, start_ns, streams, place), size)
        if self._file is not None:
            self._write_gathered(self._portions.add(items, touch, size))

    def _take_stage_results(self, results: Sequence[StageResult]) -> None:
        """Shown at once, and written with what devices give."""
        start_ns, streams = self._first_ns, self._streams
        self._show(lambda live: live.add_results(results, start_ns, streams), 0)
        self._results += results if self._file is not None else ()

    def _write_stage_results(self) -> None:
        from deformscope.log.stages import prepare_stage_results

        results, self._results = self._results, []
        if results and self._file is not None:
            self._file.send(prepare_stage_results(results, self._first_ns, self._streams, self._latest))

    def _write_gathered(self, portions: Iterable[tuple[list[Item], int]]) -> None:
        from deformscope.log.rig import prepare_items

        for items, touch in portions:
            if self._results:
                self._write_stage_results()
            place = self._place_of(touch)
            batch = prepare_items(items, self._first_ns, self._streams, self._lossless, place, self._scales)
            if self._file is not None:
                self._file.send(batch)

    def _write_images(self, items: Sequence[Item], touch: int, size: int) -> None:
        """Of a file: without loss, at once; shown as JPEG, a tenth of the bytes."""
        from deformscope.log.sequence import canvas_of, prepare_image, range_of

        for frame in (item for item in items if isinstance(item, ColorFrame)):
            if self._canvas is None:
                self._canvas, self._limits = canvas_of(frame), range_of(frame.image)
                if not self._layout.startswith("pair"):
                    self._arrange()
            show = partial(prepare_image, frame, self._first_ns, self._limits)
            if self._file is not None:
                self._file.send(show(lossless=True))
            self._show(partial(_send_shown, show), size)

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

    def _write_input(self, given: InputFile, times: tuple[int, int]) -> None:
        """To the file alone: no view shows it."""
        from deformscope.log.rig import prepare_input

        if self._file is not None:
            self._file.send(prepare_input(given, *times))

    def _place_of(self, touch: int) -> Place | None:
        return self._place(touch) if self._layout == "exploration" else None

    def _place(self, touch: int, seen_ns: int | None = None) -> Place:
        """On an exploration's timelines."""
        from deformscope.log.rig import Place

        place = Place(touch, self._pictures_ns.all)
        if seen_ns is None:
            return place
        return dataclasses.replace(place, frame=int(place.at(np.array([seen_ns - self._first_ns]))[0]))

    def _arrange(self) -> None:
        """Send the views, once, as soon as it is known what they show."""
        from deformscope.log.blueprint import blueprint

        layout = self._layout
        if layout == "rig" or layout == "exploration" or layout == "squeeze" or layout == "findings":
            return  # these views come with what they show
        if not self._arranged and self._canvas is not None:
            self._arranged = True
            views = blueprint(layout, self._canvas)
            self._emit(lambda rec: rec.send_blueprint(views), 0)

    def _emit(self, job: Callable[[rr.RecordingStream], None], size: int) -> None:
        """To the file, and to the live view when it comes to it."""
        if self._file is not None:
            self._file.log(job)
        self._show(lambda live: job(live.rec), size, lasting=True)

    def _lay_out(self, views: rr.blueprint.Blueprint, shown: rr.blueprint.Blueprint) -> None:
        if self._file is not None:
            self._file.log(lambda rec: rec.send_blueprint(views))
        self._show(lambda live: live.rec.send_blueprint(shown), 0, lasting=True)

    def _show(self, job: Callable[[LiveStream], None], size: int, *, lasting: bool = False) -> None:
        """To the live view alone. lasting: dropped last where the viewer cannot follow"""
        if self._feed is not None:
            self._feed.put(job, size, lasting=lasting)

    def _tick(self) -> None:
        """Between jobs, and several times a second while there are none."""
        if not self._deterministic:
            self._write_gathered(self._portions.overdue())
            if self._file is not None:
                self._file.beat()

    def _write_last(self) -> None:
        self._write_gathered(self._portions.rest())
        if self._results:
            self._write_stage_results()
        if self._file is not None:
            self._file.flush()

    # Its beginning and its end ---------------------------------------------------------------------------------------

    def _open(self) -> None:
        os.environ.setdefault("RUST_LOG", "off")  # what rerun would print, this recorder notices and says itself
        if self._of_devices:
            from deformscope.log.rig import warm_up

            warm_up()  # before any device is opened: a second's delay in a session would overflow its queues
        recording_id = "deterministic" if self._deterministic else uuid.uuid4().hex
        properties = provenance.properties(self._settings, brief=self._deterministic)
        if self._viewer_kind != "none":
            self._feed = self._opened_view(recording_id, properties)
            self._feed.start()
        if self._target is not None:
            self._file = RecordingFile(
                self._application,
                recording_id,
                self._target.part,
                properties,
                name="" if self._deterministic else self._target.path.stem,
                deterministic=self._deterministic,
            )
        if self._real_time:
            self._writer = Writer(self._tick, TICK_S, BACKLOG_JOBS, BACKLOG_BYTES, self._too_slow)
        else:
            self._writer = Writer(self._tick, TICK_S, AHEAD_JOBS, AHEAD_BYTES)
        self._writer.start()
        self._lateness = Lateness(BACKLOG_BYTES // LATE, self._writer.thread_id)

    def _opened_view(self, recording_id: str, properties: Mapping[str, object]) -> LiveFeed[LiveStream]:
        """A window, or a page, and what feeds it."""
        if self._viewer_kind == "native":
            viewer = start_viewer()
            print(viewer.where, file=sys.stderr, flush=True)
            return LiveFeed(partial(live_stream, self._application, recording_id, viewer, properties))
        from deformscope.page.server.page_server import PageServer

        self._page = page = PageServer(str(self._settings.get("rig_name") or self._settings.get("command") or ""))
        page.open()
        print(page.where, file=sys.stderr, flush=True)
        if self._layout in ("exploration", "squeeze"):  # whoever moves the arm or hand says what goes on
            page.session.show(recording="" if self._target is None else str(self._target.path))
        elif self._target is None:
            page.session.enter("live")
        else:
            page.session.recording_began(str(self._target.path))
        connect = partial(page_stream, self._application, recording_id, page.pieces, properties)
        return LiveFeed(connect, period_s=lambda: page.pieces.period_s)

    def _put(self, job: Callable[[], None], size: int) -> None:
        """Have the writer's thread do it, in order. From any thread."""
        if self._writer is None or self._lateness is None:
            raise ValueError("nothing can be written before the recorder's context, or after it")
        self._lateness.look(self._writer.waiting_bytes)
        self._writer.put(job, size)

    def _too_slow(self, waiting_bytes: int) -> Exception:
        assert self._lateness is not None
        return self._lateness.error(waiting_bytes, Path() if self._target is None else self._target.part)

    def _close(self, *, complete: bool) -> None:
        """End the file and the live view, each within its time; give the file its name where all went well."""
        failure = self._end_writing()  # safe on the disk before anything waits for a viewer
        dropped = self._close_live()
        path = None
        if self._file is not None and self._target is not None:
            if not self._file.broken:
                self._file.write_properties("outcome", self._outcome(dropped, failure, whole=complete))
                try:
                    self._file.flush_last()
                except RecordingError as error:
                    failure = error
            whole = self._file.close()
            if complete and failure is None and not self._file.broken:
                counts = {"frames": self._frames, "steps": self._steps, "inputs": self._inputs, **self._counts}
                path = self._target.publish(whole, counts, self._losses)
            else:
                path = self._target.keep_unfinished(whole, worth_it=self._holds_something)
        size = path.stat().st_size if path is not None else 0
        self._finished = RecordingSummary(path, self._frames, self._steps, dropped, size)
        if complete and failure is not None:
            raise failure

    def _outcome(self, dropped: int, failure: Exception | None, *, whole: bool) -> dict[str, object]:
        found: dict[str, object] = {"frames": self._frames, "steps": self._steps}
        found |= {"live_dropped": dropped, "complete": whole and failure is None}
        if self._stopped or failure is not None:
            found["stopped"] = self._stopped or str(failure).split(" | ")[0]
        if self._counts:
            found |= {"counts": json.dumps(self._counts), "losses": json.dumps(self._losses)}
        return found

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

    def _close_live(self) -> int:
        if self._feed is None:
            return 0
        if not self._feed.close(LIVE_TIMEOUT_S):
            leave_streams_alone()
        if self._page is not None and self._page.session.state.phase != "stopped":
            self._page.session.enter("stopped", self._stopped or "its command has ended")
        return self._feed.dropped

    @property
    def _holds_something(self) -> bool:
        """Whether an unfinished recording is worth keeping."""
        # an exploration whose checks have not passed holds nothing but that its devices were there
        return bool(self._steps or self._inputs or (self._frames and self._layout not in ("exploration", "squeeze")))


def _send_shown(show: Callable[..., Batch], live: LiveStream) -> None:
    live.send(show(lossless=False))


def _set_times(rec: rr.RecordingStream, times: tuple[int, int]) -> None:
    frame, session_ns = times
    rec.set_time("frame", sequence=frame)
    rec.set_time("session", duration=np.timedelta64(session_ns, "ns"))
