"""What deformscope needs of the driver of tactile pads."""

from types import SimpleNamespace
from typing import Any

from deformscope_drivers.doubles import Double
from deformscope_drivers.dsa.config import DsaConfig
from deformscope_drivers.dsa.device import Dsa
from deformscope_drivers.dsa.double import DsaDouble
from deformscope_drivers.dsa.measurer import TactileMeasurer, TactileReading
from deformscope_drivers.dsa.messages import Id, MatrixInfo
from deformscope_drivers.dsa.pads import to_pressure
from deformscope_drivers.framing import FrameDecoder
from deformscope_drivers.interface import DeviceDriver, Redecoder, Scene


class DsaAgain(Redecoder):
    """Tactile pads."""

    compares = ("counts", "pressure_pa")

    def begin(self) -> FrameDecoder[Any]:
        self._described, self._shapes = 0, [(pad.rows, pad.columns) for pad in self.said.pads]
        self._measurer = TactileMeasurer()
        return self._measurer.connect()

    def send(self, data: bytes) -> None:
        if len(data) > 3 and data[3] == Id.ACQUISITION:
            self._measurer.begin_stream()

    def measure(self, event: Any, host_ns: int) -> Any:
        if isinstance(event, MatrixInfo):
            self._described += 1
            if self._described == len(self._shapes):
                self._measurer.describe(self._shapes)
        found = self._measurer.measure(event, host_ns)
        return found if isinstance(found, TactileReading) else None

    def device(self) -> Any:
        return SimpleNamespace(pressure_pa=lambda reading: to_pressure(reading.pads, self.config.calibration))


def _double(config: DsaConfig, scene: Scene | None) -> Double:
    return DsaDouble(bytes_per_s=None) if config.port.startswith("socket:") else DsaDouble()


DRIVER = DeviceDriver("tactile", DsaConfig, Dsa, double=_double, redecoder=DsaAgain, probed=True)
