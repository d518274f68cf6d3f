"""Lumps in foam, sought with `explore --goal inclusions`: how many are found within how many touches, how often one is
where there is none, and whether what is missed is missed as often as it was said.

Touches are pressed into finite elements and estimated as the robot's are, without wires (`surface_robot`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.experiments.explore import AtOnce, Exploration, ExplorationStopped, explore, within_loop
from deformscope.experiments.explorer import AsMeasured, ExplorationStages, Explorer
from deformscope.experiments.options import ExploreOptions
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.session import run
from deformscope.stages.map.exploration import LumpsFound, PlannedTouch
from deformscope.studies.coverage import Rate
from deformscope.studies.surface_robot import LabRobot

LOOKED_AT = (10, 15, 20, 25, 30)


@dataclass(frozen=True, slots=True)
class LumpCase:
    """One search. scene: `BURIED`'s, or one with other hardnesses; clean: nothing is kept from the estimator;
    smallest_m: radius of the smallest lump that must not be missed; radius_m: of the lump, None = as the scene draws"""

    scene: str
    seed: int
    touches: int = 30
    clean: bool = True
    smallest_m: float = 0.02
    radius_m: float | None = None
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
        if case.radius_m is not None and scene.buried is not None:
            scene = replace(scene, buried=replace(scene.buried, radius_m=case.radius_m))
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
    return _outcome(case, truth, heard, explorer, time.perf_counter() - began)  # type: ignore[arg-type]


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
        last.scatter,
        tuple(zip(last.size_m.tolist(), last.missed.tolist(), strict=True)),
        tuple((float(x), float(y)) for x, y in last.contacts_m),
        tuple(touch.log_stiffness for touch in explorer.posterior.touches),
        seconds,
    )


def _off_m(found: LumpsFound, truth: tuple[float, float, float, float] | None) -> np.ndarray:
    """(k,) from the middles that were found to the true one; none without a truth."""
    return np.zeros(0) if truth is None else np.linalg.norm(found.centre_m - truth[:2], axis=1)


def found_rate(outcomes: Sequence[LumpOutcome], touches: int) -> Rate:
    """Of searches where there is a lump, those that found it within so many touches."""
    some = [one for one in outcomes if one.truth is not None]
    return Rate(len(some), sum(one.hit(touches) for one in some))
