"""Images of a file or a camera, and results over them or over particles, prepared for rerun."""

from __future__ import annotations

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
        from deformscope.log.sequence import canvas_of, prepare_image, range_of

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

        def log(rec: rr.RecordingStream) -> None:
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

    def _arrange(self, canvas: Canvas) -> None:
        """Send the views, once."""
        if self._layout is not None:
            from deformscope.log.blueprint import blueprint

            views, self._layout = blueprint(self._layout, canvas), None
            self._outputs.log(lambda rec: rec.send_blueprint(views))


def _send(prepare: Callable[..., Batch], live: LiveStream) -> None:
    live.send(prepare(lossless=False))
