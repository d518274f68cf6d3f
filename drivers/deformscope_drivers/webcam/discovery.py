"""Webcams that are plugged in, as the kernel lists them, without opening any."""

from __future__ import annotations

from pathlib import Path

from deformscope_drivers.ports import FoundDevice, UsbDevice, sysfs_text, usb_device
from deformscope_drivers.webcam.device import stable_name


def discover(sysfs: Path = Path("/sys"), dev: Path = Path("/dev")) -> list[FoundDevice]:
    """Every V4L2 camera, by its stable name where there is one.

    A camera's further nodes (metadata, which give no images) are left out. sysfs, dev: where those folders are"""
    nodes = sysfs / "class" / "video4linux"
    found = []
    for node in sorted(nodes.glob("video*"), key=lambda path: (len(path.name), path.name)) if nodes.is_dir() else []:
        if sysfs_text(node / "index") not in ("", "0"):
            continue
        device = dev / node.name
        port = stable_name(str(device), dev / "v4l" / "by-id")
        name = sysfs_text(node / "name")
        usb = _usb_of(node)
        notes = [] if port == str(device) else [str(device)]
        if usb is not None:
            notes.append(f"usb {usb.vendor:04x}:{usb.product:04x}")
        serial, revision = (usb.serial, usb.revision) if usb is not None else ("", "")
        found.append(FoundDevice("webcam", port, name, serial, revision, ", ".join(notes)))
    return found


def _usb_of(node: Path) -> UsbDevice | None:
    """The USB device that a video node belongs to: its link `device` names an interface, a folder below it."""
    interface = node / "device"
    if not interface.exists():
        return None
    folder = interface.resolve()
    return usb_device(folder) or usb_device(folder.parent)
