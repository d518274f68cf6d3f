"""What deformscope needs of KUKA's driver."""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any

from deformscope_drivers.device import Device
from deformscope_drivers.interface import DeviceDriver, Scene
from deformscope_drivers.kuka.config import CHAINS, KukaConfig
from deformscope_drivers.kuka.device import open_kuka
from deformscope_drivers.kuka.double import KukaDouble
from deformscope_drivers.kuka.port import UdpWire, free_port
from deformscope_drivers.wires import LOOPBACK


@contextlib.contextmanager
def _simulated(config: KukaConfig, scene: Scene | None) -> Iterator[Device[Any]]:
    port = free_port()
    with UdpWire(KukaDouble(config.model, cycle_s=config.cycle_s, again_s=0.5), port):
        yield open_kuka(dataclasses.replace(config, address=LOOPBACK, port=port, controller=""))


DRIVER = DeviceDriver("arm", KukaConfig, open_kuka, simulated=_simulated, chains=lambda: CHAINS)
