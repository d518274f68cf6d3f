"""Which stages of computation a recording holds, counted by rerun's own reader."""

import json
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.frames import StageCost
from deformscope.log import layout
from deformscope.log.canvas import Canvas
from deformscope.log.exploration.results import CELL_M, exploration_views
from deformscope.log.layout import EXPLORATION, RIG, SQUEEZE
from deformscope.log.over_picture import OF_APPLICATION, picture_views
from deformscope.log.squeeze.results import squeeze_views
from deformscope.log.stages import STAGE_VIEWS
from deformscope.log.views import ShownStage, Views, stages_of
from deformscope.recording.reader import Replay, read_rows
from deformscope.rows import ENTITIES

PICTURES = (layout.IMAGES, layout.FLOW, layout.PAIR, layout.PAIR_3D, layout.FINDINGS)
LIVE_MS = 1000.0
"""A stage is live if the median delay of its results behind the newest frame is below this [ms]."""


@dataclass(frozen=True, slots=True)
class RecordedStage:
    """A stage in a recording.

    timelines: timelines of its rows; computed: how often it was; wall_ms, cpu_ms: each time, in the mean; behind_ms:
    median delay of its results behind the newest frame; live: whether the results come soon; None if that was not
    recorded
    missing: the recording's settings require rows, and there are none; when: the case in which rows are expected"""

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


def registries() -> dict[str, Views[Any]]:
    """The views that are registered for each of rerun's applications."""
    over = picture_views(Canvas())
    return {
        EXPLORATION.name: exploration_views(0, None, CELL_M),
        SQUEEZE.name: squeeze_views(None),
        RIG.name: STAGE_VIEWS,
        **{one.name: {kind: over[kind] for kind in OF_APPLICATION[one.over_picture]} for one in PICTURES},
    }


def recorded_stages(path: Path) -> list[RecordedStage]:
    """All stages that are registered for recordings of this kind, or of the kind that it is a variant of, by chapter,
    existing or missing."""
    replay = Replay(path, trust=True)
    every, counted = registries(), _Counted(json.loads(replay.properties.get("settings", "{}")))
    for chunk in replay.chunks("/**"):
        entity, batch = chunk.entity_path.strip("/"), chunk.to_record_batch()
        for name in (name for name in batch.schema.names if hasattr(batch.column(name), "value_lengths")):
            counted.rows[entity][name] += sum(map(bool, batch.column(name).value_lengths().to_pylist()))
        counted.timelines[entity] |= (set(chunk.timeline_names) or {"static"}) - {"log_time", "log_tick"}
    for row in read_rows(replay, (StageCost,)):
        counted.costs[row.item.stage].append((row.item.wall_ms, row.item.cpu_ms, row.item.behind_ms))
    of = max((one for one in every if f"{replay.identity[0]}-".startswith(f"{one}-")), key=len, default="")
    views = every.get(of, {})
    found = [_stage(kind, one, counted) for kind in views for one in stages_of(kind, views)]
    return list({(one.name, one.entity): one for one in sorted(found, key=lambda one: one.chapter or 9)}.values())


@dataclass(frozen=True, slots=True)
class _Counted:
    """rows: by entity and column; timelines: by entity; costs: (wall, cpu, behind) by stage [ms]"""

    settings: dict[str, Any]
    rows: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    timelines: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    costs: dict[str, list[tuple[float | None, ...]]] = field(default_factory=lambda: defaultdict(list))


def _stage(kind: type, stage: ShownStage, counted: _Counted) -> RecordedStage:
    entity = stage.entity or ENTITIES[kind]
    name = f"{kind.__name__}:{stage.field}" if stage.field else ""
    there = [one for one in counted.rows if f"{one}/".startswith(f"{entity}/")]
    rows = sum(counted.rows[one].get(name, 0) if name else max(counted.rows[one].values()) for one in there)
    timelines = set[str]().union(*(counted.timelines[one] for one in there)) if rows else set[str]()
    own = counted.costs.get(stage.name, [])
    every = [*own, *(cost for one in stage.costs for cost in counted.costs.get(one, []))]
    costs = np.array(every, np.float64).reshape(-1, 3)
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
