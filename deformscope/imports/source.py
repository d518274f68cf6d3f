"""A foreign source as a rig: its content, frame by frame, in order of time, in the form of `session.run`."""

import contextlib
import heapq
import itertools
import math
import operator
import re
from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from deformscope.errors import InputError
from deformscope.file_io import read_file
from deformscope.files.table_file import moment_ns
from deformscope.frames import DepthFrame, Frame, HealthReport, Item, Stream, host_ns
from deformscope.imports.frame_builder import DEPTH_UNIT, TIME_NS, FrameBuilder, valid_of
from deformscope.imports.import_map import ASKED, ImportMap, MappedStream
from deformscope.imports.poses import Pose, Poses
from deformscope.imports.readers import TABLE_TYPES, FolderReader, Message, Reader
from deformscope.recording.export.manifest import DRIVER
from deformscope.recording.items import ItemSource
from deformscope.recording.streams import columns_of
from deformscope.rig.rig_file import parse_rig
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link

APART_S = 10.0
"""Distance in time from all other streams at which a stream must have another clock."""
CLOCKS_APART_S = 1.0
"""Difference of stamps from their recorded times that means another clock."""
START_APART_NS = 86_400 * 10**9
WAITING = 64
"""Largest number of messages, in a stream of several topics, that wait for others with the same time."""


class ImportSource(ItemSource):
    """`with open_reader(path) as reader: source = ImportSource(reader, read_map(file))`. rig: poses and tool, from the
    map; raises InputError for missing keys of the map"""

    def __init__(self, reader: Reader, asked: ImportMap) -> None:
        self.topics = self._topics = reader.topics
        for stream in asked.streams:
            for name in (*stream.topics, *([stream.pose] if stream.pose else ())):
                if name not in self._topics:
                    known = ", ".join(self._topics) or "nothing"
                    raise InputError(f"topics of {stream.device} out of the source's", repr(name), known)
        self.rig = parse_rig(asked.rig_text(), "the map", others=[one.device for one in asked.streams])
        self._made = {one.device: _Stream(one, reader) for one in asked.streams}
        streams = tuple(reader.about.stream(name, one.describe()) for name, one in self._made.items())
        # first stamps against their recorded times, of streams without a clock in the map
        every = ((name, one.behind_s(reader)) for name, one in self._made.items() if one.stream.offset_s is None)
        found = sorted((behind, name) for name, behind in every if behind is not None)
        if found and (apart_s := found[-1][0] - found[0][0]) > CLOCKS_APART_S:
            raise self._of_another_clock({name: abs(behind) for behind, name in (found[0], found[-1])}, apart_s)
        super().__init__(self._read(reader), streams, asked.start_ns)
        if self._next is None:
            raise InputError("a source with frames for the map's streams", "none", self._hint(*self._made.values()))
        if abs(host_ns(self._next) - self.start_ns) > START_APART_NS:
            came = f"{self.start_ns}, of which the first stamp is {(host_ns(self._next) - self.start_ns) / 1e9:.4g} s"
            raise InputError("start_ns within a day of the first stamp", came, "the map without it")

    def drain(self) -> Iterator[Item]:
        """All frames that are left. Raises InputError as `take` does."""
        while not self.ended:
            yield from self.take(0.0)

    def take(self, wait_s: float) -> list[Item]:
        """The next frames. Raises InputError at the end if the streams' clocks differ."""
        was_over, found = self.ended, super().take(wait_s)
        if self.ended and not was_over:
            if empty := [one for one in self._made.values() if not one.count]:
                count = empty[0].lost + empty[0].left_out
                came = f"none of {count} messages" if count else "none"
                raise InputError(f"frames of {empty[0].stream.device}", came, self._hint(empty[0]))
            same = {name: one for name, one in self._made.items() if one.stream.offset_s is None}
            for (name, one), (other, its) in itertools.combinations(same.items(), 2):
                if (apart_s := max(its.first_ns - one.last_ns, one.first_ns - its.last_ns) / 1e9) > APART_S:
                    first_ns = {name: abs(one.first_ns - self.start_ns), other: abs(its.first_ns - self.start_ns)}
                    raise self._of_another_clock(first_ns, apart_s)
        return found

    def look(self) -> HealthReport:
        """How many frames each device gave, and how many could not be made: of their messages some lacked."""
        looks = tuple((name, one.health()) for name, one in self._made.items())
        return HealthReport(max((one.last_ns for one in self._made.values()), default=0), looks)

    @property
    def seen(self) -> dict[str, dict[str, Any]]:
        """How much of each stream of measurements is valid, as `_Stream.seen`."""
        return {name: one.seen() for name, one in self._made.items()}

    @property
    def gaps_s(self) -> dict[str, float]:
        """The longest time without a frame of each device [s]."""
        return {name: one.gap_ns / 1e9 for name, one in self._made.items()}

    def _read(self, reader: Reader) -> Iterator[Frame]:
        if {one.type for one in self._topics.values()} & {*TABLE_TYPES, "files"}:
            yield from heapq.merge(*(one.frames(reader) for one in self._made.values()), key=host_ns)
            return
        by_topic: dict[str, list[_Stream]] = {}
        for one in self._made.values():
            for name in dict.fromkeys((*one.stream.topics, *([one.stream.pose] if one.stream.pose else ()))):
                by_topic.setdefault(name, []).append(one)
        for message in reader.messages(by_topic):
            for one in by_topic[message.topic]:
                yield from one.take(message)
        for one in self._made.values():
            yield from one.rest()

    def _hint(self, *empty: "_Stream") -> str:
        is_posed = any(one.stream.kind == "arm" for one in empty)
        return f"its topics{', pose and joints' if is_posed else ''} in the map, which --inspect lists"

    def _of_another_clock(self, away: Mapping[str, float], apart_s: float) -> InputError:
        """away: how far two streams are from the beginning, or from when they were recorded"""
        one, other = sorted(away, key=away.__getitem__)
        came = f"stamps {apart_s:.4g} s from those of {one}"
        return self._made[other].stream.missing("offset_s", "how its clock differs", came)


