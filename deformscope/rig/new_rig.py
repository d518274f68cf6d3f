"""The text of a new rig file: a section for each device, and the sections of the example that belong to them."""

import dataclasses
import re
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources

from deformscope.errors import InputError
from deformscope.rig.rig_edit import lines_of
from deformscope.rig.sections import check
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS

NAMES = {"wrench": "tip", "arm": "arm", "depth": "depth", "color": "camera", "tactile": "pads", "hand": "hand"}
"""Name of the first device of a kind."""
NEEDS = {
    "camera": {"depth"},
    "tool": {"arm"},
    "shape": {"arm", "depth"},
    "surface": {"arm"},
    "workspace": {"arm"},
    "touch": {"arm", "wrench"},
    "hand": {"hand"},
    "container": {"hand"},
    "squeeze": {"hand"},
    "record": set[str](),
}
"""Kinds of devices that a section is for."""


@dataclass(frozen=True, slots=True)
class NewDevice:
    """A device of the new file. keys: those that say where it is"""

    name: str
    driver: str
    keys: dict[str, str]

    @classmethod
    def of(cls, driver: str, address: str = "", serial: str = "", name: str = "") -> "NewDevice":
        """address: serial port, URL, CAN bus or host; empty = the only one. Raises InputError for an unknown driver, or
        an address that it does not take."""
        check(driver in DRIVERS, f"a driver out of {', '.join(DRIVERS)}", driver)
        known = DRIVERS[driver]
        defaults = {one.name: one.default for one in dataclasses.fields(known.config)}
        hint = typing.get_type_hints(known.config).get("port")
        named, keys = str in (hint, *typing.get_args(hint)), {}  # of some its port is a number
        if address.startswith(("socketcan:", "virtual:")) and "bus" in defaults:
            keys["bus"] = address
        elif named and (address.startswith(("/", "usb:")) or "://" in address):
            keys["port"] = address
        elif named and address and "://" in str(defaults["port"]):  # a host: its driver knows the rest
            keys["port"] = re.sub(r"//[^:/]*", f"//{address}", str(defaults["port"]), count=1)
        elif "address" in defaults and address:
            keys["address"] = address
        elif "serial" in defaults and serial:
            keys["serial"] = serial
        elif not serial:
            check(not address, f"an address as a rig file has it, as port = or bus = of {driver}", address)
        try:
            known.config(**keys)
        except (ValueError, DeviceError) as error:
            raise InputError.about(error, f"{driver}:{address}") from error
        return cls(name or NAMES[known.kind], driver, keys)

    @classmethod
    def parse(cls, text: str) -> "NewDevice":
        """NAME=DRIVER or NAME=DRIVER:ADDRESS."""
        name, equals, rest = text.partition("=")
        driver, _, address = rest.partition(":")
        right = equals and driver and name.replace("-", "").replace("_", "").isalnum()
        check(bool(right), "NAME=DRIVER or NAME=DRIVER:ADDRESS, as tip=optoforce:/dev/ttyACM0", text)
        return cls.of(driver, address, name=name)


def example_rig() -> str:
    """A rig file with every section, and comments."""
    return (resources.files("deformscope") / "lab" / "rig-example.toml").read_text(encoding="utf-8")


def rig_text(devices: Sequence[NewDevice]) -> str:
    """A rig file with these devices, and the example's sections for them."""
    head, *parts = re.split(r"(?m)^(?=\[)", example_rig())
    examples = {part[1 : part.index("]")]: part for part in parts}
    kinds, names, text = {DRIVERS[one.driver].kind for one in devices}, set[str](), [head]
    for one in devices:
        name = next(name for number in range(1, 99) if (name := f"{one.name}{number}".removesuffix("1")) not in names)
        names.add(name)
        driver = DRIVERS[one.driver]
        text.append(lines_of({f"devices.{name}": {"driver": one.driver, **one.keys}}) + "\n")
        if lacking := driver.lacks(driver.config(**one.keys)):
            text.append(f"# it lacks {lacking}\n")
        text += (f"# {line.lstrip('# ')}\n" for line in _further(examples, one))
        text.append("\n")
        if driver.kind == "depth":
            examples["camera"] = examples["camera"].replace('device = "depth"', f'device = "{name}"')
    text += (examples[section] for section, needed in NEEDS.items() if needed <= kinds)
    return "".join(text)


def _further(examples: dict[str, str], device: NewDevice) -> list[str]:
    """The other keys of a device in the example, if it has one with this driver."""
    mine = f'driver = "{device.driver}"'
    (section, *_) = [*(one for one in examples.values() if mine in one.splitlines()), ""]
    given = ("[", "driver ", "port ", "bus ", *(f"{key} " for key in device.keys))
    return [line for line in section.splitlines() if line.strip() and not line.startswith(given)]
