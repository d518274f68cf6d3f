"""RealSense cameras that are plugged in, from a folder laid out as the kernel's /sys."""

from pathlib import Path

import pytest

from deformscope_drivers.depth_camera import discover_realsense
from deformscope_drivers.depth_camera.discovery import list_by_librealsense
from deformscope_drivers.ports import FoundDevice
from deformscope_drivers.realsense.camera import ListedRealsense, listed
from deformscope_drivers.realsense.double import CAMERAS_FILE, DoubleCamera, plug

DOUBLE = "deformscope_drivers.realsense.double"


@pytest.fixture
def devices(tmp_path: Path) -> Path:
    """A D435 on USB 2, a D455 on USB 3, a mouse."""
    for socket, product, speed in (("1-2", "0b07", "480"), ("2-1", "0b5c", "5000"), ("3-1", "c077", "12")):
        folder = tmp_path / socket
        folder.mkdir()
        files = {"idVendor": "046d" if product == "c077" else "8086", "idProduct": product, "speed": speed}
        for name, text in files.items():
            (folder / name).write_text(text + "\n")
    return tmp_path


def test_cameras_are_listed_by_their_serial_numbers(devices: Path) -> None:
    slow = ListedRealsense("1", "Intel RealSense D435", "5.16.0.1", "2.1")
    fast = ListedRealsense("2", "Intel RealSense D455", "5.16.0.1", "3.2")
    found = discover_realsense(devices, lambda: [slow, fast])
    assert [one.port for one in found] == ["serial 1", "serial 2"]
    assert found[0].note.startswith("USB 2.1, low rates only")
    assert found[1] == FoundDevice("realsense", "serial 2", "Intel RealSense D455", "2", "5.16.0.1", "USB 3.2")


def test_without_the_library_the_kernels_list_says_what_to_install(devices: Path) -> None:
    found = discover_realsense(devices, lambda: None)
    assert [(one.port, one.name) for one in found] == [
        ("usb:1-2", "Intel RealSense D435"),
        ("usb:2-1", "Intel RealSense D455"),
    ]
    assert all("pip install deformscope[realsense]" in one.note for one in found)
    assert ["USB 2" in one.note for one in found] == [True, False]


def test_a_camera_that_the_library_does_not_see_wants_udev_rules(devices: Path) -> None:
    found = discover_realsense(devices, lambda: [ListedRealsense("2", "Intel RealSense D455")])
    assert len(found) == 3
    assert all("udev" in one.note for one in found[1:])


def test_nothing_is_asked_where_none_is_plugged_in(tmp_path: Path) -> None:
    def never() -> list[ListedRealsense]:
        raise AssertionError

    assert discover_realsense(tmp_path, never) == []


def test_the_library_is_asked_in_a_process_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plug(tmp_path / "cameras.json", DoubleCamera(serial="7"), DoubleCamera(serial="8", hidden="no access"))
    monkeypatch.setenv(CAMERAS_FILE, str(tmp_path / "cameras.json"))
    first, second = list_by_librealsense(DOUBLE) or []
    assert (first.serial, first.usb, second.trouble) == ("7", "3.2", "no access")
    assert list_by_librealsense("no_such_library") is None


def test_a_library_that_cannot_look_says_why() -> None:
    class Library:
        @staticmethod
        def context() -> None:
            raise RuntimeError("failed to open usb interface: 0, error: RS2_USB_STATUS_ACCESS")

    (camera,) = listed(Library)
    assert camera.trouble.endswith("RS2_USB_STATUS_ACCESS")
