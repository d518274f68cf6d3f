"""The shapes of a URDF's links, and the links' poses for given joint angles.

A URDF is an untrusted file: it is read without entities, and its meshes only from folders below its package."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.errors import InputError
from deformscope.robot.mesh_files import read_meshes
from deformscope.solid import Solid
from deformscope_drivers.arm.kinematics import FloatArray, rotation_from_rpy, transform

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
