"""Results of one time, prepared for rerun."""

from collections.abc import Callable, Mapping
from typing import Any, ParamSpec

import numpy as np
import numpy.typing as npt
import rerun as rr

from deformscope.log.rig.columns import Batch, moments, recorded, scalars, states
from deformscope.pictures.palette import BAD, Rgb
from deformscope.pictures.render_process import render
from deformscope.rows import ENTITIES, SERIES

P = ParamSpec("P")


def png_view(path: str, draw: Callable[..., bytes], *more: object) -> "Callable[[ResultBatch, Any], None]":
    """The view that logs the PNG of a result. draw: a function of a module, called with the result and `more`"""
    return lambda now, result: now.show_png(path, draw, result, *more)


class ResultBatch:
    """A batch, and the place on the timelines at which its rows are logged."""

    def __init__(self, batch: Batch, session_ns: int) -> None:
        self.batch = batch
        self._times = moments([session_ns], 0)

    def show(self, path: str, entity: rr.AsComponents) -> None:
        """Log one row of an entity."""
        self.batch.show(path, self._times, entity)

    def record(self, result: Any) -> None:
        """Every field of a result, without loss: one row, or those of a series."""
        if (path := SERIES.get(type(result))) is not None:
            own = rr.AnyValues.columns(host_ns=result.host_ns)
            self.batch.send_series(path, result.host_ns, [*scalars(result.values), *own])
            return
        self.batch.send_columns(ENTITIES[type(result)], self._times, recorded([result]))

    def show_png(self, path: str, draw: Callable[P, bytes], *given: P.args, **named: P.kwargs) -> None:
        """Log the PNG that `draw`, a function of a module, makes from its arguments."""
        self.show(path, rr.EncodedImage(contents=render(draw, *given, **named), media_type="image/png"))

    def show_text(self, path: str, markdown: str) -> None:
        """A document."""
        self.show(path, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))

    def show_words(self, path: str, text: str, level: str) -> None:
        """Log a line of text."""
        self.show(path, rr.TextLog(text, level=level))

    def show_stop(self, stop: Any) -> None:
        """Log the end by a fault."""
        self.show_words(ENTITIES[type(stop)], f"{stop.kind}: {stop.reason}", "ERROR")

    def show_phase(self, phase: Any, known: Mapping[str, Rgb]) -> None:
        """Log a phase, shown on a lane over time. known: phases whose colour was logged before; the phase of a stop,
        whose name states why, is never among them"""
        path = ENTITIES[type(phase)]
        if phase.name not in known:
            self.batch.log(path, states({**known, phase.name: BAD}), static=True)
        self.show(path, rr.StateChange(state=phase.name))

    def show_points(
        self, path: str, points: npt.ArrayLike, colors: npt.ArrayLike, radius: float, labels: list[str] | None = None
    ) -> None:
        """points: (n, 3); colors: one colour, or (n, 3)"""
        named: dict[str, Any] = {} if labels is None else {"labels": labels, "show_labels": True}
        self.show(path, rr.Points3D(np.asarray(points, np.float32), colors=colors, radii=radius, **named))

    def show_lines(self, path: str, strips: npt.ArrayLike, color: npt.ArrayLike, radius: float) -> None:
        """strips: (n, 2 or more, 3)"""
        self.show(path, rr.LineStrips3D(np.asarray(strips, np.float32), colors=color, radii=radius))
