"""Creep of a foam under a touch: its immediate and relaxed stiffness, its rate, and the energy loss of a cycle.

The law of `contact` with a memory. Where every modulus of a foam relaxes alike, E(t) = E0 (1 - g + sum g_i exp(-t/t_i))
(a generalised Maxwell solid; one branch: the standard linear solid, Zener 1948), a ball that never retracts loads the
foam by

    d(t)^p / D0^p = [F(t) + sum_i j_i E_i(t)] / F0,      dE_i/dt = (F - E_i) / l_i

(Lee and Radok 1960; p as in `contact`, D0 the immediate dent under the set force F0). Each branch of the creep
compliance is a low-pass filter of the force with strength j_i and retardation time l_i. Forces are treated as exact and
places are fitted, as in `contact`: the arm's scatter dominates. Relaxation times t_i follow from those of creep.

Models with zero to three branches, and with spectra that reach no plateau, are averaged by their evidence. A hold
determines creep within its duration. If a branch probably lasts longer than the hold, or creep has no end, a reason
reports that. The dependent values are then bounds. A smaller probability opens their intervals. The remaining force
after a time within the hold is always reported. Approach speed needs no correction: the filters use the times of the
force.

The free air before and after a touch gives the drift of the force, which is taken off. Without air after it drift and
slow creep look alike; the prior of `creep_law.DRIFT_N_PER_S` allows for that of a sensor that warms up.

The ball's retract does not follow this law (Ting 1966) and is not fitted; `permanent_share` uses it. The energy loss of
a cycle is the work of the measured forces on the approach less that on the retract.

Whether the tip slid over the foam while it pressed is computed from the force and the motion across the normal.

While a contact sticks, the force across grows with the motion across, dT = k (F / d) dx. A ball on an elastic body is
about STICK times as stiff across as along (Mindlin 1949: 2 (1 - v) / (2 - v) of the tangent, with F / d the secant). A
sensor or a normal that is tilted adds a share of F. Once T reaches a limit, mu F, it stays at the limit while the tip
moves: the tip slides. Both are averaged over k, mu and tilt; the slip is the motion beyond the limit."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.relaxation import ForceKept, RelaxationSeen, kept_of, median_and_interval, relaxing
from deformscope.stages.poke.contact import (
    EXPONENT,
    EXPONENT_SD,
    LOADED,
    Z_90,
    ArmCompliance,
    along_normal,
    since_contact,
)
from deformscope.stages.poke.creep_law import DRIFT_N_PER_S, CreepDraws, CreepLaw, CreepSamples

CreepBehaviour = Literal["elastic", "viscous", "plastic", "slipping", "unidentified"]

ELASTIC_MOST = 0.03
"""Share of the modulus that may relax in a foam that counts as elastic: the uncertainty due to the arm's scatter and
the law."""
KEPT_LEAST = 0.06
"""Permanent share of a dent from which a foam counts as plastic: below, the law's error may look the same."""
SURE = 0.95
SEVERAL = 0.8
"""If several branches have a greater probability, the foam may also relax faster than the approach was."""
REFERENCE_SPEED_M_S = 0.01
"""Stiffness is converted to that of an approach at this speed, so that touches compare."""
RAMP_STEPS = 60
"""Steps of the force on the way down at the reference speed."""
KEPT_DRAWS = 60
"""Number of sampled laws from which permanent set, slip and rate dependence are computed: the same samples, of seed 0,
for all three."""
FORCE_DRAWS = 400
"""Number of sampled laws from which the remaining force is computed."""
AIR, AIR_OFF = 5, 0.3
"""Fewest samples of free air on either side that show a drift, and their least distance from first contact, as a share
of the dent."""
UNEVEN, NAMED = 0.2, 0.02
"""Deviation of a drift from an even one, as a share, and the share of the set force from which it is named."""
LAYERED, LAYERED_SD = 0.05, 0.05
"""Addition of a layer on a table to a ball's exponent: 0.04 to 0.07 on the slabs of `creep_law.BEND_SD`; foam itself
may add to it."""
STICK, STICK_SD = 0.9, 0.3
TILT_SD = 0.05
"""Deviation of the share of F that a tilted sensor or normal adds: 3 degrees."""
FRICTION = np.geomspace(0.03, 2.0, 40)
STICKS = STICK + STICK_SD * np.linspace(-2.0, 2.0, 9)
PIECES = 40
"""Number of parts of the touch whose means are compared."""
STICK_OFF = 0.1
"""Error of that law, as a share of the force across."""
START_SD = 0.02
"""Standard deviation of the lateral force before the first part that is compared, as a share of the largest force."""
SMOOTHED = 9
"""Samples over which the way across is averaged."""
SLID_M = 5e-4
"""A smaller slip counts as none."""


