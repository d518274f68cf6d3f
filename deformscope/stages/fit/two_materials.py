"""Whether the residuals of a fit show that the parameter differs between two parts of the body.

The body is split in several ways: across each of its axes, into the parts near to the push and far from it, and into an
inclusion, at one of several places, and the rest. For each split the residuals get one more term, a beta that is larger
on one side and smaller on the other. The difference of betas is added to the fitted parameters and to the other
explanations (noise, its reach, misfit, wrong prescribed positions: `deformscope.stages.fit.noise`). Twice the logarithm
of the likelihood's gain is the statistic of a likelihood ratio test (a score test, as the states are linear in the
betas about the fit). A split that explains more than noise does is fitted by simulation, and has to reduce the
residuals much more."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit import least_squares
from deformscope.stages.fit.doubts import residual_ratio
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.residuals import Residuals
from deformscope.stages.msm.clusters import Clusters

STEP = 0.2
"""Change of -log(1 - beta) of each side, for the derivative."""

ROUNDS, SMALL_STEP = 5, 0.1
"""Newton's steps to the likeliest betas at most; one of this share of a standard deviation is the last."""

INCLUSIONS, INCLUSION = 8, 0.3
"""Places of inclusions that are tried, and the share of the clusters that each holds."""

GAIN = 6.0
"""Twice the log likelihood that a second beta must gain."""

APART, LEFT = 0.05, 0.8
"""Least difference of the two betas, and largest share of the error (root mean square) that they leave.

These and `GAIN`, the least of 6 to 18 that few bodies of one material reach, were chosen on tuning seeds
(`studies.seeds`), 100 bodies per kind. No body of one beta reaches them together with noise that is independent or
shared over a cell, 2 % do with noise shared over three, and 3 % of finite element bodies of one modulus. So do 71 % of
bodies whose halves have betas of 0.2 and 0.8, and 60 % of those with an inclusion."""

GAIN_SURE, LEFT_SURE, LIKE_STATED = 12.0, 0.95, (0.5, 3.0)
"""If residuals are this many times as large as the stated noise, they are noise for the most part, and the likelihood
has two betas' chance of fitting it. Twice its logarithm must then gain that much, and the betas leave that share. On
the same tuning seeds two betas were reported in 91 and 73 of 100 instead of 81 and 67, and in no more bodies of one.
Smaller residuals are those of smooth errors that the fit has taken in: gains are then of its last digits."""

DIFFERENCE = 1e-2
"""Change of -log(1 - beta), for derivatives of the full fit."""


@dataclass(frozen=True, slots=True)
class BodySplit:
    """A way to divide a body into two parts. first: (C,) clusters of the first part; names: where the parts are"""

    names: tuple[str, str]
    first: BoolArray


def splits(seen: Observation, grouped: Clusters) -> list[BodySplit]:
    """The splits of one observation's clusters: into halves of about as many, or an inclusion and the rest."""
    middles = np.array([seen.rest[row].mean(axis=0) for row in grouped])
    found = [((f"at low {one}", f"at high {one}"), along) for one, along in zip("xyz", middles.T, strict=False)]
    pressed = seen.rest[seen.touched].mean(axis=0) if len(seen.touched) else seen.rest[seen.held].mean(axis=0)
    found.append((("near the push", "far from the push"), np.linalg.norm(middles - pressed, axis=1)))
    made = []
    for names, along in found:
        # clusters in the middle count with the second part
        first = along < np.median(along) - 1e-9 * (1e-300 + np.ptp(along))
        if first.any() and not first.all():
            made.append(BodySplit(names, first))
    return made + _inclusions(middles, made, seen.unit)


def _inclusions(middles: FloatArray, others: Sequence[BodySplit], unit: str) -> list[BodySplit]:
    """Splits of the clusters, of middles (C, d), into those nearest to one of some distant places and the others."""
    found: list[BodySplit] = []
    away = np.linalg.norm(middles - middles.mean(axis=0), axis=1)
    for _ in range(INCLUSIONS):
        centre = middles[int(away.argmax())]
        apart = np.linalg.norm(middles - centre, axis=1)
        away = np.minimum(away, apart)
        first: BoolArray = apart <= np.quantile(apart, INCLUSION)
        known = [one.first for one in (*others, *found)]
        if not first.all() and not any(np.array_equal(first, one) or np.array_equal(~first, one) for one in known):
            place = ", ".join(f"{value:.3g}" for value in centre)
            found.append(BodySplit((f"around ({place}) {unit}", "elsewhere"), first))
    return found


