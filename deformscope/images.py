"""Image files: read without loss or noise on the standard error, and written as PNG."""

import itertools
import math
import mmap
import os
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

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
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
TIFF_NUMBERS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q"}
"""Types of a TIFF's numbers, as `struct` names them."""
KIND, WIDTH, HEIGHT, DESCRIPTION, ORIENTATION, SAMPLES = 254, 256, 257, 270, 274, 277
"""Tags of a TIFF's page; the first says which pages are thumbnails or masks."""
HEAD_BYTES = 1 << 16
SEVERAL = re.compile(rb'(channels=|Size[CZ]=")([2-9]|\d{2,})')
"""Words of ImageJ and OME in the description of a stack: several pages belong to one frame."""
JPEG_QUALITY = 90
DRAWN = cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE
NOISY = (
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY),
    *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB),
)

Encoded: TypeAlias = bytes | mmap.mmap
TiffTags: TypeAlias = dict[int, tuple[int, int]]

# One clear line reaches the user; the decoders would print theirs first.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def read_image(path: str | Path) -> ImageArray:
    """One image file: (H, W) grey or (H, W, 3) RGB, uint8 or uint16; transparency is left out."""
    encoded = read_file(path, "an image")
    if len(pages := frame_pages(encoded, path)) > 1 or is_animated(encoded):
        came = f"a file of {len(pages)} pages" if len(pages) > 1 else "an animation"
        raise InputError("one image", came, "save the one that is meant alone", path)
    return decode_image(encoded, path, pages[0])


def decode_image(encoded: bytes, where: object, page: int = 0, *, turned: bool = True) -> ImageArray:
    """The image in `encoded`, (H, W) or (H, W, 3) as `read_image` gives it; `where` names it in a refusal.

    page: index of a TIFF's page; turned: as its Exif orientation says, False = as the sensor gave it"""
    if not encoded:
        raise InputError("an image", "an empty file", where=where)
    if encoded[4:12] in (b"ftypheic", b"ftypheix", b"ftyphevc", b"ftypmif1", b"ftypmsf1"):
        raise InputError("a JPEG, PNG or TIFF image", "HEIC", "convert it to JPEG or PNG", where)
    if encoded.startswith(PNG_SIGNATURE):
        encoded = _bare_png(encoded, where)
    check_size("an image", _unpacked_bytes(encoded, page), where)
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | (0 if turned else cv2.IMREAD_IGNORE_ORIENTATION)
    data = np.frombuffer(encoded, np.uint8)
    if not turned and (tags := _tiff_tags(encoded, page)) and ORIENTATION in tags:
        data = data.copy()  # its decoder always turns
        place = tags[ORIENTATION][1]
        data[place : place + 2] = [0, 1] if encoded[:1] == b"M" else [1, 0]
    try:
        image = cv2.imdecodemulti(data, flags, range=(page, page + 1))[1][0] if page else cv2.imdecode(data, flags)
    except (cv2.error, IndexError) as error:
        raise InputError("an image", "one that cannot be decoded", "write the file again", where) from error
    if image is None:
        raise InputError("an image", "a damaged, truncated or unknown file", "write the file again", where)
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError("8 or 16 bits a channel", f"{image.dtype}", "convert it to 8 or 16 bits", where)
    pixels: ImageArray = image if image.dtype == np.uint8 else image.view(np.uint16)  # type: ignore[assignment]
    return pixels if pixels.ndim == 2 else to_rgb(pixels)


def frame_pages(encoded: Encoded, where: object) -> list[int]:
    """The pages of a TIFF that are images of their own: no thumbnails, no masks. [0] of any other file.

    Raises InputError where a page is one channel of an image."""
    try:
        pages = list(_tiff_pages(encoded))
    except (IndexError, OverflowError, struct.error) as error:
        raise InputError("a whole TIFF image", "a truncated one", "write the file again", where) from error
    if len(pages) > 1:
        start, length = pages[0].get(DESCRIPTION, (0, 0))
        about = bytes(memoryview(encoded)[start : start + length])
        if (several := SEVERAL.search(about)) and pages[0].get(SAMPLES, (1, 0))[0] == 1:
            came = f"{len(pages)} pages, with {several[0].decode()} in their description"
            raise InputError("a page for each frame", came, "save one channel of one plane as a stack", where)
    return [at for at, tags in enumerate(pages) if not tags.get(KIND, (0, 0))[0] & 5] or [0]


