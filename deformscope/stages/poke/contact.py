"""Stiffness of a place, from the approach of a tip itself: force and arm, no camera.

Pressed by a tip, F = k (z - z0)^p, with p about 1.5 for a sphere and 1 for a flat tip. Taking the first force above a
threshold as contact puts z0 too deep and the stiffness 15 to 20 % too high; here z0 is fitted. The arm's deflection
under the force is subtracted, as calibrated on a rigid block."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, cast

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.stages.regions.touches import LAW_SD

TipKind = Literal["sphere", "disc", "flat", "cone"]

EXPONENT: dict[TipKind, float] = {"sphere": 1.5, "disc": 1.0, "flat": 1.0, "cone": 2.0}
"""Hertz (1882) and Sneddon (1965), of a half-space."""

DentLaw = Callable[[FloatArray, float, float], FloatArray]
"""Dents (n,) at shares (n,) of the set force, of the dent at that force and the exponent p."""

EXPONENT_SD = 0.08
"""Layers, large strain and foams that are not linear move the exponent by about this."""

LOADED = 0.05
"""Share of the reference force from which samples are fitted: below, force noise hides the law."""

LEAST_SAMPLES = 6
Z_90 = 1.6449
RIGID_SDS = 3.0
DOME_SDS = 3.0
RATE_SAMPLES = 10
"""Time over which a rate of the force is measured: at 100 Hz a tenth of a second, of the half second or more of an
approach."""
LAW_STEPS = 400
"""Forces at which a fitted law is taken, from none to twice the largest."""


@dataclass(frozen=True, slots=True)
class ArmCompliance:
    """Compliance of the arm along the normal.

    compliance_m_per_n: tip behind where the arm says it is, for each newton; compliance_sd: its deviation [m/N];
    position_sd_m: scatter of the arm's position about it [m]; dome: dome of the tip itself, its dent under a rigid
    block at 1 N, which grows with the power 2/3 of the force [m/N^(2/3)]: reported, not subtracted from other dents"""

    compliance_m_per_n: float = 0.0
    compliance_sd: float = 0.0
    position_sd_m: float = 1e-4
    dome: float = 0.0

    def depth_sd_m(self, force_n: float) -> float:
        """Uncertainty of a depth under a force [m]."""
        return float(np.hypot(self.compliance_sd * force_n, self.position_sd_m))


@dataclass(frozen=True, slots=True)
class ContactFit:
    """Measurement of an approach at the place.

    stiffness_n_per_mm: force over depth at `at_force_n` (apparent stiffness), with its 90 % `interval_n_per_mm`; of a
    `rigid` place a lower bound, whose interval is open above; log_stiffness, log_sd: its natural log and standard
    deviation. `log_sd` combines `own_log_sd`, the error of this touch alone, with errors that all touches of a session
    share: `arm_log_sd`, for one deviation of the arm's compliance, and the gain of the force
    at_force_n: the set force; if the approach ended before it, the law is extrapolated, so that all touches compare;
    depth_m: depth of the dent at `at_force_n`; contact_m, contact_sd_m: where contact began, on the axis of the
    approach, which grows into the surface; exponent, exponent_sd: p, and exponent_related: covariance of the errors of
    p and log_stiffness; peak_force_n: along the normal, tare taken off
    samples: number of samples that were fitted; peak_rate_n_per_s, peak_rate_interval_n_per_s: as in `peak_rate`"""

    stiffness_n_per_mm: float
    interval_n_per_mm: tuple[float, float]
    log_stiffness: float
    log_sd: float
    own_log_sd: float
    arm_log_sd: float
    rigid: bool
    at_force_n: float
    depth_m: float
    depth_sd_m: float
    contact_m: float
    contact_sd_m: float
    exponent: float
    exponent_sd: float
    exponent_related: float
    peak_force_n: float
    samples: int
    peak_rate_n_per_s: float | None
    peak_rate_interval_n_per_s: tuple[float, float] | None

    def dent_m(self, force_n: float) -> float:
        """Depth of the dent at a force, by the law [m]."""
        return float(self.depth_m * (force_n / self.at_force_n) ** (1.0 / self.exponent))


def power_law(share: FloatArray, depth: float, exponent: float) -> FloatArray:
    """F = k d^p, as a `DentLaw`: the law of a half-space."""
    return depth * share ** (1.0 / max(exponent, 0.2))


def fit_approach(
    time_s: FloatArray,
    position_m: FloatArray,
    force_n: FloatArray,
    normal: FloatArray,
    *,
    tip: TipKind = "sphere",
    set_force_n: float = 3.0,
    arm: ArmCompliance | None = None,
    force_sd_n: float | None = None,
    exponent_sd: float = EXPONENT_SD,
    least_share: float = LOADED,
    gain_sd: float = 0.0,
    off_n: float = 0.0,
    dents: DentLaw = power_law,
) -> ContactFit:
    """Fit the law to an approach, from before contact to the peak of the force; later samples are left out.

    time_s: (n,) rising [s]; position_m: (n, 3) position of the tip as the arm says [m]; force_n: (n, 3) force on the
    tip [N], all in one frame; normal: (3,) outward normal of the surface; tip: its shape, which gives the prior mean of
    p; set_force_n: force at which the stiffness is taken. If the approach ended before that force, for example by its
    depth, the law is extrapolated and less certain
    arm: how the arm yields, from `calibrate_compliance`; default a stiff arm that scatters by 0.1 mm; force_sd_n: noise
    of the force, default as it scatters before contact; exponent_sd: deviation of the prior of p; least_share: share of
    the set force, from which samples are fitted; gain_sd: deviation of log stiffness by the force sensor's gain; off_n:
    deviation of this touch's force, besides its noise [N]; dents: the law, as `TipLaw.dents`

    The position is fitted as a function of the force, because the arm's scatter dominates: z = z0 + d (F / F0)^(1/p) +
    c F, least squares with a soft loss and a Gaussian prior on p."""
    arm = arm or ArmCompliance()
    depth_along, force = along_normal(time_s, position_m, force_n, normal)
    if set_force_n <= 0.0:
        raise InputError("a set force above 0 N", f"{set_force_n}")
    force, noise, peak, loaded = since_contact(force, set_force_n, force_sd_n, least_share)
    at_force = set_force_n
    z = depth_along[loaded] - arm.compliance_m_per_n * force[loaded]
    share = np.maximum(force[loaded], 0.0) / at_force
    prior, start_sd = EXPONENT[tip], max(arm.position_sd_m, 1e-6)
    x = share ** (1.0 / prior)
    depth = float(((x - x.mean()) * (z - z.mean())).sum() / max(((x - x.mean()) ** 2).sum(), 1e-18))
    z0 = float(z.mean() - depth * x.mean())
    # how far the noise of the force moves a sample along the law
    steep = depth / prior * np.maximum(share, least_share) ** (1.0 / prior - 1.0) - arm.compliance_m_per_n * at_force
    sample_sd = np.hypot(start_sd, steep * noise / at_force)

    def residuals(parameters: FloatArray) -> FloatArray:
        z0, depth, p = parameters
        law = z0 + dents(share, depth, p)
        return cast(FloatArray, np.append((z - law) / sample_sd, (p - prior) / exponent_sd))

    found = scipy.optimize.least_squares(
        residuals, [z0, depth, prior], x_scale=[1e-3, 1e-3, 0.1], loss="soft_l1", f_scale=2.0, method="trf"
    )
    z0, depth, p = (float(value) for value in found.x)
    # the arm may scatter more than stated
    inflation = max(1.0, float(np.median(np.abs(residuals(found.x)[:-1]))) / 0.6745)
    jacobian = found.jac.copy()
    jacobian[:-1] /= inflation
    cov = np.linalg.pinv(jacobian.T @ jacobian)
    # compliance that is off moves the depth by as much as the force times it; it is the same in every touch
    own_depth_sd, bent_m = float(np.sqrt(cov[1, 1])), arm.compliance_sd * at_force
    depth_sd = float(np.hypot(own_depth_sd, bent_m))
    arm_sd = arm.depth_sd_m(at_force)
    if depth < RIGID_SDS * arm_sd:
        bound = 1e-3 * at_force / (RIGID_SDS * arm_sd)
        stiffness, interval, log_sd, rigid = bound, (bound, np.inf), max(depth_sd, arm_sd) / (RIGID_SDS * arm_sd), True
        own_log_sd, arm_log_sd = log_sd, 0.0
    else:
        stiffness, rigid = 1e-3 * at_force / depth, False
        # the exponent beyond the peak may be another
        beyond = min(exponent_sd, EXPONENT_SD) * float(np.log(max(at_force / peak, 1.0))) / p**2
        own_log_sd = float(np.linalg.norm([own_depth_sd / depth, LAW_SD, beyond, off_n / at_force]))
        arm_log_sd = bent_m / depth
        log_sd = float(np.linalg.norm([own_log_sd, arm_log_sd, gain_sd]))
        interval = (stiffness * float(np.exp(-Z_90 * log_sd)), stiffness * float(np.exp(Z_90 * log_sd)))
    rate, rate_interval = peak_rate(time_s[loaded], force[loaded], noise)
    return ContactFit(
        stiffness_n_per_mm=stiffness,
        interval_n_per_mm=interval,
        log_stiffness=float(np.log(stiffness)),
        log_sd=log_sd,
        own_log_sd=own_log_sd,
        arm_log_sd=arm_log_sd,
        rigid=rigid,
        at_force_n=at_force,
        depth_m=depth,
        depth_sd_m=depth_sd,
        contact_m=z0,
        contact_sd_m=float(np.sqrt(cov[0, 0])),
        exponent=p,
        exponent_sd=float(np.sqrt(cov[2, 2])),
        exponent_related=-float(cov[1, 2]) / depth,
        peak_force_n=peak,
        samples=int(loaded.sum()),
        peak_rate_n_per_s=rate,
        peak_rate_interval_n_per_s=rate_interval,
    )


def peak_rate(
    time_s: FloatArray, force_n: FloatArray, force_sd_n: float
) -> tuple[float, tuple[float, float]] | tuple[None, None]:
    """The largest rate at which a force (n,) rose [N/s] and its 90 % interval. None with fewer than RATE_SAMPLES
    samples, or if no such sequence of them lasts: times that repeat, as after a stall, give no rate.

    A rate is the slope of a straight line through RATE_SAMPLES successive samples, by least squares (the first
    derivative of Savitzky and Golay 1964). If the force bends, the rate is the mean over these samples. The steepest of
    many noisy slopes is too steep, so samples are split (Cox 1975, Biometrika 62, 441). Every other sample determines
    the time of the fastest rise, and the samples between them the rate at that time. Their noise, each with deviation
    `force_sd_n`, is assumed to be independent."""
    if len(time_s) < RATE_SAMPLES:
        return None, None
    windows = np.lib.stride_tricks.sliding_window_view(np.stack([time_s, force_n]), RATE_SAMPLES, axis=1)[:, ::2]
    lasts = (np.ptp(windows[0, :, ::2], axis=1) > 0.0) & (np.ptp(windows[0, :, 1::2], axis=1) > 0.0)
    if not lasts.any():
        return None, None
    windows = windows[:, lasts]

    def slopes(samples: slice) -> tuple[FloatArray, FloatArray]:
        time, force = windows[0, :, samples], windows[1, :, samples]
        off_s = time - time.mean(axis=1, keepdims=True)
        square = (off_s**2).sum(axis=1)
        return (off_s * force).sum(axis=1) / square, force_sd_n / np.sqrt(square)

    steepest = int(np.argmax(slopes(slice(0, None, 2))[0]))
    rate, sd = (float(one[steepest]) for one in slopes(slice(1, None, 2)))
    return rate, (rate - Z_90 * sd, rate + Z_90 * sd)


def fitted_law(fit: ContactFit, arm: ArmCompliance, along_m: FloatArray) -> FloatArray:
    """(n,) force of the fitted law where the arm says that the tip is, along its way into the surface (n,) [N]."""
    forces = np.linspace(0.0, 2.0 * max(fit.peak_force_n, fit.at_force_n), LAW_STEPS)
    dent = max(fit.depth_m, 1e-9) * (forces / fit.at_force_n) ** (1.0 / fit.exponent)
    return np.asarray(np.interp(along_m, fit.contact_m + dent + arm.compliance_m_per_n * forces, forces))


def calibrate_compliance(
    time_s: FloatArray, position_m: FloatArray, force_n: FloatArray, normal: FloatArray, *, set_force_n: float = 3.0
) -> ArmCompliance:
    """Compliance of the arm, from an approach to a rigid block. Arguments as in `fit_approach`: (n,) [s], (n, 3) [m],
    (n, 3) [N], (3,).

    z = z0 + c F + d F^(2/3): the compliance of a force sensor's rubber dome (Hertz 1882) is not the arm's, if it is
    DOME_SDS of its deviations or more."""
    depth_along, force = along_normal(time_s, position_m, force_n, normal)
    force, _, _, loaded = since_contact(force, set_force_n, None)
    z, f = depth_along[loaded], force[loaded]
    line = np.column_stack([np.ones_like(f), f])
    (_, slope), (_, slope_sd), scale = _huber(line, z)
    domed = np.column_stack([line, np.maximum(f, 0.0) ** (1.0 / EXPONENT["sphere"])])
    (_, bent, dome), (_, bent_sd, dome_sd), dome_scale = _huber(domed, z)
    if dome > DOME_SDS * dome_sd and bent > -DOME_SDS * bent_sd:
        return ArmCompliance(max(bent, 0.0), bent_sd, dome_scale, dome)
    return ArmCompliance(slope, slope_sd, scale)


def _huber(design: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Coefficients (k,) of z (n,) over a design (n, k), their deviations (k,), and the scatter: Huber's weights, as far
    as they settle."""
    found: FloatArray = np.zeros(design.shape[1])
    weight, scale = np.ones_like(z), 1e-9
    for _ in range(10):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(design * root[:, None], z * root, rcond=None)[0]
        off = np.abs(z - design @ found)
        scale = max(float(np.median(off)) / 0.6745, 1e-9)
        weight = np.minimum(1.0, 1.5 * scale / np.maximum(off, 1e-12))
    cov = np.linalg.pinv(design.T @ (weight[:, None] * design))
    return found, scale * np.sqrt(np.diag(cov)), scale


