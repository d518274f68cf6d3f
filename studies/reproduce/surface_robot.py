"""The laboratory as a robot without wires, which gives the readings of a touch and a look immediately. For studies."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.explore import (
    AtOnce,
    Exploration,
    ExplorationStopped,
    Steering,
    explore,
    within_loop,
)
from deformscope.experiments.explore.explorer import ExplorationStages
from deformscope.experiments.explore.options import SHALLOW_M, VIEW_CELL_M, ExploreOptions
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.experiments.measured import off_the_border, sample_box
from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
from deformscope.lab.depth_view import DepthView
from deformscope.lab.scene_lab import slab_world
from deformscope.lab.scenes import RIGID_PA, Piece, Scene
from deformscope.lab.session_errors import TOUCHES_S, LabErrors
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld
from deformscope.rig.rig_file import Tool
from deformscope.robot.setup import Truth
from deformscope.session import SessionRecorder, run
from deformscope.solid import Capsule
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.regions.touches import MapGrid
from deformscope.stages.see.cloud import Intrinsics, perceive
from deformscope.stages.see.robot import PosedRobot
from studies.kinect import observed_m
from studies.map_score import TrueMap
from studies.reproduce.touch_clock import TouchClock
from studies.touching import Approach, Sensing, approach, force_curve

STICK_M = 0.25
TOUCH_S = TOUCHES_S / 10.0
SOFT_PA = 1e-3 * RIGID_PA
"""Modulus of the slab for the truth: soft enough for every depth, stiff enough for every force."""


def true_map(scene: Scene, options: ExploreOptions) -> TrueMap:
    """A scene's apparent stiffness, region by region and cell by cell.

    The stiffness of a place is that of a slab with this modulus everywhere and the scene's thickness, pressed in the
    same finite elements without noise. Touches far from every border and bump approach it."""
    modulus = scene.modulus_pa(scene.cells_m())
    pieces = np.array([piece.modulus_pa for piece in scene.pieces])
    pressed = (options.set_force_n, options.max_depth_m, options.tip_radius_m, scene.thickness_m, scene.poisson)
    return TrueMap(
        labels=scene.regions,
        level=_slab_log_stiffness(pieces, *pressed),
        rigid=np.array([piece.rigid for piece in scene.pieces], dtype=bool),
        log_stiffness=_slab_log_stiffness(modulus, *pressed),
    )


def _slab_log_stiffness(
    modulus_pa: FloatArray, set_force_n: float, max_depth_m: float, radius_m: float, thickness_m: float, poisson: float
) -> FloatArray:
    """(...,) log of force over depth [N/mm] on slabs of one modulus, at the set force."""
    depth_m, force_n = _slab_curve(max_depth_m, radius_m, thickness_m, poisson)
    # linear foam: the force at a depth is in proportion to the modulus
    at_n = set_force_n * SOFT_PA / modulus_pa
    within_m = PchipInterpolator(force_n, depth_m)(np.minimum(at_n, force_n[-1]))
    return np.asarray(np.log(1e-3 * set_force_n / (within_m * _deeper(at_n, force_n, depth_m))))


def _deeper(at_n: FloatArray | float, force_n: FloatArray, depth_m: FloatArray) -> FloatArray:
    """(...,) depth of a force relative to the last of these depths (n,): 1 up to the last of these forces (n,), beyond
    by the power law at their end."""
    before_n = 0.8 * force_n[-1]
    power = np.log(depth_m[-1] / np.interp(before_n, force_n, depth_m)) / np.log(force_n[-1] / before_n)
    return np.asarray(np.maximum(np.asarray(at_n) / force_n[-1], 1.0) ** power)


@lru_cache(maxsize=8)
def _slab_curve(
    max_depth_m: float, radius_m: float, thickness_m: float, poisson: float
) -> tuple[FloatArray, FloatArray]:
    """Depths [m] and forces [N] of the ball in the middle of a slab of SOFT_PA."""
    slab = Scene("homogeneous", 0, (Piece("soft", SOFT_PA),), {}, thickness_m=thickness_m, poisson=poisson)
    up = np.array([0.0, 0.0, 1.0])
    rest = np.array([*(0.5 * np.asarray(slab.size_m)), thickness_m + radius_m])
    return force_curve(SlabWorld(slab), RigidTip(radius=radius_m), rest, up, np.inf, max_depth_m)


def felt_log_stiffness(made: Approach, set_force_n: float) -> float:
    """Log of force over depth [N/mm] at the set force, without noise."""
    loading = slice(0, int(made.true_force_n.argmax()) + 1)
    force_n, depth_m = made.true_force_n[loading], made.true_depth_m[loading]
    sunk_m = np.interp(set_force_n, force_n, depth_m) * _deeper(set_force_n, force_n, depth_m)
    return float(np.log(1e-3 * set_force_n / sunk_m))


class LabRobot:
    """A simulated table with foam, seen by a camera and touched by a ball on a stick.

    scene: the true scene, without its scatter; arm: the arm as calibrated
    errors: errors of this session; truth: the scene's true values; most_force_n: the largest true contact force so far
    felt: `felt_log_stiffness` of each touch; sees: whether the camera records during the press, which only beta needs
    """

    def __init__(
        self,
        scene: Scene,
        options: ExploreOptions,
        *,
        sees: bool = True,
        sensing: Sensing | None = None,
        errors: LabErrors | None = None,
        clock: TouchClock | None = None,
    ) -> None:
        """errors: hidden errors of the session; default none; clock: counts the seconds of touches that have a plan"""
        self._clock = clock
        self.errors = (errors or LabErrors.none()).draw([options.seed, scene.seed])
        self.scene = self.errors.slab(scene)
        if any(piece.plateau_exponent for piece in scene.pieces):
            raise InputError("foam that stays linear", scene.name, f"deformscope explore lab:{scene.name}")
        foam = self.errors.foam(scene)
        self.size_m = scene.size_m
        self.arm = ArmCompliance(1.0 / ARM_STIFFNESS_N_M, ARM_DOUBT / ARM_STIFFNESS_N_M)
        self.truth = Truth(scene.regions, scene.inclusions_m)
        self.most_force_n = 0.0
        self.felt: list[float] = []
        self._options = options
        self._sensing = sensing or Sensing(
            arm_n_per_m=self.errors.arm_n_per_m,
            overshoot_m=self.errors.overshoot_m,
            friction=self.errors.friction,
            friction_rad=self.errors.friction_rad,
        )
        self._sees = sees
        self._world = slab_world(foam)
        self._view = DepthView(self.scene)
        self._tip = RigidTip(radius=options.tip_radius_m)
        self._random = np.random.default_rng([options.seed, scene.seed])

    def reachable(self, grid: MapGrid) -> BoolArray:
        """(rows, columns) mask of all cells except a margin at the border."""
        return off_the_border(grid, self._options.border_m)

    def look(self) -> SurfaceMeasurement:
        """The surface at rest, without the robot."""
        return self._see(None, ())

    def touch(self, command: Touch) -> TouchMeasurement:
        """Move down along the measured normal, and measure the dent."""
        xy_m, normal = command.xy_m, command.normal
        options = self._options
        gain = self._sensing.gain * self.errors.gain_at(len(self.felt) * TOUCH_S)
        made = approach(
            self._world,
            self._tip,
            xy_m,
            normal,
            set_force_n=options.set_force_n,
            max_depth_m=options.max_depth_m,
            second_force_n=options.second_force_n,
            shallow_m=SHALLOW_M,
            sensing=replace(self._sensing, gain=gain),
            random=self._random,
        )
        self.most_force_n = max(self.most_force_n, float(made.true_force_n.max()))
        self.felt.append(felt_log_stiffness(made, options.set_force_n))
        if self._clock is not None and command.plan is not None:
            self._clock.add(command.plan, made)
        after: FloatArray = np.zeros((0, 3))
        if self._sees:
            middle = made.position_m[-1]
            contact = self._world.press(self._tip, middle)
            moved = self._world.displaced_m(contact, self._view.places_m)
            stick = Capsule(middle, middle + STICK_M * normal, Tool().stick_radius_m)
            ball = Capsule(middle, middle, options.tip_radius_m)
            after = self._see(moved, (stick, ball)).points_m
        return TouchMeasurement(xy_m, normal, made.time_s, made.position_m, made.force_n, after, made.reached)

    def _see(self, moved_m: FloatArray | None, robot: tuple[Capsule, ...]) -> SurfaceMeasurement:
        exact = self._view.render(moved_m, robot)
        depth_m = observed_m(exact, self._random)
        seen_by = self._view.intrinsics
        camera = Intrinsics((seen_by.fx_px, seen_by.fy_px), (seen_by.cx_px, seen_by.cy_px))
        box = sample_box(self.size_m, self._options.thickness_m)
        cell = None if robot else VIEW_CELL_M
        found = perceive(
            depth_m, camera, self._view.T_world_camera, box, robot=PosedRobot(robot, margin_m=0.01), cell_m=cell
        )
        return SurfaceMeasurement(found.points_m, found.noise_m)


def explore_at_once(
    robot: LabRobot,
    stages: ExplorationStages,
    recorder: SessionRecorder,
    found: Exploration | None = None,
    steering: Steering | None = None,
) -> None:
    """Explore with a robot that gives measurements immediately. Raises ExplorationStopped. recorder: receives every
    stage's results; found: receives the touches; steering: may change the next touch"""
    found = Exploration() if found is None else found
    run([], explore(lambda: 0, within_loop(stages), found, steering=steering), recorder, AtOnce(robot))
    if found.stop is not None:
        raise ExplorationStopped(found.stop, found.stop_ns)
