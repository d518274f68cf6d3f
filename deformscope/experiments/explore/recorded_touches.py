"""Touches of a recording: either an exploration named their frames, or they are found in the data of any robot's arm,
force sensor and depth camera.

It selects the frames of a recording that `touching_robot` would have used for a look and touches, so that the same
results are computed."""

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, cast

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.explore.depth_pictures import DENT_PICTURES, LOOKS
from deformscope.experiments.explore.explore import AtOnce, RecordedRobot
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.live.device_stages import ALONG_WAY, ApproachChooser
from deformscope.experiments.measured import FrameData, Looked, SetupGeometry, Touched
from deformscope.frames import ArmFrame, DepthFrame, Frame, Item, WrenchFrame, host_ns
from deformscope.recording.items import ItemSource, read_items, read_results, read_streams
from deformscope.recording.reader import Replay, read_rows
from deformscope.recording.streams import RecordingTables
from deformscope.rig.rig_file import Rig
from deformscope.robot.placement import Placement
from deformscope.robot.readings import ArmSample
from deformscope.robot.setup import CameraView, Setup
from deformscope.robot.touch import forces_at
from deformscope.stages.map.measured import LookFrames, SurfaceMeasurement, TouchFrames, TouchMeasurement
from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz, transform
from deformscope_drivers.images import depth_m
from deformscope_drivers.manual_arm.device import MANUAL

FOLLOW_S = 5.0
"""Time over which the force without contact is followed: it is short enough that a slow press is faster."""
TRAVEL_M = 0.03
"""An arm this far from the contact has left it."""
ASIDE_M, LEAST_WAY_M = 3e-3, 1e-3
"""Largest distance of the tip from the straight path to a touch. One that dents less has its direction from the way
before contact too."""
UNSEEN = 0.1
"""Largest share of the dent between the last reading before contact and the first reading in contact."""
LOADED, STILL = (0.02, 5e-5), (0.05, 2e-4)
"""Bounds of the greatest depth in time: how close to it the dent must be before and after it, as a share of the dent,
and at least [m]."""
UPRIGHT, REACHED = 0.5, 0.95
"""Least upward part of a touch's normal: within are 60 degrees; share of the set force that counts as it."""


class _Approaches(ApproachChooser):
    """The first of the two seconds before contact is free air. A hold may last long, but not during travel: then the
    force without contact differs."""

    before_s, longest_s = 2.0, 120.0
    _contact_m: FloatArray | None = None

    def see(self, item: Item) -> None:
        super().see(item)
        if not isinstance(item, ArmFrame) or item.device != self._arm:
            return
        if self._since_ns is None or self._contact_m is None:
            self._contact_m = item.position_m
        elif np.linalg.norm(item.position_m - self._contact_m) > TRAVEL_M:
            self._end()
            self._free_n = None

    @property
    def unended_ns(self) -> int | None:
        """Contact of an approach that has not ended."""
        return self._since_ns

    def _follow(self, passed_s: float) -> float:
        return 1.0 - math.exp(-passed_s / FOLLOW_S)


def find_touches(
    items: Iterable[Item], names: tuple[str, str, str], setup: SetupGeometry, options: ExploreOptions, model: str
) -> tuple[list[LookFrames | TouchFrames], list[str]]:
    """The look and the touches of a recording, and why other approaches do not count as touches.

    items: items of its devices in order of time, images need not be decoded; names: names of arm, force sensor and
    depth camera; model: the vendor's name of the arm. Raises InputError if nothing is found."""
    arm, wrench, camera = names
    chooser = _Approaches(wrench, arm)
    touches: list[TouchFrames] = []
    left_out: list[str] = []
    images_ns: list[int] = []
    arms_ns: list[int] = []
    began_ns = 0
    for item in items:
        if isinstance(item, ArmFrame) and not np.isfinite([item.position_m, item.rotation_rad]).all():
            continue  # as of a robot that lost itself for a while
        began_ns = began_ns or host_ns(item)
        chooser.see(item)
        if isinstance(item, DepthFrame) and item.device == camera:
            images_ns.append(item.stamp.host_ns)
        elif isinstance(item, ArmFrame) and item.device == arm and not touches:
            arms_ns.append(item.stamp.host_ns)
        if (frames := chooser.take()) is None:
            continue
        try:
            touches.append(_touch(frames, chooser.contact_ns, images_ns, names, setup, options))
        except InputError as error:
            left_out.append(f"approach after {(chooser.contact_ns - began_ns) / 1e9:.1f} s: {error}")
    if chooser.unended_ns is not None:
        left_out.append(f"approach after {(chooser.unended_ns - began_ns) / 1e9:.1f} s: the recording ends within it")
    if not touches:
        came = f"none of {len(left_out)} approaches, {left_out[0]}" if left_out else chooser.lacks
        raise InputError("touches of the surface in the recording", came, "its [tool] and [surface]")
    looks = [ns for ns in images_ns if arms_ns[0] <= ns < touches[0].arm_ns[0]][:LOOKS]
    if not looks:
        raise InputError("depth images of the surface before the first touch", "none", "start the recording earlier")
    arm_ns = max(ns for ns in arms_ns if ns <= looks[-1])
    lens = setup.camera.focal_px or (), setup.camera.center_px or ()
    look = LookFrames(camera, np.array(looks, np.int64), arm, arm_ns, model, *lens)
    return [look, *touches], left_out


