"""A recording read back: the same objects that were recorded, in order of time."""

from __future__ import annotations

import heapq
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from deformscope.errors import InputError
from deformscope.frames import HealthReport, Item, StageResult, Stream
from deformscope.images import decode_image
from deformscope.recording.reader import Replay
from deformscope.rows import ENTITIES, FORMAT, FRAMES, IMAGES, OF_DEVICES, from_components, from_json
from deformscope.stages.fit.estimate import Estimate
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import StageFailure, SurfaceEstimate, TouchEstimate
from deformscope.stages.see.arrows import FlowArrows
from deformscope.stages.see.tactile import TactileContact

if TYPE_CHECKING:
    from pyarrow import RecordBatch
    from rerun.chunk import Chunk

ITEMS: tuple[type, ...] = (*OF_DEVICES, HealthReport)
"""What a rig's recording is made of."""

T = TypeVar("T")

_PART = re.compile(r"(?:[^/\\]|\\.)+")
_ESCAPED = re.compile(r"\\(?:u\{([0-9a-fA-F]+)\}|(.))")
_CONTROL = {"n": "\n", "r": "\r", "t": "\t"}

_logger = logging.getLogger(__name__)

Cells = dict[str, Any]
"""What one object is made of: arrays, or lists of words, by field."""


@dataclass(frozen=True, slots=True)
class Row:
    """An object and when it came. session_ns: since the recording's start [ns]; touch: its place on that timeline"""

    session_ns: int
    touch: int
    item: Any


@dataclass(slots=True)
class _Part:
    """What is known of a row so far."""

    kind: type
    given: dict[str, Any]
    touch: int
    cells: Cells


def read_items(path: Path, *, trust: bool = False, kinds: Sequence[type] = ITEMS) -> Iterator[Item]:
    """What the devices of a recording gave, of these kinds; `read_rows` says more."""
    return (row.item for row in read_rows(Replay(path, trust=trust), kinds))


def read_results(path: Path, kinds: Sequence[type] = (), *, trust: bool = False) -> Iterator[Row]:
    """The results of a recorded exploration, or those of some kinds, as they came: equal to the last bit."""
    every = [kind for kind, entity in ENTITIES.items() if entity.startswith("exploration/")]
    return read_rows(Replay(path, trust=trust), kinds or every)


def read_estimates(replay: Replay) -> list[Estimate]:
    """The estimates of a calibration in the order of their frames, equal to what was recorded."""
    return read_found(replay, Estimate)


def read_found(replay: Replay, kind: type[T]) -> list[T]:
    """The same of any kind that a calibration finds.

    Raises InputError where they were recorded in format 1.
    """
    found: list[tuple[int, T]] = []
    for chunk in replay.chunks("/calibration/estimate"):
        batch = chunk.to_record_batch()
        names = batch.schema.names
        if "json" in names:
            hint = "calibrate its images or pairs again, or use the version that made it"
            raise InputError(f"estimates as format {FORMAT} has them", "those of format 1", hint, replay.path)
        frames = batch.column("frame").to_pylist() if "frame" in names else [-1] * batch.num_rows
        objects = zip(frames, _objects(batch, kind), strict=True)
        for frame, cells in objects:
            if cells:  # those recorded before reasons were named have none
                none: dict[str, object] = {} if "reasons" in cells else {"reasons": ()}
                found.append((frame, from_components(kind, cells, none)))
    return [one for _, one in sorted(found, key=lambda row: row[0])]


def read_rows(
    replay: Replay,
    kinds: Sequence[type],
    read_image: Callable[[bytes, str], Any] = decode_image,
    *,
    device: str | None = None,
) -> Iterator[Row]:
    """The objects of these kinds in order of time; of one moment in the order in which they were recorded.

    Portions of a recording may lie in any order, and hold parts of the same rows. Their times are read first; then a
    row waits only until nothing before it can come any more, so that a long recording is never held whole. JPEG images
    come as a viewer shows them; all else is equal to what was recorded. A row that lacks a part is left out, with a
    warning. read_image: what becomes of an encoded image, of which the second argument says which it is
    device: what comes from this one alone
    """
    starts = _Starts(replay, kinds, device)
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


def read_streams(path: Path, *, trust: bool = False) -> tuple[Stream, ...]:
    """What was known of the recorded devices before their first frames, by kind and name."""
    found: dict[str, Stream] = {}
    for chunk in Replay(path, trust=trust).chunks(*(f"/{entity}/**" for entity in OF_DEVICES.values())):
        batch = chunk.to_record_batch()
        if chunk.is_static and "stream" in batch.schema.names:
            for cell in batch.column("stream").to_pylist():
                found[chunk.entity_path] = from_json(Stream, cell[0])
    return tuple(found[entity] for entity in sorted(found))


