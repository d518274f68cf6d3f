"""Branches of a creep compliance: strengths and retardation times, and the relaxation that follows from them, as
weighted draws of a posterior around its likeliest parameters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.creep_spectra import Spectrum
from deformscope.stages.fit.estimate import Doubt

DRAWS, TEMPERED, FREEDOM = 4000, 0.6, 4.0
"""Number of draws of all choices of all models; power of their evidence, which is only roughly known, by which choices
are drawn; degrees of freedom of the proposal."""
ROUNDS, DAMPING, SETTLED = 30, 1e-2, 1e-3
"""The search for the likeliest parameters: most rounds, first damping, change of half the squares at its end."""

RIDGE = 1e-9
"""Share of a curvature's diagonal that is added where rounding leaves none of a direction."""


def median_and_interval(value: FloatArray, weight: FloatArray, level: float = 0.9) -> tuple[float, tuple[float, float]]:
    """Median and interval of draws (n,) with weights (n,), in the unit of the draws."""
    order = np.argsort(value)
    below = np.cumsum(weight[order]) / weight.sum()
    tail = round(0.5 * (1.0 - level), 12)
    at = np.minimum(np.searchsorted(below, (tail, 0.5, 1.0 - tail)), len(order) - 1)
    low, middle, high = value[order[at]].tolist()
    return middle, (low, high)


@dataclass(frozen=True, slots=True)
class DrawnModel:
    """One model with many choices that differ only in their priors.

    mean: (c, k) mean of the Gaussian priors of each choice, where the search begins; spread: (k,) deviations, infinite:
    none; prior: probability of all choices together; each is equally probable; residuals: computes residuals (d, m)
    from parameters (d, k), without priors; linear: computes from (d, k) residuals and their derivatives (d, k, m)"""

    mean: FloatArray
    spread: FloatArray
    prior: float
    residuals: Callable[[FloatArray], FloatArray]
    linear: Callable[[FloatArray], tuple[FloatArray, FloatArray]]

    def minima(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The likeliest parameters of each choice (c, k), half its squares there (c,), and their curvature (c, k, k):
        all in one pass (Levenberg 1944, Marquardt 1963)."""
        best, holds = self.mean, np.diag(1.0 / self.spread**2)
        off, moved = self.linear(best)
        least, damping = self.half(best, self.mean, off), np.full(len(best), DAMPING)
        for _ in range(ROUNDS):
            curved = moved @ moved.transpose(0, 2, 1) + holds
            slope = (moved @ off[..., None])[..., 0] + (best - self.mean) / self.spread**2
            damped = curved + damping[:, None, None] * np.eye(len(holds)) * curved
            tried = best - np.linalg.solve(damped, slope[..., None])[..., 0]
            new_off, new_moved = self.linear(tried)
            half = self.half(tried, self.mean, new_off)
            better = half < least
            done = bool((np.abs(half - least) < SETTLED).all())
            least = np.where(better, half, least)
            best, off = np.where(better[:, None], tried, best), np.where(better[:, None], new_off, off)
            moved = np.where(better[:, None, None], new_moved, moved)
            damping = np.where(better, 0.2 * damping, 8.0 * damping)
            if done:
                break
        return best, least, moved @ moved.transpose(0, 2, 1) + holds

    def likeliest(self) -> FloatArray:
        """(1, k) the likeliest parameters of all choices."""
        best, least, _ = self.minima()
        return best[[int(np.argmin(least))]]

    def log_size(self) -> float:
        """Logarithm of the divisor of each choice's density."""
        known = self.spread[np.isfinite(self.spread)]
        return float(np.log(np.sqrt(2.0 * np.pi) * known).sum() - np.log(self.prior / len(self.mean)))

    def half(self, at: FloatArray, mean: FloatArray, off: FloatArray) -> FloatArray:
        """(d,) half the squares of parameters (d, k) about their priors (d, k), and of residuals (d, m)."""
        return np.asarray(0.5 * ((off**2).sum(axis=1) + (((at - mean) / self.spread) ** 2).sum(axis=1)))


def draw_about_each(models: Sequence[DrawnModel], random: np.random.Generator) -> tuple[list[FloatArray], FloatArray]:
    """Draws (d_i, k_i) of each model, and the weights (d,) of all, one after the other, which add up to 1.

    Choices are drawn by their evidence as a Gaussian about their most probable parameters gives it (Laplace).
    Parameters about these are drawn from a heavier tail, and weighted by their density over that of the draw."""
    minima = [one.minima() for one in models]
    roots = [_root(curved) for _, _, curved in minima]
    logs = [np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) for root in roots]
    evidence = [
        0.5 * len(one.spread) * np.log(2.0 * np.pi) - least - log - one.log_size()
        for one, (_, least, _), log in zip(models, minima, logs, strict=True)
    ]
    chance = TEMPERED * np.concatenate(evidence)
    chance = np.exp(chance - scipy.special.logsumexp(chance))
    number = np.split(random.multinomial(DRAWS, chance), np.cumsum([len(one) for one in evidence])[:-1])
    log_chance = np.split(np.log(np.maximum(chance, 1e-300)), np.cumsum([len(one) for one in evidence])[:-1])
    drawn, log_weight = [], []
    each = zip(models, minima, roots, logs, number, log_chance, strict=True)
    for one, (best, _, _), root, log, many, log_part in each:
        choice = np.repeat(np.arange(len(best)), many)
        # each direction has its own tail: a branch that is hardly seen goes far in one of them
        apart = random.standard_t(FREEDOM, (len(choice), best.shape[1]))
        some = best[choice] + np.linalg.solve(root[choice].transpose(0, 2, 1), apart[..., None])[..., 0]
        log_density = scipy.stats.t.logpdf(apart, FREEDOM).sum(axis=1)
        log_proposal = log_density + log[choice] + log_part[choice]
        drawn.append(some)
        log_weight.append(-one.half(some, one.mean[choice], one.residuals(some)) - one.log_size() - log_proposal)
    every = np.concatenate(log_weight)
    every -= scipy.special.logsumexp(every) - np.log(len(every))
    weight = np.exp(np.minimum(every, 0.5 * np.log(len(every))))  # truncated (Ionides 2008)
    return drawn, weight / weight.sum()


