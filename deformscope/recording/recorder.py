"""The recorder, through which everything is recorded or shown: the file, the live view, timelines, provenance.

A recording in progress is `NAME.part.rrd`, a file like any other recording. It becomes `NAME.rrd` after a normal end,
or when its subject was stopped and the recording holds that (`stopped_because`). A run that crashes or ends in an error
leaves this file with all its data (after a crash without the last moments). An existing `NAME.rrd` is not changed. An
unfinished recording is never overwritten.

What is recorded, prepared for rerun: images and results over them or over particles; device items, and the results
of an experiment or of stages that run meanwhile.

The outputs of a recording: its file, a live view, both or neither."""

import dataclasses
import json
import sys
import uuid
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from deformscope.frames import ColorFrame, DepthFrame, Frame, HealthReport, InputFile, Item, StageCost, StageResult
from deformscope.log.layout import IMAGES, Application, PictureLayout, RecordingLayout
from deformscope.recording import provenance
from deformscope.recording.lateness import Lateness, RecordingError
from deformscope.recording.live import LiveFeed, ViewerKind, live_stream, page_stream, start_viewer
from deformscope.recording.losses import losses_of
from deformscope.recording.portions import (
    GATHER_LIVE_S,
    GATHER_S,
    Portions,
    RisingTimes,
    arrays_size,
    counted_as,
    item_size,
)
from deformscope.recording.writer import Writer
from deformscope.session import Step
from deformscope.stages.map.exploration import StageFailure

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.live_stream import LiveStream
    from deformscope.log.rig import Batch
    from deformscope.recording.rrd_file import RecordingFile

COSTS_AT_ONCE = 200
"""Number of rows of costs that are written together."""


class Outputs:
    """The file and the live view of a recording, if any; only the writer's thread uses them."""

    def __init__(self) -> None:
        self.file: RecordingFile | None = None
        self.feed: LiveFeed[LiveStream] | None = None
        self._costs: list[tuple[int, int | None, StageCost]] = []

    def log(self, job: "Callable[[rr.RecordingStream], None]", size: int = 0) -> None:
        """Log to the file, and to the live view when it is ready. size: bytes that the job keeps alive"""
        if self.file is not None:
            self.file.log(job)
        self.show(lambda live: job(live.rec), size, lasting=True)

    def send(self, batch: "Batch", size: int) -> None:
        """Send encoded data; to the live view only those in one of its views."""
        self.keep(batch)
        self.show(lambda live: live.send(batch, lasting=True), size, lasting=True)

    def keep(self, batch: "Batch") -> None:
        """Send a batch to the file only."""
        if self.file is not None:
            self.file.send(batch)

    def add_cost(
        self, session_ns: int, cost: StageCost, *, frame: int | None = None, behind_ns: int | None = None
    ) -> None:
        """Gather a stage's cost for the file: many are written in one portion, as a portion takes a kilobyte.

        session_ns, frame: session time and frame of its result; behind_ns: time from there to the newest frame; None if
        frames wait, or continue"""
        if self.file is not None:
            behind_ms = None if behind_ns is None else behind_ns / 1e6
            self._costs.append((session_ns, frame, dataclasses.replace(cost, behind_ms=behind_ms)))
            if len(self._costs) >= COSTS_AT_ONCE:
                self.write_costs()

    def write_costs(self) -> None:
        """Write the costs that have been gathered."""
        if self._costs:
            from deformscope.log.rig.columns import prepare_costs

            self.keep(prepare_costs(self._costs))
            self._costs = []

    def show(self, job: "Callable[[LiveStream], None]", size: int, *, lasting: bool = False) -> None:
        """Log to the live view only. lasting: dropped last if the viewer is too slow"""
        if self.feed is not None:
            self.feed.put(job, size, lasting=lasting)

    def lay_out(self, views: "rr.blueprint.Blueprint", shown: "rr.blueprint.Blueprint") -> None:
        """Set the views of the file, and those of the window or page."""
        if self.file is not None:
            self.file.log(lambda rec: rec.send_blueprint(views))
        self.show(lambda live: live.rec.send_blueprint(shown), 0, lasting=True)


