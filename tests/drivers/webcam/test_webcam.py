"""A webcam on a fake capture: settings read back, faults reported. OpenCV's V4L2 needs a camera (marker hardware)."""

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from deformscope_drivers.device import Reconnect
from deformscope_drivers.errors import LinkLost, NotConnected, SettingsRefused, Stale
from deformscope_drivers.health import Link
from deformscope_drivers.webcam import Webcam, WebcamConfig
from deformscope_drivers.webcam.device import OpencvCapture, Setting, open_v4l2
from tests.drivers.contract import Bench, DeviceContract, wait_until
from tests.drivers.webcam.fake_capture import FakeCamera

QUICK = Reconnect(0.01, 0.1)
SMALL = WebcamConfig(width=64, height=48, silence_s=5.0)


@pytest.fixture
def camera() -> FakeCamera:
    return FakeCamera()


def webcam(camera: FakeCamera, config: WebcamConfig = SMALL, **options) -> Webcam:
    return Webcam(config, open_capture=camera.open, reconnect=QUICK, **options)


class TestWebcam(DeviceContract):
    @pytest.fixture
    def bench(self, camera: FakeCamera) -> Iterator[Bench]:
        def plug(plugged: bool) -> None:
            camera.plugged = plugged

        def pause(paused: bool) -> None:
            camera.paused = paused

        yield Bench(webcam(camera), lambda: plug(False), lambda: plug(True), lambda: pause(True), lambda: pause(False))
        assert camera.opened == camera.closed


def test_an_image_carries_its_arrival_and_the_cameras_own_time(camera: FakeCamera) -> None:
    with webcam(camera) as device:
        image = device.next(5.0)
    assert image.image.shape == (48, 64, 3)
    assert image.image.dtype == np.uint8
    assert image.stamp.device_ticks is not None
    assert abs(image.stamp.device_ticks * 1000 - image.stamp.host_ns) < 1e9


def test_the_format_is_set_first_then_the_size_then_the_rate(camera: FakeCamera) -> None:
    with webcam(camera):
        pass
    assert camera.asked[:4] == [Setting.FOURCC, Setting.WIDTH, Setting.HEIGHT, Setting.FPS]
    assert camera.controls[Setting.AUTOFOCUS] == 0.0


def test_controls_are_made_manual_before_they_are_set(camera: FakeCamera) -> None:
    config = dataclasses.replace(SMALL, exposure_s=0.01, gain=12.0, white_balance_k=4600.0)
    with webcam(camera, config):
        pass
    assert camera.controls[Setting.AUTO_EXPOSURE] == 1.0
    assert camera.controls[Setting.EXPOSURE] == 100.0  # in 100 us
    assert camera.controls[Setting.AUTO_WHITE_BALANCE] == 0.0
    assert camera.controls[Setting.WHITE_BALANCE] == 4600.0
    assert camera.controls[Setting.GAIN] == 12.0
    assert camera.asked.index(Setting.AUTO_EXPOSURE) < camera.asked.index(Setting.EXPOSURE)


@pytest.mark.parametrize(
    ("config", "asked", "came"),
    [
        (dataclasses.replace(SMALL, width=123), "width 123, height 48", "width 640, height 480"),
        (dataclasses.replace(SMALL, fourcc="H264"), "fourcc 'H264', fps 30", "fourcc 'YUYV', fps 15"),
        (dataclasses.replace(SMALL, fps=60.0), "fps 60", "fps 30"),
        (dataclasses.replace(SMALL, focus=10.0), "focus 10", "no focus"),
    ],
)
def test_a_setting_that_was_not_applied_is_refused(
    camera: FakeCamera, config: WebcamConfig, asked: str, came: str
) -> None:
    device = webcam(camera, config)
    with pytest.raises(SettingsRefused) as caught:
        device.open()
    assert f"expected {asked}" in str(caught.value)
    assert f"got {came}" in str(caught.value)
    assert str(caught.value).endswith("/dev/video0")
    assert camera.closed == camera.opened == 1


def test_a_control_that_stays_what_it_was_is_refused(camera: FakeCamera) -> None:
    camera.stubborn[Setting.EXPOSURE] = 166.0
    with pytest.raises(SettingsRefused, match=r"expected exposure 100; got exposure 166"):
        webcam(camera, dataclasses.replace(SMALL, exposure_s=0.01)).open()


def test_a_camera_without_autofocus_has_it_off(camera: FakeCamera) -> None:
    del camera.controls[Setting.AUTOFOCUS]
    with webcam(camera) as device:
        device.next(5.0)
    with pytest.raises(SettingsRefused, match="no autofocus"):
        webcam(camera, dataclasses.replace(SMALL, autofocus=True)).open()


def test_a_format_has_four_letters(camera: FakeCamera) -> None:
    with pytest.raises(SettingsRefused, match="four letters"):
        webcam(camera, dataclasses.replace(SMALL, fourcc="MJPEG")).open()


def test_a_frozen_picture_is_reported(camera: FakeCamera) -> None:
    with webcam(camera, dataclasses.replace(SMALL, stuck_after_s=0.05)) as device:
        device.next(5.0)
        assert not device.health().stuck
        camera.frozen = True
        wait_until(lambda: device.health().stuck)
        with pytest.raises(Stale, match="readings that change"):
            device.latest(1.0)
        camera.frozen = False
        wait_until(lambda: not device.health().stuck)
        device.latest(1.0)


def test_a_camera_that_sends_no_more_is_lost_and_opened_again(camera: FakeCamera) -> None:
    with webcam(camera, dataclasses.replace(SMALL, silence_s=0.1)) as device:
        device.next(5.0)
        camera.paused = True
        wait_until(lambda: device.link is Link.LOST)
        assert "expected an image; got none for" in device.health().reason
        camera.paused = False
        device.next(5.0)
        assert device.health().reconnects >= 1


