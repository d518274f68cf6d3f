"""OpenNI2's depth cameras, on its own dummy and on recordings written here: no camera was ever tried."""

import contextlib
import itertools
import os
import random
import signal
from pathlib import Path

import numpy as np
import pytest

from deformscope_drivers.depth_camera import DepthCamera, DepthCameraConfig, Intrinsics
from deformscope_drivers.device import Reconnect
from deformscope_drivers.errors import DeviceError, LibraryMissing, LinkLost, NotConnected, SettingsRefused
from deformscope_drivers.health import Link
from deformscope_drivers.openni.library import load
from tests.drivers.contract import Bench, DeviceContract, nothing_left_since, open_things, wait_until
from tests.drivers.openni.oni_file import write_oni

QUICK = Reconnect(0.01, 0.1)
COUNT = 12


@pytest.fixture(scope="module", autouse=True)
def library() -> None:
    try:
        load()  # loading starts nothing
    except LibraryMissing as error:
        pytest.skip(str(error))


def depths(count: int = COUNT, shape: tuple[int, int] = (12, 16)) -> list[np.ndarray]:
    return [np.full(shape, 500 + index, np.uint16) for index in range(count)]


def colors(count: int = COUNT) -> list[np.ndarray]:
    return [np.full((12, 16, 3), (index, 100, 200), np.uint8) for index in range(count)]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "walk.oni"
    write_oni(path, depths())
    return path


class TestDummy(DeviceContract):
    @pytest.fixture
    def bench(self) -> Bench:
        return Bench(DepthCamera(DepthCameraConfig(port="Dummy"), reconnect=QUICK))


class TestRecording(DeviceContract):
    @pytest.fixture
    def bench(self, recording: Path) -> Bench:
        return Bench(DepthCamera(DepthCameraConfig(port=str(recording), speed=10.0, loop=True)))


def test_the_dummys_pictures_are_as_they_are_known() -> None:
    """320 x 240 at 30 Hz; the first row 2000 mm, a disc that moves, the rest nothing; 33 ms between timestamps."""
    with DepthCamera(DepthCameraConfig(port="Dummy", width=320, height=240, fps=30, unit_m=0.001)) as camera:
        pictures = camera.readings()
        first, second = pictures.get(5.0), pictures.get(5.0)
    assert camera.model == "Table Tennis"
    assert first.depth.shape == (240, 320)
    assert first.depth.dtype == np.uint16
    assert (first.depth[0] == 2000).all()
    assert first.depth_m()[0, 0] == pytest.approx(2.0)
    assert np.isnan(first.depth_m()[239, 0])
    assert second.stamp.device_ticks - first.stamp.device_ticks == 33_000
    assert first.intrinsics is None
    assert first.color is None


@pytest.mark.parametrize(
    ("config", "asked", "came"),
    [
        (DepthCameraConfig(port="Dummy", width=640, height=480), "depth 640x480 at 30 Hz", "320x240 at 30 Hz"),
        (DepthCameraConfig(port="Dummy", fps=60), "depth 320x240 at 60 Hz", "320x240 at 30 Hz"),
        (DepthCameraConfig(port="Dummy", unit_m=1e-4), "in DEPTH_100_UM", "in DEPTH_1_MM"),
        (DepthCameraConfig(port="Dummy", unit_m=1.0), "in format 0", "in DEPTH_1_MM"),
        (DepthCameraConfig(port="Dummy", mirror=True), "mirror True", "mirror None"),
        (DepthCameraConfig(port="Dummy", color=True), "depth registered to colour", "a camera that does not"),
    ],
)
def test_what_the_camera_does_not_do_is_refused(config: DepthCameraConfig, asked: str, came: str) -> None:
    before = open_things()
    with pytest.raises(SettingsRefused) as caught:
        DepthCamera(config).open()
    assert asked in str(caught.value)
    assert came in str(caught.value)
    assert str(caught.value).endswith("Dummy")
    wait_until(lambda: nothing_left_since(before))


@pytest.mark.parametrize("port", ["nobody", ""])
def test_a_camera_that_is_not_there_is_reported(port: str) -> None:
    with pytest.raises(NotConnected, match="expected a depth camera"):
        DepthCamera(DepthCameraConfig(port=port)).open()


def test_a_library_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(LibraryMissing, match=r"expected OpenNI2; got none that loads \| try: .*libopenni2-0"):
        DepthCamera(DepthCameraConfig(port="Dummy", library=str(tmp_path))).open()


