"""A posterior as weighted draws around its likeliest parameters, and its evidence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import FloatArray, IntArray

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
        least, damping = self._half(best, self.mean, off), np.full(len(best), DAMPING)
        for _ in range(ROUNDS):
            curved = moved @ moved.transpose(0, 2, 1) + holds
            slope = (moved @ off[..., None])[..., 0] + (best - self.mean) / self.spread**2
            damped = curved + damping[:, None, None] * np.eye(len(holds)) * curved
            tried = best - np.linalg.solve(damped, slope[..., None])[..., 0]
            new_off, new_moved = self.linear(tried)
            half = self._half(tried, self.mean, new_off)
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

    def half_squares(self, drawn: FloatArray, choice: IntArray) -> FloatArray:
        """(d,) half the squares of parameters (d, k), each with the priors of its choice."""
        return self._half(drawn, self.mean[choice], self.residuals(drawn))

    def log_size(self) -> float:
        """Logarithm of the divisor of each choice's density."""
        known = self.spread[np.isfinite(self.spread)]
        return float(np.log(np.sqrt(2.0 * np.pi) * known).sum() - np.log(self.prior / len(self.mean)))

    def _half(self, at: FloatArray, mean: FloatArray, off: FloatArray) -> FloatArray:
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
        log_weight.append(-one.half_squares(some, choice) - one.log_size() - log_proposal)
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
