"""Fits to one measured touch: its contact and its creep, and its reported estimate; the forecast of one before it is
made."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.beta_fit import BetaEstimate
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.experiments.explore.search import SurfaceSearch
from deformscope.experiments.explore.seen_surface import SeenSurface
from deformscope.stages.map.exploration import TouchEstimate, TouchForecast
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.poke.contact import Z_90, ArmCompliance, ContactFit, fit_approach, fitted_law
from deformscope.stages.poke.creep import CreepFit, fit_creep
from deformscope.stages.poke.layer_seen import LayerModulus, modulus_of
from deformscope.stages.poke.local_shape import LocalShape, ShapeShift
from deformscope.stages.regions.touches import TouchErrorModel

NEAR_M = 0.08
"""Points within this of a touch are shown with it."""
CLOCK_SD_S = 0.002
"""Standard deviation of the force's times relative to the arm's [s; assumed: a millisecond or two are left by
`calibrate time`]."""


@dataclass(frozen=True, slots=True)
class TouchContact:
    """fit; law_n: (n,) its force at each reading [N]; modulus: modulus of the layer, None where it is not known
    speed_m_s: speed of the tip's approach in contact, None if unknown
    level_n_per_mm: stiffness of a level layer of the stated thickness, None if the touched layer is level"""

    fit: ContactFit
    law_n: FloatArray
    modulus: LayerModulus | None
    speed_m_s: float | None
    level_n_per_mm: float | None = None


def fit_contact(
    touched: TouchMeasurement, surface: SeenSurface, search: SurfaceSearch, arm: ArmCompliance, error: TouchErrorModel
) -> TouchContact:
    """The contact of a touch. error: of its force; raises the errors of `fit_approach`"""
    options, along = surface.options, _along(touched)
    peak = int(np.argmax(_force_along(touched)))
    fit = fit_approach(
        touched.time_s,
        touched.position_m,
        touched.force_n,
        touched.normal,
        set_force_n=options.set_force_n,
        arm=arm,
        gain_sd=error.gain_sd,
        force_sd_n=error.noise_n or None,
        off_n=error.off_n,
        exponent_sd=search.exponent_sd,
        least_share=search.least_share,
    )
    law_n, modulus = fitted_law(fit, arm, along), None
    if not fit.rigid and fit.depth_m > 0.0:
        force = min(fit.at_force_n, fit.peak_force_n)
        dent_m, (low, high) = fit.dent_m(force), fit.interval_n_per_mm
        stiffness = 1e-3 * force / dent_m
        ends = stiffness * low / fit.stiffness_n_per_mm, stiffness * high / fit.stiffness_n_per_mm
        radius_m = options.tip_radius_m
        modulus = modulus_of(surface.layer, stiffness, ends, force_n=force, radius_m=radius_m, dent_m=dent_m)
    # speed of the tip from contact to the peak of the force
    began = min(int(np.searchsorted(np.maximum.accumulate(along), fit.contact_m)), max(peak - 1, 0))
    taken_s = float(touched.time_s[peak] - touched.time_s[began])
    speed_m_s = float(along[peak] - along[began]) / taken_s if taken_s > 0.0 else None
    return TouchContact(fit, law_n, modulus, speed_m_s)


def fit_touch_creep(
    touched: TouchMeasurement, surface: SeenSurface, arm: ArmCompliance, off_n: float = 0.0
) -> CreepFit | None:
    """Creep of a touch with a hold; None for any other. off_n: deviation of the force's offset [N]"""
    if touched.loading is None or touched.held is None:
        return None
    return fit_creep(
        touched.time_s,
        touched.position_m,
        touched.force_n,
        touched.normal,
        loading=touched.loading,
        held=touched.held,
        set_force_n=surface.options.set_force_n,
        arm=arm,
        radius_m=surface.options.tip_radius_m,
        clock_sd_s=CLOCK_SD_S,
        off_n=off_n,
    )


