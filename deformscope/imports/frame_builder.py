"""From a message's fields to a frame: which field is which column, in which unit."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.file_io import check_size
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, Frame, HandFrame, Kind, TactileFrame, WrenchFrame
from deformscope.images import PNG_SIGNATURE, decode_image, read_image
from deformscope.imports.import_map import ASKED, MappedStream
from deformscope.imports.point_files import read_points
from deformscope.imports.readers import TABLE_TYPES, Message, Topic
from deformscope.recording.streams import UNITS, columns_of, split_unit
from deformscope_drivers.clock import Stamp

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
    "geometry_msgs/msg/PoseStamped": (
        "arm",
        {f"position_{axis}_m": (f"pose.position.{axis}", "m") for axis in "xyz"}
        | {f"q{axis}": (f"pose.orientation.{axis}", "") for axis in "xyzw"},
    ),
    "sensor_msgs/msg/Image": ("depth", {}),
    "sensor_msgs/msg/CompressedImage": ("color", {}),
    "sensor_msgs/msg/PointCloud2": ("depth", {}),
}
"""Kind and columns of standard messages, whose units are those of REP 103."""
SI = {
    name: (of, factor)
    for of, names in {
        "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605},
        "N m": {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "N mm": 1e-3},
        "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
        "rad": {"rad": 1.0, "deg": math.pi / 180},
        "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180},
        "Pa": {"Pa": 1.0, "kPa": 1e3, "hPa": 1e2, "MPa": 1e6},
        "deg C": {"deg C": 1.0},
    }.items()
    for name, factor in names.items()
}
"""Quantity of each unit, and its factor."""
Pose = npt.NDArray[np.float64]
"""Pose (4, 4) of the arm's end in the base frame [m]."""
Row = dict[str, Any]
CLOUDS = (".pcd", ".ply")
REAL_STEP_M = 1e-4
"""Step with which distances in real numbers are stored."""
TIME_NS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
ARM_SIZES: dict[str, int | None] = {"position_m": None, "rotation_rad": None, "force_n": 3, "torque_nm": 3, "finger": 0}
"""Vectors of an arm's frame, and the length of those that a source may lack."""
DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")
COLOR_ENCODINGS = {"rgb8": 3, "bgr8": 3, "mono8": 1, "rgba8": 4, "bgra8": 4}
AXES = ("x", "y", "z")
LONGEST_PX = 65_500
"""Longest side of an image: that of a JPEG."""
POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(frozen=True, slots=True)
class At:
    """Time of a frame, its messages, and the pose of the arm's end."""

    stamp: Stamp
    index: int
    values: Sequence[Any]
    pose: Pose | None


