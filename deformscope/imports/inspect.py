"""The content of a source, and a proposal of a map."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.errors import InputError
from deformscope.frames import Stream
from deformscope.images import read_image
from deformscope.imports.frame_builder import CLOUDS, DEPTH_UNIT, KINDS, STANDARD, STEP_M, sides_of
from deformscope.imports.image_messages import REAL, is_depth, parse_format
from deformscope.imports.import_map import ASKED, ImportMap, MappedStream
from deformscope.imports.point_files import read_points
from deformscope.imports.poses import STATIC
from deformscope.imports.readers import TABLE_TYPES, Reader, Topic
from deformscope.imports.source import CLOCKS_APART_S, Counted
from deformscope.recording.export.manifest import Manifest

TIMES = ("host_ns", "time", "timestamp", "stamp", "t", "datetime", "zeit")
"""Names of columns with times, in lower case and without their units, the likeliest first."""


@dataclass(slots=True)
class Found:
    """A topic, as found in the source. seen: times at which its messages were recorded; stamp_ns: time stamp of the
    first message itself, None = it has none; encoding: encoding of images; frames: frames of transforms, where
    is_tree; matrices: field of matrices in a list; is_behind: most points of the first file have negative z
    joints: names of joints in the first message; cells: what fields of a table's first row hold that are no numbers
    unread: why its first message cannot be read"""

    topic: Topic
    seen: Counted = field(default_factory=Counted)
    stamp_ns: int | None = None
    encoding: str = ""
    is_tree: bool = False
    matrices: str = ""
    is_behind: bool = False
    frames: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    cells: dict[str, str] = field(default_factory=dict)
    unread: str = ""

    @property
    def clock_s(self) -> float | None:
        """How far its own stamps are behind the time of recording [s]; None = it has no stamps."""
        return None if self.stamp_ns is None or not self.seen.first_ns else (self.seen.first_ns - self.stamp_ns) / 1e9

    def look(self, value: Any) -> None:
        """Describe the topic from its first message."""
        self.encoding = _encoding(value)
        self.is_tree = hasattr(value, "transforms")
        for name, items in vars(value).items() if hasattr(value, "__msgtype__") else ():
            if isinstance(items, list) and items and sides_of(value, f"{name}.data"):
                arrays = (key for key, one in vars(items[0]).items() if isinstance(one, np.ndarray))
                self.matrices = next((f"{name}.{key}" for key in arrays), self.matrices)
        if isinstance(value, Path) and value.suffix.lower() in CLOUDS:
            z = read_points(value)[..., 2]
            self.is_behind = bool(np.count_nonzero(z < 0) > np.count_nonzero(z > 0))
        if isinstance(value, Mapping):
            texts = {name: f"text {one[:20]!r}" for name, one in value.items() if isinstance(one, str)}
            lists = {name: f"{len(one)} numbers" for name, one in value.items() if isinstance(one, list)}
            self.cells = {} if self.topic.kind else texts | lists
        self.joints = tuple(value.name) if self.topic.type.endswith("JointState") else ()
        stamp = getattr(getattr(value, "header", None), "stamp", None)
        self.stamp_ns = None if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)

    def to_text(self) -> str:
        rate_hz, gap_s = self.seen.rate_hz, self.seen.gap_ns / 1e9
        rate = f", {rate_hz:.4g}/s, longest gap {gap_s:.3g} s" if rate_hz else ""
        clock = "" if self.clock_s is None else f", stamped {self.clock_s:.4g} s before it was recorded"
        frames = f", frames {', '.join(self.frames)}" if self.frames else ""
        joints = f", joints {', '.join(self.joints)}" if self.joints else ""
        about = {name: self.cells.get(name, "" if self.topic.kind else unit) for name, unit in self.topic.units.items()}
        columns = ", ".join(f"{name} ({one})" if one and one not in name else name for name, one in about.items())
        columns = f", columns {columns}" if columns else ""
        details = f"{self.topic.form}{rate}{clock}{frames}{joints}{columns}{self.unread}"
        return f"{self.topic.name}: {self.topic.type}, {self.seen.count} messages{details}"


def inspect(reader: Reader) -> list[Found]:
    """Read the source once, message by message. Raises InputError if the source is empty."""
    found = {name: Found(topic) for name, topic in reader.topics.items()}
    if not found:
        raise InputError("a source with topics", "an empty one")
    for message in reader.messages(list(found)):
        one = found[message.topic]
        if not one.seen.count:
            try:
                one.look(message.value)
            except InputError as error:  # of a type that is not known; others can be imported
                one.unread = f", not read: {error}"
        one.seen.add(message.log_ns or (message.value.get("host_ns") or 0 if isinstance(message.value, Mapping) else 0))
        if one.is_tree and len(one.frames) < 50:
            names = [(each.header.frame_id, each.child_frame_id) for each in message.value.transforms]
            one.frames = tuple(dict.fromkeys((*one.frames, *(name for pair in names for name in pair))))
    return list(found.values())


def _encoding(value: Any) -> str:
    """An image's encoding: that of its message, or `16UC1` of a file of counts; empty if it has none."""
    if isinstance(value, Path) and value.suffix.lower() not in CLOUDS:
        image = read_image(value)
        return "16UC1" if image.ndim == 2 and image.dtype == np.uint16 else "rgb8"
    return str(getattr(value, "encoding", getattr(value, "format", "")))