class Counted:
    """Counts of a stream's frames. lost: messages without a frame; gap_ns: longest time between two frames"""

    def __init__(self) -> None:
        self.count = self.lost = self.first_ns = self.last_ns = self.gap_ns = 0

    def add(self, ns: int) -> None:
        """Count one more."""
        self.first_ns, self.gap_ns = (self.first_ns, max(self.gap_ns, ns - self.last_ns)) if self.count else (ns, 0)
        self.last_ns, self.count = ns, self.count + 1

    @property
    def rate_hz(self) -> float:
        """Mean rate; 0 with a single reading."""
        span_ns = self.last_ns - self.first_ns
        return 1e9 * (self.count - 1) / span_ns if span_ns > 0 else 0.0

    def health(self) -> Health:
        return Health(Link.CLOSED, "", self.count, lost=self.lost, rate_hz=self.rate_hz)


class _Stream(Counted):
    """One stream of the map, as it is read."""

    def __init__(self, stream: MappedStream, reader: Reader) -> None:
        topics = reader.topics
        self.stream, self._builder = stream, FrameBuilder(stream, topics)
        self._units = {name: unit for one in stream.topics for name, unit in topics[one].units.items()}
        kinds = {topics[name].type for name in stream.topics} & {*TABLE_TYPES, "files"}
        self._is_table, is_file = bool(kinds), "files" in kinds
        if self._is_table and any(topics[name].type != topics[stream.topics[0]].type for name in stream.topics):
            raise stream.missing("topics", "of one kind: tables, files, or messages", ", ".join(stream.topics))
        self._times = _file_times(stream, reader) if is_file and not stream.rate_hz else None
        super().__init__()
        self.lost = sum(bool(topics[name].cut) for name in stream.topics)
        self._log_ns = 0
        self._waiting: dict[int, dict[str, Message]] = {}
        self._late = deque[tuple[int, Message]]()
        self._values = self._valid = self._blind = 0
        self._range_m = math.inf, 0.0
        needs_pose = stream.kind == "arm" and not self._builder.own and "position_x_m" not in self._builder.columns
        if needs_pose and stream.pose in ("", ASKED):
            raise stream.missing("pose", "topic of the end's pose in the base frame (PoseStamped, or transforms)")
        self._poses = Poses(stream, reader, self._when) if stream.pose else None
        if stream.kind == "depth":
            for message in reader.messages([name for name in topics if DEPTH_UNIT.match(name)]):
                if isinstance(value := getattr(message.value, "data", None), float):
                    self._builder.stated_m[message.topic] = float(f"{value:.6g}")
        foreign = self._is_table and not is_file and not self._builder.own and not stream.rate_hz
        if foreign and stream.time in ("header", "log", ASKED):
            raise stream.missing("time", "the column of its times, or rate_hz", stream.time)

    def describe(self) -> Stream:
        """The stream's kind, where no export describes it."""
        forces, torques = (columns_of(one, self._builder.columns) for one in ("force_n", "torque_nm"))
        channels, about = max(len(forces) // 3, 1), self.stream
        return Stream(about.device, about.kind, DRIVER, pads=about.pads, channels=channels, torques=bool(torques))

    def behind_s(self, reader: Reader) -> float | None:
        """By how much its first stamp is behind when it was recorded [s]; None where a source does not say that."""
        first = next(iter(reader.messages(self.stream.topics[:1])), None)
        return None if first is None or not first.log_ns else (first.log_ns - self._when(first)) / 1e9

    def frames(self, reader: Reader) -> Iterator[Frame]:
        """Frames of tables and files: all rows, those of all topics in order of time."""
        rows = (
            ((self._when(message, at), message) for at, message in enumerate(reader.messages([name])))
            for name in self.stream.topics
        )
        for ns, message in heapq.merge(*rows, key=operator.itemgetter(0)):
            if (frame := self._take(message, ns)) is not None:
                yield frame

    def take(self, message: Message) -> Iterator[Frame]:
        """The frames that a message makes whole: states of joints wait for the pose after them. Raises InputError for
        stamps that go back."""
        is_own, ready_ns = message.topic in self.stream.topics, math.inf
        if self._poses is not None:
            if message.topic == self.stream.pose:
                self._poses.follow(message, self._late[0][0] if self._late else math.inf)
            ready_ns = self._poses.newest_ns()
        if is_own:
            self._late.append((ns := self._when(message), message))
            ready_ns = max(ready_ns, ns - self.stream.pose_age_s * 1e9)
        yield from self._until(ready_ns)

    def rest(self) -> Iterator[Frame]:
        """Frames of states after the last pose."""
        return self._until(math.inf)

    def _until(self, ready_ns: float) -> Iterator[Frame]:
        while self._late and self._late[0][0] <= ready_ns:
            ns, message = self._late.popleft()
            if (frame := self._take(message, ns, None if self._poses is None else self._poses.at(ns))) is not None:
                yield frame

    def _take(self, message: Message, ns: int, pose: Pose | None = None) -> Frame | None:
        together = {message.topic: message}
        if len(self.stream.topics) > 1:
            together = self._waiting.setdefault(ns, {})
            self.lost += not together or message.topic in together  # as long as it waits
            together[message.topic] = message
            if len(together) < len(self.stream.topics):
                if len(self._waiting) > WAITING:
                    self._waiting.pop(next(iter(self._waiting)))
                return None
            del self._waiting[ns]
            self.lost -= 1
        others = self._builder.left_out
        frame = self._builder.build(together, Stamp(ns), self.count, pose)
        if frame is None:
            self.lost += others == self._builder.left_out
            return None
        step_s, passed_s = (ns - self.last_ns) / 1e9, (message.log_ns - self._log_ns) / 1e9
        if self.count and (step_s < 0 or (message.log_ns and step_s - passed_s > APART_S)):
            came = f"{-step_s:.4g} s before the last" if step_s < 0 else f"{step_s:.4g} s after {passed_s:.4g} s"
            expected = f"stamps of {self.stream.device} that only rise" + ", as time does" * (step_s > 0)
            hint = 'time = "log", or a part of it' if message.log_ns else "rate_hz in place of time, or a part of it"
            raise InputError(expected, f"one {came}, in frame {frame.index}", hint)
        self._log_ns = message.log_ns
        self.add(ns)
        valid, of = (1, 1) if self._builder.own else valid_of(frame)
        self._valid, self._values, self._blind = self._valid + valid, self._values + of, self._blind + (not valid)
        if isinstance(frame, DepthFrame) and frame.depth.any():
            seen = frame.depth[frame.depth > 0]
            low, high = (frame.unit_m * float(one) for one in (seen.min(), seen.max()))
            self._range_m = (min(low, self._range_m[0]), max(high, self._range_m[1]))
        return frame

    @property
    def left_out(self) -> int:
        """Messages of other robots."""
        return self._builder.left_out

    def seen(self) -> dict[str, Any]:
        """Share of its values that are valid, frames without any, messages of others that were left out; distances: the
        nearest and farthest [m], pixels that are beyond the last step, points outside the camera's image."""
        found: dict[str, Any] = {"valid_share": self._valid / max(self._values, 1), "frames_without": self._blind}
        found |= {"left_out": self._builder.left_out, **self._builder.missed}
        return found | ({"range_m": self._range_m} if self.stream.kind == "depth" and self._valid else {})

    def _when(self, message: Message, at: int = 0) -> int:
        """A message's stamp [ns]. at: its place among those of its topic"""
        return self.stream.moved_ns(self._stamp_ns(message, at))

    def _stamp_ns(self, message: Message, at: int) -> int | float:
        """Time in the source [ns]."""
        stream = self.stream
        if self._is_table:
            name = "host_ns" if self._builder.own else stream.time
            if name in ("header", "log") and self._times is None:
                return at * 1e9 / stream.rate_hz
            try:
                value = message.get(name) if self._times is None else self._times[message.value]
            except KeyError:
                raise stream.missing("time", "the column of its times", name) from None
            said = "ns" if self._builder.own else self._units.get(name, "")
            unit = said if said in TIME_NS else stream.time_unit
            if unit not in TIME_NS:
                raise stream.missing("time_unit", "one of s, ms, us, ns", unit or "")
            if isinstance(value, str):
                with contextlib.suppress(ValueError):
                    return moment_ns(value)
                with contextlib.suppress(ValueError):
                    value = float(value)
            if not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"times of {stream.device} in {name}", repr(value), "rows without it, or rate_hz")
            return value * TIME_NS[unit]
        if stream.time == "log":
            return message.log_ns
        try:
            stamp = message.get("header.stamp")
        except KeyError:
            raise stream.missing("time", '"log": its messages have no stamps', stream.time) from None
        ns = int(stamp.sec) * 10**9 + int(stamp.nanosec)
        if not ns:
            raise stream.missing("time", '"log": its stamps are 0', stream.time)
        return ns


