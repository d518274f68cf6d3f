"""ROS 2 message definitions that an MCAP brings along: the standard ones it uses, and one for each kind of stream."""

from __future__ import annotations

import inspect
from typing import Any

import pyarrow as pa

from deformscope.recording.export.table_files import IMAGES
from deformscope.recording.streams import SCHEMA_VERSION, RecordedStream
from deformscope.rows import FRAMES, field_of

PACKAGE = "deformscope_msgs"
_LINE = "=" * 80
_PLACES = ("session_ns", "host_ns", "index")

STANDARD: dict[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
        "uint8[] data"
    ),
    "sensor_msgs/RegionOfInterest": ("uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify"),
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
        "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    ),
    "sensor_msgs/PointField": (
        "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\n"
        "uint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count"
    ),
    "sensor_msgs/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense"
    ),
}
_TYPES = {pa.float64(): "float64", pa.float32(): "float32", pa.string(): "string", pa.bool_(): "bool"}


def definition(name: str) -> str:
    """A standard message with all that it is made of, as an MCAP's schema has it."""
    return _with_parts(STANDARD[name])


def stream_definition(stream: RecordedStream) -> tuple[str, dict[str, tuple[str, bool]]]:
    """The message of a stream, documented by what its kind says of itself and by units; and of each column its field
    and whether that is a list of at most one: a number that may be missing. A real number that is missing is NaN."""
    known = [line for kind in stream.kinds for line in (inspect.getdoc(kind) or "").splitlines()]
    about = [f"# {line}".rstrip() for line in (f"deformscope export, schema version {SCHEMA_VERSION}", *known)]
    fields = {}
    lines = ["std_msgs/Header header"]
    for column in stream.schema:
        if column.name in IMAGES:
            continue
        name, missing = column.name.lower(), is_optional(stream, column)
        unit = (column.metadata or {}).get(b"unit", b"").decode()
        lines.append(f"{_ros_type(column.type)}{'[<=1]' if missing else ''} {name}{unit and f'  # [{unit}]'}")
        fields[column.name] = name, missing
    return "\n".join([*about, _with_parts("\n".join(lines))]), fields


def is_optional(stream: RecordedStream, column: pa.Field) -> bool:
    """Whether a message needs to say that the number of a column is missing."""
    if not (pa.types.is_integer(column.type) or pa.types.is_boolean(column.type)) or column.name in _PLACES:
        return False
    kind: Any = stream.kinds[-1] if stream.kinds else None
    of = None if kind is None else field_of(kind, column.name) or field_of(kind, f"stamp.{column.name}")
    if column.name in ("device_ticks", "late_ns"):
        return True
    return kind not in FRAMES if of is None else of.optional


def _ros_type(kind: pa.DataType) -> str:
    if pa.types.is_list(kind):
        return f"{_ros_type(kind.value_type)}[]"
    return "uint8[]" if pa.types.is_large_binary(kind) else _TYPES.get(kind, str(kind))


def _with_parts(text: str) -> str:
    parts: dict[str, str] = {}

    def add(own: str) -> None:
        for line in own.splitlines():
            name = line.split()[0].partition("[")[0] if line.split() else ""
            if name in STANDARD and name not in parts:
                parts[name] = STANDARD[name]
                add(STANDARD[name])

    add(text)
    return "\n".join([text, *(f"{_LINE}\nMSG: {name}\n{part}" for name, part in parts.items())]) + "\n"
