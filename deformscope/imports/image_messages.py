"""Images and distances of messages: raw, packed by image_transport, and clouds of points.

Formats: image_transport_plugins, `compressed_depth_image_transport/codec.cpp`. RVL: Wilson, Fast Lossless Depth Image
Compression, ISS 2017."""

import re
import struct
from collections import Counter
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.file_io import check_size
from deformscope.images import PNG_SIGNATURE, decode_image
from deformscope.imports.import_map import MappedStream

REAL = "32FC1"
DEPTH_ENCODINGS = ("16UC1", "mono16", REAL)
COLOR_ENCODINGS = {"rgb8": 3, "bgr8": 3, "mono8": 1, "rgba8": 4, "bgra8": 4}
FORMAT = re.compile(r"\s*(?:(\w*)\s*;)?\s*(compressedDepth\b)?\s*(\w*)\s*(?:compressed(?:\s+\w+)?)?\s*;?\s*")
"""An encoding, whether it has a head of 12 bytes, and a codec, as in `16UC1; compressedDepth png`, `rgb8; jpeg
compressed bgr8`, `png`."""
HEAD_BYTES = 12
LOSSY = ("jpeg", "jpg", "webp")
AXES = ("x", "y", "z")
POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
IN_ORDER = 0.5
"""Least correlation of a point's direction with its place in an image."""


def parse_format(said: str) -> tuple[str, bool, str]:
    """The encoding, whether it is of compressedDepth, and the codec; empty where not said, `?` where not understood."""
    found = FORMAT.fullmatch(said)
    encoding, packed, codec = found.groups("") if found else ("?", "", "")
    return (codec, False, "") if not encoding and codec in DEPTH_ENCODINGS else (encoding, bool(packed), codec)


def is_depth(said: str) -> bool:
    """Whether an image's encoding or format is one of distances."""
    encoding, packed, _ = parse_format(said)
    return packed or encoding in DEPTH_ENCODINGS


def compressed_depth(stream: MappedStream, said: str, data: bytes) -> tuple[Any, str]:
    """(H, W) counts, or distances [m] of real numbers, and their encoding. said: the format of the message. Raises
    InputError for formats whose distances are lost or unknown."""
    encoding, packed, codec = parse_format(said)
    is_known = encoding in (DEPTH_ENCODINGS if packed else (*DEPTH_ENCODINGS[:2], ""))
    if not is_known or codec in LOSSY or (packed and codec not in ("", "png", "rvl")):
        lost = ", in which distances are lost" if codec in LOSSY else ""
        forms = "16UC1; png compressed, or ENCODING; compressedDepth [png|rvl] of 16UC1, mono16 or 32FC1"
        hint = 'another topic of the same camera, or kind = "color"'
        raise InputError(f"distances of {stream.device} in the format {forms}", f"{said!r}{lost}", hint)
    body = data[HEAD_BYTES:] if packed and (encoding == REAL or not data.startswith(PNG_SIGNATURE)) else data
    if codec == "rvl":
        counts = _unpack_rvl(body)
    elif packed and not body.startswith(PNG_SIGNATURE):
        raise ValueError(f"expected a PNG after a head of {HEAD_BYTES} bytes, as {said!r} says; got {body[:4]!r}")
    else:
        counts = decode_image(body, stream.device)
    if encoding != REAL:
        return counts, encoding
    _, a, b = struct.unpack_from("<iff", data)
    if not (0 < a < np.inf and abs(b) < np.inf and counts.dtype == np.uint16):
        raise ValueError(f"expected a head with depth = A / (pixel - B), A above 0, and 16 bits; got A {a:g}, B {b:g}")
    apart = counts - float(b)
    return np.where((counts > 0) & (apart > 0), a / np.where(apart > 0, apart, 1.0), np.nan), encoding


