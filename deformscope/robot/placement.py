"""Where the surface, the arm and its tip are to one another.

The tip's frame has its z axis along the stick, outwards: a touch along the normal n has it at -n. Its origin is the
*centre* of the tip: of the sphere for a round tip, of the face for a flat one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.rig.rig_file import Tool
from deformscope.robot.motion import DAMPED_BELOW, OFF_COURSE, off_course
from deformscope_drivers.jaco.kinematics import (
    Chain,
    FloatArray,
    damped_joint_rates,
    jacobian_of,
    least_singular,
    pose_error,
)

TURNED_RAD = 0.7
"""An arm whose end is turned further than this from where it should be goes there joint by joint, in another of its
configurations if that is better."""
PLAN_MARGIN_DEG = 8.0
"""Planned poses have every joint so far inside its range: there it may still turn at a third of its greatest rate
towards the limit (`motion.SLOW_DEG`)."""
WAY_M = 0.01
"""Distance between the places of a route that are checked [m]. Chosen."""


@dataclass(frozen=True)
class Placement:
    """The rigid relations of base, surface, arm's end and tip.

    T_base_surface: (4, 4) surface frame to the arm's base frame [m]; tool: what the arm touches with
    Raises InputError for a transform that is not rigid.
    """

    T_base_surface: FloatArray
    tool: Tool = field(default_factory=Tool)

    def __post_init__(self) -> None:
        T = np.asarray(self.T_base_surface, dtype=float)
        rotation = T[:3, :3] if T.shape == (4, 4) else np.full((3, 3), np.nan)
        rigid = T.shape == (4, 4) and bool(np.all(np.isfinite(T)))
        if not (rigid and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0):
            raise InputError("T_base_surface (4, 4), rigid", f"{T.tolist()}", "a rotation and a translation [m]")
        object.__setattr__(self, "T_base_surface", T)

    @cached_property
    def T_ee_center(self) -> FloatArray:
        """(4, 4) centre of the tip to the arm's end [m]."""
        tool = self.tool
        T = np.eye(4)
        if tool.T_ee_tip is not None:
            T = np.array(tool.T_ee_tip, dtype=float)
        else:
            T[2, 3] = tool.length_m
        if tool.tip == "sphere":
            T[:3, 3] -= tool.radius_m * T[:3, 2]
        return T

    @cached_property
    def T_surface_base(self) -> FloatArray:
        """(4, 4) the arm's base frame to the surface frame [m]."""
        return np.asarray(np.linalg.inv(self.T_base_surface))

    @cached_property
    def _T_center_ee(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.T_ee_center))

    @property
    def center_offset_m(self) -> float:
        """From the point that touches first to the tip's centre, along the normal [m]: a sphere's radius, else 0."""
        return self.tool.radius_m if self.tool.tip == "sphere" else 0.0

    def T_surface_center(self, T_base_ee: FloatArray) -> FloatArray:
        """(4, 4) the tip's centre in the surface frame, for the pose of the arm's end in the base frame."""
        return np.asarray(self.T_surface_base @ T_base_ee @ self.T_ee_center)

    def force_on_tip_n(self, force_n: FloatArray, T_base_ee: FloatArray) -> FloatArray:
        """(3,) what the world does to the tip in the surface frame [N], from what it does to the world in its own."""
        return np.asarray(-self.T_surface_center(T_base_ee)[:3, :3] @ force_n)

    def T_base_ee(self, center_m: npt.ArrayLike, normal: npt.ArrayLike) -> FloatArray:
        """(4, 4) the arm's end in the base frame when the tip's centre (3,) [m] is here and the stick along -normal.

        center_m, normal: in the surface frame. The turn about the normal is the one nearest to the surface's x axis, so
        that it is the same for all touches on a flat surface.
        """
        out = np.asarray(normal, dtype=float)
        out = out / np.linalg.norm(out)
        across = np.array([1.0, 0.0, 0.0]) - out[0] * out
        if np.linalg.norm(across) < 1e-6:
            raise InputError("a normal that is not along x", f"{out.tolist()}", "a surface less steep")
        across /= np.linalg.norm(across)
        T = np.eye(4)
        T[:3, :3] = np.stack([across, np.cross(-out, across), -out], axis=1)
        T[:3, 3] = center_m
        return np.asarray(self.T_base_surface @ T @ self._T_center_ee)

    def to_base(self, vector: npt.ArrayLike) -> FloatArray:
        """A vector (3,) of the surface frame in the base frame."""
        return np.asarray(self.T_base_surface[:3, :3] @ np.asarray(vector, dtype=float))

    def point_in_base_m(self, point_m: npt.ArrayLike) -> FloatArray:
        """A point (3,) [m] of the surface frame in the base frame."""
        return np.asarray(self.to_base(point_m) + self.T_base_surface[:3, 3])


@dataclass(frozen=True, slots=True)
class Reach:
    """Whether the arm reaches places.

    reached: (n,) inverse kinematics converged there, every joint PLAN_MARGIN_DEG inside its range; least_singular: (n,)
    smallest singular value of the Jacobian, 0 where not reached
    """

    reached: npt.NDArray[np.bool_]
    least_singular: FloatArray


def reach(
    chain: Chain,
    placement: Placement,
    centers_m: FloatArray,
    normals: npt.ArrayLike = (0.0, 0.0, 1.0),
    *,
    start_deg: npt.ArrayLike | None = None,
    starts: int = 10,
) -> Reach:
    """Which tip centres (n, 3) [m, surface frame] the arm reaches with the stick along -normal, one or (n, 3).

    start_deg: (m,) joint angles that the search begins with for each place: where the arm comes from (default: home)
    """
    directions = np.broadcast_to(np.asarray(normals, dtype=float), (len(centers_m), 3))
    joints = chain.home_deg if start_deg is None else np.asarray(start_deg, dtype=float)
    least: list[float | None] = []
    for center_m, normal in zip(centers_m, directions, strict=True):
        found = _joints_there(chain, placement.T_base_ee(center_m, normal), joints, starts)
        least.append(None if found is None else least_singular(chain.jacobian(found)))
    return _reach(least)


