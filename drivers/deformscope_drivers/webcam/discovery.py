"""Webcams that are plugged in, as the kernel lists them, without opening any."""

from __future__ import annotations

from pathlib import Path

from deformscope_drivers.ports import FoundDevice, stable_name, sysfs_text, usb_device


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
        usb, interface = None, node / "device"
        if interface.exists():  # it names an interface, a folder below the USB device's
            folder = interface.resolve()
            usb = usb_device(folder) or usb_device(folder.parent)
        notes = [] if port == str(device) else [str(device)]
        if usb is not None:
            notes.append(f"usb {usb.vendor:04x}:{usb.product:04x}")
        serial, revision = (usb.serial, usb.revision) if usb is not None else ("", "")
        found.append(FoundDevice("webcam", port, name, serial, revision, ", ".join(notes)))
    return found
