"""Shapes of arm, gripper and cables by the rig file: they are removed from the camera's image.

    described = describe(section, chain, folder)                # once, from the rig file's [shape]
    described.solids(placement, T_base_links)                   # in the surface frame, for one pose
    described.cable_capsules(placement, T_base_links)

A part belongs to a frame of the arm: 0 its base, i the link behind joint i, -1 its end. No file is read later: a
recording contains the triangles."""

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deformscope.errors import InputError
from deformscope.rig.sections import ShapeSection
from deformscope.robot.placement import Placement
from deformscope.robot.urdf_shapes import UrdfShapes, read_urdf
from deformscope.solid import Capsule, PosedSolid, Solid
from deformscope_drivers.arm.kinematics import Chain, FloatArray

Removal = Literal["capsules", "hull", "mesh"]
SAME_M, SAME_RAD = 1e-3, 5e-3
"""Largest change of the pose of a URDF's links relative to the arm's chain from one pose to another [m, rad]: the
effect of rounded lengths and angles. Another model, or joints in another order, differ by centimetres; a larger limit
would accept a similar model, whose parts are far from the arm's."""
TRIED_DEG = (0.0, 17.0, -23.0)
"""Joint angles from home for comparing a URDF with the arm's chain. Angles that are tried: each joint turns a tenth
more than the one before, so that exchanged or reversed joints displace some link."""


@dataclass(frozen=True, slots=True, eq=False)
class DescribedPart:
    """A rigid part. frame: the arm's frame with which it moves, as above; solid: its triangles in that frame [m]"""

    frame: int
    solid: Solid


@dataclass(frozen=True, slots=True, eq=False)
class DescribedCable:
    """A cable. frames: frame of the arm with which each of its points moves; points_m: (n, 3) points, each in its
    frame; radius_m: radius of the capsules from one point to the next"""

    frames: tuple[int, ...]
    points_m: FloatArray
    radius_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RobotDescription:
    """Parts of the robot that are removed from the depth image, and the method.

    removal: how links are described: as capsules around the lines between joints, as convex hulls, or as all their
    triangles; parts: solids; whole: the parts include the arm's own links; margin_m: margin around them, in addition to
    the uncertainty of the camera's pose"""

    removal: Removal = "capsules"
    parts: tuple[DescribedPart, ...] = ()
    cables: tuple[DescribedCable, ...] = ()
    whole: bool = False
    margin_m: float = 0.0

    def solids(self, placement: Placement, T_base_links: FloatArray) -> tuple[PosedSolid, ...]:
        """The parts in the surface frame. T_base_links: (k, 4, 4) poses of the arm's joints and, last, its end"""
        frames = _surface_frames(placement, T_base_links)
        return tuple(PosedSolid(frames[part.frame], part.solid) for part in self.parts)

    def cable_capsules(
        self, placement: Placement, T_base_links: FloatArray, margin_m: float = 0.0
    ) -> tuple[Capsule, ...]:
        """The cables in the surface frame [m]. T_base_links: (n + 1, 4, 4); margin_m: added to their radii"""
        frames = _surface_frames(placement, T_base_links)
        found: list[Capsule] = []
        for cable in self.cables:
            T = frames[list(cable.frames)]
            places = np.einsum("nij,nj->ni", T[:, :3, :3], cable.points_m) + T[:, :3, 3]
            found += [Capsule(a, b, cable.radius_m + margin_m) for a, b in pairwise(places)]
        return tuple(found)

    def over_tip_m(self, placement: Placement, T_base_links: FloatArray) -> float:
        """How far the lowest of gripper, mount, stick and cables is above the tip's lowest point, along the tool; inf
        where none is described. T_base_links: (n + 1, 4, 4) poses of the links in any configuration [m]"""
        frames = np.concatenate([np.eye(4)[None], T_base_links])
        T_tip = np.linalg.inv(T_base_links[-1] @ placement.T_ee_center) @ frames
        ending = {-1, len(frames) - 2, len(frames) - 1}
        along = [
            (part.solid.vertices_m @ T_tip[part.frame][2, :3] + T_tip[part.frame][2, 3]).max()
            for part in self.parts
            if part.frame in ending
        ]
        along += [
            T_tip[frame][2, :3] @ point_m + T_tip[frame][2, 3] + cable.radius_m
            for cable in self.cables
            for frame, point_m in zip(cable.frames, cable.points_m, strict=True)
            if frame in ending
        ]
        return placement.center_offset_m - max(map(float, along), default=-np.inf)

    def as_json(self) -> dict[str, Any]:
        """The description for a recording's settings."""
        return {
            "removal": self.removal,
            "whole": self.whole,
            "margin_m": self.margin_m,
            "parts": [
                {
                    "frame": part.frame,
                    "vertices_m": _packed(part.solid.vertices_m, "<f4"),
                    "triangles": _packed(part.solid.triangles, "<u4"),
                }
                for part in self.parts
            ],
            "cables": [
                {"frames": list(one.frames), "points_m": one.points_m.tolist(), "radius_m": one.radius_m}
                for one in self.cables
            ],
        }

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> "RobotDescription":
        """The reverse of `as_json`."""
        parts = [
            DescribedPart(one["frame"], Solid(_unpacked(one["vertices_m"], "<f4"), _unpacked(one["triangles"], "<u4")))
            for one in given["parts"]
        ]
        cables = [
            DescribedCable(tuple(one["frames"]), np.array(one["points_m"], float), one["radius_m"])
            for one in given["cables"]
        ]
        return cls(given["removal"], tuple(parts), tuple(cables), given["whole"], given["margin_m"])


