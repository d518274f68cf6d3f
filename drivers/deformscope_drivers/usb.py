"""USB devices as the kernel lists them under /sys, without opening anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """vendor, product: ids; revision: the device's own version number (bcdDevice), as text such as 0.12"""

    vendor: int
    product: int
    manufacturer: str
    name: str
    serial: str
    revision: str
    folder: Path


def usb_device(folder: Path) -> UsbDevice | None:
    """The USB device of a folder under /sys/bus/usb/devices; None for an interface, or another folder."""
    try:
        vendor = int(sysfs_text(folder / "idVendor"), 16)
        product = int(sysfs_text(folder / "idProduct"), 16)
    except ValueError:
        return None
    revision = sysfs_text(folder / "bcdDevice")
    return UsbDevice(
        vendor,
        product,
        sysfs_text(folder / "manufacturer"),
        sysfs_text(folder / "product"),
        sysfs_text(folder / "serial"),
        f"{int(revision[:-2])}.{revision[-2:]}" if len(revision) == 4 and revision.isdecimal() else revision,
        folder,
    )


def sysfs_text(path: Path) -> str:
    """A file's text without the space around it; empty without a file."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
