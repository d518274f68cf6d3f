"""Touches that somebody's robot made, found in what was recorded of its arm, force sensor and depth camera.

What `touching_robot` names of a look and of touches while it makes them is named here of frames that are there already;
what is computed of them is the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from deformscope.arrays import IntArray
from deformscope.errors import InputError
from deformscope.experiments.device_stages import ALONG_WAY, ApproachChooser
from deformscope.experiments.explore import AtOnce, RecordedRobot
from deformscope.experiments.measured import Looked, SetupGeometry, Touched
from deformscope.experiments.options import ExploreOptions
from deformscope.experiments.touching_robot import DENT_PICTURES, LOOKS
from deformscope.frames import ArmFrame, DepthFrame, Frame, Item, WrenchFrame
from deformscope.recording.item_source import ItemSource
from deformscope.robot.touch import forces_at
from deformscope.stages.map.measured import LookFrames, TouchFrames
from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz, transform

BEFORE_S, FOLLOW_S, LONGEST_S = 2.0, 5.0, 120.0
"""What belongs to a touch before contact, of which the first half is free air; how fast the force without contact is
followed; how long a touch lasts at most."""
ASIDE_M, LEAST_WAY_M = 3e-3, 1e-3
"""The way to a touch is straight from where the tip is no further than this beside it. One that dents less has its
direction from the way before contact too."""
LOADED, STILL = (0.02, 5e-5), (0.05, 2e-4)
"""How far before its greatest depth a touch has come to it, and how far after it the tip still stands: as a share of
the dent, and at least [m]."""
UPRIGHT, REACHED = 0.5, 0.95
"""Least upward part of a touch's normal: within are 60 degrees; share of the set force that counts as it."""


@dataclass(frozen=True, slots=True)
class FoundTouches:
    """look, touches: frames, named; left_out: why others were no touches of the surface"""

    look: LookFrames
    touches: tuple[TouchFrames, ...]
    left_out: tuple[str, ...] = ()


def find_touches(
    items: Iterable[Item], names: tuple[str, str, str], setup: SetupGeometry, options: ExploreOptions, model: str
) -> FoundTouches:
    """The look and the touches of a recording. items: of its devices in order of time, images need not be decoded.

    names: of arm, force sensor and depth camera; model: the arm's, as the vendor calls it
    Raises InputError where there is nothing to be found.
    """
    arm, wrench, camera = names
    chooser = ApproachChooser(wrench, arm, before_s=BEFORE_S, longest_s=LONGEST_S, follow_s=FOLLOW_S)
    touches: list[TouchFrames] = []
    left_out: list[str] = []
    images_ns: list[int] = []
    arms_ns: list[int] = []
    for item in items:
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
            left_out.append(f"{(chooser.contact_ns - arms_ns[0]) / 1e9:.1f} s: {error}" if arms_ns else str(error))
    if not touches:
        came = f"none of {len(left_out)} approaches, {left_out[0]}" if left_out else chooser.lacks
        raise InputError("touches of the surface in the recording", came, "its [tool] and [surface]")
    looks = [ns for ns in images_ns if arms_ns[0] <= ns < touches[0].arm_ns[0]][:LOOKS]
    if not looks:
        raise InputError("depth images of the surface before the first touch", "none", "begin to record earlier")
    arm_ns = max(ns for ns in arms_ns if ns <= looks[-1])
    lens = setup.camera.focal_px or (), setup.camera.center_px or ()
    look = LookFrames(camera, np.array(looks, np.int64), arm, arm_ns, model, *lens)
    return FoundTouches(look, tuple(touches), tuple(left_out))


def _touch(
    frames: Sequence[Frame],
    contact_ns: int,
    depth_ns: Sequence[int],
    names: tuple[str, str, str],
    setup: SetupGeometry,
    options: ExploreOptions,
) -> TouchFrames:
    """A touch out of an approach's frames. Raises InputError for what is none."""
    placement, holds = setup.placement, options.hold_s > 0.0
    states = {one.stamp.host_ns: one for one in frames if isinstance(one, ArmFrame)}
    readings = {one.stamp.host_ns: one for one in frames if isinstance(one, WrenchFrame) and one.usable}
    arm_ns, wrench_ns = np.array(list(states), np.int64), np.array(list(readings), np.int64)
    free = wrench_ns < wrench_ns[0] + (contact_ns - wrench_ns[0]) // 2
    met = int(np.searchsorted(arm_ns, contact_ns))
    if free.sum() < 3 or not 0 < met < len(arm_ns) - 1:
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
    peak = met + int(np.argmax(np.linalg.norm(force_n[met:], axis=1)))
    way_m = center_m[peak] - center_m[met]
    if np.linalg.norm(way_m) < LEAST_WAY_M:
        way_m = center_m[peak] - center_m[0]
    length_m = float(np.linalg.norm(way_m))
    if length_m < LOADED[1]:
        raise InputError("an arm that moves into what it presses", f"{1e3 * length_m:.2g} mm of way")
    normal = -way_m / length_m
    aside_m = np.linalg.norm(np.cross(center_m[:met] - center_m[met], normal), axis=1)
    start = int(np.flatnonzero(np.append(True, aside_m > ASIDE_M))[-1])
    straight_m = center_m[start : peak + 1] - center_m[start : peak + 1].mean(axis=0)
    along = np.linalg.svd(straight_m, full_matrices=False)[2][0]
    normal = along * np.sign(along @ normal)
    share = float(force_n[peak] @ normal / np.linalg.norm(force_n[peak]))
    if not share >= ALONG_WAY:
        raise InputError("an arm that presses along its way", f"{share:.0%} of the force along it")
    xy_m = (center_m[met] - placement.center_offset_m * normal)[:2]
    if normal[2] < UPRIGHT or not ((xy_m > 0.0) & (xy_m < setup.size_m)).all():
        came = f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm along ({', '.join(f'{one:.1f}' for one in -normal)})"
        raise InputError("a touch of the surface from above", came)
    along_m = -(center_m @ normal)
    most_m = float(along_m[met:].max())
    dent_m = most_m - float(along_m[met])
    before_m, after_m = (max(of * dent_m, least) for of, least in (LOADED, STILL))
    loaded = met + int(np.argmax(along_m[met:] >= most_m - before_m)) + 1
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
    """Looks and touches as they were recorded; what the devices gave until then goes by. given: as `RecordedRobot`

    count: of touches; largest_force_n: that was measured in one
    """

    def __init__(self, given: list[Looked | Touched], source: ItemSource) -> None:
        touched = [one for one in given if isinstance(one, Touched)]
        self.count = len(touched)
        self.largest_force_n = max(
            float(np.linalg.norm(one.data.wrench_n[int(ns), int(ticks)] - one.used.tare_n))
            for one in touched
            for ns, ticks in zip(one.used.wrench_ns, one.used.wrench_ticks, strict=True)
        )
        super().__init__(RecordedRobot(list(given)))
        self._source = source
        source.until_ns = source.start_ns

    def carry_out(self, command: object, keep: Callable[[], object]) -> Future[Any]:
        done = super().carry_out(command, keep)
        used = None if done.exception() else getattr(done.result(), "used", None)
        if used is not None:
            self._source.until_ns = int(used.depth_ns[-1] if isinstance(used, LookFrames) else used.end_ns)
            while keep():
                pass
        return done

    def rest(self) -> list[Item]:
        """What the devices gave after the last touch, a portion at a time."""
        self._source.until_ns = math.inf
        return self._source.take(0.0)
