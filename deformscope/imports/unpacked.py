"""Compressed parts of bags, unpacked no further than `check_size` allows: rosbags' own functions have no bound. It
refuses MCAPs without the profile ros2, and with a schema that is not of ROS: here both are read."""

import bz2
import contextlib
import io
import itertools
import struct
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from deformscope.file_io import check_size

MAGIC = b"\x89MCAP0\r\n"


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Within it rosbags unpacks with the functions of this module, and reads MCAPs of any profile."""
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap as mcap

    plain: Any = vars(ros2)["zstd"]
    lz4, zstd = _unpack(LZ4FrameDecompressor), _unpack(plain.ZstdDecompressor)
    plain_sized, plain_bytes, plain_definition = mcap.read_sized, mcap.read_bytes, mcap.get_msgdef

    def read_sized(file: Any) -> bytes:
        is_header = not isinstance(file, io.BytesIO) and file.tell() == len(MAGIC) + 1
        found = plain_sized(file)
        return struct.pack("<I4s", 4, b"ros2") if is_header else found

    def definition(schema: Any) -> MessageDefinition:
        if schema is None or schema.encoding in ("ros2msg", "ros2idl", "omgidl", ""):
            return plain_definition(schema)
        of_ros1 = schema.encoding == "ros1msg"
        return MessageDefinition(MessageDefinitionFormat.MSG if of_ros1 else MessageDefinitionFormat.NONE, schema.data)

    own = {"read_sized": read_sized, "get_msgdef": definition}
    own |= {"read_string": lambda file: plain_bytes(file).decode(errors="replace")}  # a schema of protobuf is no text
    tables: list[tuple[Any, dict[str, Any]]] = [
        (ros1.decompressors, {"bz2": _unpack(bz2.BZ2Decompressor), "lz4": lz4}),
        (mcap.DECOMPRESSORS, {"lz4": lz4, "zstd": zstd}),
        (vars(mcap), own),
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
        most, found = check_size("a compressed part", declared_bytes), b""
        while data:
            frame = make()
            found += frame.decompress(data, most + 1 - len(found))
            check_size("a compressed part", len(found))
            if not frame.eof:
                raise ValueError("a compressed part that ends early")
            data = frame.unused_data or b""
        return found

    return unpack


def check_chunks(storage: Any, where: object) -> None:
    """Raises InputError where chunks of one time are too large together: rosbags unpacks all those of an MCAP whose
    times overlap. An MCAP without an index of messages is read chunk by chunk: rosbags would find none in it."""
    found = [each.chunks for each in getattr(storage, "storages", [storage]) if hasattr(each, "chunks")]
    for chunks in found:
        if not any(one.channel_count for one in chunks):
            chunks.clear()
    begins = [(one.message_start_time, one.uncompressed_size) for chunks in found for one in chunks]
    ends = [(one.message_end_time + 1, -one.uncompressed_size) for chunks in found for one in chunks]
    for size in itertools.accumulate(change for _, change in sorted(begins + ends)):
        check_size("chunks of one time, together", size, where)
