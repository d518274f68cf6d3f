"""A recording as MCAP with ROS 2 messages; ROS need not be installed.

Each stream is a topic with its entity's name, whose message has every column. Further topics have standard types of
ROS: wrenches, joint states, images, camera calibrations, points, transforms and robot descriptions. ROS messages are in
metres, radians and the frames of REP 103 and 105 (`world`; cameras as `DEVICE_optical_frame`: z forward, x right, y
down).

The images of a recording as files, byte for byte as they were recorded, and as videos."""

import inspect
import json
import logging
import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pyarrow as pa

from deformscope.errors import InputError
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, HandFrame, WrenchFrame
from deformscope.images import PNG_SIGNATURE, decode_image
from deformscope.plain import plain
from deformscope.recording.export.manifest import SCHEMA_VERSION
from deformscope.recording.export.table_files import IMAGES
from deformscope.recording.reader import Replay
from deformscope.recording.streams import TRANSFORMS, RecordedStream, RecordingTables
from deformscope.rows import FRAMES, field_of
from deformscope.stages.map.exploration import SurfaceEstimate
from deformscope.stages.map.measured import LookFrames

VIDEO_CODEC, VIDEO_SUFFIX = "vp09", ".mp4"
"""Free of patents, in OpenCV's own wheel, and shown by browsers."""
TICKS_HZ = 90_000
"""Resolution of a video's times."""
Note = Callable[[str, int, int], None]
ImageNames = Mapping[tuple[str, str], str]
"""Name of a folder or a file for images, by device and kind."""


@dataclass(frozen=True, slots=True)
class ExportedImages:
    """Files of one kind. device: the camera; what: image, depth, or color (of a depth camera)"""

    device: str
    what: str
    folder: Path
    count: int


def counted_images(replay: Replay, devices: Collection[str] | None) -> dict[tuple[str, str], int]:
    """Number of images, by device and kind. devices: export only these devices' images; None = all.

    Raises InputError without images."""
    counts = {one: count for one, count in replay.image_counts.items() if devices is None or one[0] in devices}
    if not counts:
        known = sorted({device for device, _ in replay.image_counts})
        came = "none" if devices is None else f"none of {', '.join(map(repr, devices))}"
        hint = f"--camera {' or '.join(known)}" if known else ""
        raise InputError("images in the recording", came, hint, replay.path)
    return counts


def export_images(tables: RecordingTables, folders: Mapping[tuple[str, str], Path], note: Note) -> None:
    """Write the images as `INDEX.jpg` and `INDEX.png`. folders: folders by device and kind; note: called with what is
    done, and of how much."""
    for path in folders.values():
        path.mkdir(parents=True, exist_ok=True)
    devices = {device for device, _ in folders}
    cameras = {entity: one for entity, one in tables.streams.items() if one.device in devices}
    cameras = {entity: one for entity, one in cameras.items() if set(one.schema.names) & set(IMAGES)}
    total, done = sum(one.rows for one in cameras.values()), 0
    for stream, batch in tables.batches(cameras):
        for row in batch.select([n for n in batch.schema.names if n in ("index", *IMAGES)]).to_pylist():
            for what in IMAGES:
                if encoded := row.get(what):
                    suffix = "png" if encoded.startswith(PNG_SIGNATURE) else "jpg"
                    (folders[stream.device, what] / f"{row['index']:06d}.{suffix}").write_bytes(encoded)
            done += 1
            note("images", done, total)


