"""What deformscope needs of OptoForce's driver."""

from dataclasses import replace
from typing import Any

from deformscope_drivers.doubles import Double
from deformscope_drivers.framing import FrameDecoder
from deformscope_drivers.interface import DeviceDriver, Redecoder, Scene
from deformscope_drivers.optoforce import protocol
from deformscope_drivers.optoforce.config import OptoforceConfig
from deformscope_drivers.optoforce.device import Optoforce
from deformscope_drivers.optoforce.double import OMD_20_SE_40N, OptoforceDouble, Sensors
from deformscope_drivers.optoforce.measurement import ForceMeasurer
from deformscope_drivers.optoforce.protocol import Kind
from deformscope_drivers.transport import CAN_FRAME_BYTES


class OptoforceAgain(Redecoder):
    """Decodes the bytes of a force sensor."""

    left_out = "`usable`, which also depends on earlier readings"
    compares: tuple[str, ...] = ("counts", "force_n", "torque_nm", "overload")

    def begin(self) -> FrameDecoder[Any]:
        self._measurer = ForceMeasurer(self.config.sensitivities, self.name)
        return protocol.Decoder(CAN_FRAME_BYTES if self.config.bus else 1)

    def resume(self) -> None:
        if self.config.zero_at_start:  # the zero point that the DAQ has lost is subtracted by the driver
            self.compares = ("counts", "overload")
            self.left_out += ", and forces after the DAQ lost its zero point"

    def measure(self, event: object, host_ns: int) -> Any:
        if not isinstance(event, protocol.Reading):
            return None
        return self._measurer.measure(event, host_ns, self._measurer.follow(event, host_ns))


def _double(config: OptoforceConfig, scene: Scene | None) -> Double:
    """As many sensors, and as sensitive, as the configuration says."""
    sensitivities = _complete(config).sensitivities
    axes = sensitivities[0].axes
    kind = Kind.FOUR_CHANNEL if len(sensitivities) > 1 else Kind.SIX_AXIS if axes == 6 else Kind.THREE_AXIS
    load = scene if scene is not None else lambda time_s: (0.0,) * 6
    return OptoforceDouble(Sensors(kind, lambda time_s: load(time_s)[:axes], sensitivities))


def _complete(config: OptoforceConfig) -> OptoforceConfig:
    return config if config.sensitivities else replace(config, sensitivity=OMD_20_SE_40N)


DRIVER = DeviceDriver(
    "wrench",
    OptoforceConfig,
    Optoforce,
    double=_double,
    redecoder=OptoforceAgain,
    lacks=lambda config: "" if config.sensitivities else "its sensitivity, for forces in newtons (the sensor's report)",
    complete=_complete,
    probed=True,
)
