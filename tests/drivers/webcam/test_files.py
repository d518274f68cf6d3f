"""Video files and folders of images in a camera's place: every picture in order, at its time, to the end or round."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope_drivers.errors import NotConnected
from deformscope_drivers.health import Link
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.webcam import ColorImage, ImageFolder, VideoFile
from tests.drivers.contract import Bench, DeviceContract, wait_until
from tests.films import film

COUNT = 12


def grey(index: int) -> int:
    return 20 + 15 * index


def index_of(image: ColorImage) -> int:
    return round((float(image.image.mean()) - 20) / 15)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve grey frames, each 15 levels brighter than the one before, at 25 Hz."""
    path = tmp_path_factory.mktemp("video") / "grey.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    for index in range(COUNT):
        writer.write(np.full((48, 64, 3), grey(index), np.uint8))
    writer.release()
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("folder")
    for index in range(COUNT):
        cv2.imwrite(str(path / f"img{index}.png"), np.full((48, 64, 3), grey(index), np.uint8))
    (path / "notes.txt").write_text("no image")
    (path / ".hidden.png").write_bytes(b"no image")
    return path


class TestVideoFile(DeviceContract):
    @pytest.fixture
    def bench(self, video: Path) -> Bench:
        return Bench(VideoFile(video, fps=200.0, loop=True))


class TestImageFolder(DeviceContract):
    @pytest.fixture
    def bench(self, folder: Path) -> Bench:
        return Bench(ImageFolder(folder, fps=200.0, loop=True))


class TestAsFastAsRead(DeviceContract):
    """Without a pace of its own nothing is lost on a slow reader, so that one test of the contract is another's."""

    @pytest.fixture
    def bench(self, video: Path) -> Bench:
        return Bench(VideoFile(video, real_time=False, loop=True))

    def test_a_slow_reader_loses_the_oldest_and_sees_how_many(self, device) -> None:
        slow = device.readings(capacity=4)
        wait_until(lambda: len(slow) == 4)
        quick = device.readings()
        assert [index_of(slow.get(5.0)) for _ in range(20)] == [index % COUNT for index in range(20)]
        assert slow.dropped == quick.dropped == device.health().dropped == 0


@pytest.mark.parametrize("kind", [VideoFile, ImageFolder])
def test_every_picture_comes_once_and_then_the_end(kind, video: Path, folder: Path) -> None:
    path = video if kind is VideoFile else folder
    with kind(path, real_time=False) as device:
        assert [index_of(image) for image in device] == list(range(COUNT))
        wait_until(lambda: device.link is Link.CLOSED)
        assert device.health().received == COUNT
        assert device.health().reason == f"the end of {path.name}"


def test_the_file_tells_the_rate_and_the_times(video: Path, folder: Path) -> None:
    with VideoFile(video, real_time=False) as device:
        assert device.fps == pytest.approx(25.0)
        ticks = [image.stamp.device_ticks for image in device]
        assert ticks == [40_000 * index for index in range(COUNT)]
    with ImageFolder(folder, real_time=False) as device:
        assert device.fps == 30.0


def test_a_loop_begins_again_and_its_times_go_on(folder: Path) -> None:
    device = ImageFolder(folder, fps=100.0, real_time=False, loop=True).open(own_thread=False)
    images = [image for _ in range(30) for image in device.poll()]
    device.close()
    assert [index_of(image) for image in images] == [index % COUNT for index in range(30)]
    assert [image.stamp.device_ticks for image in images] == [10_000 * index for index in range(30)]


def test_in_real_time_pictures_keep_to_their_moments(video: Path) -> None:
    """On a simulated clock, exactly."""
    device = VideoFile(video, clock=SimulatedClock(1_000)).open(own_thread=False)
    stamps = []
    while device.link is Link.CONNECTED:
        stamps += [image.stamp.host_ns for image in device.poll(0.05)]
    device.close()
    assert stamps == [1_000 + 40_000_000 * index for index in range(COUNT)]


def test_a_video_of_a_varying_rate_plays_at_its_times(tmp_path: Path) -> None:
    times_ms = [0, 20, 40, 60, 120, 180, 200, 1200]
    path = film(tmp_path / "v.mkv", times_ms, "MJPG")
    clock = SimulatedClock(1_000)
    device = VideoFile(path, clock=clock, loop=True).open(own_thread=False)
    images = []
    while len(images) < 2 * len(times_ms):
        images += device.poll(0.05)
    device.close()
    mean_ms = 1000.0 / device.fps
    expected = np.append(times_ms, 1200 + mean_ms + np.asarray(times_ms))
    assert [image.stamp.device_ticks for image in images] == np.round(1e3 * expected).tolist()
    np.testing.assert_allclose([(image.stamp.host_ns - 1_000) / 1e6 for image in images], expected, atol=1e-5)
    with VideoFile(path, fps=10.0, real_time=False) as device:
        assert [image.stamp.device_ticks for image in device] == [100_000 * index for index in range(len(times_ms))]


def test_a_stack_of_pages_is_not_played_as_its_first_page(tmp_path: Path) -> None:
    cv2.imwritemulti(str(tmp_path / "a.tif"), [np.zeros((8, 8), np.uint8)] * 3)
    with pytest.raises(NotConnected, match=r"images of one page; got 3 pages"):
        ImageFolder(tmp_path, real_time=False).open(own_thread=False)


def test_next_goes_on_picture_by_picture(folder: Path) -> None:
    with ImageFolder(folder, real_time=False) as device:
        assert [index_of(device.next(5.0)) for _ in range(3)] == [0, 1, 2]


def test_colours_are_red_first(tmp_path: Path) -> None:
    red = np.zeros((8, 8, 3), np.uint8)
    red[..., 2] = 255
    cv2.imwrite(str(tmp_path / "red.png"), red)
    with ImageFolder(tmp_path, real_time=False) as device:
        assert device.next(5.0).image[0, 0].tolist() == [255, 0, 0]


def test_a_picture_that_cannot_be_read_is_counted(tmp_path: Path) -> None:
    for index in (0, 2):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((8, 8, 3), grey(index), np.uint8))
    (tmp_path / "1.png").write_bytes(b"")
    (tmp_path / "3.png").write_bytes(b"damaged")
    with ImageFolder(tmp_path, real_time=False) as device:
        assert [index_of(image) for image in device] == [0, 2]
        assert device.health().refused == {"unreadable": 2}


def test_what_is_no_video_is_reported(tmp_path: Path, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    damaged = tmp_path / "video.avi"
    damaged.write_bytes(b"no video")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(NotConnected, match="got a damaged file, or one of another kind"):
        VideoFile(damaged).open()
    with pytest.raises(NotConnected, match="expected a file that is there"):
        VideoFile(tmp_path / "none.avi").open()
    with pytest.raises(NotConnected, match="expected images; got none"):
        ImageFolder(empty).open()
    with pytest.raises(NotConnected, match="VideoFile for a video"):
        ImageFolder(damaged).open()
    with pytest.raises(NotConnected, match="positive frame rate"):
        ImageFolder(folder, fps=0.0)
    capfd.readouterr()
