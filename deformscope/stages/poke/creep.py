"""How a foam creeps under a touch: its stiffness at once and when all has relaxed, how fast, and what a cycle loses.

The law of `contact` with a memory. Where every modulus of a foam relaxes alike, E(t) = E0 (1 - g + sum g_i exp(-t/t_i))
(a generalised Maxwell solid; one branch: the standard linear solid, Zener 1948), a ball that never moves back meets

    d(t)^p / D0^p = [F(t) + sum_i j_i E_i(t)] / F0,      dE_i/dt = (F - E_i) / l_i

(Lee and Radok 1960; p as in `contact`, D0 the dent at once under the set force F0): each branch of the creep compliance
is a low-pass filter of the force with strength j_i and retardation time l_i. Forces are taken as measured and places
are fitted, as in `contact`: the arm's scatter is what matters. Relaxation times t_i follow from those of creep.

None, one and two branches are compared by their evidence and averaged. Approach speed needs no correction: the filters
know when the force came.

The ball's way back does not follow this law (Ting 1966) and is not fitted: the energy that a cycle loses is what the
measured forces did on the way in less what they gave on the way out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.relaxation import mean_relaxation_s
from deformscope.stages.fit.weighted_draws import draw_about, median_and_interval, pooled
from deformscope.stages.poke.contact import (
    EXPONENT,
    EXPONENT_SD,
    LOADED,
    Z_90,
    ArmCompliance,
    TipKind,
    along_normal,
    since_contact,
)

CreepVerdict = Literal["elastic", "viscous", "unidentified"]

STRENGTH_MEDIAN, STRENGTH_SPREAD = 0.2, 0.9
"""Log-normal prior of a branch's strength j: relaxation of 2 to 50 %, where flexible foams lie [assumed]."""
TIME_MEDIAN_S, TIME_SPREAD = 1.2, 0.9
"""Log-normal prior of a retardation time: 0.08 to 12 s, what a touch of some seconds can be asked about."""
MOST_BRANCHES = 2
HOLD_SAMPLES = 200
"""Of the hold, that are fitted: more are averaged over equal counts."""
ELASTIC_MOST = 0.03
"""Share of the modulus that may relax in a foam that counts as elastic: what arm's scatter and law leave open."""
SURE = 0.95
LEAST_EXPONENT, LEAST_SHARE = 0.2, 1e-4
BEND_SD = 0.005
"""Of q: log depth goes by log force over p plus q times its square, 0 at the set force. Finite elements of a ball of
2 cm on 2 to 8 cm of bonded foam, Poisson's ratio .05 to .4, at 1 and 3 N: -.009 to .006."""
LAW_OFF, LAW_PIECES = 0.015, 5.0
"""Of a dent, what that law is off by on the way to the set force: as above, at most 0.02; and as how many samples that
way counts, since neighbouring ones are off alike."""
SHAPE = 4
"""Parameters of the law without a memory."""
LOG_TIMES, TIMES = (np.log(0.005), np.log(200.0)), 80
"""Retardation times for which the filters are computed; between them they are interpolated."""


@dataclass(frozen=True, slots=True)
class CreepFit:
    """What a touch measured of a foam's creep; every interval holds 90 %.

    instant_n_per_mm, relaxed_n_per_mm: set force over depth, at once and when all has relaxed [N/mm]; relaxed_log_sd:
    deviation of the log of the latter
    share: of the modulus that relaxes, 1 - E(inf) / E0; time_s: mean relaxation time, each branch weighed by its share
    loss: energy that the cycle lost over what the way in took; None where the way out was not recorded
    held_s: how long the force was held; speed_m_s: of the approach in contact
    verdict: "elastic": less than ELASTIC_MOST relaxes; "viscous": more does; "unidentified": either may be
    """

    instant_n_per_mm: float
    instant_interval: tuple[float, float]
    relaxed_n_per_mm: float
    relaxed_interval: tuple[float, float]
    relaxed_log_sd: float
    share: float
    share_interval: tuple[float, float]
    time_s: float
    time_interval: tuple[float, float]
    loss: float | None
    loss_interval: tuple[float, float] | None
    held_s: float
    speed_m_s: float
    verdict: CreepVerdict


