"""An arm's chain of joints from its URDF, which its vendor publishes."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from deformscope_drivers.arm import kinematics
from deformscope_drivers.errors import DeviceError

Vector3 = tuple[float, float, float]


def chain_of_urdf(path: Path, tip: str, home_deg: tuple[float, ...]) -> kinematics.Chain:
    """The joints from the root of a URDF to the link `tip`, the arm's end, as joints that turn about z.

    home_deg: angles of the joints at home. Raises DeviceError for a file that is no URDF, a link that it lacks, and
    joints on the way that slide or follow others."""
    try:
        text = path.read_bytes()
        if b"<!DOCTYPE" in text.replace(b"\0", b""):  # of entities; of whatever width its letters are
            raise DeviceError("a URDF without a document type", "one", "xacro files: run xacro first", path)
        robot = ET.fromstring(text)
        above = {_value(one, "child", "link"): one for one in robot.findall("joint")}
        links = robot.findall("link")
        masses = {one.attrib["name"]: float(_value(one, "inertial/mass", "value", "0")) for one in links}
        if tip not in masses:
            raise DeviceError(f"a link out of {', '.join(masses)}", repr(tip), "the flange or tool frame", path)
        way: list[ET.Element] = []
        link = tip
        while link in above and len(way) < len(above):
            way.append(above[link])
            link = _value(above[link], "parent", "link")
        joints, step = [], np.eye(4)
        for joint in reversed(way):
            kind, link = joint.attrib["type"], _value(joint, "child", "link")
            turn = kinematics.rotation_from_rpy(*_vector(joint, "origin", "rpy"))
            step = step @ kinematics.transform(turn, _vector(joint, "origin", "xyz"))
            if kind == "fixed":
                continue
            if kind not in ("revolute", "continuous") or joint.find("mimic") is not None:
                came = f"{joint.attrib['name']}, {kind}"
                raise DeviceError("joints that turn, none as another does", came, where=path)
            turned = kinematics.transform(_to_z(np.array(_vector(joint, "axis", "xyz", "1 0 0"))), (0.0, 0.0, 0.0))
            low, high, fastest, torque = (
                float(_value(joint, "limit", key, "0")) for key in ("lower", "upper", "velocity", "effort")
            )
            first, last = (None, None) if kind == "continuous" else (math.degrees(low), math.degrees(high))
            xyz_m, rpy_rad = xyz_rpy(step @ turned)
            joints.append(kinematics.Joint(xyz_m, rpy_rad, first, last, math.degrees(fastest), torque, masses[link]))
            step = turned.T
    except OSError as error:
        raise DeviceError("a URDF that can be read", (error.strerror or "no file").lower(), where=path) from error
    except (ET.ParseError, KeyError, ValueError, AttributeError) as error:
        came = " ".join(str(error).split())
        raise DeviceError("a URDF: XML with named links and joints", came, where=path) from error
    return kinematics.Chain(robot.attrib.get("name", path.stem), tuple(joints), *xyz_rpy(step), home_deg)


def _value(part: ET.Element, name: str, key: str, default: str = "") -> str:
    found = part.find(name)
    return default if found is None else found.attrib.get(key, default)


def _vector(part: ET.Element, name: str, key: str, default: str = "0 0 0") -> Vector3:
    x, y, z = map(float, _value(part, name, key, default).split())
    return x, y, z


def _to_z(axis: kinematics.FloatArray) -> kinematics.FloatArray:
    """(3, 3) whose third column is the direction of an axis (3,)."""
    along = axis / np.linalg.norm(axis)
    across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(along, across), along])


def xyz_rpy(T: kinematics.FloatArray) -> tuple[Vector3, Vector3]:
    """Translation [m] and roll, pitch, yaw [rad] of a transform (4, 4)."""
    (x, y, z), (roll, pitch, yaw) = T[:3, 3].tolist(), (-kinematics.euler_xyz_from_rotation(T[:3, :3].T)).tolist()
    return (x, y, z), (roll, pitch, yaw)