def touch_estimate(
    touched: TouchMeasurement,
    *,
    number: int,
    height_m: float | None,
    contact: TouchContact | None,
    creep: CreepFit | None,
    beta: BetaEstimate,
    shape: LocalShape | None,
    tip_radius_m: float,
) -> TouchEstimate:
    """The reported estimate of a touch. number: from 1; height_m: observed height of the surface there, None = not
    seen; known: the surface's height is known: it is the lowest place of the tip; contact: the fitted contact, None if
    it could not be fitted"""
    along, force_n, nan = _along(touched), _force_along(touched), float("nan")
    lowest_m = float(touched.position_m[:, 2].min()) - tip_radius_m
    near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < NEAR_M if len(touched.after_m) else []
    fit, modulus = (None, None) if contact is None else (contact.fit, contact.modulus)
    return TouchEstimate(
        number=number,
        xyz_m=np.append(touched.xy_m, lowest_m if height_m is None else height_m),
        normal=touched.normal / np.linalg.norm(touched.normal),
        approach_m=along - along[0],
        approach_n=force_n,
        fitted_n=np.full(len(along), nan) if contact is None else contact.law_n,
        contact_m=nan if fit is None else fit.contact_m - along[0],
        stiffness_n_per_mm=nan if fit is None else fit.stiffness_n_per_mm,
        stiffness_interval=(nan, nan) if fit is None else fit.interval_n_per_mm,
        rigid=False if fit is None else fit.rigid,
        modulus_pa=None if modulus is None else modulus.pa,
        modulus_interval_pa=None if modulus is None else modulus.interval_pa,
        depth_m=nan if fit is None else fit.dent_m(fit.peak_force_n),
        peak_force_n=float(force_n.max()) if fit is None else fit.peak_force_n,
        peak_rate_n_per_s=None if fit is None else fit.peak_rate_n_per_s,
        peak_rate_interval_n_per_s=None if fit is None else fit.peak_rate_interval_n_per_s,
        beta=beta.value,
        beta_interval=beta.interval,
        beta_verdict=beta.verdict,
        observed_m=touched.after_m[near],
        simulated_m=beta.simulated_m,
        creep=creep,
        thickness_m=None if shape is None else shape.thickness_m,
        level_n_per_mm=None if contact is None else contact.level_n_per_mm,
        speed_m_s=None if contact is None else contact.speed_m_s,
    )


def _along(touched: TouchMeasurement) -> FloatArray:
    """(n,) way of the tip into the surface [m]."""
    return np.asarray(-(touched.position_m @ touched.normal) / np.linalg.norm(touched.normal))


def _force_along(touched: TouchMeasurement) -> FloatArray:
    """(n,) force out of the surface [N]."""
    return np.asarray(touched.force_n @ touched.normal / np.linalg.norm(touched.normal))


FORCES = 25
"""Number of points of the depth forecast."""


def forecast_touch(
    touch: Touch,
    options: ExploreOptions,
    *,
    log_stiffness: float,
    log_sd: float,
    exponent: float,
    shift: ShapeShift | None,
    touches: int,
) -> TouchForecast:
    """Forecast of a touch where the map has this log stiffness [N/mm], with the deviation of one touch's measurement.
    exponent: exponent of the law of force over depth; shift: as in `SeenSurface.shift`; touches: touches made so far"""
    if shift is not None:
        log_stiffness -= shift.log
    forces = np.linspace(0.0, options.set_force_n, FORCES)
    share = (forces / options.set_force_n) ** (1.0 / exponent)
    stiffness, low, high = (float(np.exp(log_stiffness + sds * log_sd)) for sds in (0.0, -Z_90, Z_90))
    depth_m, deepest_m, least_m = (1e-3 * options.set_force_n / one * share for one in (stiffness, low, high))
    at = np.append(touch.xy_m, touch.height_m)
    above_m = at + (options if touch.plan is None else touch.plan).standoff_m * touch.normal
    crossing_m = above_m[2] if touch.plan is None else touch.plan.travel_height_m - options.tip_radius_m
    over_m = np.append(above_m[:2], max(above_m[2], crossing_m))
    return TouchForecast(
        xyz_m=at,
        normal=touch.normal,
        way_m=np.array([over_m, above_m, at]),
        set_force_n=options.set_force_n,
        stiffness_n_per_mm=stiffness,
        stiffness_interval=(low, high),
        force_n=forces,
        depth_m=depth_m,
        depth_low_m=least_m,
        depth_high_m=deepest_m,
        touches=touches,
    )