@dataclass(frozen=True, slots=True)
class SlipFit:
    """probability: probability that the tip slid by SLID_M or more; slid_m: distance, if it slid; friction:
    lateral force by normal force where it slid"""

    probability: float
    slid_m: float
    friction: float


def fit_slip(
    across_m: FloatArray, across_n: FloatArray, dent_m: FloatArray, force_n: FloatArray, force_sd_n: float
) -> SlipFit:
    """Slip of a touch until its retract. across_m, across_n: (n, 2) place and force in the surface's plane, the force
    without its offset"""
    peak = float(force_n.max())
    loaded = slice(int(np.argmax(force_n > LOADED * peak)), None)
    kernel = np.full(SMOOTHED, 1.0 / SMOOTHED)
    padded = np.pad(across_m, ((SMOOTHED // 2, SMOOTHED // 2), (0, 0)), mode="edge")
    smooth_m = np.stack([np.convolve(one, kernel, mode="valid") for one in padded.T], axis=1)[loaded]
    force, lateral = np.maximum(force_n[loaded], LOADED * peak), across_n[loaded]
    secant = force / np.maximum(dent_m[loaded], 1e-5)
    # how the force across would grow did the contact stick
    steps_m = np.diff(smooth_m, axis=0, prepend=smooth_m[:1])
    sticking = np.cumsum(secant[:, None] * steps_m, axis=0)
    way = sticking[-1] if np.linalg.norm(sticking[-1]) > 0.0 else np.array([1.0, 0.0])
    way = way / np.linalg.norm(way)
    sticking_n, moved_m = sticking @ way, (smooth_m - smooth_m[0]) @ way
    ends = np.unique(np.linspace(0, len(force), PIECES + 1).round().astype(int))
    count = np.diff(ends)

    def pieces(one: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(one, ends[:-1], axis=-1) / count)

    stick, friction = (one.ravel() for one in np.meshgrid(STICKS, FRICTION, indexing="ij"))
    whole = stick[:, None] * sticking_n
    limit = friction[:, None] * force
    slid = np.abs(whole) > limit
    across = pieces(lateral @ way)
    sd = np.hypot(force_sd_n / np.sqrt(count), STICK_OFF * np.abs(across)) + 1e-3
    off = (across - pieces(np.clip(whole, -limit, limit))) / sd
    # tilt and start are taken out in closed form
    taken = np.stack([TILT_SD * pieces(force), np.full(len(count), START_SD * peak)], axis=1) / sd[:, None]
    shared = off @ taken
    fitted = (off**2).sum(axis=1) - (shared * np.linalg.solve(taken.T @ taken + np.eye(2), shared.T).T).sum(axis=1)
    prior = -0.5 * ((stick - STICK) / STICK_SD) ** 2
    log_weight = prior - 0.5 * fitted
    weight = np.exp(log_weight - scipy.special.logsumexp(log_weight))
    steps = np.diff(moved_m, prepend=moved_m[:1])
    slid_m = np.abs((slid * steps).sum(axis=1))
    slides = slid_m > SLID_M
    probability = float(weight[slides].sum())
    given = weight * slides if probability > 0.0 else weight
    return SlipFit(
        probability=probability,
        slid_m=float(np.average(slid_m, weights=given)),
        friction=float(np.average(friction, weights=given)),
    )


@dataclass(frozen=True, slots=True)
class CreepFit:
    """A touch's measurement of a foam's creep; every interval holds 90 %.

    instant_n_per_mm, relaxed_n_per_mm: set force over depth, immediate and after relaxation [N/mm]; relaxed_log_sd:
    deviation of the log of the relaxed value, which is None with a reason
    share: share of the modulus that relaxes, 1 - E(inf) / E0; time_s: mean relaxation time, each branch weighted by its
    share, of the relaxation within the hold; with a reason both are lower bounds. If the relaxed state is unseen with a
    probability above `relaxation.OPEN`, their intervals are open above, and that of the relaxed stiffness begins at
    0. If several branches are likely, some may be faster than the approach: the interval of `instant_n_per_mm` is open
    above, and with a reason no time is given (None)
    reasons: "short-record": a branch may outlast the hold; "no-plateau": the foam may creep without end; "force-drift":
    the force drifted, which is taken off and bounds no value
    short_record, no_plateau: probabilities of each
    force_kept: share of the force at the end of the approach that is left, held in place, for times within the hold
    loss: energy that the cycle lost over that of the approach; None if the retract was not recorded
    held_s: how long the force was held; speed_m_s: speed of the approach in contact
    verdict: "slipping": the tip slid over the surface, and other values are doubtful; "plastic": a permanent dent;
    "elastic": less than ELASTIC_MOST relaxes; "viscous": more relaxes; "unidentified": no other verdict reaches the
    probability SURE; why: why, in words
    viscous, plastic, slipping: probabilities of each, None if the touch does not determine it
    kept, kept_interval: permanent share of the dent, beyond relaxation; None without the retract
    slid_m: how far the tip slid, if it did
    log_at_reference, log_at_reference_sd: log of the ratio of stiffness at an approach with REFERENCE_SPEED_M_S to that
    of this one, and its deviation"""

    instant_n_per_mm: float
    instant_interval: tuple[float, float]
    relaxed_n_per_mm: float | None
    relaxed_interval: tuple[float, float] | None
    relaxed_log_sd: float | None
    share: float
    share_interval: tuple[float, float]
    time_s: float | None
    time_interval: tuple[float, float] | None
    loss: float | None
    loss_interval: tuple[float, float] | None
    held_s: float
    speed_m_s: float
    verdict: CreepBehaviour
    why: str = ""
    reasons: tuple[Doubt, ...] = ()
    force_kept: tuple[ForceKept, ...] = ()
    short_record: float = 0.0
    no_plateau: float = 0.0
    viscous: float | None = None
    plastic: float | None = None
    slipping: float | None = None
    kept: float | None = None
    kept_interval: tuple[float, float] | None = None
    slid_m: float | None = None
    log_at_reference: float = 0.0
    log_at_reference_sd: float = 0.0

    @property
    def brief(self) -> str:
        """Verdict, reasons, and the relaxing share."""
        least, most = self.share_interval
        if self.verdict in ("elastic", "slipping"):
            return self.verdict
        if self.reasons and self.relaxed_n_per_mm is None:
            return f"{self.verdict}, {self.reasons[0].code}: at least {least:.0%} relaxes"
        return f"{self.verdict}, {self.share:.0%} relaxes ({least:.0%} to {most:.0%})"

    @property
    def text(self) -> str:
        """The foam's creep by the hold, as text."""
        held = f"; held in place it {self.force_kept[-1]}" if self.force_kept else ""
        loss = ("" if self.loss is None else f", a touch loses {self.loss:.0%} of its energy") + held
        loss += "".join(f"; {one.code}: {one.text}" for one in self.reasons)
        if self.verdict == "elastic":
            return f"elastic within {self.held_s:.3g} s{loss}"
        if self.verdict == "slipping":
            return f"slipping: {self.why}; the values of creep are unreliable"
        if self.kept is not None and self.kept_interval is not None and self.verdict == "plastic":
            loss = ", {:.0%} ({:.0%} to {:.0%}) of the dent is permanent".format(self.kept, *self.kept_interval) + loss
        least, most = self.share_interval
        if self.relaxed_n_per_mm is None or self.relaxed_interval is None:
            return f"{self.verdict}: at least {least:.0%} of the modulus relaxes{loss}"
        low, high = self.relaxed_interval
        relaxed = f"{self.relaxed_n_per_mm:.3g} N/mm ({low:.3g} to {high:.3g}) when relaxed"
        longer = " or more" if self.time_interval is not None and np.isinf(self.time_interval[1]) else ""
        share = f"{self.share:.0%} ({least:.0%} to {most:.0%}) of the modulus relaxes in {self.time_s:.2g} s{longer}"
        return f"{self.verdict}: {relaxed}, {share}{loss}"


def fit_creep(
    time_s: FloatArray,
    position_m: FloatArray,
    force_n: FloatArray,
    normal: FloatArray,
    *,
    loading: int,
    held: int,
    set_force_n: float = 3.0,
    arm: ArmCompliance | None = None,
    radius_m: float | None = None,
    clock_sd_s: float = 0.0,
    off_n: float = 0.0,
) -> CreepFit:
    """Fit the law to a touch that came down, held and, if it was recorded, went back.

    time_s (n,), position_m (n, 3), force_n (n, 3), normal (3,), set_force_n, arm: as in `contact.fit_approach`
    radius_m: radius of a ball, whose dents are not small relative to it; None: the law is a power law at all depths
    clock_sd_s: deviation of the force's times against the place's, which the energy loss is sensitive to
    off_n: deviation of a constant error of the force (an arm's own has one): it is in both stiffnesses, and cancels
    in the share and the time
    loading: how many samples lead up to the set force; held: how many were taken until the tip went back

    Raises InputError where the touch holds nothing to fit, as `fit_approach` does."""
    if not 0 < loading < held <= len(time_s):
        raise InputError("0 < loading < held <= samples", f"{loading}, {held} and {len(time_s)}")
    arm = arm or ArmCompliance()
    z_m, force = along_normal(time_s, position_m, force_n, normal)
    zeroed, force_sd, _, among = since_contact(force[:loading], set_force_n, None)
    force = force - (force[0] - zeroed[0])
    first = int(np.argmax(among))
    drift_n, drift_sd, drifted = _air_drift(time_s, z_m, force, first, held, force_sd, set_force_n)
    force = force - drift_n
    samples = CreepSamples.of(time_s, z_m, force, first, loading, held)
    exponent = (EXPONENT["sphere"] + LAYERED, LAYERED_SD) if radius_m else (EXPONENT["sphere"], EXPONENT_SD)
    draws = CreepLaw(samples, exponent, set_force_n, arm, force_sd, radius_m, drift_sd).posterior()
    held_s = float(time_s[held - 1] - time_s[loading - 1])
    seen = draws.seen(held_s)
    # without a reason, verdict and time are of what relaxes within the hold
    weight = draws.weight
    judged = weight * (seen.within if not seen.reasons else 1.0)
    offset = np.random.default_rng(1).standard_normal(len(weight))
    instant = 1e-3 * set_force_n / draws.depth_m * np.exp(off_n / set_force_n * offset)
    share = seen.share
    viscous = float(judged[share > ELASTIC_MOST].sum() / judged.sum())
    kept = _kept(draws, time_s, z_m, force, held, arm, force_sd)
    plane = np.linalg.svd((normal / np.linalg.norm(normal))[None])[2][1:]
    across_n, unloaded = force_n[:held] @ plane.T, force[:loading] < LOADED * force.max()
    if unloaded.any():
        across_n = across_n - np.median(across_n[:loading][unloaded], axis=0)
    few = draws.some(np.random.default_rng(0), KEPT_DRAWS)
    dent_m = few.dents(z_m[:held], force[:held], arm).mean(axis=0)
    slip = fit_slip(position_m[:held] @ plane.T, across_n, dent_m, force[:held], force_sd)
    plastic = None if kept is None else float((kept > KEPT_LEAST).mean())
    verdict, why = _verdict(viscous, plastic, slip)
    speed_m_s = float((z_m[loading - 1] - z_m[samples.first]) / (time_s[loading - 1] - time_s[samples.first]))
    other_speed = _at_reference(few, speed_m_s)
    some = draws.some(np.random.default_rng(0), FORCE_DRAWS)
    at = slice(loading - 1, loading)
    approach_s = float(some.dents(z_m[at], force[at], arm).mean()) / max(speed_m_s, 1e-6)
    nothing: tuple[None, None] = (None, None)
    stays, stays_interval = nothing if kept is None else median_and_interval(kept, np.ones(len(kept)))
    instant_median, instant_interval = median_and_interval(instant, weight)
    share_median, share_interval = seen.bounded(*median_and_interval(share, weight), 1.0)
    relaxation_s: float | None
    relaxation_interval: tuple[float, float] | None
    relaxation_s, relaxation_interval = seen.bounded(*draws.time(judged), float("inf"))
    if weight[draws.branches > 1].sum() > SEVERAL:
        instant_interval = instant_interval[0], float("inf")
        if seen.reasons:
            relaxation_s, relaxation_interval = None, None
    loss, loss_interval = cycle_loss(z_m, force, held, arm, force_sd, clock_sd_s / float(np.diff(time_s).mean()))
    return CreepFit(
        instant_n_per_mm=instant_median,
        instant_interval=instant_interval,
        **_relaxed(np.log(instant) - draws.log_deeper, weight, seen),
        share=share_median,
        share_interval=share_interval,
        time_s=relaxation_s,
        time_interval=relaxation_interval,
        loss=loss,
        loss_interval=loss_interval,
        held_s=held_s,
        speed_m_s=speed_m_s,
        verdict=verdict,
        why=why,
        reasons=(*seen.reasons, *drifted),
        force_kept=kept_of(some.strength, some.retarded_s, some.exponent, approach_s, held_s),
        short_record=seen.short_record,
        no_plateau=seen.no_plateau,
        viscous=viscous,
        plastic=plastic,
        slipping=slip.probability,
        kept=stays,
        kept_interval=stays_interval,
        slid_m=slip.slid_m,
        log_at_reference=float(other_speed.mean()),
        log_at_reference_sd=float(other_speed.std()),
    )


def drift_rate(
    time_s: FloatArray, force_n: FloatArray, before: IntArray, after: IntArray, noise_n: float
) -> tuple[float, float, float]:
    """Time between the free air before and after a touch [s], rate of the force from one to the other [N/s], and its
    deviation. before, after: numbers of the samples in air"""
    apart_s = float(time_s[after].mean()) - float(time_s[before].mean())
    rate = float(np.median(force_n[after]) - np.median(force_n[before])) / apart_s
    return apart_s, rate, 1.25 * noise_n * float(np.hypot(len(before) ** -0.5, len(after) ** -0.5)) / apart_s


def _air_drift(
    time_s: FloatArray, z_m: FloatArray, force_n: FloatArray, first: int, held: int, noise_n: float, set_force_n: float
) -> tuple[FloatArray, float, tuple[Doubt, ...]]:
    """Drift of the force (n,) since the air before contact [N], the deviation of its rate [N/s], and the reason if it
    is large: by the free air before and after the touch. first: first sample in contact; held: the way back begins"""
    clear_m = z_m[first] - AIR_OFF * (z_m[held - 1] - z_m[first])
    before, after = np.flatnonzero(z_m[:first] < clear_m), held + np.flatnonzero(z_m[held:] < clear_m)
    if min(len(before), len(after)) < AIR:
        return np.zeros_like(force_n), DRIFT_N_PER_S, ()
    began_s = float(time_s[before].mean())
    apart_s, rate, rate_sd = drift_rate(time_s, force_n, before, after, noise_n)
    text = (
        f"the force drifted by {rate:+.2g} N/s from the free air before the touch to that after it, which is taken off"
    )
    named = abs(rate) * apart_s > NAMED * set_force_n and abs(rate) > 4.0 * rate_sd
    drifted = (Doubt("force-drift", text),) if named else ()
    return rate * (time_s - began_s), max(rate_sd, UNEVEN * abs(rate)), drifted


def _relaxed(log: FloatArray, weight: FloatArray, seen: RelaxationSeen) -> dict[str, Any]:
    """The relaxed stiffness as fields of a fit, from its log (d,) [N/mm] in draws with weights (d,)."""
    names = ("relaxed_n_per_mm", "relaxed_interval", "relaxed_log_sd")
    if seen.reasons:
        return dict.fromkeys(names)
    log_sd = float(np.sqrt(np.average((log - np.average(log, weights=weight)) ** 2, weights=weight)))
    middle, (low, high) = median_and_interval(log, weight)
    interval = 0.0 if seen.open else float(np.exp(low)), float(np.exp(high))
    return dict(zip(names, (float(np.exp(middle)), interval, log_sd), strict=True))


def _at_reference(some: CreepDraws, speed_m_s: float) -> FloatArray:
    """(d,) draws of the log ratio of the stiffness at the reference speed to that at this one: the branches' shares of
    the force while it rises as the p-th power of time."""
    gone = (np.arange(RAMP_STEPS) + 0.5) / RAMP_STEPS  # share of the way down

    def log_softer(speed: float) -> FloatArray:
        ramp_s = (some.depth_m / max(speed, 1e-6))[:, None, None]
        force = gone ** some.exponent[:, None, None]
        # by parts: what has not come through yet of each step of the force
        late = np.exp(-(1.0 - gone) * ramp_s / some.retarded_s[..., None])
        follows = 1.0 - (late * np.gradient(force, gone, axis=-1)).mean(axis=-1)
        return np.asarray(np.log1p((some.strength * follows.clip(0.0, 1.0)).sum(axis=1)) / some.exponent)

    return log_softer(speed_m_s) - log_softer(REFERENCE_SPEED_M_S)


def _verdict(viscous: float, plastic: float | None, slip: SlipFit) -> tuple[CreepBehaviour, str]:
    """The verdict of a touch, and its reason."""
    if slip.probability > SURE:
        where = f"once the force across was {slip.friction:.2g} of the force"
        return "slipping", f"the tip slid {1e3 * slip.slid_m:.1f} mm {where}"
    if plastic is not None and plastic > SURE:
        return "plastic", "the tip retracted further than relaxation explains"
    if viscous > SURE:
        return "viscous", f"more than {ELASTIC_MOST:.0%} of the modulus relaxes"
    if viscous < 1.0 - SURE:
        return "elastic", f"less than {ELASTIC_MOST:.0%} of the modulus relaxes"
    return "unidentified", f"whether {ELASTIC_MOST:.0%} of the modulus relaxes is not identified"


def _kept(
    draws: CreepDraws,
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
    found = permanent_share(time_s, dent_m, force_n, held, some.exponent, share, relaxation_s, arm, force_sd_n)
    if found is None:
        return None
    kept, sd = found
    return np.asarray(kept[:, None] + sd[:, None] * random.standard_normal((len(kept), KEPT_DRAWS))).ravel()


def cycle_loss(
    z_m: FloatArray, force_n: FloatArray, held: int, arm: ArmCompliance, force_sd_n: float, clock_sd: float = 0.0
) -> tuple[float | None, tuple[float, float] | None]:
    """Share of the energy of the way in and of the hold that the way out did not give back, and its 90 % interval.

    z_m, force_n: (n,) z and force of a whole touch along the normal, zero of the force taken off; held: samples until
    the way back; clock_sd: deviation of the force's times against the place's, in samples. None if the force did not
    return to 0. Energy stored in the arm is no work on the foam."""
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


LEAST_BACK, MOST_BACK = 0.05, 0.6
"""Shares of the peak between which the way back is fitted."""
FEWEST_BACK = 4
LAW_LEFT, LAW_LEFT_SD = -0.013, 0.02
"""Apparent permanent share of elastic foam, and its deviation, due to the law: F^(1/p) is no straight line, and the
table bends the law (50 touches of finite elements, seeds reserved for choosing)."""


def permanent_share(
    time_s: FloatArray,
    dent_m: FloatArray,
    force_n: FloatArray,
    held: int,
    exponent: FloatArray,
    share: FloatArray,
    relaxation_s: FloatArray,
    arm: ArmCompliance,
    force_sd_n: float,
) -> tuple[FloatArray, FloatArray] | None:
    """(d,) share of the dent that stays, beyond relaxation, and its deviation, of laws that are drawn; None where the
    way back was not recorded.

    A ball that goes back leaves a viscoelastic foam where H(t) = integral of E(t - s) d'(s) ds = 0 (Ting 1966), its
    dent d being shallower by the relaxed part. While force is left, F^(1/p) is about linear in H; the line through the
    retract, extrapolated to F = 0, gives the H of the release. For foam with a permanent share s of every dent it is s
    times the part of the approach in H; for all other foam it is 0.

    time_s, force_n: (n,) times and force of a whole touch; dent_m: (d, n), 0 before contact; held: samples until the
    way back; exponent: (d,); share, relaxation_s: (d, b) share and relaxation of the modulus that relaxes"""
    peak = float(force_n[:held].max())
    lost = np.flatnonzero(force_n[held:] < LEAST_BACK * peak)
    if not len(lost):
        return None
    back = np.arange(held, held + int(lost[0]) + 1)
    back = back[force_n[back] < MOST_BACK * peak]
    if len(back) < FEWEST_BACK:
        return None
    moved_m, middle_s = np.diff(dent_m, axis=1), 0.5 * (time_s[1:] + time_s[:-1])
    gone_s = time_s[back, None] - middle_s
    left = np.zeros((len(dent_m), *gone_s.shape))
    left += (1.0 - share.sum(axis=1))[:, None, None]
    for one, relaxed_s in zip(share.T, relaxation_s.T, strict=True):
        left += one[:, None, None] * np.exp(-np.maximum(gone_s, 0.0) / relaxed_s[:, None, None])
    each = np.where(gone_s > 0.0, left, 0.0) * moved_m[:, None]
    whole, way_in = each.sum(axis=2), each[:, :, : held - 1].sum(axis=2)
    rooted = np.maximum(force_n[back] / peak, 0.0) ** (1.0 / exponent[:, None])
    # H over F^(1/p): places scatter, forces hardly
    middle, spread = rooted.mean(axis=1, keepdims=True), whole.mean(axis=1)
    slope = ((rooted - middle) * whole).sum(axis=1) / ((rooted - middle) ** 2).sum(axis=1)
    at_none = spread - slope * middle[:, 0]
    lever = 1.0 / len(back) + middle[:, 0] ** 2 / ((rooted - middle) ** 2).sum(axis=1)
    scatter_m = np.hypot(arm.position_sd_m, slope * force_sd_n / peak)
    put_in = way_in.mean(axis=1)
    return at_none / put_in - LAW_LEFT, np.hypot(scatter_m * np.sqrt(lever) / put_in, LAW_LEFT_SD)
