"""Places of a finished recording's portions in its file, from the index that rerun writes at the end.

The last 32 bytes are offset and length of the footer (uint64), its checksum (uint32), `RRF2FOOT` and a count. The
footer is a protobuf message of manifests (field 1), one for each store. Field 4 of each holds its table of portions
(length of the plain bytes in field 4, an Arrow IPC stream, compressed by LZ4, in field 2)."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

MAGIC, TAIL_BYTES = b"RRF2FOOT", 32
MANIFEST, TABLE, PAYLOAD, PLAIN_BYTES = 1, 4, 2, 4


@dataclass(frozen=True, slots=True)
class Portion:
    """Bytes of a recording that belong together. end: place after the last byte; entity: its path without the leading
    slash

    from_s, to_s: first and last session time of its rows [s]; None without times"""

    end: int
    entity: str
    from_s: float | None = None
    to_s: float | None = None


def read_index(path: Path) -> list[Portion]:
    """The portions in their order in the file; empty without a readable index."""
    try:
        return sorted(_read_index(path), key=lambda one: one.end)
    except (ArithmeticError, LookupError, MemoryError, OSError, TypeError, ValueError, struct.error, pa.ArrowException):
        return []


def _read_index(path: Path) -> Iterator[Portion]:
    with path.open("rb") as file:
        file.seek(-TAIL_BYTES, 2)
        tail = file.read()
        if MAGIC not in tail:
            return
        start, length = struct.unpack_from("<QQ", tail)
        file.seek(start)
        footer = file.read(min(length, path.stat().st_size))
    for manifest in _fields(footer, MANIFEST):
        (packed,) = _fields(manifest, TABLE)
        (payload,), (plain_bytes,) = _fields(packed, PAYLOAD), _numbers(packed, PLAIN_BYTES)
        plain = pa.Codec("lz4_raw").decompress(payload, plain_bytes)
        table = pa.ipc.open_stream(plain).read_all()
        names = ["chunk_entity_path", "chunk_byte_offset", "chunk_byte_size"]
        entities, offsets, sizes = (table.column(name).to_pylist() for name in names)
        times = [
            table.column(name).cast(pa.int64()).to_pylist() if name in table.schema.names else [None] * len(entities)
            for name in ("session:start", "session:end")
        ]
        for entity, offset, size, first_ns, last_ns in zip(entities, offsets, sizes, *times, strict=True):
            span = (None if one is None else one / 1e9 for one in (first_ns, last_ns))
            yield Portion(offset + size, entity.removeprefix("/"), *span)


def _fields(message: bytes, number: int) -> list[bytes]:
    return [value for field, value in _parsed(message) if field == number and isinstance(value, bytes)]


def _numbers(message: bytes, number: int) -> list[int]:
    return [value for field, value in _parsed(message) if field == number and isinstance(value, int)]


def _parsed(message: bytes) -> Iterator[tuple[int, bytes | int]]:
    """Fields of a protobuf message: numbers, and bytes of those that have a length."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        if tag & 7 == 0:
            value, at = _varint(message, at)
            yield tag >> 3, value
            continue
        size, at = _varint(message, at) if tag & 7 == 2 else ({1: 8, 5: 4}[tag & 7], at)
        yield tag >> 3, message[at : at + size]
        at += size


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """A number of variable length, and the place after it."""
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
