"""A recording as a source: its frames, stamps and settings are equal to those of its run, bit for bit. Rows are
read as the objects that were recorded, in order of time."""

import heapq
import json
import logging
import re
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from deformscope.arrays import ImageArray
from deformscope.errors import InputError
from deformscope.file_io import nearest_file, utf8_path
from deformscope.frames import ColorFrame, DepthFrame, HealthReport, InputFile, SessionNote
from deformscope.images import decode_image
from deformscope.recording.ledger import Discard, check_recording, discards_of, inherited, ledger_path
from deformscope.recording.losses import losses_of
from deformscope.rows import ENTITIES, FORMAT, FRAMES, IMAGES, OF_DEVICES, from_components

if TYPE_CHECKING:
    from pyarrow import ListArray, RecordBatch
    from rerun.chunk import Chunk

_PART = re.compile(r"(?:[^/\\]|\\.)+")
_ESCAPED = re.compile(r"\\(?:u\{([0-9a-fA-F]+)\}|(.))")
_CONTROL = {"n": "\n", "r": "\r", "t": "\t"}


Cells = dict[str, Any]
"""Parts of one object: arrays, or lists of texts, by field."""


class Chunked(Protocol):
    """A recording (`deformscope.recording.reader.Replay`)."""

    def chunks(self, *contents: str) -> "Iterator[Chunk]":
        """The portions of these entities, in any order."""


@dataclass(frozen=True, slots=True)
class Row:
    """An object and its time. session_ns: time since the recording's start [ns]; touch: its place on the timeline
    `touch`"""

    session_ns: int
    touch: int
    item: Any


@dataclass(slots=True)
class _Part:
    """Known parts of a row so far."""

    kind: type
    given: dict[str, Any]
    touch: int
    cells: Cells


def read_rows(
    replay: Chunked,
    kinds: Sequence[type],
    read_image: Callable[[bytes, str], Any] = decode_image,
    *,
    device: str | None = None,
) -> Iterator[Row]:
    """The objects of these kinds in order of time; those of one time in recorded order.

    Portions of a recording may lie in any order, and hold parts of the same rows. The times of rows are read first.
    Then a row waits only until no earlier one can follow, so that memory never holds a long recording. JPEG images are
    decoded as in a viewer; all others are equal to the recorded ones. A row that lacks a part is left out, with a
    warning. read_image: replacement of an encoded image, which the second argument identifies
    device: read only items of this device"""
    starts = Starts((min(_times(chunk), default=0), str(chunk.id)) for chunk, _, _ in portions(replay, kinds, device))
    parts: dict[bytes, _Part] = {}
    waiting: list[tuple[int, bytes]] = []
    cut_off: Counter[tuple[str, str]] = Counter()
    for chunk, kind, name in portions(replay, kinds, device):
        for when, row_id, touch, index, cells in _rows(chunk, kind):
            if row_id not in parts:
                given = {"device": name} if kind in OF_DEVICES else {}
                parts[row_id] = _Part(kind, given | ({"index": index} if kind in FRAMES else {}), touch, {})
                heapq.heappush(waiting, (when, row_id))
            parts[row_id].cells.update(cells)
        until = starts.after(chunk)
        while waiting and (until is None or waiting[0][0] < until):
            when, row_id = heapq.heappop(waiting)
            part = parts.pop(row_id)
            try:
                yield Row(when, part.touch, from_components(part.kind, part.cells, part.given, read_image))
            except KeyError:  # a part of it is missing
                cut_off[part.kind.__name__, part.given.get("device", "the rig")] += 1
    for (kind_name, name), count in cut_off.items():
        _logger.warning("%d %s of %s were recorded in part, and are left out", count, kind_name, name)


class Starts:
    """The earliest time of each portion that is not read yet. coming: earliest time [ns] and id of each portion that is
    not read yet"""

    def __init__(self, coming: Iterable[tuple[int, str]]) -> None:
        self._coming = list(coming)
        heapq.heapify(self._coming)
        self._done: set[str] = set()

    def after(self, chunk: "Chunk") -> int | None:
        """Time before which no item follows after this portion [ns]; None = no item follows."""
        self._done.add(str(chunk.id))
        while self._coming and self._coming[0][1] in self._done:
            self._done.remove(heapq.heappop(self._coming)[1])
        return self._coming[0][0] if self._coming else None