def _touch(
    frames: Sequence[Frame],
    contact_ns: int,
    depth_ns: Sequence[int],
    names: tuple[str, str, str],
    setup: SetupGeometry,
    options: ExploreOptions,
) -> TouchFrames:
    """A touch out of an approach's frames. Raises InputError if it is no touch."""
    placement, holds = setup.placement, options.hold_s > 0.0
    states = {one.stamp.host_ns: one for one in frames if isinstance(one, ArmFrame)}
    readings = {one.stamp.host_ns: one for one in frames if isinstance(one, WrenchFrame) and one.usable}
    arm_ns, wrench_ns = np.array(list(states), np.int64), np.array(list(readings), np.int64)
    free = wrench_ns < wrench_ns[:1] + (contact_ns - wrench_ns[:1]) // 2
    at_contact = int(np.searchsorted(arm_ns, contact_ns))
    first = int(np.searchsorted(wrench_ns, contact_ns))
    if free.sum() < 3 or first == len(wrench_ns) or not 0 < at_contact < len(arm_ns) - 1:
        raise InputError("readings in free air and states of the arm around contact", "too few")
    raw_n = np.array([one.force_n[0] for one in readings.values()])
    tare_n = raw_n[free].mean(axis=0)
    T_base_ee = [
        transform(rotation_from_euler_xyz(*one.rotation_rad.tolist()), one.position_m) for one in states.values()
    ]
    newest = np.maximum(np.searchsorted(arm_ns, wrench_ns, side="right") - 1, 0)
    forces_n = [
        placement.force_on_tip_n(one - tare_n, T_base_ee[pose]) for one, pose in zip(raw_n, newest, strict=True)
    ]
    force_n = forces_at(arm_ns.tolist(), wrench_ns, forces_n)
    center_m = placement.T_surface_center(np.array(T_base_ee))[:, :3, 3]
    peak = at_contact + int(np.argmax(np.linalg.norm(force_n[at_contact:], axis=1)))
    if np.linalg.norm(force_n[-1]) > 0.5 * np.linalg.norm(force_n[peak]):
        raise InputError("a force that is zero after contact", "a remaining force, as after setting a sensor to zero")
    way_m = center_m[peak] - center_m[at_contact]
    if np.linalg.norm(way_m) < LEAST_WAY_M:
        way_m = center_m[peak] - center_m[0]
    length_m = float(np.linalg.norm(way_m))
    if length_m < LOADED[1]:
        raise InputError("an arm that moves into the surface", f"{1e3 * length_m:.2g} mm of way")
    normal = -way_m / length_m
    aside_m = np.linalg.norm(np.cross(center_m[:at_contact] - center_m[at_contact], normal), axis=1)
    start = int(np.flatnonzero(np.append(True, aside_m > ASIDE_M))[-1])
    straight_m = center_m[start : peak + 1] - center_m[start : peak + 1].mean(axis=0)
    along = np.linalg.svd(straight_m, full_matrices=False)[2][0]
    normal = along * np.sign(along @ normal)
    share = float(force_n[peak] @ normal / np.linalg.norm(force_n[peak]))
    if not share >= ALONG_WAY:
        raise InputError(
            "an arm that presses along its direction of motion", f"{share:.0%} of the force in that direction"
        )
    xy_m = (center_m[at_contact] - placement.center_offset_m * normal)[:2]
    if normal[2] < UPRIGHT or not ((xy_m > 0.0) & (xy_m < setup.size_m)).all():
        came = f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm along ({', '.join(f'{one:.1f}' for one in -normal)})"
        raise InputError("a touch of the surface from above", came)
    along_m = -(center_m @ normal)
    most_m = float(along_m[at_contact:].max())
    dent_m = most_m - float(along_m[at_contact])
    gaps_m = center_m[[at_contact, newest[first]]] - center_m[[at_contact - 1, newest[first - 1]]]
    unseen_m = float(np.linalg.norm(gaps_m, axis=1).max())
    if unseen_m > max(
        UNSEEN * dent_m, 5.0 * np.median(np.linalg.norm(np.diff(center_m[start : peak + 1], axis=0), axis=1))
    ):
        raise InputError("readings without a gap at contact", f"{1e3 * unseen_m:.2g} mm of way between two")
    before_m, after_m = (max(of * dent_m, least) for of, least in (LOADED, STILL))
    loaded = at_contact + int(np.argmax(along_m[at_contact:] >= most_m - before_m)) + 1
    still_ns = int(arm_ns[np.flatnonzero(along_m >= most_m - after_m)[-1]])
    images_ns = _within(np.array(depth_ns, np.int64), int(arm_ns[loaded - 1]), still_ns)[-DENT_PICTURES:]
    used_ns = _within(wrench_ns, int(arm_ns[start]), int(arm_ns[-1] if holds else arm_ns[loaded - 1]))
    ticks = [readings[int(ns)].stamp.device_ticks for ns in used_ns]
    return TouchFrames(
        xy_m=xy_m,
        normal=normal,
        reached=float((force_n @ normal).max()) > REACHED * options.set_force_n,
        arm=names[0],
        arm_ns=arm_ns[start:loaded],
        wrench=names[1],
        wrench_ns=used_ns,
        wrench_ticks=np.array([-1 if one is None else one for one in ticks], np.int64),
        pose_ns=_newest(arm_ns, used_ns),
        tare_n=tare_n,
        camera=names[2],
        depth_ns=images_ns,
        depth_arm_ns=_newest(arm_ns, images_ns),
        seen_ns=still_ns,
        end_ns=int(arm_ns[-1]),
        held_ns=arm_ns[loaded:] if holds else None,
    )


