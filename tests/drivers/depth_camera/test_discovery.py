"""What is reported of depth cameras that are plugged in, from a folder laid out as the kernel's /sys."""

from pathlib import Path

import pytest

from deformscope_drivers.depth_camera import DepthCamera, DepthCameraConfig, discover
from deformscope_drivers.depth_camera.discovery import list_by_openni, resolve_port
from deformscope_drivers.errors import NotConnected
from deformscope_drivers.openni.library import ListedDevice
from deformscope_drivers.ports import FoundDevice


def plug(devices: Path, socket: str, files: dict[str, str]) -> None:
    folder = devices / socket
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name).write_text(text + "\n")


@pytest.fixture
def devices(tmp_path: Path) -> Path:
    """An Xtion, a Kinect with its motor, a mouse, and an interface, which has no ids."""
    xtion = {"idVendor": "1d27", "idProduct": "0601", "manufacturer": "PrimeSense", "product": "PrimeSense Device"}
    plug(tmp_path, "1-2", xtion | {"bcdDevice": "0001", "busnum": "1", "devnum": "14"})
    kinect = {"idVendor": "045e", "idProduct": "02ae", "serial": "A00362A12345", "busnum": "2", "devnum": "9"}
    plug(tmp_path, "2-1.1", kinect)
    plug(tmp_path, "2-1.2", {"idVendor": "045e", "idProduct": "02b0"})
    plug(tmp_path, "3-1", {"idVendor": "046d", "idProduct": "c077"})
    plug(tmp_path, "1-2:1.0", {"bInterfaceClass": "ff"})
    return tmp_path


XTION = FoundDevice("depth_camera", "usb:1-2", "PrimeSense PrimeSense Device", "", "0.01", "OpenNI2: 1d27/0601@1/14")
KINECT = FoundDevice(
    "depth_camera", "usb:2-1.1", "Kinect for Xbox 360 or Windows", "A00362A12345", "", "OpenNI2: 045e/02ae@2/9"
)


def test_cameras_are_reported_by_their_sockets(devices: Path) -> None:
    assert discover(devices, list) == [XTION, KINECT]


def test_what_openni_sees_beside_them_is_reported_by_its_own_name(devices: Path) -> None:
    xtion = ListedDevice("1d27/0601@1/14", "PrimeSense", "PS1080", 0x1D27, 0x0601)
    astra = ListedDevice("2bc5/0401@1/7", "Orbbec", "Astra", 0x2BC5, 0x0401)
    assert discover(devices, lambda: [xtion, astra]) == [
        XTION,
        KINECT,
        FoundDevice("depth_camera", "2bc5/0401@1/7", "Orbbec Astra", note="listed by OpenNI2"),
    ]


def test_a_camera_without_the_library_tells_what_to_install(devices: Path) -> None:
    notes = [found.note for found in discover(devices, lambda: None)]
    assert notes == ["OpenNI2 is not installed: sudo apt-get install -y libopenni2-0"] * 2


def test_a_machine_without_cameras_has_none(tmp_path: Path) -> None:
    assert discover(tmp_path / "none", list) == []


def test_openni_is_asked_in_a_process_of_its_own() -> None:
    """Its dummy is no camera that is plugged in; where there is no library, it says so."""
    cameras = list_by_openni()
    assert cameras is None or all(camera.uri for camera in cameras)


def test_a_socket_is_looked_up_and_other_names_stay(devices: Path) -> None:
    assert resolve_port("usb:1-2", devices) == "1d27/0601@1/14"
    (devices / "1-2" / "devnum").write_text("15\n")  # plugged in again
    assert resolve_port("usb:1-2", devices) == "1d27/0601@1/15"
    assert [resolve_port(port, devices) for port in ("", "Dummy", "walk.oni")] == ["", "Dummy", "walk.oni"]


def test_an_empty_socket_is_reported(devices: Path) -> None:
    with pytest.raises(NotConnected, match=r"expected a camera in that socket; got none .*usb:9-9"):
        DepthCamera(DepthCameraConfig(port="usb:9-9"), usb=devices).open()