class _Starts:
    """The earliest time of each portion that is still to come."""

    def __init__(self, replay: Replay, kinds: Sequence[type], device: str | None) -> None:
        found = portions(replay, kinds, device)
        self._coming = [(min(_times(chunk), default=0), str(chunk.id)) for chunk, _, _ in found]
        heapq.heapify(self._coming)
        self._done: set[str] = set()

    def after(self, chunk: Chunk) -> int | None:
        """Once this portion has come: nothing that follows is earlier [ns]; None = nothing follows."""
        self._done.add(str(chunk.id))
        while self._coming and self._coming[0][1] in self._done:
            self._done.remove(heapq.heappop(self._coming)[1])
        return self._coming[0][0] if self._coming else None


def portions(replay: Replay, kinds: Sequence[type], device: str | None = None) -> Iterator[tuple[Chunk, type, str]]:
    """The portions that hold parts of these kinds, in any order, and the kind and the device that each is of."""
    alone = {ENTITIES[kind]: kind for kind in kinds if kind in ENTITIES}
    of_devices = {OF_DEVICES[kind]: kind for kind in kinds if kind in OF_DEVICES}
    for chunk in replay.chunks(*(f"/{entity}" for entity in alone), *(f"/{entity}/**" for entity in of_devices)):
        if chunk.is_static or "session" not in chunk.timeline_names:
            continue
        first, *names = (_unescaped(part) for part in _PART.findall(chunk.entity_path))
        kind = alone.get(chunk.entity_path.strip("/")) or (of_devices.get(first) if len(names) == 1 else None)
        name = names[0] if kind in OF_DEVICES else ""
        if kind is not None and device in (None, name):  # else a plot, or something else to look at
            yield chunk, kind, name


def _times(chunk: Chunk) -> list[int]:
    times: list[int] = chunk.to_record_batch().column("session").cast("int64").to_pylist()
    return times


def _rows(chunk: Chunk, kind: type) -> Iterator[tuple[int, bytes, int, int, Cells]]:
    """(time [ns], row id, touch, index, cells) of each row that has parts of an object of this kind."""
    batch = chunk.to_record_batch()
    names, nothing = batch.schema.names, [0] * batch.num_rows
    touches = batch.column("touch").to_pylist() if "touch" in names else nothing
    own = "index" if "index" in names else "frame"  # in an exploration `frame` is the depth camera's
    indices = batch.column(own).to_pylist() if own in names else nothing
    ids = batch.column("rerun.controls.RowId").to_pylist()
    rows = zip(_times(chunk), ids, touches, indices, _objects(batch, kind), strict=True)
    yield from (row for row in rows if row[-1])


def _objects(batch: RecordBatch, kind: type) -> Iterator[Cells]:
    """What there is of an object of this kind in each row."""
    columns = {field: _cells(batch.column(name)) for name in batch.schema.names if (field := _field_of(name, kind))}
    for row in range(batch.num_rows):
        yield {field: column[row] for field, column in columns.items() if column[row] is not None}


def _field_of(component: str, kind: type) -> str:
    """The field that a component holds, or empty."""
    ours = f"{kind.__name__}:"
    known = next((field for field, shown in IMAGES.items() if shown == component and field.startswith(ours)), component)
    return known.removeprefix(ours) if known.startswith(ours) else ""


def _cells(column: Any) -> list[Any]:
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


def _unescaped(part: str) -> str:
    """A device's name as it was before it became part of a path."""

    def one(found: re.Match[str]) -> str:
        if found[1] is not None:
            return chr(int(found[1], 16))
        return _CONTROL.get(found[2], found[2])

    return _ESCAPED.sub(one, part)


KINDS: tuple[type, ...] = (FlowArrows, MomentFit, SurfaceEstimate, TactileContact, TouchEstimate, StageFailure)


def read_stage_results(path: Path, *, trust: bool = False) -> list[StageResult]:
    """The results in the order of the frames that they belong to, equal to what was recorded.

    trust: skip the comparison with the ledger
    """
    found: list[StageResult] = []
    for chunk in Replay(path, trust=trust).chunks("/stage/**"):
        if chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        columns = {name: batch.column(name) for name in batch.schema.names if ":" in name}
        for row in range(batch.num_rows):
            cells = {
                name: column[row].values.to_numpy(zero_copy_only=False)
                for name, column in columns.items()
                if column[row].is_valid
            }
            if cells:
                found.append(_result(cells, path))
    return sorted(found, key=lambda one: (one.host_ns, one.stage))


def _result(cells: dict[str, Any], path: Path) -> StageResult:
    kind = next((kind for kind in KINDS if any(name.startswith(f"{kind.__name__}:") for name in cells)), None)
    if kind is None:
        raise InputError("results of known stages", cells["StageResult:stage"][0], where=path)
    return from_components(StageResult, _of(StageResult, cells), {"result": from_components(kind, _of(kind, cells))})


def _of(kind: type, cells: dict[str, Any]) -> dict[str, Any]:
    """The components of one class, by field."""
    prefix = f"{kind.__name__}:"
    return {name.removeprefix(prefix): value for name, value in cells.items() if name.startswith(prefix)}
