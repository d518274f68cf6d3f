"""One moment of an exploration, at which results are logged."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from deformscope.log.rig.columns import Batch, Columns, moments, recorded
from deformscope.rows import ENTITIES, Result


class ResultBatch:
    """A batch, and the place on the timelines of all that is logged to it."""

    def __init__(self, batch: Batch, session_ns: int) -> None:
        self._batch = batch
        self._times = moments([session_ns], 0)

    def send(self, path: str, columns: Columns) -> None:
        """One row of an entity."""
        self._batch.send_columns(path, self._times, columns)

    def log_static(self, path: str, entity: rr.AsComponents) -> None:
        """What holds throughout, known only now."""
        self._batch.log(path, entity, static=True)

    def record(self, result: Result) -> None:
        """Every field of a result, without loss."""
        self.send(ENTITIES[type(result)], recorded([result]))

    def show_png(self, path: str, png: bytes) -> None:
        self.send(path, rr.EncodedImage.columns(blob=[png], media_type=["image/png"]))

    def show_points(self, path: str, points: Any, colors: Any, radius: float, labels: list[str] | None = None) -> None:
        """points: (n, 3); colors: one, or (n, 3)"""
        many = len(points)
        tints = np.broadcast_to(np.asarray(colors, np.uint8), (many, 3))
        columns = [
            *rr.Points3D.columns(positions=np.asarray(points, np.float32), colors=tints).partition([many]),
            *rr.Points3D.columns(radii=[radius]),
        ]
        if labels is not None:
            columns += rr.Points3D.columns(labels=labels).partition([many])
            columns += rr.Points3D.columns(show_labels=[True])
        self.send(path, columns)

    def show_lines(self, path: str, strips: Any, color: Any, radius: float) -> None:
        """strips: (n, 2 or more, 3)"""
        many = len(strips)
        columns = [
            *rr.LineStrips3D.columns(strips=np.asarray(strips, np.float32)).partition([many]),
            *rr.LineStrips3D.columns(colors=[color], radii=[radius]),
        ]
        self.send(path, columns)