def _within(times_ns: IntArray, first_ns: int, last_ns: int) -> IntArray:
    return times_ns[(times_ns >= first_ns) & (times_ns <= last_ns)]


def _newest(of_ns: IntArray, at_ns: IntArray) -> IntArray:
    """The newest of some times at others."""
    return of_ns[np.maximum(np.searchsorted(of_ns, at_ns, side="right") - 1, 0)]


class RecordedTouches(AtOnce):
    """Looks and touches as they were recorded; earlier device items are skipped. given: as `RecordedRobot`

    count: number of touches; largest_force_n: largest force measured in a touch; left_out: why other approaches do not
    count as touches; asked: whether a person requested the end: no further touch is given"""

    def __init__(self, given: list[Looked | Touched], source: ItemSource, left_out: Sequence[str]) -> None:
        touched = [one for one in given if isinstance(one, Touched)]
        self.count = len(touched)
        self.largest_force_n = max(
            float(np.linalg.norm(one.data.wrench_n[int(ns), int(ticks)] - one.used.tare_n))
            for one in touched
            for ns, ticks in zip(one.used.wrench_ns, one.used.wrench_ticks, strict=True)
        )
        self._given = list(given)
        self.asked: Callable[[], bool] = lambda: False
        super().__init__(RecordedRobot(self._given))
        self.left_out, self._source = left_out, source
        source.until_ns = source.start_ns

    def carry_out(self, command: object, keep: Callable[[], object]) -> Future[Any]:
        if self.asked():
            self._given.clear()
        done = super().carry_out(command, keep)
        if not done.exception() and (used := getattr(done.result(), "used", None)) is not None:
            self._source.until_ns = int(used.depth_ns[-1] if isinstance(used, LookFrames) else used.end_ns)
            while keep():
                pass
        return done

    def rest(self) -> list[Item]:
        """Device items after the last touch, in portions."""
        self._source.until_ns = math.inf
        return self._source.take(0.0)


