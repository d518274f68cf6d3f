"""Files of points (PCD, PLY): Open3D reads them after what they declare was compared with the bytes they have."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.file_io import check_size
from deformscope.recording.utf8_path import utf8_path

HEAD_BYTES = 1 << 16
POINT_BYTES = 72
"""Memory of a point: Open3D's place, colour and normal in float64."""

PLY_BYTES = {"char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2}
PLY_BYTES |= {"int": 4, "uint": 4, "float": 4, "int32": 4, "uint32": 4, "float32": 4, "double": 8, "float64": 8}


def read_points(path: Path) -> FloatArray:
    """(H, W, 3) points in the file's unit; H = 1 if they have no order. Raises InputError for a file that does not have
    the points that it declares."""
    import open3d as o3d

    with path.open("rb") as file:
        head, size = file.read(HEAD_BYTES), path.stat().st_size
    try:
        height, width = _pcd(head, size) if path.suffix.lower() == ".pcd" else (1, _ply(head, size))
    except (IndexError, KeyError, ValueError) as error:
        came = f"one without or with a wrong {' '.join(str(error).split())[:120]}"
        raise InputError("a PCD or PLY file with the points that it declares", came, "write it again", path) from error
    check_size(f"a file of {height * width} points", height * width * POINT_BYTES, path)
    points = np.asarray(o3d.io.read_point_cloud(utf8_path(path), remove_nan_points=False).points)
    if not 0 < len(points) == height * width:
        came = f"{len(points)}, as of a damaged or empty file, or one of another kind"
        raise InputError(f"{height * width} points, as the file declares", came, "write it again", path)
    return points.reshape(height, width, 3)


def _pcd(head: bytes, size: int) -> tuple[int, int]:
    """Height and width. Raises ValueError or KeyError for sizes that are not those of a file of this size [bytes]."""
    lines, _, body = head.partition(b"\nDATA ")
    kind, _, body = body.partition(b"\n")
    said = {words[0]: words[1:] for line in lines.decode("latin-1").splitlines() if (words := line.split())}
    fields, sizes = said["FIELDS"], [int(one) for one in said["SIZE"]]
    counts = [int(one) for one in said.get("COUNT", ["1"] * len(fields))]
    width, height, points = (int(" ".join(said[name])) for name in ("WIDTH", "HEIGHT", "POINTS"))
    if not {"x", "y", "z"} <= {*fields} or not len(fields) == len(sizes) == len(counts) == len(said["TYPE"]):
        raise ValueError("FIELDS, SIZE, TYPE, COUNT: of each field, with x, y and z")
    if not {*sizes} <= {1, 2, 4, 8} or min(*counts, width, height) < 1 or points != width * height:
        raise ValueError("SIZE, COUNT, WIDTH, HEIGHT, or POINTS, which are WIDTH times HEIGHT")
    needed = points * sum(each * count for each, count in zip(sizes, counts, strict=True))
    if kind.strip() == b"ascii":
        needed = 2 * points * sum(counts) - 1
    elif kind.strip() == b"binary_compressed":
        packed, unpacked = np.frombuffer(body, "<u4", 2).tolist()
        if unpacked != needed:
            raise ValueError(f"unpacked size: {unpacked} bytes of {needed}")
        check_size("compressed points", unpacked)
        needed = packed + 8
    if (left := size - (len(head) - len(body))) < needed:
        raise ValueError(f"size: {left} bytes of {needed}")
    return height, width


def _ply(head: bytes, size: int) -> int:
    """The number of points. Raises ValueError or KeyError for sizes that are not those of a file of this size."""
    lines, end, body = head.partition(b"\nend_header")
    needed = points = count = 0
    for words in (line.split() for line in lines.decode("latin-1").splitlines()):
        if words[:1] == ["element"] and len(words) == 3:
            count = int(words[2])
            points = count if words[1] == "vertex" else points
        elif words[:1] == ["property"]:
            needed += count * (2 if b"\nformat ascii" in lines else PLY_BYTES[words[1 + (words[1] == "list")]])
    if not end or count < 0 or size - (len(head) - len(body)) < needed:
        raise ValueError(f"size: {size - len(head) + len(body)} bytes of {needed}" if end else "end_header")
    return points
