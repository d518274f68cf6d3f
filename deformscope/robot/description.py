"""Shapes of arm, gripper and cables by the rig file: they are removed from the camera's image.

    described = describe(section, chain, folder)                # once, from the rig file's [shape]
    described.solids(placement, T_base_links)                   # in the surface frame, for one pose
    described.cable_capsules(placement, T_base_links)

A part belongs to a frame of the arm: 0 its base, i the link behind joint i, -1 its end. No file is read later: a
recording contains the triangles.

The shapes of a URDF's links, and the links' poses for given joint angles.

A URDF is an untrusted file: it is read without entities, and its meshes only from folders below its package."""

import base64
import math
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deformscope.errors import InputError
from deformscope.rig.sections import ShapeSection
from deformscope.robot.mesh_files import read_meshes
from deformscope.robot.placement import Placement
from deformscope.solid import Capsule, PosedSolid, Solid
from deformscope_drivers.arm.kinematics import Chain, FloatArray, rotation_from_rpy, transform

MOVABLE = ("revolute", "continuous", "prismatic")
FILE_BYTES = 2_000_000
"""Largest URDF file: vendors' have a tenth at most. It bounds time and memory for a file of unknown origin."""
LARGEST = 1e30
"""Largest number of any kind: squares stay finite."""
LONGEST_M = 1000.0
"""Side of a box, radius or length, or factor of a mesh: files in millimetres stay below it."""
SIDES = 24
"""Number of sides of the prisms that replace cylinders: they are inside of the cylinder by less than 1 % of its radius.
With fewer sides more of a cylinder stays in the image; every side is recorded with each session."""


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """T_parent_joint: (4, 4) pose at joint value 0; axis: (3,) axis in the joint's frame; lower, upper: its range [rad
    or m], 0 to 0 = fixed or without end"""

    name: str
    kind: str
    parent: str
    child: str
    T_parent_joint: FloatArray
    axis: FloatArray
    lower: float
    upper: float

    def moved(self, value: float) -> FloatArray:
        """(4, 4) the child's frame in the parent's, at an angle [rad] or a length [m]."""
        if self.kind not in MOVABLE:
            return self.T_parent_joint
        if self.kind == "prismatic":
            return np.asarray(self.T_parent_joint @ transform(np.eye(3), value * self.axis))
        x, y, z = self.axis
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = np.eye(3) + math.sin(value) * across + (1.0 - math.cos(value)) * across @ across
        return np.asarray(self.T_parent_joint @ transform(turned, (0.0, 0.0, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class UrdfShapes:
    """root: the first link; joints: parents before children; solids: solids of each link, in its frame"""

    root: str
    joints: tuple[UrdfJoint, ...]
    solids: Mapping[str, tuple[Solid, ...]]

    @property
    def movable(self) -> tuple[UrdfJoint, ...]:
        """The joints that turn or slide, nearest to the root first."""
        return tuple(joint for joint in self.joints if joint.kind in MOVABLE)

    def poses(self, values: Mapping[str, float]) -> dict[str, FloatArray]:
        """Pose (4, 4) of each link in the root's frame. values: joints' by name [rad or m], else 0"""
        found: dict[str, FloatArray] = {self.root: np.eye(4)}
        for joint in self.joints:
            found[joint.child] = found[joint.parent] @ joint.moved(values.get(joint.name, 0.0))
        return found


def read_urdf(path: Path) -> UrdfShapes:
    """Read a URDF with its meshes. Raises InputError, with the error."""
    try:
        with path.open("rb") as file:
            content = file.read(FILE_BYTES + 1)
        if len(content) > FILE_BYTES:
            raise InputError(f"a URDF of up to {FILE_BYTES // 1_000_000} MB", "a larger one", where=path)
        plain = content.replace(b"\0", b"")  # of whatever width its letters are
        if b"<!DOCTYPE" in plain or b"<!ENTITY" in plain:
            raise InputError("a URDF without a document type", "one", "xacro files: run xacro first", path)
        robot = ET.fromstring(content)
        if robot.tag != "robot":
            raise InputError("a URDF: <robot> with links and joints", f"<{robot.tag}>", where=path)
        parts = [part for link in robot.findall("link") for part in _shown(link)]
        named = [mesh.attrib["filename"] for part in parts for mesh in part.findall("geometry/mesh")]
        files = {name: _mesh_file(name, path) for name in named}
        read = [Solid(vertices, faces.astype(np.uint32)) for vertices, faces in read_meshes(list(files.values()))]
        meshes = dict(zip(files, read, strict=True))
        solids = {link.attrib["name"]: _link_solids(link, meshes) for link in robot.findall("link")}
        joints = [_joint(one) for one in robot.findall("joint")]
    except OSError as error:
        raise InputError("a URDF that can be read", (error.strerror or "no file").lower(), where=path) from error
    except (ET.ParseError, KeyError, ValueError) as error:
        raise InputError("a URDF: XML with named links and joints", " ".join(str(error).split()), where=path) from error
    root, ordered = _in_order(joints, list(solids), path)
    return UrdfShapes(root, ordered, solids)


def _in_order(joints: list[UrdfJoint], links: list[str], path: Path) -> tuple[str, tuple[UrdfJoint, ...]]:
    """The root link, and the joints with parents before children."""
    children = {joint.child for joint in joints}
    roots = [name for name in links if name not in children]
    if len(roots) != 1 or len(children) != len(joints):
        came = f"{len(roots)} of {len(links)} links have no parent"
        raise InputError("a URDF whose links form one tree", came, where=path)
    below: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    ordered: list[UrdfJoint] = []
    level = roots
    while level:
        found = [joint for name in level for joint in below.get(name, ())]
        ordered += found
        level = [joint.child for joint in found]
    if len(ordered) != len(joints) or {joint.child for joint in ordered} - set(links):
        raise InputError("a URDF whose joints join its links", "others", where=path)
    return roots[0], tuple(ordered)


def _joint(given: ET.Element) -> UrdfJoint:
    parent, child = (given.find(name) for name in ("parent", "child"))
    if parent is None or child is None:
        raise ValueError(f"joint {given.attrib['name']} without parent or child")
    axis, limit = given.find("axis"), given.find("limit")
    along = np.array([1.0, 0.0, 0.0]) if axis is None else np.array(_numbers(axis.attrib["xyz"], 3))
    bounds = ("0", "0") if limit is None else (limit.get("lower", "0"), limit.get("upper", "0"))
    lower, upper = _numbers(" ".join(bounds), 2)
    along /= max(float(np.linalg.norm(along)), 1e-12)
    names = (given.attrib["name"], given.attrib["type"], parent.attrib["link"], child.attrib["link"])
    return UrdfJoint(*names, _origin(given), along, lower, upper)


def _origin(given: ET.Element) -> FloatArray:
    origin = given.find("origin")
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"), 3)
    return transform(rotation_from_rpy(roll, pitch, yaw), _numbers(origin.get("xyz", "0 0 0"), 3))


def _numbers(words: str, count: int) -> tuple[float, ...]:
    found = tuple(float(word) for word in words.split())
    if len(found) != count or not all(abs(one) <= LARGEST for one in found):
        raise ValueError(f"expected {count} numbers up to {LARGEST:g}; got {words[:60]!r}")
    return found


def _lengths(words: str, count: int) -> tuple[float, ...]:
    found = _numbers(words, count)
    if not all(0.0 < one <= LONGEST_M for one in found):
        raise ValueError(f"expected lengths above 0, up to {LONGEST_M:g} m; got {words[:60]!r}")
    return found


def _shown(link: ET.Element) -> list[ET.Element]:
    """The visual shapes of a link, or its collision shapes where it has none."""
    return link.findall("visual") or link.findall("collision")


def _link_solids(link: ET.Element, meshes: Mapping[str, Solid]) -> tuple[Solid, ...]:
    found = []
    for part in _shown(link):
        geometry = part.find("geometry")
        kind = None if geometry is None else next(iter(geometry), None)
        if kind is None:
            raise ValueError(f"link {link.attrib['name']} without geometry")
        found.append(_solid(kind, meshes).moved(_origin(part)))
    return tuple(found)


def _solid(kind: ET.Element, meshes: Mapping[str, Solid]) -> Solid:
    import open3d as o3d

    make: Any = o3d.geometry.TriangleMesh  # its stubs know paths and booleans where it takes strings and numbers
    match kind.tag:
        case "box":
            size_m = _lengths(kind.attrib["size"], 3)
            return _of_open3d(make.create_box(*size_m).translate([-0.5 * side for side in size_m]))
        case "cylinder":
            radius_m, length_m = _lengths(f"{kind.attrib['radius']} {kind.attrib['length']}", 2)
            return _of_open3d(make.create_cylinder(radius_m, length_m, resolution=SIDES, split=1))
        case "sphere":
            return _of_open3d(make.create_sphere(*_lengths(kind.attrib["radius"], 1), resolution=SIDES // 2))
        case "mesh":
            scale = _numbers(kind.get("scale", "1 1 1"), 3)
            _lengths(" ".join(str(abs(one)) for one in scale), 3)
            found = meshes[kind.attrib["filename"]]
            return Solid(found.vertices_m * scale, found.triangles)
    raise ValueError(f"expected box, cylinder, sphere or mesh; got <{kind.tag}>")


def _of_open3d(mesh: Any) -> Solid:
    return Solid(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.triangles, np.uint32))


def _mesh_file(name: str, path: Path) -> Path:
    """A mesh file of the URDF at `path`: below the package that it is in, else below its own folder."""
    folder = path.resolve().parent
    package = next((one for one in (folder, *folder.parents) if (one / "package.xml").exists()), folder)
    inside = name.removeprefix("package://").partition("/")[2] if name.startswith("package://") else ""
    where = ((package / inside) if inside else (folder / name.removeprefix("file://"))).resolve()
    if not where.is_relative_to(package):
        raise InputError(f"meshes below {package}", name, "copy them there", path)
    return where


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