def portions(replay: Chunked, kinds: Sequence[type], device: str | None = None) -> "Iterator[tuple[Chunk, type, str]]":
    """The portions that hold parts of these kinds, in any order, with the kind and the device of each."""
    alone = {ENTITIES[kind]: kind for kind in kinds if kind in ENTITIES}
    of_devices = {OF_DEVICES[kind]: kind for kind in kinds if kind in OF_DEVICES}
    for chunk in replay.chunks(*(f"/{entity}" for entity in alone), *(f"/{entity}/**" for entity in of_devices)):
        if chunk.is_static or "session" not in chunk.timeline_names:
            continue
        first, *names = entity_parts(chunk.entity_path)
        kind = alone.get(chunk.entity_path.strip("/")) or (of_devices.get(first) if len(names) == 1 else None)
        name = names[0] if kind in OF_DEVICES else ""
        if kind is not None and device in (None, name):  # else a plot, or something else to look at
            yield chunk, kind, name


def _times(chunk: "Chunk") -> list[int]:
    times: list[int] = chunk.to_record_batch().column("session").cast("int64").to_pylist()
    return times


def _rows(chunk: "Chunk", kind: type) -> Iterator[tuple[int, bytes, int, int, Cells]]:
    """(time [ns], row id, touch, index, cells) of each row that has parts of an object of this kind."""
    batch = chunk.to_record_batch()
    names, nothing = batch.schema.names, [0] * batch.num_rows
    touches = batch.column("touch").to_pylist() if "touch" in names else nothing
    own = "index" if "index" in names else "frame"  # in an exploration `frame` is the depth camera's
    indices = batch.column(own).to_pylist() if own in names else nothing
    ids = batch.column("rerun.controls.RowId").to_pylist()
    rows = zip(_times(chunk), ids, touches, indices, objects_of(batch, kind), strict=True)
    yield from (row for row in rows if row[-1])


def objects_of(batch: "RecordBatch", kind: type) -> Iterator[Cells]:
    """Parts of an object of this kind in each row."""
    columns = {field: _cells(batch.column(name)) for name in batch.schema.names if (field := _field_of(name, kind))}
    for row in range(batch.num_rows):
        yield {field: column[row] for field, column in columns.items() if column[row] is not None}


def _field_of(component: str, kind: type) -> str:
    """The field that a component holds, or empty."""
    ours = f"{kind.__name__}:"
    known = next((field for field, shown in IMAGES.items() if shown == component and field.startswith(ours)), component)
    return known.removeprefix(ours) if known.startswith(ours) else ""


def _cells(column: "ListArray") -> list[Any]:
    """One array a row, or one list of words; None where there is nothing."""
    values, offsets = column.values, column.offsets.to_numpy()
    if str(values.type) == "string":
        cut = values.to_pylist()
    elif hasattr(values.type, "value_type"):  # one blob a row
        cut, offsets = values.values.to_numpy(zero_copy_only=False), values.offsets.to_numpy()[offsets]
    else:
        cut = values.to_numpy(zero_copy_only=False)
    rows = [cut[first:last] for first, last in pairwise(offsets)]
    return [row if there else None for row, there in zip(rows, column.is_valid().to_pylist(), strict=True)]


def entity_parts(path: str) -> list[str]:
    """The parts of an entity's path, with the original names of devices."""
    return [_unescaped(part) for part in _PART.findall(path)]


def _unescaped(part: str) -> str:
    """A device's name as it was before it became part of a path."""

    def one(found: re.Match[str]) -> str:
        if found[1] is not None:
            return chr(int(found[1], 16))
        return _CONTROL.get(found[2], found[2])

    return _ESCAPED.sub(one, part)


if TYPE_CHECKING:
    from rerun.chunk import Chunk, RrdReader

Pace = Literal["fast", "real", "step"]
RRD_MAGIC = b"RRF"
APPLICATION_PREFIX = "deformscope"
"""Prefix of deformscope's application names in rerun (`deformscope.log.layout`)."""
BLOB = "EncodedImage:blob"
IMAGE_FIELDS = {BLOB: "image", "EncodedDepthImage:blob": "depth", "DepthFrame:color": "color"}
"""Kind of the images in each component."""
SESSION, OUTCOME = "/__properties/session", "/__properties/outcome"

_logger = logging.getLogger(__name__)


def check_exists(path: Path) -> None:
    """Raises InputError for a path without a file; it names the unfinished recording of this name, if there is one."""
    if not path.is_file():
        part = next(iter(sorted(path.parent.glob(f"{path.stem}.part*{path.suffix}"))), None)
        there = "its files" if path.is_dir() else nearest_file(path)
        hint = f"the unfinished one: {part}" if part is not None else there
        raise InputError("a recording (.rrd)", "a folder" if path.is_dir() else "nothing there", hint, path)


