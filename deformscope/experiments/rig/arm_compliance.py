"""The compliance of an arm, from touches of something rigid, and whether camera and arm agree about its place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.explore import Look
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import Geometry
from deformscope.session import RigExperiment, ask
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.map.surface import fit_surface
from deformscope.stages.poke.contact import ArmCompliance, calibrate_compliance, fit_approach

SURE_SD = 0.1
"""Largest unknown share of a compliance that is subtracted from dents."""

DOME_AT_MOST = 3.5e-4
"""Largest dent at 1 N that may be that of the tip itself [m/N^(2/3)]. A rubber dome of 10 mm radius that yields 2 mm at
40 N has 1.7e-4, foam of 300 kPa under it 8e-4. The value is between the two."""

COMMON_SD = 0.05
"""Share that all touches of one block have in common, and that their scatter does not show: the block's own dent."""


@dataclass(frozen=True, slots=True)
class ComplianceTouch:
    """One touch of something rigid. seen_m, met_m: height of the surface by the camera, and by the arm's contact [m,
    surface frame]"""

    found: ArmCompliance
    peak_force_n: float
    seen_m: float
    met_m: float


@dataclass(frozen=True, slots=True)
class CombinedCompliance:
    """compliance_m_per_n: mean of the touches; compliance_sd: its uncertainty, with the scatter between touches [m/N];
    dome: mean dent of the tip itself at 1 N, which grows with the power 2/3 of the force [m/N^(2/3)], not in the
    compliance; off_m: height of the surface by the camera minus that by contact [m], off_sd_m: its scatter"""

    touches: tuple[ComplianceTouch, ...]
    compliance_m_per_n: float
    compliance_sd: float
    off_m: float
    off_sd_m: float
    dome: float = 0.0


def touch_places(
    geometry: Geometry,
    places_m: FloatArray,
    touched: Callable[[TouchMeasurement, float], None],
    forces_n: Sequence[float] = (),
) -> RigExperiment[None]:
    """The experiment that touches places (n, 2) [m] after a look. touched: called with each touch and the height at
    which the camera sees the surface there; forces_n: set force of each, if not that of the options. Raises
    ExplorationStopped, and InputError if the camera sees no surface."""
    seen = geometry.look((yield from ask(Look())))
    world = fit_surface(seen.points_m, noise_m=seen.noise_m, within_m=((0.0, 0.0), geometry.size_m), outlier_sd=5.0)
    for number, xy_m in enumerate(places_m):
        height_m, normal = float(world.at(xy_m[None]).mean[0]), world.normals(xy_m[None])[0]
        touch = geometry.approach(xy_m, height_m, normal, None)
        if forces_n and touch.plan is not None:
            touch = replace(touch, plan=replace(touch.plan, set_force_n=forces_n[number], more_force_n=None))
        touched(geometry.touch((yield from ask(touch))), height_m)


def touched_rigid(measured: TouchMeasurement, height_m: float, options: ExploreOptions) -> ComplianceTouch:
    """A touch of something rigid, whose surface the camera sees at this height. Raises InputError for a soft thing."""
    made, normal = measured.approach, measured.normal
    found = calibrate_compliance(made.time_s, made.position_m, made.force_n, normal, set_force_n=options.set_force_n)
    law = fit_approach(made.time_s, made.position_m, made.force_n, normal, set_force_n=options.set_force_n, arm=found)
    # the contact with the surface, along the normal, taken to where the camera's height is given
    met_m = height_m + (-law.contact_m - float(np.append(measured.xy_m, height_m) @ normal) - options.tip_radius_m)
    if found.dome > DOME_AT_MOST:
        raise InputError(
            f"something rigid, which a tip dents by {1e3 * DOME_AT_MOST:g} mm at 1 N at most",
            f"a dent of {1e3 * found.dome:.2f} mm at 1 N that stiffens as it grows, as foam's",
            "a block of steel or stone, fixed to the surface",
        )
    return ComplianceTouch(found, law.peak_force_n, height_m, met_m)


def combine_compliance(touches: list[ComplianceTouch]) -> CombinedCompliance:
    """Combined result of the touches. Raises InputError without any."""
    if not touches:
        raise InputError("a touch or more", "none")
    each = np.array([one.found.compliance_m_per_n for one in touches])
    within = np.array([one.found.compliance_sd for one in touches])
    scatter = float(each.std(ddof=1)) if len(each) > 1 else 0.0
    own = np.hypot(np.sqrt((within**2).mean()), scatter) / np.sqrt(len(each))
    sd = float(np.hypot(own, COMMON_SD * each.mean()))
    off = np.array([one.seen_m - one.met_m for one in touches])
    off_sd = float(off.std(ddof=1)) if len(off) > 1 else 0.0
    dome = np.mean([one.found.dome for one in touches])
    return CombinedCompliance(tuple(touches), float(each.mean()), sd, float(off.mean()), off_sd, float(dome))