def _file_times(stream: MappedStream, reader: Reader) -> dict[Path, int | float]:
    """The stamp of each file, as in the text file of the map."""
    if stream.time in ("header", "log", ASKED) or not isinstance(reader, FolderReader):
        raise stream.missing("time", "a text file with a stamp in each line, or rate_hz", stream.time)
    path, files = reader.path / stream.time, [message.value for message in reader.messages(stream.topics)]
    text = read_file(path, f"times of {stream.device}, a text file").decode("utf-8", "replace")
    rows = [line.replace(",", " ").split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    try:
        whole = re.compile(r"-?\d{1,24}", re.ASCII)
        stamps = [(row[0], (int if whole.fullmatch(row[-1]) else float)(row[-1])) for row in rows]
    except ValueError as error:
        raise InputError(f"a stamp at the end of each line of {stream.time}", str(error), where=path) from error
    named = dict(stamps) if all(len(row) > 1 for row in rows) else {}
    if not named and len(stamps) != len(files):
        raise InputError(f"{len(files)} stamps, one a file", str(len(stamps)), where=path)
    if missing := [one.name for one in files if named and one.name not in named and one.stem not in named]:
        raise InputError(f"a stamp of every file of {stream.device}", f"none of {missing[0]}", where=path)
    each = [named[one.name if one.name in named else one.stem] for one in files] if named else [ns for _, ns in stamps]
    return dict(zip(files, each, strict=True))
