"""Do 90 % intervals hold 90 % of the truths? Random bodies of known beta, each kind of noise, and data without any
information, through the same calibration as a user's.

A body is a lattice in the plane or in space whose first layer is fixed while a patch of its last one is moved. Its
truth is the engine's static state for a random beta, in float64; what is "measured" has noise on top. The ranks of the
truths in their posteriors are even if these are right (simulation-based calibration, Talts et al. 2018)."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.distance import cdist
from scipy.stats import binom

from deformscope.arrays import FloatArray, IntArray
from deformscope.pictures.figures import canvas, png_of
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.estimate import DoubtCode, Estimate, Verdict
from deformscope.stages.msm.clusters import held_mask
from studies.field_bodies import SPACING_M, lattice

BOUNDS = (0.0, 0.99)
CANDIDATES = 40
NOISE_SHARES = (0.005, 0.05)
"""Sizes of the noise, even in their logarithm between these [spacings]."""

NEAR_ONE = 0.97
"""Truths above are reported apart, as is 0: there the range ends."""

Truth = Literal["prior", "zero", "near one"]
Nothing = Literal["noise alone", "rigid motion", "no motion", "shuffled labels", "random motion"]
NOTHING: tuple[Nothing, ...] = ("noise alone", "rigid motion", "no motion", "shuffled labels", "random motion")
"""Data without information: shuffled labels = the true displacements of the free particles, dealt out at random."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One kind of noise.

    held_noise: the prescribed positions have it too; said: whether that is stated (`held_measured`)
    correlated: neighbours share it, over about one spacing; stated: factors by which the noise that is given is wrong
    """

    name: str
    held_noise: bool
    said: bool | None = None
    correlated: bool = False
    stated: tuple[float, ...] = (1.0,)


WRONG = (0.25, 0.5, 2.0, 4.0)
CONDITIONS = (
    Condition("independent noise", False),
    Condition("independent noise, held stated exact", False, said=False),
    Condition("noisy held positions", True),
    Condition("noisy held positions, stated", True, said=True),
    Condition("correlated over a cell", True, correlated=True),
    Condition("correlated over a cell, held exact", False, correlated=True),
    Condition("wrong noise level", True, stated=WRONG),
    Condition("wrong noise level, held exact", False, stated=WRONG),
)


@dataclass(frozen=True, slots=True)
class Case:
    """One random object to try: its place in `CONDITIONS`, what its truth is drawn from, its number and the seed."""

    condition: int
    truth: Truth
    number: int
    seed: int
    level: float = 0.9


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one object. beta: its truth (of theta, where that is fitted); rank: mass of the posterior below it
    seconds: processor time of the fit; codes: codes of the reasons to doubt it"""

    condition: str
    dim: int
    cluster_size: int
    particles: int
    beta: float
    value: float
    interval: tuple[float, float]
    rank: float
    verdict: Verdict
    seconds: float
    codes: tuple[DoubtCode, ...] = ()

    @property
    def covered(self) -> bool:
        return self.interval[0] <= self.beta <= self.interval[1]

    @property
    def confident_wrong(self) -> bool:
        """The interval leaves the truth out by more than its own width."""
        low, high = self.interval
        return max(low - self.beta, self.beta - high) > high - low


@dataclass(frozen=True, slots=True)
class NothingCase:
    """Data without information: what kind, its number and the seed."""

    kind: Nothing
    number: int
    seed: int


@dataclass(frozen=True, slots=True)
class RandomBody:
    """A lattice and what is done to it. rest: (K, d) [m]; held: (n,); held_position: (n, d) [m]"""

    rest: FloatArray
    shape: tuple[int, ...]
    held: IntArray
    held_position: FloatArray
    cluster_size: int

    def observe(
        self, deformed: FloatArray, noise: float | None = None, held_measured: bool | None = None
    ) -> Observation:
        """The body as seen in one deformed shape (K, d)."""
        count = len(self.rest)
        return Observation(
            self.rest,
            deformed,
            self.held,
            np.ones(count, dtype=bool),
            noise=None if noise is None else np.full(count, noise),
            shape=self.shape,
            cell=np.arange(count),
            held_measured=held_measured,
        )

    def deform(self, beta: float) -> FloatArray:
        """Its static state (K, d)."""
        body = Model(cluster_size=self.cluster_size).body(self.observe(self.rest))
        return np.asarray(body.relax(self.held_position, beta).position[0])


