"""Poses of the surface, the arm and its tip relative to each other.

The tip's frame has its z axis along the stick, outwards: a touch along the normal n has it at -n. Its origin is the
*centre* of the tip: of the sphere for a round tip, of the face for a flat one."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.rig.rig_file import Tool
from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.device import DAMPED_BELOW, OFF_COURSE

TURNED_RAD = 0.7
"""An arm whose end is further than this from its planned rotation moves joint by joint, perhaps reconfigured."""
PLAN_MARGIN_DEG = 8.0
"""Distance of every joint of a planned pose from its limits: there it may still turn at a third of its greatest rate
towards the limit (`motion.SLOW_DEG`)."""
TOLERANCES: dict[str, Any] = {
    "position_tolerance_m": 1e-4,
    "rotation_tolerance_rad": 1e-3,
    "margin_deg": PLAN_MARGIN_DEG,
}
"""Accuracy of planned poses: a third of the accuracy of reached ones (`travel.REACHED_M`, `travel.REACHED_RAD`).
Larger, the joint angles planned with are not those that the arm comes to; smaller costs iterations."""
WAY_M = 0.01
"""Distance between the places of a route that are checked [m]: at half a metre from a joint it is a turn of 1 deg.
Larger may step over a limit or a singularity between two; smaller takes longer in proportion."""


@dataclass(frozen=True)
class Placement:
    """The rigid relations of base, surface, arm's end and tip.

    T_base_surface: (4, 4) surface frame to the arm's base frame [m]; tool: the arm's. Raises InputError unless it is
    rigid."""

    T_base_surface: kinematics.FloatArray
    tool: Tool = field(default_factory=Tool)

    def __post_init__(self) -> None:
        T = np.asarray(self.T_base_surface, dtype=float)
        rotation = T[:3, :3] if T.shape == (4, 4) else np.full((3, 3), np.nan)
        rigid = T.shape == (4, 4) and bool(np.all(np.isfinite(T)))
        if not (rigid and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0):
            raise InputError("T_base_surface (4, 4), rigid", f"{T.tolist()}", "a rotation and a translation [m]")
        object.__setattr__(self, "T_base_surface", T)

    @cached_property
    def T_ee_center(self) -> kinematics.FloatArray:
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
    def T_surface_base(self) -> kinematics.FloatArray:
        """(4, 4) the arm's base frame to the surface frame [m]."""
        return np.asarray(np.linalg.inv(self.T_base_surface))

    @cached_property
    def _T_center_ee(self) -> kinematics.FloatArray:
        return np.asarray(np.linalg.inv(self.T_ee_center))

    @cached_property
    def _R_tip_force(self) -> kinematics.FloatArray:
        given = self.tool.R_tip_force
        return np.eye(3) if given is None else np.array(given, dtype=float)

    @property
    def center_offset_m(self) -> float:
        """Distance of the point that touches first to the tip's centre, along the normal [m]: a radius or 0."""
        return self.tool.radius_m if self.tool.tip == "sphere" else 0.0

    def T_surface_center(self, T_base_ee: kinematics.FloatArray) -> kinematics.FloatArray:
        """(..., 4, 4) the tip's centre in the surface frame; T_base_ee: (..., 4, 4) the arm's end in its base frame."""
        return np.asarray(self.T_surface_base @ T_base_ee @ self.T_ee_center)

    def force_on_tip_n(self, force_n: kinematics.FloatArray, T_base_ee: kinematics.FloatArray) -> kinematics.FloatArray:
        """(3,) force of the world on the tip in the surface frame [N], from the sensor's: less its gain."""
        return (
            np.asarray(-self.T_surface_center(T_base_ee)[:3, :3] @ self._R_tip_force @ force_n) / self.tool.force_gain
        )

    def weight_on_sensor_n(self, T_base_ee: kinematics.FloatArray) -> kinematics.FloatArray:
        """(3,) what the weight of the tool adds to the sensor's forces, in its axes [N]; 0 where it is not known.
        A tool that hangs pulls at the sensor, which a tip that presses compresses."""
        weight_n = np.array(self.tool.weight_n or (0.0, 0.0, 0.0))
        return np.asarray(-weight_n @ (T_base_ee @ self.T_ee_center)[:3, :3] @ self._R_tip_force)

    def T_base_ee(self, center_m: npt.ArrayLike, normal: npt.ArrayLike) -> kinematics.FloatArray:
        """(..., 4, 4) the arm's end in the base frame with the tip's centre (..., 3) [m] here, stick along -normal
        (..., 3).

        center_m, normal: in the surface frame. The turn about the normal is the nearest to the surface's x axis, so
        that it is the same for all touches on a flat surface."""
        out = np.asarray(normal, dtype=float)
        out = out / np.sqrt(kinematics.squared(out))[..., None]
        across = np.array([1.0, 0.0, 0.0]) - out[..., :1] * out
        size = np.sqrt(kinematics.squared(across))
        if (size < 1e-6).any():
            raise InputError("a normal that is not along x", f"{out.tolist()}", "a surface less steep")
        across /= size[..., None]
        center = np.asarray(center_m, dtype=float)
        T = np.zeros((*np.broadcast_shapes(center.shape, out.shape)[:-1], 4, 4))
        T[..., :3, 0], T[..., :3, 1], T[..., :3, 2] = across, kinematics.cross(-out, across), -out
        T[..., :3, 3], T[..., 3, 3] = center, 1.0
        return np.asarray(self.T_base_surface @ T @ self._T_center_ee)

    def to_base(self, vector: npt.ArrayLike) -> kinematics.FloatArray:
        """A vector (3,) of the surface frame in the base frame."""
        return np.asarray(self.T_base_surface[:3, :3] @ np.asarray(vector, dtype=float))

    def point_in_base_m(self, point_m: npt.ArrayLike) -> kinematics.FloatArray:
        """A point (3,) [m] of the surface frame in the base frame."""
        return np.asarray(self.to_base(point_m) + self.T_base_surface[:3, 3])


