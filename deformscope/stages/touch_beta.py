"""The local *beta* of one touch: the shape parameter of the model that dents as the surface around the tip did.

    found = fit_touch(world, after_m, touch, thickness_m=0.05)      # layers below the surface: the default
    found = thesis_beta(before_m, after_m)                          # one layer, as in Thesis 4.3

`fit_touch` goes through `deformscope.stages.poke_fit`, as a poke of a pair file does. The data are the raw points that
the camera saw while the tip pressed, never a smooth surface through them: a Gaussian process widens shallow dents, and
beta would follow the depth. On linear foam the dent's shape does not depend on how firm the foam is, and beta ends
at its bound for every modulus: the verdict `at-bound` is the normal answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.cloud import contact_radius_m
from deformscope.stages.estimate import Estimate
from deformscope.stages.gaussian_process import Grid
from deformscope.stages.layers import Surface
from deformscope.stages.msm import clusters
from deformscope.stages.msm.solver import Precision
from deformscope.stages.poke import Law, Scene, Tip, hold
from deformscope.stages.poke_estimate import conclude
from deformscope.stages.poke_fit import DOWN, NEAR_SHARE, REACH_SHARE, REACH_TIPS, PokesFit, SeenPoke, fit_pokes
from deformscope.stages.surface import HeightProcess

SPACING_M = 0.01
"""Spacing of the lattice wished for [m]: 15 x 15 x 6 particles around a tip of 2 cm on foam of 5 cm."""

CLUSTER_SIZE = 3
BOUNDS = (0.0, 0.99)

RINGS, SPOKES = 4, 12
"""Points at which the contact patch is described."""

FEWEST = 20
"""Points near a touch at least."""


@dataclass(frozen=True, slots=True)
class BallTouch:
    """A ball pressed into a surface from above, as arm and force sensor tell it.

    lowest_m: (3,) its foremost point; radius_m: of the ball; depth_m: how far that point sank since contact [m]
    force_n: [N], None if unknown
    """

    lowest_m: FloatArray
    radius_m: float
    depth_m: float
    force_n: float | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.lowest_m).all() and self.radius_m > 0.0 and self.depth_m > 0.0):
            raise InputError(
                "a ball that has sunk in", f"radius {self.radius_m:g} m, depth {self.depth_m:g} m", "leave rigid touches"
            )


@dataclass(frozen=True, slots=True)
class TouchBeta:
    """beta of a touch, with interval and verdict, and the fit that it comes from. points: raw ones it rests on"""

    estimate: Estimate
    fit: PokesFit
    points: int

    @property
    def sd(self) -> float:
        """Deviation of beta's posterior, for the field of beta."""
        posterior = self.estimate.posterior
        return float("nan") if posterior is None else posterior.deviation()


def fit_touch(
    world: HeightProcess,
    after_m: FloatArray,
    touch: BallTouch,
    *,
    thickness_m: float,
    sample_m: tuple[tuple[float, float], tuple[float, float]] | None = None,
    spacing_m: float = SPACING_M,
    cluster_size: int = CLUSTER_SIZE,
    level: float = 0.9,
    precision: Precision = "float32",
    device: str = "cpu",
) -> TouchBeta:
    """beta of layers of material below the surface, their bottom held, all that the ball touches held to it.

    world: the surface before, a process of all points seen then: it tells the heights at rest, not the dent
    after_m: (n, 3) raw points seen while the ball pressed, the robot's taken away [m]
    thickness_m: of the foam [m]; sample_m: (low, high) places where the foam ends, default the world's box
    Raises InputError for too few points around the touch.
    """
    near = _around(after_m, touch, thickness_m)
    low, high = sample_m or world.box_m
    surface = Surface(_at_rest(world, touch, thickness_m, low, high, spacing_m), thickness_m)
    sunk = near[:, 2] - world.at(near[:, :2]).mean
    seen = SeenPoke(
        at=np.array([*touch.lowest_m[:2], touch.lowest_m[2] + touch.depth_m]),
        tip=Tip("sphere", (2.0 * touch.radius_m,)),
        depth=touch.depth_m,
        **_contact(touch),
        points=np.column_stack([near[:, :2], near[:, 2] - sunk]),
        moved=np.column_stack([np.zeros((len(near), 2)), sunk]),
        noise=None,
        force=touch.force_n,
        heights_only=True,
    )
    fit = fit_pokes(
        surface,
        [seen],
        spacing=spacing_m,
        cluster_sizes=[cluster_size],
        theta=0.0,
        precision=precision,
        device=device,
    )
    found = conclude(fit, bounds=BOUNDS, level=level, settings={"model": "volume"}, provenance={})
    return TouchBeta(found.estimate, fit, len(near))


def _around(after: FloatArray, touch: BallTouch, thickness: float) -> FloatArray:
    """The points that the fit compares, without those of the ball."""
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
    touch: BallTouch,
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


def _contact(touch: BallTouch) -> dict[str, FloatArray]:
    """The patch under the ball, at rest, and where the ball has pushed it."""
    radius = contact_radius_m(touch.radius_m, touch.depth_m)
    away = radius * np.arange(1, RINGS + 1) / RINGS
    angle = 2.0 * np.pi * np.arange(SPOKES) / SPOKES
    aside = np.concatenate(
        [np.zeros((1, 2)), (away[:, None, None] * np.column_stack([np.cos(angle), np.sin(angle)])).reshape(-1, 2)]
    )
    sink = Tip("sphere", (2.0 * touch.radius_m,)).rise(aside * (1.0 - 1e-9)) - touch.depth_m
    rest = np.column_stack([touch.lowest_m[:2] + aside, np.full(len(aside), touch.lowest_m[2] + touch.depth_m)])
    return {"touched": rest, "touched_by": np.column_stack([np.zeros_like(aside), sink])}