def random_body(rng: np.random.Generator, dim: int) -> RandomBody:
    """4 to 8 by 4 to 12 particles in the plane, 3 to 5 per side in space; one to some of the far side moved by about a
    spacing; clusters of 2 to 5 per side."""
    shape = (int(rng.integers(4, 9)), int(rng.integers(4, 13))) if dim == 2 else tuple(map(int, rng.integers(3, 6, 3)))
    rest = lattice(shape)
    near = np.flatnonzero(rest[:, 0] <= 0.0)
    far = np.flatnonzero(rest[:, 0] >= rest[:, 0].max() - 1e-9)
    middle = rest[rng.choice(far)]
    patch = far[np.linalg.norm(rest[far] - middle, axis=1) <= SPACING_M * rng.uniform(0.5, 2.0)]
    held = np.concatenate([near, patch])
    position = rest[held].copy()
    position[len(near) :] += rng.normal(0.0, SPACING_M * rng.uniform(0.4, 1.2), dim)
    return RandomBody(rest, shape, held, position, int(rng.integers(2, 6)))


def random_dim(number: int) -> int:
    """A third of the objects, by their numbers, is in space."""
    return 3 if number % 3 == 2 else 2


def random_sigma(rng: np.random.Generator) -> float:
    """Deviation of an observed coordinate [m]."""
    return SPACING_M * float(np.exp(rng.uniform(*np.log(NOISE_SHARES))))


def random_noise(rng: np.random.Generator, rest: FloatArray, *, correlated: bool) -> FloatArray:
    """Noise of unit variance (K, d): white, or shared by neighbours with a correlation drawn out of exponential, Matern
    3/2 and Gaussian, of length 0.7 to 1.3 spacings."""
    white = rng.standard_normal(rest.shape)
    if not correlated:
        return white
    s = cdist(rest, rest) / (SPACING_M * rng.uniform(0.7, 1.3))
    kind = rng.integers(3)
    root3 = np.sqrt(3.0) * s
    covariance = (np.exp(-s), (1.0 + root3) * np.exp(-root3), np.exp(-0.5 * s**2))[kind]
    return np.asarray(np.linalg.cholesky(covariance + 1e-9 * np.eye(len(rest))) @ white)


def try_object(case: Case) -> Outcome:
    """One random object through the calibration."""
    condition = CONDITIONS[case.condition]
    which = ("prior", "zero", "near one").index(case.truth)
    rng = np.random.default_rng([case.seed, case.condition, which, case.number])
    body = random_body(rng, random_dim(case.number))
    beta = {"prior": float(rng.uniform(*BOUNDS)), "zero": 0.0, "near one": float(rng.uniform(NEAR_ONE, BOUNDS[1]))}
    truth = beta[case.truth]
    sigma = random_sigma(rng)
    noise = sigma * random_noise(rng, body.rest, correlated=condition.correlated)
    if not condition.held_noise:
        noise[body.held] = 0.0
    stated = sigma * float(rng.choice(condition.stated))
    seen = body.observe(body.deform(truth) + noise, stated, condition.said)
    options = FitOptions(Model(cluster_size=body.cluster_size), BOUNDS, candidates=CANDIDATES, level=case.level)
    return fitted(condition.name, truth, [seen], options)[0]


def fitted(
    name: str, truth: float, seen: Sequence[Observation], options: FitOptions, *, one_motion: bool = False
) -> tuple[Outcome, Calibration]:
    """Fit what was seen of one object, and compare it with the truth. name: name of the condition"""
    started = time.process_time()
    found = calibrate(seen, options, one_motion=one_motion)
    estimate = found.estimate
    outcome = Outcome(
        condition=name,
        dim=seen[0].rest.shape[1],
        cluster_size=options.model.cluster_size or 0,
        particles=len(seen[0].rest),
        beta=truth,
        value=estimate.value,
        interval=estimate.interval,
        rank=found.inferred.posterior.rank(truth),
        verdict=estimate.verdict,
        seconds=time.process_time() - started,
        codes=tuple(dict.fromkeys(one.code for one in estimate.reasons)),
    )
    return outcome, found


def try_nothing(case: NothingCase) -> Verdict:
    """The verdict on data without information; the noise is stated in every other case."""
    rng = np.random.default_rng([case.seed, 99, NOTHING.index(case.kind), case.number])
    body = random_body(rng, random_dim(case.number))
    return fit_nothing(body, case.kind, rng, stated=case.number % 2 == 0).verdict