class FrameBuilder:
    """Makes a stream's frames. topics: topics of the source. Raises InputError for missing keys of the map."""

    def __init__(self, stream: MappedStream, topics: Mapping[str, Topic]) -> None:
        self.stream = stream
        of = [topics[name] for name in stream.topics]
        self.joints: tuple[str, ...] = stream.joints
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
            if is_table and field not in units:
                raise stream.missing(f"columns.{name}", f"one of {', '.join(units)}", field)
            self._fields[name] = field, self._factor(name, field, units.get(field, ""))

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a message, as far as they are known in advance."""
        return tuple(self._fields or ())

    def _check_columns(self, standard: Iterable[str]) -> None:
        """Refuse columns that no frame of the kind has, and vectors that lack a part. standard: its messages'"""
        stream, names = self.stream, {*standard, *self.stream.columns}
        known = [one.name for one in fields(KINDS[stream.kind]) if one.name not in ("stamp", "index", "device")]
        other = {*standard, *(f"q{axis}" for axis in "xyzw" if stream.kind == "arm")}
        for field in known:
            found, (base, unit) = columns_of(field, names), split_unit(field)
            of_axes = (f"{at}_{axis}" for at in range(len(found) // 3) for axis in "xyz")
            whole = [
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
        if said and given != said:
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
        row = {}
        for name, (field, factor) in (fields or {}).items():
            try:
                value = message.get(field)
            except KeyError:
                continue
            if isinstance(value, str) and value.startswith("["):
                value = json.loads(value)
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
            return np.asarray(row[name], kind).ravel()
        return np.array([np.nan if row[one] is None else row[one] for one in columns], kind)


_columns_of = lru_cache(columns_of)
"""All rows of a stream have the same columns."""


def _wrench(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    force = self.values(row, "force_n").reshape(-1, 3)
    torque = self.values(row, "torque_nm", size=force.size).reshape(-1, 3)
    if self.stream.nan == "refuse" and not self.own and not np.isfinite(force).all():
        is_empty = any(row[one] is None for one in columns_of("force_n", row))
        came = "nothing, or NaN," if is_empty else "inf" if np.isinf(force).any() else "NaN"
        raise InputError(
            f"forces of {self.stream.device} that are numbers", f"{came} in frame {at.index}", 'nan = "keep"'
        )
    counts = self.values(row, "counts", np.int64, 0)
    flags = bool(row.get("overload", False)), bool(row.get("usable", True))
    known = None if np.isnan(torque).all() else torque
    return WrenchFrame(at.stamp, at.index, counts, force, known, *flags, self.stream.device)


def _tactile(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    shapes, pressure = [(pad.rows, pad.columns) for pad in self.stream.pads], self.values(row, "pressure_pa")
    ends = np.cumsum([rows * columns for rows, columns in shapes])
    if not shapes or len(pressure) != ends[-1]:
        about = f"name, rows, columns, texel_m, index, finger, part of each, {len(pressure)} texels in all"
        raise self.stream.missing("pads", about, f"{ends[-1]} texels" if shapes else "")
    pads = tuple(one.reshape(shape) for one, shape in zip(np.split(pressure, ends[:-1]), shapes, strict=True))
    return TactileFrame(at.stamp, at.index, self.values(row, "counts", np.uint16, 0), pads, self.stream.device)


def _arm(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    from deformscope_drivers.arm.kinematics import euler_xyz_from_rotation

    if named := next((list(one.name) for one in at.values if hasattr(one, "name")), []):
        self.joints = self.joints or tuple(named)
        if self.stream.joints and not set(self.joints) <= set(named):
            return None  # another robot's, or another part's
        if set(self.joints) != set(named) and not self.stream.joints:
            came = f"{', '.join(self.joints)}, then {', '.join(named)}"
            raise self.stream.missing("joints", "names of the arm's, in their order", came)
        places = {name: at for at, name in reversed(list(enumerate(named)))}
        order = [places[name] for name in self.joints]
        row = {name: np.asarray(value)[order] if np.size(value) > 1 else value for name, value in row.items()}
    row, pose = {name: value for name, value in row.items() if np.size(value)}, at.pose
    if "qw" in row:
        pose = _pose([row.pop(f"q{axis}") for axis in "xyzw"], [row.pop(f"position_{axis}_m") for axis in "xyz"])
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
    image, _ = _images(self, row, at)
    if image is None:
        raise KeyError("image")
    return ColorFrame(at.stamp, at.index, image, self.stream.device)


def _depth(self: FrameBuilder, row: Row, at: At) -> Frame | None:
    color, depth = _images(self, row, at)
    if depth is None:
        raise KeyError("depth")
    if depth.ndim != 2:
        came = f"an image of shape {depth.shape}"
        raise InputError(f"distances of {self.stream.device} of one channel", came, 'kind = "color" in the map')
    is_real = depth.dtype.kind == "f"
    unit_m = float(row.get("unit_m") or self.stream.unit_m or (REAL_STEP_M if is_real else 1e-3))
    if not 1e-7 <= unit_m <= 10.0:
        raise InputError(f"a unit_m of distances of {self.stream.device} from 1e-7 to 10 m", f"{unit_m:g}")
    if is_real:
        counts = np.rint(np.nan_to_num(depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0) / unit_m)
        depth = np.where((counts > 0) & (counts < 65536), counts, 0).astype(np.uint16)
    return DepthFrame(at.stamp, at.index, depth.astype(np.uint16, copy=False), unit_m, color, self.stream.device)


def _images(self: FrameBuilder, row: Row, at: At) -> tuple[Any, Any]:
    """A colour image and one of distances, counts or real numbers in metres; None where there is none."""
    stream = self.stream
    encoded = row.get("image") or row.get("color"), row.get("depth")
    color, depth = (None if one is None else decode_image(bytes(one), stream.device) for one in encoded)
    for value in at.values:
        if isinstance(value, Path):
            image = _of_file(stream, value)
            is_depth = stream.kind == "depth" and (image.ndim == 2 or len(at.values) == 1)
        elif hasattr(value, "point_step"):
            image, is_depth = _cloud_depth(stream, value), True
        elif hasattr(value, "encoding"):
            image, is_depth = _raw_image(stream, value), value.encoding in DEPTH_ENCODINGS
        elif hasattr(value, "format"):
            is_depth = "compressedDepth" in value.format or (stream.kind == "depth" and "16UC1" in value.format)
            data = bytes(value.data)  # a depth image has a head of its own before the PNG
            image = decode_image(data[max(data.find(PNG_SIGNATURE), 0) if is_depth else 0 :], stream.device)
        else:
            continue
        color, depth = (color, image) if is_depth else (image, depth)
    for image in (color, depth):
        if image is not None and not all(1 <= side <= LONGEST_PX for side in image.shape[:2]):
            raise ValueError(f"expected sides of 1 to {LONGEST_PX} px; got {' x '.join(map(str, image.shape[:2]))}")
    return color, depth


def _of_file(stream: MappedStream, path: Path) -> Any:
    """An image file, or the distances of one of points."""
    if path.suffix.lower() not in CLOUDS:
        if stream.kind == "depth" and not stream.unit_m:
            raise stream.missing("unit_m", "the step of its images [m]: 0.001 for mm", "")
        return read_image(path)
    if (unit := stream.units.get("points", "")) not in SI or SI[unit][0] != "m":
        raise stream.missing("units.points", "m, cm, mm or um", unit)
    return depth_of_points(stream, read_points(path) * SI[unit][1])


def _raw_image(stream: MappedStream, value: Any) -> Any:
    """(H, W) or (H, W, 3) of a message. Raises InputError for an encoding that is not known."""
    order = ">" if value.is_bigendian else "<"
    if value.encoding in DEPTH_ENCODINGS:
        kind = np.dtype(f"{order}{'f4' if value.encoding == '32FC1' else 'u2'}")
        rows = _rows(value, value.width * kind.itemsize, value.step)
        return np.ascontiguousarray(rows).view(kind).astype(kind.newbyteorder("="))
    if value.encoding not in COLOR_ENCODINGS:
        known = ", ".join((*DEPTH_ENCODINGS, *COLOR_ENCODINGS))
        raise InputError(f"images of {stream.device} encoded as {known}", repr(value.encoding))
    channels = COLOR_ENCODINGS[value.encoding]
    rows = _rows(value, value.width * channels, value.step)
    image = rows.reshape(value.height, value.width, channels)
    image = image[..., 2::-1] if value.encoding.startswith("bgr") else image[..., :3]
    return np.ascontiguousarray(image[..., 0] if channels == 1 else image)


def _rows(value: Any, used: int, stride: int) -> Any:
    """(H, used) bytes of a message with rows `stride` bytes apart. Raises ValueError if they are not its bytes."""
    if used > stride or value.height * stride != len(value.data):
        rows = f"{value.height} rows of {used} bytes each, {stride} bytes apart"
        raise ValueError(f"expected {rows}, as the message says; got {len(value.data)} bytes")
    return np.asarray(value.data, np.uint8).reshape(value.height, stride)[:, :used]


def _cloud_depth(stream: MappedStream, value: Any) -> Any:
    """Distances of a message of points along z [m]: (H, W) in their order, or projected into the camera of the map."""
    of = {one.name: one for one in value.fields}
    if missing := [axis for axis in AXES if axis not in of]:
        raise ValueError(f"expected fields x, y and z; got no {missing[0]} in {', '.join(of) or 'none'}")
    for one in value.fields:
        size = np.dtype(POINT_TYPES.get(one.datatype, "V0")).itemsize * max(one.count, 1)
        if not size or one.offset + size > value.point_step or (one.count > 1 and one.name in AXES):
            came = f"{one.count} of type {one.datatype} from byte {one.offset} on"
            raise ValueError(f"expected {one.name} within the {value.point_step} bytes of its point; got {came}")
    rows = _rows(value, value.width * value.point_step, value.row_step)
    order = ">" if value.is_bigendian else "<"
    formats = [order + POINT_TYPES[of[axis].datatype] for axis in AXES]
    offsets = [of[axis].offset for axis in AXES]
    kind = np.dtype({"names": AXES, "formats": formats, "offsets": offsets, "itemsize": value.point_step})
    points = np.ascontiguousarray(rows).view(kind)
    return depth_of_points(stream, np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=-1))


def depth_of_points(stream: MappedStream, points_m: FloatArray) -> FloatArray:
    """Distances along z [m] of points (H, W, 3): in their order if H > 1, else projected into the map's camera, with
    the nearest point for each pixel."""
    if len(points_m) > 1:
        return points_m[..., 2]
    given = {"focal_px": stream.focal_px, "center_px": stream.center_px, "size_px": stream.size_px}
    for key, value in given.items():
        if value is None:
            raise stream.missing(key, "of the camera that points without an order are projected into [px]", "")
    (fx, fy), (cx, cy), (width, height) = stream.focal_px, stream.center_px, stream.size_px  # type: ignore[misc]
    x, y, z = points_m.reshape(-1, 3)[np.isfinite(points_m.reshape(-1, 3)).all(axis=1)].T
    x, y, z = x[z > 0], y[z > 0], z[z > 0]
    with np.errstate(all="ignore"):  # beside the axis, near it, and where the map's camera is none
        column, row = np.rint(fx * x / z + cx), np.rint(fy * y / z + cy)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    check_size("an image of size_px", 8.0 * height * width, stream.device)
    depth = np.full((height, width), np.inf)
    np.minimum.at(depth, (row[inside].astype(np.int64), column[inside].astype(np.int64)), z[inside])
    return depth


def _pose(quaternion: Any, position: Any) -> Pose:
    """(4, 4) of x, y, z, w and metres."""
    from scipy.spatial.transform import Rotation

    T: Pose = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), position
    return T


def pose_of(value: Any) -> Pose:
    """(4, 4) of a transform message, or a pose. Raises AttributeError if it has no pose."""
    turn = getattr(value, "rotation", None)
    place = getattr(value, "translation", None)
    turn, place = (value.orientation, value.position) if turn is None or place is None else (turn, place)
    return _pose([turn.x, turn.y, turn.z, turn.w], [place.x, place.y, place.z])


_MAKE: dict[Kind, Callable[..., Frame | None]] = {
    "wrench": _wrench,
    "tactile": _tactile,
    "arm": _arm,
    "hand": _hand,
    "color": _color,
    "depth": _depth,
}
