"""Touches of viscoelastic foams by hereditary integrals: a ball comes down and holds its force, or holds its place.

F(t) = integral of E(t - s) / E0 d f(d(s))      (Lee and Radok 1960, of a contact that does not shrink)

with f the force of an elastic layer under a ball (Sneddon 1965, with the series of Dimitriadis et al. 2002 for a layer
bonded to its table) and E(t) any law. The integral is taken by the mean of E over each step, in float64. Nothing is
taken from `deformscope`: the laws below are functions of time alone, and no branch is a filter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import erfcx, gamma

FloatArray = npt.NDArray[np.floating[Any]]
Modulus = Callable[[FloatArray], FloatArray]
"""E(t) / E0 at times (n,) [s]."""

STEP_S, RATE_HZ = 2e-3, 100.0
"""Step of the integral, and rate of the samples of place and force."""
CLEARANCE_M, SPEED_M_S, RADIUS_M, SET_N = 0.005, 0.01, 0.01, 3.0
PLACE_SD_M, FORCE_SD_N, COUNT_N = 1e-4, 0.02, 0.0037
"""Noise of the arm's place, and of an OptoForce, of which one count is this (5.4 counts of noise)."""
DRIFT_N_PER_S = 0.001
"""Deviation of the drift of a force sensor: 0.06 N a minute."""
ARM_M_PER_N, ARM_OFF_M_PER_N = 1.0 / 12e3, 0.1 / 12e3
"""Compliance of an arm, and its deviation from the calibration."""
FOAM_N_PER_M, THICKNESS_M, POISSON = (350.0, 900.0), (0.035, 0.06), (0.05, 0.35)
"""Force over depth at SET_N, about; thickness and Poisson's ratio of the layer."""
PARTS = 64
"""Parts of a step over which E is averaged where it falls fast."""


# Laws -----------------------------------------------------------------------------------------------------------------


def prony(shares: FloatArray, times_s: FloatArray) -> Modulus:
    """Branches that relax (b,) of the modulus with times (b,) [s]."""
    return lambda time_s: 1.0 - shares.sum() + np.exp(-time_s[:, None] / times_s) @ shares


def power_law(exponent: float, since_s: float) -> Modulus:
    """A modulus that falls without end by a power of time, from `since_s` on."""
    return lambda time_s: (1.0 + time_s / since_s) ** -exponent


def logarithmic(decade: float, since_s: float) -> Modulus:
    """A compliance that grows by `decade` with each decade of time after `since_s`; its modulus to first order."""
    return lambda time_s: 1.0 / (1.0 + decade * np.log10(1.0 + time_s / since_s))


def fractional_zener(share: float, time_s: float) -> Modulus:
    """`share` relaxes by a Mittag-Leffler function of order one half: exp(u) erfc(sqrt(u)), u = t / time_s."""
    return lambda at_s: 1.0 - share + share * erfcx(np.sqrt(at_s / time_s))


def stretched(share: float, time_s: float, order: float) -> Modulus:
    """`share` relaxes by a stretched exponential (Kohlrausch 1854)."""
    return lambda at_s: 1.0 - share + share * np.exp(-((at_s / time_s) ** order))


def stretched_mean_s(time_s: float, order: float) -> float:
    """Mean relaxation time of a stretched exponential."""
    return float(time_s / order * gamma(1.0 / order))


# Touches --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Recorded:
    """time_s, place_m, force_n: (n,) as recorded, along the normal; loading: samples up to the set force
    at_once_n_per_mm: force over depth at SET_N without memory; relaxed_n_per_mm: stiffness of `left`, the remaining
    share of the modulus
    kept: (T,) share of the force at the end of the approach that is left `kept_s` (T,) after it, held in place"""

    time_s: FloatArray
    place_m: FloatArray
    force_n: FloatArray
    loading: int
    at_once_n_per_mm: float
    relaxed_n_per_mm: float
    kept: FloatArray


