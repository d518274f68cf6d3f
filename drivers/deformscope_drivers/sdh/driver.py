"""What deformscope needs of the hand's driver."""

from typing import Any

from deformscope_drivers.doubles import Double
from deformscope_drivers.errors import ProtocolViolation
from deformscope_drivers.framing import FrameDecoder
from deformscope_drivers.interface import DeviceDriver, Redecoder, Scene
from deformscope_drivers.sdh import protocol
from deformscope_drivers.sdh.config import SdhConfig
from deformscope_drivers.sdh.device import Sdh
from deformscope_drivers.sdh.double import Port, SdhDouble
from deformscope_drivers.sdh.measurer import HandMeasurer


class SdhAgain(Redecoder):
    """Decodes the bytes of a hand: a reading consists of its answers with states, velocities and, last, angles."""

    late_answers = True
    compares = ("position_deg", "velocity_deg_s", "temperature_c", "state")

    def begin(self) -> FrameDecoder[Any]:
        self._measurer = HandMeasurer(self.name)
        self.listening = False  # what the line holds at first is dropped
        return protocol.Decoder(checksummed=self.config.checksummed())

    def send(self, data: bytes) -> None:
        self.listening |= data != protocol.END_OF_COMMAND

    def measure(self, event: Any, host_ns: int) -> Any:
        try:
            return self._measurer.measure(event, host_ns)
        except ProtocolViolation:  # states that are not known: the driver refused the reading too
            return None


GRASP_PERIOD_NS = 4_000_000_000
OPEN_DEG = (0.0, -30.0, 10.0, -30.0, 10.0, -30.0, 10.0)
CLOSED_DEG = (0.0, 5.0, 40.0, 5.0, 40.0, 5.0, 40.0)
GRASP_DEG_S = 40.0


class GraspingHand(SdhDouble):
    """A hand that another operator closes and opens, every 4 s in turn."""

    def __init__(self, port: Port) -> None:
        super().__init__(port)
        self._turn_ns: int | None = None
        self._closes = True

    def due(self, now_ns: int) -> bytes:
        sent = super().due(now_ns)
        if self._turn_ns is None or now_ns >= self._turn_ns:
            self._turn_ns = now_ns + GRASP_PERIOD_NS
            for axis in range(len(OPEN_DEG)):
                self.motion.power(axis, True)
            self.motion.advance(now_ns)
            self.motion.start(CLOSED_DEG if self._closes else OPEN_DEG, [GRASP_DEG_S] * len(OPEN_DEG))
            self._closes = not self._closes
        return sent


def _double(config: SdhConfig, scene: Scene | None) -> Double:
    return GraspingHand(Port.RS232 if config.checksummed() else Port.CAN)


DRIVER = DeviceDriver("hand", SdhConfig, Sdh, double=_double, redecoder=SdhAgain, probed=True)
