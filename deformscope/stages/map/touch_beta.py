"""The local *beta* of one touch: the shape parameter of the model whose dent fits that of the surface around the tip.

    found = fit_touch(world, after_m, touch, thickness_m=0.05)      # layers below the surface: the default
    found = thesis_beta(dent_of(world, touched, place_m))           # one layer, as in Thesis 4.3

`fit_touch` uses `deformscope.stages.poke.poke_fit`, like a poke of a pair file. The data are the raw points
that the camera saw while the tip pressed, never a smooth surface through them: a Gaussian process widens shallow dents,
and beta would follow the depth. On linear foam the dent's shape does not depend on how firm the foam is, and beta ends
at its bound for every modulus: the verdict `at-bound` is the normal answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.distance import nearest_error
from deformscope.stages.fit.estimate import Curve, Estimate
from deformscope.stages.gaussian_process import ProcessPrediction
from deformscope.stages.map.perception import COARSE_GRID_M, SeenDent
from deformscope.stages.map.surface import HeightProcess
from deformscope.stages.msm import clusters
from deformscope.stages.msm.poke import Law, PokeSetup, Tip, hold, settle
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import conclude
from deformscope.stages.poke.poke_fit import DOWN, NEAR_SHARE, REACH_SHARE, REACH_TIPS, PokesFit, SeenPoke, fit_pokes
from deformscope.stages.regions.touches import MapGrid
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

THESIS_SIDE_M, THESIS_GRID_M, THESIS_STEP = 0.15, 0.005, 0.01
"""Side of the square around a touch; the thesis's grid (4.4) and step of the sweep of beta (Algorithm 3)."""

THESIS_NOTE = (
    "a trend of this beta with firmness is an effect of the contact patch, which grows with the dent. One "
    "held particle makes the model interpret the patch's width as deformability; with the whole patch held "
    "the trend disappears"
)
"""Remark wherever beta of the thesis's model is shown."""


class SurfaceHeights(Protocol):
    """A surface with known heights at requested places, such as a `HeightProcess`."""

    def at(self, places_m: FloatArray) -> ProcessPrediction:
        """Prediction at places (n, 2) [m]."""


@dataclass(frozen=True, slots=True)
class BallContact:
    """A ball pressed into a surface from above, as arm and force sensor report it.

    lowest_m: (3,) lowest point of the ball; radius_m: radius of the ball; depth_m: how far that point sank since
    contact [m]; force_n: force [N], None if unknown
    """

    lowest_m: FloatArray
    radius_m: float
    depth_m: float
    force_n: float | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.lowest_m).all() and self.radius_m > 0.0 and self.depth_m > 0.0):
            raise InputError(
                "a ball that has sunk in",
                f"radius {self.radius_m:g} m, depth {self.depth_m:g} m",
                "leave rigid touches",
            )


@dataclass(frozen=True, slots=True)
class TouchBeta:
    """beta of a touch, with interval and verdict, and the fit that it comes from.

    points: number of raw points of the fit; simulated_m: (p, 3) particles of the model's top layer under the ball, at
    beta
    """

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
    sample_m: tuple[tuple[float, float], tuple[float, float]] | None = None,
) -> TouchBeta:
    """beta of layers of material below the surface. Their bottom is held, and all particles that the ball touches are
    held to it.

    world: the surface before, a process of all points seen then: it gives the heights at rest, not the dent
    after_m: (n, 3) raw points seen while the ball pressed, the robot's taken away [m]
    thickness_m: thickness of the foam [m]; sample_m: (low, high) edges of the foam, default the world's box The
    lattice's spacing is the patch's radius. Therefore the patch always has four columns, and a coarse lattice has the
    same effect on beta for soft and firm foam. (At 1 cm a single one would, for every patch: noise-free dents of 20 to
    120 kPa then give 0.55 to 0.14, the trend that one held particle makes; so they give at most 0.1.) Raises InputError
    for too few points around the touch.
    """
    radius = contact_radius_m(touch.radius_m, touch.depth_m)
    ends = LEAST_SPACING_SHARE * thickness_m, MOST_SPACING_SHARE * thickness_m
    spacing = float(np.clip(radius, *ends))
    near = _around(after_m, touch, thickness_m)
    low, high = sample_m or world.box_m
    surface = MeasuredSurface(_at_rest(world, touch, thickness_m, low, high, spacing), thickness_m)
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


def _at_rest(
    world: HeightProcess,
    touch: BallContact,
    thickness: float,
    low: tuple[float, float],
    high: tuple[float, float],
    spacing: float,
) -> FloatArray:
    """(n, 3) the surface before, as far around the touch as the lattice goes."""
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
    aside = np.concatenate(
        [np.zeros((1, 2)), (away[:, None, None] * np.column_stack([np.cos(angle), np.sin(angle)])).reshape(-1, 2)]
    )
    sink = Tip("sphere", (2.0 * touch.radius_m,)).rise(aside * (1.0 - 1e-9)) - touch.depth_m
    rest = np.column_stack([touch.lowest_m[:2] + aside, np.full(len(aside), touch.lowest_m[2] + touch.depth_m)])
    return rest, np.column_stack([np.zeros_like(aside), sink])