def recorded_setup(path: Path, rig: Rig, options: ExploreOptions) -> tuple[Setup, RecordedTouches]:
    """A recording's arm as a setup that is explored. Raises InputError if it made no touch."""
    replay, streams = Replay(path, trust=True), read_streams(path, trust=True)
    names: list[str] = []
    for kind in ("arm", "wrench", "depth"):
        camera = rig.camera.device if kind == "depth" else ""
        found = [one.device for one in streams if one.kind == kind and camera in ("", one.device)]
        if len(found) != 1:
            came, hint = ", ".join(found) or "none", "in the map of its import"
            raise InputError(f"one {kind} device in the recording", came, hint, path)
        names += found
    T_base_surface = np.array(rig.surface.T_arm_surface, dtype=np.float64)
    T_surface_camera = np.linalg.inv(T_base_surface) @ np.array(rig.camera.T_arm_camera)
    view = rig.camera
    source = ItemSource(read_items(path, trust=True), streams, RecordingTables(replay).start_ns)
    setup = Setup(
        size_m=rig.surface.size_m,
        placement=Placement(T_base_surface, rig.tool),
        workspace=rig.workspace,
        camera=CameraView(view.focal_px, view.center_px, view.distortion, T_surface_camera, view.doubt_m),
        open_source=lambda: cast(Any, source),
        names=(names[0], names[1], names[2]),
        compliance_m_per_n=rig.tool.compliance_m_per_n or 0.0,
        compliance_sd=rig.tool.compliance_sd,
        simulated=bool(replay.settings.get("simulated")),
        runs_itself=False,
        clock=lambda: source.now_ns,
    )
    model = next((getattr(one.config, "model", None) for one in rig.devices if one.name == names[0]), None) or MANUAL
    kinds = (ArmFrame, WrenchFrame, DepthFrame)
    items = (row.item for row in read_rows(replay, kinds, lambda encoded, which: encoded))
    named, left_out = find_touches(items, setup.names, SetupGeometry.of(setup), options, model)
    return setup, RecordedTouches(frame_inputs(path, named), source, left_out)


def recorded_inputs(path: Path) -> list[Any]:
    """The look and the touches of a recording, in their order, in the form of `ExplorationStages`.

    Raises InputError if a named frame is not in the recording."""
    kinds = (LookFrames, SurfaceMeasurement, TouchFrames, TouchMeasurement)
    inputs: list[Any] = [row.item for row in read_results(path, kinds, trust=True)]
    named = [one for one in inputs if isinstance(one, LookFrames | TouchFrames)]
    return frame_inputs(path, named) if named else inputs


def frame_inputs(path: Path, named: list[Any]) -> list[Any]:
    """Looks and touches with the content of the frames that they name, which a recording holds."""
    data = _frames(path, named)
    return [Looked(one, data) if isinstance(one, LookFrames) else Touched(one, data) for one in named]


def _frames(path: Path, named: list[Any]) -> Any:
    """Content of the named frames."""
    images, states, readings = set[int](), set[int](), set[tuple[int, int]]()
    for one in named:
        images.update(map(int, one.depth_ns))
        if isinstance(one, LookFrames):
            states.add(one.arm_ns)
            continue
        held_ns = [] if one.held_ns is None else one.held_ns
        times_ns = np.concatenate([one.arm_ns, one.pose_ns, one.depth_arm_ns, held_ns, [one.end_ns]])
        states.update(map(int, times_ns))
        readings.update(zip(map(int, one.wrench_ns), map(int, one.wrench_ticks), strict=True))
    depths: dict[int, Any] = {}
    poses: dict[int, ArmSample] = {}
    forces: dict[tuple[int, int], Any] = {}
    devices = {one.camera for one in named} | {one.arm for one in named}
    devices |= {one.wrench for one in named if not isinstance(one, LookFrames)}
    for item in read_items(path, trust=True, kinds=(DepthFrame, ArmFrame, WrenchFrame)):
        match item:
            case DepthFrame() if item.stamp.host_ns in images and item.device in devices:
                depths[item.stamp.host_ns] = depth_m(item.depth.astype(np.uint16, copy=False), item.unit_m)
            case ArmFrame() if item.stamp.host_ns in states and item.device in devices:
                pose = transform(rotation_from_euler_xyz(*item.rotation_rad.tolist()), item.position_m)
                joints_deg = tuple(item.joint_deg.tolist())
                poses[item.stamp.host_ns] = ArmSample(item.stamp.host_ns, pose, joints_deg, item.queued)
            case WrenchFrame() if item.device in devices:
                ticks = -1 if item.stamp.device_ticks is None else item.stamp.device_ticks
                if (item.stamp.host_ns, ticks) in readings:
                    forces[item.stamp.host_ns, ticks] = item.force_n[0]
    missing = len(images - set(depths)), len(readings - set(forces)), len(states - set(poses))
    if any(missing):
        came = "without {} depth images, {} forces and {} states of the arm".format(*missing)
        raise InputError("a recording of every frame that was used", came, "deformscope verify", path)
    return FrameData(depths, poses, forces)
