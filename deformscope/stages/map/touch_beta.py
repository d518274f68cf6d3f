"""The local *beta* of one touch: the shape parameter of the model whose dent fits that of the surface around the tip.

    found = fit_touch(world, after_m, touch, thickness_m=0.05)

Layers below the surface are fitted, by `deformscope.stages.poke.poke_fit`, like a poke of a pair file. The data are the
raw points that the camera saw while the tip pressed, never a smooth surface through them: a Gaussian process widens
shallow dents, and beta would follow the depth. On linear foam the dent's shape does not depend on how firm the foam
is, and beta ends at its bound for every modulus: the verdict `at-bound` is the normal answer.
"""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.estimate import Estimate
from deformscope.stages.map.surface import HeightProcess
from deformscope.stages.msm.poke import Tip
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import conclude
from deformscope.stages.poke.poke_fit import NEAR_SHARE, REACH_SHARE, REACH_TIPS, PokesFit, SeenPoke, fit_pokes
from deformscope.stages.see.cloud import contact_radius_m

LEAST_SPACING_SHARE, MOST_SPACING_SHARE = 0.14, 0.25
"""The lattice's spacing in thicknesses of the foam at least (finer ones take seconds) and at most (fewer layers hold no
cluster off the ground)."""

CLUSTER_SIZE, LEVEL = 3, 0.9
BOUNDS = (0.0, 0.95)
"""Betas nearer to 1 take long to settle, and no foam was seen to need them."""

RINGS, SPOKES = 4, 12
"""Points at which the contact patch is described."""

FEWEST = 20
"""Least number of points near a touch."""


@dataclass(frozen=True, slots=True)
class BallContact:
    """A ball pressed into a surface from above, as arm and force sensor report it.

    lowest_m: (3,) lowest point of the ball; radius_m: radius of the ball; depth_m: how far that point sank since
    contact [m]; force_n: force [N], None if unknown"""

    lowest_m: FloatArray
    radius_m: float
    depth_m: float
    force_n: float | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.lowest_m).all() and self.radius_m > 0.0 and self.depth_m > 0.0):
            came = f"radius {self.radius_m:g} m, depth {self.depth_m:g} m"
            raise InputError("a ball that has sunk in", came, "leave rigid touches")


@dataclass(frozen=True, slots=True)
class TouchBeta:
    """beta of a touch, with interval and verdict, and the fit that it comes from.

    points: number of raw points of the fit; simulated_m: (p, 3) particles of the model's top layer under the ball, at
    beta"""

    estimate: Estimate
    fit: PokesFit
    points: int
    simulated_m: FloatArray

    @property
    def sd(self) -> float:
        """Deviation of beta's posterior, for the field of beta."""
        posterior = self.estimate.posterior
        return float("nan") if posterior is None else posterior.deviation()