class Encoder(Protocol):
    """Encodes items for rerun, in the writer's thread, and gives them to the outputs."""

    def write_items(self, items: Sequence[Item], size: int) -> None:
        """Write items of devices, files or cameras."""

    def write_step(self, step: Step, size: int) -> None:
        """Write the results of a step."""

    def write_input(self, given: InputFile) -> None:
        """Write an input file only to the recording's file: no view shows it."""

    def write_overdue(self) -> None:
        """Write the items that have been gathered for long enough."""

    def write_rest(self) -> None:
        """Write the items that are still gathered, at the end."""


if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.canvas import Canvas
    from deformscope.log.live_stream import LiveStream
    from deformscope.log.rig import Batch, Place
    from deformscope.page.server.page_server import PageServer
    from deformscope.recording.target import RecordingTarget

BACKLOG_JOBS, BACKLOG_BYTES = 1 << 20, 512 << 20
"""Limit of waiting data of devices, which continue on their own clock."""
LATE = 8
"""The recording counts as late if 1 / this of its capacity waits."""
AHEAD_JOBS, AHEAD_BYTES = 16, 64 << 20
"""The same of sources that can wait for their recording."""
TICK_S = 0.1
SETTLE_TIMEOUT_S = 10.0
DRAIN_TIMEOUT_S = 60.0
LIVE_TIMEOUT_S = 3.0


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """Summary of a recording.

    path: the finished file, or the unfinished one after an error; None if no file was written
    dropped: portions (a frame, a step, an input, device items of a tenth of a second) without the viewer's
    confirmation; bytes: size of the file"""

    path: Path | None
    frames: int
    steps: int
    dropped: int
    bytes: int


