"""Every page of a TIFF is a frame; one camera's images stay one sequence, in grey or RGB, however they were held."""

import contextlib
import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.files.sources import open_source
from deformscope.images import decode_image, read_image

SIZE = (24, 32)


def noise(seed: int, depth: type = np.uint8, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, np.iinfo(depth).max, size, dtype=depth, endpoint=True)


def tiff(
    pages: Sequence[np.ndarray],
    *,
    order: str = "<",
    big: bool = False,
    kinds: Sequence[int] = (),
    turns: Sequence[int] = (),
    about: bytes = b"",
) -> bytes:
    """A grey TIFF. kinds: NewSubfileType of each page; turns: orientation of each; about: its description"""
    number, entry = ("Q", "HHQQ") if big else ("I", "HHII")
    size, many = struct.calcsize(f"={number}"), "Q" if big else "H"
    out = struct.pack(f"{order}2s", b"II" if order == "<" else b"MM")
    out += struct.pack(f"{order}HHHQ", 43, 8, 0, 16) if big else struct.pack(f"{order}HI", 42, 8)
    for at, page in enumerate(pages):
        page = page.astype(page.dtype.newbyteorder(order))
        numbers = {254: kinds[at] if kinds else 0, 256: page.shape[1], 257: page.shape[0], 258: 8 * page.itemsize}
        numbers |= {
            259: 1,
            262: 1,
            273: 0,
            274: turns[at] if turns else 1,
            277: 1,
            278: page.shape[0],
            279: page.nbytes,
        }
        count = len(numbers) + bool(about)
        end = len(out) + struct.calcsize(f"={many}") + count * struct.calcsize(f"={entry}") + size
        numbers[273] = end + len(about)
        rows = [(tag, 16 if big else 4, 1, value) for tag, value in numbers.items()]
        rows += [(270, 2, len(about), end)] if about else []
        out += struct.pack(order + many, count)
        out += b"".join(struct.pack(order + entry, *row) for row in sorted(rows))
        out += struct.pack(order + number, 0 if at == len(pages) - 1 else end + len(about) + page.nbytes)
        out += about + page.tobytes()
    return out


def refusal(*paths: Path, **options: object) -> str:
    with pytest.raises(InputError) as refused, open_source(paths, **options) as source:  # type: ignore[arg-type]
        list(source)
    return str(refused.value)


def frames(*paths: Path) -> list[np.ndarray]:
    with open_source(paths) as source:
        found = [frame.image for frame in source]
        assert source.count == len(found)
    return found


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True], ids=["classic", "big"])
@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_pages_are_frames(tmp_path: Path, order: str, big: bool, depth: type) -> None:
    given = [noise(seed, depth) for seed in range(5)]
    (tmp_path / "only.tif").write_bytes(tiff(given, order=order, big=big))
    np.testing.assert_array_equal(frames(tmp_path / "only.tif"), given)
    folder = tmp_path / "parts"
    folder.mkdir()
    for name, part in (("part2.tiff", given[:2]), ("part10.tif", given[2:4]), ("part11.tif", given[4:])):
        (folder / name).write_bytes(tiff(part, order=order, big=big))
    np.testing.assert_array_equal(frames(folder), given)
    np.testing.assert_array_equal(frames(folder / "part2.tiff", folder / "part11.tif"), [given[0], given[1], given[4]])
    with open_source([folder], stride=2) as source:
        assert source.count == 3
        np.testing.assert_array_equal([frame.image for frame in source], given[::2])


def test_pages_written_by_opencv_with_compression(tmp_path: Path) -> None:
    given = [noise(seed) for seed in range(3)]
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), given)
    np.testing.assert_array_equal(frames(tmp_path / "a.tif"), given)


