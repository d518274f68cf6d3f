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

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.relaxation import mean_relaxation_s, relaxing
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
from deformscope.stages.poke.permanent_set import kept_share
from deformscope.stages.poke.slip import SlipFit, fit_slip

CreepVerdict = Literal["elastic", "viscous", "plastic", "slipping", "unidentified"]

STRENGTH_MEDIAN, STRENGTH_SPREAD = 0.2, 0.9
"""Log-normal prior of the strength j of one branch, in equal parts of several: relaxation of 2 to 50 %, where flexible
foams lie [assumed]."""
TIME_MEDIAN_S, TIME_SPREAD = 1.2, 0.9
"""Log-normal prior of a retardation time: 0.08 to 12 s, what a touch of some seconds can be asked about."""
MOST_BRANCHES = 2
HOLD_SAMPLES = 120
"""Of the hold, that are fitted: more are averaged over equal counts."""
ELASTIC_MOST = 0.03
"""Share of the modulus that may relax in a foam that counts as elastic: what arm's scatter and law leave open."""
KEPT_LEAST = 0.06
"""Share of a dent that stays for good from which on a foam counts as plastic: below, the law's error may look so."""
SURE = 0.95
REFERENCE_SPEED_M_S = 0.01
"""Stiffness is converted to what an approach at this speed would have felt, so that touches compare."""
RAMP_STEPS = 60
"""Of the force on the way down at the reference speed."""
KEPT_DRAWS = 60
"""Of the laws drawn, from which what is kept is computed."""
LEAST_EXPONENT, LEAST_SHARE = 0.2, 1e-4
BEND_SD = 0.003
"""Of q: log depth goes by log force over p plus q times its square, 0 at the set force. Finite elements of a ball of
2 cm on 2 to 8 cm of bonded foam, Poisson's ratio .05 to .4, at 1 and 3 N: -.009 to .006."""
LAW_OFF, LAW_RISE, LAW_LENGTH = 0.004, 0.4, 0.3
"""Of a log dent, what that law is off by: a Gaussian process over log force, 0 at the set force, with this deviation
there, more below it (a power of the force) and with this length: elements that come into contact one after the other
make waves of 0.2 to 1 % (24 slabs as above, seeds kept for choosing). Foam itself is no better."""
LAYERED, LAYERED_SD = 0.05, 0.05
"""What a layer on a table adds to a ball's exponent: 0.04 to 0.07 on these slabs; foam itself may add to it."""
BALL_STEPS = 400
SHAPE = 5
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
    verdict: "slipping": the tip slid over the surface, and the rest is doubtful; "plastic": a dent stays for good;
    "elastic": less than ELASTIC_MOST relaxes; "viscous": more does; "unidentified": none is SURE; why: in words
    viscous, plastic, slipping: probabilities of each, None where the touch cannot tell
    kept, kept_interval: share of the dent that stays, beyond what relaxation explains; None without the way out
    slid_m, force_ratio: how far the tip slid, if it did; the largest force across over the set force
    log_at_reference, log_at_reference_sd: log of the stiffness that an approach at REFERENCE_SPEED_M_S would have felt
    over that which this one felt, and its deviation
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
    why: str = ""
    viscous: float | None = None
    plastic: float | None = None
    slipping: float | None = None
    kept: float | None = None
    kept_interval: tuple[float, float] | None = None
    slid_m: float | None = None
    force_ratio: float | None = None
    log_at_reference: float = 0.0
    log_at_reference_sd: float = 0.0


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
    radius_m: float | None = None,
    clock_sd_s: float = 0.0,
) -> CreepFit:
    """Fit the law to a touch that came down, held and, if it was recorded, went back.

    time_s (n,), position_m (n, 3), force_n (n, 3), normal (3,), set_force_n, arm: as in `contact.fit_approach`
    radius_m: of a ball, whose dents are not small beside it; None: the law is a power at all depths
    clock_sd_s: deviation of the force's times against the place's, which the energy loss is sensitive to
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
    ball_m = radius_m if tip == "sphere" else None
    exponent = (EXPONENT[tip] + LAYERED, LAYERED_SD) if ball_m else (EXPONENT[tip], EXPONENT_SD)
    law = _Law(samples, exponent, set_force_n, arm, force_sd, ball_m)
    draws = _Draws.together([law.posterior(branches) for branches in range(MOST_BRANCHES + 1)])
    weight, strength = draws.weight, draws.strength.sum(axis=1)
    instant = 1e-3 * set_force_n / draws.depth_m
    relaxed = instant * np.exp(-draws.log_deeper)
    share, creeps = strength / (1.0 + strength), strength > 0.0
    middle = float(np.average(np.log(relaxed), weights=weight))
    viscous = float(weight[share > ELASTIC_MOST].sum())
    kept = _kept(draws, time_s, z_m, force, held, arm, force_sd)
    slip = _slip(draws, z_m, force, position_m[:held], force_n[:held], normal, loading, arm, force_sd)
    plastic = None if kept is None else float((kept > KEPT_LEAST).mean())
    verdict, why = _verdict(viscous, plastic, slip)
    speed_m_s = float((z_m[loading - 1] - z_m[samples.first]) / (time_s[loading - 1] - time_s[samples.first]))
    other_speed = _at_reference(draws, speed_m_s)
    nothing: tuple[None, None] = (None, None)
    stays, stays_interval = nothing if kept is None else median_and_interval(kept, np.ones(len(kept)))
    instant_median, instant_interval = median_and_interval(instant, weight)
    relaxed_median, relaxed_interval = median_and_interval(relaxed, weight)
    share_median, share_interval = median_and_interval(share, weight)
    relaxation_s, relaxation_interval = median_and_interval(draws.mean_time_s[creeps], weight[creeps])
    loss, loss_interval = cycle_loss(z_m, force, held, arm, force_sd, clock_sd_s / float(np.diff(time_s).mean()))
    return CreepFit(
        instant_n_per_mm=instant_median,
        instant_interval=instant_interval,
        relaxed_n_per_mm=relaxed_median,
        relaxed_interval=relaxed_interval,
        relaxed_log_sd=float(np.sqrt(np.average((np.log(relaxed) - middle) ** 2, weights=weight))),
        share=share_median,
        share_interval=share_interval,
        time_s=relaxation_s,
        time_interval=relaxation_interval,
        loss=loss,
        loss_interval=loss_interval,
        held_s=float(time_s[held - 1] - time_s[loading - 1]),
        speed_m_s=speed_m_s,
        verdict=verdict,
        why=why,
        viscous=viscous,
        plastic=plastic,
        slipping=slip.probability,
        kept=stays,
        kept_interval=stays_interval,
        slid_m=slip.slid_m,
        force_ratio=slip.ratio,
        log_at_reference=float(other_speed.mean()),
        log_at_reference_sd=float(other_speed.std()),
    )


def _at_reference(draws: _Draws, speed_m_s: float) -> FloatArray:
    """(d,) draws of the log of the stiffness at the reference speed over that at this one: how much of the force the
    branches follow by while it rises as the p-th power of time."""
    some = draws.some(np.random.default_rng(0), KEPT_DRAWS)
    gone = (np.arange(RAMP_STEPS) + 0.5) / RAMP_STEPS  # share of the way down

    def log_softer(speed: float) -> FloatArray:
        ramp_s = (some.depth_m / max(speed, 1e-6))[:, None, None]
        force = gone ** some.exponent[:, None, None]
        # by parts: what has not come through yet of each step of the force
        late = np.exp(-(1.0 - gone) * ramp_s / some.retarded_s[..., None])
        follows = 1.0 - (late * np.gradient(force, gone, axis=-1)).mean(axis=-1)
        return np.asarray(np.log1p((some.strength * follows.clip(0.0, 1.0)).sum(axis=1)) / some.exponent)

    return log_softer(speed_m_s) - log_softer(REFERENCE_SPEED_M_S)


def _verdict(viscous: float, plastic: float | None, slip: SlipFit) -> tuple[CreepVerdict, str]:
    """What a touch met, and why it is taken for that."""
    if slip.probability > SURE:
        where = f"once the force across was {slip.friction:.2g} of the force"
        return "slipping", f"the tip slid {1e3 * slip.slid_m:.1f} mm {where}"
    if plastic is not None and plastic > SURE:
        return "plastic", "the tip let go deeper than relaxation explains"
    if viscous > SURE:
        return "viscous", f"more than {ELASTIC_MOST:.0%} of the modulus relaxes"
    if viscous < 1.0 - SURE:
        return "elastic", f"less than {ELASTIC_MOST:.0%} of the modulus relaxes"
    return "unidentified", f"whether {ELASTIC_MOST:.0%} of the modulus relaxes is too near to call"


def _kept(
    draws: _Draws,
    time_s: FloatArray,
    z_m: FloatArray,
    force_n: FloatArray,
    held: int,
    arm: ArmCompliance,
    force_sd_n: float,
) -> FloatArray | None:
    """(d,) draws of the share of the dent that stays; None where the way back was not recorded."""
    random = np.random.default_rng(0)
    some = draws.some(random, KEPT_DRAWS)
    share, relaxation_s = relaxing(some.strength, some.retarded_s)
    dent_m = some.dents(z_m, force_n, arm)
    found = kept_share(time_s, dent_m, force_n, held, some.exponent, share, relaxation_s, arm, force_sd_n)
    if found is None:
        return None
    kept, sd = found
    return np.asarray(kept[:, None] + sd[:, None] * random.standard_normal((len(kept), KEPT_DRAWS))).ravel()


def _slip(
    draws: _Draws,
    z_m: FloatArray,
    force_along_n: FloatArray,
    position_m: FloatArray,
    force_n: FloatArray,
    normal: FloatArray,
    loading: int,
    arm: ArmCompliance,
    force_sd_n: float,
) -> SlipFit:
    """Whether the tip slid until its way back."""
    held = len(position_m)
    along = normal / np.linalg.norm(normal)
    plane = np.linalg.svd(along[None])[2][1:]
    across_n = force_n @ plane.T
    free = force_along_n[:loading] < LOADED * force_along_n.max()
    across_n = across_n - np.median(across_n[:loading][free], axis=0) if free.any() else across_n
    dent_m = draws.some(np.random.default_rng(0), KEPT_DRAWS).dents(z_m[:held], force_along_n[:held], arm).mean(axis=0)
    return fit_slip(position_m @ plane.T, across_n, dent_m, force_along_n[:held], force_sd_n)


def cycle_loss(
    z_m: FloatArray,
    force_n: FloatArray,
    held: int,
    arm: ArmCompliance,
    force_sd_n: float,
    clock_sd: float = 0.0,
) -> tuple[float | None, tuple[float, float] | None]:
    """Share of the energy of the way in and of the hold that the way out did not give back, and its 90 % interval.

    z_m, force_n: (n,) of a whole touch along the normal, zero of the force taken off; held: samples until the way back;
    clock_sd: deviation of the force's times against the place's, in samples.
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
    loss = 1.0 - given / taken
    # by how much the loss follows the place and the force of each sample, each off by its own
    counts = np.where(np.arange(end) < held - 1, 1.0 - loss, 1.0)
    by_place = np.diff(np.pad(counts * middle_n, 1))
    by_force = 0.5 * np.convolve(counts * way_m, [1.0, 1.0])
    # an arm that gives otherwise than calibrated stored and gave back another c F^2 / 2
    bent = arm.compliance_sd * 0.5 * peak**2 * loss
    noise = arm.position_sd_m * float(np.linalg.norm(by_place)), force_sd_n * float(np.linalg.norm(by_force))
    # forces that are late by a sample, all the way: a work of F dF/dt on the way in, and more on the way out
    late = clock_sd * float((counts * way_m * np.gradient(force_n[: end + 1])[1:]).sum())
    sd = float(np.linalg.norm(np.array([*noise, bent, late]))) / taken
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
        return cls(time_s=time, z_m=z, force_n=force, count=count, first=first, loading=loading)