def follow(
    chain: kinematics.Chain,
    placement: Placement,
    centers_m: kinematics.FloatArray,
    normals: npt.ArrayLike = (0.0, 0.0, 1.0),
    *,
    start_deg: npt.ArrayLike,
    meanwhile: Callable[[], None] = lambda: None,
) -> npt.NDArray[np.bool_]:
    """Whether tip centres (..., n, 3) [m, surface frame] can be led to on straight ways one after the other, (..., n)
    bool: many routes at once cost little more than one.

    start_deg: (m,) joint angles from which the first place is solved; each other place is solved from the one before,
    in the arm's present configuration. Paths are checked every WAY_M: joints keep PLAN_MARGIN_DEG, and near a
    singularity its damping keeps the arm on its path (`commands.OFF_COURSE`).
    meanwhile: called every few milliseconds"""
    directions = np.broadcast_to(np.asarray(normals, dtype=float), np.shape(centers_m))
    places = np.concatenate([centers_m, directions], axis=-1)
    routes = places.reshape(-1, *places.shape[-2:])
    joints_deg = np.tile(np.asarray(start_deg, dtype=float), (len(routes), 1))
    led = np.zeros(routes.shape[:2], dtype=bool)
    before: kinematics.FloatArray = np.full((len(routes), 6), np.nan)
    for index in range(routes.shape[1]):
        place = routes[:, index]
        known = np.isfinite(before[:, 0])
        ways = [_way(*both) if there else both[1][None] for there, *both in zip(known, before, place, strict=True)]
        poses = [placement.T_base_ee(way[:, :3], way[:, 3:]) for way in ways]
        led[:, index], there_deg = lead(chain, poses, joints_deg, known, meanwhile)
        # what was not reached: the next one is sought from the last that was
        joints_deg = np.where(led[:, index, None], there_deg, joints_deg)
        before = np.where(led[:, index, None], place, before)
    return led.reshape(places.shape[:-1])