AS_CAPSULES = RobotDescription()


def _packed(values: Any, kind: str) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(values, kind).tobytes(), 9)).decode("ascii")


def _unpacked(text: str, kind: str) -> Any:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), kind).reshape(-1, 3)


def _surface_frames(placement: Placement, T_base_links: FloatArray) -> FloatArray:
    """(k + 1, 4, 4) of base, joints and end in the surface frame."""
    return np.asarray(placement.T_surface_base @ np.concatenate([np.eye(4)[None], T_base_links]))


def describe(section: ShapeSection, chain: Chain | None, folder: Path) -> RobotDescription:
    """A rig file's [shape]. folder: folder of the rig file; raises InputError, with the error."""
    solids = bool(section.urdf or section.gripper)
    removal: Removal = section.removal or ("mesh" if solids else "capsules")
    if removal != "capsules" and not solids:
        raise InputError(f'[shape] removal = "{removal}" with urdf or gripper', "neither", 'removal = "capsules"')
    cables = tuple(_cable(number, section, chain) for number in range(len(section.cables)))
    if removal == "capsules":
        return RobotDescription(removal, (), cables)
    parts: list[DescribedPart] = []
    if section.urdf:
        if chain is None:
            raise InputError("[shape] gripper, of an arm without a chain of joints", "urdf", "gripper = ...")
        parts += _arm_parts(_file(folder, section.urdf), chain, section.closed, removal)
    if section.gripper:
        urdf = read_urdf(_file(folder, section.gripper))
        T = np.eye(4) if section.T_ee_gripper is None else np.array(section.T_ee_gripper, float)
        for link, pose in urdf.poses(_closed(urdf, 0, section.closed)).items():
            parts += [DescribedPart(-1, one) for one in _solids(urdf.solids[link], T @ pose, removal)]
    if not parts:
        raise InputError("[shape] with a URDF that has shapes", "none", "visual or collision geometry")
    return RobotDescription(removal, tuple(parts), cables, bool(section.urdf), section.margin_m)


def _file(folder: Path, name: str) -> Path:
    try:
        return folder / Path(name).expanduser()
    except RuntimeError as error:  # ~NAME of nobody
        raise InputError("a URDF that can be read", " ".join(str(error).split()), where=name) from error


def _cable(number: int, section: ShapeSection, chain: Chain | None) -> DescribedCable:
    given = section.cables[number]
    joints = 0 if chain is None else chain.joint_count
    frames = given.joints or (-1,) * len(given.points_m)
    if any(not -1 <= frame <= joints or (chain is None and frame != -1) for frame in frames):
        least = f"joints of cable {number + 1} from 0, the base, to {joints}, or -1, the arm's end"
        raise InputError(least, f"{list(frames)}", where="[shape]")
    return DescribedCable(tuple(frames), np.array(given.points_m, float), given.radius_m)


def _closed(urdf: UrdfShapes, own: int, share: float) -> dict[str, float]:
    """Values of the joints behind the arm's own (a gripper's), not reported: the same share of each range [rad or m].

    own: how many joints are the arm's; share: 0 = lower limit, 1 = upper limit"""
    return {joint.name: joint.lower + share * (joint.upper - joint.lower) for joint in urdf.movable[own:]}