def touched(modulus: Modulus, left: float, hold_s: float, kept_s: FloatArray, random: np.random.Generator) -> Recorded:
    """Press a foam of this law until SET_N and keep the force for a while, as an arm and an OptoForce record it.

    left: share of the modulus that is left when all has relaxed, 0 where that never happens; kept_s: (T,) [s]"""
    layer = _Layer(float(random.uniform(*THICKNESS_M)), float(random.uniform(*POISSON)))
    stiff = float(np.exp(random.uniform(*np.log(FOAM_N_PER_M))))
    scale = SET_N / float(layer.force(np.array([SET_N / stiff]))[0])
    steps = round((2.0 * SET_N / stiff / SPEED_M_S + hold_s + 1.0) / STEP_S)
    mean = _step_means(modulus, steps)
    depth, felt = np.linspace(0.0, 0.03, 3001), scale * layer.force(np.linspace(0.0, 0.03, 3001))
    elastic, force = np.zeros(steps + 1), np.zeros(steps + 1)  # f(d), F
    growth = np.zeros(steps)
    reached = ended = 0
    for at in range(1, steps + 1):
        carried = float(growth[: at - 1] @ mean[at - 1 : 0 : -1])
        if not reached:
            elastic[at] = np.interp(at * STEP_S * SPEED_M_S, depth, felt)
        else:
            elastic[at] = elastic[at - 1] + (SET_N - carried) / mean[0]
        growth[at - 1] = elastic[at] - elastic[at - 1]
        force[at] = carried + growth[at - 1] * mean[0]
        if not reached and force[at] >= SET_N:
            reached = at
        if reached and (at - reached) * STEP_S >= hold_s:
            ended = at
            break
    dent = np.interp(elastic[: ended + 1], felt, depth)
    give = ARM_M_PER_N + ARM_OFF_M_PER_N * float(random.standard_normal())
    before = round(CLEARANCE_M / SPEED_M_S * RATE_HZ)
    every = round(1.0 / RATE_HZ / STEP_S)
    shift = reached % every  # the sample at which the force is reached is the first of the hold
    dent_m = np.append((np.arange(-before, 0) / RATE_HZ + shift * STEP_S) * SPEED_M_S, dent[shift::every])
    force_n = np.append(np.zeros(before), force[shift : ended + 1 : every])
    time_s = np.arange(len(force_n)) / RATE_HZ
    drift_n = DRIFT_N_PER_S * float(random.standard_normal()) * time_s
    noisy_n = force_n + drift_n + FORCE_SD_N * random.standard_normal(len(force_n))
    held_still = growth[:reached]
    after = np.array([_relaxed(modulus, held_still, gone_s) for gone_s in (0.0, *kept_s)])
    needed = {share: float(np.interp(SET_N / share, felt, depth)) for share in (1.0, left) if share > 0.0}
    return Recorded(
        time_s=time_s,
        place_m=dent_m + give * force_n + PLACE_SD_M * random.standard_normal(len(force_n)),
        force_n=COUNT_N * np.round(noisy_n / COUNT_N),
        loading=before + reached // every + 1,
        at_once_n_per_mm=1e-3 * SET_N / needed[1.0],
        relaxed_n_per_mm=1e-3 * SET_N / needed[left] if left > 0.0 else 0.0,
        kept=after[1:] / after[0],
    )


@dataclass(frozen=True, slots=True)
class _Layer:
    """thickness_m; poisson"""

    thickness_m: float
    poisson: float

    def force(self, depth_m: FloatArray) -> FloatArray:
        """(n,) force of a ball at depths (n,), up to a factor."""
        contact = np.linspace(0.0, 0.995, 4000)
        logs = np.log((1.0 + contact) / (1.0 - contact))
        of_ball = np.interp(depth_m / RADIUS_M, 0.5 * contact * logs, 0.5 * (1.0 + contact**2) * logs - contact)
        nu, chi = self.poisson, np.sqrt(RADIUS_M * depth_m) / self.thickness_m
        low = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1.0 - nu) / np.pi
        high = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1.0 - nu)
        series = 1.0 - 2.0 * low * chi + 4.0 * low**2 * chi**2
        third = low**3 + 4.0 / 15.0 * high / np.pi
        last = 16.0 * low * (low**3 + 0.6 * high / np.pi) * chi**4
        return np.asarray(of_ball * (series - 8.0 * third * chi**3 + last))


def _step_means(modulus: Modulus, steps: int) -> FloatArray:
    """(n,) mean of E over each step since a change."""
    fine = (np.arange(steps)[:, None] + (np.arange(PARTS) + 0.5) / PARTS) * STEP_S
    return np.asarray(modulus(fine.ravel()).reshape(fine.shape).mean(axis=1))


def _relaxed(modulus: Modulus, growth: FloatArray, gone_s: float) -> float:
    """The force at a time after the last of these steps, held in place."""
    since = gone_s + (np.arange(len(growth), 0, -1) - 0.5) * STEP_S
    return float(np.dot(growth, modulus(since)))
