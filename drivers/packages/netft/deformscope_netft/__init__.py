"""Force sensors over UDP: ATI Net F/T and Axia (`driver = "netft"`), OnRobot HEX (`driver = "onrobot_hex"`)."""

import dataclasses
from typing import Any

from deformscope_drivers.doubles import Double
from deformscope_drivers.framing import FrameDecoder
from deformscope_drivers.interface import DeviceDriver, Redecoder, Scene
from deformscope_netft.config import HexConfig as HexConfig
from deformscope_netft.config import NetftConfig as NetftConfig
from deformscope_netft.device import Measurer
from deformscope_netft.device import NetftSensor as NetftSensor
from deformscope_netft.double import COUNTS_PER_N, COUNTS_PER_NM, NetftDouble
from deformscope_netft.protocol import Calibration, Decoder, Record


class RdtAgain(Redecoder):
    """Decodes the datagrams of a sensor, and its page."""

    compares = ("counts", "force_n", "torque_nm", "overload", "usable")

    def begin(self) -> FrameDecoder[Any]:
        self._measurer = Measurer(self.config)
        return Decoder()

    def measure(self, event: Any, host_ns: int) -> Any:
        if isinstance(event, Calibration):
            self._measurer.learn(event)
        return self._measurer.measure(event, host_ns) if isinstance(event, Record) else None


def _double(config: Any, scene: Scene | None) -> Double:
    return NetftDouble(config, scene)


def _complete(config: NetftConfig) -> NetftConfig:
    """The double has no page."""
    if config.counts_per_n is not None:
        return config
    return dataclasses.replace(config, counts_per_n=COUNTS_PER_N, counts_per_nm=COUNTS_PER_NM, serial="")


NETFT = DeviceDriver("wrench", NetftConfig, NetftSensor, double=_double, redecoder=RdtAgain, complete=_complete)
HEX = DeviceDriver("wrench", HexConfig, NetftSensor, double=_double, redecoder=RdtAgain)
