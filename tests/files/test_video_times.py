"""The frames of a video come with the times that the file has for them, whatever its rate does."""

import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.files.sources import Source, open_source
from tests.films import film, pictures

SLOWS_MS = [*range(0, 200, 20), *range(200, 800, 60), 817, 833, 1400]
"""As of a phone that slows in dim light, and then some of its own."""


def with_times_at_a_stop(path: Path) -> Path:
    """The MP4, all of whose frames are taken at once, by its own table."""
    raw = bytearray(path.read_bytes())
    at = raw.find(b"stts")
    (count,) = struct.unpack_from(">I", raw, at + 8)
    for entry in range(count):
        struct.pack_into(">I", raw, at + 16 + 8 * entry, 0)
    path.write_bytes(raw)
    return path


def trimmed(path: Path, from_ms: int) -> Path:
    """The MP4, of which its edit list shows what follows a time."""
    raw = bytearray(path.read_bytes())
    at = raw.find(b"elst")
    header = raw.find(b"mdhd")
    (ticks_hz,) = struct.unpack_from(">I", raw, header + 16)
    (shown,) = struct.unpack_from(">I", raw, at + 12)
    struct.pack_into(">Ii", raw, at + 12, shown - from_ms, round(from_ms * ticks_hz / 1000))
    path.write_bytes(raw)
    return path


def times_ms(source: Source) -> list[float]:
    with source:
        return [frame.stamp.host_ns / 1e6 for frame in source]


@pytest.mark.parametrize(
    ("name", "fourcc"), [("a.mp4", "vp09"), ("a.mov", "MJPG"), ("a.mkv", "mp4v"), ("a.avi", "MJPG"), ("a.webm", "VP80")]
)
@pytest.mark.parametrize("late_ms", [0, 5000])
def test_frames_have_the_times_of_the_file(tmp_path: Path, name: str, fourcc: str, late_ms: int) -> None:
    if late_ms and name == "a.avi":
        pytest.skip("an AVI has no time before its first frame")
    path = film(tmp_path / name, [late_ms + time for time in SLOWS_MS], fourcc)
    source = open_source([path], timed=True)
    np.testing.assert_allclose(times_ms(source), SLOWS_MS, atol=1.01)  # Matroska rounds to a millisecond
    assert source.timed
    assert source.problems() == []
    np.testing.assert_allclose(times_ms(open_source([path], stride=4)), SLOWS_MS[::4], atol=1.01)


def test_a_rate_that_is_given_goes_before_the_file_s_times(tmp_path: Path) -> None:
    path = film(tmp_path / "a.mp4", SLOWS_MS)
    np.testing.assert_allclose(times_ms(open_source([path], fps=50.0)), 20.0 * np.arange(len(SLOWS_MS)))


def test_a_trimmed_video_begins_at_0_with_what_it_shows(tmp_path: Path) -> None:
    path = trimmed(film(tmp_path / "a.mov", SLOWS_MS, "MJPG"), 200)
    shown = [time - 200 for time in SLOWS_MS if time >= 200]
    np.testing.assert_allclose(times_ms(open_source([path])), shown, atol=1.01)


@pytest.mark.parametrize(("name", "fourcc"), [("a.mkv", "mp4v"), ("a.avi", "MJPG"), ("a.mov", "MJPG")])
def test_frames_are_spread_over_those_that_there_are(tmp_path: Path, name: str, fourcc: str) -> None:
    """A container counts 1.4 s of an even rate, or the frames that are cut away."""
    path = film(tmp_path / name, SLOWS_MS, fourcc)
    expected = SLOWS_MS
    if name == "a.mov":
        trimmed(path, 200)
        expected = [time - 200 for time in SLOWS_MS if time >= 200]
    with open_source([path]) as source:
        assert source.thin(6) == len(expected)
        assert source.count == 6
        found = [frame.stamp.host_ns / 1e6 for frame in source]
    assert len(found) == 6
    np.testing.assert_allclose([found[0], found[-1]], [0, expected[-1]], atol=1.01)
    with open_source([path], stride=2) as source:
        source.thin(len(SLOWS_MS))
        np.testing.assert_allclose([frame.stamp.host_ns / 1e6 for frame in source], expected[::2], atol=1.01)


def test_times_that_do_not_rise_are_refused_where_time_matters(tmp_path: Path) -> None:
    path = with_times_at_a_stop(film(tmp_path / "a.mp4", SLOWS_MS))
    with pytest.raises(InputError, match=r"a video whose frames' times rise.*--fps RATE"):
        times_ms(open_source([path], timed=True))
    source = open_source([path])
    assert not source.timed
    assert (np.diff(times_ms(source)) > 0.0).all()
    given = times_ms(open_source([path], timed=True, fps=10.0))
    np.testing.assert_allclose(given, 100.0 * np.arange(len(given)))


def animation(path: Path, durations_ms: Sequence[int]) -> Path:
    moving = cv2.Animation()
    moving.frames = [np.dstack([one, np.full(one.shape[:2], 255, np.uint8)]) for one in pictures(len(durations_ms))]
    moving.durations = list(durations_ms)
    assert cv2.imwriteanimation(str(path), moving)
    return path


@pytest.mark.parametrize("name", ["a.gif", "a.png"])
def test_an_animation_is_a_video_with_its_own_delays(tmp_path: Path, name: str) -> None:
    path = animation(tmp_path / name, [*[100] * 20, 1000, 50, 100])
    source = open_source([path], timed=True)
    expected = np.cumsum([0, *[100] * 20, 1000, 50])
    np.testing.assert_allclose(times_ms(source), expected, atol=1e-3)
    assert source.problems() == []


def test_animations_where_one_image_is_meant_are_refused(tmp_path: Path) -> None:
    paths = [animation(tmp_path / f"{number}.gif", [100, 100]) for number in range(2)]
    for given in (paths, [tmp_path]):
        with pytest.raises(InputError, match=r"got an animation .*an animated GIF alone"):
            open_source(given)
    still = [animation(tmp_path / f"{number}.gif", [100]) for number in range(2)]
    assert times_ms(open_source(still)) == pytest.approx([0.0, 1000 / 30])
