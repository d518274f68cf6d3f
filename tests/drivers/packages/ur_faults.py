"""A moving UR to which something happens: when the velocity that its program asks for is zero, for good.

On a simulated clock; model, rates, moment and fault of each run are drawn from its seed."""

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from deformscope_ur import Ur, UrConfig, UrDouble, rtde
from deformscope_ur.config import CHAINS, RTDE
from deformscope_ur.device import SILENCE_S

from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.memory import SimulatedClock
from tests.drivers.packages.ur_memory import MemoryPorts

ZERO_S = 0.02
"""From a report of the fault until the velocity is zero: two control periods."""
STEP_S = 0.001


def _spoil(double: UrDouble, name: str, value: float) -> None:
    """From now on a register has another value than the one that was sent."""
    take = double.take
    double.take = lambda values, now_ns: take(values | {name: value}, now_ns)  # type: ignore[method-assign]


FAULTS: dict[str, Callable[[UrDouble, MemoryPorts, np.random.Generator], object]] = {
    "protective stop": lambda double, ports, random: double.protective_stop(),
    "emergency stop": lambda double, ports, random: double.emergency_stop(),
    "program paused": lambda double, ports, random: double.pause(),
    "program ended": lambda double, ports, random: double.end_program(),
    "another program": lambda double, ports, random: double.load(
        "def p():\n  while True:\n    speedj([0, 0, 0, 0, 0, 0], 1, 0.1)\n  end\nend\n", double.next_ns(0)
    ),
    "speed slider": lambda double, ports, random: setattr(double, "slider", random.uniform(0.02, 0.9)),
    "arm off": lambda double, ports, random: setattr(double, "robot_mode", 3),
    "gain": lambda double, ports, random: setattr(double, "gain", random.uniform(3.0, 10.0)),
    "cable": lambda double, ports, random: ports.unplug(),
    "silent controller": lambda double, ports, random: setattr(double, "silent", True),
    "register lag": lambda double, ports, random: setattr(double, "lag_s", random.uniform(0.2, 1.0)),
    "too fast": lambda double, ports, random: _spoil(double, "input_double_register_44", 1.5),
    "not a number": lambda double, ports, random: _spoil(double, "input_double_register_47", math.nan),
    "another session": lambda double, ports, random: _spoil(double, "input_int_register_43", 5),
    "driver stalls": lambda double, ports, random: None,
}
UNREPORTED = ("cable", "silent controller", "register lag", "driver stalls")
"""Faults that the script alone sees, as a heartbeat that stands still."""
BEFORE: dict[str, Callable[[UrDouble], object]] = {
    "local control": lambda double: setattr(double, "remote", False),
    "protective stop": lambda double: double.protective_stop(),
    "emergency stop": lambda double: double.emergency_stop(),
    "speed slider": lambda double: setattr(double, "slider", 0.2),
    "arm off": lambda double: setattr(double, "robot_mode", 3),
    "brakes closed": lambda double: setattr(double, "robot_mode", rtde.IDLE),
    "registers in use": lambda double: double.connection(RTDE).receive(
        rtde.input_request(("input_double_register_45",)).encode(), 0
    ),
    "another program": lambda double: (
        double.load("def p():\n  while True:\n    speedj([0, 0, 0, 0, 0, 0], 1, 0.1)\n  end\nend\n", 0),
        double.live(1_000_000_000),
    ),
    "another arm": lambda double: setattr(double, "chain", CHAINS["ur10" if double.chain.name == "ur3" else "ur3"]),
    "silent controller": lambda double: setattr(double, "silent", True),
}
"""Faults before an arm is opened."""


@dataclass(frozen=True, slots=True)
class UrFault:
    """fault: a key of FAULTS or, `before`, of BEFORE; refused: what opening said; stopped: why the arm is stopped
    zero_s: from the fault until the program's velocity was zero for good; moved: whether any joint moved at all"""

    seed: int
    fault: str
    before: bool
    refused: str
    stopped: str
    zero_s: float
    moved: bool

    @property
    def in_time(self) -> bool:
        """Refused before a motion, or at zero within two control periods of what could be seen."""
        if self.before:
            return bool(self.refused) and not self.moved
        return self.zero_s <= ZERO_S + (SILENCE_S if self.fault in UNREPORTED else 0.0)


def run_fault(seed: int) -> UrFault:
    """One arm that is opened and moved, and one fault at a random moment or before."""
    random = np.random.default_rng([seed, 0x0E])
    model = str(random.choice(list(CHAINS)))
    state_hz = float(random.choice([100.0, 125.0, 250.0])) if model.endswith("e") else 125.0
    config = UrConfig(model=model, state_hz=state_hz, own_process=False)
    clock = SimulatedClock(1_000_000_000)
    double = UrDouble(config)
    ports = MemoryPorts(double, clock)
    arm = Ur(config, ports, clock=clock)
    before = seed % 4 == 0
    fault = str(random.choice(list(BEFORE if before else FAULTS)))
    if fault == "local control" and not double.e_series:  # which a CB3 does not have
        fault = "arm off"
    start_deg, found = double.joints_deg, None
    if before:
        BEFORE[fault](double)
        refused = ""
        try:
            arm.open(own_thread=False)
        except DeviceError as error:
            refused = str(error)
        return UrFault(seed, fault, True, refused, "", math.nan, bool(np.any(double.joints_deg != start_deg)))
    with contextlib.suppress(DeviceError), arm.open(own_thread=False):  # of a cable that is out as it closes
        rates = JointVelocity(tuple(random.uniform(2.0, 18.0, 6) * random.choice([-1.0, 1.0], 6)))
        moment_s, after_s = random.uniform(0.1, 0.6), 0.4
        at_ns = clock() + round(moment_s * 1e9)
        zero_ns, struck, stalled = 0, False, False
        while clock() < at_ns + round(after_s * 1e9):
            if not struck and clock() >= at_ns:
                FAULTS[fault](double, ports, random)
                struck, stalled = True, fault == "driver stalls"
            if not stalled:
                with contextlib.suppress(DeviceError):
                    arm.set_velocity(rates, 0.1)
                with contextlib.suppress(DeviceError):
                    arm.poll(0.0)
            clock.advance_to(clock() + round(STEP_S * 1e9))
            double.live(clock())
            if np.any(double.commanded_deg_s):
                zero_ns = clock()
        moved = bool(np.any(double.joints_deg != start_deg))
        found = UrFault(seed, fault, False, "", arm.stopped_because, (zero_ns - at_ns) / 1e9, moved)
    assert found is not None, f"seed {seed}: not opened"
    return found
