"""How a tactile controller is reached and set; checked when it is made, before anything is sent."""

from dataclasses import dataclass
from typing import TypeVar

from deformscope_drivers.dsa.messages import TEXEL_MAX
from deformscope_drivers.dsa.pads import SCHUNK_PA_PER_COUNT, Curve
from deformscope_drivers.errors import OutOfLimits
from deformscope_drivers.transport import check_port

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class DsaConfig:
    """How the tactile controller is reached, and how it shall run.

    port: serial port, or URL (`socket://192.168.1.1:13000` for a hand with Ethernet)
    rle: run-length encoded frames, 3 to 12 times shorter; frame_rate_hz: requested (the firmware does not guarantee it)
    sensitivity: 0 to 1, for all matrices or each; None = the controller's present one
    threshold: texels below it read 0, 0 to 4095, for all or each; None = the controller's present one (firmware >= 268)
    calibration: for each matrix, or for all, the pressure of a count [Pa] or a `Curve`
    silence_s: time without a good frame during streaming after which the link is lost, and opened again
    stuck_after_s: pressed texels with equal counts for this long mean a stuck sensor; None = no limit"""

    port: str = ""
    rle: bool = True
    frame_rate_hz: int = 30
    sensitivity: float | tuple[float, ...] | None = None
    threshold: int | tuple[int, ...] | None = None
    calibration: tuple[float | Curve, ...] = (SCHUNK_PA_PER_COUNT,)
    silence_s: float = 3.0
    stuck_after_s: float | None = 10.0

    def __post_init__(self) -> None:
        check_port(self.port)
        if not 1 <= self.frame_rate_hz <= 0xFFFF:
            raise OutOfLimits("a frame rate from 1 to 65535 Hz", f"{self.frame_rate_hz}", where=self.port)
        for sensitivity in each(self.sensitivity):
            if not 0.0 <= sensitivity <= 1.0:
                raise OutOfLimits("a sensitivity from 0 to 1", f"{sensitivity:g}", where=self.port)
        for threshold in each(self.threshold):
            if not 0 <= threshold <= TEXEL_MAX:
                raise OutOfLimits(f"a threshold from 0 to {TEXEL_MAX}", f"{threshold}", where=self.port)


def each(value: T | tuple[T, ...] | None) -> tuple[T, ...]:
    """The values in a setting for all matrices, or for each; none where nothing is set."""
    if value is None:
        return ()
    return value if isinstance(value, tuple) else (value,)
