"""The RealSense driver on a double of the library: no camera was ever tried."""

import itertools
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deformscope_drivers.depth_camera import Realsense, RealsenseConfig
from deformscope_drivers.device import Reconnect
from deformscope_drivers.errors import Busy, DeviceError, LibraryMissing, LinkLost, NotConnected, SettingsRefused, Stale
from deformscope_drivers.health import Link
from deformscope_drivers.realsense import camera as reading
from deformscope_drivers.realsense import double
from deformscope_drivers.realsense.camera import RealsenseCamera, RealsenseSettings
from deformscope_drivers.realsense.double import CAMERAS_FILE, CLOCK_ROUND_US, DoubleCamera, plug
from tests.drivers.contract import Bench, DeviceContract, wait_until

QUICK = Reconnect(0.01, 0.1)
DOUBLE = "deformscope_drivers.realsense.double"
ONE = DoubleCamera()
SMALL = RealsenseConfig(serial=ONE.serial, width=64, height=48, fps=100, warm_up_s=0.0, silence_s=60.0)
PATIENCE_S = 60.0


@pytest.fixture
def cameras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Plugs these cameras in, and no others."""
    file = tmp_path / "cameras.json"
    monkeypatch.setenv(CAMERAS_FILE, str(file))
    plug(file, ONE)
    return lambda *there: plug(file, *there)


def opened(config: RealsenseConfig = SMALL) -> Realsense:
    return Realsense(config, reconnect=QUICK, library=DOUBLE)


class TestRealsense(DeviceContract):
    @pytest.fixture
    def bench(self, cameras: Callable[..., None]) -> Bench:
        return Bench(
            opened(),
            unplug=cameras,
            plug=lambda: cameras(ONE),
            pause=lambda: cameras(replace(ONE, silent=True)),
            resume=lambda: cameras(ONE),
            another=opened,
        )


def test_depth_is_in_metres_whatever_its_unit(cameras: Callable[..., None]) -> None:
    """A wall at 0.6 m; a D435's 427.7 px at 848 px of width are 32.3 at 64."""
    with opened(replace(SMALL, unit_m=0.0001, preset="high_accuracy")) as camera:
        picture = camera.next(PATIENCE_S)
    assert picture.unit_m == 0.0001
    assert picture.depth.dtype == np.uint16
    assert abs(np.median(picture.depth) - 6000) < 5
    assert np.median(picture.depth_m()) == pytest.approx(0.6, abs=5e-4)
    assert picture.intrinsics.fx_px == pytest.approx(427.7 * 64 / 848, rel=1e-3)
    assert (picture.intrinsics.cx_px, picture.intrinsics.cy_px) == (30.4, 17.8)
    assert picture.intrinsics.distortion == ()
    assert camera.identity().serial == ONE.serial


def test_pictures_that_got_lost_are_counted_by_the_cameras_number(cameras: Callable[..., None]) -> None:
    with opened() as camera:
        camera.next(PATIENCE_S)
        before = camera.health().lost
        cameras(replace(ONE, lost=1000))
        wait_until(lambda: camera.health().lost - before >= 1000)


def test_a_frozen_picture_is_reported(cameras: Callable[..., None]) -> None:
    with opened(replace(SMALL, stuck_after_s=0.1)) as camera:
        camera.next(PATIENCE_S)
        assert not camera.health().stuck
        cameras(replace(ONE, frozen=True))
        wait_until(lambda: camera.health().stuck)
        with pytest.raises(Stale, match="readings that change"):
            camera.latest(PATIENCE_S)


@pytest.mark.parametrize(
    ("trouble", "reason"),
    [
        ({"hung": True}, "expected a picture; got none for"),
        ({"drifting_unit_m": 0.0001}, "expected depth in steps of 0.001 m; got of 0.0001 m"),
    ],
)
def test_what_goes_wrong_while_it_streams_is_a_lost_link(
    trouble: dict[str, object], reason: str, cameras: Callable[..., None]
) -> None:
    with opened(replace(SMALL, silence_s=0.5)) as camera:
        events = camera.events()
        camera.next(PATIENCE_S)
        cameras(replace(ONE, **trouble))
        lost = events.get(PATIENCE_S)
        cameras(ONE)
        camera.next(PATIENCE_S)
    assert lost.link is Link.LOST
    assert reason in lost.reason


