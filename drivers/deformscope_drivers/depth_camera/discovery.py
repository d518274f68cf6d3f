"""Depth cameras that are plugged in, as the kernel lists them, without opening any; and the names of their ports."""

from collections.abc import Callable
from pathlib import Path

from deformscope_drivers.errors import DeviceError, LibraryMissing, NotConnected
from deformscope_drivers.hosted import ask_hosted
from deformscope_drivers.openni import library as openni
from deformscope_drivers.openni.camera import report_cameras as report_openni
from deformscope_drivers.openni.library import ListedDevice
from deformscope_drivers.ports import USB_DEVICES, FoundDevice, UsbDevice, sysfs_text, usb_device
from deformscope_drivers.realsense.camera import INSTALL, UDEV, ListedRealsense
from deformscope_drivers.realsense.camera import report_cameras as report_realsense

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
"""The depth cameras that OpenNI2's Debian package has udev rules for (60-libopenni2-0.rules), without motors."""


def list_by_openni() -> list[ListedDevice] | None:
    """The cameras that OpenNI2 lists in a child process; None if it is not installed."""
    try:
        return ask_hosted(report_openni, timeout_s=LIST_TIMEOUT_S) or []
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
        note = f"OpenNI2: {uri}" if listed is not None else f"OpenNI2 is not installed: {openni.INSTALL}"
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
        return ask_hosted(report_realsense, library, timeout_s=LIST_TIMEOUT_S) or []
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
