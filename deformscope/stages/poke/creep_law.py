"""The law by which a foam creeps under a ball, fitted to one touch: its parameters as weighted draws (`creep`).

Each branch of the creep compliance is a low-pass filter of the force (`stages.fit.creep_spectra`); the law's error is a
Gaussian process over the log of the force. A force sensor that drifts moves the place in proportion to time.

For every choice of nodes of the log times the most probable parameters are found, all choices in one pass (Levenberg
1944, Marquardt 1963), with their evidence (Laplace). Draws about them are weighted by the posterior, which averages
over the choices, the numbers of branches and their times."""

from dataclasses import dataclass, fields

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import FloatArray
from deformscope.stages.fit.creep_spectra import LARGEST_LOG, Spectrum, spectra
from deformscope.stages.fit.relaxation import DrawnModel, RelaxationDraws, relaxation_posterior
from deformscope.stages.gaussian_process import correlation
from deformscope.stages.poke.contact import LOADED, ArmCompliance

MOST_BRANCHES = 3
HOLD_SAMPLES = 60
"""Fitted samples of the hold, evenly in the log of time: more are averaged."""
LEAST_EXPONENT, LEAST_SHARE = 0.2, 1e-4
BEND_SD = 0.003
"""Deviation of q: log depth goes by log force over p plus q times its square, 0 at the set force. Finite elements of a
ball of 2 cm on 2 to 8 cm of bonded foam, Poisson's ratio .05 to .4, at 1 and 3 N: -.009 to .006."""
LAW_OFF, LAW_RISE, LAW_LENGTH = 0.004, 0.4, 0.3
"""Error of that law in the log dent: a Gaussian process over log force, 0 at the set force. It has this deviation
there, more below it (a power of the force), and this length. Elements that come into contact one after another make
waves of 0.2 to 1 % (24 slabs as above, seeds reserved for choosing). Foam itself is no better."""
DRIFT_N_PER_S = 0.002
"""Deviation of a force sensor's drift where no free air after the touch shows it: that of one that warms up."""
BALL_STEPS = 400
SHAPE = 5
"""Parameters of the law without a memory."""
LOG_TIMES, TIMES = (np.log(0.002), np.log(4000.0)), 100
"""Retardation times for which the filters are computed; between them they are interpolated."""


@dataclass(frozen=True, slots=True)
class CreepSamples:
    """time_s, z_m, force_n: (m,) samples from the first to the end of the hold, which is averaged; count: (m,) number
    of readings averaged in each; first: index of the first fitted one; loading: up to which they lead to the set
    force"""

    time_s: FloatArray
    z_m: FloatArray
    force_n: FloatArray
    count: FloatArray
    first: int
    loading: int

    @classmethod
    def of(
        cls, time_s: FloatArray, z_m: FloatArray, force_n: FloatArray, first: int, loading: int, held: int
    ) -> "CreepSamples":
        later = np.geomspace(1.0, max(held - loading, 1), HOLD_SAMPLES).round().astype(int)
        ends = np.unique([*range(1, loading + 1), *(loading + later)])
        starts = np.append(0, ends[:-1])
        count = (ends - starts).astype(float)
        time, z, force = (np.add.reduceat(one[:held], starts) / count for one in (time_s, z_m, force_n))
        return cls(time_s=time, z_m=z, force_n=force, count=count, first=first, loading=loading)


@dataclass(frozen=True, slots=True)
class CreepDraws(RelaxationDraws):
    """Weighted draws of a touch: z0, D0 [m], log of the relaxed dent over D0, p, deviations of the arm's compliance,
    all (d,)"""

    start_m: FloatArray
    depth_m: FloatArray
    log_deeper: FloatArray
    exponent: FloatArray
    bent: FloatArray

    def dents(self, z_m: FloatArray, force_n: FloatArray, arm: ArmCompliance) -> FloatArray:
        """(d, n) of places and forces (n,) [m]."""
        gives = arm.compliance_m_per_n + arm.compliance_sd * self.bent[:, None]
        return np.asarray(np.maximum(z_m - self.start_m[:, None] - gives * force_n, 0.0))


