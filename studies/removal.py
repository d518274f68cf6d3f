"""`python -m studies removal`: how well the robot is taken out of the camera's picture, on simulated ones.

python -m studies removal
python -m studies removal --layouts 4 --picture removal.png --json removal.json

Which points of foam stay, and which of the robot do.

A laboratory's robot with gripper, stick and cable (`lab.robot_body`) is seen before foam, above it and during a press.
The estimator has its rig file's description, and the camera's pose with an error.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from deformscope.arrays import BoolArray, FloatArray
from deformscope.config import flags
from deformscope.experiments.measured import DENT_M, SetupGeometry, sample_box
from deformscope.lab.depth_view import DepthView
from deformscope.lab.live_lab import LayerWorld
from deformscope.lab.ray_camera import FOAM, ROBOT, DepthViewConfig, Rendered
from deformscope.lab.scene_lab import RobotBody, described_robot
from deformscope.lab.scenes import built_in
from deformscope.pictures.figures import canvas, png_of
from deformscope.pictures.report import Figure, Table
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.robot.description import AS_CAPSULES, Removal, RobotDescription
from deformscope.robot.placement import Placement
from deformscope.robot.readings import ArmSample
from deformscope.robot.setup import T_BASE_SURFACE, CameraView
from deformscope.stages.see.cloud import Box, Intrinsics, as_seen, back_project, not_alone, within
from deformscope.stages.see.pixel_labels import PixelLabel
from deformscope.stages.see.robot import label_robot, measured
from deformscope_drivers.arm.kinematics import transform
from deformscope_drivers.depth_camera import SENSORS
from deformscope_drivers.jaco.chains import J2N6S300
from studies.kinect import observed_m
from studies.quantities import Quantity, Row, by, rows
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

Sensor = Literal["plain", "primesense", "realsense"]
About = Literal["nothing", "surface", "camera"]
Where = Literal["sample", "around a touch", "all above"]
REMOVALS: tuple[Removal, ...] = ("capsules", "hull", "mesh")
SCENE = "two-60-150"
OFF_M, OFF_RAD = 0.005, float(np.radians(1.0))
DOUBT_M: Mapping[About, float] = {"nothing": 0.0, "surface": OFF_M + 0.2 * OFF_RAD, "camera": OFF_M + 0.8 * OFF_RAD}
"""The [camera] doubt_m of this: the robot's apparent displacement at 0.2 m from the centre of the turn, or at 0.8 m."""
NOISE_PER_M: Mapping[Sensor, float] = {"plain": 1.425e-3, "primesense": 1.425e-3, "realsense": 3.75e-3}
"""Deviation of depth z is that times z^2 [m], as the cameras have it."""
DEVIATIONS, STEP_M = 4.0, 0.002
"""Points with a larger difference from the foam's depth are none of it."""
BLEEDING_PX = 2
"""Distance in pixels from the robot within which a pixel may have its depth, or one between."""
TILT_RAD = float(np.radians(10.0))
PRESSED_M = (0.002, 0.012)
ABOVE_M = 0.05
HIGHEST_M = 0.6
BORDER_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class RobotPicture:
    """One picture with the robot in it.

    depth_m: (H, W) measured; exact: without the sensor's errors; pose: pose of the arm, as it reports; center_m: (3,)
    centre of the tip; foam: (H, W) pixels that fell on foam and have its depth; robot: pixels on the robot, or within
    BLEEDING_PX of it, that do not have the depth of what is behind it; above_m: nothing of the sample is higher"""

    depth_m: FloatArray
    exact: Rendered
    pose: ArmSample
    center_m: FloatArray
    foam: BoolArray
    robot: BoolArray
    above_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RemovedPoints:
    """Points of a picture in a box. points_m: (n, 3); foam, robot: (n,) their true classes; beside: (n,) not classified
    as robot; kept: nor as outliers, which follow; seconds: that telling the robot's apart took"""

    points_m: FloatArray
    foam: BoolArray
    robot: BoolArray
    beside: BoolArray
    kept: BoolArray
    seconds: float