def fit_creep(
    time_s: FloatArray,
    position_m: FloatArray,
    force_n: FloatArray,
    normal: FloatArray,
    *,
    loading: int,
    held: int,
    tip: TipKind = "sphere",
    set_force_n: float = 3.0,
    arm: ArmCompliance | None = None,
    exponent_sd: float = EXPONENT_SD,
) -> CreepFit:
    """Fit the law to a touch that came down, held and, if it was recorded, went back.

    time_s (n,), position_m (n, 3), force_n (n, 3), normal (3,), set_force_n, arm: as in `contact.fit_approach`
    loading: how many samples lead up to the set force; held: how many were taken until the tip went back

    Raises InputError where the touch holds nothing to fit, as `fit_approach` does.
    """
    if not 0 < loading < held <= len(time_s):
        raise InputError("0 < loading < held <= samples", f"{loading}, {held} and {len(time_s)}")
    arm = arm or ArmCompliance()
    z_m, force = along_normal(time_s, position_m, force_n, normal)
    zeroed, force_sd, _, among = since_contact(force[:loading], set_force_n, None)
    force = force - (force[0] - zeroed[0])
    samples = _Samples.of(time_s, z_m, force, int(np.argmax(among)), loading, held)
    law = _Law(samples, EXPONENT[tip], exponent_sd, set_force_n, arm, force_sd)
    draws = [law.posterior(branches) for branches in range(MOST_BRANCHES + 1)]
    weight = pooled([one.log_evidence for one in draws], [one.weight for one in draws])
    depth_m, exponent, strength, mean_time_s = (
        np.concatenate([getattr(one, name) for one in draws])
        for name in ("depth_m", "exponent", "strength", "mean_time_s")
    )
    instant = 1e-3 * set_force_n / depth_m
    relaxed = instant * (1.0 + strength) ** (-1.0 / exponent)
    share, creeps = strength / (1.0 + strength), strength > 0.0
    middle = float(np.average(np.log(relaxed), weights=weight))
    viscous = float(weight[share > ELASTIC_MOST].sum())
    verdict: CreepVerdict = "viscous" if viscous > SURE else "elastic" if viscous < 1.0 - SURE else "unidentified"
    return CreepFit(
        *median_and_interval(instant, weight),
        *median_and_interval(relaxed, weight),
        float(np.sqrt(np.average((np.log(relaxed) - middle) ** 2, weights=weight))),
        *median_and_interval(share, weight),
        *median_and_interval(mean_time_s[creeps], weight[creeps]),
        *cycle_loss(z_m, force, held, arm, force_sd),
        float(time_s[held - 1] - time_s[loading - 1]),
        float((z_m[loading - 1] - z_m[samples.first]) / (time_s[loading - 1] - time_s[samples.first])),
        verdict,
    )


def cycle_loss(
    z_m: FloatArray, force_n: FloatArray, held: int, arm: ArmCompliance, force_sd_n: float
) -> tuple[float | None, tuple[float, float] | None]:
    """Share of the energy of the way in and of the hold that the way out did not give back, and its 90 % interval.

    z_m, force_n: (n,) of a whole touch along the normal, zero of the force taken off; held: samples until the way back.
    None where the force did not come back to nothing. What the arm itself stores is no work on the foam.
    """
    peak = float(force_n[:held].max())
    z_m = z_m - arm.compliance_m_per_n * force_n
    back = np.flatnonzero(force_n[held:] < max(0.02 * peak, 3.0 * force_sd_n))
    if not len(back):
        return None, None
    end = held + int(back[0])
    middle_n, way_m = 0.5 * (force_n[1 : end + 1] + force_n[:end]), np.diff(z_m[: end + 1])
    work = middle_n * way_m
    taken, given = float(work[: held - 1].sum()), -float(work[held - 1 :].sum())
    # a work is also minus the sum of places times how the force changes around them, each place off by its own
    steps = np.zeros(end + 1)
    steps[1:-1] = 0.5 * (force_n[2 : end + 1] - force_n[: end - 1])
    loss = 1.0 - given / taken
    # an arm that gives otherwise than calibrated stored and gave back another c F^2 / 2
    bent = arm.compliance_sd * 0.5 * peak**2 * loss
    noise = arm.position_sd_m * float(np.linalg.norm(steps)), force_sd_n * float(np.linalg.norm(way_m))
    sd = float(np.linalg.norm(np.array([*noise, bent]))) / taken
    return loss, (loss - Z_90 * sd, loss + Z_90 * sd)


