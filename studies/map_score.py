"""Quality of a map of regions with a known truth: one score for every study."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.map.map_score import boundary_distance, called_labels, match_regions
from deformscope.stages.regions.posterior import RegionMap

Z_90 = 1.6449
"""Half width in standard deviations that contains 90 % of a normal distribution."""


@dataclass(frozen=True, slots=True)
class TrueMap:
    """True map of a scene, for touches far from every border.

    labels: (rows, columns) region of each cell, None where stiffness changes gradually
    level: (k,) log apparent stiffness [N/mm] of each label; rigid: (k,) labels with only a lower bound
    log_stiffness: (rows, columns) that of the material of each cell, without the averaging of a contact"""

    labels: IntArray | None
    level: FloatArray
    rigid: BoolArray
    log_stiffness: FloatArray

    @property
    def region_count(self) -> int:
        """Number of regions, 0 without regions."""
        return 0 if self.labels is None else len(self.level)

    @property
    def measurable(self) -> BoolArray:
        """(rows, columns) cells whose stiffness can be measured: those that are not rigid."""
        if self.labels is None:
            return np.ones(self.log_stiffness.shape, dtype=bool)
        return np.asarray(~self.rigid[self.labels])


@dataclass(frozen=True, slots=True)
class MapScore:
    """A map against the truth. A score without a truth is None; shares are from 0 to 1.

    region_count: 0 where the verdict is "gradual"; right: verdict and number of regions are right; iou:
    `match_regions`; least_iou: IoU of the smallest true region with its match; boundary_m: `boundary_distance`
    ordered: the matched regions' levels have the true order; rigid_found: most of the rigid area is reported as rigid
    levels_covered: share of the true levels (rigid ones left out) in the 90 % intervals of the regions they are matched
    to; None with a wrong number of regions; wrong, wrong_claimed: share of the surface whose label is not that of its
    matched region, and the map's expectation of it; field_rms: root mean square of log stiffness; field_covered: share
    of cells whose truth lies in the field's 90 % interval; both without rigid parts"""

    region_count: int
    verdict: str
    right: bool
    iou: float | None
    least_iou: float | None
    boundary_m: float | None
    ordered: bool
    rigid_found: bool | None
    levels_covered: float | None
    field_rms: float
    field_covered: float
    wrong: float | None = None
    wrong_claimed: float | None = None


def score_map(shown: RegionMap, truth: TrueMap) -> MapScore:
    """A map against the truth."""
    off = (shown.field - truth.log_stiffness)[truth.measurable]
    rms, covered = (
        float(np.sqrt((off**2).mean())),
        float((np.abs(off) <= Z_90 * shown.field_sd[truth.measurable]).mean()),
    )
    labels, count = called_labels(shown), shown.region_count
    if truth.labels is None:
        gradual = shown.verdict == "gradual"
        return MapScore(
            region_count=count,
            verdict=shown.verdict,
            right=gradual,
            iou=None,
            least_iou=None,
            boundary_m=None,
            ordered=True,
            rigid_found=None,
            levels_covered=None,
            field_rms=rms,
            field_covered=covered,
        )
    iou, pairs = match_regions(labels, truth.labels)
    right = count == truth.region_count
    inside = [
        shown.level_interval[found, 0] <= truth.level[true] <= shown.level_interval[found, 1]
        for found, true in pairs
        if right and not truth.rigid[true]
    ]
    found_rigid = np.append(shown.rigid, False)[shown.labels]  # label -1, no region, is not rigid
    there = truth.rigid[truth.labels]
    smallest = int(np.bincount(truth.labels.ravel()).argmin())
    matched = {true: found for found, true in pairs}
    least = 0.0
    if smallest in matched:
        one, other = labels == matched[smallest], truth.labels == smallest
        least = float((one & other).sum() / (one | other).sum())
    as_true = np.full(int(labels.max()) + 1, -1)
    for found, true in pairs:
        as_true[found] = true
    return MapScore(
        region_count=count,
        verdict=shown.verdict,
        right=right,
        iou=iou,
        least_iou=least,
        boundary_m=boundary_distance(labels, truth.labels, shown.grid.cell_m),
        ordered=bool(np.all(np.diff([truth.level[true] for _, true in sorted(pairs)]) > 0.0)),
        rigid_found=bool((there & found_rigid).sum() > 0.5 * there.sum()) if there.any() else None,
        levels_covered=float(np.mean(inside)) if inside else None,
        field_rms=rms,
        field_covered=covered,
        wrong=None if shown.verdict == "gradual" else float((as_true[labels] != truth.labels).mean()),
        wrong_claimed=None if shown.verdict == "gradual" else shown.wrong_share,
    )
