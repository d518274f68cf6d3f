"""Devices connected to this machine, as far as they are visible without opening anything."""

from dataclasses import dataclass
from pathlib import Path

from deformscope_drivers.doubles import running_doubles


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


USB_DEVICES = Path("/sys/bus/usb/devices")
NETWORK = Path("/sys/class/net")
ARPHRD_CAN = "280"

OPTOFORCE_USB = (0x04D8, 0x000A)
KINOVA_VENDOR = 0x22CD
SERIAL_ADAPTER = "a serial port or adapter; the SDH's tactile controller or its hand may be behind it"


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """Something that is plugged in.

    driver: name of the package with its driver; empty if only a query would determine it
    port: what a configuration names; serial: its serial number, or that of the USB adapter"""

    driver: str
    port: str
    name: str = ""
    serial: str = ""
    firmware: str = ""
    note: str = ""


def find_doubles() -> list[FoundDevice]:
    """Simulated devices that other processes run."""
    return [FoundDevice(d.driver, d.port, d.name, note=f"a double, run by process {d.pid}") for d in running_doubles()]


def find_serial() -> list[FoundDevice]:
    """Serial ports, USB first by their stable names."""
    from serial.tools import list_ports

    found = []
    for port in sorted(list_ports.comports(include_links=False), key=lambda port: port.device):
        if port.vid is None and "ttyS" in port.device:
            continue  # motherboards announce ports that do not exist
        name = port.product or port.description or ""
        # The identity is that of a chip maker's example, which others use too: the name decides.
        driver = "optoforce" if (port.vid, port.pid) == OPTOFORCE_USB and "optoforce" in name.lower() else ""
        note = "" if driver else SERIAL_ADAPTER
        found.append(
            FoundDevice(
                driver, stable_name(port.device, Path("/dev/serial/by-id")), name, port.serial_number or "", note=note
            )
        )
    return found


def find_usb_arms(devices: Path = USB_DEVICES) -> list[FoundDevice]:
    """Kinova arms on USB."""
    found = []
    for folder in sorted(devices.glob("*")) if devices.is_dir() else []:
        if sysfs_text(folder / "idVendor").lower() == f"{KINOVA_VENDOR:04x}":
            name = sysfs_text(folder / "product") or "Kinova arm"
            found.append(FoundDevice("jaco", f"usb:{folder.name}", name, sysfs_text(folder / "serial")))
    return found


def find_can(network: Path = NETWORK) -> list[FoundDevice]:
    """CAN interfaces of the kernel's (socketcan)."""
    found = []
    for folder in sorted(network.glob("*")) if network.is_dir() else []:
        if sysfs_text(folder / "type") == ARPHRD_CAN:
            state = sysfs_text(folder / "operstate")
            note = "" if state in ("up", "unknown") else f"it is {state}: sudo ip link set {folder.name} up"
            found.append(FoundDevice("", f"socketcan:{folder.name}", "CAN interface", note=note))
    return found


def stable_name(path: str, links: Path) -> str:
    """The link in the folder `links` (/dev/serial/by-id, /dev/v4l/by-id) to the same device, or else the path."""
    if not links.is_dir() or Path(path).parent == links or not Path(path).exists():
        return path
    target = Path(path).resolve()
    return next((str(link) for link in sorted(links.iterdir()) if link.resolve() == target), path)
