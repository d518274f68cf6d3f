"""Do the intervals hold where the data are not as assumed? Random bodies of known beta or theta whose observed
positions carry errors that neighbours share over several cells, outliers, lost tracks, or a held particle that is off.

Bodies, sizes of noise and truths are those of `studies.random_bodies`; a third of the bodies is in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation
from deformscope.stages.fit.estimate import DoubtCode, Parameter
from studies.random_bodies import (
    BOUNDS,
    CANDIDATES,
    SPACING_M,
    Outcome,
    RandomBody,
    Rate,
    fitted,
    random_body,
    random_dim,
    random_noise,
    random_sigma,
)

FRAMES = 5
"""Frames of a whole motion, pushed on evenly."""

OUTLIERS = (0.1, 1.0)
"""Distances of a wrong track from where its particle is, even between these [spacings]."""

LOST = (0.0, 0.8)
"""Share of its motion up to which a lost track follows its particle, even between these."""

THETA_BETA = 0.9
"""beta of the bodies whose theta is looked for."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """How observed positions err.

    cells: over how many spacings neighbours share errors (0: not at all), 0.7 to 1.3 times it, exponential, Matern or
    Gaussian; white: share of the variance that they do not; held_noise: held positions have it too
    wrong, lost: share of the free particles whose track is wrong or lost; off: distance of one held particle from where
    it is said to be [spacings]; frames: of a motion, None for its end alone; frames_share: all have the same errors
    """

    cells: float = 0.0
    white: float = 0.0
    held_noise: bool = True
    wrong: float = 0.0
    lost: float = 0.0
    off: float = 0.0
    frames: int | None = None
    frames_share: bool = False


DISTURBED: dict[str, Disturbance] = {
    "white": Disturbance(),
    "shared over 1 cell": Disturbance(cells=1.0),
    "shared over 2 cells": Disturbance(cells=2.0),
    "shared over 3 cells": Disturbance(cells=3.0),
    "shared over 6 cells": Disturbance(cells=6.0),
    "half white, half over 2 cells": Disturbance(cells=2.0, white=0.5),
    "half white, half over 6 cells": Disturbance(cells=6.0, white=0.5),
    "white, held exact": Disturbance(held_noise=False),
    "10 % outliers": Disturbance(wrong=0.1),
    "30 % outliers": Disturbance(wrong=0.3),
    "30 % lost tracks": Disturbance(lost=0.3),
    "over 2 cells, 10 % outliers": Disturbance(cells=2.0, wrong=0.1),
    "a held particle off by .3 cell": Disturbance(off=0.3),
    "motion, errors of each frame's own": Disturbance(frames=FRAMES),
    "motion, errors that frames share, over 2 cells": Disturbance(cells=2.0, frames=FRAMES, frames_share=True),
    "motion, 10 % outliers": Disturbance(wrong=0.1, frames=FRAMES),
}
"""By name."""


@dataclass(frozen=True, slots=True)
class DisturbedCase:
    """One random object: its name in `DISTURBED`, which parameter is fitted, its number and the seed."""

    name: str
    number: int
    seed: int
    parameter: Parameter = "beta"
    level: float = 0.9


@dataclass(frozen=True, slots=True)
class DisturbedOutcome:
    """What came of one object. disturbed, found: particles whose track was made wrong or lost or whose held position
    is off, and those that were left out; both: how many are in both"""

    outcome: Outcome
    disturbed: int = 0
    found: int = 0
    both: int = 0


def try_disturbed(case: DisturbedCase) -> DisturbedOutcome:
    """One random object through the calibration."""
    what = DISTURBED[case.name]
    rng = np.random.default_rng([case.seed, 16, list(DISTURBED).index(case.name), case.number])
    body = random_body(rng, random_dim(case.number))
    bounds = BOUNDS if case.parameter == "beta" else (0.0, 1.0)
    truth = float(rng.uniform(*bounds))
    model = _model(case.parameter, body)
    errors = _Errors(what, body, random_sigma(rng), rng)
    frames = what.frames or 1
    seen = [errors.observe(model, truth, (frame + 1) / frames) for frame in range(frames)]
    options = FitOptions(model, bounds, candidates=CANDIDATES, level=case.level)
    outcome, found = fitted(case.name, truth, seen, options, one_motion=what.frames is not None)
    left_out = np.zeros(len(body.rest), dtype=bool)
    for one in found.left_out:
        left_out[np.concatenate([one.lost, one.wrong, one.held])] = True
    counts = (int(np.count_nonzero(one)) for one in (errors.bad, left_out, errors.bad & left_out))
    return DisturbedOutcome(outcome, *counts)


def _model(parameter: Parameter, body: RandomBody) -> Model:
    if parameter == "beta":
        return Model(cluster_size=body.cluster_size)
    return Model(parameter="theta", cluster_size=body.cluster_size, beta=THETA_BETA, volume="project")


class _Errors:
    """The errors of one object, drawn once. bad: (K,) particles whose track is wrong or lost, or whose held
    position is off"""

    def __init__(self, what: Disturbance, body: RandomBody, sigma: float, rng: np.random.Generator) -> None:
        self.what, self.body, self.sigma, self.rng = what, body, sigma, rng
        count, d = body.rest.shape
        self.free: BoolArray = np.ones(count, dtype=bool)
        self.free[body.held] = False
        self.same = self._noise()
        draw = rng.random(count)
        self.wrong: BoolArray = self.free & (draw < what.wrong)
        self.lost: BoolArray = self.free & (what.wrong <= draw) & (draw < what.wrong + what.lost)
        self.bad = self.wrong | self.lost
        self.jump = SPACING_M * rng.uniform(*OUTLIERS, (count, 1)) * _directions(rng, count, d)
        self.until = rng.uniform(*LOST, (count, 1))
        self.off = np.zeros((count, d))
        misheld = rng.choice(body.held)
        self.off[misheld] = SPACING_M * what.off * _directions(rng, 1, d)[0]
        self.bad[misheld] = what.off > 0.0

    def _noise(self) -> FloatArray:
        what, rng, rest = self.what, self.rng, self.body.rest
        noise = np.sqrt(what.white if what.cells else 1.0) * rng.standard_normal(rest.shape)
        if what.cells:
            noise += np.sqrt(1.0 - what.white) * random_noise(rng, rest / what.cells, correlated=True)
        if not what.held_noise:
            noise[self.body.held] = 0.0
        return np.asarray(self.sigma * noise)

    def observe(self, model: Model, truth: float, share: float) -> Observation:
        """What is seen when a share of the motion is done."""
        body = self.body
        start = body.rest[body.held]
        held = start + share * (body.held_position - start)
        beta, theta = (truth, 0.0) if model.parameter == "beta" else (model.beta, truth)
        simulated = model.body(body.observe(body.rest)).relax(held, beta, theta, volume=model.volume).position[0]
        noise = self.same if self.what.frames_share or self.what.frames is None else self._noise()
        seen = simulated + noise + self.off
        seen[self.wrong] += self.jump[self.wrong]
        stays = self.lost & (share > self.until[:, 0])
        seen[stays] -= ((1.0 - self.until / share) * (simulated - body.rest))[stays]
        return body.observe(seen, self.sigma)


def _directions(rng: np.random.Generator, count: int, d: int) -> FloatArray:
    drawn = rng.standard_normal((count, d))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


@dataclass(frozen=True, slots=True)
class DisturbedRow:
    """A line of the table: of the objects of one disturbance.

    covered: truths within their intervals; by_dim: the same in the plane and in space; width: median of the intervals;
    rms: error of the value; identified, unidentified: verdicts; wrong: truths outside intervals that were called
    identified; caught: of disturbed particles, those left out; alarms: of the others, those left out; seconds: median
    reasons: how often each reason to doubt the value was named
    """

    name: str
    covered: Rate
    by_dim: dict[int, Rate]
    width: float
    rms: float
    identified: Rate
    unidentified: Rate
    wrong: Rate
    caught: Rate
    alarms: Rate
    seconds: float
    verdicts: dict[str, int] = field(default_factory=dict)
    reasons: dict[DoubtCode, Rate] = field(default_factory=dict)


def disturbed_rows(outcomes: Sequence[DisturbedOutcome]) -> list[DisturbedRow]:
    """The table, a line for each disturbance."""
    rows = []
    for name in dict.fromkeys(one.outcome.condition for one in outcomes):
        mine = [one for one in outcomes if one.outcome.condition == name]
        every = [one.outcome for one in mine]
        called = [one.verdict for one in every]
        sure = [one for one in every if one.verdict == "identified"]
        bad, both = sum(one.disturbed for one in mine), sum(one.both for one in mine)
        others = sum(one.particles for one in every) - bad
        rows.append(
            DisturbedRow(
                name=name,
                covered=_covered(every),
                by_dim={dim: _covered([one for one in every if one.dim == dim]) for dim in (2, 3)},
                width=float(np.median([one.interval[1] - one.interval[0] for one in every])),
                rms=float(np.sqrt(np.mean([(one.value - one.beta) ** 2 for one in every]))),
                identified=Rate(len(every), called.count("identified")),
                unidentified=Rate(len(every), called.count("unidentified")),
                wrong=Rate(len(sure), sum(not one.covered for one in sure)),
                caught=Rate(bad, both),
                alarms=Rate(others, sum(one.found for one in mine) - both),
                seconds=float(np.median([one.seconds for one in every])),
                verdicts={verdict: called.count(verdict) for verdict in sorted(set(called))},
                reasons={
                    code: Rate(len(every), sum(code in one.codes for one in every))
                    for code in get_args(DoubtCode)
                    if any(code in one.codes for one in every)
                },
            )
        )
    return rows


def _covered(some: Sequence[Outcome]) -> Rate:
    return Rate(len(some), sum(one.covered for one in some))
