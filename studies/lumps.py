"""`python -m studies lumps`: how many lumps in foam `explore --goal inclusions` finds, and how many it misses.

python -m studies lumps --objects 40 --json lumps.json
python -m studies lumps --foam 110 --lump rigid --errors

Lumps in foam, sought with `explore --goal inclusions`: share found within numbers of touches, false alarms without a
lump, and calibration of the miss probability.

Touches are pressed into finite elements and estimated as the robot's are, without wires (`surface_robot`).
"""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from threadpoolctl import threadpool_limits
from tyro.conf import arg

from deformscope.arrays import FloatArray
from deformscope.config import flags
from deformscope.experiments.explore.explorer import ExplorationStages, Explorer, UnseenSurface
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import AsMeasured
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.pictures.report import Table
from deformscope.stages.map.exploration import InclusionsResult, PlannedTouch
from deformscope.stages.map.inclusion_posterior import DEEP_M
from studies.lump_limit import limit
from studies.quantities import Quantity, Rate, Row, band, by, number, of_cases, rows, table
from studies.reproduce.surface_robot import LabRobot, explore_at_once
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

LOOKED_AT = (3, 5, 7, 10, 15, 20)
FOAMS = (0.02, 0.04, 0.07, 0.1)
"""Scatters of foam, between which lumps are counted apart."""


@dataclass(frozen=True, slots=True)
class LumpCase:
    """One search. scene: `BURIED`'s, or one with other hardnesses; clean: no hidden errors;
    smallest_m: radius of the smallest lump that must not be missed; set_force_n: set force of a touch"""

    scene: str
    seed: int
    touches: int = 30
    clean: bool = True
    smallest_m: float = 0.02
    set_force_n: float = 5.0


@dataclass(frozen=True, slots=True)
class LumpAfter:
    """After some touches. found: lumps; off_m: from the nearest one's middle to the true one's, None where there is
    neither; missed: said probability of one that is missed, of the smallest radius or more"""

    touches: int
    found: int
    off_m: float | None
    missed: float


@dataclass(frozen=True, slots=True)
class LumpOutcome:
    """Outcome of a search. truth: x, y, radius, depth of the lump [m], None where there is none; stop: why it ended
    foam_sd: by which the foam truly scatters, in log stiffness; scatter: as it was found; radius_m, interval_m: radius
    and interval of the found lump nearest to the true one, within_m: stated accuracy of its middle; depth: its class
    xy_m: (t) places that were touched"""

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
        """Results after at most this number of touches."""
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
        unseen = UnseenSurface(scene.size_m, options, robot.arm, robot.truth)
        stages = ExplorationStages(unseen, AsMeasured(scene.size_m, robot.reachable))
        heard = _HeardLumps()
        explore_at_once(robot, stages, heard)
    truth = tuple(map(float, scene.inclusions_m[0])) if len(scene.inclusions_m) else None
    foam_sd = robot.errors.scatter_sd
    return _outcome(case, truth, foam_sd, heard, stages.explorer, time.perf_counter() - began)  # type: ignore[arg-type]


class _HeardLumps:
    """A recorder that keeps what was found after each touch."""

    def __init__(self) -> None:
        self.found: list[InclusionsResult] = []
        self.stop = ""

    def write(self, items: object) -> None:
        for one in getattr(items, "results", ()):
            if isinstance(one, InclusionsResult):
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


def _off_m(found: InclusionsResult, truth: tuple[float, float, float, float] | None) -> FloatArray:
    """(k,) from the middles that were found to the true one; none without a truth."""
    return np.zeros(0) if truth is None else np.asarray(np.linalg.norm(found.centre_m - truth[:2], axis=1))


def details(outcomes: Sequence[LumpOutcome]) -> dict[str, float]:
    """Numbers of the lumps found in the end: their errors, and how often the stated intervals hold the truth; number of
    touches. nan if none was found."""
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


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LumpCoverageConfig(StudyOptions):
    """Count how many lumps `explore --goal inclusions` finds within numbers of touches, its false alarms without a
    lump, and the calibration of its miss probability. Fields of 20 by 20 cm of finite elements have a lump of 2 cm
    radius 1 to 2 cm deep, or none."""

    objects: flags.ManyFlag = 40
    """Fields with a lump, and as many without, from seed SEED on; each takes some 25 s."""
    touches: flags.ManyFlag = 30
    """Touches at most."""
    foam: Annotated[str, arg(metavar="N")] = "60"
    """Hardness of the foam [N]."""
    lump: Annotated[str, arg(metavar="N|rigid")] = "600"
    """Hardness of the lump [N]."""
    smallest_inclusion: Annotated[float, arg(metavar="M")] = 0.02
    """Radius of the smallest inclusion that must not be missed [m]."""
    set_force: Annotated[float, arg(metavar="N")] = 5.0
    """Force to press with [N]."""
    errors: bool = False
    """With all errors of the laboratory, foam that scatters among them; else without hidden errors."""


