"""One small result of each kind."""

from __future__ import annotations

import numpy as np

from deformscope.rows import Result
from deformscope.stages.map.exploration import (
    ExplorationStop,
    MapEstimate,
    PhaseStart,
    PlannedTouch,
    StageFailure,
    SurfaceEstimate,
    TouchEstimate,
)


def small_results() -> tuple[Result, ...]:
    field, way, at = np.ones((4, 6)), np.linspace(0.0, 0.01, 5), np.zeros(3)
    labels = np.zeros((4, 6), np.int64)
    labels[:, 3:] = 1
    cloud = np.ones((3, 3))
    told = TouchEstimate(
        *(0, at, np.array([0.0, 0.0, 1.0]), way, way, way, 0.0, 1.0, (0.9, 1.1), False, None, 0.01, 3.0),
        *(None, None, "", cloud, cloud),
    )
    levels, intervals, rigid = np.ones(2), np.ones((2, 2)), np.zeros(2, np.bool_)
    maps = MapEstimate(
        *(1, 0.005, field, field, field, field, labels, field, 2, "regions", 0.9, levels, intervals, rigid),
        *(at[None, :2], 0.01, 0.1, labels, 1.0),
    )
    plan = PlannedTouch(at[:2], field, field, labels == 1, "")
    seen, stop = SurfaceEstimate(cloud, field, field, 0.005), ExplorationStop("", "", "", "stop", 0)
    return seen, told, maps, plan, StageFailure("", 1, "", ""), PhaseStart("look", 0), stop