def test_an_unplugged_camera_is_reported_as_one(cameras: Callable[..., None]) -> None:
    with opened() as camera:
        events = camera.events()
        camera.next(PATIENCE_S)
        cameras()
        assert "none (unplugged?) | try: check the cable" in events.get(PATIENCE_S).reason


def test_what_it_complains_of_is_a_remark(cameras: Callable[..., None]) -> None:
    cameras(replace(ONE, usb="2.1", notes=("Out of IR range",), firmware="5.12.7.100", metadata=False))
    with opened(replace(SMALL, fps=6)) as camera:
        wait_until(lambda: len(camera.remarks()) == 4)
        remarks = camera.remarks()
    assert [words.split(":")[0] for words in remarks] == [
        "it is on USB 2.1",
        "no time stamps of its own",
        "firmware 5.12.7.100, and 5.16.0.1 is recommended",
        "it reports",
    ]


def test_without_the_library_it_says_what_to_install() -> None:
    camera = Realsense(SMALL, library="no_such_library")
    with pytest.raises(LibraryMissing, match=r"expected pyrealsense2; .* try: pip install deformscope\[realsense\]"):
        camera.open()


@pytest.fixture
def here(cameras: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """The double in this process."""
    monkeypatch.setattr(double, "_world", double._World())
    monkeypatch.setattr(reading, "FIRST_FRAME_S", 0.2)
    yield cameras
    for lock in double._world._locks:
        os.close(lock)


ASKED = RealsenseSettings(width=64, height=48, fps=100, warm_up_s=0.0)


@pytest.mark.parametrize(
    ("there", "asked", "kind", "words"),
    [
        ((), {}, NotConnected, ["a RealSense camera; got none", "udev rules"]),
        ((ONE,), {"serial": "1"}, NotConnected, [f"RealSense camera 1; got {ONE.serial}", "deformscope devices"]),
        ((ONE, replace(ONE, serial="2")), {}, NotConnected, ["one of several", f"try: {ONE.serial}, 2"]),
        ((replace(ONE, busy="failed to set power state"),), {}, Busy, ["realsense-viewer", ONE.serial]),
        ((replace(ONE, busy="... errno=16 Last Error: Device or resource busy"),), {}, Busy, ["no other program"]),
        (
            (replace(ONE, busy="failed to open usb interface: 0, error: RS2_USB_STATUS_ACCESS"),),
            {},
            NotConnected,
            ["udev"],
        ),
        ((replace(ONE, hidden="failed to open usb interface: 0, error: RS2_USB_STATUS_BUSY"),), {}, Busy, ["ROS node"]),
        ((replace(ONE, busy="something else"),), {}, NotConnected, ["something else"]),
        (
            (replace(ONE, usb="2.1"),),
            {"width": 848, "height": 480, "fps": 30},
            SettingsRefused,
            ["848x480 at 30 Hz; got a camera on USB 2.1", "a USB 3 port and cable, or one of", "480x270 at 15 Hz"],
        ),
        ((ONE,), {"fps": 300}, SettingsRefused, ["64x48 at 300 Hz", "try: one of 1280x720 at 30 Hz"]),
        ((replace(ONE, deaf=True),), {"preset": "hand"}, SettingsRefused, ["preset hand; got 1"]),
        ((replace(ONE, deaf=True),), {"unit_m": 0.0001}, SettingsRefused, ["steps of 0.0001 m; got 0.001"]),
        ((replace(ONE, silent=True),), {}, NotConnected, ["pictures within 0.2 s; got none", "USB 3 port"]),
    ],
)
def test_what_cannot_be_opened_says_what_to_do(
    there: tuple[DoubleCamera, ...],
    asked: dict[str, object],
    kind: type[DeviceError],
    words: list[str],
    here: Callable[..., None],
) -> None:
    here(*there)
    with pytest.raises(DeviceError) as caught:
        RealsenseCamera(replace(ASKED, **asked), double)
    assert type(caught.value) is kind
    for part in words:
        assert part in str(caught.value)


def taken(camera: RealsenseCamera, count: int) -> list[reading.FrameMessage]:
    return list(itertools.islice(filter(None, iter(lambda: camera.next(1.0), 0)), count))


@pytest.mark.parametrize("unit_m", [0.00005, 0.0003, 0.00029, 0.001])
def test_a_unit_that_the_camera_rounds_is_taken_as_it_has_it(unit_m: float, here: Callable[..., None]) -> None:
    """It stores whole micrometres, cut off."""
    camera = RealsenseCamera(replace(ASKED, unit_m=unit_m), double)
    assert camera.words()["unit_m"] == pytest.approx(unit_m, abs=1.01e-6)
    (frame,) = taken(camera, 1)
    assert np.median(np.frombuffer(frame.depth, np.uint16)) * camera.words()["unit_m"] == pytest.approx(0.6, abs=1e-3)


def test_colour_of_the_same_moment_comes_with_depth_on_its_pixels(here: Callable[..., None]) -> None:
    """With the colour camera's lens, whose distortion librealsense projects with."""
    here(replace(ONE, lens=(-0.0565, 0.0682, 0.0004, 0.0007, -0.0218)))
    camera = RealsenseCamera(replace(ASKED, color=True), double)
    (frame,) = taken(camera, 1)
    assert camera.words()["distortion"] == (-0.0565, 0.0682, 0.0004, 0.0007, -0.0218)
    assert (frame.color_width, frame.color_height) == (64, 48)
    assert tuple(frame.color[:3]) == (frame.index % 256, 100, 200)


def test_colour_of_another_moment_is_none(here: Callable[..., None]) -> None:
    here(replace(ONE, color_late_ms=5.1))  # half a period is 5 ms
    assert taken(RealsenseCamera(replace(ASKED, color=True), double), 1)[0].color == b""


def test_a_picture_that_the_library_hands_out_twice_comes_once(here: Callable[..., None]) -> None:
    here(replace(ONE, repeating=True))
    numbers = [frame.index for frame in taken(RealsenseCamera(replace(ASKED, color=True), double), 5)]
    assert len(set(numbers)) == 5


def test_stamps_on_the_hosts_clock_where_they_are_asked_for(here: Callable[..., None]) -> None:
    here(replace(ONE, clock_us=10**15))
    assert taken(RealsenseCamera(replace(ASKED, global_time=True), double), 1)[0].timestamp_us > 10**15


def test_a_clock_that_begins_anew_goes_on(here: Callable[..., None]) -> None:
    """After 2^32 us: the camera's stamps are in milliseconds."""
    camera = RealsenseCamera(ASKED, double)
    first_us = CLOCK_ROUND_US - 25_000
    seen = []
    for index in range(6):
        ms = (first_us + 10_000 * index) % CLOCK_ROUND_US / 1e3
        frame = double.frame(b"", (0, 0), index, ms, double.timestamp_domain.hardware_clock)
        seen.append(camera._timestamp_us(frame, 10_000_000 * index))
    assert list(np.diff(seen)) == [10_000] * 5


def test_a_host_that_stamps_in_the_cameras_place_gives_no_camera_time(here: Callable[..., None]) -> None:
    here(replace(ONE, metadata=False))
    assert taken(RealsenseCamera(ASKED, double), 1)[0].timestamp_us == reading.NO_TIME_US


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"preset": "best"}, "a preset (custom, default, hand"),
        ({"warm_up_s": -1.0}, "a warm_up_s of 0 to 10"),
        ({"width": 0}, "of 1 or more"),
    ],
)
def test_what_a_rig_file_cannot_ask_for_is_refused(keys: dict[str, object], words: str) -> None:
    with pytest.raises(SettingsRefused) as caught:
        RealsenseConfig(**keys)
    assert words in str(caught.value)


@pytest.mark.hardware
@pytest.mark.parametrize("color", [False, True])
def test_on_a_camera(color: bool) -> None:
    """The only camera of this machine, on USB 3."""
    with Realsense(RealsenseConfig(color=color)) as camera:
        pictures = [camera.next(5.0) for _ in range(60)]
    assert {picture.depth.shape for picture in pictures} == {(480, 848)}
    assert np.mean([(picture.depth > 0).mean() for picture in pictures]) > 0.1
    assert camera.remarks() == ()


def test_lost_links_are_sought_by_the_same_serial(cameras: Callable[..., None]) -> None:
    """Another camera in its place is not taken for it."""
    with opened() as camera:
        camera.next(PATIENCE_S)
        cameras(replace(ONE, serial="2"))
        wait_until(lambda: f"RealSense camera {ONE.serial}; got 2" in camera.health().reason)
        with pytest.raises((Stale, LinkLost)):
            camera.next(0.01)
