"""Effect of a layer's shape on a touch: its thickness there, the curvature of its surface, its edge.

    shift = shape_shift(LocalShape(thickness_m=0.03), depth_m=0.004, reference_m=0.05)
    log_stiffness + shift.log       # as the same foam would be on a level layer of the reference thickness

Apparent stiffness = that of a level, wide layer of the reference thickness x factors. Thickness: a ball on a bonded
layer (Dimitriadis et al. 2002); curvature: after Hertz's ball of the relative curvature, 1 / R + kappa;
inclination and edges: fitted to finite elements.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported as they are first used

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.poke.contact import layer_modulus

CURVED, INCLINED = 0.40, 0.10
"""Power of 1 + R kappa in apparent stiffness at a force: Hertz gives 1/3, for bodies without sides; and the effect of
the slope's square on its logarithm. Fitted to finite elements of waves and egg-crates (`studies.seeds.TUNING`): 5 to 20
cm long, slopes of up to 0.29, R kappa from -0.16 to 0.26. The residual is 0.4 % of stiffness rms, 2 % at most."""

EDGE, EDGE_LENGTH = 0.473, 0.358
"""An edge at a distance e subtracts EDGE exp(-e / L) from log stiffness. L is this share of the geometric mean of the
thickness and the contact's radius sqrt(R d), with d the measured dent. It is fitted to finite elements 1 to 3 cm from
38 edges (as above), layers of 2 to 6 cm, foam of 30 to 110 kPa, within 0.15 % rms and 0.4 %."""

EDGE_BENDS = 0.6
"""Change of the exponent of force over depth by an edge, per unit of log stiffness: the effect grows with the contact
(finite elements 3 cm from one edge and from two)."""

DOUBT = 0.1
"""Deviation of each of the four corrections, as a share of it."""

LEAST_RELATIVE = 0.2
"""A hollow narrower than a ball of 1.25 times the tip's radius counts as that: beyond it the tip touches its sides."""

MOST_SHIFT = 2.0
"""Largest change of log depth within which the reference layer's depth is sought."""


@dataclass(frozen=True, slots=True)
class LocalShape:
    """A layer where it is touched.

    thickness_m: thickness of the foam under the place [m]; curvature_per_m: mean of the surface's two, above 0 on a
    crest [1/m]; slope: slope of the surface [m/m]; edge_m: distance to the layer's edge [m];
    thickness_sd_m: deviation of the thickness [m]"""

    thickness_m: float
    curvature_per_m: float = 0.0
    slope: float = 0.0
    edge_m: float = float("inf")
    thickness_sd_m: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.thickness_m) and self.thickness_m > 0.0 and np.isfinite(self.curvature_per_m)):
            raise InputError("a thickness above 0 m and a finite curvature", f"{self.thickness_m}")
        if not self.edge_m >= 0.0:
            raise InputError("a distance to the edge, 0 m or more", f"{self.edge_m}")


@dataclass(frozen=True, slots=True)
class ShapeShift:
    """log: to be added to log apparent stiffness; sd: its deviation; exponent: to be added to the exponent of force
    over depth, only because of the edge"""

    log: float
    sd: float
    exponent: float = 0.0


def shape_shift(shape: LocalShape, depth_m: float, *, reference_m: float, radius_m: float = 0.01) -> ShapeShift:
    """Addition of a level, wide layer of the reference thickness [m] to a touch's log stiffness at its force. depth_m:
    depth of the dent at the force at which stiffness is taken [m]; radius_m: radius of the ball"""
    if not (depth_m > 0.0 and reference_m > 0.0 and radius_m > 0.0):
        raise InputError("depth, reference thickness and radius above 0 m", f"{depth_m}, {reference_m}, {radius_m}")
    thickness = _thickness_log(shape.thickness_m, depth_m, reference_m, radius_m)
    relative = max(1.0 + radius_m * shape.curvature_per_m, LEAST_RELATIVE)
    curved, inclined = CURVED * float(np.log(relative)), -INCLINED * shape.slope**2
    length_m = EDGE_LENGTH * float(np.sqrt(shape.thickness_m * np.sqrt(radius_m * depth_m)))
    edge = EDGE * float(np.exp(-shape.edge_m / length_m))
    thicker = _thickness_log(shape.thickness_m + shape.thickness_sd_m, depth_m, reference_m, radius_m)
    sds = [DOUBT * part for part in (thickness, curved, inclined, edge)] + [thicker - thickness]
    return ShapeShift(thickness + curved + inclined + edge, float(np.linalg.norm(sds)), EDGE_BENDS * edge)


def _thickness_log(thickness_m: float, depth_m: float, reference_m: float, radius_m: float) -> float:
    """Log of this depth over that which the same force makes on the reference layer of the same modulus."""

    def modulus_log(log_depth: float, layer_m: float) -> float:
        depth = float(np.exp(log_depth))
        return float(np.log(layer_modulus(depth, 1.0, radius_m=radius_m, thickness_m=layer_m)))

    here, wanted = float(np.log(depth_m)), modulus_log(float(np.log(depth_m)), thickness_m)
    if thickness_m == reference_m:
        return 0.0
    ends = here - MOST_SHIFT, here + MOST_SHIFT
    return here - float(scipy.optimize.brentq(lambda there: modulus_log(there, reference_m) - wanted, *ends, xtol=1e-9))


def shape_of(height_m: FloatArray, deviation_m: FloatArray, step_m: float, edge_m: float, least_m: float) -> LocalShape:
    """The shape from heights over the table (5,), at a place and a step along +x, -x, +y, -y, and their deviations [m].
    edge_m: distance to the layer's edge; least_m: least thickness of a layer [m]"""
    middle, right, left, ahead, behind = (float(one) for one in height_m)
    return LocalShape(
        thickness_m=max(middle, least_m),
        curvature_per_m=(4.0 * middle - right - left - ahead - behind) / (2.0 * step_m**2),
        slope=float(np.hypot(right - left, ahead - behind)) / (2.0 * step_m),
        edge_m=max(edge_m, 0.0),
        thickness_sd_m=float(deviation_m[0]),
    )