class Recorder:
    """`with Recorder(file, "none", settings) as recorder: run(source, experiment, recorder)`.

    file: an `.rrd` to make; None = none. viewer: a window, a page for a browser, or none. Without file and viewer it
    does nothing and does not import rerun.
    settings: everything that determines the results, of JSON's types; application: kind of its recording
    deterministic: two runs of one input give recordings that `rerun rrd compare --unordered` finds equal. It leaves out
    differences between runs (start time, command line, versions, git state) and writes in larger portions
    real_time: its source does not wait, as devices do not: a disk that stays too slow ends the recording with a
    RecordingError. Otherwise a call of `write` waits if the disk is far behind
    whole_or_nothing: an error leaves no unfinished file, as its source can be read again

    The thread that calls `write` neither encodes nor waits for a disk. A thread of the recorder does that in order, so
    items must not be changed after the call. An error in that thread is raised by the next call, or at the end."""

    def __init__(
        self,
        file: Path | None,
        viewer: ViewerKind = "none",
        settings: Mapping[str, object] | None = None,
        *,
        application: Application = IMAGES,
        overwrite: bool = False,
        deterministic: bool = False,
        real_time: bool = False,
        whole_or_nothing: bool = False,
    ) -> None:
        self._target: RecordingTarget | None = None
        if file is not None:
            from deformscope.recording import target  # slow to import, as what else writes

            self._target = target.RecordingTarget(Path(file), overwrite=overwrite)
        self._viewer_kind = viewer
        self._settings = dict(settings or {})
        self._application = application
        self._deterministic = deterministic
        self._real_time = real_time
        self._whole_or_nothing = whole_or_nothing
        self._finished: RecordingSummary | None = None
        self._stopped = ""
        # what who calls knows
        self._frames = self._steps = self._inputs = 0
        self._counts: dict[str, int] = {}
        self._losses: dict[str, dict[str, float]] = {}
        self._writer: Writer | None = None
        self._lateness: Lateness | None = None
        self._page: PageServer | None = None
        # what the writer's thread alone writes to, until it has ended
        self._outputs = Outputs()
        self._encoder: Encoder = PictureEncoder(self._outputs, application.over_picture)
        self._not_shown: list[StageFailure] = []

    @property
    def active(self) -> bool:
        """Whether anything is recorded or shown."""
        return self._target is not None or self._viewer_kind != "none"

    @property
    def not_shown(self) -> tuple[StageFailure, ...]:
        """Results that were recorded, but could not be shown; waits until all results so far are drawn."""
        if self._writer is not None:
            self._writer.settle(SETTLE_TIMEOUT_S)
        return tuple(self._not_shown)

    @property
    def page(self) -> "PageServer | None":
        """The page that shows the recording."""
        return self._page

    def __enter__(self) -> "Recorder":
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

    def start(self, layout: RecordingLayout, start_ns: int, lossless: Collection[str] = ()) -> None:
        """From now on devices, and results computed from them, are recorded. layout: how, from the experiment;
        start_ns: the host's clock at session time 0; lossless: devices whose colour images are stored without loss"""
        if not self.active:
            return
        from deformscope.log.rig import log_streams

        def log_start(rec: "rr.RecordingStream") -> None:
            log_streams(rec, layout.streams)
            layout.log_start(rec)

        views = layout.blueprint()
        shown = layout.blueprint(on_page=True) if self._viewer_kind == "page" else views
        self._put(lambda: self._outputs.lay_out(views, shown), 0)
        self._put(lambda: self._outputs.log(log_start), 0)
        at_frames = PictureEncoder(self._outputs, None)
        gather_s = GATHER_LIVE_S if self._real_time else GATHER_S
        self._encoder = DeviceEncoder(self._outputs, layout, start_ns, lossless, at_frames, self._not_shown, gather_s)

    def write(self, items: object) -> None:
        """Record an object, or a sequence of objects, without loss; an empty sequence checks whether recording can
        continue.

        Items of devices, files and cameras (`deformscope.frames.Item`) have the time of their stamp, an `InputFile`
        that of the frame before it. The results of a `Step` have its time, or that of their frame, which a
        `StageResult` names."""
        given = tuple(items) if isinstance(items, Sequence) else (items,)
        if not given and self._writer is not None:
            self._writer.check()
        if taken := [one for one in given if isinstance(one, Item)]:
            self._take_items(taken)
        for one in given:
            match one:
                case Step():
                    self._take_step(one)
                case InputFile():
                    self._inputs += 1
                    if self.active:
                        self._put(partial(self._encoder.write_input, one), len(one.content))

    def stopped_because(self, reason: str) -> None:
        """End the recording of a run that ended early: it is complete, and holds the reason."""
        self._stopped = reason

    def summary(self) -> RecordingSummary:
        """Summary of the recording so far, or at its end."""
        if self._finished is not None:
            return self._finished
        part = None if self._target is None else self._target.part
        size = part.stat().st_size if part is not None and part.exists() else 0
        dropped = 0 if self._outputs.feed is None else self._outputs.feed.dropped
        return RecordingSummary(part, self._frames, self._steps, dropped, size)

    def _take_items(self, items: Sequence[Item]) -> None:
        if self._application.devices:
            for kind, count in Counter(map(counted_as, items)).items():
                self._counts[kind] = self._counts.get(kind, 0) + count
        for item in items:
            if isinstance(item, HealthReport):
                self._losses = losses_of(item)
        self._frames += sum(isinstance(item, Frame) for item in items)
        if self.active:
            size = sum(map(item_size, items))
            self._put(partial(self._encoder.write_items, items, size), size)

    def _take_step(self, step: Step) -> None:
        self._steps += 1
        if self._deterministic and step.costs:
            step = dataclasses.replace(step, costs=())
        if self.active and (step.results or step.moment is not None):
            results = (one.result if isinstance(one, StageResult) else one for one in step.results)
            size = sum(map(arrays_size, results))
            self._put(partial(self._encoder.write_step, step, size), size)

    # In the writer's thread ------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        """Between jobs, and several times a second while there are none."""
        if not self._deterministic:
            self._encoder.write_overdue()
            if self._outputs.file is not None:
                self._outputs.file.beat()

    def _write_last(self) -> None:
        self._encoder.write_rest()
        self._outputs.write_costs()
        if self._outputs.file is not None:
            self._outputs.file.flush()

    # Its beginning and its end ---------------------------------------------------------------------------------------

    def _open(self) -> None:
        if self._application.devices:
            from deformscope.log.rig import warm_up

            warm_up()  # before any device is opened: a second's delay in a session would overflow its queues
        recording_id = "deterministic" if self._deterministic else uuid.uuid4().hex
        properties = provenance.properties(self._settings, brief=self._deterministic)
        if self._viewer_kind != "none":
            self._outputs.feed = self._opened_view(recording_id, properties)
            self._outputs.feed.start()
        if self._target is not None:
            from deformscope.recording.rrd_file import RecordingFile

            self._outputs.file = RecordingFile(
                self._application.name,
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

    def _opened_view(self, recording_id: str, properties: Mapping[str, object]) -> "LiveFeed[LiveStream]":
        """A window, or a page, and its feed."""
        if self._viewer_kind == "native":
            viewer = start_viewer()
            print(viewer.where, file=sys.stderr, flush=True)
            return LiveFeed(partial(live_stream, self._application.name, recording_id, viewer, properties))
        from deformscope.page.server.page_server import PageServer

        self._page = page = PageServer(str(self._settings.get("rig_name") or self._settings.get("command") or ""))
        page.open()
        print(page.where, file=sys.stderr, flush=True)
        if self._application.robot_moves:  # whoever moves the arm or hand says what goes on
            page.session.show(recording="" if self._target is None else str(self._target.path))
        elif self._target is None:
            page.session.enter("live")
        else:
            page.session.recording_began(str(self._target.path))
        connect = partial(page_stream, self._application.name, recording_id, page.pieces, properties)
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
        path, file = None, self._outputs.file
        if file is not None and self._target is not None:
            if not file.broken:
                found: dict[str, object] = {"frames": self._frames, "steps": self._steps}
                found |= {"live_dropped": dropped, "complete": complete and failure is None}
                if self._stopped or failure is not None:
                    found["stopped"] = self._stopped or str(failure).split(" | ")[0]
                if self._counts:
                    found |= {"counts": json.dumps(self._counts), "losses": json.dumps(self._losses)}
                file.write_properties("outcome", found)
                try:
                    file.flush_last()
                except RecordingError as error:
                    failure = error
            whole = file.close()
            if complete and failure is None and not file.broken:
                counts = {"frames": self._frames, "steps": self._steps, "inputs": self._inputs, **self._counts}
                path = self._target.publish(whole, counts, self._losses)
            else:
                path = self._target.keep_unfinished(whole, worth_it=self._holds_something)
        size = path.stat().st_size if path is not None else 0
        self._finished = RecordingSummary(path, self._frames, self._steps, dropped, size)
        if complete and failure is not None:
            raise failure

    def _end_writing(self) -> Exception | None:
        """Have the writer finish; the error that prevented it."""
        writer, self._writer = self._writer, None
        if writer is None:
            return None
        if writer.close(DRAIN_TIMEOUT_S, self._write_last):
            return writer.failure
        if self._outputs.file is not None:
            self._outputs.file.broken = True
        return self._too_slow(writer.waiting_bytes)

    def _close_live(self) -> int:
        feed = self._outputs.feed
        if feed is None:
            return 0
        if not feed.close(LIVE_TIMEOUT_S):
            from deformscope.recording import rrd_file

            rrd_file.leave_streams_alone()
        if self._page is not None and self._page.session.state.phase != "stopped":
            self._page.session.enter("stopped", self._stopped or "its command has ended")
        return feed.dropped

    @property
    def _holds_something(self) -> bool:
        """Whether an unfinished recording is worth keeping."""
        # a robot's whose checks have not passed holds nothing but that its devices were there
        if self._whole_or_nothing:
            return False
        return bool(self._steps or self._inputs or (self._frames and not self._application.robot_moves))


class PictureEncoder:
    """An `Encoder`. layout: views that are sent as soon as the picture that they show is known, None = none"""

    def __init__(self, outputs: Outputs, layout: PictureLayout | None) -> None:
        self._outputs, self._layout = outputs, layout
        self._session_ns: dict[int, int] = {}
        self._first_ns = self._last_frame = 0
        self._canvas: Canvas | None = None
        self._limits = 0.0, 1.0

    def write_items(self, items: Sequence[Item], size: int) -> None:
        """Write images without loss, immediately; they are shown as JPEG, with a tenth of the bytes."""
        from deformscope.log.over_picture import canvas_of, prepare_image, range_of

        for frame in (item for item in items if isinstance(item, ColorFrame)):
            self._first_ns = self._first_ns if self._session_ns else frame.stamp.host_ns
            self._session_ns[frame.index] = frame.stamp.host_ns - self._first_ns
            self._last_frame = frame.index
            if self._canvas is None:
                self._canvas, self._limits = canvas_of(frame), range_of(frame.image)
                self._arrange(self._canvas)
            prepare = partial(prepare_image, frame, self._first_ns, self._limits)
            if self._outputs.file is not None:
                self._outputs.keep(prepare(lossless=True))
            self._outputs.show(partial(_send, prepare), size)

    def write_step(self, step: Step, size: int) -> None:
        """Write results at their frame, each over the picture that belongs to it."""
        from deformscope.log.canvas import Canvas
        from deformscope.log.over_picture import canvas_after, log_over_picture, picture_views
        from deformscope.log.views import stages_of

        times = self._times(step.frame)
        canvas = self._canvas or Canvas()
        shown = []
        for result in step.results:
            canvas = canvas_after(result, canvas)
            shown.append((result, canvas))
        for cost in step.costs:
            name = cost.stage or stages_of(type(step.results[0]), picture_views(canvas))[0].name
            self._outputs.add_cost(times[1], dataclasses.replace(cost, stage=name), frame=times[0])
        self._canvas = canvas
        if canvas != Canvas():
            self._arrange(canvas)

        def log(rec: "rr.RecordingStream") -> None:
            frame, session_ns = times
            rec.set_time("frame", sequence=frame)
            rec.set_time("session", duration=np.timedelta64(session_ns, "ns"))
            log_over_picture(rec, shown)

        self._outputs.log(log, size)

    def write_input(self, given: InputFile) -> None:
        """Write an input file at the time of the frame before it."""
        from deformscope.log.rig import prepare_input

        times = self._times(None)
        if self._outputs.file is not None:
            self._outputs.keep(prepare_input(given, *times))

    def write_overdue(self) -> None:
        """Nothing is gathered."""

    def write_rest(self) -> None:
        """Nothing is gathered."""

    def _times(self, frame: int | None) -> tuple[int, int]:
        """(frame, session [ns]) of a frame that was written, None = the last; pairs have frames without images, at time
        0."""
        frame = self._last_frame if frame is None else frame
        if self._session_ns and frame not in self._session_ns:
            raise ValueError(f"a step belongs to frame {frame}, which was never written")
        return frame, self._session_ns.get(frame, 0)

    def _arrange(self, canvas: "Canvas") -> None:
        """Send the views, once."""
        if self._layout is not None:
            from deformscope.log.blueprint import blueprint

            views, self._layout = blueprint(self._layout, canvas), None
            self._outputs.log(lambda rec: rec.send_blueprint(views))


def _send(prepare: "Callable[..., Batch]", live: "LiveStream") -> None:
    live.send(prepare(lossless=False))


class DeviceEncoder:
    """An `Encoder` that gathers device items into portions.

    layout: layout of the recording; start_ns: host time at which `session` is 0 [ns]; lossless: devices whose colour
    images are stored without loss; at_frames: number of frames, for inputs and for results without a time
    failed: receives results that could not be shown; gather_s: time over which items are gathered [s]"""

    def __init__(
        self,
        outputs: Outputs,
        layout: RecordingLayout,
        start_ns: int,
        lossless: Collection[str],
        at_frames: Encoder,
        failed: list[StageFailure],
        gather_s: float,
    ) -> None:
        self._outputs, self._layout, self._at_frames, self._failed = outputs, layout, at_frames, failed
        self._start_ns, self._streams, self._lossless = start_ns, layout.streams, frozenset(lossless)
        self._camera = next((stream.device for stream in layout.streams if stream.kind == "depth"), None)
        self._touch = self._newest_ns = 0
        self._pictures_ns = RisingTimes()
        self._portions = Portions(gather_s)
        self._scales: dict[str, tuple[object, int]] = {}
        self._results: list[StageResult] = []
        self._latest: dict[str, StageResult] = {}

    def __len__(self) -> int:
        """How many items wait."""
        return len(self._portions)

    def write_items(self, items: Sequence[Item], size: int) -> None:
        """Show items immediately, and gather them with others of the same touch."""
        self._newest_ns = max([self._newest_ns, *(item.stamp.host_ns for item in items if isinstance(item, Frame))])
        pictures = [item for item in items if isinstance(item, DepthFrame) and item.device == self._camera]
        self._pictures_ns.add([item.stamp.host_ns - self._start_ns for item in pictures])
        place = self._place_of(self._touch)
        self._outputs.show(lambda live: live.add_items(items, self._start_ns, self._streams, place), size)
        if self._outputs.file is not None:
            self._write(self._portions.add(items, self._touch, size))

    def write_step(self, step: Step, size: int) -> None:
        """Write results of stages with device items: a result with a time at that time, others at their frame."""
        if step.moment is not None:
            self._touch = self._layout.touch_after(step.results, step.moment.touch)
            session_ns, place = step.moment.now_ns - self._start_ns, self._place(step.moment.touch)
            if step.moment.seen_ns is not None:
                seen_ns = np.array([step.moment.seen_ns - self._start_ns])
                place = dataclasses.replace(place, frame=int(place.at(seen_ns)[0]))
            batch = self._layout.prepare(step.results, session_ns, place, step.moment.cell_m, self._failed)
            self._outputs.send(batch, size)
            for cost in step.costs:
                behind_ns = max(self._newest_ns - step.moment.now_ns, 0)
                self._outputs.add_cost(step.moment.now_ns - self._start_ns, cost, behind_ns=behind_ns)
            return
        live = [one for one in step.results if isinstance(one, StageResult)]
        if live:
            results = {one.stage: one for one in live}
            for cost in step.costs:
                of = results.get(cost.stage, live[-1])
                self._outputs.add_cost(of.host_ns - self._start_ns, cost, behind_ns=round(of.late_s * 1e9))
            self._outputs.show(lambda view: view.add_results(live, self._start_ns, self._streams), 0)
            self._results += live if self._outputs.file is not None else ()
        if len(step.results) > len(live):
            self._at_frames.write_step(step, size)

    def write_input(self, given: InputFile) -> None:
        self._at_frames.write_input(given)

    def write_overdue(self) -> None:
        self._write(self._portions.overdue())

    def write_rest(self) -> None:
        self._write(self._portions.rest())
        self._write_stage_results()

    def _write(self, portions: Iterable[tuple[list[Item], int]]) -> None:
        from deformscope.log.rig import prepare_items

        for items, touch in portions:
            self._write_stage_results()
            place = self._place_of(touch)
            self._outputs.keep(prepare_items(items, self._start_ns, self._streams, self._lossless, place, self._scales))

    def _write_stage_results(self) -> None:
        from deformscope.log.stages import prepare_stage_results

        if self._results:
            results, self._results = self._results, []
            self._outputs.keep(prepare_stage_results(results, self._start_ns, self._streams, self._latest))

    def _place_of(self, touch: int) -> "Place | None":
        return self._place(touch) if self._layout.by_touch else None

    def _place(self, touch: int) -> "Place":
        from deformscope.log.rig import Place

        return Place(touch, self._pictures_ns.all, start_ns=self._start_ns)
