"""From a message's fields to a frame: which field is which column, in which unit."""

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, Frame, HandFrame, Kind, TactileFrame, WrenchFrame
from deformscope.images import decode_image, read_image
from deformscope.imports.image_messages import cloud_depth, compressed_depth, depth_of_points, is_depth, raw_image
from deformscope.imports.import_map import ASKED, MappedStream
from deformscope.imports.point_files import read_points
from deformscope.imports.poses import QUATERNIONS, Pose, check_rotation, pose_from, rotation_from
from deformscope.imports.readers import TABLE_TYPES, Message, Topic, list_parts
from deformscope.recording.streams import UNITS, columns_of, split_unit
from deformscope_drivers.clock import Stamp
from deformscope_drivers.dsa.pads import SCHUNK_PA_PER_COUNT

KINDS: dict[Kind, type] = {
    "wrench": WrenchFrame,
    "tactile": TactileFrame,
    "arm": ArmFrame,
    "hand": HandFrame,
    "color": ColorFrame,
    "depth": DepthFrame,
}
STANDARD: dict[str, tuple[Kind, dict[str, tuple[str, str]]]] = {
    "geometry_msgs/msg/WrenchStamped": (
        "wrench",
        {f"force_{axis}_n": (f"wrench.force.{axis}", "N") for axis in "xyz"}
        | {f"torque_{axis}_nm": (f"wrench.torque.{axis}", "N m") for axis in "xyz"},
    ),
    "sensor_msgs/msg/JointState": (
        "arm",
        {
            "joint_deg": ("position", "rad"),
            "joint_velocity_deg_s": ("velocity", "rad/s"),
            "joint_torque_nm": ("effort", "N m"),
        },
    ),
    **{
        name: (
            "arm",
            {f"position_{axis}_m": (f"{place}.{axis}", "m") for axis in "xyz"}
            | {f"q{axis}": (f"{turn}.{axis}", "") for axis in "xyzw"},
        )
        for name, place, turn in (
            ("geometry_msgs/msg/PoseStamped", "pose.position", "pose.orientation"),
            ("geometry_msgs/msg/PoseWithCovarianceStamped", "pose.pose.position", "pose.pose.orientation"),
            ("nav_msgs/msg/Odometry", "pose.pose.position", "pose.pose.orientation"),
            ("geometry_msgs/msg/TransformStamped", "transform.translation", "transform.rotation"),
        )
    },
    "sensor_msgs/msg/Image": ("depth", {}),
    "sensor_msgs/msg/CompressedImage": ("color", {}),
    "sensor_msgs/msg/PointCloud2": ("depth", {}),
}
"""Kind and columns of standard messages, whose units are those of REP 103."""
SI = {
    name: (of, factor)
    for of, names in {
        "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605}
        | {"uN": 1e-6, "nN": 1e-9},
        "N m": {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "N mm": 1e-3},
        "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
        "rad": {"rad": 1.0, "deg": math.pi / 180},
        "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180},
        "Pa": {"Pa": 1.0, "kPa": 1e3, "hPa": 1e2, "MPa": 1e6, "DSA count": SCHUNK_PA_PER_COUNT},
        "deg C": {"deg C": 1.0},
    }.items()
    for name, factor in names.items()
}
"""Quantity of each unit, and its factor."""
VENDORS = tuple(
    (re.compile(rf"(actual|target)_{name}[_.]?\[?{places}\]?"), unit, rotation)
    for name, places, unit, rotation in (
        ("TCP_pose", "[0-2]", "m", ""),
        ("TCP_pose", "[3-5]", "rad", "vector"),
        ("q", "[0-5]", "rad", ""),
    )
)
"""Names of a vendor's columns, their unit, and the form of the rotation that they have: of Universal Robots' RTDE."""
SIDES = (("cells_y", "cells_x"), ("rows", "columns"), ("rows", "cols"), ("height", "width"))
"""Names of a matrix's rows and columns in messages."""
Row = dict[str, Any]
CLOUDS = (".pcd", ".ply")
REAL_STEP_M = 1e-4
"""Step with which distances in real numbers are stored."""
TIME_NS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
ARM_SIZES: dict[str, int | None] = {"position_m": None, "rotation_rad": None, "force_n": 3, "torque_nm": 3, "finger": 0}
"""Vectors of an arm's frame, and the length of those that a source may lack."""
STEP_M = {"16UC1": 1e-3}
"""Step of counts of an encoding (REP 118)."""
FAR_M = 20.0
"""Distance that half of an image of a thing to press is not beyond: its numbers are of another unit."""
LONGEST_PX = 65_500
"""Longest side of an image: that of a JPEG."""
DEPTH_UNIT = re.compile(r"(.*/)(?:option/)?[^/]*depth[_/]?(?:units?|scale)\b", re.IGNORECASE)
"""A topic with the unit of a camera, after the camera's name."""


