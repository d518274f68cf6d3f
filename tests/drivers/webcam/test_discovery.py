"""What is reported of cameras that are plugged in, from a folder laid out as the kernel's /sys."""

from pathlib import Path

import pytest

from deformscope_drivers.ports import FoundDevice
from deformscope_drivers.webcam import discover


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A C920 with its two nodes, and a virtual camera."""
    usb = tmp_path / "sys/devices/pci0000:00/usb1/1-2"
    interface = usb / "1-2:1.0"
    interface.mkdir(parents=True)
    for name, text in {
        "idVendor": "046d",
        "idProduct": "082d",
        "manufacturer": "Logitech",
        "product": "HD Pro Webcam C920",
        "serial": "9D5B0A6F",
        "bcdDevice": "0011",
    }.items():
        (usb / name).write_text(text + "\n")
    for node, index, name, device in [
        ("video0", "0", "HD Pro Webcam C920", interface),
        ("video1", "1", "HD Pro Webcam C920", interface),
        ("video10", "0", "Dummy video device", None),
    ]:
        folder = tmp_path / "sys/class/video4linux" / node
        folder.mkdir(parents=True)
        (folder / "index").write_text(index + "\n")
        (folder / "name").write_text(name + "\n")
        if device is not None:
            (folder / "device").symlink_to(device)
        (tmp_path / "dev").mkdir(exist_ok=True)
        (tmp_path / "dev" / node).touch()
    links = tmp_path / "dev/v4l/by-id"
    links.mkdir(parents=True)
    (links / "usb-046d_HD_Pro_Webcam_C920_9D5B0A6F-video-index0").symlink_to("../../video0")
    (links / "usb-046d_HD_Pro_Webcam_C920_9D5B0A6F-video-index1").symlink_to("../../video1")
    return tmp_path


def test_cameras_are_reported_by_their_stable_names(machine: Path) -> None:
    link = machine / "dev/v4l/by-id/usb-046d_HD_Pro_Webcam_C920_9D5B0A6F-video-index0"
    name, note = "HD Pro Webcam C920", f"{machine}/dev/video0, usb 046d:082d"
    assert discover(machine / "sys", machine / "dev") == [
        FoundDevice("webcam", str(link), name, "9D5B0A6F", "0.11", note),
        FoundDevice("webcam", str(machine / "dev/video10"), "Dummy video device"),
    ]


def test_a_machine_without_cameras_has_none(tmp_path: Path) -> None:
    assert discover(tmp_path / "sys", tmp_path / "dev") == []