class Videos:
    """A video of each kind of images at their recorded times, which the table of the same name has, too. Distances are
    shown as colours from 0 (violet) to the largest of the first image."""

    def __init__(self, folder: Path, rates_hz: dict[str, float], names: ImageNames) -> None:
        self._folder, self._rates_hz, self._names = folder, rates_hz, names
        self._open: dict[Path, tuple[cv2.VideoWriter, tuple[int, ...], float]] = {}
        self._ticks: dict[Path, list[int]] = {}
        self.counts: Counter[Path] = Counter()

    def write(self, device: str, what: str, encoded: bytes, host_ns: int) -> None:
        """Add an image, with its time."""
        path = self._folder / (self._names[device, what] + VIDEO_SUFFIX)
        image: Any = decode_image(encoded, path)
        if path not in self._open:
            self._open[path] = (self._begin(path, device, image), image.shape[:2], float(image.max()) or 1.0)
        writer, size, most = self._open[path]
        if image.shape[:2] != size:
            raise InputError(f"images of {device} of one size", f"{size} and {image.shape[:2]}", "--to images")
        if what == "depth":
            image = cv2.applyColorMap((255.0 * np.minimum(image / most, 1.0)).astype(np.uint8), cv2.COLORMAP_TURBO)
        elif image.ndim == 2:
            image = np.repeat(
                (image >> 8 if image.dtype == np.uint16 else image).astype(np.uint8)[..., None], 3, axis=2
            )
        else:
            image = image[..., ::-1]
        writer.write(np.ascontiguousarray(image))
        self.counts[path] += 1
        ticks, tick = self._ticks.setdefault(path, []), host_ns * TICKS_HZ // 10**9
        ticks.append(max(tick, ticks[-1] + 1) if ticks else tick)

    def close(self) -> None:
        """Raises InputError if a video is incomplete: OpenCV does not report a full disk."""
        for path, (writer, size, _) in self._open.items():
            writer.release()
            self._retime(path, size)
            if cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) < self.counts[path] - 1:
                raise InputError("a video of all images", "one that is cut off: is the disk full?", where=path.name)

    def _retime(self, path: Path, size: tuple[int, ...]) -> None:
        """Put the frames at their times: OpenCV encodes at an even rate, but takes encoded frames with times."""
        even, code = path.rename(path.with_name(f".even-{path.name}")), cv2.VideoWriter.fourcc(*VIDEO_CODEC)
        frames = cv2.VideoCapture(str(even), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
        raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, float(TICKS_HZ), size[::-1], raw)
        for index, tick in enumerate(self._ticks[path]):
            done, frame = frames.read()
            if not done:  # which `close` reports
                break
            since = tick - self._ticks[path][0]
            writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, frames.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME))
            writer.set(cv2.VIDEOWRITER_PROP_PTS, since)
            writer.set(cv2.VIDEOWRITER_PROP_DTS_DELAY, index - since)  # from its place to its time
            writer.write(frame)
        frames.release()
        writer.release()
        even.unlink()

    def _begin(self, path: Path, device: str, image: Any) -> cv2.VideoWriter:
        height, width = image.shape[:2]
        codec, rate = cv2.VideoWriter.fourcc(*VIDEO_CODEC), self._rates_hz[device] or 1.0
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, rate, (width, height))
        if not writer.isOpened():
            raise InputError(f"OpenCV with {VIDEO_CODEC}", "one without", "--to images", path.name)
        return writer


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


_logger = logging.getLogger(__name__)
LATCHED = (
    "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1\n  deadline: {sec: 9223372036, nsec: 854775807}\n"
    "  lifespan: {sec: 9223372036, nsec: 854775807}\n  liveliness: 1\n"
    "  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}\n  avoid_ros_namespace_conventions: false\n"
)
"""QoS of rosbag2 for a topic whose last message late subscribers also receive."""
MOVABLE = ("revolute", "continuous", "prismatic")
"""Joints of a URDF that an arm's angles turn; those of fingers follow."""
Row = dict[str, Any]


def ros_names(names: Iterable[str]) -> dict[str, str]:
    """Topics of entities or devices: letters that ROS does not allow are `_`, and each name has a topic of its own."""
    found: dict[str, str] = {}
    for name in names:
        plain = "/" + re.sub(r"[^A-Za-z0-9_/]", "_", name)
        others = (f"{plain.rstrip('_')}_{number}" for number in count(2))
        found[name] = next(one for one in chain([plain], others) if one not in found.values())
    return found


