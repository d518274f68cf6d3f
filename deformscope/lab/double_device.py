"""Doubles that replace devices, for a rig file with `double = true`."""

import contextlib
import itertools
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from deformscope.errors import InputError
from deformscope.processes import child_process
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.device import Device
from deformscope_drivers.interface import DRIVERS, Scene
from deformscope_drivers.wires import Wire, of_any_serial, reaching, wire_for

_numbers = itertools.count(1)


@contextlib.contextmanager
def double_device(driver: str, config: object) -> Iterator[Device[Any]]:
    """A device of this driver, not opened, whose other end is a double that runs until the end of the context.

    config: as for the real device; the double has the address in it, and needs neither hardware nor a CAN interface of
    the kernel"""
    known = DRIVERS[driver]
    config = known.complete(config)
    if known.simulated is not None:
        with known.simulated(of_any_serial(config), scene_of(driver)) as device:
            yield device
    elif getattr(config, "bus", ""):  # python-can's virtual buses are within a process
        with wire_of(driver, config, f"virtual:double-{next(_numbers)}") as wire:
            yield known.make(reaching(config, wire.port, is_bus=wire.is_bus))
    else:
        with _wire_process(driver, config) as port:
            yield known.make(reaching(config, port))


@contextlib.contextmanager
def wire_of(driver: str, config: Any, bus: str) -> Iterator[Wire]:
    """A running double of a byte-stream device. bus: replacement of the CAN bus that the configuration names"""
    make = DRIVERS[driver].double
    assert make is not None
    with wire_for(make(config, scene_of(driver)), config, bus) as wire:
        yield wire


@contextlib.contextmanager
def _wire_process(driver: str, config: object) -> Iterator[str]:
    """The same in a process of its own, as a device does not take this one's time either. Yields its port."""
    with child_process(f"double of {driver}", serve, driver, config) as pipe:
        try:
            port: str = pipe.recv()
        except EOFError as error:
            raise InputError(f"a double of {driver} in a process of its own", "one that ended immediately") from error
        yield port


def serve(pipe: Connection, driver: str, config: object) -> None:
    """Send the port of a running double, and run it until the pipe ends."""
    with wire_of(driver, config, "") as wire, contextlib.suppress(EOFError, OSError):
        pipe.send(wire.port)
        pipe.recv()


def scene_of(driver: str) -> Scene | None:
    """What the doubles of a bench measure: a stick that presses foam now and then. It begins at rest, so that a force
    sensor can be zeroed when it is opened."""
    from deformscope.lab import bench_scene

    begin_s = monotonic_ns() / 1e9 - bench_scene.PRESS_S
    scenes: dict[str, Scene] = {
        "wrench": lambda time_s: (*bench_scene.loads(time_s - begin_s), 0.0, 0.0, 0.0),
        "color": bench_scene.side,
        "depth": bench_scene.view,
    }
    return scenes.get(DRIVERS[driver].kind)
