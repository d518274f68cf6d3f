"""ROS 2 message definitions inside an MCAP: the standard ones that it uses, and one for each kind of stream."""

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

_TYPES = {pa.float64(): "float64", pa.float32(): "float32", pa.string(): "string", pa.bool_(): "bool"}


def definition(name: str) -> str:
    """A standard message with all its parts, as in an MCAP's schema."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(name.replace("/", "/msg/"), ros_version=2)[0]


def stream_definition(stream: RecordedStream) -> tuple[str, dict[str, tuple[str, bool]]]:
    """The message of a stream, documented with its kind's description and units; and for each column its field, and
    whether that is a list of at most one number, which may be missing. A real number that is missing is NaN."""
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
    return "\n".join([*about, *lines, _LINE, "MSG: std_msgs/Header", definition("std_msgs/Header")]), fields


def is_optional(stream: RecordedStream, column: pa.Field) -> bool:
    """Whether the number of a column may be missing."""
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