def propose(reader: Reader, found: list[Found]) -> ImportMap:
    """A map of the known values; `?` for those that the source does not contain."""
    names = {kind.__name__: kind_name for kind_name, kind in KINDS.items()}
    if own := [one for one in found if one.topic.kind in names]:
        # CSV leaves images out.
        own = [one for one in own if one.topic.type != "csv" or names[one.topic.kind] not in ("color", "depth")]
        streams = [_own(one, names[one.topic.kind], found, reader.about) for one in own]
        return ImportMap(tuple(streams), reader.about.session_starts_ns)
    clocks = [one.clock_s for one in found if one.clock_s is not None]
    same = bool(clocks) and max(clocks) - min(clocks) < CLOCKS_APART_S
    poses = [one for one in found if one.is_tree or one.topic.type.endswith("PoseStamped")]
    poses.sort(key=lambda one: one.topic.name.endswith(STATIC))
    joints = [one for one in found if one.topic.type.endswith("JointState")]
    streams = []
    for one in found:
        kind, _ = STANDARD.get(one.topic.type, ("wrench", {}))
        asked: dict[str, Any] = {"device": one.topic.name.rsplit(".", 1)[0].strip("/").replace("/", "_"), "kind": kind}
        if one.topic.type in TABLE_TYPES:
            # only the owner of a foreign table can identify its columns
            bare = {name: re.split(r"\s*[\[(<#]", name)[0].lower() for name in one.topic.units}
            time = next((name for known in TIMES for name, base in bare.items() if base == known), ASKED)
            if time == ASKED:
                time = next((name for name, unit in one.topic.units.items() if unit == "ns"), ASKED)
            unit = "" if time == ASKED else one.topic.units[time] or ("ns" if time.endswith("_ns") else ASKED)
            columns = {f"force_{axis}_n": ASKED for axis in "xyz"}
            asked |= {"columns": columns, "units": {ASKED: ASKED}, "time": time, "time_unit": unit}
        elif one.topic.type == "files":
            is_cloud = one.topic.name.endswith(CLOUDS)
            asked["device"] = one.topic.name.rpartition("/")[0].replace("/", "_") or "camera"
            asked |= {"kind": "depth" if is_cloud or one.encoding == "16UC1" else "color", "time": ASKED}
            asked |= {"time_unit": ASKED, "units": {"points": ASKED} if is_cloud else {}}
            asked |= {"axes": "x, -y, -z"} if one.is_behind else {}
        elif one.matrices:
            columns = {"pressure_pa": one.matrices}
            asked |= {"kind": "tactile", "columns": columns, "units": {one.matrices: ASKED}}
        elif one.topic.type not in STANDARD or (joints and one in poses):
            continue
        elif one.topic.type.endswith("Image"):
            asked["kind"] = "depth" if is_depth(one.encoding) else "color"
            counts = parse_format(one.encoding)[0]
            if is_depth(one.encoding) and not (
                counts in (*STEP_M, REAL) or any(DEPTH_UNIT.match(of.topic.name) for of in found)
            ):
                asked["unit_m"] = ASKED
        if one in joints:
            of_tf = ASKED if poses and poses[0].is_tree else ""
            asked |= {"pose": poses[0].topic.name if poses else ASKED, "parent": of_tf, "child": of_tf}
            asked["joints"] = one.joints
        if one.topic.type in STANDARD and not one.stamp_ns:
            asked["time"] = "log"
        elif not same and one.clock_s is not None and abs(one.clock_s) > CLOCKS_APART_S:
            asked["offset_s"] = ASKED
        streams.append(MappedStream(topics=(one.topic.name,), **asked))
    return ImportMap(tuple(streams))


def _own(one: Found, kind: Any, found: list[Found], about: Manifest) -> MappedStream:
    """The stream of an export of deformscope, which names all columns. Images of an MCAP are separate messages."""
    files = [(each.entity, name) for each in about.streams for name in each.files]
    entities = [entity for entity, name in [*about.topics.items(), *files] if name == one.topic.name]
    named = one.topic.name.strip("/").removesuffix(".csv").removesuffix(".parquet")
    device = (entities[0] if entities else named).partition("/")[2]
    topics = [one.topic.name]
    if kind in ("color", "depth") and one.topic.type not in TABLE_TYPES:
        there = {each.topic.name for each in found}
        base = about.device_topics.get(device, f"/{device}")
        topics += [name for name in (f"{base}/color/compressed", f"{base}/depth/image") if name in there]
    known = about.stream(device, Stream(device, kind, ""))
    return MappedStream(device=device, kind=kind, topics=tuple(topics), pads=known.pads, nan="keep")
