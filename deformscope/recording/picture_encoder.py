"""What is recorded, prepared for rerun: images and results over them or over particles; device items, and the results
of an experiment or of stages that run meanwhile."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from deformscope.frames import ColorFrame, InputFile, Item
from deformscope.log.layout import PictureLayout
from deformscope.recording.outputs import Outputs
from deformscope.session import Step

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.canvas import Canvas
    from deformscope.log.live_stream import LiveStream
    from deformscope.log.rig import Batch
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

from deformscope.frames import DepthFrame, Frame, StageResult
from deformscope.log.layout import RecordingLayout
from deformscope.recording.outputs import Encoder
from deformscope.recording.portions import Portions, RisingTimes
from deformscope.stages.map.exploration import StageFailure

if TYPE_CHECKING:
    from deformscope.log.rig import Place


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
