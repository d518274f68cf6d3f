"""How well the robot is taken out of the camera's picture: which points of foam stay, and which of the robot do.

A laboratory's robot with gripper, stick and cable (`lab.robot_body`) is seen before foam, above it and as it presses;
the estimator knows it as its rig file describes it, and the camera's place with an error.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from deformscope.arrays import BoolArray, FloatArray
from deformscope.experiments.measured import DENT_M, SetupGeometry, sample_box
from deformscope.lab.depth_view import DepthView
from deformscope.lab.layer_world import LayerWorld
from deformscope.lab.ray_camera import FOAM, ROBOT, DepthViewConfig, Rendered
from deformscope.lab.robot_body import RobotBody, described_robot
from deformscope.lab.scenes import built_in
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.robot.description import AS_CAPSULES, Removal, RobotDescription
from deformscope.robot.placement import Placement
from deformscope.robot.readings import ArmSample
from deformscope.robot.setup import T_BASE_SURFACE, CameraView
from deformscope.stages.see.align import as_seen
from deformscope.stages.see.cloud import Box, Intrinsics, back_project, not_alone, within
from deformscope.stages.see.robot import beside_robot, measured
from deformscope_drivers.arm.kinematics import transform
from deformscope_drivers.depth_camera import SENSORS
from deformscope_drivers.jaco.chains import J2N6S300

Sensor = Literal["plain", "primesense", "realsense"]
About = Literal["nothing", "surface", "camera"]
Where = Literal["sample", "around a touch", "all above"]
REMOVALS: tuple[Removal, ...] = ("capsules", "hull", "mesh")
SCENE = "two-60-150"
OFF_M, OFF_RAD = 0.005, float(np.radians(1.0))
DOUBT_M: Mapping[About, float] = {"nothing": 0.0, "surface": OFF_M + 0.2 * OFF_RAD, "camera": OFF_M + 0.8 * OFF_RAD}
"""What [camera] doubt_m is then: how far off the robot seems at 0.2 m from what it is turned about, or at 0.8 m."""
NOISE_PER_M: Mapping[Sensor, float] = {"plain": 1.425e-3, "primesense": 1.425e-3, "realsense": 3.75e-3}
"""Deviation of depth z is that times z^2 [m], as the cameras have it."""
DEVIATIONS, STEP_M = 4.0, 0.002
"""What differs from the foam's depth by more is none of it."""
BLEEDING_PX = 2
"""Pixels so near the robot may have its depth, or one between."""
TILT_RAD = float(np.radians(10.0))
PRESSED_M = (0.002, 0.012)
ABOVE_M = 0.05
HIGHEST_M = 0.6
BORDER_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class RobotPicture:
    """One picture with the robot in it.

    depth_m: (H, W) measured; exact: what it would be without the sensor's errors; pose: of the arm, as it reports
    center_m: (3,) of the tip; foam: (H, W) pixels that fell on foam and have its depth; robot: pixels on the robot, or
    within BLEEDING_PX of it, that do not have the depth of what is behind it; above_m: nothing of the sample is higher
    """

    depth_m: FloatArray
    exact: Rendered
    pose: ArmSample
    center_m: FloatArray
    foam: BoolArray
    robot: BoolArray
    above_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RemovedPoints:
    """Points of a picture in a box. points_m: (n, 3); foam, robot: (n,) what they truly are; beside: (n,) not taken for
    the robot's; kept: nor as outliers, which follow; seconds: that telling the robot's apart took"""

    points_m: FloatArray
    foam: BoolArray
    robot: BoolArray
    beside: BoolArray
    kept: BoolArray
    seconds: float


@dataclass(frozen=True, slots=True)
class RemovalCount:
    """One picture, seen with a sensor, with the camera's place off about something, in a box.

    foam, foam_kept: points of foam, and how many of them are not taken for the robot's; foam_outliers: of these, how
    many the filter of outliers takes afterwards, as it does without a robot
    robot, robot_left: points of the robot, and how many stay after both; seconds: that telling them apart took
    """

    sensor: Sensor
    about: About
    where: Where
    removal: Removal
    foam: int
    foam_kept: int
    foam_outliers: int
    robot: int
    robot_left: int
    seconds: float


