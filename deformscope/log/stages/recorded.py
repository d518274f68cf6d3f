"""A stage's results without loss, one row each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import rerun as rr

from deformscope.frames import StageResult
from deformscope.log.rig.columns import Batch, moments, root
from deformscope.rows import components

_ARROW = {"float64": pa.float64(), "int64": pa.int64(), "bool": pa.bool_(), "string": pa.string()}


def log_recorded(batch: Batch, stage: str, device: str, results: Sequence[StageResult], start_ns: int) -> None:
    """Results of one kind: their own fields, and those of the class of `StageResult` but times that `session` holds."""
    rows = [{**_envelope(one), **_fields(one.result)} for one in results]
    columns: list[rr.ComponentColumn] = []
    for name in dict.fromkeys(name for row in rows for name in row):
        kind = next(row[name][0] for row in rows if name in row)
        values = [row[name][1] if name in row else [] for row in rows]
        archetype, component = name.split(":")
        flat = pa.array([value for row in values for value in row], _ARROW[kind])
        made = rr.DynamicArchetype.columns(archetype=archetype, components={component: flat})
        columns += made.partition([len(row) for row in values])
    places = rr.TimeColumn("frame", sequence=np.array([one.used[-1].last for one in results], np.int64))
    times = [*moments([one.host_ns for one in results], start_ns), places]
    batch.send_columns(root(f"stage/{stage}", device), times, columns)


Cell = tuple[str, list[object]]


def _envelope(one: StageResult) -> dict[str, Cell]:
    return {
        "StageResult:stage": ("string", [one.stage]),
        "StageResult:device": ("string", [used.device for used in one.used]),
        "StageResult:first": ("int64", [used.first for used in one.used]),
        "StageResult:last": ("int64", [used.last for used in one.used]),
        "StageResult:host_ns": ("int64", [one.host_ns]),
        "StageResult:skipped": ("int64", [one.skipped]),
        "StageResult:late_s": ("float64", [one.late_s]),
    }


def _fields(result: object) -> dict[str, Cell]:
    kind = type(result).__name__
    return {f"{kind}:{name}": (arrow, list(values)) for name, (arrow, values) in components(result).items()}