def trials(options: LumpCoverageConfig) -> list[Trials[LumpCase, LumpOutcome]]:
    """Fields with a lump and without, of each seed."""
    scenes = f"buried-{options.foam}-{options.lump}", f"empty-{options.foam}"
    for scene in scenes:
        built_in(scene)
    smallest_m, clean = options.smallest_inclusion, not options.errors
    cases = [
        LumpCase(scene, seed, options.touches, clean, smallest_m, options.set_force)
        for seed in reported(options.objects, options.output.seed)
        for scene in scenes
    ]
    return [Trials("fields", seek, cases)]


def found_rate(outcomes: Sequence[LumpOutcome], touches: int) -> Rate:
    """Share of fields with a lump where a middle within its radius was found."""
    return Rate.of(one.hit(touches) for one in outcomes if one.truth is not None)


def alarm_rate(outcomes: Sequence[LumpOutcome], touches: int) -> Rate:
    """Share of all fields where a lump is found and there is none."""
    return Rate.of(one.alarms(touches) > 0 for one in outcomes)


AfterTouches = tuple[int, Sequence[LumpOutcome]]
"""Searches with at most this number of touches."""

QUANTITIES: tuple[Quantity[AfterTouches], ...] = (
    Quantity("touches", lambda after: after[0], {"touches": int}),
    Quantity("found", lambda after: found_rate(after[1], after[0]), {"found": of_cases, "95 % band": band(2)}),
    Quantity("alarms", lambda after: alarm_rate(after[1], after[0]), {"false alarms": of_cases}),
    # the mean probability of a missed lump, as it was said, and how many were missed
    Quantity(
        "missed_said",
        lambda after: float(np.mean([one.at(after[0]).missed for one in after[1]])),
        {"stated miss probability": number(3)},
    ),
    Quantity(
        "missed",
        lambda after: Rate.of(one.truth is not None and not one.hit(after[0]) for one in after[1]),
        {"missed, of all fields": lambda rate: f"{rate.rate:.3f} ({of_cases(rate)})"},
    ),
)


def lump_rows(outcomes: Sequence[LumpOutcome]) -> list[Row]:
    """After some numbers of touches."""
    most = max(one.case.touches for one in outcomes)
    return rows([(touches, outcomes) for touches in (*(n for n in LOOKED_AT if n < most), most)], QUANTITIES)


FOAM_QUANTITIES: tuple[Quantity[Sequence[LumpOutcome]], ...] = (
    Quantity(
        "scatter",
        lambda some: foam_of(some[0]),
        {"foam scatters by": lambda ends: f"{100.0 * ends[0]:g} to {100.0 * ends[1]:g} %"},
    ),
    Quantity("found", lambda some: found_rate(some, some[0].case.touches), {"found": of_cases}),
    Quantity(
        "limit",
        lambda some: limit(float(np.sqrt(np.prod(foam_of(some[0]) or 0.0)))),
        {"detectable in principle": number(2)},
    ),
    Quantity("alarms", lambda some: alarm_rate(some, some[0].case.touches), {"false alarms": of_cases}),
)


def foam_of(outcome: LumpOutcome) -> tuple[float, float] | None:
    """Between which scatters its foam is counted; None where it does not scatter."""
    return next((ends for ends in itertools.pairwise(FOAMS) if ends[0] <= outcome.foam_sd < ends[1]), None)


def foam_rows(outcomes: Sequence[LumpOutcome]) -> list[Row]:
    """By how much the foam scatters, in the end."""
    groups = by(sorted(outcomes, key=lambda one: one.foam_sd), foam_of)
    return rows([some for ends, some in groups.items() if ends is not None], FOAM_QUANTITIES)


def report(options: LumpCoverageConfig, seconds: float, outcomes: Sequence[LumpOutcome]) -> StudyReport:
    """After some numbers of touches, by the foam's scatter, and the stated values of the found ones."""
    seeds = reported(options.objects, options.output.seed)
    lines, foams, found = lump_rows(outcomes), foam_rows(outcomes), details(outcomes)
    title = f"{len(seeds)} fields with a lump and {len(seeds)} without, seeds {seeds.start} to {seeds.stop - 1}"
    tables = [table(lines, QUANTITIES, title)]
    if foams:
        tables.append(table(foams, FOAM_QUANTITIES, "By the scatter of the foam, after all touches"))
    tables.append(Table(list(_format_counts(found).items()), caption="Of those that were found"))
    ends = [seeds.start, seeds.stop - 1]
    return StudyReport(tables, {"seeds": ends, "rows": lines, "foams": foams, "details": found, "searches": outcomes})


def _format_counts(counted: dict[str, float]) -> dict[str, str]:
    return {
        "touches until found, median": f"{counted['touches_to_find']:.3g}, at most {counted['most_to_find']:.3g}",
        "touches made": f"{counted['touches_with']:.3g} with a lump, {counted['touches_without']:.3g} without (means)",
        "middle off, median": f"{1e3 * counted['off_m']:.1f} mm",
        "middle within the stated distance (90 %)": f"{counted['within']:.2f}",
        "radius within its interval (90 %)": f"{counted['radius_held']:.2f}",
        "radius off, rms": f"{1e3 * counted['radius_off_m']:.1f} mm",
        "depth found": f"in {counted['depth_told']:.2f}, right in {counted['depth_right']:.2f} of these",
    }


STUDY = Study(LumpCoverageConfig, trials, report)
