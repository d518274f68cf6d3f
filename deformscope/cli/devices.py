"""`deformscope devices`: connected devices, and their health."""

import dataclasses
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from deformscope.cli.common import say, show_table, write_json
from deformscope.config import DevicesConfig
from deformscope_drivers.depth_camera import discover as find_depth_cameras
from deformscope_drivers.depth_camera import discover_realsense
from deformscope_drivers.errors import Busy, DeviceError
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.ports import find_can, find_doubles, find_serial, find_usb_arms
from deformscope_drivers.webcam import discover as find_webcams

PROBE_S = 1.0
LISTEN_S = 0.5

NOTHING = (
    "No device was found on this machine. What to check:\n  cable and power; then: lsusb, ls -l "
    "/dev/serial/by-id /dev/video* , ip -details link show type can\n  the SDH's hand and tactile controller sit "
    "behind plain serial adapters, which are listed when connected\n  in a container or virtual machine, pass "
    "the device through\nWithout hardware: deformscope double optoforce (in another terminal), or deformscope "
    "record lab:bench"
)


@dataclass(frozen=True, slots=True)
class ListedDevice:
    """One line of the list. health: `ok at 1000/s`, or the reason against; empty without a query"""

    driver: str
    port: str
    name: str
    serial: str
    firmware: str
    health: str
    note: str


def run(config: DevicesConfig) -> None:
    """List connected devices, and query those that can be queried without harm."""
    found = [_listed(one, config.probe) for one in search()]
    write_json([dataclasses.asdict(one) for one in found], config.json)
    if not found:
        print(NOTHING)
        return
    for one in found:
        rows = {
            "driver": one.driver or "unknown",
            "name": one.name,
            "serial": one.serial,
            "firmware": one.firmware,
            "health": one.health,
            "note": one.note,
        }
        show_table(one.port, [(what, words) for what, words in rows.items() if words])


def search() -> list[Any]:
    """All devices that any search finds; a failed search is reported and does not hide the others."""
    searches: list[Callable[[], list[Any]]] = [
        find_doubles,
        find_serial,
        find_can,
        find_usb_arms,
        lambda: list(find_webcams()),
        lambda: list(find_depth_cameras()),
        lambda: list(discover_realsense()),
    ]
    found: list[Any] = []
    for one in searches:
        try:
            found += one()
        except Exception as error:
            say(f"a search failed: {' '.join(str(error).split()) or type(error).__name__}")
    return found


def _listed(found: Any, probe: bool) -> ListedDevice:
    serial, firmware, health = found.serial, found.firmware, ""
    if probe and found.driver in DRIVERS and DRIVERS[found.driver].probed:
        serial_known, firmware_known, health = _ask(found)
        serial, firmware = serial_known or serial, firmware_known or firmware
    return ListedDevice(found.driver, found.port, found.name, serial, firmware, health, found.note)


def _ask(found: Any) -> tuple[str, str, str]:
    """Serial number, firmware and health of a device that is opened for a moment. Nothing moves."""
    driver = DRIVERS[found.driver]
    try:
        is_bus = not found.port.startswith("/") and "://" not in found.port
        config: Any = driver.config
        with driver.make(config(bus=found.port) if is_bus else config(port=found.port)) as device:
            known, serial = device.identity(), ""
            with suppress(DeviceError):  # some give it only on request, some not at all
                serial = known.serial or device.serial_number()
            try:
                device.next(PROBE_S)
            except DeviceError as error:
                return serial, known.firmware, f"silent: {error}"
            time.sleep(LISTEN_S)
            health = device.health()
            bad = f", {health.skipped_bytes} bad bytes" if health.skipped_bytes else ""
            return serial, known.firmware, f"ok, {health.rate_hz:.4g} readings a second{bad}"
    except Busy:
        return "", "", "in use by another program"
    except DeviceError as error:
        return "", "", f"does not answer: {error}"