def write_mcap(
    tables: RecordingTables, chosen: Mapping[str, RecordedStream], path: Path, about: Mapping[str, Any], note: Note
) -> list[tuple[str, str, int]]:
    """Write the file; returns (topic, file, messages) of each topic. about: has `topics` of entities, `device_topics`
    of devices.

    Raises InputError if the package is not installed."""
    try:
        from mcap.writer import CompressionType, Writer
        from mcap_ros2._dynamic import serialize_dynamic
        from rosbags import typesys  # noqa: F401
    except ImportError:
        missing = "pip install 'deformscope[mcap]'"
        raise InputError("the packages mcap, mcap-ros2-support and rosbags", "none", missing) from None
    with path.open("wb") as file:
        writer: Any = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="deformscope")
        bag = _Bag(writer, serialize_dynamic)
        topics = _Topics(bag, tables, chosen, about)
        total, done = sum(stream.rows for stream in chosen.values()), 0
        for stream, batch in tables.batches(chosen, gather=False):
            for row in batch.to_pylist():
                topics.write(stream, row)
            done += batch.num_rows
            note("rows", done, total)
        topics.close()
        said = {name: json.dumps(plain(value), allow_nan=False) for name, value in about.items()}
        writer.add_metadata("deformscope", said)
        writer.finish()
    return [(topic, path.name, count) for topic, count in sorted(bag.counts.items())]


class _Bag:
    """Topics of an MCAP as they are written to. counts: messages by topic"""

    def __init__(self, writer: Any, encoders: Callable[[str, str], dict[str, Callable[[Any], bytes]]]) -> None:
        self._writer, self._encoders = writer, encoders
        self._schemas: dict[str, tuple[int, Callable[[Any], bytes]]] = {}
        self._channels: dict[str, tuple[int, Callable[[Any], bytes]]] = {}
        self.counts: Counter[str] = Counter()

    def add(self, topic: str, kind: str, text: str | None, message: Row, ns: int, *, latched: bool = False) -> None:
        """Write a message. kind: PACKAGE/NAME; text: its definition, None = standard; ns: its time [ns]"""
        if topic not in self._channels:
            if kind not in self._schemas:
                name, text = kind.replace("/", "/msg/"), definition(kind) if text is None else text
                encode = self._encoders(name, text)[name]
                self._schemas[kind] = self._writer.register_schema(name, "ros2msg", text.encode()), encode
            schema, encode = self._schemas[kind]
            offered = {"offered_qos_profiles": LATCHED if latched else ""}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema, offered), encode
        channel, encode = self._channels[topic]
        self._writer.add_message(channel, ns, encode(message), ns, self.counts[topic])
        self.counts[topic] += 1