def _unpack_rvl(data: bytes) -> Any:
    """(H, W) uint16: after its width and height, counts of zeros and of others in turn, and of those the differences.

    Numbers are in groups of 3 bits, the lowest first, with a fourth bit where a group follows; 8 groups are a word."""
    if len(data) < 8:
        raise ValueError("RVL without a width and a height")
    width, height = struct.unpack_from("<II", data)
    check_size("an image in RVL", 24.0 * width * height)
    words = np.frombuffer(data, "<u4", (len(data) - 8) // 4, 8)
    groups = (words[:, None] >> np.arange(28, -4, -4, dtype=np.uint32) & 15).astype(np.int64).ravel()
    ends = np.flatnonzero(groups < 8) + 1
    starts = np.concatenate([[0], ends[:-1]])
    place = np.arange(ends[-1]) - np.repeat(starts, ends - starts)
    if place.max() > 10:  # of 32 bits
        raise ValueError("RVL with a number of more than 32 bits")
    numbers = np.add.reduceat((groups[: ends[-1]] & 7) << 3 * place, starts)
    steps, seen = np.zeros(width * height, np.int64), np.zeros(width * height, bool)
    done = at = 0
    while done < len(steps):
        if at + 2 > len(numbers):
            raise ValueError(f"RVL that ends after {done} of {len(steps)} pixels")
        done, count = done + int(numbers[at]), int(numbers[at + 1])
        some = numbers[at + 2 : at + 2 + count]
        if done + count > len(steps) or len(some) < count:
            raise ValueError(f"RVL with {done + count} of {len(steps)} pixels, or that ends there")
        steps[done : done + count], seen[done : done + count] = (some >> 1) ^ -(some & 1), True
        done, at = done + count, at + 2 + count
    return np.where(seen, np.cumsum(steps), 0).astype(np.uint16).reshape(height, width)


def raw_image(stream: MappedStream, value: Any) -> Any:
    """(H, W) or (H, W, 3) of a message. Raises InputError for an encoding that is not known."""
    order = ">" if value.is_bigendian else "<"
    if value.encoding in DEPTH_ENCODINGS:
        kind = np.dtype(f"{order}{'f4' if value.encoding == REAL else 'u2'}")
        rows = _rows(value, value.width * kind.itemsize, value.step)
        return np.ascontiguousarray(rows).view(kind).astype(kind.newbyteorder("="))
    if value.encoding not in COLOR_ENCODINGS:
        known = ", ".join((*DEPTH_ENCODINGS, *COLOR_ENCODINGS))
        raise InputError(f"images of {stream.device} encoded as {known}", repr(value.encoding))
    channels = COLOR_ENCODINGS[value.encoding]
    rows = _rows(value, value.width * channels, value.step)
    image = rows.reshape(value.height, value.width, channels)
    image = image[..., 2::-1] if value.encoding.startswith("bgr") else image[..., :3]
    return np.ascontiguousarray(image[..., 0] if channels == 1 else image)


def _rows(value: Any, used: int, stride: int) -> Any:
    """(H, used) bytes of a message with rows `stride` bytes apart. Raises ValueError if they are not its bytes."""
    if used > stride or value.height * stride != len(value.data):
        rows = f"{value.height} rows of {used} bytes each, {stride} bytes apart"
        raise ValueError(f"expected {rows}, as the message says; got {len(value.data)} bytes")
    return np.asarray(value.data, np.uint8).reshape(value.height, stride)[:, :used]


def cloud_depth(stream: MappedStream, value: Any, missed: Counter[str]) -> Any:
    """Distances of a message of points along z: (H, W) in their order, or projected into the camera of the map."""
    of = {one.name: one for one in value.fields}
    if missing := [axis for axis in AXES if axis not in of]:
        raise ValueError(f"expected fields x, y and z; got no {missing[0]} in {', '.join(of) or 'none'}")
    for one in value.fields:
        size = np.dtype(POINT_TYPES.get(one.datatype, "V0")).itemsize * max(one.count, 1)
        if not size or one.offset + size > value.point_step or (one.count > 1 and one.name in AXES):
            came = f"{one.count} of type {one.datatype} from byte {one.offset} on"
            raise ValueError(f"expected {one.name} within the {value.point_step} bytes of its point; got {came}")
    rows = _rows(value, value.width * value.point_step, value.row_step)
    order = ">" if value.is_bigendian else "<"
    formats = [order + POINT_TYPES[of[axis].datatype] for axis in AXES]
    offsets = [of[axis].offset for axis in AXES]
    kind = np.dtype({"names": AXES, "formats": formats, "offsets": offsets, "itemsize": value.point_step})
    points = np.ascontiguousarray(rows).view(kind)
    return depth_of_points(stream, np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=-1), missed)


