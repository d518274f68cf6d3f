"""The surface as the camera measured it before any touch, and its use for touches: targets, height of the path, and
effect of the foam's shape on stiffness."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.config.explore import BORDER_M
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.measured import off_the_border
from deformscope.stages.map.exploration import MapEstimate, SurfaceEstimate
from deformscope.stages.map.measured import SurfaceMeasurement
from deformscope.stages.map.perception import LookPerception
from deformscope.stages.map.surface import HeightMap, HeightProcess, fit_surface
from deformscope.stages.poke.contact import Z_90, ContactFit
from deformscope.stages.poke.layer_seen import KnownLayer, LayerModulus, known_layer, modulus_of
from deformscope.stages.poke.local_shape import LocalShape, ShapeShift, shape_of, shape_shift
from deformscope.stages.regions.touches import MapGrid, StiffnessSample
from deformscope.stages.see.pixel_labels import SeenPixels

CORRIDOR_M, SURE_SD = 0.02, 3.0
"""The surface under the tip's path is checked this far to either side, at its height plus this number of standard
deviations."""
LEAST_THICKNESS = 0.1
"""Least share of the stated thickness."""
CURVED_OVER_M = 0.01
"""Half width over which curvature is computed: a tip of 1 cm resolves no finer shape."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenSurface:
    """points_m: (n, 3) points seen [m, surface frame]; process, heights: Gaussian process of the heights, and its
    values on the grid; layer: the level layer that stands for the foam; on_level_layer: whether touches compare as on
    that layer even where the surface is level; pixels: number of pixels of the points, None = not requested, or no
    images"""

    grid: MapGrid
    options: ExploreOptions
    points_m: FloatArray
    process: HeightProcess
    heights: HeightMap
    layer: KnownLayer
    on_level_layer: bool
    pixels: SeenPixels | None = None

    @classmethod
    def of(
        cls, looked: SurfaceMeasurement, grid: MapGrid, options: ExploreOptions, *, on_level_layer: bool
    ) -> "SeenSurface":
        """Fit it. on_level_layer: the search needs that comparison; a narrow border needs it as well"""
        process = fit_surface(
            looked.points_m, noise_m=looked.noise_m, within_m=((0.0, 0.0), grid.size_m), outlier_sd=5.0
        )
        heights = process.on(grid)
        inner_m = heights.mean_m[off_the_border(grid, options.border_m)]
        layer = known_layer(inner_m, looked.table, stated_m=options.stated_m)
        return cls(
            grid=grid,
            options=options,
            points_m=looked.points_m,
            process=process,
            heights=heights,
            layer=layer,
            on_level_layer=on_level_layer or options.border_m < BORDER_M,
            pixels=looked.pixels,
        )

    @property
    def estimate(self) -> SurfaceEstimate:
        """The reported estimate of the surface."""
        return SurfaceEstimate(
            points_m=self.points_m,
            height_m=self.heights.mean_m,
            deviation_m=self.heights.deviation_m,
            cell_m=self.grid.cell_m,
            layer_m=self.layer.thickness_m,
            layer_sd_m=self.layer.sd_m,
        )

    @property
    def perception(self) -> LookPerception | None:
        """The input of the surface; None unless requested."""
        if not self.options.perception:
            return None
        masks = None if self.pixels is None else self.pixels.masks(self.process.used)
        return LookPerception(masks, self.process.learned, int(self.process.used.sum()))

    def aim(self, xy_m: FloatArray) -> tuple[float, FloatArray]:
        """Height of the surface at a place (2,) [m], and its unit normal (3,)."""
        return float(self.process.at(xy_m[None]).mean[0]), self.process.normals(xy_m[None])[0]

    def highest_m(self, start_m: FloatArray, goal_m: FloatArray) -> float:
        """The surface's greatest height on the straight path from a place (2,) to another [m]."""
        way = goal_m - start_m
        along = ((self.grid.centres_m - start_m) @ way / max(float(way @ way), 1e-12)).clip(0.0, 1.0)
        off_m = np.linalg.norm(self.grid.centres_m - start_m - along[..., None] * way, axis=-1)
        crossed = off_m.reshape(self.grid.shape) <= self.options.tip_radius_m + CORRIDOR_M
        return float((self.heights.mean_m + SURE_SD * self.heights.deviation_m)[crossed].max())

    def doubt_m(self, xy_m: FloatArray) -> float:
        """Deviation of the surface's height at a place (2,) [m], from its Gaussian process."""
        row, column = (xy_m[::-1] / self.grid.cell_m).astype(int)
        return SURE_SD * float(self.heights.deviation_m[row, column])

    @property
    def levels(self) -> bool:
        """Whether touches are converted to a level, wide layer: the foam is uneven, or it is requested."""
        return self.layer.uneven or self.on_level_layer

    def shape(self, xy_m: FloatArray) -> LocalShape | None:
        """Local shape of the foam at a place (2,) [m]; None where it counts as level, and no result needs its width."""
        layer, edge_m = self.layer, float(np.min([xy_m, self.grid.size_m - xy_m]))
        if layer.thickness_m is None:
            return None
        if not layer.uneven:
            return LocalShape(layer.thickness_m, edge_m=edge_m) if self.levels else None
        step = CURVED_OVER_M
        found = self.process.at(xy_m + step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]))
        above_m = found.mean - layer.table_m
        return shape_of(above_m, found.deviation, step, edge_m, LEAST_THICKNESS * self.options.thickness_m)

    def shift(self, xy_m: FloatArray, n_per_mm: float) -> ShapeShift | None:
        """Change of a log stiffness [N/mm] at a place (2,) [m] to that of the level layer; None if the surface is
        level."""
        shape, options, thickness_m = self.shape(xy_m), self.options, self.layer.thickness_m
        if shape is None or thickness_m is None:
            return None
        depth_m = 1e-3 * options.set_force_n / n_per_mm
        return shape_shift(shape, depth_m, reference_m=thickness_m, radius_m=options.tip_radius_m)

    def levelled(
        self, sample: StiffnessSample, fit: ContactFit, shift: ShapeShift
    ) -> tuple[StiffnessSample, float, LayerModulus | None]:
        """A touch converted to a level, wide layer of the stated thickness: its sample for the map, the stiffness of
        its contact [N/mm], and the layer's modulus."""
        exponent = None if sample.exponent is None else sample.exponent + shift.exponent
        log_stiffness, log_sd = sample.log_stiffness + shift.log, float(np.hypot(sample.log_sd, shift.sd))
        sample = dataclasses.replace(sample, log_stiffness=log_stiffness, log_sd=log_sd, exponent=exponent)
        log_level, own_sd = fit.log_stiffness + shift.log, float(np.hypot(fit.own_log_sd, shift.sd))
        level, low, high = (float(np.exp(log_level + sds * own_sd)) for sds in (0.0, -Z_90, Z_90))
        return sample, level, self.modulus(level, (low, high))

    def modulus(self, n_per_mm: float, interval: tuple[float, float]) -> LayerModulus | None:
        """Modulus of the level layer, from its stiffness at the set force; None if its thickness is unknown."""
        options = self.options
        return modulus_of(self.layer, n_per_mm, interval, force_n=options.set_force_n, radius_m=options.tip_radius_m)

    def with_moduli(self, maps: MapEstimate) -> MapEstimate:
        """Maps with the modulus of each level; unchanged if the thickness is unknown."""
        if self.layer.thickness_m is None:
            return maps
        level, interval = maps.level_n_per_mm, maps.level_interval_n_per_mm
        ends = np.where(maps.level_rigid[:, None] | ~np.isfinite(interval), level[:, None], interval)  # open above
        found = [
            self.modulus(float(one), (float(low), float(high))) for one, (low, high) in zip(level, ends, strict=True)
        ]
        return dataclasses.replace(
            maps,
            level_modulus_pa=np.array([one.pa for one in found if one is not None]),
            level_modulus_interval_pa=np.reshape([one.interval_pa for one in found if one is not None], (-1, 2)),
        )