@dataclass(frozen=True, slots=True)
class _Samples:
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
    ) -> _Samples:
        every = max(1, (held - loading) // HOLD_SAMPLES)
        ends = np.unique([*range(1, loading + 1), *range(loading, held, every), held])
        starts = np.append(0, ends[:-1])
        count = (ends - starts).astype(float)
        time, z, force = (np.add.reduceat(one[:held], starts) / count for one in (time_s, z_m, force_n))
        return cls(time, z, force, count, first, loading)


@dataclass(frozen=True, slots=True)
class _Draws:
    """Of one number of branches: log evidence; weight (d,), which adds up to 1; D0 [m], p, sum of j_i, mean relaxation
    time [s], all (d,)"""

    log_evidence: float
    weight: FloatArray
    depth_m: FloatArray
    exponent: FloatArray
    strength: FloatArray
    mean_time_s: FloatArray


class _Law:
    """The law over one touch; parameters (4 + 2 b,): z0 [mm], log D0, p, the law's bend q, then log j and log l of
    each branch."""

    def __init__(
        self,
        samples: _Samples,
        prior_exponent: float,
        exponent_sd: float,
        set_force_n: float,
        arm: ArmCompliance,
        force_sd_n: float,
    ) -> None:
        fitted = slice(samples.first, None)
        force = np.maximum(samples.force_n, 0.0) / set_force_n
        self._share = force[fitted]
        log_s = np.linspace(*LOG_TIMES, TIMES)
        self._filtered = scipy.interpolate.CubicSpline(log_s, _lagging(samples.time_s, force, np.exp(log_s))[:, fitted])
        self._z = samples.z_m[fitted] - arm.compliance_m_per_n * samples.force_n[fitted]
        self._bent_m = arm.compliance_sd * set_force_n
        self._exponent = prior_exponent, exponent_sd
        root = np.sqrt(samples.count[fitted])
        share = np.maximum(self._share, LOADED)
        design = np.column_stack([np.ones_like(self._z), share ** (1.0 / prior_exponent)])
        (z0, depth_m), *_ = np.linalg.lstsq(design, self._z, rcond=None)
        self._start = np.array([1e3 * z0, np.log(max(depth_m, 1e-5)), prior_exponent, 0.0])
        slope_m = depth_m / prior_exponent * share ** (1.0 / prior_exponent - 1.0)
        sd = np.hypot(max(arm.position_sd_m, 1e-6), slope_m * force_sd_n / set_force_n) / root
        off = LAW_OFF * depth_m * share ** (1.0 / prior_exponent) * np.clip(1.0 - share, 0.0, 1.0)
        sd = np.hypot(sd, off * np.sqrt(max(1.0, (samples.loading - samples.first) / LAW_PIECES)))
        self._sd = sd
        # the arm may scatter more than stated
        scatter = self._off(self._best(MOST_BRANCHES)[None])[0]
        self._sd = sd * max(1.0, float(np.sqrt(np.mean(scatter**2))))

    def posterior(self, branches: int) -> _Draws:
        """Weighted draws of the parameters with so many branches."""
        best = self._best(branches)
        random = np.random.default_rng(branches)
        drawn, weight, log_evidence = draw_about(
            best, self._jacobian(best), self._residuals, self._log_size(branches), random
        )
        strength, retarded_s = np.exp(drawn[:, SHAPE : SHAPE + branches]), np.exp(drawn[:, SHAPE + branches :])
        bent_m = self._bent_m * random.standard_normal(len(drawn))
        return _Draws(
            log_evidence,
            weight,
            np.maximum(np.exp(drawn[:, 1]) + bent_m, 1e-6),
            np.maximum(drawn[:, 2], LEAST_EXPONENT),
            strength.sum(axis=1),
            mean_relaxation_s(strength, retarded_s),
        )

    def _best(self, branches: int) -> FloatArray:
        """(4 + 2 b,) the likeliest parameters."""
        apart = np.linspace(-0.7, 0.7, branches) if branches > 1 else np.zeros(branches)
        start = np.concatenate(
            [self._start, np.full(branches, np.log(STRENGTH_MEDIAN)), np.log(TIME_MEDIAN_S) + TIME_SPREAD * apart]
        )
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
            (log_j - np.log(STRENGTH_MEDIAN)) / STRENGTH_SPREAD,
            (log_l - np.log(TIME_MEDIAN_S)) / TIME_SPREAD,
        ]
        return np.concatenate([self._off(parameters), *priors], axis=1)

    def _off(self, parameters: FloatArray) -> FloatArray:
        """(d, m) how far each sample is from the law, in its deviations."""
        branches = (parameters.shape[1] - SHAPE) // 2
        felt = np.broadcast_to(self._share, (len(parameters), len(self._share))).copy()
        for strength, log_s in zip(
            np.exp(parameters.T[SHAPE:][:branches]), parameters.T[SHAPE + branches :], strict=True
        ):
            felt += strength[:, None] * self._filtered(np.clip(log_s, *LOG_TIMES))
        log_felt = np.log(np.maximum(felt, LEAST_SHARE))
        z0_m, log_depth, exponent, bend = parameters.T[:SHAPE, :, None]
        log_dent = log_depth + log_felt / np.maximum(exponent, LEAST_EXPONENT) + bend * log_felt**2
        return np.asarray((self._z - 1e-3 * z0_m - np.exp(log_dent)) / self._sd)

    def _log_size(self, branches: int) -> float:
        """Logarithm of what the priors' densities are divided by, without what all numbers of branches share."""
        return float(branches * np.log(2.0 * np.pi * STRENGTH_SPREAD * TIME_SPREAD))


def _lagging(time_s: FloatArray, force: FloatArray, retarded_s: FloatArray) -> FloatArray:
    """(l, m) a force (m,) behind low-pass filters of times (l,) [s]; between samples it is straight, each filter then
    exact."""
    found = np.empty((len(retarded_s), len(force)))
    found[:, 0] = force[0]
    for i, step_s in enumerate(np.diff(time_s)):
        left, rate = np.exp(-step_s / retarded_s), (force[i + 1] - force[i]) / step_s
        found[:, i + 1] = force[i + 1] - rate * retarded_s * (1.0 - left) + left * (found[:, i] - force[i])
    return found