class RemovalScene:
    """A table with a robot over it, drawn by a seed."""

    def __init__(self, seed: int) -> None:
        scene = built_in(SCENE, seed)
        self.view = DepthView(scene, DepthViewConfig(azimuth_deg=-90.0))
        self._placement = Placement(T_BASE_SURFACE, Tool())
        self._body = RobotBody(seed)
        self._world = LayerWorld(scene, self._placement.tool.radius_m)
        self._random = np.random.default_rng([seed, 0x2E0])

    def picture(self, sensor: Sensor, *, pressing: bool) -> RobotPicture:
        """At a random place, with the stick a little tilted: pressing, or above it."""
        scene, random, tool = self.view.scene, self._random, self._placement.tool
        while True:
            xy = random.uniform(BORDER_M, np.array(scene.size_m) - BORDER_M)
            normal = Rotation.from_rotvec([*random.uniform(-TILT_RAD, TILT_RAD, 2), 0.0]).apply([0.0, 0.0, 1.0])
            depth = random.uniform(*PRESSED_M) if pressing else -ABOVE_M
            center = np.array([*xy, float(scene.foam_height_m(xy)) + tool.radius_m - depth])
            found = J2N6S300.inverse(self._placement.T_base_ee(center, normal), J2N6S300.home_deg)
            if found.converged:
                break
        moved = None
        if pressing:
            self._world.pressed = np.array([*xy, depth])
            moved = self._world.displaced_m(self.view.places_m)
        links = J2N6S300.forward(found.joints_deg)
        exact = self.view.render(moved, *self._body.seen(self._placement, links, center))
        behind_m = self.view.render(moved).depth_m
        depth_m = self._measure(exact, sensor)
        as_behind = np.abs(depth_m - behind_m) <= DEVIATIONS * NOISE_PER_M[sensor] * behind_m**2 + STEP_M
        near = _grown(exact.seen == ROBOT, BLEEDING_PX)
        pose = ArmSample(0, links[-1], tuple(found.joints_deg.tolist()), 0)
        foam, robot = (exact.seen == FOAM) & as_behind, near & ~as_behind
        highest_m = self.box("sample", center).high_m[2]
        return RobotPicture(depth_m, exact, pose, center, foam, robot, highest_m)

    def _measure(self, exact: Rendered, sensor: Sensor) -> FloatArray:
        if sensor == "plain":
            return self.view.observe(exact, self._random) * self.view.config.unit_m
        return SENSORS[sensor].measure(exact.depth_m, self.view.intrinsics.fx_px, self._random)

    def T_surface_camera(self, about: About) -> FloatArray:
        """(4, 4) where the estimator takes the camera to be: off by `OFF_M` and `OFF_RAD` in random directions, turned
        about its own place or about the surface's middle."""
        T = self.view.surface_from_camera
        if about == "nothing":
            return T
        shift, axis = (one / np.linalg.norm(one) for one in self._random.standard_normal((2, 3)))
        scene = self.view.scene
        middle = T[:3, 3] if about == "camera" else np.array([*(0.5 * np.array(scene.size_m)), scene.thickness_m])
        turn = Rotation.from_rotvec(OFF_RAD * axis).as_matrix()
        return np.asarray(transform(turn, middle - turn @ middle + OFF_M * shift) @ T)

    def geometry(self, T_surface_camera: FloatArray, doubt_m: float, known: RobotDescription) -> SetupGeometry:
        """As the estimator has it."""
        lens = self.view.intrinsics
        view = CameraView(
            (lens.fx_px, lens.fy_px), (lens.cx_px, lens.cy_px), T_surface_camera=T_surface_camera, doubt_m=doubt_m
        )
        return SetupGeometry(self.view.scene.size_m, self._placement, Workspace(), view, 0.0, 0.0, known)

    def box(self, where: Where, center_m: FloatArray) -> Box:
        """Whose points are counted: the sample's as explorations crop it, around a touch, or as high as is seen."""
        box = sample_box(self.view.scene.size_m, self.view.scene.thickness_m)
        if where == "all above":
            return dataclasses.replace(box, high_m=(*box.high_m[:2], HIGHEST_M))
        if where == "sample":
            return box
        low, high = (center_m[:2] - DENT_M).tolist(), (center_m[:2] + DENT_M).tolist()
        return Box(
            (max(low[0], box.low_m[0]), max(low[1], box.low_m[1]), box.low_m[2]),
            (min(high[0], box.high_m[0]), min(high[1], box.high_m[1]), box.high_m[2]),
        )


