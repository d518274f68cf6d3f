"""Damaged videos are noticed by what their container lists and by times; whole ones, of any rate, pass."""

import json
import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.files.sources import open_source
from deformscope.files.video_check import VideoCheck

COUNT = 40


def textured() -> np.ndarray:
    noise = np.random.default_rng(0).integers(0, 255, (96, 128, 3), np.uint8)
    return np.asarray(cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX))


def write_video(path: Path, fourcc: str) -> bytes:
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*fourcc), 30.0, (128, 96))
    assert writer.isOpened(), path
    image = textured()
    for index in range(COUNT):
        writer.write(np.roll(image, index, axis=1))
    writer.release()
    return path.read_bytes()


def problems(path: Path, stride: int = 1) -> tuple[int, list[str]]:
    with open_source([path], stride=stride) as source:
        return sum(1 for _ in source), source.problems()


@pytest.mark.parametrize("fourcc", ["MJPG", "XVID"])
@pytest.mark.parametrize("stride", [1, 3])
def test_frames_that_an_avi_lists_and_does_not_give(tmp_path: Path, fourcc: str, stride: int) -> None:
    path = tmp_path / "v.avi"
    whole = write_video(path, fourcc)
    assert problems(path, stride) == (-(-COUNT // stride), [])
    path.write_bytes(whole[: round(0.6 * len(whole))])
    count, found = problems(path)
    assert count < COUNT
    assert found == [f"the container lists {COUNT} frames, {count} could be read"]


@pytest.mark.parametrize(("fourcc", "suffix"), [("mp4v", "mkv"), ("VP80", "webm"), ("mp4v", "ts")])
def test_a_hole_is_a_gap_in_the_times(tmp_path: Path, fourcc: str, suffix: str) -> None:
    path = tmp_path / f"v.{suffix}"
    whole = bytearray(write_video(path, fourcc))
    assert problems(path) == (COUNT, [])
    start, end = round(0.4 * len(whole)), round(0.6 * len(whole))
    whole[start:end] = bytes(end - start)
    path.write_bytes(whole)
    count, found = problems(path)
    assert any(f"{COUNT - count} frames are missing after 0." in line for line in found), (count, found)


def test_one_damaged_frame_does_not_end_a_video(tmp_path: Path) -> None:
    path = tmp_path / "v.mkv"
    whole = bytearray(write_video(path, "MJPG"))
    start = round(0.5 * len(whole))
    whole[start : start + 2000] = bytes(2000)
    path.write_bytes(whole)
    count, found = problems(path)
    assert COUNT - 3 < count < COUNT
    assert any("could not be decoded" in line for line in found)


def test_a_cut_matroska_is_shorter_than_it_says(tmp_path: Path) -> None:
    path = tmp_path / "v.mkv"
    whole = write_video(path, "mp4v")
    path.write_bytes(whole[: round(0.6 * len(whole))])
    _, found = problems(path)
    assert len(found) == 1
    assert found[0].startswith("its stated duration is 1.33 s")
    # With sound beside it, the duration may be that of the sound.
    path.write_bytes(path.read_bytes().replace(b"\x86\x8fV_MPEG4/ISO/ASP", b"\x86\x8fA_MPEG4/ISO/ASP"))
    check = VideoCheck(path, COUNT, 30.0)
    for index in range(20):
        check.read(index / 30)
    assert check.problems() == []


def box(kind: bytes, content: bytes = b"", length: int | None = None) -> bytes:
    return struct.pack(">I4s", 8 + len(content) if length is None else length, kind) + content


def movie(*, shown: int | None = None, fragments: bool = False, cut: bool = False) -> bytes:
    """An MP4's boxes. shown: edited to so many of its ticks of 1/600 s"""
    handler = box(b"mdia", box(b"hdlr", bytes(8) + b"vide"))
    edit = b"" if shown is None else box(b"edts", box(b"elst", struct.pack(">IIIiI", 0, 1, shown, 0, 0)))
    inner = box(b"mvhd", bytes(12) + struct.pack(">II", 600, 1200)) + box(b"trak", edit + handler)
    moov = box(b"moov", inner + (box(b"mvex") if fragments else b""))
    return box(b"ftyp", b"isom") + moov + box(b"mdat", bytes(100), 5000 if cut else None)


def checked(path: Path, claimed: float, times_s: Sequence[float]) -> list[str]:
    check = VideoCheck(path, claimed, 30.0)
    for time_s in times_s:
        check.read(time_s)
    check.fail()
    return check.problems()


EVEN = [index / 30 for index in range(60)]


@pytest.mark.parametrize(
    ("content", "claimed", "times_s", "said"),
    [
        (movie(), 60, EVEN, ""),
        (movie(), 60, EVEN[:36], "lists 60 frames, 36"),
        (movie(), 60, EVEN[:20] + EVEN[33:], "13 frames are missing after 0.633 s"),
        (movie(shown=1200), 60, EVEN[:36], "lists 60 frames, 36"),
        (movie(shown=720), 60, EVEN[:36], ""),  # trimmed in a phone to 1.2 s
        (movie(fragments=True), 75, EVEN, ""),  # the count is an estimate
        (movie(cut=True), 60, EVEN, "the file is truncated"),
        (movie(), 60, list(np.cumsum([1 / 30, 1 / 15, 1 / 10] * 20)), ""),  # a rate that varies
        (movie(), 60, EVEN[:30] + [time_s + 0.5 for time_s in EVEN[30:]], ""),  # a pause that the container knows of
        (b"\x1a\x45\xdf\xa3", 90, list(np.cumsum([0.02, 0.05, 0.09] * 20)), ""),  # a screen, filmed as it changes
        (b"\x1a\x45\xdf\xa3\x86\x86A_OPUS", 90, EVEN, ""),  # the sound goes on
        (b"\x1a\x45\xdf\xa3", 0, EVEN, ""),
        (b"\x1a\x45\xdf\xa3", -9e18, [round(time_s, 3) for time_s in EVEN], ""),
        (b"G", float("nan"), [0.0] * 60, ""),  # no times at all
        (b"", 60, [], ""),
    ],
)
def test_what_is_called_damaged(
    tmp_path: Path, content: bytes, claimed: float, times_s: list[float], said: str
) -> None:
    path = tmp_path / "v"
    path.write_bytes(content)
    found = "; ".join(checked(path, claimed, times_s))
    assert (said in found) if said else found == ""


def test_calibrate_names_the_damage_and_exits_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, told = tmp_path / "v.avi", tmp_path / "found.json"
    whole = write_video(path, "MJPG")
    flags = ["--grid", "4x5", "--held", "top,bottom", "--viewer", "none", "--json", str(told)]
    path.write_bytes(whole[: round(0.6 * len(whole))])
    assert main(["calibrate", "beta", str(path), *flags]) == 3
    said = capsys.readouterr()
    (line,) = json.loads(told.read_text())["source_problems"]
    assert line.startswith(f"the container lists {COUNT} frames")
    assert line in said.out
    assert "is damaged: " in said.err