def _arm_parts(path: Path, chain: Chain, share: float, removal: Removal) -> list[DescribedPart]:
    """All links of an arm's URDF, in the frames of its chain. The URDF's own frames may be others, as long as they move
    with the chain's."""
    urdf = read_urdf(path)
    names = [joint.name for joint in urdf.movable[: chain.joint_count]]
    if len(names) < chain.joint_count:
        raise InputError(f"a URDF with the {chain.joint_count} joints of {chain.name}", f"{len(names)}", where=path)
    carried = {urdf.root: 0}
    for joint in urdf.joints:
        carried[joint.child] = names.index(joint.name) + 1 if joint.name in names else carried[joint.parent]
    tried = []
    for turned_deg in TRIED_DEG:
        joints_deg = np.asarray(chain.home_deg, float) + turned_deg * (1.0 + 0.1 * np.arange(chain.joint_count))
        frames = np.concatenate([np.eye(4)[None], chain.forward(joints_deg)])
        values = dict(zip(names, np.radians(joints_deg).tolist(), strict=True))
        poses = urdf.poses(values | _closed(urdf, chain.joint_count, share))
        tried.append({link: np.linalg.inv(frames[carried[link]]) @ pose for link, pose in poses.items()})
    first, *others = tried
    for link in first:
        for other in others:
            apart = np.linalg.inv(first[link]) @ other[link]
            off_m = float(np.linalg.norm(apart[:3, 3]))
            off_rad = float(np.linalg.norm(apart[:3, :3] - np.eye(3)) / np.sqrt(2.0))
            if off_m > SAME_M or off_rad > SAME_RAD:
                came = f"link {link} differs by {1e3 * off_m:.0f} mm and {np.degrees(off_rad):.1f} deg as joints turn"
                raise InputError(f"a URDF whose joints are those of {chain.name}, in their order", came, where=path)
    parts: list[DescribedPart] = []
    for link, T in first.items():
        parts += [DescribedPart(carried[link], one) for one in _solids(urdf.solids[link], T, removal)]
    return parts


def _solids(drawn: Sequence[Solid], T: FloatArray, removal: Removal) -> list[Solid]:
    """Solids of a link, T (4, 4) in its arm frame [m]: all that is drawn of it, or its convex hull (Thesis 4.4)."""
    moved = [one.moved(T) for one in drawn]
    if removal != "hull" or not moved:
        return moved
    from scipy.spatial import ConvexHull

    vertices = np.concatenate([one.vertices_m for one in moved])
    used, triangles = np.unique(ConvexHull(vertices).simplices, return_inverse=True)
    return [Solid(vertices[used], triangles.reshape(-1, 3).astype(np.uint32))]


# Approximate volume of arm and stick: it hides the surface from a camera, and is removed from its points

LINK_RADIUS_M = 0.045
"""Radius of the capsules that represent the arm's links [m]: that of the arm in the simulated laboratory. With a larger
radius, more of the surface around the arm is removed from the image, and the arm stays farther from the table and
itself. With a smaller one, parts of a thicker arm count as surface and may collide."""


def link_capsules(T_base_links: FloatArray, T: FloatArray) -> list[Capsule]:
    """Capsules of the links only, from the arm's foot, in another frame. T_base_links: (k, 4, 4) poses of the arm's
    joints and, last, of its end; T: (4, 4) base to that frame [m]"""
    joints_m = [T[:3, 3], *(T @ T_base_links)[:, :3, 3]]
    return [Capsule(a, b, LINK_RADIUS_M) for a, b in pairwise(joints_m)]


def arm_shape(
    placement: Placement,
    T_base_links: FloatArray,
    center_m: FloatArray,
    *,
    description: RobotDescription = AS_CAPSULES,
    link_margin_m: float = 0.0,
    stick_margin_m: float = 0.0,
) -> tuple[Capsule, ...]:
    """The links, the stick, the ball at its tip and the cables, in the surface frame [m].

    T_base_links: (k, 4, 4) poses of the arm's joints and, last, of its end (`Chain.forward`); of the end only if a
    person holds it; center_m: (3,) measured centre of its tip, which a push moves away from that of the chain
    description: description of the robot; links that are solids in it are left out
    link_margin_m, stick_margin_m: margins around the links, and around stick, ball and cables"""
    frames = T_base_links if len(T_base_links) == 1 else (np.eye(4), *T_base_links)
    joints_m = [(placement.T_surface_base @ frame)[:3, 3] for frame in frames]
    links = [Capsule(a, b, LINK_RADIUS_M + link_margin_m) for a, b in pairwise(joints_m)]
    stick = Capsule(joints_m[-1], center_m, placement.tool.stick_radius_m + stick_margin_m)
    ball = Capsule(center_m, center_m, placement.tool.radius_m + stick_margin_m)
    cables = description.cable_capsules(placement, T_base_links, stick_margin_m)
    return (*(() if description.whole else links), stick, ball, *cables)