def follow(
    chain: Chain,
    placement: Placement,
    centers_m: FloatArray,
    normals: npt.ArrayLike = (0.0, 0.0, 1.0),
    *,
    start_deg: npt.ArrayLike,
) -> npt.NDArray[np.bool_]:
    """Whether tip centres (n, 3) [m, surface frame] can be led to on straight ways one after the other, (n,) bool.

    start_deg: (m,) joint angles from which the first place is sought, each other one from the one before: in the
    configuration that the arm is in. The ways are looked at every WAY_M: joints keep PLAN_MARGIN_DEG, and where
    a singularity is near, its damping keeps the arm on its way (`motion.OFF_COURSE`).
    """
    directions = np.broadcast_to(np.asarray(normals, dtype=float), (len(centers_m), 3))
    places = np.hstack([centers_m, directions])
    joints_deg = np.asarray(start_deg, dtype=float)
    led: list[bool] = []
    before: FloatArray | None = None
    for place in places:
        if before is None:
            there_deg = _joints_there(chain, placement.T_base_ee(place[:3], place[3:]), joints_deg, 1)
        else:
            there_deg = _led(chain, placement, _way(before, place), joints_deg)
        led.append(there_deg is not None)
        if there_deg is not None:  # else the next one is sought from the last that was reached
            joints_deg, before = there_deg, place
    return np.array(led, dtype=bool)


def _led(chain: Chain, placement: Placement, way: FloatArray, joints_deg: FloatArray) -> FloatArray | None:
    """Joint angles (m,) at the end of a way of places with their normals (n, 6); None where it cannot be followed."""
    for place in way:
        T_base_ee = placement.T_base_ee(place[:3], place[3:])
        links = chain.forward(joints_deg)
        jacobian, twist = jacobian_of(links), pose_error(links[-1], T_base_ee)
        if off_course(jacobian, damped_joint_rates(jacobian, twist, DAMPED_BELOW), twist) > OFF_COURSE:
            return None
        there_deg = _joints_there(chain, T_base_ee, joints_deg, 1)
        if there_deg is None:
            return None
        joints_deg = there_deg
    return joints_deg


def _way(start: FloatArray, end: FloatArray) -> FloatArray:
    """Places with their normals (n, 6) on the straight way from one (6,) to another, without the first."""
    steps = max(1, math.ceil(float(np.linalg.norm(end[:3] - start[:3])) / WAY_M))
    shares = np.arange(1, steps + 1)[:, None] / steps
    return np.asarray(start + shares * (end - start))


def _joints_there(chain: Chain, T_base_ee: FloatArray, start_deg: FloatArray, starts: int) -> FloatArray | None:
    """Joint angles (n,) away from their limits, None where none were found."""
    if float(np.linalg.norm(T_base_ee[:3, 3])) > _longest_m(chain):
        return None  # many searches for nothing
    found = chain.inverse(
        T_base_ee,
        start_deg,
        position_tolerance_m=1e-4,
        rotation_tolerance_rad=1e-3,
        starts=starts,
        margin_deg=PLAN_MARGIN_DEG,
    )
    return found.joints_deg if found.converged else None


@cache
def _longest_m(chain: Chain) -> float:
    """From the base to the arm's end with all links stretched out [m]."""
    frames = [np.eye(4), *chain.forward(chain.home_deg)]
    return sum(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) for a, b in itertools.pairwise(frames))


def _reach(least: Sequence[float | None]) -> Reach:
    """Of the smallest singular values, None where a place is not reached."""
    reached = np.array([one is not None for one in least], dtype=bool)
    return Reach(reached, np.array([one or 0.0 for one in least]))


def best_joints(chain: Chain, T_base_ees: Sequence[FloatArray], tries: int = 16) -> FloatArray | None:
    """Joint angles (n,) for the first of some poses (4, 4), from which a straight way leads through the others.

    A six-joint arm has up to eight for one pose; of those found, the ones are given whose way stays furthest from
    singularities, every joint PLAN_MARGIN_DEG inside its range. None = none leads through all.
    """
    best: tuple[float, FloatArray] | None = None
    for seed in range(tries):
        start_deg = np.random.default_rng([seed, 0x1C]).uniform(0.0, 360.0, chain.joint_count) if seed else None
        found = first = chain.inverse(T_base_ees[0], start_deg, starts=1, margin_deg=PLAN_MARGIN_DEG)
        least = math.inf if first.converged else 0.0
        for T_base_ee in T_base_ees:
            found = chain.inverse(T_base_ee, found.joints_deg, starts=1, margin_deg=PLAN_MARGIN_DEG)
            least = min(least, least_singular(chain.jacobian(found.joints_deg)) if found.converged else 0.0)
        if least > 0 and (best is None or least > best[0] + 1e-6):
            best = least, first.joints_deg
    return None if best is None else best[1]


def towards(start_deg: Sequence[float], goal_deg: npt.ArrayLike, endless: npt.NDArray[np.bool_]) -> FloatArray:
    """(n,) degrees to turn from joint angles to others, the short way where a joint turns without end."""
    turn = np.asarray(goal_deg, dtype=float) - np.asarray(start_deg, dtype=float)
    return np.asarray(np.where(endless, (turn + 180.0) % 360.0 - 180.0, turn))