def fit_touch(
    world: HeightProcess,
    after_m: FloatArray,
    touch: BallContact,
    *,
    thickness_m: float,
    cluster_size: int = CLUSTER_SIZE,
) -> TouchBeta:
    """beta of layers of material below the surface. Their bottom is held, and all particles that the ball touches are
    held to it.

    world: the surface before, a process of all points seen then: it gives the heights at rest, not the dent
    after_m: (n, 3) raw points seen while the ball pressed, the robot's taken away [m]
    thickness_m: thickness of the foam [m], whose edges are those of the world's box. The lattice's spacing is the
    patch's radius. Therefore the patch always has four columns, and a coarse lattice has the same effect on beta for
    soft and firm foam. (At 1 cm a single one would, for every patch: noise-free dents of 20 to 120 kPa then give 0.55
    to 0.14, the trend that one held particle makes; so they give at most 0.1.) Raises InputError for too few points
    around the touch."""
    radius = contact_radius_m(touch.radius_m, touch.depth_m)
    ends = LEAST_SPACING_SHARE * thickness_m, MOST_SPACING_SHARE * thickness_m
    spacing = float(np.clip(radius, *ends))
    near = _around(after_m, touch, thickness_m)
    surface = MeasuredSurface(_at_rest(world, touch, thickness_m, spacing), thickness_m)
    sunk = near[:, 2] - world.at(near[:, :2]).mean
    touched, touched_by = _contact(touch)
    seen = SeenPoke(
        at=np.array([*touch.lowest_m[:2], touch.lowest_m[2] + touch.depth_m]),
        tip=Tip("disc", (spacing,), slips=False),  # one cell wide: its corners stand in the patch
        depth=touch.depth_m,
        touched=touched,
        touched_by=touched_by,
        points=np.column_stack([near[:, :2], near[:, 2] - sunk]),
        moved=np.column_stack([np.zeros((len(near), 2)), sunk]),
        noise=None,
        force=touch.force_n,
        heights_only=True,
        average_over=touch.radius_m,
        misfit_over=2.0 * touch.radius_m,
    )
    fit = fit_pokes(surface, [seen], spacing=spacing, cluster_sizes=[cluster_size], beta_range=BOUNDS, theta=0.0)
    found = conclude(fit, level=LEVEL, settings={"model": "volume"}, provenance={})
    posed = fit.posed[0]
    top = posed.settle([fit.best.law]).position[0, posed.scene.open]
    return TouchBeta(estimate=found.estimate, fit=fit, points=len(near), simulated_m=np.asarray(top, dtype=np.float64))


def _around(after: FloatArray, touch: BallContact, thickness: float) -> FloatArray:
    """Those of the points (n, 3) [m] around a touch that the fit compares. Raises InputError where they are too few."""
    after = np.asarray(after, dtype=np.float64)
    if after.ndim != 2 or after.shape[1] != 3 or not np.isfinite(after).all():
        raise InputError("finite points (n, 3) [m]", f"shape {after.shape}")
    reach = touch.radius_m + NEAR_SHARE * thickness
    near = after[(np.abs(after[:, :2] - touch.lowest_m[:2]) <= reach).all(axis=1)]
    if len(near) < FEWEST:
        raise InputError(f"{FEWEST} points around the touch", f"{len(near)}", "another view, or a smaller margin")
    return near


def _at_rest(world: HeightProcess, touch: BallContact, thickness: float, spacing: float) -> FloatArray:
    """(n, 3) the surface before, as far around the touch as the lattice goes."""
    low, high = world.box_m
    reach = touch.radius_m + REACH_SHARE * thickness + 2.0 * REACH_TIPS * touch.radius_m + spacing
    at = touch.lowest_m[:2]
    first, last = np.maximum(at - reach, low), np.minimum(at + reach, high)
    if (last - first < 2.0 * spacing).any():
        raise InputError("a touch on the sample", f"at ({at[0]:.3g}, {at[1]:.3g}) m", "the sample's extent")
    x, y = (np.linspace(first[i], last[i], max(3, round((last[i] - first[i]) / spacing) + 1)) for i in range(2))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack([places, world.at(places).mean])


def _contact(touch: BallContact) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points of the patch under the ball at rest [m], and their displacements (n, 3) [m] where the ball has
    pushed them."""
    radius = contact_radius_m(touch.radius_m, touch.depth_m)
    away = radius * np.arange(1, RINGS + 1) / RINGS
    angle = 2.0 * np.pi * np.arange(SPOKES) / SPOKES
    rings = away[:, None, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    aside = np.concatenate([np.zeros((1, 2)), rings.reshape(-1, 2)])
    sink = Tip("sphere", (2.0 * touch.radius_m,)).rise(aside * (1.0 - 1e-9)) - touch.depth_m
    rest = np.column_stack([touch.lowest_m[:2] + aside, np.full(len(aside), touch.lowest_m[2] + touch.depth_m)])
    return rest, np.column_stack([np.zeros_like(aside), sink])
