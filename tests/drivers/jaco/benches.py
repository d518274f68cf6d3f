"""Doubles of the vendor's library on the bench: the one in Python and the one in C, held in the same way."""

import atexit
import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import pytest

from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.jaco.chains import CHAINS
from deformscope_drivers.jaco.double import JacoDouble
from deformscope_drivers.jaco.library import PREFIXES, Connection, Functions, Library
from deformscope_drivers.memory import SimulatedClock
from tests.patience import PATIENCE_S

SOURCE = Path(__file__).with_name("double.c")
DEVICE_TYPES = {"j2n6s300": 3, "j2s6s300": 7, "j2s7s300": 8}
"""Typed from KinovaTypes.h."""


class VendorBench(Protocol):
    """A double whose time the test moves on.

    functions: what the driver is given; chain: its kinematics"""

    functions: Functions
    chain: Chain

    def advance(self, seconds: float) -> None:
        """Let time pass."""

    def inject(self, name: str, code: int, times: int = 1) -> None:
        """Have the next calls of a function return a code."""

    def push(self, wrench: Sequence[float]) -> None:
        """Push the end effector."""


class PythonBench:
    def __init__(self, model: str, cold: bool = False) -> None:
        self.chain = CHAINS[model]
        self.clock = SimulatedClock()
        self.double = JacoDouble(model, self.clock, cold_boot=cold)
        self.functions: Functions = self.double

    def advance(self, seconds: float) -> None:
        self.clock.advance_to(self.clock() + round(seconds * 1e9))

    def inject(self, name: str, code: int, times: int = 1) -> None:
        self.double.inject(name, code, times)

    def push(self, wrench: Sequence[float]) -> None:
        self.double.push(wrench)


@functools.cache
def build(connection: Connection) -> Path:
    """The C double as a shared library; skips the test where there is no compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler; apt-get install gcc")
    folder = Path(tempfile.mkdtemp(prefix="jaco-double-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    target = folder / f"{connection}.so"
    define = ["-DETHERNET"] if connection == "ethernet" else []
    command = [compiler, *define, "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run([*command, "-o", str(target), str(SOURCE), "-lm"], check=True, timeout=PATIENCE_S)
    return target


class CBench:
    def __init__(self, model: str, connection: Connection = "usb", cold: bool = False) -> None:
        self.chain = CHAINS[model]
        self.path = build(connection)
        self.functions: Functions = Library(self.path, connection)
        self.prefix = PREFIXES[connection]
        self.own = ctypes.CDLL(str(self.path))
        self.own.double_reset(DEVICE_TYPES[model], int(cold))

    def advance(self, seconds: float) -> None:
        self.own.double_advance(ctypes.c_double(seconds))

    def real_time(self, on: bool) -> None:
        self.own.double_real_time(int(on))

    def inject(self, name: str, code: int, times: int = 1) -> None:
        self.own.double_inject(name.encode(), code, times)

    def push(self, wrench: Sequence[float]) -> None:
        self.own.double_push((ctypes.c_double * 6)(*wrench))

    def sizeof(self, name: str) -> int:
        return int(self.own.double_sizeof(name.encode()))