class _Topics:
    """Messages of each stream."""

    def __init__(
        self, bag: _Bag, tables: RecordingTables, chosen: Mapping[str, RecordedStream], about: Mapping[str, Any]
    ) -> None:
        self._bag, self._start_ns = bag, tables.start_ns or 0
        self._topics, self._devices = about["topics"], about["device_topics"]
        self._own: dict[str, tuple[str, str, dict[str, tuple[str, bool]]]] = {}
        names: dict[str, str] = {}
        for entity, stream in chosen.items():
            text, fields = stream_definition(stream)
            kind = stream.kinds[-1].__name__ if stream.kinds else "Transforms"
            known = sum(name.rstrip("0123456789") == kind for name in names.values())
            names.setdefault(text, f"{kind}{known + 1}" if known else kind)
            self._own[entity] = f"{PACKAGE}/{names[text]}", text, fields
        depth = [stream.device for stream in tables.streams.values() if DepthFrame in stream.kinds]
        self._camera = depth[0] if depth else "camera"
        self._lens = _lens(tables, self._camera)
        self._unposted: list[tuple[int, Row]] = []
        self._still: list[Row] = []
        self._moving: set[str] = set()
        self._joints: dict[str, list[str]] = {}
        for stream in chosen.values():
            if stream.about is not None and stream.about.urdf is not None and stream.about.urdf.is_file():
                try:
                    text = stream.about.urdf.read_text(encoding="utf-8")
                    joints = [one for one in ElementTree.fromstring(text).iter("joint") if one.get("type") in MOVABLE]
                except (OSError, ValueError, ElementTree.ParseError) as error:
                    _logger.warning("%s is left out, which is no robot description: %s", stream.about.urdf, error)
                    continue
                self._joints[stream.device] = [one.get("name", "") for one in joints]
                if not tables.anonymous:  # it may name a person, a path or a machine anywhere
                    topic = f"{self._devices[stream.device]}/robot_description"
                    self._bag.add(topic, "std_msgs/String", None, {"data": text}, self._start_ns, latched=True)

    def write(self, stream: RecordedStream, row: Row) -> None:
        """One row."""
        ns = row.get("host_ns")
        ns = (self._start_ns + (row["session_ns"] or 0)) if ns is None else ns
        header = _header(ns, stream.device)
        kind, text, fields = self._own[stream.entity]
        message: Row = {"header": header}
        for column, (name, optional) in fields.items():
            value = row[column]
            message[name] = ([] if value is None else [value]) if optional else value
            if value is None and not optional:
                message[name] = _NOTHING.get(str(stream.schema.field(column).type), [])
        self._bag.add(self._topics[stream.entity], kind, text, message, ns)
        self._write_standard(stream, row, header, ns)

    def close(self) -> None:
        """Write the rest: the last transforms, and in one message the static ones."""
        self._post()
        # A joint's rest pose stands still in the recording too; for ROS a frame either moves or does not.
        if own := [one for one in self._still if one["child_frame_id"] not in self._moving]:
            still = {"transforms": own}
            self._bag.add("/tf_static", "tf2_msgs/TFMessage", None, still, self._start_ns, latched=True)

    def _write_standard(self, stream: RecordedStream, row: Row, header: Row, ns: int) -> None:
        topic = self._devices[stream.device]
        if stream.entity == TRANSFORMS:
            self._add_transform(row, ns)
        for kind in stream.kinds:
            if kind is WrenchFrame:
                self._write_wrenches(topic, row, header, ns)
            elif kind is ArmFrame:
                state = _joints(row, header, "joint", "joint_velocity", "joint_torque")
                if len(own := self._joints.get(stream.device, [])) >= len(state["name"]):
                    state["name"] = own[: len(state["name"])]
                self._bag.add(f"{topic}/joint_states", "sensor_msgs/JointState", None, state, ns)
                self._write_wrenches(topic, row, header, ns)
            elif kind is HandFrame:
                state = _joints(row, header, "position", "velocity", "torque")
                self._bag.add(f"{topic}/joint_states", "sensor_msgs/JointState", None, state, ns)
            elif kind in (ColorFrame, DepthFrame):
                self._write_images(topic, row, _header(ns, self._optical(stream.device)), ns)
            elif kind is SurfaceEstimate:
                cloud = _cloud(row["points_m"], _header(ns, "surface"))
                self._bag.add(f"{self._topics[stream.entity]}/points", "sensor_msgs/PointCloud2", None, cloud, ns)

    def _write_wrenches(self, topic: str, row: Row, header: Row, ns: int) -> None:
        for channel in ("", *(f"{number}_" for number in range(8))):
            if f"force_{channel}x_n" in row:
                force = {axis: row[f"force_{channel}{axis}_n"] for axis in "xyz"}
                torque = {axis: row.get(f"torque_{channel}{axis}_nm") for axis in "xyz"}
                torque = {axis: math.nan if value is None else value for axis, value in torque.items()}
                message = {"header": header, "wrench": {"force": force, "torque": torque}}
                name = f"{topic}/wrench{channel and f'_{channel[:-1]}'}"
                self._bag.add(name, "geometry_msgs/WrenchStamped", None, message, ns)

    def _write_images(self, topic: str, row: Row, header: Row, ns: int) -> None:
        for what in ("image", "color"):
            if encoded := row.get(what):
                kind = "png" if encoded.startswith(PNG_SIGNATURE) else "jpeg"
                image = {"header": header, "format": kind, "data": encoded}
                self._bag.add(f"{topic}/color/compressed", "sensor_msgs/CompressedImage", None, image, ns)
        if encoded := row.get("depth"):
            depth: Any = decode_image(encoded, topic)
            millimetres = math.isclose(row["unit_m"], 1e-3)
            data = depth.astype("<u2") if millimetres else (depth * row["unit_m"]).astype("<f4")
            height, width = depth.shape
            about = {"header": header, "height": height, "width": width}
            shown = {"encoding": "16UC1" if millimetres else "32FC1", "is_bigendian": 0, "step": data.strides[0]}
            image = about | shown | {"data": data.tobytes()}
            self._bag.add(f"{topic}/depth/image", "sensor_msgs/Image", None, image, ns)
            if self._lens is not None and topic == self._devices[self._camera]:
                self._bag.add(f"{topic}/depth/camera_info", "sensor_msgs/CameraInfo", None, about | self._lens, ns)

    def _add_transform(self, row: Row, ns: int) -> None:
        parent, child = (self._frame_name(row[name]) for name in ("parent_frame", "child_frame"))
        if parent == child:
            return
        place = {axis: row[f"{axis}_m"] or 0.0 for axis in "xyz"}
        turn = {axis: row.get(f"q{axis}") or 0.0 for axis in "xyz"}
        scalar = row.get("qw")
        turn |= {"w": 1.0 if scalar is None else scalar}
        transform = {"header": _header(ns, parent), "child_frame_id": child}
        transform |= {"transform": {"translation": place, "rotation": turn}}
        if row["session_ns"] is None:
            self._still.append(transform)
            return
        if self._unposted and self._unposted[0][0] != ns:
            self._post()
        self._unposted.append((ns, transform))
        self._moving.add(child)

    def _post(self) -> None:
        """Transforms of one moment are one message."""
        if self._unposted:
            message = {"transforms": [transform for _, transform in self._unposted]}
            self._bag.add("/tf", "tf2_msgs/TFMessage", None, message, self._unposted[0][0])
        self._unposted = []

    def _frame_name(self, name: str) -> str:
        if name.startswith("tf#"):
            return "world"
        return self._optical(self._camera) if name == "camera" else name

    def _optical(self, camera: str) -> str:
        return f"{self._devices.get(camera, camera).strip('/').replace('/', '_')}_optical_frame"