def is_animated(encoded: Encoded) -> bool:
    """Whether a GIF, PNG, WebP or AVIF has more than one frame."""
    head = bytes(memoryview(encoded)[:HEAD_BYTES])
    if head.startswith(b"GIF8"):
        return len(cv2.imdecodeanimation(np.frombuffer(encoded, np.uint8), start=0, count=2)[1].frames) > 1
    if head.startswith(PNG_SIGNATURE):
        return b"acTL" in head.partition(b"IDAT")[0]
    return head[4:12] == b"ftypavis" or (head[12:16] == b"VP8X" and bool(head[20] & 2))


def encode_png(image: ImageArray, *, noisy: bool = False) -> bytes:
    """(H, W) grey or (H, W, 3) RGB, uint8 or uint16, as PNG without loss; fast rather than small. noisy: the image is
    from a sensor, so that searching for repetitions would only take twice the time; else it is drawn"""
    swapped = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1, *(NOISY if noisy else DRAWN)]
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


def _unpacked_bytes(encoded: bytes, page: int) -> int:
    """Bytes of an image's pixels as RGB, by its head; twice as many may come with 16 bits. page: see `decode_image`"""
    try:
        if encoded.startswith(PNG_SIGNATURE):
            width, height, bits = struct.unpack_from(">IIB", encoded, 16)
            return int(width * height * 3 * max(bits, 8) // 8)
        if encoded.startswith(b"\xff\xd8"):
            place = 2
            while (kind := encoded[place + 1]) not in JPEG_FRAMES:
                place += 1 if kind == 0xFF else 2 + int.from_bytes(encoded[place + 2 : place + 4])
            return 3 * math.prod(map(int, struct.unpack_from(">HH", encoded, place + 5)))
        if tags := _tiff_tags(encoded, page):
            return 3 * math.prod(tags.get(side, (1, 0))[0] for side in (WIDTH, HEIGHT))
    except (IndexError, OverflowError, struct.error):  # cut off, which its decoder says
        return 0
    return LARGEST_OTHER


def _tiff_tags(encoded: bytes, page: int) -> TiffTags:
    return next(itertools.islice(_tiff_pages(encoded), page, None), {})


def _tiff_pages(encoded: Encoded) -> Iterator[TiffTags]:
    """The number of each tag of each page of a TIFF (of one page of several gigabytes, too), and its place; of the
    description its place and length. Nothing of other files; raises struct.error where it ends early."""
    order = {b"II": "<", b"MM": ">"}.get(bytes(memoryview(encoded)[:2]), "")
    version = struct.unpack_from(f"{order}H", encoded, 2)[0] if order and len(memoryview(encoded)) > 8 else 0
    if version not in (42, 43):
        return
    big = version == 43
    size, offset, many = (8, "Q", "Q") if big else (4, "I", "H")
    (place,), seen = struct.unpack_from(order + offset, encoded, size), set[int]()
    while place and place not in seen:
        seen.add(place)
        (count,) = struct.unpack_from(order + many, encoded, place)
        start, step = place + struct.calcsize(f"={many}"), 4 + 2 * size
        tags: TiffTags = {}
        for at in range(start, start + step * count, step):
            tag, kind = struct.unpack_from(f"{order}HH", encoded, at)
            (number,), value = struct.unpack_from(order + offset, encoded, at + 4), at + 4 + size
            if tag == DESCRIPTION and number > size:
                tags[tag] = struct.unpack_from(order + offset, encoded, value)[0], number
            elif kind in TIFF_NUMBERS:
                tags[tag] = struct.unpack_from(order + TIFF_NUMBERS[kind], encoded, value)[0], value
        yield tags
        (place,) = struct.unpack_from(order + offset, encoded, start + step * count)


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
