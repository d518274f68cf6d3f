"""The rows of table 4.1: medians and shares over layouts after some numbers of touches, for each planner, and the maps'
quality over touches."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial import KDTree

from deformscope.arrays import FloatArray
from deformscope.lab.scenes import built_in
from deformscope.pictures.figures import COLOURS
from deformscope.stages.regions.touches import MapGrid
from studies.map_score import MapScore
from studies.output import figure
from studies.reproduce.table41_runs import TableRun

GOOD_IOU = 0.85
PASSED_IOU = (0.8, 0.85, 0.9)
"""Quality of a map at which planners are compared by their cost."""

FOUND_IOU = 0.5
"""Share of overlap with its match from which a small region counts as found, if the number of regions is right."""

LOOKED_AT = (3, 4, 6, 8, 12)
"""Numbers of touches in a table; the thesis touched 3 or 4 times."""

DRAWS = 2000
What = Literal["touches", "travel_m", "robot_s"]
PASSED: tuple[What, ...] = ("touches", "travel_m", "robot_s")


def summarise(runs: Sequence[TableRun], touches: int) -> dict[str, Any]:
    """Statistics of the runs of one scene with one planner, after this number of touches: the robot stops at the end of
    its plan.

    Medians: iou, boundary_m, field_rms, made (touches), travel_m, robot_s. good: share with iou 0.85 or better; right:
    with the right verdict and number; found: that, and the smallest region with an IoU of 0.5; ordered, rigid_found,
    gradual: shares. levels_covered: share of levels within their intervals, over `levels_runs` layouts with the right
    number of regions; field_covered: mean share of cells; touches_covered: share of the touches so far that are not
    rigid; stopped: share of runs whose plan ended before the budget; wrong, wrong_claimed: mean share of the surface
    with a wrong label, found and expected; unseen: median probability of undetected inclusions; unseen_missed: that
    over layouts whose smallest region was not found
    unmet_m: radius of the largest disc of another material without a touch, median None if there is nothing to report
    """
    last = [run.at(touches) for run in runs]
    scores = [after.score for after in last]
    felt = [one.touch_covered for run, end in zip(runs, last, strict=True) for one in run.after[: end.touches]]
    regions = runs[0].region_count
    return {
        "touches": touches,
        "layouts": len(runs),
        "iou": _median(one.iou for one in scores),
        "good": _share((one.iou or 0.0) >= GOOD_IOU for one in scores) if regions else None,
        "right": _share(one.right for one in scores),
        "found": _share(_found(one) for one in scores) if regions > 1 else None,
        "gradual": _share(one.verdict == "gradual" for one in scores),
        "ordered": _share(one.ordered for one in scores),
        "rigid_found": _share(one.rigid_found for one in scores),
        "stopped": _share(run.stop_after is not None and run.stop_after <= touches for run in runs),
        "wrong": _mean(one.wrong for one in scores),
        "wrong_claimed": _mean(one.wrong_claimed for one in scores),
        "unseen": _median(one.unseen for one in last),
        "unseen_missed": _median(one.unseen for one in last if regions > 1 and not _found(one.score)),
        "boundary_m": _median(one.boundary_m for one in scores),
        "field_rms": _median(one.field_rms for one in scores),
        "field_covered": _share(one.field_covered for one in scores),
        "levels_covered": _share(one.levels_covered for one in scores),
        "levels_runs": sum(one.levels_covered is not None for one in scores),
        "touches_covered": _share(felt),
        "unmet_m": _median(_unmet_m(run, end.touches) for run, end in zip(runs, last, strict=True)),
        "made": _median(after.touches for after in last),
        "travel_m": _median(after.travel_m for after in last),
        "robot_s": _median(after.robot_s for after in last),
    }


def _found(score: MapScore) -> bool:
    return score.right and (score.least_iou or 0.0) >= FOUND_IOU


def _unmet_m(run: TableRun, touches: int) -> float:
    """Radius of the largest circle on the surface without a touch inside."""
    grid = MapGrid(built_in(run.job.scene, run.job.seed).size_m)
    centres = grid.centres_m
    away = KDTree([one.xy_m for one in run.after[:touches]]).query(centres)[0]
    return float(np.minimum(away, np.minimum(centres, grid.size_m - centres).min(axis=1)).max())


def first_passage(run: TableRun, iou: float) -> tuple[dict[What, float], bool]:
    """Cost until the map first had this quality, even after the end of the plan; and whether it reached it.
    was: if not, it is the cost of all touches."""
    for after in run.after:
        if after.score.iou is not None and after.score.iou >= iou:
            return {what: float(getattr(after, what)) for what in PASSED}, True
    return {what: float(getattr(run.after[-1], what)) for what in PASSED}, False


def compare(runs: Sequence[TableRun], against: Sequence[TableRun], iou: float) -> dict[str, Any]:
    """The effort of one planner and pace for maps of this quality, compared with another's on the same scenes and
    seeds.

    reached: share of layouts in which it was reached; touches, travel_m, robot_s: mean first passages, with their
    ratio, and 5 and 95 % of its bootstrap over layouts"""
    other = {(run.job.scene, run.job.seed): run for run in against}
    pairs = [(run, other[run.job.scene, run.job.seed]) for run in runs if (run.job.scene, run.job.seed) in other]
    passed = [[first_passage(one, iou) for one in pair] for pair in pairs]
    summary: dict[str, Any] = {
        "planner": runs[0].job.way,
        "against": against[0].job.way,
        "iou": iou,
        "layouts": len(pairs),
        "reached": _share(ours[1] for ours, _ in passed),
        "reached_against": _share(theirs[1] for _, theirs in passed),
    }
    for what in PASSED:
        both = np.array([[one[0][what] for one in pair] for pair in passed])
        mean, ratio = both.mean(axis=0), _ratio(both)
        summary |= {what: float(mean[0]), f"{what}_against": float(mean[1]), f"{what}_ratio": ratio[0]}
        summary |= {f"{what}_low": ratio[1], f"{what}_high": ratio[2]}
    return summary


def _ratio(pairs: FloatArray) -> tuple[float, float, float]:
    """Ratio of the means of (n, 2), with 5 and 95 % of its bootstrap."""
    rng = np.random.default_rng(0)
    some = pairs[rng.integers(0, len(pairs), (DRAWS, len(pairs)))].mean(axis=1)
    low, high = np.quantile(some[:, 0] / some[:, 1], [0.05, 0.95])
    return float(pairs[:, 0].mean() / pairs[:, 1].mean()), float(low), float(high)


def _median(values: Any) -> float | None:
    """Median of the values that are known."""
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4) if known else None


def _mean(values: Any) -> float | None:
    """Mean of the values that are known."""
    known = [value for value in values if value is not None]
    return round(float(np.mean(known)), 4) if known else None


def _share(values: Any) -> float | None:
    """Mean of those that are known."""
    known = [float(value) for value in values if value is not None]
    return round(float(np.mean(known)), 3) if known else None


ACROSS = 4
FIELD_RMS = 0.12


def curves(runs: Sequence[TableRun], path: Path) -> None:
    """One panel per scene: IoU of regions (of a gradient: error of the field) against touches, up to the end of the
    plan; median, and the middle half of the layouts."""
    scenes = list(dict.fromkeys(run.job.scene for run in runs))
    planners = list(dict.fromkeys(run.job.way for run in runs))
    columns = min(ACROSS, len(scenes))
    with figure(path, columns, -(-len(scenes) // columns)) as axes:
        for scene, one in zip(scenes, axes.flat, strict=False):
            mine = [run for run in runs if run.job.scene == scene]
            regions = mine[0].region_count > 0
            for planner, colour in zip(planners, COLOURS, strict=False):
                _curve(one, [run for run in mine if run.job.way == planner], regions, planner, colour)
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