@dataclass(frozen=True, slots=True)
class At:
    """Time of a frame, its messages, and the pose of the arm's end."""

    stamp: Stamp
    index: int
    values: Sequence[Any]
    pose: Pose | None


class FrameBuilder:
    """Makes a stream's frames. topics: topics of the source. Raises InputError for missing keys of the map.

    left_out: messages of other robots; missed: counts of distances and points that no frame has, by reason
    stated_m: units of depth cameras that topics of the source state, by their names [m]"""

    def __init__(self, stream: MappedStream, topics: Mapping[str, Topic]) -> None:
        self.stream = stream
        of = [topics[name] for name in stream.topics]
        self.joints: tuple[str, ...] = stream.joints
        self.left_out, self.missed, self.rotation, self.axes = 0, Counter[str](), "", ""
        self.stated_m: dict[str, float] = {}
        self.own = any(one.kind == KINDS[stream.kind].__name__ for one in of)
        standard: dict[str, tuple[str, str]] = {}
        units: dict[str, str] = {}
        for one in of:
            units |= one.units
            if one.type in STANDARD:
                standard |= STANDARD[one.type][1]
        if self.own:  # a message of ours has the columns' units in their names
            names = [name for one in of for name in one.units] or None
            self._fields = None if names is None else {name: (name, 1.0) for name in names}
            for name in names or ():
                self._check_own(name, units[name])
            return
        self._check_columns(standard)
        self._fields = {name: (field, self._factor(name, field, unit)) for name, (field, unit) in standard.items()}
        is_table = all(one.type in TABLE_TYPES for one in of)
        for name, field in stream.columns.items():
            if is_table and field not in units and list_parts(field)[0] not in units:
                places = [one for one in units if one.startswith(f"{field}#")]
                which = f"one of {', '.join(places or units)}" + f": {len(places)} columns are named {field}" * bool(
                    places
                )
                raise stream.missing(f"columns.{name}", which, field)
            self._fields[name] = field, self._factor(name, field, units.get(field) or _vendor(field)[0])
        if stream.kind == "arm":
            self._check_rotation()

    def _check_rotation(self) -> None:
        """Find the form of a rotation of three or four numbers, or ask for it."""
        fields = {name: field for name, (field, _) in (self._fields or {}).items()}
        named = {one: fields[f"q{one}"][-1:].lower() for one in "xyzw" if f"q{one}" in fields}
        if sorted(named.values()) == sorted("xyzw") and (wrong := [one for one in named if named[one] != one]):
            field = fields[f"q{wrong[0]}"]
            raise self.stream.missing(f"columns.q{wrong[0]}", f"the column of {wrong[0]}, as their names say", field)
        if columns := columns_of("q", fields) or columns_of("rotation_rad", fields):
            self.axes = "xyz" if columns[0] == "rotation_x_rad" else ""
            forms = {_vendor(fields[one])[1] for one in columns}
            ends = "".join(fields[one][-1:].lower() for one in columns)
            known = forms.pop() if len(forms) == 1 else ""
            known = ends if ends in QUATERNIONS else known
            self.rotation = check_rotation(self.stream, 4 if columns[0][0] == "q" else 3, self.axes, known)
        elif self.stream.rotation:
            raise self.stream.missing("rotation", "none: no column is a rotation of three or four numbers", "")

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a message, as far as they are known in advance."""
        return tuple(self._fields or ())

    def _check_columns(self, standard: Iterable[str]) -> None:
        """Refuse columns that no frame of the kind has, and vectors that lack a part. standard: its messages'"""
        stream, names = self.stream, {*standard, *self.stream.columns}
        known = [one.name for one in fields(KINDS[stream.kind]) if one.name not in ("stamp", "index", "device")]
        other = {*standard, *(f"q{one}" for one in ("", *"xyzw", "_0", "_1", "_2", "_3") if stream.kind == "arm")}
        for field in known:
            found, (base, unit) = columns_of(field, names), split_unit(field)
            of_axes = (f"{at}_{axis}" for at in range(len(found) // 3) for axis in "xyz")
            alone = [[f"force_{axis}_n"] for axis in "xyz"] if field == "force_n" else []  # of a load cell
            whole = alone + [
                [f"{base}_{one}{unit and f'_{unit}'}" for one in each] for each in ("xyz", range(len(found)), of_axes)
            ]
            if found not in ([], [field], *whole):
                raise stream.missing(f"columns of {field}", "x, y and z, or numbers from 0 on", ", ".join(found))
            other.update(found)
        if unknown := [name for name in stream.columns if name not in other]:
            raise stream.missing(f"columns.{unknown[0]}", f"of a {stream.kind} frame: {', '.join(known)}", unknown[0])

    def _check_own(self, name: str, unit: str) -> None:
        wanted = UNITS.get(split_unit(name)[1], "")
        if wanted and unit and unit != wanted:
            raise InputError(f"{name} in {wanted}", f"{unit}", f"columns and units of {self.stream.device} in the map")

    def _factor(self, column: str, field: str, said: str) -> float:
        """Factor of a field. said: its unit as in the source, or empty"""
        wanted = UNITS.get(split_unit(column)[1], "")
        if not wanted or wanted in ("ns", "ticks"):
            return 1.0
        given = self.stream.units.get(field, said)
        key = f'units."{field}"'
        known = ", ".join(name for name, (of, _) in SI.items() if of == SI[wanted][0])
        if not given or given == ASKED:
            raise self.stream.missing(key, f"one of {known}", given)
        if said and given != said and (said not in SI or SI.get(given) != SI[said]):
            raise self.stream.missing(key, f"{said}, as the source says", given)
        if given not in SI or SI[given][0] != SI[wanted][0]:
            raise self.stream.missing(key, f"one of {known}", given)
        return 1.0 if given == wanted else SI[given][1] / SI[wanted][1]

    def build(self, messages: Mapping[str, Message], stamp: Stamp, index: int, pose: Pose | None) -> Frame | None:
        """The frame of these messages, by topic; None if they do not belong to it. pose: pose of the arm's end"""
        row: Row = {}
        try:
            for message in messages.values():
                row |= self._row(message)
            if self.own:
                stamp = Stamp(stamp.host_ns, row.get("device_ticks"), row.get("late_ns"))
                index = int(row.get("index", index))
            return _MAKE[self.stream.kind](self, row, At(stamp, index, [one.value for one in messages.values()], pose))
        except KeyError as error:
            raise self.stream.missing(f"columns.{error.args[0]}", "the source's field that holds it", "") from error
        except (ArithmeticError, IndexError, RecursionError, TypeError, ValueError) as error:  # as of sizes that differ
            came = f"in frame {index}: {' '.join(str(error).split())[:160]}"
            raise InputError(f"a {self.stream.kind} frame of {self.stream.device}", came, "its columns") from error

    def _row(self, message: Message) -> dict[str, Any]:
        fields = self._fields
        if self.own and fields is None:  # a message of ours
            names = [name for name in type(message.value).__dataclass_fields__ if not name.startswith("__")]
            found = {name: getattr(message.value, name) for name in names}
            for name in ("device_ticks", "late_ns"):
                if name in found:
                    found[name] = found[name][0] if len(found[name]) else None
            return found
        row: Row = {}
        for name, (field, factor) in (fields or {}).items():
            try:
                value = message.get(field)
            except KeyError:
                continue
            if isinstance(value, str) and value.startswith("["):
                value = json.loads(value)
            elif isinstance(value, str) and not name.startswith("state"):
                value = _number(value, field)
            if factor != 1.0 and _is_of_matrices(value):
                row[name] = tuple(np.asarray(one, np.float64) * factor for one in value)
            else:
                row[name] = value if factor == 1.0 or value is None else np.asarray(value, np.float64) * factor
        return row

    def values(self, row: Mapping[str, Any], name: str, kind: Any = np.float64, size: int | None = None) -> Any:
        """A field's values as a flat list, NaN for empty real numbers; if its columns are missing, `size` times NaN.
        Raises KeyError if that is None too."""
        columns = _columns_of(name, tuple(row))
        is_empty = all(row[one] is None for one in columns)
        if not columns or (is_empty and (columns == [name] or kind is not np.float64)):
            if size is None:
                raise KeyError(name)
            return np.full(size, np.nan if kind is np.float64 else 0, kind)
        if columns == [name]:
            if _is_of_matrices(row[name]):
                return np.concatenate([np.asarray(one, kind).ravel() for one in row[name]])
            return np.asarray(row[name], kind).ravel()
        return np.array([np.nan if row[one] is None else row[one] for one in columns], kind)

    def check_numbers(self, row: Row, name: str, values: FloatArray, at: At) -> None:
        """Refuse values that are no numbers, unless the map keeps them. name: their field"""
        if self.stream.nan == "refuse" and not self.own and not np.isfinite(values).all():
            is_empty = any(row[one] is None for one in columns_of(name, row))
            came = "nothing, or NaN," if is_empty else "inf" if np.isinf(values).any() else "NaN"
            words = {"force_n": "forces", "pressure_pa": "pressures"}[name]
            raise InputError(
                f"{words} of {self.stream.device} that are numbers", f"{came} in frame {at.index}", 'nan = "keep"'
            )

    def of_file(self, path: Path) -> Any:
        """An image file, or the distances of one of points [m]."""
        stream = self.stream
        if path.suffix.lower() not in CLOUDS:
            if stream.kind == "depth" and not stream.step_m:
                raise stream.missing("unit_m", "the step of its images [m]", "", "unit_m = 0.001, for mm,")
            return read_image(path)
        if not stream.units.get("points"):
            raise stream.missing("units.points", "m, cm, mm or um", "", 'units = {"points" = "mm"}')
        return self.in_metres("points", depth_of_points(stream, read_points(path), self.missed))

    def step_m(self, encoding: str) -> float:
        """Step of counts [m]: stated by the map, by a topic of the camera, or by the encoding."""
        stream, stated = self.stream, self.stated_m
        of = {name: DEPTH_UNIT.match(name)[1].removesuffix("option/") for name in stated}  # type: ignore[index]
        of = {name: place for name, place in of.items() if stream.topics[0].startswith(place)}
        nearest = {stated[name] for name, place in of.items() if place == max(of.values(), key=len)}
        usual = {STEP_M[encoding]} if encoding in STEP_M else set()
        known = nearest | usual or {*stated.values()}
        by_map = stream.step_m or (float(self.in_metres("data", np.ones(1))[0]) if "data" in stream.units else 0.0)
        if by_map and (not nearest or by_map in known):
            return by_map
        if not by_map and len(known) == 1 and (nearest or (usual and known >= {*stated.values()})):
            return known.pop()
        said = ", ".join(
            [*(f"{value:g} by {name}" for name, value in stated.items()), *(f"{one:g} by {encoding}" for one in usual)]
        )
        expected = f"the step of its distances [m]{said and ': '}{said or f', which {encoding!r} does not say'}"
        raise stream.missing("unit_m", expected, by_map or stream.unit_m or "", "unit_m = 0.001, for mm,")

    def in_metres(self, key: str, distances: FloatArray) -> FloatArray:
        """Real numbers as metres. key: the map's key in `units`"""
        unit = self.stream.units.get(key, "")
        if unit and SI.get(unit, ("",))[0] == "m":
            return distances * SI[unit][1]
        known = ", ".join(name for name, (of, _) in SI.items() if of == "m")
        if unit or _is_far(distances):
            came = f"none, and most of its distances are above {FAR_M:g}"
            raise self.stream.missing(f"units.{key}", f"one of {known}", unit or came, f'units = {{"{key}" = "mm"}}')
        return distances


def _vendor(field: str) -> tuple[str, str]:
    """Unit and form of rotation of a vendor's column; both empty for others."""
    return next(((unit, form) for pattern, unit, form in VENDORS if pattern.fullmatch(field)), ("", ""))


def _is_far(distances: FloatArray) -> bool:
    """Whether most of the distances [m] are beyond those of a thing to press."""
    seen = np.isfinite(distances) & (distances > 0)
    return bool(2 * np.count_nonzero(seen & (distances > FAR_M)) > np.count_nonzero(seen))


def _is_of_matrices(value: Any) -> bool:
    """Whether it is of a list of messages, each with an array of its own size."""
    return isinstance(value, tuple) and len(value) > 0 and np.ndim(value[0]) > 0


def sides_of(value: Any, field: str) -> list[tuple[int, int]]:
    """Rows and columns of a list of matrices, as the messages themselves say; empty where they do not."""
    for part in field.split(".")[:-1]:
        value = getattr(value, part, None)
    for sides in SIDES if isinstance(value, list) else ():
        if all(hasattr(one, name) for one in value for name in sides):
            return [(int(getattr(one, sides[0])), int(getattr(one, sides[1]))) for one in value]
    return []


def valid_of(frame: Frame) -> tuple[int, int]:
    """How many values of a frame are valid, and how many it has; 1 of 1 where every value is."""
    if isinstance(frame, DepthFrame):
        return int(np.count_nonzero(frame.depth)), frame.depth.size
    values = frame.force_n if isinstance(frame, WrenchFrame) else getattr(frame, "position_m", None)
    values = np.concatenate([one.ravel() for one in frame.pressure_pa]) if isinstance(frame, TactileFrame) else values
    return (1, 1) if values is None else (int(np.isfinite(values).sum()), values.size)


def _number(text: str, field: str) -> float:
    try:
        return float(text.strip().replace("_", "?"))
    except ValueError:
        raise ValueError(f"text in {field}, where numbers were expected: {text!r}") from None


_columns_of = lru_cache(columns_of)
"""All rows of a stream have the same columns."""


def _wrench(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    force = self.values(row, "force_n")
    if axis := next((one for one in "xyz" if force.size == 1 and f"force_{one}_n" in row), ""):  # a load cell's
        force = np.where([one == axis for one in "xyz"], force, 0.0)
    for name in () if self.own else ("force_n", "torque_nm"):
        if name in row and np.size(row[name]) != 3:
            about = f'three numbers of one sensor; parts of a list are named: {name.replace("_", "_x_", 1)} = "NAME[0]"'
            raise self.stream.missing(f"columns.{name}", about, f"{np.size(row[name])} numbers")
    force = force.reshape(-1, 3)
    torque = self.values(row, "torque_nm", size=force.size).reshape(-1, 3)
    self.check_numbers(row, "force_n", force, at)
    counts = self.values(row, "counts", np.int64, 0)
    flags = bool(row.get("overload", False)), bool(row.get("usable", True))
    known = None if np.isnan(torque).all() else torque
    return WrenchFrame(at.stamp, at.index, counts, force, known, *flags, self.stream.device)


def _tactile(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    shapes, pressure = [(pad.rows, pad.columns) for pad in self.stream.pads], self.values(row, "pressure_pa")
    self.check_numbers(row, "pressure_pa", pressure, at)
    said = sides_of(at.values[0], (self._fields or {}).get("pressure_pa", ("",))[0])
    if shapes and said and said != shapes:
        raise self.stream.missing("pads", f"rows and columns of its matrices, {said}, in their order", shapes)
    if shapes and _is_of_matrices(parts := row.get("pressure_pa")):
        sizes, texels = [np.size(one) for one in parts or ()], [rows * columns for rows, columns in shapes]
        if sizes != texels:
            raise self.stream.missing("pads", f"in the order of its matrices, of {sizes} texels", texels)
    ends = np.cumsum([rows * columns for rows, columns in shapes])
    if not shapes or len(pressure) != ends[-1]:
        about = f"name, rows, columns, texel_m, index, finger, part of each, {len(pressure)} texels in all"
        about += f", rows and columns {said}" if said else ""
        raise self.stream.missing("pads", about, f"{ends[-1]} texels" if shapes else "")
    pads = tuple(one.reshape(shape) for one, shape in zip(np.split(pressure, ends[:-1]), shapes, strict=True))
    return TactileFrame(at.stamp, at.index, self.values(row, "counts", np.uint16, 0), pads, self.stream.device)


def _arm(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    from deformscope_drivers.arm.kinematics import euler_xyz_from_rotation

    if named := next((list(one.name) for one in at.values if hasattr(one, "name")), []):
        self.joints = self.joints or tuple(named)
        if self.stream.joints and not set(self.joints) <= set(named):
            self.left_out += not set(self.joints) & set(named)  # another robot's, or another part's
            return None
        if set(self.joints) != set(named) and not self.stream.joints:
            came = f"{', '.join(self.joints)}, then {', '.join(named)}"
            raise self.stream.missing("joints", "names of the arm's, in their order", came)
        places = {name: at for at, name in reversed(list(enumerate(named)))}
        order = [places[name] for name in self.joints]
        row = {name: np.asarray(value)[order] if np.size(value) > 1 else value for name, value in row.items()}
    row, pose = {name: value for name, value in row.items() if np.size(value)}, at.pose
    if "qw" in row:
        pose = pose_from([row.pop(f"q{axis}") for axis in "xyzw"], [row.pop(f"position_{axis}_m") for axis in "xyz"])
    elif self.rotation:
        turn = rotation_from(
            self.rotation, self.values(row, "q" if "q" in row or "q_0" in row else "rotation_rad"), self.axes
        )
        row = {name: value for name, value in row.items() if not name.startswith(("q", "rotation"))}
        row["rotation_rad"] = euler_xyz_from_rotation(np.asarray(turn, np.float64))
    if pose is not None:
        row |= {"position_m": pose[:3, 3], "rotation_rad": euler_xyz_from_rotation(pose[:3, :3])}
    elif not columns_of("position_m", row):
        return None  # no pose has come yet
    joints = self.values(row, "joint_deg", size=0)
    sizes = ARM_SIZES | dict.fromkeys(("joint_velocity_deg_s", "joint_torque_nm"), len(joints))
    found = {name: self.values(row, name, size=size) for name, size in sizes.items()}
    queued = int(row.get("queued", 0))
    return ArmFrame(at.stamp, at.index, joints, **found, queued=queued, device=self.stream.device)


def _hand(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    row = {name.removeprefix("joint_velocity").removeprefix("joint"): value for name, value in row.items()} | row
    row = {{"_deg": "position_deg", "_deg_s": "velocity_deg_s"}.get(name, name): value for name, value in row.items()}
    position = self.values(row, "position_deg")
    velocity, heat = self.values(row, "velocity_deg_s", size=len(position)), self.values(row, "temperature_c", size=9)
    states = [row[one] for one in columns_of("state", row)]
    states = states[0] if len(states) == 1 and not isinstance(states[0], str) else states
    return HandFrame(at.stamp, at.index, position, velocity, heat, tuple(states), self.stream.device)


def _color(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    image, *_ = _images(self, row, at)
    if image is None:
        raise KeyError("image")
    return ColorFrame(at.stamp, at.index, image, self.stream.device)


def _depth(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    color, depth, encoding = _images(self, row, at)
    if depth is None:
        raise KeyError("depth")
    if depth.ndim != 2:
        came = f"an image of shape {depth.shape}"
        raise InputError(f"distances of {self.stream.device} of one channel", came, 'kind = "color" in the map')
    if depth.dtype == np.uint8 and not all(isinstance(one, Path) and one.suffix.lower() != ".jpg" for one in at.values):
        hint = 'the topic or files of its distances, or kind = "color" in the map'
        raise InputError(f"distances of {self.stream.device} in 16 bits or real numbers", "8 bits: they are lost", hint)
    is_real = depth.dtype.kind == "f"
    unit_m = float(row.get("unit_m") or 0.0)
    unit_m = unit_m or (self.stream.step_m or REAL_STEP_M if is_real else self.step_m(encoding))
    if (
        not self.own
        and not is_real
        and not (self.stream.step_m or self.stream.units.get("data"))
        and _is_far(depth * unit_m)
    ):
        came = f"{unit_m:g} m, by which most of them are beyond {FAR_M:g} m"
        raise self.stream.missing("unit_m", "the step of its distances", came, f"unit_m = {unit_m:g}, if it is that,")
    if not 1e-7 <= unit_m <= 10.0:
        raise InputError(f"a unit_m of distances of {self.stream.device} from 1e-7 to 10 m", f"{unit_m:g}")
    if is_real:
        with np.errstate(over="ignore"):
            counts = np.rint(np.where(np.isfinite(depth), depth, 0.0).astype(np.float64) / unit_m)
        self.missed["beyond"] += int(np.count_nonzero(counts > 65535))
        depth = np.where((counts > 0) & (counts < 65536), counts, 0).astype(np.uint16)
    return DepthFrame(at.stamp, at.index, depth.astype(np.uint16, copy=False), unit_m, color, self.stream.device)


def _images(self: FrameBuilder, row: Row, at: At) -> tuple[Any, Any, str]:
    """A colour image and one of distances, counts or real numbers in metres; None where there is none. The encoding of
    a message's distances; empty where none is said."""
    stream, encoding = self.stream, ""
    encoded = row.get("image") or row.get("color"), row.get("depth")
    color, depth = (None if one is None else decode_image(bytes(one), stream.device) for one in encoded)
    said = [getattr(one, "encoding", getattr(one, "format", None)) for one in at.values]
    for value, form in zip(at.values, said, strict=True):
        if isinstance(value, Path):
            image = self.of_file(value)
            of_depth = stream.kind == "depth" and (image.ndim == 2 or len(at.values) == 1)
        elif hasattr(value, "point_step"):
            image, of_depth = self.in_metres("points", cloud_depth(stream, value, self.missed)), True
        elif form is None:
            continue
        elif of_depth := stream.kind == "depth" and (is_depth(form) or len(at.values) == 1):
            if hasattr(value, "encoding"):
                image, encoding = raw_image(stream, value), form
            else:
                image, encoding = compressed_depth(stream, form, bytes(value.data))
            image = self.in_metres("data", image) if image.dtype.kind == "f" else image
        elif is_depth(form):
            raise stream.missing("kind", f'"depth", as {form!r} has distances', stream.kind, 'kind = "depth"')
        elif hasattr(value, "encoding"):
            image = raw_image(stream, value)
        else:
            image = decode_image(bytes(value.data), stream.device)
        color, depth = (color, image) if of_depth else (image, depth)
    for image in (color, depth):
        if image is not None and not all(1 <= side <= LONGEST_PX for side in image.shape[:2]):
            raise ValueError(f"expected sides of 1 to {LONGEST_PX} px; got {' x '.join(map(str, image.shape[:2]))}")
    return color, depth, encoding


_MAKE: dict[Kind, Callable[..., Frame | None]] = {
    "wrench": _wrench,
    "tactile": _tactile,
    "arm": _arm,
    "hand": _hand,
    "color": _color,
    "depth": _depth,
}
