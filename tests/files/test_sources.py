"""Every kind of source gives the same frames; everything that cannot be used is refused in one line."""

import io
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.files.sources import images_in, open_source
from deformscope.frames import ColorFrame
from deformscope.images import encode_png, read_image

SIZE = (24, 32)


def noise(seed: int, channels: int = 1, depth: type = np.uint8) -> np.ndarray:
    shape = SIZE if channels == 1 else (*SIZE, channels)
    return np.random.default_rng(seed).integers(0, np.iinfo(depth).max, shape, dtype=depth, endpoint=True)


def write(path: Path, image: np.ndarray) -> Path:
    """RGB or grey to a file, in whatever format its name says."""
    assert cv2.imwrite(str(path), image if image.ndim == 2 else image[..., ::-1])
    return path


def folder(path: Path, count: int = 3, **kind: object) -> Path:
    path.mkdir()
    for index in range(count):
        write(path / f"img{index + 1}.png", noise(index, **kind))  # type: ignore[arg-type]
    return path


def video(path: Path, count: int = 12, fps: float = 25.0) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, (64, 48))
    assert writer.isOpened()
    for index in range(count):
        writer.write(np.full((48, 64, 3), (10 * index, 0, 200), np.uint8))
    writer.release()
    return path


def read(*paths: str | Path, **options: object) -> list[ColorFrame]:
    with open_source(paths, **options) as source:  # type: ignore[arg-type]
        return list(source)


def refusal(*paths: str | Path, **options: object) -> str:
    with pytest.raises(InputError) as refused:
        read(*paths, **options)
    message = str(refused.value)
    assert "\n" not in message
    assert message.startswith("expected ")
    return message


def test_folder_in_natural_order(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        write(tmp_path / f"img{number}.png", noise(number))
    (tmp_path / "notes.txt").write_text("not an image")
    (tmp_path / "._img1.png").write_bytes(b"left behind by a file manager")
    assert [path.name for path in images_in(tmp_path)] == ["img1.png", "img2.png", "img10.png"]
    frames = read(tmp_path)
    assert [frame.index for frame in frames] == [0, 1, 2]
    for frame, number in zip(frames, (1, 2, 10), strict=True):
        np.testing.assert_array_equal(frame.image, noise(number))


def test_files_keep_the_order_given(tmp_path: Path) -> None:
    paths = [write(tmp_path / name, noise(index)) for index, name in enumerate(["b.png", "a.png", "c.png"])]
    for index, frame in enumerate(read(*paths)):
        np.testing.assert_array_equal(frame.image, noise(index))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".ppm"])
def test_formats_without_loss(tmp_path: Path, suffix: str) -> None:
    image = noise(1, channels=3)
    np.testing.assert_array_equal(read_image(write(tmp_path / f"a{suffix}", image)), image)


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_formats_with_loss(tmp_path: Path, suffix: str) -> None:
    image = np.full((*SIZE, 3), (200, 100, 50), np.uint8)
    assert np.abs(read_image(write(tmp_path / f"A{suffix.upper()}", image)).astype(int) - image).max() <= 6


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("channels", [1, 3])
def test_sixteen_bits_are_exact(tmp_path: Path, suffix: str, channels: int) -> None:
    image = noise(2, channels, np.uint16)
    found = read_image(write(tmp_path / f"a{suffix}", image))
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_own_png_is_exact(channels: int, depth: type) -> None:
    from deformscope.images import decode_image

    image = noise(3, channels, depth)
    found = decode_image(encode_png(image), "memory")
    assert found.dtype == image.dtype
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize(("mode", "shape"), [("P", (*SIZE, 3)), ("1", SIZE), ("RGBA", (*SIZE, 3)), ("L", SIZE)])
def test_unusual_pngs(tmp_path: Path, mode: str, shape: tuple[int, ...]) -> None:
    image = pytest.importorskip("PIL.Image").fromarray(noise(4, 3)).convert(mode)
    image.save(tmp_path / "a.png")
    found = read_image(tmp_path / "a.png")
    assert found.shape == shape
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, np.asarray(image.convert("RGB" if len(shape) == 3 else "L")))


def test_video_is_stamped_by_its_own_rate(tmp_path: Path) -> None:
    path = video(tmp_path / "v.mp4")
    with open_source([path]) as source:
        assert source.count == 12
        frames = list(source)
    assert len(frames) == 12
    assert [frame.stamp.host_ns for frame in frames[:3]] == [0, 40_000_000, 80_000_000]
    assert frames[0].image.shape == (48, 64, 3)
    red, _, blue = frames[3].image.reshape(-1, 3).mean(axis=0)
    assert red > 150
    assert blue < 80


@pytest.mark.parametrize("kind", ["video", "folder"])
def test_stride(tmp_path: Path, kind: str) -> None:
    path = video(tmp_path / "v.mp4", fps=30) if kind == "video" else folder(tmp_path / "f", 12)
    with open_source([path], stride=5) as source:
        assert source.count == 3
        frames = list(source)
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert [frame.stamp.host_ns for frame in frames] == [0, 166_666_667, 333_333_333]


def test_rate_that_was_asked_for(tmp_path: Path) -> None:
    assert read(folder(tmp_path / "f"), fps=2.0)[2].stamp.host_ns == 1_000_000_000
    assert read(video(tmp_path / "v.mp4"), fps=50)[1].stamp.host_ns == 20_000_000