@dataclass(frozen=True, slots=True)
class _Draws:
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
    def together(cls, models: Sequence[_Draws]) -> _Draws:
        """All, each model by its evidence."""
        weight = pooled([one.log_evidence for one in models], [one.weight for one in models])
        others = {name: np.concatenate([getattr(one, name) for one in models]) for name in cls._parameters()}
        return cls(log_evidence=0.0, weight=weight, **others)

    @classmethod
    def _parameters(cls) -> list[str]:
        """Names of the fields that are neither evidence nor weight."""
        return [one.name for one in fields(cls) if one.name not in ("log_evidence", "weight")]

    def some(self, random: np.random.Generator, count: int) -> _Draws:
        """So many of them, by their weight."""
        at = random.choice(len(self.weight), count, p=self.weight / self.weight.sum())
        others = {name: getattr(self, name)[at] for name in self._parameters()}
        return _Draws(log_evidence=self.log_evidence, weight=np.full(count, 1.0 / count), **others)

    def dents(self, z_m: FloatArray, force_n: FloatArray, arm: ArmCompliance) -> FloatArray:
        """(d, n) of places and forces (n,) [m]."""
        gives = arm.compliance_m_per_n + arm.compliance_sd * self.bent[:, None]
        return np.asarray(np.maximum(z_m - self.start_m[:, None] - gives * force_n, 0.0))


class _Law:
    """The law over one touch; parameters (5 + 2 b,): z0 [mm], log D0 (of a ball: of the dent that a paraboloid
    would make instead), p, the law's bend q, the arm's compliance in deviations from what it was calibrated to, then
    log j and log l of each branch.

    What the law is off by at one force it is off by at neighbouring ones, in the hold as on the way down: residuals
    are whitened by the covariance of that and of the samples' own scatter.
    """

    def __init__(
        self,
        samples: _Samples,
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

    def posterior(self, branches: int) -> _Draws:
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
        return _Draws(
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