def check_magic(path: Path) -> None:
    """Raises InputError for a file that does not begin like rerun's recordings."""
    with path.open("rb") as file:
        magic = file.read(len(RRD_MAGIC))
    if magic != RRD_MAGIC:
        raise InputError("a recording (.rrd)", "a file of another kind" if magic else "an empty file", where=path)


class Replay:
    """Content of a recording, read on demand.

    trust: skip the comparison with the ledger; has_ledger: there is a ledger, with which its bytes can be compared
    source_problems: what was damaged before it was recovered, by its compared ledger"""

    def __init__(self, path: Path, *, trust: bool = False) -> None:
        self.path = Path(path)
        self.has_ledger = ledger_path(self.path).exists()
        self.source_problems: list[str] = []
        self._check(trust)

    @cached_property
    def properties(self) -> dict[str, Any]:
        """Provenance of the recording: format, settings, seed, versions, git state, command, platform, most as JSON."""
        return self._values(SESSION)

    @cached_property
    def settings(self) -> dict[str, Any]:
        """All settings that determined the recorded results."""
        found = json.loads(self.properties.get("settings", "null"))
        if not isinstance(found, dict):
            raise InputError("a recording with settings", "one without", where=self.path)
        return found

    @cached_property
    def identity(self) -> tuple[str, str]:
        """rerun's application and recording id."""
        entry = next(entry for entry in self._reader().recordings() if _ours(entry.application_id))
        return entry.application_id, entry.recording_id

    @cached_property
    def outcome(self) -> dict[str, Any]:
        """How the recording ended: frames, steps, live_dropped, complete; empty where the run was cut short."""
        return self._values(OUTCOME)

    @cached_property
    def losses(self) -> dict[str, dict[str, float]]:
        """Losses of its devices, by device and kind: from the end of the run, else from their last health."""
        if "losses" in self.outcome:
            found: dict[str, dict[str, float]] = json.loads(self.outcome["losses"])
            return found
        last = max(read_rows(self, (HealthReport,)), key=lambda row: row.item.host_ns, default=None)
        return {} if last is None else losses_of(last.item)

    @property
    def discarded(self) -> list[Discard]:
        """Its discarded parts, with reasons."""
        return discards_of(self.path, [row.item for row in read_rows(self, (SessionNote,))])

    @cached_property
    def image_counts(self) -> dict[tuple[str, str], int]:
        """Number of recorded images, by device and kind: `image`, or `depth` and `color`."""
        found: Counter[tuple[str, str]] = Counter()
        for chunk, _, device in portions(self, (ColorFrame, DepthFrame)):
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name in IMAGE_FIELDS:
                    found[device, IMAGE_FIELDS[name]] += sum(map(bool, batch.column(name).value_lengths().to_pylist()))
        return {one: count for one, count in sorted(found.items()) if count}

    @property
    def color_counts(self) -> dict[str, int]:
        """How many colour images were recorded of each camera, by its name."""
        return {device: count for (device, what), count in self.image_counts.items() if what != "depth"}

    @property
    def frame_count(self) -> int:
        """How many colour images were recorded, of all cameras."""
        return sum(self.color_counts.values())

    def camera(self, name: str | None = None) -> str:
        """The camera of this name; without a name, the only recorded camera, or the only one that is no depth
        camera."""
        known = list(self.color_counts)
        if not known:
            raise InputError("a recording with images of a camera", "one without", where=self.path)
        own = [device for device, what in self.image_counts if what == "image"]
        if name is None and len(own or known) > 1:
            came = f"a recording of several: {', '.join(known)}"
            raise InputError("one camera", came, f"--camera {known[0]}", self.path)
        if name is not None and name not in known:
            came = f"{name!r}, of which no colour images were recorded"
            raise InputError("a camera of the recording", came, f"--camera {' or '.join(known)}", self.path)
        return (own or known)[0] if name is None else name

    @property
    def mask(self) -> ImageArray | None:
        """The recorded mask image (h, w); None if it has none."""
        found = self.read_inputs().get("mask")
        return None if found is None else decode_image(found, self.path)

    def read_numbered(self, kind: str) -> list[bytes]:
        """The inputs `KIND/NUMBER`, such as pair files, unchanged, in the order of their numbers."""
        found = self.read_inputs()
        return [found[name] for name in sorted(found, key=_natural) if name.split("/")[0] == kind]

    def read_inputs(self) -> dict[str, bytes]:
        """Inputs that are no frames, in the order of their names."""
        found = {row.item.name: row.item.content for row in read_rows(self, (InputFile,))}
        return {name: found[name] for name in sorted(found)}

    def frames(
        self, pace: Pace = "fast", wait: Callable[[ColorFrame], None] | None = None, camera: str | None = None
    ) -> Iterator[ColorFrame]:
        """The recorded colour images in their order, with their recorded stamps.

        pace: "fast" = as fast as possible; "real" = at the recorded times; "step" = each after `wait` (called with the
        next frame) returns; camera: name of the camera, needed if several were recorded"""
        if pace == "step" and wait is None:
            raise ValueError('a pace of "step" needs something to wait for')
        started_ns: int | None = None
        camera = self.camera(camera)
        for row in read_rows(self, (ColorFrame, DepthFrame), device=camera):
            frame: ColorFrame | DepthFrame = row.item
            if isinstance(frame, DepthFrame):
                if frame.color is None:
                    continue
                frame = ColorFrame(frame.stamp, frame.index, frame.color, camera)
            if pace == "step" and wait is not None:
                wait(frame)
            if pace == "real":
                started_ns = started_ns or time.monotonic_ns() - frame.stamp.host_ns
                time.sleep(max(0, started_ns + frame.stamp.host_ns - time.monotonic_ns()) / 1e9)
            yield frame

    def _check(self, trust: bool) -> None:
        """Refuse a file that is no recording of ours, or has changed since it was recorded."""
        path = self.path
        check_exists(path)
        check_magic(path)
        if not trust:
            self._check_ledger()
        try:
            known = [entry.application_id for entry in self._reader().recordings()]
        except Exception as error:  # the reader raises what it likes on bytes it does not understand
            raise _unreadable(path) from error
        if not any(_ours(name) for name in known):
            came = f"one of {known[0]!r}" if known else "one without content"
            raise InputError("a recording made by deformscope", came, where=path)
        self._check_format()
        for one in () if trust else self.discarded:
            _logger.warning("%s is discarded: %s", path, one)

    def _check_format(self) -> None:
        """Refuse other formats, which this version would misread."""
        if (number := self.properties.get("format")) != FORMAT:
            versions = json.loads(self.properties.get("versions", "{}"))
            came = f"one of format {number}, written by deformscope {versions.get('deformscope', 'of unknown version')}"
            raise InputError(f"a recording of format {FORMAT}", came, "open it with that version", self.path)

    def _check_ledger(self) -> None:
        try:
            check = check_recording(self.path)
        except FileNotFoundError:
            _logger.warning("%s has no ledger: changed bytes cannot be detected", self.path)
            return
        if not check.ended and not check.problems:
            came = f"{check.committed} bytes are as recorded, later ones are not checked"
            _logger.warning("%s is of an interrupted run: %s", self.path, came)
        if problems := check.problems:
            more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
            raise InputError("a recording that matches its ledger", problems[0] + more, "an intact copy", self.path)
        self.source_problems = check.source_problems
        if check.source_problems:
            _logger.warning("%s: %s", self.path, inherited(check.source_problems))

    def _reader(self) -> "RrdReader":
        from rerun.chunk import RrdReader

        with warnings.catch_warnings():
            # A run that was killed leaves no footer; all that it recorded can be read all the same.
            warnings.filterwarnings("ignore", "RRD file has no footer")
            return RrdReader(utf8_path(self.path))

    def chunks(self, *contents: str) -> "Iterator[Chunk]":
        """The portions of these entities, in any order."""
        reader = self._reader()
        store = next(entry for entry in reader.recordings() if _ours(entry.application_id))
        try:
            yield from reader.stream(store=store).filter(content=list(contents))
        except Exception as error:  # whatever the reader raises on damaged bytes
            raise _unreadable(self.path) from error

    def _values(self, entity: str) -> dict[str, Any]:
        """Each property's one value, the last where a recovered recording has another; empty where there are none."""
        found: dict[str, Any] = {}
        for chunk in self.chunks(entity):
            batch = chunk.to_record_batch()
            names = [name for name in batch.schema.names if not name.startswith("rerun.controls.")]
            found |= {name: cell[0] for name in names if (cell := batch.column(name)[-1].as_py())}
        return found


def _ours(application: str) -> bool:
    return application.split("-")[0] == APPLICATION_PREFIX


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _unreadable(path: Path) -> InputError:
    return InputError(
        "a readable recording", "one that is truncated or damaged", f"deformscope recover {path.name}", path
    )