def test_a_library_can_be_named_by_the_folder_it_was_linked_into(tmp_path: Path) -> None:
    """As the vendors' own archives have it: libOpenNI2.so, with its drivers beside it."""
    found = next(Path("/usr/lib").glob("*/libOpenNI2.so.0"), None)
    if found is None:
        pytest.skip("the library lies elsewhere")
    (tmp_path / "libOpenNI2.so").symlink_to(found)
    (tmp_path / "OpenNI2").symlink_to(found.parent / "OpenNI2")
    with DepthCamera(DepthCameraConfig(port="Dummy", library=str(tmp_path))) as camera:
        camera.next(5.0)


def process_of(camera: DepthCamera) -> int:
    assert camera.process_id is not None
    return camera.process_id


def test_a_crash_of_the_library_is_a_lost_link_that_is_made_again() -> None:
    with DepthCamera(DepthCameraConfig(port="Dummy"), reconnect=QUICK) as camera:
        events = camera.events()
        camera.next(5.0)
        os.kill(process_of(camera), signal.SIGSEGV)
        lost = events.get(5.0)
        camera.next(10.0)
        assert lost.link is Link.LOST
        assert f"its end (exit status {-signal.SIGSEGV})" in lost.reason
        assert camera.health().reconnects == 1


def test_a_library_that_hangs_is_a_lost_link_that_is_made_again() -> None:
    config = DepthCameraConfig(port="Dummy", silence_s=0.3)
    with DepthCamera(config, reconnect=QUICK) as camera:
        events = camera.events()
        camera.next(5.0)
        hung = process_of(camera)
        os.kill(hung, signal.SIGSTOP)
        lost = events.get(5.0)
        camera.next(10.0)
        assert lost.link is Link.LOST
        assert "expected a picture; got none for 0.3" in lost.reason
        assert process_of(camera) != hung
        with pytest.raises(ProcessLookupError):
            os.kill(hung, 0)


def test_without_reconnection_a_crash_ends_the_session() -> None:
    with DepthCamera(DepthCameraConfig(port="Dummy"), reconnect=None) as camera:
        pictures = camera.readings()
        camera.next(5.0)
        os.kill(process_of(camera), signal.SIGKILL)
        with pytest.raises(LinkLost):
            for _ in pictures:
                pass


def test_a_camera_that_is_closed_leaves_no_process() -> None:
    before = open_things()
    with DepthCamera(DepthCameraConfig(port="Dummy")) as camera:
        camera.next(5.0)
        process = process_of(camera)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    wait_until(lambda: nothing_left_since(before))


def test_every_frame_of_a_recording_comes_once_and_then_the_end(tmp_path: Path) -> None:
    path = tmp_path / "long.oni"
    times = write_oni(path, depths(100))
    with DepthCamera(DepthCameraConfig(port=str(path), speed=0.0)) as camera:
        seen = [(picture.stamp.device_ticks, int(picture.depth[5, 5])) for picture in camera]
        assert seen == [(at, 500 + index) for index, at in enumerate(times)]
        wait_until(lambda: camera.link is Link.CLOSED)
        assert camera.health().reason == "the end of long.oni"
        assert camera.health().lost == 0


def test_next_goes_on_frame_by_frame(recording: Path) -> None:
    with DepthCamera(DepthCameraConfig(port=str(recording), speed=0.0)) as camera:
        assert [int(camera.next(5.0).depth[0, 0]) for _ in range(3)] == [500, 501, 502]


def test_a_loop_begins_again_and_its_times_go_on(recording: Path) -> None:
    with DepthCamera(DepthCameraConfig(port=str(recording), speed=0.0, loop=True)) as camera:
        pictures = camera.readings()
        seen = [pictures.get(5.0) for _ in range(30)]
        assert [int(picture.depth[0, 0]) - 500 for picture in seen] == [index % COUNT for index in range(30)]
        ticks = [picture.stamp.device_ticks for picture in seen]
        assert all(32_000 < later - earlier < 35_000 for earlier, later in itertools.pairwise(ticks))
        assert camera.health().lost == 0


def test_frames_that_are_missing_are_counted(tmp_path: Path) -> None:
    """By the recording's own frame numbers."""
    path = tmp_path / "gaps.oni"
    write_oni(path, depths(10), skip={3, 4, 7})
    with DepthCamera(DepthCameraConfig(port=str(path), speed=0.0)) as camera:
        assert [int(picture.depth[0, 0]) - 500 for picture in camera] == [0, 1, 2, 5, 6, 8, 9]
        assert camera.health().lost == 3


