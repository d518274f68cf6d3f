"""What deformscope needs of KUKA's driver."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from deformscope_drivers.clock import Clock
from deformscope_drivers.device import Device
from deformscope_drivers.interface import ArmInLab, DeviceDriver, FloatArray, Scene
from deformscope_drivers.kuka.config import CHAINS, KukaConfig, controller_files
from deformscope_drivers.kuka.device import Kuka, open_kuka
from deformscope_drivers.kuka.double import KukaDouble
from deformscope_drivers.kuka.port import UdpWire, free_port
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.wires import LOOPBACK


@contextlib.contextmanager
def _simulated(config: KukaConfig, scene: Scene | None) -> Iterator[Device[Any]]:
    port = free_port()
    with UdpWire(KukaDouble(config.model, cycle_s=config.cycle_s, again_s=0.5), port):
        yield open_kuka(dataclasses.replace(config, address=LOOPBACK, port=port, controller=""))


def _in_lab(config: KukaConfig, start_deg: FloatArray | None, clock: Clock) -> ArmInLab:
    """On the host's clock behind a port of this host, and answered as a controller is."""
    double = KukaDouble(config.model, start_deg=start_deg, cycle_s=config.cycle_s, again_s=0.5)
    double.sends_currents = True
    if isinstance(clock, SimulatedClock):
        way = MemoryTransport(double, clock, "simulated KUKA")
        faults: dict[str, Callable[[], None]] = {
            "arm-cable": way.unplug,
            "arm-silent": partial(setattr, double, "running", False),
            "arm-frozen": partial(setattr, double, "frozen", True),
        }
        return ArmInLab(Kuka(config, way, clock=clock), double, faults=faults)
    port = free_port()
    here = dataclasses.replace(config, address=LOOPBACK, port=port, controller="")
    return ArmInLab(open_kuka(here), double, UdpWire(double, port))


DRIVER = DeviceDriver(
    "arm",
    KukaConfig,
    open_kuka,
    simulated=_simulated,
    chains=lambda: CHAINS,
    in_lab=_in_lab,
    controller_files=controller_files,
)
