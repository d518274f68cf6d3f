"""Depth cameras that are plugged in, as the kernel lists them, without opening any; and the names of their ports."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from deformscope_drivers.errors import DeviceError, NotConnected
from deformscope_drivers.hosted import ask_hosted
from deformscope_drivers.openni.library import INSTALL, ListedDevice
from deformscope_drivers.openni.process import report_cameras
from deformscope_drivers.ports import FoundDevice
from deformscope_drivers.usb import UsbDevice, sysfs_text, usb_device

USB_DEVICES = Path("/sys/bus/usb/devices")
USB_PORT = "usb:"
LIST_TIMEOUT_S = 10.0

PRIMESENSE = 0x1D27
MICROSOFT = 0x045E
CAMERAS = {
    **{(PRIMESENSE, product): "PrimeSense or Xtion" for product in (0x0200, 0x0300, 0x0400, 0x0401, 0x0500)},
    **{(PRIMESENSE, product): "PrimeSense Carmine or Xtion" for product in (0x0600, 0x0601, 0x0609)},
    **{(PRIMESENSE, product): "PrimeSense" for product in (0x1280, 0x2100, 0x2200, 0xF9DB)},
    **{(MICROSOFT, product): "Kinect for Xbox 360 or Windows" for product in (0x02AE, 0x02BF)},
}
"""The depth cameras that OpenNI2's Debian package has udev rules for (60-libopenni2-0.rules), less their motors and
microphones."""


def list_by_openni() -> list[ListedDevice] | None:
    """The cameras that OpenNI2 lists in a child process; None if it is not installed."""
    try:
        return ask_hosted(report_cameras, timeout_s=LIST_TIMEOUT_S) or []
    except DeviceError:
        return None


def discover(
    devices: Path = USB_DEVICES, list_cameras: Callable[[], list[ListedDevice] | None] = list_by_openni
) -> list[FoundDevice]:
    """Every connected depth camera: known ones on USB, by their socket, and others that OpenNI2 finds (a vendor's own
    build of it finds more).

    devices: /sys/bus/usb/devices; list_cameras: cameras that OpenNI2 sees, None if it is not installed"""
    listed = list_cameras()
    found, reported = [], set()
    for folder in sorted(devices.iterdir()) if devices.is_dir() else []:
        usb = usb_device(folder)
        if usb is None or (usb.vendor, usb.product) not in CAMERAS:
            continue
        uri = openni_uri(usb)
        reported.add(uri)
        name = " ".join(f"{usb.manufacturer} {usb.name}".split()) or CAMERAS[usb.vendor, usb.product]
        note = f"OpenNI2: {uri}" if listed is not None else f"OpenNI2 is not installed: {INSTALL}"
        found.append(FoundDevice("depth_camera", USB_PORT + folder.name, name, usb.serial, usb.revision, note))
    for camera in listed or []:
        if camera.uri not in reported:
            name = " ".join(f"{camera.vendor} {camera.name}".split())
            found.append(FoundDevice("depth_camera", camera.uri, name, note="listed by OpenNI2"))
    return found


def resolve_port(port: str, devices: Path = USB_DEVICES) -> str:
    """OpenNI2's name of a port's camera: `usb:1-2` is looked up, anything else is its own name."""
    if not port.startswith(USB_PORT):
        return port
    usb = usb_device(devices / port.removeprefix(USB_PORT))
    if usb is None:
        raise NotConnected("a camera in that socket", "none", "deformscope devices", port)
    return openni_uri(usb)


def openni_uri(usb: UsbDevice) -> str:
    """vendor/product@bus/device; the last number changes whenever it is plugged in."""
    bus, number = (sysfs_text(usb.folder / name) for name in ("busnum", "devnum"))
    return f"{usb.vendor:04x}/{usb.product:04x}@{bus}/{number}"
