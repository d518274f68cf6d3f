"""The law by which a foam creeps under a ball, fitted to one touch: its parameters as weighted draws (`creep`).

Each branch of the creep compliance is a low-pass filter of the force, with a strength j and a retardation time l; what
the law is off by is a Gaussian process over the log of the force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import FloatArray
from deformscope.stages.fit.relaxation import mean_relaxation_s
from deformscope.stages.fit.weighted_draws import draw_about, pooled
from deformscope.stages.poke.contact import LOADED, ArmCompliance

STRENGTH_MEDIAN, STRENGTH_SPREAD = 0.2, 0.9
"""Log-normal prior of the strength j of one branch, in equal parts of several: relaxation of 2 to 50 %, where flexible
foams lie [assumed]."""
TIME_MEDIAN_S, TIME_SPREAD = 1.2, 0.9
"""Log-normal prior of a retardation time: 0.08 to 12 s, what a touch of some seconds can be asked about."""
MOST_BRANCHES = 2
HOLD_SAMPLES = 120
"""Of the hold, that are fitted: more are averaged over equal counts."""
LEAST_EXPONENT, LEAST_SHARE = 0.2, 1e-4
BEND_SD = 0.003
"""Of q: log depth goes by log force over p plus q times its square, 0 at the set force. Finite elements of a ball of
2 cm on 2 to 8 cm of bonded foam, Poisson's ratio .05 to .4, at 1 and 3 N: -.009 to .006."""
LAW_OFF, LAW_RISE, LAW_LENGTH = 0.004, 0.4, 0.3
"""Of a log dent, what that law is off by: a Gaussian process over log force, 0 at the set force, with this deviation
there, more below it (a power of the force) and with this length: elements that come into contact one after the other
make waves of 0.2 to 1 % (24 slabs as above, seeds kept for choosing). Foam itself is no better."""
BALL_STEPS = 400
SHAPE = 5
"""Parameters of the law without a memory."""
LOG_TIMES, TIMES = (np.log(0.005), np.log(200.0)), 80
"""Retardation times for which the filters are computed; between them they are interpolated."""