def test_colour_of_the_same_moment_comes_with_depth(tmp_path: Path) -> None:
    """One colour frame is a period late, and belongs to no depth frame; the others are 5 ms behind or ahead."""
    path = tmp_path / "color.oni"
    delays = [5_000, -5_000] * (COUNT // 2)
    delays[4] = 17_000
    write_oni(path, depths(), colors=colors(), color_delays_us=delays)
    with DepthCamera(DepthCameraConfig(port=str(path), speed=0.0, color=True)) as camera:
        seen = list(camera)
    assert [int(picture.depth[0, 0]) - 500 for picture in seen] == list(range(COUNT))
    without = [index for index, picture in enumerate(seen) if picture.color is None]
    assert without == [4]
    for index, picture in enumerate(seen):
        if picture.color is not None:
            assert picture.color[0, 0].tolist() == [index, 100, 200]
            assert picture.color.shape == (12, 16, 3)


def test_intrinsics_come_from_the_field_of_view(tmp_path: Path) -> None:
    """A first Kinect's 58.5 x 45.6 degrees at 640 x 480 are the 571 px that are known of it."""
    path = tmp_path / "kinect.oni"
    write_oni(path, depths(2, (480, 640)), fov=(np.deg2rad(58.5), np.deg2rad(45.6)))
    with DepthCamera(DepthCameraConfig(port=str(path), speed=0.0)) as camera:
        intrinsics = camera.next(5.0).intrinsics
    assert intrinsics == camera.intrinsics
    assert isinstance(intrinsics, Intrinsics)
    assert intrinsics.fx_px == pytest.approx(571.4, abs=0.1)
    assert intrinsics.fy_px == pytest.approx(570.9, abs=0.1)
    assert (intrinsics.cx_px, intrinsics.cy_px) == (320.0, 240.0)


def test_a_recording_is_checked_against_what_was_asked(recording: Path) -> None:
    with DepthCamera(DepthCameraConfig(port=str(recording), width=16, height=12, fps=30, speed=0.0)) as camera:
        camera.next(5.0)
    with pytest.raises(SettingsRefused, match="depth 640x480 at 30 Hz in DEPTH_1_MM; got 16x12"):
        DepthCamera(DepthCameraConfig(port=str(recording), width=640, height=480)).open()


def test_recordings_that_cannot_be_played_are_reported(tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.oni"
    damaged.write_bytes(b"no recording")
    with pytest.raises(NotConnected, match="expected an existing recording"):
        DepthCamera(DepthCameraConfig(port=str(tmp_path / "none.oni"))).open()
    with pytest.raises(NotConnected, match="expected a depth camera"):
        DepthCamera(DepthCameraConfig(port=str(damaged))).open()
    with pytest.raises(SettingsRefused, match="a speed of 0 or more"):
        DepthCamera(DepthCameraConfig(port=str(damaged), speed=-1.0))


def test_damaged_recordings_end_in_words(recording: Path) -> None:
    """Whatever OpenNI2 makes of them: an end, an error of a device's, and no process that stays."""
    good = recording.read_bytes()
    rolls = random.Random(3)
    for _ in range(12):
        damaged = bytearray(good)
        for _ in range(2):
            damaged[rolls.randrange(700)] ^= 1 << rolls.randrange(8)
        recording.write_bytes(damaged)
        camera = DepthCamera(DepthCameraConfig(port=str(recording), speed=0.0, silence_s=0.5))
        with contextlib.suppress(DeviceError), camera:
            for picture in camera:
                assert picture.depth.shape == (camera._reported["height"], camera._reported["width"])
        assert not camera.is_open
        assert camera.process_id is None


@pytest.mark.hardware
@pytest.mark.parametrize("color", [False, True])
def test_on_a_camera(color: bool) -> None:
    """The first camera of this machine."""
    with DepthCamera(DepthCameraConfig(width=640, height=480, fps=30, color=color)) as camera:
        pictures = [camera.next(5.0) for _ in range(60)]
    assert {picture.depth.shape for picture in pictures} == {(480, 640)}
    assert np.mean([(picture.depth > 0).mean() for picture in pictures]) > 0.1
    assert camera.intrinsics is not None
