"""Which stages of computation a recording holds, counted by rerun's own reader."""

from __future__ import annotations

import json
from collections import defaultdict
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
    before the newest frame its results stand, in the median; live: whether that is soon; None where it was not recorded
    missing: rows were to be expected, by the recording's settings, and there are none; when: they are to be expected
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
    live: bool | None
    missing: bool
    when: str


@dataclass(slots=True)
class _Counted:
    """rows: by entity and column; timelines: by entity; costs: (wall, cpu, behind) by stage [ms]"""

    settings: dict[str, Any] = field(default_factory=dict)
    rows: dict[str, dict[str, int]] = field(default_factory=lambda: defaultdict(lambda: defaultdict(int)))
    timelines: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    costs: dict[str, list[list[float]]] = field(default_factory=lambda: defaultdict(list))

    def add(self, entity: str, batch: RecordBatch, timelines: set[str]) -> None:
        """Count a portion of an entity."""
        components = [name for name in batch.schema.names if hasattr(batch.column(name), "value_lengths")]
        if entity == "__properties/session" and "settings" in components:
            self.settings = json.loads(batch.column("settings")[-1].as_py()[0])
        if entity == "cost":
            rows = [
                {name.split(":")[1]: row[name] for name in components} for row in batch.select(components).to_pylist()
            ]
            for row in rows:
                values = [(row.get(name) or [np.nan])[0] for name in ("wall_ms", "cpu_ms", "behind_ms")]
                self.costs[row["stage"][0]].append(values)
        for name in components:
            self.rows[entity][name] += sum(map(bool, batch.column(name).value_lengths().to_pylist()))
        self.timelines[entity] |= timelines - {"log_time", "log_tick"}


def recorded_stages(path: Path) -> list[RecordedStage]:
    """All that are registered for recordings of its kind, by chapter; whether they are in it or not."""
    from rerun.chunk import RrdReader

    from deformscope.log.registered import stages_in

    reader = RrdReader(utf8_path(path))
    store = next(one for one in reader.recordings() if one.application_id.startswith("deformscope"))
    counted = _Counted()
    for chunk in reader.stream(store=store):
        counted.add(chunk.entity_path.strip("/"), chunk.to_record_batch(), set(chunk.timeline_names) or {"static"})
    found = (_stage(kind, entity, stage, counted) for kind, entity, stage in stages_in(store.application_id))
    return list({(one.name, one.entity): one for one in found}.values())


def _stage(kind: type, entity: str, stage: ShownStage, counted: _Counted) -> RecordedStage:
    name = f"{kind.__name__}:{stage.field}" if stage.field else ""
    there = [one for one in counted.rows if f"{one}/".startswith(f"{entity}/")]
    rows = sum(counted.rows[one].get(name, 0) if name else max(counted.rows[one].values()) for one in there)
    timelines = set[str]().union(*(counted.timelines[one] for one in there)) if rows else set[str]()
    own = counted.costs.get(stage.name, [])
    costs = np.array([*own, *(cost for one in stage.costs for cost in counted.costs.get(one, []))]).reshape(-1, 3)
    known = costs[np.isfinite(costs[:, 2]), 2]
    behind_ms = float(np.median(known)) if len(known) else None
    computed = len(own) or len(costs)
    wall_ms, cpu_ms = costs[:, :2].sum(axis=0).tolist() if computed else (None, None)
    return RecordedStage(
        name=stage.name,
        chapter=stage.chapter,
        gives=stage.gives,
        entity=entity,
        timelines=tuple(sorted(timelines - {"static"} or timelines)),
        rows=rows,
        computed=computed,
        wall_ms=None if wall_ms is None else wall_ms / computed,
        cpu_ms=None if cpu_ms is None else cpu_ms / computed,
        behind_ms=behind_ms,
        live=None if behind_ms is None else behind_ms <= LIVE_MS,
        missing=not rows and bool(counted.settings) and stage.is_expected(counted.settings),
        when=stage.when,
    )