# The thesis's procedure ----------------------------------------------------------------------------------------------


def dent_of(
    world: SurfaceHeights, touched: SurfaceHeights, place_m: FloatArray, cell_m: float = COARSE_GRID_M
) -> SeenDent:
    """The dent in a square of `THESIS_SIDE_M` around a place (2,) [m]. world, touched: the surface before and under
    touch, the second with the tactile points; cell_m: cell size of the grid"""
    grid = MapGrid((THESIS_SIDE_M, THESIS_SIDE_M), cell_m)
    places_m = np.asarray(place_m)[:2] - 0.5 * THESIS_SIDE_M + grid.centres_m
    rest, under = world.at(places_m), touched.at(places_m)
    before, after = (np.column_stack([places_m, one.mean]) for one in (rest, under))
    return SeenDent(before, after, grid.shape, cell_m, under.deviation)


def swept_betas(step: float) -> FloatArray:
    """(b,) values of the sweep: 0, step, 2 step... below 1 (Algorithm 3)."""
    return step * np.arange(np.ceil(1.0 / step - 1e-9))


@dataclass(frozen=True, slots=True)
class ThesisBeta:
    """beta of a lattice with fixed edges and one held particle (Thesis 4.3).

    curve: error over beta (eq. 4.6) [m]; depth_m: depth of the particle held; simulated_m: (p, 3) the particles of the
    surface at beta; converged: the state at beta settled; dent: the fitted dent; note: remark on its trend
    """

    beta: float
    curve: Curve
    depth_m: float
    simulated_m: FloatArray
    converged: bool
    dent: SeenDent
    note: str = THESIS_NOTE

    @property
    def error_m(self) -> float:
        """Mean distance from each simulated point to the nearest observed one, at beta [m] (Thesis eq. 4.6)."""
        return float(np.nanmin(self.curve.aee))


def thesis_beta(
    dent: SeenDent,
    *,
    thickness_m: float | None = None,
    cluster_size: int | None = CLUSTER_SIZE,
    step: float = THESIS_STEP,
) -> ThesisBeta:
    """beta as in Thesis 4.3, 4.4 and Algorithm 3: the lowest point of the surface under touch is held, beta is swept.

    thickness_m: layers down to a ground that is held, this far below; default a single layer, as in the thesis
    cluster_size: particles a side; None: one cluster of all particles, which deforms quadratically (the thesis's "no
    cluster")
    step: step of the sweep (`swept_betas`) A single layer, all bending, has wider dents than foam on a table, at any
    beta: on finite element slabs of 20 to 120 kPa with a square of 15 cm beta is 0 for all except the smoothest dents.
    With one held particle of a volume lattice, beta depends on firmness: 0.55 to 0.14 there. Raises InputError if the
    lowest point is at the square's edge.
    """
    before, after, shape = dent.before, dent.after, dent.shape
    lowest = int(np.argmax(dent.sunk_m))
    row, column = np.unravel_index(np.arange(len(before)), shape)
    edge = (row == 0) | (row == shape[0] - 1) | (column == 0) | (column == shape[1] - 1)
    if edge[lowest]:
        raise InputError("a dent inside the square", "the lowest point at its edge", "a place nearer to the touch")
    layers = 1 if thickness_m is None else max(2, round(thickness_m / dent.cell_m) + 1)
    rest = np.repeat(before[:, None], layers, axis=1)
    if thickness_m is not None:
        rest[:, :, 2] -= thickness_m * np.arange(layers - 1, -1, -1) / (layers - 1)
    rest = rest.reshape(-1, 3)
    fixed = np.repeat(edge[:, None], layers, axis=1)
    fixed[:, 0] |= thickness_m is not None
    top = np.arange(layers - 1, len(rest), layers)
    if cluster_size is None:
        grouped, law = clusters.single(len(rest)), Law(0.0, cluster_size=None, basis="quadratic")
    else:
        lattice = shape if layers == 1 else (*shape, layers)
        grouped = clusters.lattice(rest, lattice, np.arange(len(rest)), cluster_size)
        law = Law(0.0, cluster_size=cluster_size)
    scene = PokeSetup(
        rest=rest, clusters=grouped, fixed=np.flatnonzero(fixed), open=top, toward=DOWN, spacing=dent.cell_m
    )
    here = top[[lowest]]
    body = hold(scene, here, law, "float32", "cpu")
    beta = swept_betas(step)
    laws = [replace(law, beta=float(one)) for one in beta]
    state = settle(scene, body, laws, here, after[[lowest]], slips=False, start=None)
    surface = np.asarray(state.position, dtype=np.float64)[:, top]
    error = np.array([nearest_error(one, after) for one in surface])
    best = int(np.argmin(error))
    return ThesisBeta(
        beta=float(beta[best]),
        curve=Curve(beta, error),
        depth_m=float(dent.sunk_m[lowest]),
        simulated_m=surface[best],
        converged=bool(state.converged[best]),
        dent=dent,
    )
