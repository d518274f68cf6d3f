"""From frames to measurements: the same functions during an exploration, and in its replay."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.config.explore import BORDER_M
from deformscope.errors import InputError
from deformscope.experiments.explore.options import (
    ABOVE_M,
    EDGE_M,
    LOW_SHARE,
    LOW_UNSTATED,
    VIEW_CELL_M,
    ExploreOptions,
)
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.description import AS_CAPSULES, RobotDescription, arm_shape
from deformscope.robot.placement import Placement, follow
from deformscope.robot.readings import ArmSample
from deformscope.robot.setup import CameraView, Setup
from deformscope.robot.supervisor import Limits
from deformscope.robot.touch import STILL_S, TouchPlan, centers_of, forces_at
from deformscope.robot.travel import NotThere, find_way
from deformscope.stages.map.measured import LookFrames, SurfaceMeasurement, TouchFrames, TouchMeasurement
from deformscope.stages.map.perception import force_pose
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.poke.layer_seen import AROUND_M, WITHIN_M, TableSeen, find_table
from deformscope.stages.regions.touches import GAIN_SD, MapGrid, TouchErrorModel
from deformscope.stages.see.cloud import Box, Intrinsics, Perceived, perceive
from deformscope.stages.see.pixel_labels import SeenPixels
from deformscope.stages.see.robot import PosedRobot
from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.arms import chain_of

LINK_MARGIN_M, STICK_MARGIN_M = 0.012, 0.005
"""Margin removed around the arm's links, whose shape is approximate, and around stick and ball. The latter is four
standard deviations of a depth at 0.8 m (0.9 mm), plus the arm's deflection (0.6 mm). A dent is seen best within 2 cm of
the ball."""
DENT_M = 0.08
"""Half the side of the observed area around a dent."""
SOFT_STOP_SHARE = 0.75
"""Largest set force, as a share of the soft stop: noise and overshoot must not reach it."""
DWELL_S, DWELL_AT_MOST_S = 0.5, 3.0
"""Time at rest during a touch, and the largest such time after the requested hold."""
COARSE_M = 0.02
"""Spacing of places for which it is computed whether the tip reaches them; each represents the cells around it."""
UPRIGHT = np.array([0.0, 0.0, 1.0])

HOP_M, HOP_SPEED_M_S, HOP_PASSING_M, HOP_BRAKING_PER_S = 0.02, 0.05, 2e-3, 8.0
"""Over a known surface: the tip's height before and after a touch, its speeds down and up, its accuracy at the start,
and its deceleration. Chosen."""
HOP_MARGIN_M, HOP_SLOW_M = 5e-3, 0.015
"""Height above the surface from which it is slow; the first touch uses the larger one, above the measured height. If it
may be higher than that, all is as at a careful pace. Chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameData:
    """The contents of frames by their times on the host's clock [ns]; a reading of force by time and device's ticks.

    depth_m: (H, W); arm: states; wrench_n: (3,) force before any tare, in the tip's frame"""

    depth_m: Mapping[int, npt.NDArray[np.floating]]
    arm: Mapping[int, ArmSample]
    wrench_n: Mapping[tuple[int, int], npt.NDArray[np.floating]]

    def __reduce__(self) -> tuple[Any, ...]:
        # A few arrays to another process: thousands of small ones keep Python's lock, and the robot waiting, for 0.2 s.
        poses = list(self.arm.values())
        return _frame_data, (
            self.depth_m,
            np.array([(pose.time_ns, pose.fifo_count) for pose in poses], np.int64).reshape(-1, 2),
            np.array([pose.T_base_ee for pose in poses], float).reshape(-1, 4, 4),
            [pose.joints_deg for pose in poses],
            np.array(list(self.wrench_n), np.int64).reshape(-1, 2),
            np.concatenate([np.zeros(0), *self.wrench_n.values()]).reshape(-1, 3),
        )