@dataclass(frozen=True, slots=True)
class RemovalCount:
    """One picture, seen with a sensor, with the camera's place off about something, in a box.

    foam, foam_kept: points of foam, and number of them not classified as robot; foam_outliers: how many of these the
    filter of outliers takes afterwards, as it does without a robot
    robot, robot_left: points of the robot, and how many stay after both; seconds: that telling them apart took"""

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
            return observed_m(exact, self._random)
        return SENSORS[sensor].measure(exact.depth_m, self.view.intrinsics.fx_px, self._random)

    def T_surface_camera(self, about: About) -> FloatArray:
        """(4, 4) the estimator's pose of the camera: displaced by `OFF_M` and `OFF_RAD` in random directions, turned
        about its own place or about the surface's middle."""
        T = self.view.T_world_camera
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
    beside = label_robot(cropped, robot, picture.depth_m, inside) == PixelLabel.USED
    seconds = time.process_time() - began
    kept = beside.copy()
    kept[beside] = not_alone(cropped[beside])
    return RemovedPoints(cropped, picture.foam[seen][inside], picture.robot[seen][inside], beside, kept, seconds)


@cache
def known_as(removal: Removal) -> RobotDescription:
    """The known description of the robot: of capsules neither gripper nor cable, as without [shape] in the rig file."""
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


