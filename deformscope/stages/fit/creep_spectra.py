"""Models of a creep compliance over time: discrete branches, or a spectrum without end (`stages.poke.creep_law`).

Each is a set of low-pass filters of the force, of strengths j_i and retardation times l_i. `Branches`: each filter has
a separate strength and time. `Endless`: the strengths for all times follow one power of the time. The compliance grows
as t^n (Nutting 1921), with n about 0 as log(1 + t / t0), and reaches no plateau.

Times have a log-uniform prior from a part of the approach's duration to ten holds, which is a sum of Gaussians about
nodes: for every choice of nodes the parameters have one likeliest value."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from deformscope.arrays import FloatArray

STRENGTH_MEDIAN, STRENGTH_SPREAD = 0.2, 0.9
"""Log-normal prior of the strength of one branch, in equal parts of several, and of a spectrum within the hold:
relaxation of 2 to 50 %, the range of flexible foams [assumed]."""
FASTEST, SLOWEST = 1.0 / 8.0, 10.0
"""Retardation times range from this share of the approach's duration to this number of holds [assumed]."""
NODES_APART, NODE_SD = 0.75, 0.6
"""Distance of log times, about; deviation of a node's Gaussian over it: their sum is level within 1 %."""
POWERS, POWER_SD = (0.05, 0.2, 0.35, 0.5), 0.09
"""Exponents n of a spectrum: nodes, and the deviation of a node's Gaussian."""
BEGINS = (1.0 / 40.0, 0.5)
"""Times at which a spectrum begins, over the approach's duration."""
ENDLESS_SPACING, ENDLESS_HOLDS = 0.9, 30.0
"""Spacing of its log times, and how many holds they reach in place of no end."""

LARGEST_LOG = 15.0

Filtered = Callable[[FloatArray, int], FloatArray]
"""(..., m) force after first-order filters with log time constants (...,), or its derivative by log time."""


@dataclass(frozen=True, slots=True)
class Branches:
    """A fixed number of filters; parameters (2 b,): log j, then log l of each. nodes: (n,) nodes of log l; prior:
    probability, of all choices of nodes together"""

    count: int
    nodes: FloatArray
    prior: float
    endless: bool = False

    @property
    def most(self) -> int:
        """How many filters it has."""
        return self.count

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 2 * self.count

    def priors(self) -> tuple[FloatArray, FloatArray]:
        """Means (c, k) and deviations (k,) of the parameters of each choice of nodes."""
        chosen = np.array(list(combinations(self.nodes, self.count)), dtype=np.float64)
        log_j = np.full(chosen.shape, np.log(STRENGTH_MEDIAN / max(self.count, 1)))
        apart = float(self.nodes[1] - self.nodes[0])
        return np.hstack([log_j, chosen]), np.repeat([STRENGTH_SPREAD, NODE_SD * apart], self.count)

    def filters(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Strengths (d, b) and retardation times (d, b) [s] of parameters (d, k)."""
        return _exp(parameters[:, : self.count]), _exp(parameters[:, self.count :])

    def added(self, parameters: FloatArray, filtered: Filtered) -> tuple[FloatArray, FloatArray]:
        """(d, m) contribution of the filters to the force, and (d, k, m) its derivatives."""
        strength, log_l = _exp(parameters[:, : self.count, None]), parameters[:, self.count :]
        each = strength * filtered(log_l, 0)
        return each.sum(axis=1), np.concatenate([each, strength * filtered(log_l, 1)], axis=1)


@dataclass(frozen=True, slots=True)
class Endless:
    """Filters of the log times (b,), with strengths in proportion to l^n; parameters (2,): log of their sum within the
    hold, and n. within: (b,) which filters are within the record; methods as in `Branches`"""

    log_times: FloatArray
    within: FloatArray
    prior: float
    endless: bool = True
    size: int = 2

    @property
    def most(self) -> int:
        return len(self.log_times)

    @classmethod
    def over(cls, approach_s: float, hold_s: float, begins: float, prior: float) -> "Endless":
        """begins: time at which the spectrum begins, over the approach's duration"""
        first, last = np.log(begins * approach_s), np.log(ENDLESS_HOLDS * hold_s)
        log_times = np.arange(first, max(last, first + 2.0 * ENDLESS_SPACING), ENDLESS_SPACING)
        return cls(log_times, (log_times <= max(np.log(hold_s), first)).astype(float), prior)

    def priors(self) -> tuple[FloatArray, FloatArray]:
        means = [(np.log(STRENGTH_MEDIAN), power) for power in POWERS]
        return np.array(means), np.array([STRENGTH_SPREAD, POWER_SD])

    def filters(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        strengths = self._strengths(parameters)[0]
        return strengths, np.broadcast_to(np.exp(self.log_times), strengths.shape)

    def added(self, parameters: FloatArray, filtered: Filtered) -> tuple[FloatArray, FloatArray]:
        strength, by_power = self._strengths(parameters)
        behind = filtered(self.log_times, 0)
        added = strength @ behind
        return added, np.stack([added, by_power @ behind], axis=1)

    def _strengths(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(d, b) strengths, and their derivatives by n."""
        log_sum, power = parameters.T[..., None]
        grown = np.exp(np.clip(power, -3.0, 3.0) * self.log_times)
        within = (grown * self.within).sum(axis=1, keepdims=True)
        mean_log = (grown * self.within * self.log_times).sum(axis=1, keepdims=True) / within
        strength = _exp(log_sum) * grown / within
        return strength, strength * (self.log_times - mean_log)


Spectrum = Branches | Endless


def _exp(log: FloatArray) -> FloatArray:
    """exp without overflow, also for far-off draws, whose weight is 0."""
    return np.exp(np.clip(log, -LARGEST_LOG, LARGEST_LOG))


def spectra(approach_s: float, hold_s: float, most: int) -> list[Spectrum]:
    """All models of creep that are compared: none and up to `most` branches, each number half as probable as the one
    before. Spectra without an end together are as probable as three branches [assumed]."""
    fastest, slowest = np.log(FASTEST * approach_s), np.log(SLOWEST * hold_s)
    count = max(most + 1, 1 + round((slowest - fastest) / NODES_APART))
    nodes = np.linspace(fastest, slowest, count)
    found: list[Spectrum] = [Branches(some, nodes, 0.5**some) for some in range(most + 1)]
    return found + [Endless.over(approach_s, hold_s, one, 0.125 / len(BEGINS)) for one in BEGINS]
