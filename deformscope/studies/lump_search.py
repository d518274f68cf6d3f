"""Lumps in foam, sought with `explore --goal inclusions`: how many are found within how many touches, how often one is
where there is none, and whether what is missed is missed as often as it was said.

Touches are pressed into finite elements and estimated as the robot's are, without wires (`surface_robot`).
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.arrays import FloatArray
from deformscope.experiments.explore import AtOnce, Exploration, ExplorationStopped, explore, within_loop
from deformscope.experiments.explorer import ExplorationStages, Explorer
from deformscope.experiments.options import ExploreOptions
from deformscope.experiments.robot_geometry import AsMeasured
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.session import run
from deformscope.stages.map.exploration import LumpsFound, PlannedTouch
from deformscope.stages.map.lump_posterior import DEEP_M
from deformscope.studies.coverage import Rate
from deformscope.studies.lump_limit import limit
from deformscope.studies.surface_robot import LabRobot

LOOKED_AT = (3, 5, 7, 10, 15, 20)
FOAMS = (0.02, 0.04, 0.07, 0.1)
"""Scatters of foam, between which lumps are counted apart."""


@dataclass(frozen=True, slots=True)
class LumpCase:
    """One search. scene: `BURIED`'s, or one with other hardnesses; clean: nothing is kept from the estimator;
    smallest_m: radius of the smallest lump that must not be missed; set_force_n: of a touch"""

    scene: str
    seed: int
    touches: int = 30
    clean: bool = True
    smallest_m: float = 0.02
    set_force_n: float = 5.0


@dataclass(frozen=True, slots=True)
class LumpAfter:
    """After some touches. found: lumps; off_m: from the nearest one's middle to the true one's, None where there is
    neither; missed: said probability of one that is missed, of the smallest radius or more
    """

    touches: int
    found: int
    off_m: float | None
    missed: float


@dataclass(frozen=True, slots=True)
class LumpOutcome:
    """What came of a search. truth: x, y, radius, depth of the lump [m], None where there is none; stop: why it ended
    foam_sd: by which the foam truly scatters, in log stiffness; scatter: as it was found
    radius_m, interval_m: of the found lump nearest to the true one, within_m: as said of its middle; depth: its class
    xy_m: (t) places that were touched
    """

    case: LumpCase
    truth: tuple[float, float, float, float] | None
    after: tuple[LumpAfter, ...]
    stop: str
    radius_m: float | None
    interval_m: tuple[float, float] | None
    within_m: float | None
    depth: str
    foam_sd: float
    scatter: float
    sized: tuple[tuple[float, float], ...]
    xy_m: tuple[tuple[float, float], ...]
    log_stiffness: tuple[float, ...]
    seconds: float

    def at(self, touches: int) -> LumpAfter:
        """What is known with so many touches at most."""
        return self.after[min(touches, len(self.after)) - 1]

    def hit(self, touches: int) -> bool:
        """Whether the true lump was found: a middle within its radius."""
        off_m = self.at(touches).off_m
        return self.truth is not None and off_m is not None and off_m <= self.truth[2]

    def alarms(self, touches: int) -> int:
        """Lumps that were found where there is none."""
        return self.at(touches).found - self.hit(touches)


def seek(case: LumpCase) -> LumpOutcome:
    """Explore one scene."""
    began = time.perf_counter()
    with threadpool_limits(1):
        scene = built_in(case.scene, case.seed)
        options = ExploreOptions(
            goal="inclusions",
            budget=case.touches,
            inclusion_m=case.smallest_m,
            set_force_n=case.set_force_n,
            beta_model="none",
            seed=case.seed,
            thickness_m=scene.thickness_m,
        )
        robot = LabRobot(scene, options, sees=False, errors=LabErrors.none() if case.clean else LabErrors())
        explorer = Explorer(scene.size_m, options, robot.arm, robot.truth)
        found, heard = Exploration(), _HeardLumps()
        stages = ExplorationStages(explorer, AsMeasured(scene.size_m, robot.reachable))
        run([], explore(lambda: 0, within_loop(stages), found), heard, AtOnce(robot))
        if found.stop is not None:
            raise ExplorationStopped(found.stop, found.stop_ns)
    truth = tuple(map(float, scene.lumps_m[0])) if len(scene.lumps_m) else None
    foam_sd = robot.errors.scatter_sd
    return _outcome(case, truth, foam_sd, heard, explorer, time.perf_counter() - began)  # type: ignore[arg-type]


class _HeardLumps:
    """A recorder that keeps what was found after each touch."""

    def __init__(self) -> None:
        self.found: list[LumpsFound] = []
        self.stop = ""

    def write(self, items: object) -> None:
        for one in getattr(items, "results", ()):
            if isinstance(one, LumpsFound):
                self.found.append(one)
            elif isinstance(one, PlannedTouch):
                self.stop = one.stop_reason


def _outcome(
    case: LumpCase,
    truth: tuple[float, float, float, float] | None,
    foam_sd: float,
    heard: _HeardLumps,
    explorer: Explorer,
    seconds: float,
) -> LumpOutcome:
    after = []
    for one in heard.found:
        off = _off_m(one, truth)
        after.append(
            LumpAfter(len(one.contacts_m), len(one), float(off.min()) if len(off) else None, one.missed_smallest)
        )
    last = heard.found[-1]
    off = _off_m(last, truth)
    nearest = int(off.argmin()) if len(off) else None
    low_high = None if nearest is None else last.radius_interval_m[nearest]
    return LumpOutcome(
        case,
        truth,
        tuple(after),
        heard.stop,
        None if nearest is None else float(last.radius_m[nearest]),
        None if low_high is None else (float(low_high[0]), float(low_high[1])),
        None if nearest is None else float(last.within_m[nearest]),
        "" if nearest is None else last.depth[nearest],
        foam_sd,
        last.scatter,
        tuple(zip(last.size_m.tolist(), last.missed.tolist(), strict=True)),
        tuple((float(x), float(y)) for x, y in last.contacts_m),
        tuple(touch.log_stiffness for touch in explorer.search.posterior.touches),
        seconds,
    )


def _off_m(found: LumpsFound, truth: tuple[float, float, float, float] | None) -> FloatArray:
    """(k,) from the middles that were found to the true one; none without a truth."""
    return np.zeros(0) if truth is None else np.asarray(np.linalg.norm(found.centre_m - truth[:2], axis=1))


@dataclass(frozen=True, slots=True)
class LumpRow:
    """With so many touches at most. found: of fields with a lump, a middle within its radius; alarms: of all fields,
    those with a lump where there is none; said: mean probability of a missed lump, as it was said; missed: of all
    fields, those where there is one that was not found
    """

    touches: int
    found: Rate
    alarms: Rate
    said: float
    missed: Rate


def lump_rows(outcomes: Sequence[LumpOutcome]) -> list[LumpRow]:
    """After some numbers of touches."""
    most = max(one.case.touches for one in outcomes)
    rows = []
    for touches in (*(count for count in LOOKED_AT if count < most), most):
        hits = [one.hit(touches) for one in outcomes]
        there = [one.truth is not None for one in outcomes]
        rows.append(
            LumpRow(
                touches,
                Rate(sum(there), sum(hits)),
                Rate(len(outcomes), sum(one.alarms(touches) > 0 for one in outcomes)),
                float(np.mean([one.at(touches).missed for one in outcomes])),
                Rate(len(outcomes), sum(there) - sum(hits)),
            )
        )
    return rows


@dataclass(frozen=True, slots=True)
class FoamRow:
    """Of foams that scatter by `scatter` (from, to). found, alarms: as of `LumpRow`, in the end; limit: share that
    could be found at all (`lump_limit`)"""

    scatter: tuple[float, float]
    found: Rate
    alarms: Rate
    limit: float


def foam_rows(outcomes: Sequence[LumpOutcome]) -> list[FoamRow]:
    """By how much the foam scatters; none where it does not."""
    rows = []
    for low, high in itertools.pairwise(FOAMS):
        some = [one for one in outcomes if low <= one.foam_sd < high]
        there = [one for one in some if one.truth is not None]
        if some:
            found = Rate(len(there), sum(one.hit(one.case.touches) for one in there))
            alarms = Rate(len(some), sum(one.alarms(one.case.touches) > 0 for one in some))
            rows.append(FoamRow((low, high), found, alarms, limit(float(np.sqrt(low * high)))))
    return rows


def details(outcomes: Sequence[LumpOutcome]) -> dict[str, float]:
    """Of the lumps that were found in the end: how far off, and how often what was said of them holds the truth;
    touches that were made. nan where none was found."""
    with_lump = [one for one in outcomes if one.truth is not None]
    without = [one for one in outcomes if one.truth is None]
    hits = [(one, one.truth) for one in with_lump if one.truth is not None and one.hit(one.case.touches)]
    to_find = [next(after.touches for after in one.after if one.hit(after.touches)) for one, _ in hits]
    told = [(one.depth == "deep") == (truth[3] > DEEP_M) for one, truth in hits if one.depth]
    held = [one.interval_m is not None and one.interval_m[0] <= truth[2] <= one.interval_m[1] for one, truth in hits]
    off = [one.after[-1].off_m or 0.0 for one, _ in hits]
    within = [away <= (one.within_m or 0.0) for away, (one, _) in zip(off, hits, strict=True)]
    radius_off = [(one.radius_m or 0.0) - truth[2] for one, truth in hits]
    return {
        "touches_to_find": _mean(to_find, np.median),
        "most_to_find": _mean(to_find, np.max),
        "touches_with": _mean([len(one.xy_m) for one in with_lump]),
        "touches_without": _mean([len(one.xy_m) for one in without]),
        "off_m": _mean(off, np.median),
        "within": _mean(within),
        "radius_held": _mean(held),
        "radius_off_m": float(np.sqrt(_mean(np.square(radius_off)))),
        "depth_told": len(told) / max(len(hits), 1),
        "depth_right": _mean(told),
    }


def _mean(values: Sequence[float] | FloatArray, of: Callable[..., Any] = np.mean) -> float:
    return float(of(values)) if len(values) else float("nan")
