"""Merges portions of a recording: a few large ones are read and shown many times faster."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import pyarrow as pa
from rerun.chunk import Chunk

MOST_BYTES, MOST_PARTS = 2 << 20, 256
MOST_NS, MOST_NS_OF_RESULTS = 20_000_000_000, 300_000_000_000
"""A portion is complete at a limit of bytes, of items, or of `session` time [ns]. A reader in the order of time has to
hold the span of the longest one. Each portion costs rerun about 70 bytes of memory, until the file is closed, for every
column of any entity of the file: 20 kB in an exploration."""
RESULTS = ("/exploration/", "/display/")
"""Entities with a few rows for each touch, which no reader needs to merge with device items in order of time."""


@dataclass(slots=True)
class _Growing:
    """Rows of one entity that have the same columns."""

    parts: list[pa.RecordBatch] = field(default_factory=list)
    bytes: int = 0
    first_ns: int = 0


class Merged:
    """Portions of one entity with the same columns become one; their rows keep their ids and their order."""

    def __init__(self) -> None:
        self._growing: dict[tuple[object, ...], _Growing] = {}

    def add(self, chunk: Chunk) -> Iterator[Chunk]:
        """Add a portion that is not static; returns the chunks that it completes."""
        batch = chunk.to_record_batch()
        session_ns = batch.column("session").cast(pa.int64())
        columns = ((column.name, column.type) for column in batch.schema)
        growing = self._growing.setdefault((chunk.entity_path, *columns), _Growing())
        if not growing.parts:
            growing.first_ns = session_ns[0].as_py()
        growing.parts.append(batch)
        growing.bytes += batch.nbytes
        most_ns = MOST_NS_OF_RESULTS if chunk.entity_path.startswith(RESULTS) else MOST_NS
        full = growing.bytes >= MOST_BYTES or len(growing.parts) >= MOST_PARTS
        if full or session_ns[-1].as_py() - growing.first_ns >= most_ns:
            yield _joined(growing.parts)
            growing.parts, growing.bytes = [], 0

    def rest(self) -> Iterator[Chunk]:
        """The chunks that were not returned yet; none is stored."""
        for growing in self._growing.values():
            if growing.parts:
                yield _joined(growing.parts)
        self._growing.clear()


def _joined(parts: list[pa.RecordBatch]) -> Chunk:
    schema = parts[0].schema
    unsorted = [_without_order(field) for field in schema]  # rerun finds out by itself whether the whole is in order
    arrays = [pa.concat_arrays([part.column(name) for part in parts]) for name in schema.names]
    whole = pa.RecordBatch.from_arrays(arrays, schema=pa.schema(unsorted, metadata=schema.metadata))
    (chunk,) = Chunk.from_record_batch(whole)
    return chunk


def _without_order(column: pa.Field) -> pa.Field:
    metadata = {name: value for name, value in (column.metadata or {}).items() if name != b"rerun:is_sorted"}
    return column.with_metadata(metadata)