def _root(curved: FloatArray) -> FloatArray:
    """(c, k, k) lower roots of curvatures, also of those that have no width in a direction but for rounding."""
    try:
        return np.linalg.cholesky(curved)
    except np.linalg.LinAlgError:
        return np.linalg.cholesky(curved + RIDGE * np.eye(curved.shape[1]) * curved)


RAMP_STEPS = 60
"""Number of steps of an approach over which its force is summed."""
KEPT_AFTER_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
DOUBTED = 0.5
"""Probability of an unseen relaxed state from which it is reported as a reason."""
OPEN = 0.15
"""Probability of unseen relaxation from which intervals are open at that end. At .25 a quarter of the intervals of
power laws without a reason stay closed; at .1 half of those of two branches are open (`studies.creep`, seeds 3000 to
3059)."""
SLOW_LEAST, SLOW_SHARE = 0.03, 0.2
"""Strength of a branch that outlasts the record, and its share of all strengths, from which it matters: a fainter one
may be a drift of the sensor."""


def relaxation_modes(strength: FloatArray, retarded_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Relaxation rates (d, m) [1/s] of branches with strengths and retardation times (d, b), their modes (d, b, m), in
    sqrt(j_i l_i) E_i, and the displacement's drive of each (d, m).

    Under a displacement y, dE_i/dt = (F - E_i) / l_i with F = y - sum_k j_k E_k. In terms of sqrt(j_i l_i) E_i the
    matrix is symmetric, so that its eigenvectors are orthogonal."""
    drive = np.sqrt(strength / retarded_s)
    rates = drive[:, :, None] * drive[:, None, :] + np.eye(strength.shape[1]) / retarded_s[:, :, None]
    rate, mode = np.linalg.eigh(rates)
    return rate, mode, (drive[:, None, :] @ mode)[:, 0]


def relaxing(strength: FloatArray, retarded_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(d, b) shares of the modulus that relax, and (d, b) their times [s], of strengths and retardation times (d, b)
    that are held still."""
    if strength.shape[1] == 0:
        return strength, retarded_s
    rate, _, drive = relaxation_modes(strength, retarded_s)
    return drive**2 / rate, 1.0 / rate


def force_kept(
    strength: FloatArray, retarded_s: FloatArray, exponent: FloatArray, ramp_s: float, after_s: FloatArray
) -> FloatArray:
    """(d, T) share of the force at the end of an approach that is left `after_s` (T,) later, held in place.

    strength, retarded_s: (d, b); exponent: (d,) exponent of the elastic force over the time of the approach, which is
    even and takes `ramp_s`"""
    share, relaxed_s = relaxing(strength, retarded_s)
    gone = (np.arange(RAMP_STEPS) + 0.5) / RAMP_STEPS
    grown = np.diff((np.arange(RAMP_STEPS + 1) / RAMP_STEPS) ** exponent[:, None], axis=1)
    # what a branch still carries of the approach at its end
    carries = (np.exp(-(1.0 - gone) * ramp_s / relaxed_s[..., None]) * grown[:, None]).sum(axis=2)
    left = np.exp(-np.append(0.0, after_s) / relaxed_s[..., None]) * carries[..., None]
    force = 1.0 - (share[..., None] * (1.0 - left)).sum(axis=1)
    return np.asarray(force[:, 1:] / force[:, :1])


@dataclass(frozen=True, slots=True)
class ForceKept:
    """share: share of the force at the end of the push that is left `after_s` later [s], held in place; interval: 90 %
    interval"""

    after_s: float
    share: float
    interval: tuple[float, float]

    def __str__(self) -> str:
        low, high = self.interval
        return f"keeps {self.share:.1%} ({low:.1%} to {high:.1%}) of its force after {self.after_s:.2g} s"


def kept_of(
    strength: FloatArray, retarded_s: FloatArray, exponent: FloatArray, ramp_s: float, held_s: float
) -> tuple[ForceKept, ...]:
    """The remaining force after round times of the hold, and at its end, of equal draws: see `force_kept`."""
    after_s = np.array([*(one for one in KEPT_AFTER_S if one < 0.95 * held_s), held_s])
    kept = np.quantile(force_kept(strength, retarded_s, exponent, ramp_s, after_s), (0.05, 0.5, 0.95), axis=0).T
    return tuple(
        ForceKept(float(after), float(middle), (float(low), float(high)))
        for after, (low, middle, high) in zip(after_s, kept, strict=True)
    )


@dataclass(frozen=True, slots=True)
class RelaxationSeen:
    """The part of relaxation that a record shows.

    reasons: reasons to doubt its end; short_record, no_plateau: probabilities that a branch lasts longer than the
    record, and that relaxation never ends; open: whether these together exceed `OPEN`, or the given threshold
    within: (d,) draws that relax completely within the record; share: (d,) share of the modulus that relaxes, of
    endless creep within the record"""

    reasons: tuple[Doubt, ...]
    short_record: float
    no_plateau: float
    open: bool
    within: BoolArray
    share: FloatArray

    def bounded(self, middle: float, interval: tuple[float, float], top: float) -> tuple[float, tuple[float, float]]:
        """A value, or its lower bound if there is a reason; and its interval, up to `top` if it is open."""
        low, high = interval
        return low if self.reasons else middle, (low, top if self.reasons or self.open else high)


@dataclass(frozen=True, slots=True)
class RelaxationDraws:
    """Weighted draws of all models, whatever observed them: a touch (`stages.poke.creep_law`), or images and a force
    (`stages.materials.recovery`).

    weight: (d,) adds up to 1; strength, retarded_s: (d, b) j_i and l_i [s], with strength 0 for absent branches;
    mean_s: (d,) mean relaxation time [s]; branches: (d,) their number; endless: (d,) the spectrum has no end"""

    weight: FloatArray
    strength: FloatArray
    retarded_s: FloatArray
    mean_s: FloatArray
    branches: IntArray
    endless: BoolArray

    def some(self, random: np.random.Generator, count: int) -> Self:
        """`count` draws, picked in proportion to their weight."""
        at = random.choice(len(self.weight), count, p=self.weight / self.weight.sum())
        others = {one.name: getattr(self, one.name)[at] for one in fields(self)}
        return type(self)(**others | {"weight": np.full(count, 1.0 / count)})

    def seen(self, record_s: float, open_from: float = OPEN) -> RelaxationSeen:
        """Whether relaxation ends within a record. open_from: probability from which intervals are open"""
        strength, retarded_s, endless, weight = self.strength, self.retarded_s, self.endless, self.weight
        slow = np.where(retarded_s / (1.0 + strength) > record_s, strength, 0.0)
        most, all_of_it = slow.max(axis=1, initial=0.0), np.maximum(strength.sum(axis=1), 1e-12)
        outlasts = ~endless & (slow.sum(axis=1) > np.maximum(SLOW_LEAST, SLOW_SHARE * all_of_it))
        short, no_end = float(weight[outlasts].sum()), float(weight[endless].sum())
        within = ~endless & (most < SLOW_LEAST)
        reasons: tuple[Doubt, ...] = ()
        if short + no_end > DOUBTED or not weight[within].sum() > 0.0:
            outlast = f"{short:.0%} that a branch outlasts the {record_s:.2g} s recorded"
            each = f"{outlast}, {no_end:.0%} that it creeps without end"
            text = f"the relaxed state was not seen ({each}): shares and times are lower bounds; hold longer"
            reasons = (Doubt("no-plateau" if no_end > short else "short-record", text),)
        counted = np.where(endless[:, None] & (retarded_s > record_s), 0.0, strength).sum(axis=1)
        return RelaxationSeen(reasons, short, no_end, short + no_end > open_from, within, counted / (1.0 + counted))

    def time(self, judged: FloatArray, level: float = 0.9) -> tuple[float, tuple[float, float]]:
        """Median and interval of the mean relaxation time [s]. judged: (d,) weight"""
        creeps = self.strength.any(axis=1)
        return median_and_interval(self.mean_s[creeps], judged[creeps], level)


def relaxation_posterior(
    fitted: Sequence[tuple[Spectrum, DrawnModel]], random: np.random.Generator
) -> tuple[list[FloatArray], RelaxationDraws]:
    """Draws of the parameters (d_i, k_i) of each spectrum, which are the last ones of an observer's model, and what
    relaxes by them."""
    drawn, weight = draw_about_each([model for _, model in fitted], random)
    most = max(spectrum.most for spectrum, _ in fitted)
    every: list[tuple[FloatArray, ...]] = []
    for (spectrum, _), some in zip(fitted, drawn, strict=True):
        strength, retarded_s = spectrum.filters(some[:, some.shape[1] - spectrum.size :])
        none = ((0, 0), (0, most - spectrum.most))
        padded = np.pad(strength, none), np.pad(retarded_s, none, constant_values=1.0)
        counts = np.full(len(some), spectrum.most), np.full(len(some), spectrum.endless)
        every.append((*padded, mean_relaxation_s(strength, retarded_s), *counts))
    return drawn, RelaxationDraws(weight, *map(np.concatenate, zip(*every, strict=True)))


def mean_relaxation_s(strength: FloatArray, retarded_s: FloatArray) -> FloatArray:
    """(d,) mean relaxation time of strengths and retardation times (d, b), each branch weighed by its share."""
    share, relaxed_s = relaxing(strength, retarded_s)
    return np.asarray((share * relaxed_s).sum(axis=1) / np.maximum(share.sum(axis=1), 1e-12))