@dataclass(frozen=True, slots=True)
class Local:
    """One observation, linearised at its fit.

    part: its particles and error model; residual: (n, d) residual at the fit; response: (n, d, m) there, to held
    positions; fitted: (q, n, d) derivatives by the parameters fitted; apart: (s, n, d) derivatives by a difference
    between the parts of each split; weight: weight of the observation"""

    part: Residuals
    residual: FloatArray
    response: FloatArray
    fitted: FloatArray
    apart: FloatArray
    weight: float = 1.0


def gains(local: Sequence[Local]) -> FloatArray:
    """(s,) gain of twice the log likelihood by a difference between the parts of each split."""
    every = [np.concatenate([one.residual[None], one.fitted, one.apart]) for one in local]
    pairs = zip(local, every, strict=True)
    products = [one.part.errors.products(some, one.response, one.part.kept) for one, some in pairs]

    def likelihood(mix: FloatArray) -> FloatArray:
        """(g,) log likelihood of sums (g, 1 + q + s) of the residual and all derivatives."""
        total = np.zeros(len(mix))
        for one, found in zip(local, products, strict=True):
            total += one.weight * logsumexp(one.part.errors.judged(found, mix).log_likelihood, axis=0)
        return total

    flat = np.concatenate([some.reshape(len(some), -1) for some in every], axis=1)
    common = list(range(1, 1 + len(local[0].fitted)))
    before = _highest(likelihood, flat, common)
    after = [_highest(likelihood, flat, [*common, row]) for row in range(common[-1] + 1, len(flat))]
    return np.maximum(2.0 * (np.array(after) - before), 0.0)


def _highest(likelihood: Callable[[FloatArray], FloatArray], flat: FloatArray, columns: Sequence[int]) -> float:
    """The highest log likelihood of the residual, the first row of flat (1 + q, n), less multiples of some of the
    derivatives in the others, by Newton's steps."""

    def taken(multiple: FloatArray) -> FloatArray:
        mix = np.zeros((len(multiple), len(flat)))
        mix[:, 0] = 1.0
        mix[:, columns] = -multiple
        return likelihood(mix)

    # in directions that are independent, of a size that residuals as they are make likely
    u, size, _ = np.linalg.svd(flat[columns], full_matrices=False)
    keep = size > 1e-8 * max(float(size[0]), 1e-300)
    if not size[0] > 0.0:
        return float(taken(np.zeros((1, len(columns))))[0])
    turn = (u[:, keep] / size[keep]).T
    unit = float(np.sqrt(np.mean(flat[0] ** 2))) or 1.0
    at = turn @ (flat[columns] @ flat[0])
    eye = np.eye(len(turn))  # a stencil by which a quadratic function of as many numbers is known
    rows = [sign * one for one in eye for sign in (1.0, -1.0)] + [one + other for one, other in combinations(eye, 2)]
    stencil = np.array([np.zeros(len(turn)), *rows])
    best, width = -np.inf, unit
    for _ in range(ROUNDS):
        value = taken((at + width * stencil) @ turn)
        best = max(best, float(value.max()))
        step = _peak(stencil, value)
        at = at + width * np.clip(step, -5.0, 5.0)
        if np.abs(step).max() < SMALL_STEP:
            break
        width *= 0.5 if np.abs(step).max() < 1.0 else 1.0
    return max(best, float(taken((at @ turn)[None])[0]))


def _peak(stencil: FloatArray, value: FloatArray) -> FloatArray:
    """(q,) where the quadratic through values (s,) at a stencil (s, q) is highest; bent up, along its slope."""
    q = stencil.shape[1]
    middle, up, down = value[0], value[1 : 2 * q + 1 : 2], value[2 : 2 * q + 2 : 2]
    slope = 0.5 * (up - down)
    bend = np.diag(up + down - 2.0 * middle)
    for place, (i, j) in enumerate(combinations(range(q), 2)):
        bend[i, j] = bend[j, i] = value[2 * q + 1 + place] - up[i] - up[j] + middle
    curve, along = np.linalg.eigh(bend)
    curve = np.minimum(curve, -1e-3 * max(float(np.abs(curve).max()), 1e-12))
    return np.asarray(along @ ((along.T @ slope) / -curve))