def _grown(some: BoolArray, pixels: int) -> BoolArray:
    import cv2

    side = 2 * pixels + 1
    return np.asarray(cv2.dilate(some.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)


# As a picture --------------------------------------------------------------------------------------------------------

KEPT, TAKEN, LOST, LEFT = (104, 176, 104), (74, 96, 190), (240, 160, 30), (220, 30, 150)
DIM = 0.55


def removal_png(seed: int) -> bytes:
    """Picture of a robot that presses into foam, seen by a RealSense whose place is off by 5 mm and 1 degree."""
    import matplotlib as mpl

    scene = RemovalScene(seed)
    picture = scene.picture("realsense", pressing=True)
    T = scene.T_surface_camera("surface")
    panels: list[tuple[str, npt.NDArray[np.uint8]]] = [("content of the image", picture.exact.color)]
    for removal in REMOVALS:
        geometry = scene.geometry(T, DOUBT_M["surface"], known_as(removal))
        found = removed(picture, geometry, scene.box("all above", picture.center_m))
        columns, rows = np.rint(scene.view.pixels(_as_seen(found.points_m, T, scene))).astype(int).T
        color: npt.NDArray[np.uint8] = (DIM * picture.exact.color).astype(np.uint8)
        for which, tint in (
            (found.kept, KEPT),
            (~found.beside, TAKEN),
            (found.foam & ~found.beside, LOST),
            (found.robot & found.kept, LEFT),
        ):
            color[rows[which], columns[which]] = tint
        panels.append((f'removal = "{removal}"', color))
    with mpl.rc_context({"font.size": 9}):
        figure = canvas(10.4, 8.4, layout="constrained")
        for axes, (title, image) in zip(figure.subplots(2, 2).flat, panels, strict=True):
            axes.imshow(image)
            axes.set_title(title)
            axes.set_axis_off()
        words = ("kept", "classified as robot", "lost foam", "remaining robot")
        handles = [
            mpl.patches.Patch(color=tuple((np.array(tint) / 255.0).tolist()), label=word)
            for word, tint in zip(words, (KEPT, TAKEN, LOST, LEFT), strict=True)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
        return png_of(figure, 110)


def _as_seen(
    points_m: npt.NDArray[np.floating], T: npt.NDArray[np.floating], scene: RemovalScene
) -> npt.NDArray[np.floating]:
    """(n, 3) points where they were truly seen, from where they are taken to be."""
    back = scene.view.T_world_camera @ np.linalg.inv(T)
    return np.asarray(points_m @ back[:3, :3].T + back[:3, 3])


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RemovalCoverageConfig(StudyOptions):
    """Count the remaining points of simulated images, of foam and of a robot with gripper, stick and cable, by the
    method of removal: capsules, convex hulls (Thesis 4.4) or meshes. The camera's pose is exact, or displaced by 5 mm
    and 1 degree."""

    layouts: flags.ManyFlag = 6
    """Robots, from seed SEED on; of each, six pictures. One takes some 30 s of a core."""
    picture: flags.PictureFlag = None
    """Draw what was removed of the first robot's pictures to a PNG."""


TITLES: dict[Where, str] = {
    "sample": "In the sample's box, as explorations crop it: foam left (worst picture) / robot left (worst picture)",
    "around a touch": "Within 8 cm of the tip during a press: foam left (worst picture) / robot left (worst picture)",
}
ABOUT = {"nothing": "exact", "surface": "5 mm, 1 deg about the surface", "camera": "5 mm, 1 deg about the camera"}


def _pooled(part: str, whole: str) -> Callable[[Sequence[RemovalCount]], float]:
    """Share of all pictures' points."""
    return lambda some: float(
        sum(getattr(one, part) for one in some) / max(sum(getattr(one, whole) for one in some), 1)
    )


def _of_pictures(
    part: str, whole: str, which: Callable[[list[float]], float]
) -> Callable[[Sequence[RemovalCount]], float]:
    """That of one picture, the worst."""
    return lambda some: float(which([getattr(one, part) / max(getattr(one, whole), 1) for one in some]))


QUANTITIES: tuple[Quantity[Sequence[RemovalCount]], ...] = (
    Quantity("sensor", lambda some: some[0].sensor),
    Quantity("about", lambda some: some[0].about),
    Quantity("where", lambda some: some[0].where),
    Quantity("removal", lambda some: some[0].removal),
    Quantity("pictures", len),
    Quantity("foam_kept", _pooled("foam_kept", "foam")),
    Quantity("foam_kept_worst", _of_pictures("foam_kept", "foam", min)),
    Quantity("foam_outliers", _pooled("foam_outliers", "foam")),
    Quantity("robot_points", lambda some: sum(one.robot for one in some)),
    Quantity("robot_left", _pooled("robot_left", "robot")),
    Quantity("robot_left_worst", _of_pictures("robot_left", "robot", max)),
    Quantity("seconds", lambda some: float(np.median([one.seconds for one in some]))),
)


def removal_rows(counts: Sequence[RemovalCount]) -> list[Row]:
    """One for each condition; seconds: the median."""
    return rows(by(counts, lambda one: (one.sensor, one.about, one.where, one.removal)).values(), QUANTITIES)


def trials(options: RemovalCoverageConfig) -> list[Trials[int, list[RemovalCount]]]:
    """A robot for each seed."""
    return [Trials("robots", try_removals, reported(options.layouts, options.output.seed))]


def report(options: RemovalCoverageConfig, seconds: float, tried: Sequence[list[RemovalCount]]) -> StudyReport:
    """A table for each box, and the time."""
    lines = removal_rows([one for some in tried for one in some])
    tables = [*(_removal_table(where, lines) for where in TITLES), _time_table(lines)]
    png = removal_png(options.output.seed)
    return StudyReport(
        tables,
        {"layouts": options.layouts, "doubt_m": DOUBT_M, "rows": lines},
        (Figure(png, "Classified as robot, by method of removal"),),
        {options.picture: png},
    )


def _removal_table(where: Where, lines: Sequence[Row]) -> Table:
    """A line for each sensor and error, a column for each way."""
    chosen = {(row["sensor"], row["about"], row["removal"]): row for row in lines if row["where"] == where}
    written = []
    for sensor in NOISE_PER_M:
        for about, words in ABOUT.items():
            some = [chosen[sensor, about, removal] for removal in REMOVALS]
            points = some[0]["robot_points"] // some[0]["pictures"]
            written.append((sensor, words, points, *map(_shares, some), f"{some[-1]['foam_outliers']:.2%}"))
    return Table(written, ("camera", "error of its pose", "robot points", *REMOVALS, "then outliers"), TITLES[where])


def _shares(row: Row) -> str:
    kept = f"{row['foam_kept']:.2%} ({row['foam_kept_worst']:.2%})"
    return f"{kept} / {row['robot_left']:.2%} ({row['robot_left_worst']:.2%})"


def _time_table(lines: Sequence[Row]) -> Table:
    """Time of a picture of 640 by 480."""
    written = [
        (removal, *(f"{1e3 * _median_s(lines, where, removal):.0f}" for where in TITLES)) for removal in REMOVALS
    ]
    return Table(written, ("removal", *TITLES), "Time of a picture of 640 by 480 pixels on one core [ms]")


def _median_s(lines: Sequence[Row], where: Where, removal: Removal) -> float:
    some = sorted(row["seconds"] for row in lines if row["where"] == where and row["removal"] == removal)
    return float(some[len(some) // 2])


STUDY = Study(RemovalCoverageConfig, trials, report)
