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
PLY_BYTES = {
    name: size
    for size, names in {
        1: ("char", "uchar", "int8", "uint8"),
        2: ("short", "ushort", "int16", "uint16"),
        4: ("int", "uint", "float", "int32", "uint32", "float32"),
        8: ("double", "float64"),
    }.items()
    for name in names
}


def read_points(path: Path) -> FloatArray:
    """(H, W, 3) points in the file's unit; H = 1 if they have no order. Raises InputError for a file that does not have
    the points that it declares."""
    import open3d as o3d

    with path.open("rb") as file:
        head, size = file.read(HEAD_BYTES), path.stat().st_size
    try:
        height, width, least_bytes = (_pcd if path.suffix.lower() == ".pcd" else _ply)(head)
    except (IndexError, KeyError, ValueError) as error:
        came = f"one without or with a wrong {' '.join(str(error).split())[:120]}"
        raise InputError("a PCD or PLY file with its head", came, where=path) from error
    check_size(f"a file of {height * width} points", height * width * POINT_BYTES, path)
    if least_bytes > size:
        expected = f"the {least_bytes} bytes or more of {height * width} points, as the file declares"
        raise InputError(expected, f"{size}", "write the file again", path)
    points = np.asarray(o3d.io.read_point_cloud(utf8_path(path), remove_nan_points=False).points)
    if not 0 < len(points) == height * width:
        came = f"{len(points)}, as of a damaged or empty file, or one of another kind"
        raise InputError(f"{height * width} points, as the file declares", came, where=path)
    return points.reshape(height, width, 3)


def _lines(head: bytes, last: bytes) -> tuple[list[list[str]], int]:
    """Words of each line until the one that begins with `last`, and where the next line begins."""
    found, place = [], 0
    while (end := head.find(b"\n", place) + 1) > 0:
        line, place = head[place:end], end
        found.append(line.decode("latin-1").split())
        if line.startswith(last):
            return found, place
    raise ValueError(f"line {last.decode()}")


def _pcd(head: bytes) -> tuple[int, int, int]:
    """Height, width, and the size of the smallest such file [bytes]."""
    lines, place = _lines(head, b"DATA")
    said = {words[0]: words[1:] for words in lines if words}
    fields, sizes = said["FIELDS"], [int(one) for one in said["SIZE"]]
    counts = [int(one) for one in said.get("COUNT", ["1"] * len(fields))]
    (width,), (height,), (points,), (data,) = ([*said[name]] for name in ("WIDTH", "HEIGHT", "POINTS", "DATA"))
    if not {"x", "y", "z"} <= {*fields} or not len(fields) == len(sizes) == len(counts) == len(said["TYPE"]):
        raise ValueError("FIELDS, SIZE, TYPE, COUNT: of each field, with x, y and z")
    if not {*sizes} <= {1, 2, 4, 8} or min(counts) < 1 or min(int(width), int(height)) < 1:
        raise ValueError("SIZE, COUNT, WIDTH or HEIGHT")
    if int(points) != int(width) * int(height):
        raise ValueError(f"POINTS: {points}, of WIDTH {width} and HEIGHT {height}")
    step = sum(size * count for size, count in zip(sizes, counts, strict=True))
    least_bytes = int(points) * (2 * sum(counts) if data == "ascii" else step)
    if data == "binary_compressed":
        packed, unpacked = np.frombuffer(head, "<u4", 2, place).tolist()
        if unpacked != least_bytes:
            raise ValueError(f"unpacked size: {unpacked} bytes of {points} points of {step} bytes")
        check_size("compressed points", unpacked)
        least_bytes = packed + 8
    return int(height), int(width), place + least_bytes - (data == "ascii")


def _ply(head: bytes) -> tuple[int, int, int]:
    """1, the number of points, and the size of the smallest such file [bytes]."""
    lines, place = _lines(head, b"end_header")
    least_bytes = points = count = 0
    is_ascii = ["format", "ascii", "1.0"] in lines
    for words in lines:
        if words[:1] == ["element"]:
            count = int(words[2])
            points = count if words[1] == "vertex" else points
            if count < 0:
                raise ValueError(f"element {words[1]}")
        elif words[:1] == ["property"]:
            size = PLY_BYTES[words[2] if words[1] == "list" else words[1]]
            least_bytes += count * (2 if is_ascii else size)
    return 1, points, place + max(least_bytes - is_ascii, 0)
