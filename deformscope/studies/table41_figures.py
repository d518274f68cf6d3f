"""Figures of table 4.1: how the maps grow better with every touch, planner beside planner."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.pictures.figures import COLOURS, figure
from deformscope.studies.table41 import TableRun
from deformscope.studies.table41_summary import GOOD_IOU

ACROSS = 4
FIELD_RMS = 0.12


def curves(runs: Sequence[TableRun], path: Path) -> None:
    """One panel a scene: IoU of regions (of a gradient: error of the field) against touches, as the robot has them;
    median, and the middle half of the layouts."""
    scenes = list(dict.fromkeys(run.job.scene for run in runs))
    planners = list(dict.fromkeys(run.job.planner for run in runs))
    columns = min(ACROSS, len(scenes))
    with figure(path, columns, -(-len(scenes) // columns)) as axes:
        for scene, one in zip(scenes, axes.flat, strict=False):
            mine = [run for run in runs if run.job.scene == scene]
            regions = mine[0].region_count > 0
            for planner, colour in zip(planners, COLOURS, strict=False):
                _curve(one, [run for run in mine if run.job.planner == planner], regions, planner, colour)
            one.axhline(GOOD_IOU if regions else FIELD_RMS, color="0.5", lw=0.8)
            one.set(title=scene, xlabel="touches", ylim=(0.0, 1.03) if regions else (0.0, None))
            one.set_ylabel("IoU of regions" if regions else "error of log stiffness, rms")
            one.xaxis.get_major_locator().set_params(integer=True)
            one.legend(fontsize=8)


def _curve(axes: Any, runs: Sequence[TableRun], regions: bool, label: str, colour: str) -> None:
    if not runs:
        return
    touches = np.arange(1, max(run.job.touches for run in runs) + 1)
    scores = [[run.at(int(count)).score for count in touches] for run in runs]
    values = np.array([[one.iou if regions else one.field_rms for one in row] for row in scores], dtype=np.float64)
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    axes.fill_between(touches, low, high, color=colour, alpha=0.2, lw=0)
    axes.plot(touches, middle, "-o", ms=3, color=colour, label=f"{label}, {len(runs)} layouts")
