"""The compliance of an arm, from touches of something rigid; and whether camera and arm agree about where it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore import Look
from deformscope.experiments.explorer import Geometry
from deformscope.experiments.options import ExploreOptions
from deformscope.session import RigExperiment, ask
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.map.surface import fit_surface
from deformscope.stages.poke.contact import ArmCompliance, calibrate_compliance, fit_approach

SURE_SD = 0.1
"""Of a compliance that is to be taken off dents, at most this share of it should be unknown."""

LOADED, LEAST_BEND_M = 0.1, 2e-4
"""Share of the peak force from which on the law is looked at; what gives less than this is rigid enough [m]."""

COMMON_SD = 0.05
"""Share that all touches of one block have in common, and that their scatter does not show: the block's own dent."""


@dataclass(frozen=True, slots=True)
class GiveTouch:
    """One touch of something rigid. seen_m, met_m: height of the surface as the camera sees it, and as the arm meets it
    [m, surface frame]"""

    found: ArmCompliance
    peak_force_n: float
    seen_m: float
    met_m: float


@dataclass(frozen=True, slots=True)
class ArmGive:
    """compliance_m_per_n: mean of the touches; compliance_sd: what is not known of it, the scatter between touches
    included [m/N]; off_m: the camera sees the surface so much higher than the arm meets it [m], off_sd_m: its scatter
    """

    touches: tuple[GiveTouch, ...]
    compliance_m_per_n: float
    compliance_sd: float
    off_m: float
    off_sd_m: float


def touch_rigid(
    geometry: Geometry,
    options: ExploreOptions,
    xy_m: FloatArray,
    touches: int,
    found_one: Callable[[GiveTouch], None],
) -> RigExperiment[None]:
    """The experiment that touches a place (2,) [m] of something rigid so often, after a look at it.

    found_one: called with each. Raises ExplorationStopped, and InputError where there is nothing to see.
    """
    seen = geometry.look((yield from ask(Look())))
    world = fit_surface(seen.points_m, noise_m=seen.noise_m, within_m=((0.0, 0.0), geometry.size_m), outlier_sd=5.0)
    height_m = float(world.at(xy_m[None]).mean[0])
    normal = world.normals(xy_m[None])[0]
    for _ in range(touches):
        made = geometry.touch((yield from ask(geometry.approach(xy_m, height_m, normal, None))))
        found = calibrate_compliance(
            made.time_s, made.position_m, made.force_n, normal, set_force_n=options.set_force_n
        )
        law = fit_approach(
            made.time_s, made.position_m, made.force_n, normal, set_force_n=options.set_force_n, arm=found
        )
        # where it met the surface, along the normal, taken to where the camera's height is given
        met_m = height_m + (-law.contact_m - float(np.append(xy_m, height_m) @ normal) - options.tip_radius_m)
        if not _straight(made, normal, found, law.contact_m):
            raise InputError(
                "something rigid, under which the arm gives in proportion to the force",
                "a dent that stiffens as it grows, as foam's",
                "a block of steel or stone, firmly on the surface",
            )
        found_one(GiveTouch(found, law.peak_force_n, height_m, met_m))


def _straight(made: TouchMeasurement, normal: FloatArray, found: ArmCompliance, contact_m: float) -> bool:
    """Whether depth goes with the force, rather than with its power 2/3 as under a ball in foam (Hertz 1882)."""
    force_n = made.force_n @ normal
    depth_m = -(made.position_m @ normal) - contact_m
    pressed = force_n > LOADED * force_n.max()
    force_n, depth_m = force_n[pressed], depth_m[pressed]
    if found.compliance_m_per_n * force_n.max() < LEAST_BEND_M:  # too little bends to distinguish the laws
        return True
    off = []
    for power in (1.0, 2.0 / 3.0):
        law = np.column_stack([force_n**power, np.ones_like(force_n)])
        off.append(float(np.sum((depth_m - law @ np.linalg.lstsq(law, depth_m, rcond=None)[0]) ** 2)))
    return off[0] <= off[1]


def arm_give(touches: list[GiveTouch]) -> ArmGive:
    """What the touches give together. Raises InputError without any."""
    if not touches:
        raise InputError("a touch or more", "none")
    each = np.array([one.found.compliance_m_per_n for one in touches])
    within = np.array([one.found.compliance_sd for one in touches])
    scatter = float(each.std(ddof=1)) if len(each) > 1 else 0.0
    own = np.hypot(np.sqrt((within**2).mean()), scatter) / np.sqrt(len(each))
    sd = float(np.hypot(own, COMMON_SD * each.mean()))
    off = np.array([one.seen_m - one.met_m for one in touches])
    off_sd = float(off.std(ddof=1)) if len(off) > 1 else 0.0
    return ArmGive(tuple(touches), float(each.mean()), sd, float(off.mean()), off_sd)
