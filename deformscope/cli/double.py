"""`deformscope double`: simulated devices on real transports, for users without hardware."""

import contextlib
from typing import Any

from deformscope.cli.common import say
from deformscope.config import DoubleConfig
from deformscope.errors import InputError
from deformscope.lab.double_device import wire_of
from deformscope.rig.rig_file import load_rig
from deformscope.terminal import until_interrupted
from deformscope_drivers.doubles import announced
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.wires import Wire

SHARED_BUS, FIRST_PORT = "udp_multicast:239.74.163.2", 43113
"""A CAN bus that other processes of this host reach."""


def run(config: DoubleConfig) -> None:
    """Run doubles until Ctrl-C, and print the rig that reaches them."""
    if not config.what:
        raise InputError("drivers to double", "none", "deformscope double optoforce dsa, or lab:bench")
    wanted: list[tuple[str, str, Any]] = []  # name, driver and configuration of each
    for word in config.what:
        if word in DRIVERS:
            number = sum(driver == word for _, driver, _ in wanted)
            wanted.append((word if not number else f"{word}-{number + 1}", word, DRIVERS[word].config()))
            continue
        rig = load_rig(word)
        wired = [d for d in rig.devices if d.driver.double]
        if others := [d.name for d in rig.devices if d not in wired]:
            say(f"{', '.join(others)}: simulated only within a command, by double = true in the rig file")
        if not wired:
            raise InputError(f"a rig with devices of {_wired()}", "none", where=word)
        wanted += [(d.name, d.driver.name, d.config) for d in wired]
    with until_interrupted() as asked, contextlib.ExitStack() as stack:
        running: list[tuple[str, str, Wire]] = []
        for name, driver, settings in wanted:
            if DRIVERS[driver].double is None:
                raise InputError(f"drivers with a byte protocol: {_wired()}; a rig file; or lab:NAME", repr(driver))
            bus = f"{SHARED_BUS}?port={FIRST_PORT + len(running)}"
            running.append((name, driver, stack.enter_context(wire_of(driver, settings, bus))))
        for name, driver, wire in running:
            stack.enter_context(announced(driver, wire.port, name))
            key = "bus" if wire.is_bus else "port"
            print(f'[devices.{name}]\ndriver = "{driver}"\n{key} = "{wire.port}"\n', flush=True)
        say("doubles are running: Ctrl-C ends them")
        asked.wait(config.seconds)


def _wired() -> str:
    """Drivers with a byte-exact double."""
    return ", ".join(driver.name for driver in DRIVERS.of_kind() if driver.double)