class CreepLaw:
    """The law over one touch; parameters (5 + k,): z0 [mm], log D0 (of a ball: of the dent of a paraboloid), p, the
    law's bend q, the arm's compliance in deviations from its calibrated value, then those of the spectrum.

    The law's errors at neighbouring forces are correlated, in the hold as on the approach. Residuals are whitened by
    the covariance of these errors, of a drift, and of the samples' own scatter."""

    def __init__(
        self,
        samples: CreepSamples,
        exponent: tuple[float, float],
        set_force_n: float,
        arm: ArmCompliance,
        force_sd_n: float,
        radius_m: float | None,
        drift_sd_n_per_s: float = DRIFT_N_PER_S,
    ) -> None:
        self._ball = _ball(radius_m) if radius_m else None
        fitted = slice(samples.first, None)
        force = np.maximum(samples.force_n, 0.0) / set_force_n
        self._share = force[fitted]
        log_s = np.linspace(*LOG_TIMES, TIMES)
        behind = scipy.interpolate.CubicSpline(log_s, _lagging(samples.time_s, force, np.exp(log_s))[:, fitted])
        self._filtered = lambda at, order: behind(np.clip(at, *LOG_TIMES), order)
        self._z = samples.z_m[fitted] - arm.compliance_m_per_n * samples.force_n[fitted]
        self._bent_m = arm.compliance_sd * set_force_n * self._share
        root = np.sqrt(samples.count[fitted])
        share = np.maximum(self._share, LOADED)
        design = np.column_stack([np.ones_like(self._z), share ** (1.0 / exponent[0])])
        (z0, depth_m), *_ = np.linalg.lstsq(design, self._z, rcond=None)
        self._start = np.array([1e3 * z0, np.log(max(depth_m, 1e-5)), exponent[0], 0.0, 0.0])
        self._spread = np.array([np.inf, np.inf, exponent[1], BEND_SD, 1.0])
        slope_m = depth_m / exponent[0] * share ** (1.0 / exponent[0] - 1.0)
        sd = np.hypot(max(arm.position_sd_m, 1e-6), slope_m * force_sd_n / set_force_n) / root
        begins_s, loaded_s, ends_s = samples.time_s[[samples.first, samples.loading - 1, -1]]
        self._spectra = spectra(max(loaded_s - begins_s, 1e-2), max(ends_s - loaded_s, 1e-2), MOST_BRANCHES)
        self._whitens = np.diag(1.0 / np.hypot(sd, LAW_OFF * depth_m))
        one = self._fitted(self._spectra[1]).likeliest()
        self._log_force, self._dent_m = (each[0] for each in self._dents(one, self._spectra[1])[:2])
        drift_m = drift_sd_n_per_s * (samples.time_s[fitted] - begins_s) * slope_m / set_force_n
        self._off_m2 = self._dent_m * _off_together(self._log_force, self._log_force) * self._dent_m[:, None]
        self._off_m2 += drift_m * drift_m[:, None]
        self._whitens = _whitening(sd, self._off_m2)
        # the arm may scatter more than stated
        two = self._fitted(self._spectra[2]).likeliest()
        scatter = self._off(two, self._spectra[2])
        self._whitens = _whitening(sd * max(1.0, float(np.sqrt(np.mean(scatter**2)))), self._off_m2)

    def posterior(self) -> CreepDraws:
        """Weighted draws of the parameters, of all spectra."""
        random = np.random.default_rng(0)
        drawn, found = relaxation_posterior([(one, self._fitted(one)) for one in self._spectra], random)
        own = [self._own(*pair, random) for pair in zip(self._spectra, drawn, strict=True)]
        common = [getattr(found, one.name) for one in fields(found)]
        return CreepDraws(*common, *np.concatenate(own, axis=1))

    def _own(self, spectrum: Spectrum, drawn: FloatArray, random: np.random.Generator) -> FloatArray:
        """(5, d) the fields of `CreepDraws` alone, from parameters (d, k) of one spectrum."""
        log_force = np.log1p(spectrum.filters(drawn[:, SHAPE:])[0].sum(axis=1))
        log_depth = self._log_dent(drawn, np.zeros(len(drawn)))
        # the law's error at that force, given its errors in the samples
        shared = (_off_together(log_force, self._log_force) * self._dent_m) @ self._whitens.T
        mean = (shared * self._off(drawn, spectrum)).sum(axis=1)
        high = np.exp(-LAW_RISE * log_force)  # the diagonal of `_off_together`
        variance = LAW_OFF**2 * (1.0 + high**2 - 2.0 * high * correlation("gaussian", log_force / LAW_LENGTH))
        variance -= (shared**2).sum(axis=1)
        law_off = mean + np.sqrt(np.maximum(variance, 0.0)) * random.standard_normal(len(log_force))
        log_deeper = self._log_dent(drawn, log_force) - log_depth + law_off
        deeper = log_deeper if spectrum.most else np.zeros(len(drawn))
        exponent, dent_m = np.maximum(drawn[:, 2], LEAST_EXPONENT), np.maximum(np.exp(log_depth), 1e-6)
        return np.stack([1e-3 * drawn[:, 0], dent_m, deeper, exponent, drawn[:, 4]])

    def _fitted(self, spectrum: Spectrum) -> DrawnModel:
        """One spectrum with all choices of its nodes, as it is fitted."""
        mean, spread = spectrum.priors()
        shape = np.broadcast_to(self._start, (len(mean), SHAPE))
        return DrawnModel(
            np.hstack([shape, mean]),
            np.append(self._spread, spread),
            spectrum.prior,
            lambda some: self._off(some, spectrum),
            lambda some: self._jacobian(some, spectrum),
        )

    def _off(self, parameters: FloatArray, spectrum: Spectrum) -> FloatArray:
        """(d, m) how far the samples are from the law, whitened."""
        dent_m = self._dents(parameters, spectrum)[1]
        away = self._z - 1e-3 * parameters[:, :1] - dent_m - parameters[:, 4:5] * self._bent_m
        return np.asarray(away @ self._whitens.T)

    def _jacobian(self, parameters: FloatArray, spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
        """(d, m) of `_off`, and its derivatives (d, k, m)."""
        log_force, dent_m, added = self._dents(parameters, spectrum)
        _, _, exponent, bend = (one[:, None] for one in parameters.T[: SHAPE - 1])
        by_log = dent_m
        if self._ball is not None:  # by its slopes, in the middle between its values
            paraboloid, ball = self._ball
            middle, slope = 0.5 * (paraboloid[1:] + paraboloid[:-1]), np.diff(ball) / np.diff(paraboloid)
            by_log = dent_m * np.interp(self._straight(parameters[:, None], log_force), middle, slope)
        by_force = by_log * (1.0 / exponent + 2.0 * bend * log_force) / np.exp(log_force)
        start, bent = np.full_like(dent_m, 1e-3), np.broadcast_to(self._bent_m, dent_m.shape)
        shape = np.stack([start, by_log, -by_log * log_force / exponent**2, by_log * log_force**2, bent], axis=1)
        away = self._z - 1e-3 * parameters[:, :1] - dent_m - parameters[:, 4:5] * self._bent_m
        moved = np.concatenate([-shape, -by_force[:, None] * added], axis=1)
        return away @ self._whitens.T, moved @ self._whitens.T

    def _dents(self, parameters: FloatArray, spectrum: Spectrum) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(d, m) log of the force that would make each sample's dent at once, over the set force; that dent [m]; and
        the derivatives of that force (d, k, m)."""
        more, by_parameter = spectrum.added(parameters[:, SHAPE:], self._filtered)
        log_force = np.log(np.maximum(self._share + more, LEAST_SHARE))
        return log_force, np.exp(self._log_dent(parameters[:, None], log_force)), by_parameter

    def _straight(self, parameters: FloatArray, log_force: FloatArray) -> FloatArray:
        """(...,) as `_log_dent`, of a paraboloid."""
        _, log_depth, exponent, bend = np.moveaxis(parameters[..., : SHAPE - 1], -1, 0)
        log_dent = log_depth + log_force / np.maximum(exponent, LEAST_EXPONENT) + bend * log_force**2
        return np.asarray(np.clip(log_dent, -LARGEST_LOG, LARGEST_LOG))

    def _log_dent(self, parameters: FloatArray, log_force: FloatArray) -> FloatArray:
        """(...,) log of the dent [m] at a log force (...,) over the set force, of parameters (..., k)."""
        log_dent = self._straight(parameters, log_force)
        return np.asarray(log_dent if self._ball is None else np.interp(log_dent, *self._ball))


def _ball(radius_m: float) -> tuple[FloatArray, FloatArray]:
    """(n,) logs of the dent that a paraboloid of a ball's curvature makes, and of the ball's own, at equal forces [m]
    (Sneddon 1965, both rigid)."""
    contact = -np.expm1(-np.geomspace(1e-4, 5.0, BALL_STEPS))  # radius of the contact over the ball's
    force = (1.0 + contact**2) * np.arctanh(contact) - contact
    force[contact < 0.03] = (4.0 / 3.0 * contact**3 + 8.0 / 15.0 * contact**5)[contact < 0.03]
    return np.log(radius_m * (0.75 * force) ** (2.0 / 3.0)), np.log(radius_m * contact * np.arctanh(contact))


def _off_together(one: FloatArray, other: FloatArray) -> FloatArray:
    """(a, b) covariance of the law's errors at log forces (a,) and (b,): a process g less its value at 0."""

    def g(left: FloatArray, right: FloatArray) -> FloatArray:
        rise = np.exp(-LAW_RISE * (left[:, None] + right))
        return LAW_OFF**2 * rise * correlation("gaussian", (left[:, None] - right) / LAW_LENGTH)

    at = np.zeros(1)
    return np.asarray(g(one, other) - g(one, at) - g(at, other) + g(at, at))


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