def test_a_stack_has_no_times(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(tiff([noise(0), noise(1)]))
    assert "--fps with images" in refusal(tmp_path / "a.tif", timed=True)


def test_thumbnails_and_masks_are_no_frames(tmp_path: Path) -> None:
    given, small = [noise(0), noise(1)], noise(9, size=(6, 8))
    for at, (name, pages, kinds) in enumerate(
        [("a.tif", [given[0], small], (0, 1)), ("b.tif", [small, given[1], given[1]], (1, 2, 4))]
    ):
        (tmp_path / name).write_bytes(tiff(pages, kinds=kinds))
        np.testing.assert_array_equal(read_image(tmp_path / name), given[at])
    np.testing.assert_array_equal(frames(tmp_path), given)


def test_a_page_of_another_size_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(tiff([noise(0), noise(1), noise(2, size=(6, 8))]))
    said = refusal(tmp_path / "a.tif")
    assert "got 8x6 grey of 8 bits after 32x24 grey of 8 bits" in said
    assert "a.tif, page 3" in said


def test_pages_where_one_image_is_meant_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(tiff([noise(0), noise(1)]))
    with pytest.raises(InputError, match=r"expected one image; got a file of 2 pages"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize(
    "about", [b"ImageJ=1.53\nimages=4\nchannels=2\nframes=2\n\0", b'<OME><Pixels SizeZ="2"></OME>\0']
)
def test_pages_that_are_channels_or_planes_are_refused(tmp_path: Path, about: bytes) -> None:
    (tmp_path / "a.tif").write_bytes(tiff([noise(seed) for seed in range(4)], about=about))
    assert "a page for each frame; got 4 pages, with " in refusal(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(tiff([noise(seed) for seed in range(4)], about=b"images=4\nframes=4\0"))
    assert len(frames(tmp_path / "a.tif")) == 4


def test_a_stack_that_is_cut_off_is_not_a_shorter_one(tmp_path: Path) -> None:
    whole = tiff([noise(seed) for seed in range(4)])
    for share in (0.3, 0.6, 0.9, 0.999):
        (tmp_path / "a.tif").write_bytes(whole[: round(share * len(whole))])
        assert "a.tif" in refusal(tmp_path / "a.tif")


@pytest.mark.parametrize("place", range(8, 150, 2))
def test_damaged_stacks_end_in_a_refusal_or_in_images(tmp_path: Path, place: int) -> None:
    raw = bytearray(tiff([noise(seed) for seed in range(3)], big=bool(place % 4)))
    raw[place : place + 2] = b"\xff\xff"
    (tmp_path / "a.tif").write_bytes(raw)
    found = []
    with contextlib.suppress(InputError):
        found = frames(tmp_path / "a.tif")
    assert len(found) in (0, 2, 3)


def jpeg(image: np.ndarray, orientation: int | None) -> bytes:
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    if orientation is None:
        return encoded
    exif = b"Exif\0\0II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    return encoded[:2] + struct.pack(">2sH", b"\xff\xe1", 2 + len(exif)) + exif + encoded[2:]


@pytest.mark.parametrize("first", [None, 1, 2, 3, 4, 5, 6, 7, 8])
@pytest.mark.parametrize("kind", ["jpg", "tif"])
def test_a_sequence_is_turned_as_its_first_image(tmp_path: Path, first: int | None, kind: str) -> None:
    image = noise(0)
    said = [first, None, 1, 3, 6, 8, 2]
    for at, turn in enumerate(said):
        raw = jpeg(image, turn) if kind == "jpg" else tiff([image], turns=[turn or 1])
        (tmp_path / f"{at}.{kind}").write_bytes(raw)
    expected = read_image(tmp_path / f"0.{kind}")
    assert expected.shape == (SIZE if first is None or first < 5 else SIZE[::-1])
    for found in frames(tmp_path):
        np.testing.assert_array_equal(found, expected)


def test_grey_images_may_be_saved_as_rgb(tmp_path: Path) -> None:
    given = [noise(seed) for seed in range(4)]
    for at, (image, kind) in enumerate(zip(given, (0, 3, 0, 4), strict=True)):
        copies = np.dstack([image] * kind) if kind else image
        if kind == 4:
            copies[..., 3] = 255
        cv2.imwrite(str(tmp_path / f"{at}.png"), copies)
    np.testing.assert_array_equal(frames(tmp_path), given)
    (tmp_path / "0.png").unlink()
    np.testing.assert_array_equal(frames(tmp_path), [np.dstack([image] * 3) for image in given[1:]])


def test_colour_beside_grey_stays_refused(tmp_path: Path) -> None:
    colour = np.dstack([noise(1), noise(2), noise(3)])
    for first, then in ((noise(0), colour), (colour, noise(0))):
        cv2.imwrite(str(tmp_path / "0.png"), first)
        cv2.imwrite(str(tmp_path / "1.png"), then)
        assert "one size, depth and channel count" in refusal(tmp_path)


def test_images_that_cannot_be_read_are_not_left_out_of_a_folder(tmp_path: Path) -> None:
    heic = b"\0\0\0\x18ftypheic" + bytes(40)
    for at in range(2):
        cv2.imwrite(str(tmp_path / f"{at}.png"), noise(at))
    (tmp_path / "2.HEIC").write_bytes(heic)
    for given in ([tmp_path], [tmp_path / "0.png", tmp_path / "2.HEIC"], [tmp_path / "2.HEIC"]):
        said = refusal(*given)
        assert "got HEIC" in said
        assert "convert 2.HEIC to JPEG or PNG" in said
    (tmp_path / "2.HEIC").rename(tmp_path / "2.jpg")
    assert "got HEIC" in refusal(tmp_path)
    with pytest.raises(InputError, match="got HEIC"):
        decode_image(heic, "a.jpg")
