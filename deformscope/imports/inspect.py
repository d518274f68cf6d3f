"""What a source holds, and a map to begin with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from deformscope.errors import InputError
from deformscope.frames import Kind, Pad
from deformscope.images import read_image
from deformscope.imports.frame_builder import CLOUDS, KINDS, STANDARD
from deformscope.imports.import_map import ASKED, ImportMap, MappedStream
from deformscope.imports.readers import TABLE_TYPES, Reader, Topic

TIMES = ("host_ns", "time", "timestamp", "stamp", "t")
"""Names of columns that hold times, in small letters, the likeliest first."""
CLOCKS_APART_S = 1.0
"""Stamps that differ so much from when they were recorded are of another clock."""
TRANSFORMS = "tf2_msgs/msg/TFMessage"


@dataclass(slots=True)
class Found:
    """A topic as it was read. messages: how many; first_ns, last_ns: when recorded; gap_ns: the longest between two
    stamp_ns: of the first message itself, None = it has none; encoding: of images; frames: of transforms
    joints: names in the first message; unread: why that is not read"""

    topic: Topic
    messages: int = 0
    first_ns: int = 0
    last_ns: int = 0
    gap_ns: int = 0
    stamp_ns: int | None = None
    encoding: str = ""
    frames: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    unread: str = ""

    @property
    def rate_hz(self) -> float:
        span_ns = self.last_ns - self.first_ns
        return 1e9 * (self.messages - 1) / span_ns if span_ns > 0 else 0.0

    @property
    def clock_s(self) -> float | None:
        """By how much its own stamps are behind when it was recorded [s]; None = it has none."""
        return None if self.stamp_ns is None or not self.first_ns else (self.first_ns - self.stamp_ns) / 1e9

    def look(self, value: Any) -> None:
        """Take what the first message says."""
        self.encoding = _encoding(value)
        self.joints = tuple(value.name) if self.topic.type.endswith("JointState") else ()
        stamp = getattr(getattr(value, "header", None), "stamp", None)
        self.stamp_ns = None if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)

    def to_text(self) -> str:
        rate = f", {self.rate_hz:.4g}/s, longest gap {self.gap_ns / 1e9:.3g} s" if self.rate_hz else ""
        clock = "" if self.clock_s is None else f", stamped {self.clock_s:.4g} s before it was recorded"
        frames = f", frames {', '.join(self.frames)}" if self.frames else ""
        joints = f", joints {', '.join(self.joints)}" if self.joints else ""
        columns = f", columns {', '.join(self.topic.units)}" if self.topic.units else ""
        told = f"{rate}{clock}{frames}{joints}{columns}{self.unread}"
        return f"{self.topic.name}: {self.topic.type}, {self.messages} messages{told}"


def inspect(reader: Reader) -> list[Found]:
    """Read it once, message by message. Raises InputError where nothing is there."""
    found = {name: Found(topic) for name, topic in reader.topics().items()}
    if not found:
        raise InputError("a source with topics", "an empty one")
    for message in reader.messages(list(found)):
        one = found[message.topic]
        ns = message.log_ns or (message.value.get("host_ns") or 0 if isinstance(message.value, Mapping) else 0)
        if not one.messages:
            one.first_ns = ns
            try:
                one.look(message.value)
            except InputError as error:  # of a type that is not known; others can be imported
                one.unread = f", not read: {error}"
        else:
            one.gap_ns = max(one.gap_ns, ns - one.last_ns)
        if one.topic.type == TRANSFORMS and len(one.frames) < 50:
            names = [(each.header.frame_id, each.child_frame_id) for each in message.value.transforms]
            one.frames = tuple(dict.fromkeys((*one.frames, *(name for pair in names for name in pair))))
        one.messages, one.last_ns = one.messages + 1, ns
    return list(found.values())


def _encoding(value: Any) -> str:
    """Of an image: what its message says, or `16UC1` of a file of counts; empty where it is none."""
    if isinstance(value, Path) and value.suffix.lower() not in CLOUDS:
        image = read_image(value)
        return "16UC1" if image.ndim == 2 and image.dtype == np.uint16 else "rgb8"
    return str(getattr(value, "encoding", getattr(value, "format", "")))


def propose(reader: Reader, found: list[Found]) -> ImportMap:
    """A map of what is known; `?` where the source does not say."""
    names = {kind.__name__: kind_name for kind_name, kind in KINDS.items()}
    if own := [one for one in found if one.topic.kind in names]:
        # CSV leaves images out.
        own = [one for one in own if one.topic.type != "csv" or names[one.topic.kind] not in ("color", "depth")]
        streams = [_own(one, names[one.topic.kind], found, reader.about) for one in own]
        return ImportMap(tuple(streams), reader.about.get("session_starts_ns"))
    clocks = [one.clock_s for one in found if one.clock_s is not None]
    same = bool(clocks) and max(clocks) - min(clocks) < CLOCKS_APART_S
    streams, poses = [], [one for one in found if one.topic.type.endswith(("PoseStamped", "TFMessage"))]
    joints = [one for one in found if one.topic.type.endswith("JointState")]
    for one in found:
        device = one.topic.name.rsplit(".", 1)[0].strip("/").replace("/", "_")
        if one.topic.type in TABLE_TYPES:
            streams.append(_table(one, device))
            continue
        if one.topic.type in ("bytes", "candump"):
            config = {"bus": f"socketcan:{one.topic.name.partition('/')[0]}"} if one.topic.type == "candump" else {}
            capture = MappedStream(device=device, kind="wrench", topics=(one.topic.name,), driver=ASKED, config=config)
            streams.append(capture)
            continue
        if one.topic.type == "files":
            is_cloud = one.topic.name.endswith(CLOUDS)
            device = one.topic.name.rpartition("/")[0].replace("/", "_") or "camera"
            units = {"points": ASKED} if is_cloud else {}
            kind: Kind = "depth" if is_cloud or one.encoding == "16UC1" else "color"
            asked = MappedStream(device=device, kind=kind, topics=(one.topic.name,), units=units, time=ASKED)
            streams.append(replace(asked, time_unit=ASKED))
            continue
        if one.topic.type not in STANDARD or (joints and one in poses):
            continue
        stream = MappedStream(device=device, kind=STANDARD[one.topic.type][0], topics=(one.topic.name,))
        if one.topic.type.endswith("Image") and not ("16UC1" in one.encoding or one.encoding in ("mono16", "32FC1")):
            stream = replace(stream, kind="color")
        if one in joints:
            pose = poses[0].topic.name if poses else ASKED
            of_tf = bool(poses) and poses[0].topic.type == TRANSFORMS
            stream = replace(
                stream, pose=pose, parent=ASKED if of_tf else "", child=ASKED if of_tf else "", joints=one.joints
            )
        if not one.stamp_ns:
            stream = replace(stream, time="log")
        elif not same and one.clock_s is not None and abs(one.clock_s) > CLOCKS_APART_S:
            stream = replace(stream, offset_s=ASKED)
        streams.append(stream)
    return ImportMap(tuple(streams))


def _table(one: Found, device: str) -> MappedStream:
    """Of a foreign table: nobody but its owner knows what its columns are."""
    time = next((name for known in TIMES for name in one.topic.units if name.lower() == known), ASKED)
    columns = {f"force_{axis}_n": ASKED for axis in "xyz"}
    unit = "" if time == ASKED else one.topic.units[time] or ("ns" if time.endswith("_ns") else ASKED)
    units = {ASKED: ASKED}
    table = MappedStream(device=device, kind="wrench", topics=(one.topic.name,), columns=columns, units=units)
    return replace(table, time=time, time_unit=unit)


def _own(one: Found, kind: Any, found: list[Found], about: Mapping[str, Any]) -> MappedStream:
    """Of an export of ours: all is known. Images of an MCAP stand in messages of their own."""
    files = [(each["entity"], name) for each in about.get("streams", []) for name in each["files"]]
    entities = [entity for entity, name in [*about.get("topics", {}).items(), *files] if name == one.topic.name]
    named = one.topic.name.strip("/").removesuffix(".csv").removesuffix(".parquet")
    device = (entities[0] if entities else named).partition("/")[2]
    known = about.get("devices", {})
    topics = [one.topic.name]
    if kind in ("color", "depth") and one.topic.type not in TABLE_TYPES:
        there = {each.topic.name for each in found}
        base = about.get("device_topics", {}).get(device, f"/{device}")
        topics += [name for name in (f"{base}/color/compressed", f"{base}/depth/image") if name in there]
    pads = msgspec.convert(known.get(device, {}).get("pads", ()), tuple[Pad, ...])
    return MappedStream(device=device, kind=kind, topics=tuple(topics), pads=pads, nan="keep")
