"""Points of PCD and PLY files: no value comes from beyond the bytes of the file.

Open3D 0.20 takes float64 of a binary PCD as 0, and what its memory held for the points that a shorter file lacks."""

import io
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.file_io import check_size

AXES = ("x", "y", "z")
POINT_BYTES = 72
"""Memory of a point, with its copies."""
PCD_TYPES = {"I": "i", "U": "u", "F": "f"}
PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
PLY_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
PLY_TYPES |= {f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4)}


def read_points(path: Path) -> FloatArray:
    """(H, W, 3) points in the file's unit; H = 1 without an order. Raises InputError if some are missing."""
    check_size("a file of points", path.stat().st_size, path)
    try:
        return (_pcd if path.suffix.lower() == ".pcd" else _ply)(path.read_bytes())
    except InputError as error:
        raise InputError.about(error, path) from error
    except (IndexError, KeyError, TypeError, ValueError) as error:
        came = f"one without or with a wrong {' '.join(str(error).split())[:120]}"
        raise InputError("a PCD or PLY file with the points that it declares", came, "write it again", path) from error


def _pcd(raw: bytes) -> FloatArray:
    lines, _, body = raw.partition(b"\nDATA ")
    data, _, body = body.partition(b"\n")
    form = data.strip().decode("latin-1")
    if form not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"DATA: {form!r}")
    said = {words[0]: words[1:] for line in lines.decode("latin-1").splitlines() if (words := line.split())}
    fields = said["FIELDS"]
    kinds = [f"<{PCD_TYPES[kind]}{int(size)}" for kind, size in zip(said["TYPE"], said["SIZE"], strict=True)]
    counts = [int(one) for one in said.get("COUNT", ["1"] * len(fields))]
    width, height, points = (int(" ".join(said[name])) for name in ("WIDTH", "HEIGHT", "POINTS"))
    if min(*counts, width, height) < 1 or points != width * height:
        raise ValueError("COUNT, WIDTH, HEIGHT, or POINTS, which are WIDTH times HEIGHT")
    places, each = [fields.index(axis) for axis in AXES], list(zip(kinds, counts, strict=True))
    if form != "binary_compressed":
        return _points(body, points, each, places, form == "ascii").reshape(height, width, 3)
    sizes = [points * np.dtype(kind).itemsize * count for kind, count in each]
    packed, unpacked = np.frombuffer(body, "<u4", 2).tolist()
    if unpacked != sum(sizes) or packed > len(body) - 8:
        raise ValueError(f"size: {packed} bytes packed, {unpacked} unpacked, of {len(body) - 8} and {sum(sizes)}")
    check_size("compressed points", unpacked)
    plain, begins = _unpack_lzf(body[8 : 8 + packed], unpacked), np.cumsum([0, *sizes])
    columns = [np.frombuffer(plain, each[at][0], points * each[at][1], begins[at])[:: each[at][1]] for at in places]
    return np.stack(columns, axis=-1).astype(np.float64).reshape(height, width, 3)


def _ply(raw: bytes) -> FloatArray:
    lines, _, body = raw.partition(b"\nend_header")
    words = [line.split() for line in lines.decode("latin-1").splitlines()]
    starts = [at for at, line in enumerate(words) if line[:1] == ["element"]]
    if words[starts[0]][1] != "vertex":
        raise ValueError("element vertex, the first")
    given = [line for line in words[starts[0] : [*starts, len(words)][1]] if line[:1] == ["property"]]
    form = next((line[1] for line in words if line[:1] == ["format"]), "format")
    order = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    each = [(order + PLY_TYPES[line[1]], 1) for line in given]
    places = [[line[-1] for line in given].index(axis) for axis in AXES]
    return _points(body.partition(b"\n")[2], int(words[starts[0]][2]), each, places, form == "ascii")[None]


def _points(
    body: bytes, points: int, each: Sequence[tuple[str, int]], places: Sequence[int], is_ascii: bool
) -> FloatArray:
    """(points, 3). each: type and count of each of a point's values; places: places of x, y and z among them. Raises
    ValueError for fewer points."""
    if points < 1 or (is_ascii and not body.strip()):
        raise ValueError(f"number of points: {points}")
    check_size(f"a file of {points} points", points * POINT_BYTES)
    if is_ascii:
        lines = itertools.islice(filter(bytes.strip, io.BytesIO(body)), points)
        table, begins = np.loadtxt(lines, ndmin=2, comments=None), np.cumsum([0, *(n for _, n in each)])
        if table.shape != (points, begins[-1]):
            raise ValueError(f"number of values: {table.shape}, of {(points, int(begins[-1]))}")
        return np.asarray(table[:, begins[list(places)]])
    layout = np.dtype([(str(at), kind, (count,)) for at, (kind, count) in enumerate(each)])
    rows: Any = np.frombuffer(body, layout, points)
    return np.stack([rows[str(at)][:, 0].astype(np.float64) for at in places], axis=-1)


def _unpack_lzf(packed: bytes, size: int) -> bytes:
    """Raises ValueError or IndexError if it is not of this size. Source: LibLZF's format."""
    found, place = bytearray(), 0
    while place < len(packed) and len(found) <= size:
        control, place = packed[place], place + 1
        if control < 32:  # as it is
            found += packed[place : place + control + 1]
            place += control + 1
            continue
        length = control >> 5
        if length == 7:
            length, place = length + packed[place], place + 1
        start, place = len(found) - 1 - ((control & 31) << 8 | packed[place]), place + 1
        if start < 0:
            raise ValueError("compressed points")
        again = found[start : start + length + 2]
        found += (again * (length + 2))[: length + 2] if len(again) < length + 2 else again
    if len(found) != size:
        raise ValueError(f"size of compressed points: {len(found)} of {size}")
    return bytes(found)