@dataclass(frozen=True, slots=True)
class FittedBody:
    """One observation at its fit, with the values for changing the beta of each cluster.

    part: its particles and error model; grouped: its clusters; position: (K, d) simulated positions at the fit
    response: (n, d, m) there, to held positions; others: (q, n, d) derivatives by parameters besides beta
    states: positions (B, K, d) for -log(1 - beta) of each cluster (B, C); weight: weight of the observation
    whole: if the observation is one frame of a history, all observed numbers of it (n,), and their derivatives for (B,
    C), as (B, n): two betas fit errors of one frame more easily than those of all"""

    part: Residuals
    grouped: Clusters
    position: FloatArray
    response: FloatArray
    others: FloatArray
    states: Callable[[FloatArray], FloatArray]
    weight: float = 1.0
    whole: tuple[FloatArray, Callable[[FloatArray], FloatArray]] | None = None

    def compared(self) -> tuple[FloatArray, Callable[[FloatArray], FloatArray]]:
        """The compared numbers of two betas, (n,), and their derivatives by -log(1 - beta) (B, C)."""
        judged = self.part.judged
        own = self.part.observed.ravel(), lambda at: self.states(at)[:, judged].reshape(len(at), -1)
        return self.whole or own

    def local(self, stretched: float, ways: Sequence[BodySplit]) -> Local:
        """About one -log(1 - beta) of all clusters."""
        sides = np.array([np.where(way.first, 0.5, -0.5) for way in ways] + [np.full(self.grouped.count, 0.5)])
        sides = STEP * np.concatenate([sides, -sides])
        ahead = self.states(np.maximum(stretched + sides, 0.0))[:, self.part.judged]
        each = (ahead[: len(ways) + 1] - ahead[len(ways) + 1 :]) / STEP
        fitted = np.concatenate([each[-1:], self.others])
        return Local(self.part, self.part.left(self.position), self.response, fitted, each[:-1], self.weight)


def two_materials(bodies: Sequence[FittedBody], beta: float, top: float, rival: float = np.inf) -> Iterator[Doubt]:
    """Whether two betas explain data that one, fitted to all bodies, does not.

    beta: the single beta of the fit; top: the highest beta that is searched; rival: squared error [unit^2] of another
    explanation, which two betas have to undercut"""
    every = [{way.names: way for way in splits(body.part.seen, body.grouped)} for body in bodies]
    names = [name for name in every[0] if all(name in one for one in every)]
    if not names:
        return
    highest = float(-np.log1p(-top))
    stretched = float(np.clip(-np.log1p(-beta), 0.5 * STEP, highest))
    local = [body.local(stretched, [one[name] for name in names]) for body, one in zip(bodies, every, strict=True)]
    if not all(np.isfinite(one.apart).all() and np.isfinite(one.fitted).all() for one in local):
        return
    gain = gains(local)
    best = int(gain.argmax())
    if gain[best] < GAIN:
        return
    ways = [one[names[best]] for one in every]
    each = [body.compared() for body in bodies]
    observed = np.concatenate([numbers for numbers, _ in each])
    weight = np.repeat([np.sqrt(body.weight) for body in bodies], [len(numbers) for numbers, _ in each])

    def simulate(at: FloatArray) -> FloatArray:
        states = [found(np.where(way.first, at[:, :1], at[:, 1:])) for (_, found), way in zip(each, ways, strict=True)]
        return np.asarray(np.concatenate(states, axis=1) * weight)

    both = np.array([[0.0, highest]] * 2)
    found = least_squares.minimise(simulate, observed * weight, np.full(2, stretched), both, np.full(2, DIFFERENCE))

    def simulate_alike(at: FloatArray) -> FloatArray:
        return simulate(np.repeat(at, 2, axis=1))

    one = np.full(1, stretched), both[:1], np.full(1, DIFFERENCE)
    alike = least_squares.minimise(simulate_alike, observed * weight, *one)
    low, high = -np.expm1(-found.at)
    share = float(np.sqrt(found.squares / alike.squares))
    enough = share < LEFT or (share < LEFT_SURE and gain[best] > GAIN_SURE and _like_stated(bodies))
    if abs(high - low) < APART or not enough or found.squares >= rival:
        return
    text = (
        f"residuals show two materials or thicknesses: beta {low:.2g} {names[best][0]} and {high:.2g} {names[best][1]} "
        f"leave {share:.0%} of the error of one beta"
    )
    yield Doubt("two-materials", text, "unidentified")


def _like_stated(bodies: Sequence[FittedBody]) -> bool:
    """Whether a noise was stated, and residuals are about as large."""
    floor = max(body.part.measured.floor for body in bodies)
    ratio = residual_ratio([body.part.seen for body in bodies], [body.position for body in bodies], floor)
    return ratio is not None and LIKE_STATED[0] < ratio < LIKE_STATED[1]
