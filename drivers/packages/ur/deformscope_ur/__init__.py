"""Universal Robots' arms, CB3 and e-Series, through RTDE: `driver = "ur"`."""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from deformscope_drivers.clock import Clock
from deformscope_drivers.interface import ArmInLab, DeviceDriver, FloatArray, Redecoder
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.wires import PortsWire
from deformscope_ur.config import CHAINS
from deformscope_ur.config import UrConfig as UrConfig
from deformscope_ur.config import ur_chain as ur_chain
from deformscope_ur.device import OUTPUTS, open_ur, state_of
from deformscope_ur.device import Ur as Ur
from deformscope_ur.double import UrDouble as UrDouble
from deformscope_ur.rtde import Decoder, Kind, Recipe

GAIN = 3.0
"""Factor on the commanded rates of an arm that turns on its own."""


def _in_lab(config: UrConfig, start_deg: FloatArray | None, clock: Clock) -> ArmInLab:
    double = UrDouble(config, start_deg=start_deg)
    if isinstance(clock, SimulatedClock):
        made: list[MemoryTransport] = []

        def ways(name: str) -> MemoryTransport:
            made.append(MemoryTransport(double.connection(name), clock, name))
            return made[-1]

        faults: dict[str, Callable[[], None]] = {
            "arm-cable": lambda: made[0].unplug(),
            "arm-silent": partial(setattr, double, "silent", True),
            "arm-invalid": lambda: double.report(np.full(6, math.nan)),
            "arm-turns": partial(setattr, double, "gain", GAIN),
            "arm-frozen": lambda: double.report(double.joints_deg),
        }
        return ArmInLab(Ur(config, ways, clock=clock), double, faults=faults)
    wire = PortsWire(double)
    return ArmInLab(open_ur(dataclasses.replace(config, port=wire.bind())), double, wire)


class UrAgain(Redecoder):
    """Decodes the reports of a controller. Those that came while the driver waited for an answer give no frame."""

    late_answers = True
    compares = ("joint_deg", "joint_velocity_deg_s", "position_m", "rotation_rad", "force_n", "torque_nm")

    def begin(self) -> Decoder:
        self._outputs: Recipe | None = None
        self._chain = self.config.chain
        return Decoder()

    def measure(self, event: Any, host_ns: int) -> Any:
        if event.kind is Kind.OUTPUTS:
            self._outputs = Recipe.of_reply(event, OUTPUTS)
        values = self._outputs.unpack(event) if self._outputs is not None else None
        try:
            return values and state_of(values, self._chain, host_ns)
        except (TypeError, ValueError, OverflowError):  # numbers of other types, or none: damaged bytes
            return None


DRIVER = DeviceDriver(
    "arm",
    UrConfig,
    open_ur,
    double=lambda config, scene: UrDouble(config),
    chains=lambda: CHAINS,
    in_lab=_in_lab,
    redecoder=UrAgain,
)
