"""The forecast of a touch that a person requests, before it is made."""

from __future__ import annotations

import numpy as np

from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.stages.map.exploration import TouchForecast
from deformscope.stages.poke.contact import Z_90
from deformscope.stages.poke.local_shape import ShapeShift

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
