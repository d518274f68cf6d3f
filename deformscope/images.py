"""Image files: read without loss or noise on the standard error, and written as PNG."""

from __future__ import annotations

import math
import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from deformscope.arrays import ImageArray
from deformscope.errors import InputError
from deformscope.file_io import check_size, read_file

LARGEST_OTHER = 3 * 16383**2
"""Bytes of the largest WebP: what an image may take of a kind whose size is not read before it is decoded."""
JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""Markers of a JPEG's segment with its size."""
TIFF_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_QUALITY = 90
NOISY = (
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY),
    *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB),
)

# One clear line reaches the user; the decoders would print theirs first.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def read_image(path: str | Path) -> ImageArray:
    """One image file: (H, W) grey or (H, W, 3) RGB, uint8 or uint16; transparency is left out."""
    return decode_image(read_file(path, "an image"), path)


def decode_image(encoded: bytes, where: object) -> ImageArray:
    """The image in `encoded`, (H, W) or (H, W, 3) as `read_image` gives it; `where` names it in a refusal."""
    if not encoded:
        raise InputError("an image", "an empty file", where=where)
    if encoded.startswith(PNG_SIGNATURE):
        encoded = _bare_png(encoded, where)
    check_size("an image", _unpacked_bytes(encoded), where)
    try:
        image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    except cv2.error as error:
        raise InputError("an image", "one that cannot be decoded", "write the file again", where) from error
    if image is None:
        raise InputError("an image", "a damaged, truncated or unknown file", "write the file again", where)
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError("8 or 16 bits a channel", f"{image.dtype}", "convert it to 8 or 16 bits", where)
    pixels: ImageArray = image if image.dtype == np.uint8 else image.view(np.uint16)  # type: ignore[assignment]
    return pixels if pixels.ndim == 2 else to_rgb(pixels)


def encode_png(image: ImageArray, *, noisy: bool = False) -> bytes:
    """(H, W) grey or (H, W, 3) RGB, uint8 or uint16, as PNG without loss; fast rather than small. noisy: the image is
    from a sensor, so that searching for repetitions would only take twice the time"""
    swapped = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1, *(NOISY if noisy else ())]
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(swapped), options)
    if not done:
        raise ValueError(f"no PNG can be made of an image of shape {image.shape} and type {image.dtype}")
    return encoded.tobytes()


def encode_jpeg(image: ImageArray) -> bytes:
    """(H, W) grey or (H, W, 3) RGB uint8 as JPEG of quality 90: small, fast, with losses."""
    swapped = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", np.ascontiguousarray(swapped), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def encode_color(image: ImageArray, *, lossless: bool) -> bytes:
    """An image (H, W[, 3]) as JPEG; as PNG if it must be lossless, or has 16 bits, which JPEG does not support."""
    return encode_png(image, noisy=True) if lossless or image.dtype != np.uint8 else encode_jpeg(image)


def to_rgb(bgr: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> ImageArray:
    """OpenCV's (H, W, 3) BGR as RGB."""
    swapped: ImageArray = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)  # type: ignore[assignment]
    return swapped


def _unpacked_bytes(encoded: bytes) -> int:
    """Bytes of an image's pixels as RGB, by its head; twice as many may come with 16 bits."""
    try:
        if encoded.startswith(PNG_SIGNATURE):
            width, height, bits = struct.unpack_from(">IIB", encoded, 16)
            return int(width * height * 3 * max(bits, 8) // 8)
        if encoded.startswith(b"\xff\xd8"):
            place = 2
            while (kind := encoded[place + 1]) not in JPEG_FRAMES:
                place += 1 if kind == 0xFF else 2 + int.from_bytes(encoded[place + 2 : place + 4])
            return 3 * math.prod(map(int, struct.unpack_from(">HH", encoded, place + 5)))
        if order := TIFF_ORDERS.get(encoded[:4]):
            (place,) = struct.unpack_from(f"{order}I", encoded, 4)
            (count,) = struct.unpack_from(f"{order}H", encoded, place)
            found = 3
            for at in range(place + 2, place + 2 + 12 * count, 12):
                tag, kind = struct.unpack_from(f"{order}HH", encoded, at)
                if tag in (256, 257):  # width and height
                    (side,) = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", encoded, at + 8)
                    found *= int(side)
            return found
    except (IndexError, struct.error):  # cut off, which its decoder says
        return 0
    return LARGEST_OTHER


def _bare_png(encoded: bytes, where: object) -> bytes:
    """The PNG with its critical chunks alone, each checked.

    The decoder prints to the standard error on damage, and on a camera's odd colour profile: neither gets there."""
    kept = [PNG_SIGNATURE]
    place = len(PNG_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        head = encoded[place : place + 8]
        length, kind = struct.unpack(">I4s", head) if len(head) == 8 else (0, b"")
        chunk = encoded[place : place + 12 + length]
        if len(head) < 8 or len(chunk) < 12 + length:
            raise InputError("a whole PNG image", "a truncated one", "write the file again", where)
        if zlib.crc32(chunk[4:-4]) != int.from_bytes(chunk[-4:], "big"):
            raise InputError("a whole PNG image", "one with damaged bytes", "write the file again", where)
        if kind[:1].isupper():
            kept.append(chunk)
        place += len(chunk)
    return b"".join(kept)