def depth_of_points(stream: MappedStream, points: FloatArray, missed: Counter[str]) -> FloatArray:
    """Distances along z of points (H, W, 3): in their order if H > 1, else projected into the map's camera, with the
    nearest point for each pixel. missed: counts points that this camera does not see. Raises InputError for points
    that are not of a camera that looks along z, with x to the right and y down."""
    # The points' axes that lead to the camera's right, down, and along its view
    axes = stream.axes.replace(",", " ").split()
    if sorted(one.removeprefix("-") for one in axes) != ["x", "y", "z"]:
        raise stream.missing("axes", 'x, y and z, each once, as in "x, -y, -z"', stream.axes)
    points = points[..., ["xyz".index(one[-1]) for one in axes]]
    points = points * [-1.0 if one.startswith("-") else 1.0 for one in axes]
    x, y, z = (points[..., at] for at in range(3))
    finite = np.isfinite(points).all(axis=-1)
    front, behind = finite & (z > 0), np.count_nonzero(finite & (z < 0))
    if behind > np.count_nonzero(front):
        came = f"{behind} of {np.count_nonzero(finite)} points behind it (z < 0)"
        raise _of_other_axes(stream, f"points in front of the camera, along {axes[2]}", came)
    if len(points) > 1:
        for name, across, place in (("right", x, 1), ("down", y, 0)):
            near = front & (np.abs(across) < 1e3 * z)
            line, tangent = np.indices(z.shape)[place][near], across[near] / z[near]
            if len(line) > 2 and np.ptp(line) and np.ptp(tangent) > 1e-9:
                alike = np.corrcoef(line, tangent)[0, 1]
                if alike < IN_ORDER:
                    came = f"a correlation of {alike:.2f} with their place in the image"
                    raise _of_other_axes(stream, f"points that go to the {name} along the image's side", came)
        return z
    given = {"focal_px": stream.focal_px, "center_px": stream.center_px, "size_px": stream.size_px}
    for key, value in given.items():
        if value is None:
            expected = "of the camera that points without an order are projected into [px]"
            raise stream.missing(
                key, expected, "", f"{key} = [WIDTH, HEIGHT]" if key == "size_px" else f"{key} = [X, Y]"
            )
    (fx, fy), (cx, cy), (width, height) = stream.focal_px, stream.center_px, stream.size_px  # type: ignore[misc]
    x, y, z = points[front].T
    with np.errstate(all="ignore"):  # beside the axis, near it, and where the map's camera is none
        column, row = np.rint(fx * x / z + cx), np.rint(fy * y / z + cy)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    missed["outside"] += int(np.count_nonzero(~inside))
    check_size("an image of size_px", 8.0 * height * width, stream.device)
    depth = np.full((height, width), np.inf)
    np.minimum.at(depth, (row[inside].astype(np.int64), column[inside].astype(np.int64)), z[inside])
    return depth


def _of_other_axes(stream: MappedStream, expected: str, came: str) -> InputError:
    hint = 'axes = "x, -y, -z" in the map, where y is up (viewers), or "-y, -z, x", where x is ahead (robots)'
    return InputError(f"axes of {stream.device} in the map: {expected}", came, hint)
