"""Thesis table 4.1, and scenes beyond it, in the laboratory: how good the map is after how many touches, over seeds.

Touches are pressed into finite elements and estimated as the robot's are, without wires (`explore_lab`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.experiments.explore import ExploreOptions, Explorer, Moment, explore
from deformscope.experiments.explore_lab import LabRobot
from deformscope.lab.scenes import built_in
from deformscope.stages.exploration import MapsKnown
from deformscope.stages.plan import Planner


@dataclass(frozen=True, slots=True)
class TableJob:
    """One exploration."""

    scene: str
    seed: int
    planner: Planner = "regions"
    touches: int = 8


@dataclass(frozen=True, slots=True)
class MapAfter:
    """The map after some touches. iou, boundary_m: None where there are no regions, or no boundary
    rigid_found: most of what is rigid is told to be, None where nothing is; ordered: stiffer regions read stiffer
    """

    touches: int
    travel_m: float
    region_count: int
    verdict: str
    iou: float | None
    boundary_m: float | None
    rigid_found: bool | None
    ordered: bool


@dataclass(frozen=True, slots=True)
class TableRun:
    """What one exploration gave. max_force_n: largest true contact force; slowest_s: between two touches"""

    job: TableJob
    after: tuple[MapAfter, ...]
    max_force_n: float
    stop_after: int
    compute_s: float
    slowest_s: float
    seconds: float


def run_table(job: TableJob) -> TableRun:
    """Explore one scene."""
    began = time.perf_counter()
    with threadpool_limits(1):
        scene = built_in(job.scene, job.seed)
        options = ExploreOptions(
            planner=job.planner, budget=job.touches, beta_model="none", seed=job.seed, thickness_m=scene.thickness_m
        )
        robot = LabRobot(scene, options, sees=False)
        explorer = Explorer(scene.size_m, options, robot.arm, robot.truth)
        after: list[MapAfter] = []
        spent: list[float] = []
        for moment in explore(robot, explorer):
            after += _maps(moment, explorer, scene.rigid)
            if moment.compute_s:
                spent.append(moment.compute_s)
    return TableRun(
        job,
        tuple(after),
        robot.most_force_n,
        len(explorer.told),
        float(sum(spent)),
        float(max(spent, default=0.0)),
        time.perf_counter() - began,
    )


def _maps(moment: Moment, explorer: Explorer, rigid: tuple[int, ...]) -> list[MapAfter]:
    found = []
    for result in moment.results:
        if not isinstance(result, MapsKnown):
            continue
        regions = explorer.region_map()
        rigid_found = None
        if rigid and result.truth_labels is not None:
            there = np.isin(result.truth_labels, rigid)
            told = regions.rigid[result.labels]
            rigid_found = bool((there & told).sum() > 0.5 * there.sum())
        found.append(
            MapAfter(
                result.touches,
                explorer.travel_m,
                result.region_count,
                result.verdict,
                result.iou,
                explorer.boundary_m(),
                rigid_found,
                _ordered(explorer),
            )
        )
    return found


def _ordered(explorer: Explorer) -> bool:
    """Whether touches in a stiffer true region read stiffer, by the regions' medians."""
    truth = explorer.truth
    if truth is None or truth.labels is None:
        return True
    rows, columns = truth.labels.shape
    by_label: dict[int, list[float]] = {}
    for told in explorer.told:
        column = min(int(told.xyz_m[0] / explorer.grid.cell_m), columns - 1)
        row = min(int(told.xyz_m[1] / explorer.grid.cell_m), rows - 1)
        by_label.setdefault(int(truth.labels[row, column]), []).append(told.stiffness_n_per_mm)
    stiffness = truth.stiffness
    medians = [float(np.median(values)) for _, values in sorted(by_label.items(), key=lambda one: stiffness[one[0]])]
    return all(first < second for first, second in pairwise(medians))
