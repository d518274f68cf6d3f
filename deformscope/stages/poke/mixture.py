"""Quantiles of mixtures: a value comes from one of several hypotheses, each with a separate error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import ndtr

from deformscope.arrays import FloatArray

BISECTIONS = 30
FARTHEST = 9.0
"""Deviations from a component's mean within which its quantiles are sought."""


def quantile(
    mean: FloatArray,
    deviation: FloatArray,
    weight: FloatArray,
    share: float,
    *,
    below: Callable[[FloatArray], FloatArray] = ndtr,
) -> FloatArray:
    """The value (...) that a `share` of a mixture lies below, by bisection.

    mean, deviation: (c, ...) mean and deviation of the components; weight: (c,) or (c, ...), adding up to 1 over them;
    below: distribution function of a component of mean 0 and deviation 1"""
    own = weight.reshape(*weight.shape, *(1,) * (mean.ndim - weight.ndim))
    low, high = (mean - FARTHEST * deviation).min(axis=0), (mean + FARTHEST * deviation).max(axis=0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        less = (own * below((middle - mean) / deviation)).sum(axis=0) < share
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return np.asarray(0.5 * (low + high))
