"""A posterior as weighted draws around its likeliest parameters, and its evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import FloatArray

DRAWS = 2000
"""Weighted draws from a heavier-tailed proposal."""
PROPOSAL_FREEDOM = 5.0
FEWEST_EFFECTIVE = 40.0
"""Where fewer weighted draws than these count in effect, unweighted ones about the best fit are taken."""


def draw_about(
    best: FloatArray,
    jacobian: FloatArray,
    residuals: Callable[[FloatArray], FloatArray],
    log_size: float,
    random: np.random.Generator,
) -> tuple[FloatArray, FloatArray, float]:
    """Draws (d, k), their weights (d,) which add up to 1, and the log evidence.

    best: (k,) of least squares; jacobian: (m, k) there of residuals, which takes (d, k) and gives (d, m), in
    deviations, priors among them; log_size: logarithm of what the density is divided by
    """
    root = np.linalg.cholesky(jacobian.T @ jacobian)
    stretch = np.sqrt(PROPOSAL_FREEDOM / random.chisquare(PROPOSAL_FREEDOM, (DRAWS, 1)))
    apart = stretch * random.standard_normal((DRAWS, len(best)))
    drawn = best + scipy.linalg.solve_triangular(root.T, apart.T).T
    log_proposal = _log_student(apart) + float(np.log(np.diag(root)).sum())
    log_weight = -0.5 * (residuals(drawn) ** 2).sum(axis=1) - log_size - log_proposal
    weight = np.exp(log_weight - scipy.special.logsumexp(log_weight))
    if 1.0 / (weight**2).sum() < FEWEST_EFFECTIVE:
        weight = np.full(DRAWS, 1.0 / DRAWS)
    return drawn, weight, float(scipy.special.logsumexp(log_weight) - np.log(DRAWS))


def pooled(log_evidence: Sequence[float], weight: Sequence[FloatArray]) -> FloatArray:
    """The weights (d,) of several models' draws, one after the other, each model by its evidence."""
    evidence = np.array(log_evidence)
    return np.concatenate(
        [one * np.exp(e - scipy.special.logsumexp(evidence)) for e, one in zip(evidence, weight, strict=True)]
    )


def median_and_interval(value: FloatArray, weight: FloatArray, level: float = 0.9) -> tuple[float, tuple[float, float]]:
    """Median and interval of draws (n,) with weights (n,), in the unit of the draws."""
    order = np.argsort(value)
    below = np.cumsum(weight[order]) / weight.sum()
    tail = round(0.5 * (1.0 - level), 12)
    low, middle, high = (
        float(value[order[min(int(np.searchsorted(below, q)), len(order) - 1)]]) for q in (tail, 0.5, 1.0 - tail)
    )
    return middle, (low, high)


def _log_student(apart: FloatArray) -> FloatArray:
    """(d,) log density of Student's t of PROPOSAL_FREEDOM at (d, k), of unit scale."""
    freedom, size = PROPOSAL_FREEDOM, apart.shape[1]
    gammaln = scipy.special.gammaln
    constant = gammaln(0.5 * (freedom + size)) - gammaln(0.5 * freedom) - 0.5 * size * np.log(np.pi * freedom)
    return np.asarray(constant - 0.5 * (freedom + size) * np.log1p((apart**2).sum(axis=1) / freedom))