def removed(picture: RobotPicture, geometry: SetupGeometry, box: Box) -> RemovedPoints:
    """The picture as explorations perceive it, with what each point truly is."""
    camera, T = geometry.camera, geometry.camera.T_surface_camera
    assert T is not None
    assert camera.focal_px is not None
    assert camera.center_px is not None
    points = back_project(picture.depth_m, Intrinsics(camera.focal_px, camera.center_px), np.asarray(T, np.float64))
    inside, seen = within(points, box), measured(picture.depth_m)
    cropped = points[inside]
    began = time.process_time()
    robot = as_seen(geometry.posed_robot(picture.pose, J2N6S300), points, picture.above_m)
    beside = beside_robot(cropped, robot, picture.depth_m, inside)
    seconds = time.process_time() - began
    kept = beside.copy()
    kept[beside] = not_alone(cropped[beside])
    return RemovedPoints(cropped, picture.foam[seen][inside], picture.robot[seen][inside], beside, kept, seconds)


@cache
def known_as(removal: Removal) -> RobotDescription:
    """What is known of the robot: of capsules neither gripper nor cable, as without [shape] in the rig file."""
    return AS_CAPSULES if removal == "capsules" else described_robot(removal)


def try_removals(seed: int) -> list[RemovalCount]:
    """One picture above the foam and one pressing into it, with each sensor and error."""
    return [one for sensor in NOISE_PER_M for pressing in (False, True) for one in _tried(seed, sensor, pressing)]


def _tried(seed: int, sensor: Sensor, pressing: bool) -> Iterator[RemovalCount]:
    scene = RemovalScene(seed)
    picture = scene.picture(sensor, pressing=pressing)
    boxes: tuple[Where, ...] = ("sample", "around a touch") if pressing else ("sample",)
    for about, doubt_m in DOUBT_M.items():
        T = scene.T_surface_camera(about)
        for removal in REMOVALS:
            geometry = scene.geometry(T, doubt_m, known_as(removal))
            for where in boxes:
                found = removed(picture, geometry, scene.box(where, picture.center_m))
                yield RemovalCount(
                    sensor,
                    about,
                    where,
                    removal,
                    foam=int(np.count_nonzero(found.foam)),
                    foam_kept=int(np.count_nonzero(found.foam & found.beside)),
                    foam_outliers=int(np.count_nonzero(found.foam & found.beside & ~found.kept)),
                    robot=int(np.count_nonzero(found.robot)),
                    robot_left=int(np.count_nonzero(found.robot & found.kept)),
                    seconds=found.seconds,
                )


@dataclass(frozen=True, slots=True)
class RemovalRow:
    """Shares of all pictures' points, and of those of the worst picture."""

    sensor: Sensor
    about: About
    where: Where
    removal: Removal
    pictures: int
    foam_kept: float
    foam_kept_worst: float
    foam_outliers: float
    robot_points: int
    robot_left: float
    robot_left_worst: float
    seconds: float


def removal_rows(counts: Sequence[RemovalCount]) -> list[RemovalRow]:
    """One for each condition; seconds: the median."""
    groups: dict[tuple[Sensor, About, Where, Removal], list[RemovalCount]] = {}
    for one in counts:
        groups.setdefault((one.sensor, one.about, one.where, one.removal), []).append(one)
    rows = []
    for names, some in groups.items():
        names_of_counts = ("foam", "foam_kept", "foam_outliers", "robot", "robot_left")
        foam, kept, outliers, robot, left = (np.array([getattr(one, name) for one in some]) for name in names_of_counts)
        rows.append(
            RemovalRow(
                *names,
                pictures=len(some),
                foam_kept=float(kept.sum() / foam.sum()),
                foam_kept_worst=float((kept / np.maximum(foam, 1)).min()),
                foam_outliers=float(outliers.sum() / foam.sum()),
                robot_points=int(robot.sum()),
                robot_left=float(left.sum() / max(robot.sum(), 1)),
                robot_left_worst=float((left / np.maximum(robot, 1)).max()),
                seconds=float(np.median([one.seconds for one in some])),
            )
        )
    return rows


def _grown(some: BoolArray, pixels: int) -> BoolArray:
    import cv2

    side = 2 * pixels + 1
    return np.asarray(cv2.dilate(some.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)