@dataclass(frozen=True, slots=True)
class CreepSamples:
    """time_s, z_m, force_n: (m,) from the first sample to the end of the hold, which is averaged; count: (m,) how many
    each is the mean of; first: from which on they are fitted; loading: up to which they lead to the set force"""

    time_s: FloatArray
    z_m: FloatArray
    force_n: FloatArray
    count: FloatArray
    first: int
    loading: int

    @classmethod
    def of(
        cls, time_s: FloatArray, z_m: FloatArray, force_n: FloatArray, first: int, loading: int, held: int
    ) -> CreepSamples:
        every = max(1, (held - loading) // HOLD_SAMPLES)
        ends = np.unique([*range(1, loading + 1), *range(loading, held, every), held])
        starts = np.append(0, ends[:-1])
        count = (ends - starts).astype(float)
        time, z, force = (np.add.reduceat(one[:held], starts) / count for one in (time_s, z_m, force_n))
        return cls(time_s=time, z_m=z, force_n=force, count=count, first=first, loading=loading)


@dataclass(frozen=True, slots=True)
class CreepDraws:
    """Weighted draws, of one number of branches or of all: log evidence; weight (d,), which adds up to 1; z0, D0 [m],
    log of the dent when all has relaxed over D0, p, deviations of the arm's compliance, mean relaxation time [s], all
    (d,); j_i and l_i [s] (d, MOST_BRANCHES), what is not there with a strength of 0"""

    log_evidence: float
    weight: FloatArray
    start_m: FloatArray
    depth_m: FloatArray
    log_deeper: FloatArray
    exponent: FloatArray
    bent: FloatArray
    mean_time_s: FloatArray
    strength: FloatArray
    retarded_s: FloatArray

    @classmethod
    def together(cls, models: Sequence[CreepDraws]) -> CreepDraws:
        """All, each model by its evidence."""
        weight = pooled([one.log_evidence for one in models], [one.weight for one in models])
        others = {name: np.concatenate([getattr(one, name) for one in models]) for name in cls._parameters()}
        return cls(log_evidence=0.0, weight=weight, **others)

    @classmethod
    def _parameters(cls) -> list[str]:
        """Names of the fields that are neither evidence nor weight."""
        return [one.name for one in fields(cls) if one.name not in ("log_evidence", "weight")]

    def some(self, random: np.random.Generator, count: int) -> CreepDraws:
        """So many draws, picked in proportion to their weight."""
        at = random.choice(len(self.weight), count, p=self.weight / self.weight.sum())
        others = {name: getattr(self, name)[at] for name in self._parameters()}
        return CreepDraws(log_evidence=self.log_evidence, weight=np.full(count, 1.0 / count), **others)

    def dents(self, z_m: FloatArray, force_n: FloatArray, arm: ArmCompliance) -> FloatArray:
        """(d, n) of places and forces (n,) [m]."""
        gives = arm.compliance_m_per_n + arm.compliance_sd * self.bent[:, None]
        return np.asarray(np.maximum(z_m - self.start_m[:, None] - gives * force_n, 0.0))


class CreepLaw:
    """The law over one touch; parameters (5 + 2 b,): z0 [mm], log D0 (of a ball: of the dent that a paraboloid
    would make instead), p, the law's bend q, the arm's compliance in deviations from what it was calibrated to, then
    log j and log l of each branch.

    What the law is off by at one force it is off by at neighbouring ones, in the hold as on the way down: residuals
    are whitened by the covariance of that and of the samples' own scatter.
    """

    def __init__(
        self,
        samples: CreepSamples,
        exponent: tuple[float, float],
        set_force_n: float,
        arm: ArmCompliance,
        force_sd_n: float,
        radius_m: float | None,
    ) -> None:
        self._ball = _ball(radius_m) if radius_m else None
        fitted = slice(samples.first, None)
        force = np.maximum(samples.force_n, 0.0) / set_force_n
        self._share = force[fitted]
        log_s = np.linspace(*LOG_TIMES, TIMES)
        self._filtered = scipy.interpolate.CubicSpline(log_s, _lagging(samples.time_s, force, np.exp(log_s))[:, fitted])
        self._z = samples.z_m[fitted] - arm.compliance_m_per_n * samples.force_n[fitted]
        self._bent_m = arm.compliance_sd * set_force_n * self._share
        self._exponent, prior_exponent = exponent, exponent[0]
        root = np.sqrt(samples.count[fitted])
        share = np.maximum(self._share, LOADED)
        design = np.column_stack([np.ones_like(self._z), share ** (1.0 / prior_exponent)])
        (z0, depth_m), *_ = np.linalg.lstsq(design, self._z, rcond=None)
        self._start = np.array([1e3 * z0, np.log(max(depth_m, 1e-5)), prior_exponent, 0.0, 0.0])
        slope_m = depth_m / prior_exponent * share ** (1.0 / prior_exponent - 1.0)
        sd = np.hypot(max(arm.position_sd_m, 1e-6), slope_m * force_sd_n / set_force_n) / root
        self._whitens = np.diag(1.0 / np.hypot(sd, LAW_OFF * depth_m))
        self._log_felt, self._dent_m = (one[0] for one in self._dents(self._best(MOST_BRANCHES)[None]))
        self._off_m2 = self._dent_m * _off_together(self._log_felt, self._log_felt) * self._dent_m[:, None]
        self._whitens = _whitening(sd, self._off_m2)
        # the arm may scatter more than stated
        scatter = self._off(self._best(MOST_BRANCHES)[None])[0]
        self._whitens = _whitening(sd * max(1.0, float(np.sqrt(np.mean(scatter**2)))), self._off_m2)

    def posterior(self, branches: int) -> CreepDraws:
        """Weighted draws of the parameters with so many branches."""
        best = self._best(branches)
        random = np.random.default_rng(branches)
        drawn, weight, log_evidence = draw_about(
            best, self._jacobian(best), self._residuals, self._log_size(branches), random
        )
        none = ((0, 0), (0, MOST_BRANCHES - branches))
        strength = np.pad(np.exp(drawn[:, SHAPE : SHAPE + branches]), none)
        retarded_s = np.pad(np.exp(drawn[:, SHAPE + branches :]), none, constant_values=1.0)
        log_felt = np.log1p(strength.sum(axis=1))
        log_depth = self._log_dent(drawn, np.zeros(len(drawn)))
        log_deeper = self._log_dent(drawn, log_felt) - log_depth + self._law_off(drawn, log_felt, random)
        return CreepDraws(
            log_evidence=log_evidence,
            weight=weight,
            start_m=1e-3 * drawn[:, 0],
            depth_m=np.maximum(np.exp(log_depth), 1e-6),
            log_deeper=log_deeper if branches else np.zeros(len(drawn)),
            exponent=np.maximum(drawn[:, 2], LEAST_EXPONENT),
            bent=drawn[:, 4],
            mean_time_s=mean_relaxation_s(strength, retarded_s),
            strength=strength,
            retarded_s=retarded_s,
        )

    def _law_off(self, parameters: FloatArray, log_felt: FloatArray, random: np.random.Generator) -> FloatArray:
        """(d,) draws of what the law is off by at a log force (d,), given what it is off by in the samples."""
        shared = (_off_together(log_felt, self._log_felt) * self._dent_m) @ self._whitens.T
        mean = (shared * self._off(parameters)).sum(axis=1)
        variance = _off_variance(log_felt) - (shared**2).sum(axis=1)
        return np.asarray(mean + np.sqrt(np.maximum(variance, 0.0)) * random.standard_normal(len(log_felt)))

    def _best(self, branches: int) -> FloatArray:
        """(5 + 2 b,) the likeliest parameters."""
        apart = np.linspace(-0.7, 0.7, branches) if branches > 1 else np.zeros(branches)
        log_j = np.full(branches, np.log(STRENGTH_MEDIAN / max(branches, 1)))
        start = np.concatenate([self._start, log_j, np.log(TIME_MEDIAN_S) + TIME_SPREAD * apart])
        found = scipy.optimize.least_squares(
            lambda one: self._residuals(one[None])[0], start, jac=self._jacobian, x_scale="jac"
        )
        return np.asarray(found.x)

    def _jacobian(self, parameters: FloatArray) -> FloatArray:
        """(m, k) of the residuals, by central differences, all in one pass."""
        step = 1e-5 * np.eye(len(parameters))
        both = self._residuals(np.concatenate([parameters + step, parameters - step]))
        return np.asarray((both[: len(parameters)] - both[len(parameters) :]).T / 2e-5)

    def _residuals(self, parameters: FloatArray) -> FloatArray:
        """(d, m) of parameters (d, k): samples, then what priors hold against them."""
        branches = (parameters.shape[1] - SHAPE) // 2
        log_j, log_l = parameters[:, SHAPE : SHAPE + branches], parameters[:, SHAPE + branches :]
        middle, spread = self._exponent
        priors = [
            (parameters[:, 2:3] - middle) / spread,
            parameters[:, 3:4] / BEND_SD,
            parameters[:, 4:5],
            (log_j - np.log(STRENGTH_MEDIAN / max(branches, 1))) / STRENGTH_SPREAD,
            (log_l - np.log(TIME_MEDIAN_S)) / TIME_SPREAD,
        ]
        return np.concatenate([self._off(parameters), *priors], axis=1)

    def _off(self, parameters: FloatArray) -> FloatArray:
        """(d, m) how far the samples are from the law, whitened."""
        _, dent_m = self._dents(parameters)
        away = self._z - 1e-3 * parameters[:, :1] - dent_m - parameters[:, 4:5] * self._bent_m
        return np.asarray(away @ self._whitens.T)

    def _dents(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(d, m) log of the force that would make each sample's dent at once, over the set force; and that dent [m]."""
        branches = (parameters.shape[1] - SHAPE) // 2
        felt = np.broadcast_to(self._share, (len(parameters), len(self._share))).copy()
        for strength, log_s in zip(
            np.exp(parameters.T[SHAPE:][:branches]), parameters.T[SHAPE + branches :], strict=True
        ):
            felt += strength[:, None] * self._filtered(np.clip(log_s, *LOG_TIMES))
        log_felt = np.log(np.maximum(felt, LEAST_SHARE))
        return log_felt, np.exp(self._log_dent(parameters[:, None], log_felt))

    def _log_dent(self, parameters: FloatArray, log_felt: FloatArray) -> FloatArray:
        """(...,) log of the dent [m] at a log force (...,) over the set force, of parameters (..., k)."""
        _, log_depth, exponent, bend = np.moveaxis(parameters[..., : SHAPE - 1], -1, 0)
        log_dent = log_depth + log_felt / np.maximum(exponent, LEAST_EXPONENT) + bend * log_felt**2
        return np.asarray(log_dent if self._ball is None else np.interp(log_dent, *self._ball))

    def _log_size(self, branches: int) -> float:
        """Logarithm of what the priors' densities are divided by, without what all numbers of branches share."""
        return float(branches * np.log(2.0 * np.pi * STRENGTH_SPREAD * TIME_SPREAD))


def _ball(radius_m: float) -> tuple[FloatArray, FloatArray]:
    """(n,) logs of the dent that a paraboloid of a ball's curvature makes, and of the ball's own, at equal forces [m]
    (Sneddon 1965, both rigid)."""
    contact = -np.expm1(-np.geomspace(1e-4, 5.0, BALL_STEPS))  # radius of the contact over the ball's
    force = (1.0 + contact**2) * np.arctanh(contact) - contact
    force[contact < 0.03] = (4.0 / 3.0 * contact**3 + 8.0 / 15.0 * contact**5)[contact < 0.03]
    return np.log(radius_m * (0.75 * force) ** (2.0 / 3.0)), np.log(radius_m * contact * np.arctanh(contact))


def _off_together(one: FloatArray, other: FloatArray) -> FloatArray:
    """(a, b) covariance of what the law is off by at log forces (a,) and (b,): a process g less its value at 0."""

    def g(left: FloatArray, right: FloatArray) -> FloatArray:
        rise = np.exp(-LAW_RISE * (left[:, None] + right))
        return LAW_OFF**2 * rise * np.exp(-0.5 * ((left[:, None] - right) / LAW_LENGTH) ** 2)

    at = np.zeros(1)
    return np.asarray(g(one, other) - g(one, at) - g(at, other) + g(at, at))


def _off_variance(one: FloatArray) -> FloatArray:
    """(a,) as the diagonal of `_off_together`."""
    high = np.exp(-LAW_RISE * one)
    return np.asarray(LAW_OFF**2 * (1.0 + high**2 - 2.0 * high * np.exp(-0.5 * (one / LAW_LENGTH) ** 2)))


def _whitening(sd_m: FloatArray, together_m2: FloatArray) -> FloatArray:
    """(m, m) that makes residuals of deviations (m,) with a covariance (m, m) in common white."""
    lower = np.linalg.cholesky(together_m2 + np.diag(sd_m**2))
    return np.asarray(scipy.linalg.solve_triangular(lower, np.eye(len(sd_m)), lower=True))


def _lagging(time_s: FloatArray, force: FloatArray, retarded_s: FloatArray) -> FloatArray:
    """(l, m) a force (m,) behind low-pass filters of times (l,) [s]; between samples it is straight, each filter then
    exact."""
    found = np.empty((len(retarded_s), len(force)))
    found[:, 0] = force[0]
    for i, step_s in enumerate(np.diff(time_s)):
        left, rate = np.exp(-step_s / retarded_s), (force[i + 1] - force[i]) / step_s
        found[:, i + 1] = force[i + 1] - rate * retarded_s * (1.0 - left) + left * (found[:, i] - force[i])
    return found
