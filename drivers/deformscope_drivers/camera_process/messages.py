"""What the process that reads a camera sends to the one that records: one tag byte, then a body."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

OPENED, FRAME, FAILED, END, NOTE = b"O", b"F", b"E", b"X", b"N"
NO_TIME_US = 2**64 - 1
"""In the place of a frame's timestamp where the camera's clock did not stamp it."""
_HEADER = struct.Struct("<cqQIHHHH")


@dataclass(frozen=True, slots=True)
class FrameMessage:
    """host_ns: arrival on the host's monotonic clock, which all processes share [ns]; timestamp_us: on the camera's
    clock [us]; index: the camera's count of frames; sizes [px], 0 = no colour; depth, color: without padding"""

    host_ns: int
    timestamp_us: int
    index: int
    width: int
    height: int
    color_width: int
    color_height: int
    depth: bytes
    color: bytes


def pack_frame(frame: FrameMessage) -> bytes:
    header = _HEADER.pack(
        FRAME,
        frame.host_ns,
        frame.timestamp_us,
        frame.index & 0xFFFFFFFF,
        frame.width,
        frame.height,
        frame.color_width,
        frame.color_height,
    )
    return header + frame.depth + frame.color


def unpack_frame(message: bytes) -> FrameMessage:
    _, host_ns, timestamp_us, index, width, height, color_width, color_height = _HEADER.unpack_from(message)
    at = _HEADER.size
    middle = at + 2 * width * height
    depth, color = message[at:middle], message[middle:]
    return FrameMessage(host_ns, timestamp_us, index, width, height, color_width, color_height, depth, color)


def pack_words(tag: bytes, words: dict[str, Any]) -> bytes:
    return tag + json.dumps(words).encode()


def unpack_words(message: bytes) -> dict[str, Any]:
    words: dict[str, Any] = json.loads(message[1:])
    return words
