"""Universal Robots' arms, CB3 and e-Series, through RTDE: `driver = "ur"`."""

import dataclasses

from deformscope_drivers.clock import Clock
from deformscope_drivers.interface import ArmInLab, DeviceDriver, FloatArray
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.wires import PortsWire
from deformscope_ur.config import CHAINS
from deformscope_ur.config import UrConfig as UrConfig
from deformscope_ur.config import ur_chain as ur_chain
from deformscope_ur.device import Ur as Ur
from deformscope_ur.device import open_ur
from deformscope_ur.double import UrDouble as UrDouble


def _in_lab(config: UrConfig, start_deg: FloatArray | None, clock: Clock) -> ArmInLab:
    double = UrDouble(config, start_deg=start_deg)
    if isinstance(clock, SimulatedClock):
        ways = lambda name: MemoryTransport(double.connection(name), clock, name)  # noqa: E731
        return ArmInLab(Ur(config, ways, clock=clock), double)
    wire = PortsWire(double)
    return ArmInLab(open_ur(dataclasses.replace(config, port=wire.bind())), double, wire)


DRIVER = DeviceDriver(
    "arm", UrConfig, open_ur, double=lambda config, scene: UrDouble(config), chains=lambda: CHAINS, in_lab=_in_lab
)