def layer_modulus(
    depth_m: float, force_n: float, *, radius_m: float = 0.01, thickness_m: float = 0.05, poisson: float = 0.3
) -> float:
    """Young's modulus [Pa] of a layer bonded to a rigid table, from one depth and force of a sphere.

    Hertz with the series for a layer in chi = sqrt(R d) / h (Dimitriadis et al. 2002, eq. 12; the fourth order is below
    1e-3 here). Linear theory: for dents deeper than a third of the radius a comparison between foams rather than a
    modulus."""
    if min(depth_m, force_n, radius_m, thickness_m) <= 0.0 or not -1.0 < poisson <= 0.5:
        raise InputError("depth, force, radius and thickness above 0, Poisson's ratio in (-1, 0.5]", "others")
    hertz = 4.0 / 3.0 / (1.0 - poisson**2) * np.sqrt(radius_m) * depth_m**1.5
    chi = np.sqrt(radius_m * depth_m) / thickness_m
    alpha = -(1.2876 - 1.4678 * poisson + 1.3442 * poisson**2) / (1.0 - poisson)
    beta = (0.6387 - 1.0277 * poisson + 1.5164 * poisson**2) / (1.0 - poisson)
    third = 8.0 / np.pi**3 * (alpha**3 + 4.0 * np.pi**2 / 15.0 * beta)
    correction = 1.0 - 2.0 * alpha / np.pi * chi + 4.0 * alpha**2 / np.pi**2 * chi**2 - third * chi**3
    return float(force_n / (hertz * correction))


