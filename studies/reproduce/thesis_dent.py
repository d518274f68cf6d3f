"""The dent of a touch as the thesis sees it (4.4): the surface before and under it, each a Gaussian process.

dent = seen_dent(touched, fit, surface, arm, radius_m, cell_m)"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.beta_fit import ball_at_depth
from deformscope.experiments.explore.seen_surface import SeenSurface
from deformscope.stages.gaussian_process import ProcessPrediction
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.map.surface import HeightProcess, fit_surface
from deformscope.stages.poke.contact import ArmCompliance, ContactFit
from deformscope.stages.regions.touches import MapGrid
from deformscope.stages.see.cloud import contact_radius_m

TACTILE_POINTS = 10
"""Virtual points on the tip (Thesis 4.4)."""

GOLDEN_ANGLE = float(np.pi * (3.0 - np.sqrt(5.0)))

THESIS_ROI_M, TACTILE_NOISE_M = 0.08, 2e-4
"""Half the side of the square that the process of a dent sees, and the noise of its virtual points."""

NOISE_ROUNDS, NOISE_SETTLED = 5, 0.01
"""Rounds until the noise of the virtual points is that one, within this share."""

COARSE_GRID_M = 0.01
"""The grid around a touch of recordings without one."""

SIDE_M = 0.15
"""Side of the square around a touch (Thesis 4.4)."""

DENTED = 0.1
"""Share of the greatest depth from which a place counts as dented."""


@dataclass(frozen=True, slots=True)
class SeenDent:
    """A square of the surface around a touch, on a grid, before it and under it (Thesis 4.4).

    before, after: (p, 3) points at the same places [m]; shape: (rows, columns); cell_m: how far apart they are
    sd_m: (p,) deviation of the heights under it"""

    before: FloatArray
    after: FloatArray
    shape: tuple[int, int]
    cell_m: float = COARSE_GRID_M
    sd_m: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def sunk_m(self) -> FloatArray:
        """(p,) how far the touch lowered the surface [m]."""
        return np.asarray(self.before[:, 2] - self.after[:, 2])

    @property
    def dented_m(self) -> FloatArray:
        """(m, 2) the places that were dented [m]: all that sank by `DENTED` of the deepest."""
        sunk = self.sunk_m
        return np.asarray(self.before[sunk >= DENTED * sunk.max(), :2])


class SurfaceHeights(Protocol):
    """A surface with known heights at requested places, such as a `HeightProcess`."""

    def at(self, places_m: FloatArray) -> ProcessPrediction:
        """Prediction at places (n, 2) [m]."""


def dent_of(
    world: SurfaceHeights, touched: SurfaceHeights, place_m: FloatArray, cell_m: float = COARSE_GRID_M
) -> SeenDent:
    """The dent in a square of `SIDE_M` around a place (2,) [m]. world, touched: the surface before and under
    touch, the second with the tactile points; cell_m: cell size of the grid"""
    grid = MapGrid((SIDE_M, SIDE_M), cell_m)
    places_m = np.asarray(place_m)[:2] - 0.5 * SIDE_M + grid.centres_m
    rest, under = world.at(places_m), touched.at(places_m)
    before, after = (np.column_stack([places_m, one.mean]) for one in (rest, under))
    return SeenDent(before, after, grid.shape, cell_m, under.deviation)


def seen_dent(
    touched: TouchMeasurement, fit: ContactFit, surface: SeenSurface, arm: ArmCompliance, radius_m: float, cell_m: float
) -> SeenDent:
    """The dent of a touch that is not rigid: the surface under it is a process of its own, of the points seen and of
    virtual points where the ball is. radius_m: radius of the ball; cell_m: spacing of the dent's places"""
    ball = ball_at_depth(touched, fit, arm, radius_m)
    tactile = tactile_points(ball.lowest_m, ball.radius_m, ball.depth_m, normal=touched.normal)
    near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < THESIS_ROI_M
    return dent_of(surface.process, with_tactile(touched.after_m[near], tactile), touched.xy_m, cell_m)


def with_tactile(seen_m: FloatArray, tactile_m: FloatArray) -> HeightProcess:
    """The surface through points that were seen (n, 3), whose noise is not known, and virtual ones (k, 3) [m].

    One factor of all noise is learned. So the share of the virtual points is set again until the learned noise at them
    is `TACTILE_NOISE_M`."""
    count, share = len(seen_m), np.ones(len(seen_m) + len(tactile_m))
    found = fit_surface(seen_m)
    for _ in range(NOISE_ROUNDS):
        share[count:] = TACTILE_NOISE_M / found.noise_m[0]
        found = fit_surface(np.concatenate([seen_m, tactile_m]), noise_m=share)
        if abs(found.noise_m[-1] / TACTILE_NOISE_M - 1.0) < NOISE_SETTLED:
            break
    return found


def tactile_points(
    lowest_m: FloatArray, radius_m: float, depth_m: float, *, normal: FloatArray | None = None
) -> FloatArray:
    """`TACTILE_POINTS` virtual points (n, 3) [m] where a ball touches, around its foremost one (Thesis 4.4).

    lowest_m: (3,) the ball's foremost point; depth_m: how far it is below where it first touched
    normal: (3,) outward unit normal of the surface at rest, default up. The points cover the contact cap evenly, and
    include its lowest point. A ball in an elastic body touches it up to about the root of radius times depth from its
    axis (Hertz), at most up to its equator."""
    if radius_m <= 0.0 or depth_m < 0.0:
        raise InputError("a ball and a depth of 0 or more", f"radius {radius_m:g} m, depth {depth_m:g} m")
    up = np.array([0.0, 0.0, 1.0]) if normal is None else np.asarray(normal, dtype=np.float64)
    up = up / np.linalg.norm(up)
    sink = 1.0 - np.sqrt(1.0 - (contact_radius_m(radius_m, depth_m) / radius_m) ** 2)
    rise = radius_m * sink * np.arange(TACTILE_POINTS) / (TACTILE_POINTS - 1)
    away = np.sqrt(np.maximum(radius_m**2 - (radius_m - rise) ** 2, 0.0))
    angle = GOLDEN_ANGLE * np.arange(TACTILE_POINTS)
    first = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    around = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return np.asarray(np.asarray(lowest_m) + rise[:, None] * up + away[:, None] * around)
