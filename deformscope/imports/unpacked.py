"""Compressed parts of bags, unpacked no further than `check_size` allows: rosbags' own functions have no bound."""

from __future__ import annotations

import bz2
import contextlib
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

from deformscope.file_io import check_size, largest_bytes


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Within it rosbags unpacks with the functions of this module."""
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap as mcap

    plain: Any = vars(ros2)["zstd"]
    lz4, zstd = _unpack(LZ4FrameDecompressor), _unpack(plain.ZstdDecompressor)
    tables: list[tuple[Any, dict[str, Any]]] = [
        (ros1.decompressors, {"bz2": _unpack(bz2.BZ2Decompressor), "lz4": lz4}),
        (mcap.DECOMPRESSORS, {"lz4": lz4, "zstd": zstd}),
        (vars(ros2), {"zstd": SimpleNamespace(decompress=zstd, open=plain.open)}),
    ]
    with contextlib.ExitStack() as kept:
        for table, own in tables:
            kept.callback(table.update, {name: table[name] for name in own})
            table.update(own)
        yield


def _unpack(make: Callable[[], Any]) -> Callable[..., bytes]:
    """A function that unpacks frames, one after the other. make: makes the decompressor of a frame"""

    def unpack(data: bytes, declared_bytes: int = 0) -> bytes:
        check_size("a compressed part", declared_bytes)
        found, size, most = [], 0, largest_bytes()
        while data:
            frame = make()
            found.append(frame.decompress(data, most + 1 - size))
            check_size("a compressed part", size := size + len(found[-1]))
            if not frame.eof:
                raise ValueError("a compressed part that ends early")
            data = frame.unused_data or b""
        return b"".join(found)

    return unpack


def check_overlap(spans: Sequence[tuple[int, int, int]], where: object) -> None:
    """rosbags keeps all chunks whose times overlap. spans: first and last time of each, and its unpacked size [bytes].
    Raises InputError where those of one time are too large together."""
    size, ends = 0, [change for first, last, one in spans for change in ((first, one), (last + 1, -one))]
    for _, change in sorted(ends):
        size += change
        check_size("chunks of one time, together", size, where)
