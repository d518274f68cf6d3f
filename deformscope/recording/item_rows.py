"""Rows of a recording as the objects that were recorded, in order of time."""

import heapq
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

from deformscope.images import decode_image
from deformscope.rows import ENTITIES, FRAMES, IMAGES, OF_DEVICES, from_components

if TYPE_CHECKING:
    from pyarrow import ListArray, RecordBatch
    from rerun.chunk import Chunk

_PART = re.compile(r"(?:[^/\\]|\\.)+")
_ESCAPED = re.compile(r"\\(?:u\{([0-9a-fA-F]+)\}|(.))")
_CONTROL = {"n": "\n", "r": "\r", "t": "\t"}

_logger = logging.getLogger(__name__)

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