def test_mask_is_left_out(tmp_path: Path) -> None:
    path = folder(tmp_path / "f")
    mask = write(path / "img0_mask.png", noise(9, 3))
    assert len(read(path, mask=mask)) == 3
    assert len(read(path, mask=path / ".." / "f" / mask.name)) == 3
    assert "odd image" in refusal(path)


def test_frames_are_read_one_at_a_time(tmp_path: Path) -> None:
    path = folder(tmp_path / "f", 6)
    with open_source([path]) as source:
        frames = iter(source)
        next(frames)
        (path / "img4.png").unlink()
        with pytest.raises(InputError, match="no such file"):
            list(frames)


def test_samples() -> None:
    frames = read("sample:tension")
    assert len(frames) == 7
    assert frames[0].image.shape == (335, 415)
    assert "tension" in refusal("sample:nothing")


def test_refuses_what_is_missing(tmp_path: Path) -> None:
    assert str(tmp_path / "gone") in refusal(tmp_path / "gone")
    image = write(tmp_path / "a.png", noise(0))
    assert "nothing there" in refusal(image, tmp_path / "b.png")
    write(tmp_path / "foam.png", noise(0))
    assert f"got nothing there | try: {tmp_path / 'foam.png'} | " in refusal(tmp_path / "fomm.png")
    assert f"try: {tmp_path / 'foam.png'} | " in refusal(image, tmp_path / "fomm.png")
    assert f"try: another name; none in {tmp_path} is like it | " in refusal(tmp_path / "elephant.mp4")
    assert "try: sample:video | " in refusal(tmp_path / "video")
    assert f"try: another folder; {tmp_path / 'gone'}: no such file or directory | " in refusal(tmp_path / "gone" / "a")
    refusal()


def test_refuses_text_that_is_called_a_video(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes.mp4"
    path.write_text("this is no video\n" * 50)
    assert "a video that FFmpeg can read" in refusal(path)
    (tmp_path / "empty.mp4").touch()
    assert "an empty file" in refusal(tmp_path / "empty.mp4")
    whole = video(tmp_path / "v.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    refusal(tmp_path / "cut.mp4")
    assert capfd.readouterr().err == ""


def test_refuses_folders_without_frames(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    refusal(tmp_path / "empty")
    path = folder(tmp_path / "f", 1)
    assert "at least two frames" in refusal(path)
    assert "the mask alone" in refusal(path, mask=path / "img1.png")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp"])
@pytest.mark.parametrize("keep", [0.0, 0.05, 0.5, 0.97])
def test_refuses_a_cut_image(tmp_path: Path, suffix: str, keep: float, capfd: pytest.CaptureFixture[str]) -> None:
    for index in range(4):
        write(tmp_path / f"img{index}{suffix}", noise(index, 3))
    cut = tmp_path / f"img2{suffix}"
    whole = cut.read_bytes()
    cut.write_bytes(whole[: int(len(whole) * keep)])
    assert str(cut) in refusal(tmp_path)
    assert capfd.readouterr().err == ""


def test_refuses_a_flipped_png(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = folder(tmp_path / "f")
    encoded = bytearray((path / "img2.png").read_bytes())
    encoded[len(encoded) // 2] ^= 4
    (path / "img2.png").write_bytes(encoded)
    assert "damaged" in refusal(path)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("odd", [noise(1)[:-1], noise(1, 3), noise(1, 1, np.uint16)], ids=["size", "channels", "depth"])
@pytest.mark.parametrize("place", [2, 3])
def test_refuses_unequal_frames(tmp_path: Path, odd: np.ndarray, place: int) -> None:
    path = folder(tmp_path / "f", 4)
    write(path / f"img{place}.png", odd)
    message = refusal(path)
    assert "one size, depth and channel count" in message
    assert str(path / f"img{place}.png") in message


def test_refuses_few_frames(tmp_path: Path) -> None:
    path = folder(tmp_path / "f")
    assert "one image" in refusal(path / "img1.png")
    assert "stride" in refusal(path, stride=3)
    assert "at least two frames" in refusal(video(tmp_path / "v.mp4", 1))
    assert "at least two frames" in refusal(video(tmp_path / "w.mp4", 5), stride=9)


def test_refuses_mixed_sources(tmp_path: Path) -> None:
    path = folder(tmp_path / "f")
    assert "a folder" in refusal(path, path)
    assert ".mp4" in refusal(video(tmp_path / "v.mp4"), path / "img1.png")


def test_refuses_odd_numbers(tmp_path: Path) -> None:
    path = folder(tmp_path / "f")
    for options in ({"stride": 0}, {"fps": 0.0}, {"fps": float("nan")}, {"fps": -3.0}):
        refusal(path, **options)


def test_refuses_floating_point_images(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.tif"), np.zeros(SIZE, np.float32))
    with pytest.raises(InputError, match="8 or 16 bits"):
        read_image(tmp_path / "a.tif")


def test_a_colour_profile_is_no_reason_to_complain(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pil = pytest.importorskip("PIL.Image")
    encoded = io.BytesIO()
    pil.fromarray(noise(1, 3)).save(encoded, "PNG", icc_profile=b"not a profile" * 20)
    (tmp_path / "a.png").write_bytes(encoded.getvalue())
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), noise(1, 3))
    assert capfd.readouterr().err == ""