def lead(
    chain: kinematics.Chain,
    ways: Sequence[kinematics.FloatArray],
    joints_deg: kinematics.FloatArray,
    steered: npt.NDArray[np.bool_],
    meanwhile: Callable[[], None] = lambda: None,
) -> tuple[npt.NDArray[np.bool_], kinematics.FloatArray]:
    """Whether each of k ways can be followed (k,), and the joint angles (k, m) [deg] at their ends.

    ways: k ways, each poses (n, 4, 4) of the arm's end, base frame, WAY_M apart; joints_deg: (k, m) joint angles at
    their beginning; steered: (k,) the arm reaches each place from the one before"""
    good, joints_deg = np.ones(len(ways), dtype=bool), joints_deg.copy()
    for step in range(max(map(len, ways))):
        meanwhile()
        on = [index for index, way in enumerate(ways) if good[index] and step < len(way)]
        if not on:
            break
        T_base_ee = np.array([ways[one][step] for one in on])
        links = chain.forward(joints_deg[on])
        jacobian, twist = kinematics.jacobian_of(links), kinematics.pose_error(links[:, -1], T_base_ee)
        off = (
            kinematics.off_course(jacobian, kinematics.damped_joint_rates(jacobian, twist, DAMPED_BELOW), twist)
            > OFF_COURSE
        )
        near = np.linalg.norm(T_base_ee[:, :3, 3], axis=1) <= longest_m(chain)
        joints_deg[on], found = chain.inverse_near(T_base_ee, joints_deg[on], **TOLERANCES)
        good[on] = found & near & ~(off & steered[on])
    return good, joints_deg


def _way(start: kinematics.FloatArray, end: kinematics.FloatArray) -> kinematics.FloatArray:
    """Places with their normals (n, 6) on the straight way from one (6,) to another, without the first."""
    steps = max(1, math.ceil(float(np.linalg.norm(end[:3] - start[:3])) / WAY_M))
    shares = np.arange(1, steps + 1)[:, None] / steps
    return np.asarray(start + shares * (end - start))


@cache
def longest_m(chain: kinematics.Chain) -> float:
    """Distance from the base to the arm's end with all links stretched out [m]."""
    frames = [np.eye(4), *chain.forward(chain.home_deg)]
    return sum(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) for a, b in itertools.pairwise(frames))


def best_joints(
    chain: kinematics.Chain,
    T_base_ees: Sequence[kinematics.FloatArray],
    tries: int = 16,
    free: Callable[[kinematics.FloatArray], bool] = lambda joints_deg: True,
) -> kinematics.FloatArray | None:
    """Joint angles (n,) for the first of some poses (4, 4), from which a straight way leads through the others.

    A six-joint arm has up to eight for one pose. Returned are those whose path stays furthest from singularities, with
    every joint PLAN_MARGIN_DEG inside its range. free: whether joint angles (n,) are clear of what is around the arm.
    None = no configuration reaches all places."""
    random = [np.random.default_rng([seed, 0x1C]).uniform(0.0, 360.0, chain.joint_count) for seed in range(1, tries)]

    def near(
        T_base_ee: kinematics.FloatArray, start_deg: kinematics.FloatArray
    ) -> tuple[kinematics.FloatArray, npt.NDArray[np.bool_]]:
        targets = np.broadcast_to(T_base_ee, (tries, 4, 4))
        return chain.inverse_near(targets, start_deg, margin_deg=PLAN_MARGIN_DEG)

    first, reached = near(T_base_ees[0], np.array([chain.home_deg, *random]))
    found, least = first, np.where(reached, math.inf, 0.0)
    for T_base_ee in T_base_ees:
        found, reached = near(T_base_ee, found)
        reached &= [bool(there and free(one)) for there, one in zip(reached, found, strict=True)]
        least = np.minimum(least, np.where(reached, kinematics.least_singular(chain.jacobian(found)), 0.0))
    best = -1
    for index in np.flatnonzero(least > 0):
        best = int(index) if best < 0 or least[index] > least[best] + 1e-6 else best
    return None if best < 0 else first[best]


def towards(
    start_deg: Sequence[float], goal_deg: npt.ArrayLike, endless: npt.NDArray[np.bool_]
) -> kinematics.FloatArray:
    """(n,) degrees to turn from joint angles to others, the short way where a joint turns without end."""
    turn = np.asarray(goal_deg, dtype=float) - np.asarray(start_deg, dtype=float)
    return np.asarray(np.where(endless, (turn + 180.0) % 360.0 - 180.0, turn))
