"""Reads a recording: the objects that were recorded, in order of time."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Self, TypeVar

import numpy as np

from deformscope.errors import InputError
from deformscope.frames import HealthReport, Item, StageResult, Stream, host_ns
from deformscope.recording.portions import item_size
from deformscope.recording.reader import Replay, Row, objects_of, read_rows
from deformscope.rows import ENTITIES, OF_DEVICES, SERIES, from_components, from_json
from deformscope.stages.fit.estimate import Estimate
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import StageFailure, SurfaceEstimate, TouchEstimate
from deformscope.stages.poke.tip_wrench import TipWrench
from deformscope.stages.see.arrows import FlowArrows
from deformscope.stages.see.tactile import TactileContact

ITEMS: tuple[type, ...] = (*OF_DEVICES, HealthReport)
"""Content of a rig's recording."""

VALUES = "Scalars:scalars"
T = TypeVar("T")


def read_items(path: Path, *, trust: bool = False, kinds: Sequence[type] = ITEMS) -> Iterator[Item]:
    """Items of a recording's devices, of these kinds; `read_rows` has the details."""
    return (row.item for row in read_rows(Replay(path, trust=trust), kinds))


def read_results(path: Path, kinds: Sequence[type] = (), *, trust: bool = False) -> Iterator[Row]:
    """The results of a recorded exploration, or those of some types, in their order and equal to the last bit."""
    every = [kind for kind, entity in ENTITIES.items() if entity.startswith("exploration/")]
    return read_rows(Replay(path, trust=trust), kinds or every)


def read_series(path: Path, kind: type[T], *, trust: bool = False) -> list[T]:
    """The series of this kind (`deformscope.rows.SERIES`) of each touch, equal to the recorded ones."""
    found: dict[int, list[tuple[list[int], list[float]]]] = {}
    chunks = Replay(path, trust=trust).chunks(f"/{SERIES[kind]}")
    batches = [chunk.to_record_batch() for chunk in chunks if not chunk.is_static]
    for batch in sorted(batches, key=lambda one: one.column("session").cast("int64")[0].as_py()):
        for touch, *row in zip(*(batch.column(name).to_pylist() for name in ("touch", "host_ns", VALUES)), strict=True):
            found.setdefault(touch, []).append((row[0], row[1]))
    every = (zip(*rows, strict=True) for _, rows in sorted(found.items()))
    return [kind(np.ravel(host_ns), np.array(values)) for host_ns, values in every]  # type: ignore[call-arg]


def read_estimates(replay: Replay) -> list[Estimate]:
    """The estimates of a calibration in the order of their frames, equal to the recorded ones."""
    return read_found(replay, Estimate)


def read_found(replay: Replay, kind: type[T]) -> list[T]:
    """The results of any type that a calibration gives."""
    found: list[tuple[int, T]] = []
    for chunk in replay.chunks("/calibration/estimate"):
        batch = chunk.to_record_batch()
        names = batch.schema.names
        frames = batch.column("frame").to_pylist() if "frame" in names else [-1] * batch.num_rows
        objects = zip(frames, objects_of(batch, kind), strict=True)
        found += [(frame, from_components(kind, cells)) for frame, cells in objects if cells]
    return [one for _, one in sorted(found, key=lambda row: row[0])]


def read_streams(path: Path, *, trust: bool = False) -> tuple[Stream, ...]:
    """Descriptions of the recorded devices before their first frames, by kind and name."""
    found: dict[str, Stream] = {}
    for chunk in Replay(path, trust=trust).chunks(*(f"/{entity}/**" for entity in OF_DEVICES.values())):
        batch = chunk.to_record_batch()
        if chunk.is_static and "stream" in batch.schema.names:
            for cell in batch.column("stream").to_pylist():
                found[chunk.entity_path] = from_json(Stream, cell[0])
    return tuple(found[entity] for entity in sorted(found))


KINDS: tuple[type, ...] = (
    *(FlowArrows, MomentFit, SurfaceEstimate, TactileContact, TouchEstimate, TipWrench, StageFailure),
)


def read_stage_results(path: Path, *, trust: bool = False) -> list[StageResult]:
    """The results in the order of their frames, equal to the recorded ones. trust: skip the
    comparison with the ledger"""
    found: list[StageResult] = []
    for chunk in Replay(path, trust=trust).chunks("/stage/**"):
        if chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        parts = (objects_of(batch, kind) for kind in (StageResult, *KINDS))
        for cells, *results in zip(*parts, strict=True):
            if cells:
                known = next((one for one in zip(KINDS, results, strict=True) if one[1]), None)
                if known is None:
                    raise InputError("results of known stages", cells["stage"][0], where=path)
                found.append(from_components(StageResult, cells, {"result": from_components(*known)}))
    return sorted(found, key=lambda one: (one.host_ns, one.stage))


# Existing items in the form of a rig, in order of time and in limited portions, so that memory is bounded

BATCH_NS, BATCH_BYTES = 200_000_000, 16 << 20


class ItemSource:
    """`session.run(ItemSource(items, streams), ...)`: `take` gives about a fifth of a second at a time.

    streams: streams of the devices; start_ns: start of the session, None = time of the first item; now_ns: time of the
    newest item that was taken; ended: no item is left; until_ns: no later item is given"""

    failures: Mapping[str, str] = {}

    def __init__(self, items: Iterator[Item], streams: tuple[Stream, ...], start_ns: int | None = None) -> None:
        self.streams, self.ended, self.until_ns = streams, False, math.inf
        self._items, self._health = items, HealthReport(0, ())
        self._next = next(items, None)
        if start_ns is None and self._next is not None:
            start_ns = host_ns(self._next)
        self.start_ns = self.now_ns = start_ns or 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def take(self, wait_s: float) -> list[Item]:
        """The next items. wait_s: ignored, as nothing waits"""
        found: list[Item] = []
        size = 0
        until_ns = self.until_ns if self._next is None else min(host_ns(self._next) + BATCH_NS, self.until_ns)
        while self._next is not None and host_ns(self._next) <= until_ns and size < BATCH_BYTES:
            found.append(self._next)
            size += item_size(self._next)
            self._next = next(self._items, None)
        self.ended = self._next is None
        self._health = next((one for one in reversed(found) if isinstance(one, HealthReport)), self._health)
        found.sort(key=host_ns)
        self.now_ns = host_ns(found[-1]) if found else self.now_ns
        return found

    def look(self) -> HealthReport:
        """How the devices were by the newest report."""
        return self._health

    def rest(self) -> list[Item]:
        """All items that are left."""
        return []

    def close(self) -> None:
        """Does nothing: the caller closes the source of the items."""