def along_normal(
    time_s: FloatArray, position_m: FloatArray, force_n: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n,) displacement into the surface [m] and force out of it [N]."""
    count = len(time_s)
    if position_m.shape != (count, 3) or force_n.shape != (count, 3) or np.shape(normal) != (3,):
        raise InputError(f"{count} positions and forces (n, 3)", f"{position_m.shape} and {force_n.shape}")
    if not (np.isfinite(time_s).all() and np.isfinite(position_m).all() and np.isfinite(force_n).all()):
        raise InputError("finite times, positions and forces", "NaN or infinity", "leave such samples out")
    if (np.diff(time_s) <= 0.0).any():
        raise InputError("times that rise", "some that do not")
    length = float(np.linalg.norm(normal))
    if not length > 0.0:
        raise InputError("a normal that is not zero", f"{normal}")
    return -(position_m @ normal) / length, force_n @ normal / length


def since_contact(
    force: FloatArray, set_force_n: float, force_sd_n: float | None, least_share: float = LOADED
) -> tuple[FloatArray, float, float, BoolArray]:
    """Force (n,) without its offset, its noise, its peak, and the samples (n,) from contact to the peak.

    Samples are selected by time, from the last one below a small force on, not by their own force, which would favour
    those with positive noise."""
    smooth = np.convolve(np.pad(force, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    rising = smooth - np.median(smooth[: max(5, len(force) // 20)])
    free = np.arange(len(force)) < np.argmax(rising > max(0.02 * rising.max(), 3.0 * (force_sd_n or 0.0)))
    free[:5] = True
    offset = float(np.median(force[free]))
    measured = float(np.median(np.abs(force[free] - offset))) / 0.6745
    noise = force_sd_n if force_sd_n is not None else max(measured, 1e-3)
    force = force - offset
    about = max(int(np.argmax(smooth)) - 3, 0)
    peak_at = about + int(np.argmax(force[about : about + 7]))  # a mean over time lags behind a steep rise
    peak = float(force[peak_at])
    if peak < 10.0 * noise:
        came, try_this = f"{peak:.2g} N along the normal", "press harder, or check the normal's sign"
        raise InputError(f"a force well above its noise of {noise:.2g} N", came, try_this)
    least = max(least_share * min(peak, set_force_n), 3.0 * noise)
    below = np.flatnonzero(smooth[:peak_at] - offset < least)
    loaded = np.zeros(len(force), dtype=bool)
    loaded[below[-1] + 1 if len(below) else 0 : peak_at + 1] = True
    if loaded.sum() < LEAST_SAMPLES:
        wanted = f"{LEAST_SAMPLES} samples or more between contact and the peak"
        raise InputError(wanted, f"{loaded.sum()}", "approach more slowly")
    return force, noise, peak, loaded


# Effect of a stiffness that changes with the force on the law that is fitted to a touch:
#
# to_log, to_exponent = law_response()
# log, exponent = to_log @ shifts, to_exponent @ shifts        # shifts (3,) of log stiffness under CONTACTS
#
# The wider the contact has grown, the larger is the effect of an inclusion below the surface, or of a near edge. Their
# effect on log stiffness grows with the force, and so does the exponent of F = k (z - z0)^p. A foam whose modulus
# varies from place to place has the same exponent everywhere. To first order, of samples that are even in depth

CONTACTS = (0.3, 0.65, 1.0)
"""Radii of the contact over that at the set force (Hertz: proportional to F^(1/3)), between which shifts are computed
parabolas: samples from the least force that is fitted."""
LEAST_SHARE = 0.02
"""Share of the set force from which a free exponent is fitted: 0.1 N of 5 are five times the sensors' noise. The
exponent is then known to 0.026, from 0.05 on to 0.034."""
SAMPLES = 400


@lru_cache(maxsize=1)
def law_response() -> tuple[FloatArray, FloatArray]:
    """(3,) weights of shifts of log stiffness under `CONTACTS` in the log stiffness at the set force that is fitted
    with a given exponent, and (3,) in the fitted exponent if it is free."""
    exponent = EXPONENT["sphere"]
    depth = np.linspace(LEAST_SHARE ** (1.0 / exponent), 1.0, SAMPLES)
    contact = depth ** (exponent / 3.0)
    others = [(one, np.delete(CONTACTS, number)) for number, one in enumerate(CONTACTS)]
    between = np.column_stack([np.prod((contact[:, None] - rest) / (one - rest), axis=1) for one, rest in others])
    moved = -depth[:, None] * between
    law = np.column_stack([np.ones_like(depth), depth, -depth * np.log(depth) / exponent])
    return -np.linalg.lstsq(law[:, :2], moved)[0][1], np.linalg.lstsq(law, moved)[0][2]