def _frame_data(
    depth_m: Mapping[int, npt.NDArray[np.floating]],
    numbers: IntArray,
    poses: FloatArray,
    joints_deg: Sequence[tuple[float, ...]],
    readings: IntArray,
    wrench_n: FloatArray,
) -> FrameData:
    arm = {
        when: ArmSample(when, pose, joints, fifo)
        for (when, fifo), pose, joints in zip(numbers.tolist(), poses, joints_deg, strict=True)
    }
    return FrameData(depth_m, arm, dict(zip(map(tuple, readings.tolist()), wrench_n, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """A look at the surface. used: its frames, named; data: its values"""

    used: LookFrames
    data: FrameData


@dataclass(frozen=True, slots=True, eq=False)
class Touched:
    """A touch. used: its frames, by the name of their use; data: its values"""

    used: TouchFrames
    data: FrameData


def highest_m(options: ExploreOptions) -> float:
    """Height of the tip's middle above all objects that a camera may find on the table [m]."""
    return options.thickness_m + ABOVE_M + options.standoff_m + options.tip_radius_m + options.lift_m


def sample_box(size_m: tuple[float, float], thickness_m: float, low_share: float = LOW_SHARE) -> Box:
    """Box of the sample's surface without its edges, where the camera may see its sides."""
    low = (EDGE_M, EDGE_M, low_share * thickness_m)
    return Box(low, (size_m[0] - EDGE_M, size_m[1] - EDGE_M, thickness_m + ABOVE_M))


@dataclass(frozen=True, slots=True, eq=False)
class SetupGeometry:
    """Poses of surface, arm and camera relative to each other, and their consequences; pure.

    compliance_m_per_n, compliance_sd: the arm's compliance under a push and its deviation [m/N]; described: shape of
    the robot"""

    size_m: tuple[float, float]
    placement: Placement
    workspace: Workspace
    camera: CameraView
    compliance_m_per_n: float
    compliance_sd: float
    described: RobotDescription = AS_CAPSULES

    @classmethod
    def of(cls, setup: Setup) -> "SetupGeometry":
        give = setup.compliance_m_per_n, setup.compliance_sd
        return cls(setup.size_m, setup.placement, setup.workspace, setup.camera, *give, setup.described)

    def as_json(self) -> dict[str, Any]:
        """The geometry for a recording's settings."""
        values = {name: getattr(self, name) for name in ("size_m", "compliance_m_per_n", "compliance_sd")}
        values |= {name: dataclasses.asdict(getattr(self, name)) for name in ("workspace", "camera")}
        if self.described is not AS_CAPSULES:
            values["described"] = self.described.as_json()
        values["tool"], values["T_base_surface"] = (
            dataclasses.asdict(self.placement.tool),
            self.placement.T_base_surface,
        )
        return msgspec.json.decode(msgspec.json.encode(values, enc_hook=lambda array: array.tolist()))  # type: ignore[no-any-return]

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> "SetupGeometry":
        """The reverse of `as_json`. Raises InputError where something is missing."""
        try:
            camera: dict[str, Any] = {}
            for name, value in given["camera"].items():
                camera[name] = tuple(value) if isinstance(value, list) else value
            stands = camera.pop("T_surface_camera")
            view = CameraView(**camera, T_surface_camera=None if stands is None else np.array(stands))
            width, depth = given["size_m"]
            return cls(
                (float(width), float(depth)),
                Placement(np.array(given["T_base_surface"]), msgspec.convert(given["tool"], Tool)),
                msgspec.convert(given["workspace"], Workspace),
                view,
                given["compliance_m_per_n"],
                given["compliance_sd"],
                RobotDescription.from_json(given["described"]) if "described" in given else AS_CAPSULES,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                "a recording with its setup", f"{type(error).__name__}: {error}", "explore again"
            ) from error

    @property
    def arm(self) -> ArmCompliance:
        return ArmCompliance(self.compliance_m_per_n, self.compliance_sd)

    @property
    def touch_error(self) -> TouchErrorModel:
        """Errors of touches, with the calibrated error of the force sensor's gain, or else that of any sensor."""
        tool = self.placement.tool
        known_to = GAIN_SD if tool.force_gain_sd is None else tool.force_gain_sd
        return TouchErrorModel(gain_sd=known_to, noise_n=tool.force_noise_n, off_n=tool.force_off_n)

    # What was measured ------------------------------------------------------------------------------------------------

    def surface(self, looked: Looked, options: ExploreOptions) -> SurfaceMeasurement:
        """The surface before any touch, without the robot."""
        used, box = looked.used, self._box(options)
        pose = looked.data.arm[used.arm_ns]
        clouds = [
            self._perceived(looked.data.depth_m[int(when)], pose, used, box, VIEW_CELL_M) for when in used.depth_ns
        ]
        return SurfaceMeasurement(
            points_m=np.concatenate([cloud.points_m for cloud in clouds]),
            noise_m=np.concatenate([cloud.noise_m for cloud in clouds]),
            table=None if options.thickness_stated else self._table(looked, box),
            pixels=_pixels(used.camera, used.depth_ns, clouds, options),
        )

    def _box(self, options: ExploreOptions) -> Box:
        share = LOW_SHARE if options.thickness_stated else LOW_UNSTATED
        return sample_box(self.size_m, options.thickness_m, share)

    def _table(self, looked: Looked, box: Box) -> TableSeen | None:
        """The table under the surface, as measured around it."""
        used = looked.used
        low = (box.low_m[0] - AROUND_M, box.low_m[1] - AROUND_M, -WITHIN_M)
        around = Box(low, (box.high_m[0] + AROUND_M, box.high_m[1] + AROUND_M, box.high_m[2]))
        pose, depth_m = looked.data.arm[used.arm_ns], looked.data.depth_m
        clouds = [self._perceived(depth_m[int(when)], pose, used, around, VIEW_CELL_M) for when in used.depth_ns]
        return find_table(np.concatenate([cloud.points_m for cloud in clouds]), self.size_m)

    def touch(self, touched: Touched, options: ExploreOptions) -> TouchMeasurement:
        """Readings of arm and force sensor, without the dent."""
        used, data = touched.used, touched.data
        held_ns: IntArray = np.zeros(0, np.int64) if used.held_ns is None else used.held_ns
        arms = [data.arm[int(when)] for when in (*used.arm_ns, *held_ns)]
        time_s, position_m = centers_of(arms, self.placement)
        forces_n = [
            self.placement.force_on_tip_n(
                data.wrench_n[int(when), int(ticks)] - used.tare_n, data.arm[int(pose)].T_base_ee
            )
            for when, ticks, pose in zip(used.wrench_ns, used.wrench_ticks, used.pose_ns, strict=True)
        ]
        force_n = forces_at([arm.time_ns for arm in arms], used.wrench_ns, forces_n)
        loading = held = None
        if used.held_ns is not None:
            loading, held = len(used.arm_ns), int(np.searchsorted(1e9 * time_s, used.seen_ns, side="right"))
        poses_and_forces = None
        if options.perception and forces_n:
            states = np.unique(np.concatenate([used.arm_ns, used.pose_ns, [used.end_ns]]))
            T = self.placement.T_surface_center(np.array([data.arm[int(when)].T_base_ee for when in states]))
            poses_and_forces = force_pose(used.wrench_ns, np.array(forces_n), states, T)
        return TouchMeasurement(
            xy_m=used.xy_m,
            normal=used.normal,
            time_s=time_s,
            position_m=position_m,
            force_n=force_n,
            after_m=np.zeros((0, 3)),
            reached=used.reached,
            seen_ns=used.seen_ns,
            loading=loading,
            held=held,
            force_pose=poses_and_forces,
        )

    def dent(self, touched: Touched, look: LookFrames, options: ExploreOptions) -> tuple[FloatArray, SeenPixels | None]:
        """(k, 3) points measured around a place during the press, of all images [m], and their pixels, None unless
        requested."""
        used, box = touched.used, self._box(options)
        low = (*np.maximum(box.low_m[:2], used.xy_m - DENT_M), box.low_m[2])
        high = (*np.minimum(box.high_m[:2], used.xy_m + DENT_M), box.high_m[2])
        seen, seen_ns = [], []
        for when, pose in zip(used.depth_ns, used.depth_arm_ns, strict=True):
            with contextlib.suppress(InputError):  # nothing but the robot is there
                depth_m, pose_then = touched.data.depth_m[int(when)], touched.data.arm[int(pose)]
                seen.append(self._perceived(depth_m, pose_then, look, Box(low, high), cell_m=None))
                seen_ns.append(when)
        if not seen:
            return np.zeros((0, 3)), None
        pixels = _pixels(used.camera, np.array(seen_ns, np.int64), seen, options)
        return np.concatenate([cloud.points_m for cloud in seen]), pixels

    def _perceived(
        self, depth_m: npt.NDArray[np.floating], pose: ArmSample, look: LookFrames, box: Box, cell_m: float | None
    ) -> Perceived:
        if self.camera.T_surface_camera is None:
            raise InputError("[camera] T_arm_camera", "none", "the camera's pose")
        (fx, fy), (cx, cy) = look.focal_px, look.center_px
        camera = Intrinsics((fx, fy), (cx, cy), self.camera.distortion)
        robot = self.posed_robot(pose, chain_of(look.arm_model))
        return perceive(depth_m, camera, self.camera.T_surface_camera, box, robot=robot, cell_m=cell_m)

    def posed_robot(self, pose: ArmSample, chain: Chain | None) -> PosedRobot:
        """The volume of arm, gripper, stick and cables at the arm's reported pose, surface frame; for an arm without a
        chain, only the parts at its end."""
        T_base_links = pose.T_base_ee[None] if chain is None else chain.forward(pose.joints_deg)
        described = self.described
        capsules = arm_shape(
            self.placement,
            T_base_links,
            self.placement.T_surface_center(pose.T_base_ee)[:3, 3],
            description=described,
            link_margin_m=LINK_MARGIN_M,
            stick_margin_m=STICK_MARGIN_M,
        )
        return PosedRobot(
            capsules,
            described.solids(self.placement, T_base_links),
            margin_m=self.camera.doubt_m,
            solid_margin_m=described.margin_m,
            aligns=described.whole and described.removal == "mesh",
            mixes=described.removal != "capsules",
        )

    # Where it can touch -----------------------------------------------------------------------------------------------

    def more_force_n(self, options: ExploreOptions) -> float | None:
        """Force of a touch whose dent stays small; None if the soft stop does not allow more."""
        more_n = min(options.second_force_n, SOFT_STOP_SHARE * self.workspace.soft_stop_n)
        return more_n if more_n > options.set_force_n else None

    def plan(
        self,
        xy_m: FloatArray,
        height_m: float,
        normal: FloatArray,
        over_m: float | None,
        options: ExploreOptions,
        known_m: float | None = None,
    ) -> TouchPlan:
        """A touch of a place (2,) [m] whose surface was seen at this height, with the unit normal (3,).

        over_m: greatest height of the surface on the straight path, None = unknown: then the greatest height of any
        obstacle; known_m: uncertainty of the surface's height there, None = measured, before any touch; at a quick pace
        the motion is slow within it"""
        highest, standoff_m, quick = highest_m(options), options.standoff_m, dict[str, float]()
        still_s = DWELL_S
        if options.pace == "quick":
            quick |= {"far_speed_m_s": HOP_SPEED_M_S, "travel_speed_m_s": self.workspace.travel_speed_m_s}
            quick |= {"passing_m": HOP_PASSING_M, "braking_per_s": HOP_BRAKING_PER_S}
            still_s = STILL_S if options.beta_model == "none" else DWELL_S
            if known_m is None:
                quick["slow_within_m"] = HOP_SLOW_M
            elif (slow_m := known_m + HOP_MARGIN_M) <= HOP_SLOW_M:
                quick["slow_within_m"], standoff_m = slow_m, HOP_M + self.camera.doubt_m
        if over_m is not None:
            highest = min(over_m + options.lift_m + standoff_m + self.placement.center_offset_m, highest)
        tool = self.placement.tool
        plan = TouchPlan(
            np.append(xy_m, height_m + options.lift_m),
            np.asarray(normal, np.float64),
            contact_force_n=tool.contact_n,
            noise_n=tool.force_noise_n,
            set_force_n=options.set_force_n,
            more_force_n=self.more_force_n(options),
            max_depth_m=options.max_depth_m,
            standoff_m=standoff_m,
            travel_height_m=highest,
            tangential=options.tangential,
            dwell_s=max(options.hold_s, still_s),
            dwell_at_most_s=options.hold_s + DWELL_AT_MOST_S,
            slow_back=options.hold_s > 0.0,
            **quick,
        )
        return plan.no_faster(self.workspace.contact_speed_m_s, self.workspace.travel_speed_m_s)

    def plan_led(
        self,
        xy_m: FloatArray,
        height_m: float,
        normal: FloatArray,
        over_m: float | None,
        options: ExploreOptions,
        chain: Chain | None,
        joints_deg: npt.ArrayLike,
        known_m: float | None = None,
    ) -> TouchPlan:
        """A touch along the normal, or upright if the arm cannot move along the normal: joint limits and singularities
        depend on the tilt. A person who places a stick without a chain holds it upright. Raises NotThere if there is no
        way within the workspace."""
        along = self.plan(xy_m, height_m, normal, over_m, options, known_m)
        upright = self.plan(xy_m, height_m, UPRIGHT, over_m, options, known_m)
        if chain is None:
            return upright
        if self._lead([along], chain, joints_deg).all():
            with contextlib.suppress(NotThere):
                return self._with_a_way(along, chain, joints_deg)
        return self._with_a_way(upright, chain, joints_deg)

    def _with_a_way(self, plan: TouchPlan, chain: Chain, joints_deg: npt.ArrayLike) -> TouchPlan:
        """The plan. Raises NotThere where the arm cannot travel to its place."""
        crossing_m, above_m, deepest_m = plan.places_m(self.placement.center_offset_m)
        find_way(
            chain,
            self.placement,
            Limits.of(self.workspace),
            joints_deg,
            above_m,
            plan.normal,
            height_m=float(crossing_m[2]),
            deepest_m=deepest_m,
            clearance=ArmClearance(self.placement, chain.forward(chain.home_deg)),
        )
        return plan

    def reachable(
        self, grid: MapGrid, options: ExploreOptions, chain: Chain | None, joints_deg: npt.ArrayLike
    ) -> BoolArray:
        """(rows, columns) cells that the tip can reach with the stick upright, down to the depth of a touch, without a
        margin at the border; without a chain, all cells except the margin."""
        if chain is None:
            return off_the_border(grid, options.border_m)
        rows, columns = grid.shape
        every = max(1, round(COARSE_M / grid.cell_m))
        row, column = np.arange(0, rows, every), np.arange(0, columns, every)
        middle = 0.5 * every
        x, y = np.meshgrid((column + middle) * grid.cell_m, (row + middle) * grid.cell_m)
        height_m = options.thickness_m
        places = [np.array(xy) for xy in zip(x.flat, y.flat, strict=True)]
        plans = [self.plan(place, height_m, UPRIGHT, None, options) for place in places]
        good = self._lead(plans, chain, joints_deg).reshape(x.shape)
        inside = np.repeat(np.repeat(good, every, 0), every, 1)[:rows, :columns]
        return np.asarray(inside & off_the_border(grid, options.border_m))

    def _lead(self, plans: Sequence[TouchPlan], chain: Chain, joints_deg: npt.ArrayLike) -> BoolArray:
        """(n,) whether the arm can be led straight down from above, as deep as a touch goes at most."""
        down_m = np.array([plan.places_m(self.placement.center_offset_m)[1:] for plan in plans])
        normals = np.array([[plan.normal] for plan in plans])
        return np.asarray(follow(chain, self.placement, down_m, normals, start_deg=joints_deg).all(axis=-1))


def _pixels(camera: str, depth_ns: IntArray, clouds: Sequence[Perceived], options: ExploreOptions) -> SeenPixels | None:
    if not options.perception:
        return None
    first = np.cumsum([0, *(len(cloud.points_m) for cloud in clouds)])
    point = np.concatenate([cloud.point + before for cloud, before in zip(clouds, first, strict=False)])
    return SeenPixels(camera=camera, depth_ns=depth_ns, label=np.array([one.label for one in clouds]), point=point)


def off_the_border(grid: MapGrid, border_m: float) -> BoolArray:
    """(rows, columns) all cells except a margin at the surface's edge. A narrower margin than usual excludes fewer
    cells: considered places are corners of cells."""
    if border_m < BORDER_M:
        border_m -= 0.501 * grid.cell_m
    places = grid.centres_m
    return ((places > border_m) & (places < np.asarray(grid.size_m) - border_m)).all(axis=1).reshape(grid.shape)
