"""A stage's results without loss, one row each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from deformscope.frames import StageResult
from deformscope.log.rig.columns import Batch, moments, root
from deformscope.rows import to_columns


def log_recorded(batch: Batch, stage: str, device: str, results: Sequence[StageResult], start_ns: int) -> None:
    """Results of one kind: the fields of `StageResult`, and those of what it holds."""
    columns = [*_columns(results, ("result",)), *_columns([one.result for one in results])]
    places = rr.TimeColumn("frame", sequence=np.array([one.used[-1].last for one in results], np.int64))
    times = [*moments([one.host_ns for one in results], start_ns), places]
    batch.send_columns(root(f"stage/{stage}", device), times, columns)


def _columns(objects: Sequence[object], leave_out: Sequence[str] = ()) -> list[rr.ComponentColumn]:
    found: list[rr.ComponentColumn] = []
    for name, column in to_columns(objects, leave_out).items():
        made = rr.DynamicArchetype.columns(archetype=type(objects[0]).__name__, components={name: column.values})
        found += made.partition(column.lengths)
    return found