def test_without_reconnection_a_lost_camera_ends_the_session(camera: FakeCamera) -> None:
    with Webcam(SMALL, open_capture=camera.open, reconnect=None) as device:
        images = device.readings()
        camera.plugged = False
        with pytest.raises(LinkLost):
            for _ in images:
                pass
        assert device.link is Link.FAILED


def test_images_that_cannot_be_used_are_counted(camera: FakeCamera) -> None:
    with webcam(camera) as device:
        device.next(5.0)
        camera.undecodable = True
        wait_until(lambda: device.health().refused.get("undecodable", 0) >= 3)
        camera.undecodable, camera.shape = False, (24, 32, 3)
        wait_until(lambda: device.health().refused.get("size", 0) >= 3)
        camera.shape = None
        assert device.next(5.0).image.shape == (48, 64, 3)


def test_pauses_are_counted_by_the_cameras_time(camera: FakeCamera) -> None:
    camera.period_s = 0.004
    with webcam(camera) as device:
        device.next(5.0)
        before = device.health().extra["gaps"]
        camera.paused = True
        with pytest.raises(Stale):
            device.next(0.2)  # six periods of the 30 Hz that are configured
        camera.paused = False
        device.next(5.0)
        wait_until(lambda: device.health().extra["gaps"] > before)


def test_the_cameras_clock_is_fitted_to_the_hosts(camera: FakeCamera) -> None:
    with webcam(camera) as device:
        relation = None
        while relation is None:
            device.next(5.0)
            relation = device.health().clock
    assert relation.tick_ns == pytest.approx(1000.0, rel=0.01)


def test_a_camera_is_found_again_by_its_stable_name(camera: FakeCamera, tmp_path: Path) -> None:
    """Plugged in again as video1, it is still the same camera."""
    links = tmp_path / "by-id"
    links.mkdir()
    for name in ("video0", "video1"):
        (tmp_path / name).touch()
    link = links / "usb-046d_C920-video-index0"
    link.symlink_to(tmp_path / "video0")
    config = dataclasses.replace(SMALL, port=str(tmp_path / "video0"))
    with webcam(camera, config, links=links) as device:
        device.next(5.0)
        link.unlink()
        link.symlink_to(tmp_path / "video1")
        camera.plugged = False
        wait_until(lambda: device.link is Link.LOST)
        camera.plugged = True
        wait_until(lambda: device.link is Link.CONNECTED)
    assert set(camera.paths) == {str(link)}


@pytest.mark.parametrize(("port", "path"), [(2, "/dev/video2"), ("1", "/dev/video1"), ("/dev/v4l/x", "/dev/v4l/x")])
def test_a_port_is_a_number_or_a_path(port: str | int, path: str) -> None:
    assert WebcamConfig(port=port).path == path


def test_a_camera_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(NotConnected, match=r"expected a camera that is there; got none .*deformscope devices"):
        Webcam(WebcamConfig(port=str(tmp_path / "video9"))).open()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open anything")
def test_a_camera_that_may_not_be_opened_is_reported(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.touch(mode=0o000)
    with pytest.raises(NotConnected, match=r"permission denied \| try: sudo usermod -aG video"):
        open_v4l2(str(node))


def test_opencv_refuses_what_is_no_camera(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The one step with OpenCV's V4L2 that needs no camera."""
    node = tmp_path / "video0"
    node.write_bytes(b"no camera")
    with pytest.raises(NotConnected, match="one that is in use, or gives none"):
        OpencvCapture(str(node))
    capfd.readouterr()  # OpenCV's own warning


class StandIn:
    """`cv2`, as far as waiting goes: what `waitAny` gives."""

    error = cv2.error

    def __init__(self, outcome) -> None:
        self.VideoCapture = self
        self._outcome = outcome

    def waitAny(self, captures, timeout_ns):
        assert timeout_ns > 0, "0 is for ever"
        if isinstance(self._outcome, Exception):
            raise self._outcome
        return self._outcome


def waiting(path: Path, outcome) -> OpencvCapture:
    capture = object.__new__(OpencvCapture)
    capture._path, capture._capture, capture._cv2 = str(path), None, StandIn(outcome)
    return capture


def test_what_opencv_says_of_a_wait(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.touch()
    assert waiting(node, (True, [0])).wait(0.0)
    assert not waiting(node, (False, [])).wait(0.05)
    with pytest.raises(LinkLost, match="unplugged, or its driver failed"):
        waiting(node, cv2.error("Error is reported for camera stream")).wait(0.05)
    with pytest.raises(LinkLost, match="unplugged"):
        waiting(node, (True, [])).wait(0.05)  # the kernel hung up
    node.unlink()
    with pytest.raises(LinkLost, match="unplugged"):
        waiting(node, (False, [])).wait(0.05)


def test_waiting_is_asked_of_opencv_as_it_is_called(tmp_path: Path) -> None:
    """Of anything but a V4L2 camera it says that it cannot wait, and not that the call is wrong."""
    path = tmp_path / "grey.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    capture = waiting(path, None)
    capture._cv2, capture._capture = cv2, cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    with pytest.raises(LinkLost) as caught:
        capture.wait(0.05)
    image = capture._capture.grab() and capture.retrieve()
    capture.close()
    assert "supported by V4L backend only" in str(caught.value.__cause__)
    assert image.shape == (48, 64, 3)


@pytest.mark.hardware
def test_on_a_camera() -> None:
    """The first camera of this machine, at a size that every camera has."""
    with Webcam(WebcamConfig(fourcc="YUYV")) as camera:
        images = [camera.next(5.0) for _ in range(30)]
    assert {image.image.shape for image in images} == {(480, 640, 3)}
