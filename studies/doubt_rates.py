"""How often a calibration gives each reason to doubt it: on data that satisfy the model's assumptions, which are false
alarms, and on data with known errors.

Bodies, noise and fits are those of `studies.random_bodies`; finite element bodies of one material, which have no true
beta, are those of `studies.unseen_pokes` with a uniform modulus. Bodies of "other solver" are those of
`studies.independent`. They are clusters, and plane stress or strain of one material whose whole faces are stretched,
pressed or sheared by 2 to 10 %."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.estimate import DoubtCode, Verdict
from studies.beta import observed
from studies.field_bodies import SPACING_M
from studies.independent.observed import Errors, Motion, pushed_clusters, pushed_elements
from studies.independent.plane_elements import Floats, stiffness
from studies.quantities import Quantity, Rate, Row, by, rows
from studies.random_bodies import BOUNDS, CANDIDATES, RandomBody, random_body, random_dim, random_noise, random_sigma
from studies.unseen_pokes import FoamBody, observe_foam

Data = Literal[
    "independent noise",
    "noise not stated",
    "noise over a cell, held noisy",
    "noise over three cells, held noisy",
    "finite elements, one material",
    "two betas, halves",
    "two betas, a lump",
    "x and y swapped",
    "one sign turned",
    "positions mirrored",
    "noise stated 15 times too small",
    "other solver: clusters",
    "other solver: whole face, nu 0",
    "other solver: whole face, nu .3",
    "other solver: whole face, nu .45",
    "other solver: whole face, plane strain, nu .45",
    "other solver: whole face, orthotropic",
    "other solver: patch, nu .3",
    "other solver: clusters, x and y swapped",
]
EXPECTED: dict[Data, DoubtCode] = {
    "two betas, halves": "two-materials",
    "two betas, a lump": "two-materials",
    "x and y swapped": "axes-swapped",
    "one sign turned": "axes-swapped",
    "positions mirrored": "axes-swapped",
    "noise stated 15 times too small": "noise-contradicted",
    "other solver: clusters, x and y swapped": "axes-swapped",
}
"""Error of the data, if any; elsewhere such a reason is a false alarm."""

MATERIALS: dict[Data, Floats] = {
    "other solver: whole face, nu 0": stiffness(1.0, 0.0),
    "other solver: whole face, nu .3": stiffness(1.0, 0.3),
    "other solver: whole face, nu .45": stiffness(1.0, 0.45),
    "other solver: whole face, plane strain, nu .45": stiffness(1.0, 0.45, strain=True),
    "other solver: whole face, orthotropic": stiffness(2.5, 0.3),
    "other solver: patch, nu .3": stiffness(1.0, 0.3),
}
MOTIONS: tuple[Motion, ...] = get_args(Motion)

TWO: tuple[Data, ...] = ("two betas, halves", "two betas, a lump")

SOFT, FIRM = 0.8, 0.2
"""The betas of two materials."""

LUMP = 0.3
"""Share of the clusters that a lump holds."""


@dataclass(frozen=True, slots=True)
class DoubtCase:
    """One random object: what is done to its data, its number and the seed."""

    data: Data
    number: int
    seed: int


@dataclass(frozen=True, slots=True)
class Doubted:
    """Result of one object. codes: codes of the reasons; truths: all betas that are in it; none of finite elements"""

    data: Data
    codes: tuple[DoubtCode, ...]
    verdict: Verdict
    truths: tuple[float, ...]
    interval: tuple[float, float]

    @property
    def held(self) -> bool:
        """Whether the interval holds all that is true of the body."""
        return bool(self.truths) and all(self.interval[0] <= one <= self.interval[1] for one in self.truths)


def try_doubts(case: DoubtCase) -> Doubted:
    """One random object through the calibration."""
    rng = np.random.default_rng([case.seed, 55, get_args(Data).index(case.data), case.number])
    dim = random_dim(case.number)
    truths: tuple[float, ...] = ()
    if case.data.startswith("other solver"):
        errors, size = Errors(), int(rng.integers(2, 5))
        if case.data in MATERIALS:
            motion, patch = MOTIONS[case.number % len(MOTIONS)], "patch" in case.data
            other = pushed_elements(rng, MATERIALS[case.data], motion, errors, patch=patch)
        else:
            other = pushed_clusters(rng, errors, dim)
            size, truths = other.clusters, (other.beta,)
        if "swapped" in case.data:
            moved = (other.seen - other.rest)[:, [1, 0, *range(2, dim)]]
            other = dataclasses.replace(other, seen=other.rest + moved)
        seen = observed(other, errors)
    elif case.data == "finite elements, one material":
        foam = FoamBody(rng, dim, even=True)
        size = int(rng.integers(2, 5))
        seen = observe_foam(foam, *foam.poke(rng), rng)
    else:
        body = random_body(rng, dim)
        while case.data in TWO and np.ptp(_middles(body), axis=0).max() < 0.5 * SPACING_M:
            body = random_body(rng, dim)  # one that has two halves
        size = body.cluster_size
        seen, truths = _seen(body, case.data, rng)
    found = calibrate([seen], FitOptions(Model(cluster_size=size), BOUNDS, candidates=CANDIDATES)).estimate
    codes = tuple(dict.fromkeys(one.code for one in found.reasons))
    return Doubted(case.data, codes, found.verdict, truths, found.interval)


def _seen(body: RandomBody, data: Data, rng: np.random.Generator) -> tuple[Observation, tuple[float, ...]]:
    """Input of the calibration, and its true betas."""
    truths: tuple[float, ...] = (float(rng.uniform(*BOUNDS)),)
    if data in TWO:
        deformed, truths = _two_betas(body, data, rng)
    else:
        deformed = body.deform(truths[0])
    cells = {"noise over a cell, held noisy": 1.0, "noise over three cells, held noisy": 3.0}.get(data)
    sigma = random_sigma(rng)
    noise = sigma * random_noise(rng, body.rest / (cells or 1.0), correlated=cells is not None)
    if cells is None:
        noise[body.held] = 0.0
    deformed = deformed + noise
    moved, dim = deformed - body.rest, body.rest.shape[1]
    turn = np.eye(dim)
    if data == "x and y swapped":
        turn[[0, 1]] = turn[[1, 0]]
    elif data == "one sign turned":
        turn[1, 1] = -1.0
    deformed = body.rest + moved @ turn.T
    if data == "positions mirrored":
        deformed[:, [0, 1]] = deformed[:, [1, 0]]
    stated = {"noise not stated": None, "noise stated 15 times too small": sigma / 15.0}.get(data, sigma)
    return body.observe(deformed, stated), truths


def _middles(body: RandomBody) -> FloatArray:
    """(C, d) where the clusters are [m]."""
    grouped = Model(cluster_size=body.cluster_size).grouping(body.observe(body.rest))
    return np.array([body.rest[row].mean(axis=0) for row in grouped])


def _two_betas(body: RandomBody, data: Data, rng: np.random.Generator) -> tuple[FloatArray, tuple[float, float]]:
    """The static state of a body of which one half, or a lump, has another beta."""
    middles = _middles(body)
    if data == "two betas, halves":
        apart = np.flatnonzero(np.ptp(middles, axis=0) > 0.5 * SPACING_M)
        along = middles[:, rng.choice(apart)]
        first: BoolArray = along < 0.5 * (along.min() + along.max()) + 1e-9
    else:
        away = np.linalg.norm(middles - middles[rng.integers(len(middles))], axis=1)
        first = away <= np.quantile(away, LUMP)
    beta = np.where(first == (rng.random() < 0.5), SOFT, FIRM)
    state = Model(cluster_size=body.cluster_size).body(body.observe(body.rest)).relax(body.held_position, beta[None])
    return np.asarray(state.position[0]), (FIRM, SOFT)


CODES: tuple[DoubtCode, ...] = get_args(DoubtCode)


def _named(some: Sequence[Doubted]) -> dict[DoubtCode, Rate]:
    """Number of each reason."""
    rates = {code: Rate.of(code in one.codes for one in some) for code in CODES}
    return {code: rate for code, rate in rates.items() if rate.hits}


QUANTITIES: tuple[Quantity[Sequence[Doubted]], ...] = (
    Quantity("data", lambda some: some[0].data),
    Quantity("expected", lambda some: EXPECTED.get(some[0].data)),
    Quantity("named", _named),
    Quantity("identified", lambda some: Rate.of(one.verdict == "identified" for one in some)),
    # although the interval leaves out what is true
    Quantity(
        "identified_wrong",
        lambda some: Rate.of(one.verdict == "identified" and bool(one.truths) and not one.held for one in some),
    ),
)


def doubt_rows(tried: Sequence[Doubted]) -> list[Row]:
    """All quantities, of each kind of data."""
    return rows(by(tried, lambda one: one.data).values(), QUANTITIES)


def doubt_plan(count: int, seed: int) -> list[DoubtCase]:
    """So many objects of each kind of data."""
    return [DoubtCase(data, number, seed) for data in get_args(Data) for number in range(count)]