_NOTHING: dict[str, Any] = {"double": math.nan, "float": math.nan, "string": "", "int64": 0, "bool": False}


def _lens(tables: RecordingTables, camera: str) -> Row | None:
    """The calibration of the depth camera; None where the recording does not say it."""
    looks = [entity for entity, stream in tables.streams.items() if LookFrames in stream.kinds]
    found: Row = next((batch.to_pylist()[0] for _, batch in tables.batches(looks)), {}) if looks else {}
    if not found:
        try:
            found = tomllib.loads(tables.settings.get("rig", "")).get("camera", {})
        except (tomllib.TOMLDecodeError, TypeError, AttributeError):
            return None
    if not found.get("focal_px") or found.get("device") not in (None, camera):
        return None
    (fx, fy), (cx, cy) = found["focal_px"], found["center_px"]
    lens: Row = {"distortion_model": "plumb_bob", "d": [*map(float, found.get("distortion") or (0.0,) * 5)]}
    lens |= {"k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]}
    lens |= {"p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0], "binning_x": 0, "binning_y": 0}
    return lens | {"roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}}


def _joints(row: Row, header: Row, position: str, velocity: str, effort: str) -> Row:
    """Angles [rad], speeds [rad/s] and torques [N m] of all joints."""
    count = sum(re.fullmatch(rf"{position}_\d+_deg", name) is not None for name in row)
    turned = {"position": f"{position}_{{}}_deg", "velocity": f"{velocity}_{{}}_deg_s"}
    state = {name: [math.radians(row[of.format(at)]) for at in range(count)] for name, of in turned.items()}
    torques = [row.get(f"{effort}_{at}_nm") for at in range(count)]
    names = [f"{header['frame_id']}_joint_{at}" for at in range(count)]
    return {"header": header, "name": names, "effort": [] if None in torques else torques, **state}


def _cloud(points_m: list[float], header: Row) -> Row:
    """(n, 3) points, one after the other, as float32."""
    data = np.asarray(points_m, "<f4")
    fields = [{"name": axis, "offset": 4 * at, "datatype": 7, "count": 1} for at, axis in enumerate("xyz")]
    about = {"header": header, "height": 1, "width": len(data) // 3, "fields": fields, "is_bigendian": False}
    return about | {"point_step": 12, "row_step": 4 * len(data), "data": data.tobytes(), "is_dense": True}


def _header(ns: int, frame: str) -> Row:
    if not 0 <= ns < 2**31 * 10**9:
        raise InputError("times from 0 to 2038, as ROS has them", f"{ns / 1e9:.4g} s", "--to parquet")
    return {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": frame}
