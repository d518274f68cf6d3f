"""Which stages of computation a recording holds, counted by rerun's own reader."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.log.views import ShownStage
from deformscope.recording.utf8_path import utf8_path

if TYPE_CHECKING:
    from pyarrow import RecordBatch

LIVE_MS = 1000.0
"""A stage is live whose results stand so shortly before the newest frame, in the median [ms]."""


@dataclass(frozen=True, slots=True)
class RecordedStage:
    """A stage as a recording has it.

    timelines: of its rows; computed: how often it was; wall_ms, cpu_ms: each time, in the mean; behind_ms: how long
    before the newest frame its results stand, in the median; None where its costs, or that, were not recorded
    missing: rows were to be expected, by the recording's settings, and there are none
    """

    name: str
    chapter: int
    gives: str
    entity: str
    timelines: tuple[str, ...]
    rows: int
    computed: int
    wall_ms: float | None
    cpu_ms: float | None
    behind_ms: float | None
    missing: bool
    asked: str

    @property
    def live(self) -> bool | None:
        """Whether results came while the devices went on; None where that was not recorded."""
        return None if self.behind_ms is None else self.behind_ms <= LIVE_MS


@dataclass(slots=True)
class _Counted:
    """rows: by entity and column; timelines: by entity; costs: (wall, cpu, behind) by stage [ms]"""

    settings: Mapping[str, Any] = field(default_factory=dict)
    rows: dict[str, dict[str, int]] = field(default_factory=lambda: defaultdict(lambda: defaultdict(int)))
    timelines: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    costs: dict[str, list[tuple[float, float, float]]] = field(default_factory=lambda: defaultdict(list))


def recorded_stages(path: Path) -> list[RecordedStage]:
    """All that are registered for recordings of its kind, by chapter; whether they are in it or not."""
    from rerun.chunk import RrdReader

    from deformscope.log.registered import stages_in

    reader = RrdReader(utf8_path(path))
    store = next(one for one in reader.recordings() if one.application_id.startswith("deformscope"))
    counted = _Counted()
    for chunk in reader.stream(store=store):
        entity, batch = chunk.entity_path.strip("/"), chunk.to_record_batch()
        if entity == "__properties/session" and "settings" in batch.schema.names:
            counted.settings = json.loads(batch.column("settings")[-1].as_py()[0])
        elif entity == "cost":
            _count_costs(batch, counted.costs)
        else:
            _count(entity, batch, set(chunk.timeline_names) or {"static"}, counted)
    found: dict[tuple[str, str], RecordedStage] = {}
    for kind, entity, stage in stages_in(store.application_id):
        found.setdefault((stage.name, entity), _stage(kind, entity, stage, counted))
    return list(found.values())


def _count(entity: str, batch: RecordBatch, timelines: set[str], counted: _Counted) -> None:
    for name in batch.schema.names:
        if hasattr(batch.column(name), "value_lengths"):  # a component, no time
            counted.rows[entity][name] += sum(map(bool, batch.column(name).value_lengths().to_pylist()))
    counted.timelines[entity] |= timelines


def _count_costs(batch: RecordBatch, costs: dict[str, list[tuple[float, float, float]]]) -> None:
    def values(name: str) -> list[Any]:
        there = f"StageCost:{name}" in batch.schema.names
        cells = batch.column(f"StageCost:{name}").to_pylist() if there else [None] * batch.num_rows
        return [cell[0] if cell else np.nan for cell in cells]

    for stage, *cost in zip(*map(values, ("stage", "wall_ms", "cpu_ms", "behind_ms")), strict=True):
        costs[stage].append((cost[0], cost[1], cost[2]))


def _stage(kind: type, entity: str, stage: ShownStage, counted: _Counted) -> RecordedStage:
    name = f"{kind.__name__}:{stage.field}" if stage.field else ""
    there = [one for one in counted.rows if f"{one}/".startswith(f"{entity}/")]
    rows = sum(counted.rows[one].get(name, 0) if name else max(counted.rows[one].values()) for one in there)
    timelines = set[str]().union(*(counted.timelines[one] for one in there)) if rows else set[str]()
    timelines -= {"static"} if len(timelines) > 1 else set()
    own = counted.costs.get(stage.name, [])
    costs = np.array([*own, *(cost for one in stage.costs for cost in counted.costs.get(one, []))]).reshape(-1, 3)
    behind_ms = costs[np.isfinite(costs[:, 2]), 2]
    computed = len(own) or len(costs)

    return RecordedStage(
        name=stage.name,
        chapter=stage.chapter,
        gives=stage.gives,
        entity=entity,
        timelines=tuple(sorted(timelines - {"log_time", "log_tick"})),
        rows=rows,
        computed=computed,
        wall_ms=float(costs[:, 0].sum() / computed) if computed else None,
        cpu_ms=float(costs[:, 1].sum() / computed) if computed else None,
        behind_ms=float(np.median(behind_ms)) if len(behind_ms) else None,
        missing=not rows and bool(counted.settings) and stage.expected(counted.settings),
        asked=stage.asked,
    )
