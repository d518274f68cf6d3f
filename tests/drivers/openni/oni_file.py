"""Writes small recordings as OpenNI2's OniFile driver reads them: uncompressed depth, and colour beside it.

The format was read in OpenNI2's Source/Drivers/OniFile (DataRecords.h, PlayerNode.cpp, PlayerDevice.cpp): a header of
24 bytes, then records of 28 bytes of header, fields and a payload. A recording without `xnCropping` gives no frame."""

import struct
from pathlib import Path

import numpy as np

NODE_ADDED, INT, GENERAL, DATA_BEGIN, STATE_READY, NEW_DATA, END = 13, 3, 6, 8, 9, 10, 11
DEPTH_NODE, COLOR_NODE = 2, 3
UNCOMPRESSED = b"NONE"
RGB24 = 1


def record(kind: int, node: int, fields: bytes, payload: bytes = b"") -> bytes:
    return b"NIR\0" + struct.pack("<IIIIQ", kind, node, 28 + len(fields), len(payload), 0) + fields + payload


def text(words: str) -> bytes:
    data = words.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def added(node: int, name: str, kind: int, times_us: list[int]) -> bytes:
    span = struct.pack("<IQQQ", len(times_us), min(times_us), max(times_us), 0)
    return record(NODE_ADDED, node, text(name) + struct.pack("<i", kind) + UNCOMPRESSED + span)


def number(node: int, name: str, value: int) -> bytes:
    return record(INT, node, text(name) + struct.pack("<IQ", 8, value))


def general(node: int, name: str, data: bytes) -> bytes:
    return record(GENERAL, node, text(name) + struct.pack("<I", len(data)) + data)


def node(identity: int, name: str, kind: int, shape: tuple[int, ...], fps: int, times_us: list[int], fov) -> bytes:
    parts = [
        added(identity, name, kind, times_us),
        general(identity, "xnMapOutputMode", struct.pack("<III", shape[1], shape[0], fps)),
        number(identity, "xnPixelFormat", RGB24) if kind == COLOR_NODE else b"",
        general(identity, "xnCropping", bytes(12)),
        general(identity, "xnFOV", struct.pack("<dd", *fov)) if fov else b"",
        number(identity, "xnMirror", 0),
        record(STATE_READY, identity, b""),
    ]
    return b"".join(parts)


def write_oni(
    path: Path,
    depths: list[np.ndarray],
    *,
    colors: list[np.ndarray] | None = None,
    color_delays_us: list[int] | None = None,
    fps: int = 30,
    first_us: int = 1_000_000,
    fov: tuple[float, float] | None = (1.0, 0.8),
    skip: frozenset[int] | set[int] = frozenset(),
) -> list[int]:
    """Write a recording; the times of its depth frames [us].

    color_delays_us: of each colour frame behind its depth; skip: depth frames that are numbered and left out"""
    times = [first_us + round(index * 1e6 / fps) for index in range(len(depths))]
    delays = color_delays_us or [0] * len(depths)
    color_times = [at + delay for at, delay in zip(times, delays, strict=True)]
    frames = [
        (at, 0, index + 1, depth.astype("<u2").tobytes())
        for index, (at, depth) in enumerate(zip(times, depths, strict=True))
        if index not in skip
    ]
    nodes = node(0, "Depth0", DEPTH_NODE, depths[0].shape, fps, times, fov)
    begins = record(DATA_BEGIN, 0, struct.pack("<IQ", len(times), max(times)))
    if colors is not None:
        frames += [
            (at, 1, index + 1, color.tobytes())
            for index, (at, color) in enumerate(zip(color_times, colors, strict=True))
        ]
        nodes += node(1, "Image1", COLOR_NODE, colors[0].shape, fps, color_times, fov)
        begins += record(DATA_BEGIN, 1, struct.pack("<IQ", len(times), max(color_times)))
    data = b"".join(
        record(NEW_DATA, node_id, struct.pack("<QI", at, index), payload)
        for at, node_id, index, payload in sorted(frames, key=lambda frame: frame[:3])
    )
    last_us, last_node = max(times + color_times), int(colors is not None)
    header = b"NI10" + struct.pack("<BBHI", 1, 0, 1, 0) + struct.pack("<QI", last_us, last_node)
    path.write_bytes(header + nodes + begins + data + record(END, 0xFFFFFFFF, b""))
    return times