def fit_nothing(body: RandomBody, kind: Nothing, rng: np.random.Generator, *, stated: bool) -> Estimate:
    """A body's fit to data of one kind without information; stated: the noise is."""
    sigma = random_sigma(rng)
    noise = sigma * random_noise(rng, body.rest, correlated=bool(rng.integers(2)))
    deformed = body.rest + (0.0 if kind == "no motion" else noise)
    if kind == "rigid motion":
        deformed = _turned(body.rest, rng) + noise
    elif kind in ("shuffled labels", "random motion"):
        moved = body.deform(float(rng.uniform(*BOUNDS))) - body.rest
        free = np.flatnonzero(~held_mask(len(body.rest), body.held))
        if kind == "shuffled labels":
            moved[free] = moved[rng.permutation(free)]
        else:
            moved[free] = rng.normal(0.0, np.sqrt(np.mean(moved[free] ** 2)), (len(free), body.rest.shape[1]))
        deformed = body.rest + moved + noise
    seen = body.observe(deformed, sigma if stated else None)
    options = FitOptions(Model(cluster_size=body.cluster_size), BOUNDS, candidates=CANDIDATES)
    return calibrate([seen], options).estimate


def _turned(rest: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Turned by some degrees, and moved by some spacings."""
    matrix, _ = np.linalg.qr(np.eye(rest.shape[1]) + rng.normal(0.0, 0.1, (rest.shape[1],) * 2))
    matrix *= np.sign(np.diag(matrix))
    middle = rest.mean(axis=0)
    return np.asarray((rest - middle) @ matrix.T + middle + rng.normal(0.0, 2.0 * SPACING_M, rest.shape[1]))


# All of it -----------------------------------------------------------------------------------------------------------

QUICK_OBJECTS = 15
PART_APART = 5
"""Number of objects in between for one object at 0 and one near 1; and for as many finite element bodies."""

NOTHING_CASES = 200


def plan(objects: int, seed: int, level: float, *, quick: bool) -> tuple[list[Case], list[NothingCase]]:
    """All objects to try, and all data without information."""
    count = QUICK_OBJECTS if quick else objects
    apart = -(-count // PART_APART)
    numbers: dict[Truth, int] = {"prior": count, "zero": apart, "near one": apart}
    cases = [
        Case(condition, truth, number, seed, level)
        for condition in range(len(CONDITIONS))
        for truth, many in numbers.items()
        for number in range(many)
    ]
    nothing = min(NOTHING_CASES, max(count // 2, 5))
    return cases, [NothingCase(kind, number, seed) for kind in NOTHING for number in range(nothing)]


BINS = 10


def rank_counts(outcomes: Sequence[Outcome]) -> dict[str, list[int]]:
    """How many truths fall into each tenth of their posterior, of each condition; truths at the bound 0 left out."""
    found: dict[str, list[int]] = {}
    for name in dict.fromkeys(one.condition for one in outcomes):
        ranks = [one.rank for one in outcomes if one.condition == name]
        found[name] = np.histogram(ranks, BINS, (0.0, 1.0))[0].tolist()
    return found


def ranks_png(counts: dict[str, list[int]]) -> bytes:
    """A histogram for each condition, with the band that holds 99 % of bins if the posterior is right."""
    columns = min(4, len(counts))
    rows = -(-len(counts) // columns)
    figure = canvas(3.2 * columns, 2.5 * rows + 0.5, layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel())
    edges = np.linspace(0.0, 1.0, BINS + 1)
    for place, axis in enumerate(axes):
        axis.set_visible(place < len(counts))
    for place, (axis, (name, count)) in enumerate(zip(axes, counts.items(), strict=False)):
        total = sum(count)
        low, high = binom.ppf([0.005, 0.995], total, 1.0 / BINS)
        axis.stairs(count, edges, fill=True, color="tab:blue", label="truths")
        axis.axhspan(low, high, color="0.2", alpha=0.2, label="99 % of bins, if right")
        axis.axhline(total / BINS, color="0.2", linewidth=0.8)
        axis.set_title(name, fontsize=9)
        axis.set_xlim(0.0, 1.0)
        axis.set_ylim(0.0, 1.15 * max(*count, high))
        if place % columns == 0:
            axis.set_ylabel("truths in the bin")
        if place >= len(counts) - columns:
            axis.set_xlabel("posterior mass below the truth")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=8)
    return png_of(figure, 130)
