"""RealSense cameras that are plugged in: by librealsense, and by the kernel where that is missing or sees none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from deformscope_drivers.errors import LibraryMissing
from deformscope_drivers.hosted import ask_hosted
from deformscope_drivers.ports import FoundDevice
from deformscope_drivers.realsense.advice import INSTALL, UDEV
from deformscope_drivers.realsense.camera import ListedRealsense
from deformscope_drivers.realsense.process import report_cameras
from deformscope_drivers.usb import sysfs_text, usb_device

USB_DEVICES = Path("/sys/bus/usb/devices")
LIST_TIMEOUT_S = 10.0
INTEL = 0x8086
MODELS = {
    0x0AD1: "D400",
    0x0AD2: "D410",
    0x0AD3: "D415",
    0x0AD4: "D430",
    0x0AF6: "D420",
    0x0B07: "D435",
    0x0B3A: "D435i",
    0x0B4B: "D430i",
    0x0B5B: "D405",
    0x0B5C: "D455",
    0x1155: "D421",
    0x1156: "D436",
}
"""Models that are sold with USB, by product number (librealsense, src/ds/d400/d400-private.h)."""
USB_3_MBIT_S = 5000


def list_by_librealsense(library: str = "pyrealsense2") -> list[ListedRealsense] | None:
    """The cameras that librealsense lists in a child process; None if it is not installed."""
    try:
        return ask_hosted(report_cameras, library, timeout_s=LIST_TIMEOUT_S) or []
    except LibraryMissing:
        return None


def discover_realsense(
    devices: Path = USB_DEVICES, list_cameras: Callable[[], list[ListedRealsense] | None] = list_by_librealsense
) -> list[FoundDevice]:
    """Every RealSense camera that is plugged in, by its serial number where librealsense reports it. The kernel reports
    another serial number, so that cameras which only the kernel sees are named by their socket.

    devices: /sys/bus/usb/devices; list_cameras: cameras that librealsense sees, None if it is not installed"""
    folders = sorted(devices.iterdir()) if devices.is_dir() else []
    plugged = [usb for folder in folders if (usb := usb_device(folder)) is not None]
    sockets = [(usb.folder, MODELS[usb.product]) for usb in plugged if usb.vendor == INTEL and usb.product in MODELS]
    listed = list_cameras() if sockets else []
    cameras = listed or []
    found = [
        FoundDevice("realsense", f"serial {one.serial or '(unknown)'}", one.name, one.serial, one.firmware, _note(one))
        for one in cameras
    ]
    if len(cameras) >= len(sockets):
        return found
    why = f"librealsense is missing: {INSTALL}" if listed is None else f"librealsense does not see all of them: {UDEV}"
    for folder, model in sockets:
        speed = sysfs_text(folder / "speed")
        slow = speed.isdecimal() and int(speed) < USB_3_MBIT_S
        note = why + ("; it is on a USB 2 port or cable: low rates only" if slow else "")
        found.append(FoundDevice("realsense", f"usb:{folder.name}", f"Intel RealSense {model}", note=note))
    return found


def _note(camera: ListedRealsense) -> str:
    if camera.trouble:
        return f"{camera.trouble}: in use by another program, or {UDEV}"
    slow = ", low rates only: a USB 3 port and cable give all of them" if camera.usb.startswith("2") else ""
    return f"USB {camera.usb or '(unknown)'}{slow}"
