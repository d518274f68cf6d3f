"""Reach of a robot, and its readings of looks and touches, for robots that give measurements or frames."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.measured import Looked, SetupGeometry, Touched
from deformscope.robot.touch import TouchPlan
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.regions.touches import MapGrid
from deformscope.stages.see.pixel_labels import SeenPixels
from deformscope_drivers.arms import chain_of


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """A command: touch a place (2,) [m] whose surface was seen at this height, along this normal (3,).

    plan: path of the touch, for a robot that needs one"""

    xy_m: FloatArray
    height_m: float
    normal: FloatArray
    plan: TouchPlan | None = None


class Geometry(Protocol):
    """Reach of a robot, and its readings."""

    size_m: tuple[float, float]

    def look(self, looked: Any) -> SurfaceMeasurement: ...

    def reachable(self, grid: MapGrid) -> BoolArray:
        """(rows, columns) cells that the tip can touch."""

    def approach(
        self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None, known_m: float | None = None
    ) -> Touch:
        """The touch of a place (2,) [m] whose surface was seen at this height, along this normal (3,).

        over_m: how high the surface may be on the straight way from the touch before; known_m: how far the surface may
        be from this height; None = unknown"""

    def touch(self, touched: Any) -> TouchMeasurement: ...

    def dent(self, touched: Any) -> tuple[FloatArray, SeenPixels | None]:
        """(k, 3) points seen during the press, without the robot [m], and their pixels, as in `TouchMeasurement`."""


class AsMeasured:
    """Geometry of robots that give measurements rather than frames, and reach the places of `reachable`, all by
    default."""

    def __init__(self, size_m: tuple[float, float], reachable: Callable[[MapGrid], BoolArray] | None = None) -> None:
        self.size_m = size_m
        self.reachable = reachable or (lambda grid: np.ones(grid.shape, dtype=bool))

    def look(self, looked: SurfaceMeasurement) -> SurfaceMeasurement:
        return looked

    def approach(
        self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None, known_m: float | None = None
    ) -> Touch:
        return Touch(xy_m, height_m, normal)

    def touch(self, touched: TouchMeasurement) -> TouchMeasurement:
        return touched

    def dent(self, touched: TouchMeasurement) -> tuple[FloatArray, SeenPixels | None]:
        return touched.after_m, touched.pixels


class FromFrames:
    """Geometry of an arm, a force sensor and a camera: everything is computed from their frames."""

    def __init__(self, setup: SetupGeometry, options: ExploreOptions) -> None:
        self.size_m = setup.size_m
        self._setup, self._options = setup, options
        self._looked: Looked | None = None
        self._joints_deg: tuple[float, ...] = ()

    def look(self, looked: Looked) -> SurfaceMeasurement:
        self._looked, self._joints_deg = looked, looked.data.arm[looked.used.arm_ns].joints_deg
        return self._setup.surface(looked, self._options)

    def reachable(self, grid: MapGrid) -> BoolArray:
        assert self._looked is not None
        chain = chain_of(self._looked.used.arm_model)
        return self._setup.reachable(grid, self._options, chain, self._joints_deg)

    def approach(
        self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None, known_m: float | None = None
    ) -> Touch:
        assert self._looked is not None
        chain = chain_of(self._looked.used.arm_model)
        plan = self._setup.plan_led(xy_m, height_m, normal, over_m, self._options, chain, self._joints_deg, known_m)
        return Touch(xy_m, height_m, plan.normal, plan=plan)

    def touch(self, touched: Touched) -> TouchMeasurement:
        self._joints_deg = touched.data.arm[touched.used.end_ns].joints_deg
        return self._setup.touch(touched, self._options)

    def dent(self, touched: Touched) -> tuple[FloatArray, SeenPixels | None]:
        assert self._looked is not None
        return self._setup.dent(touched, self._looked.used, self._options)
