"""What a DAQ's reading comes to: forces where a sensitivity report is known, counts otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope_drivers.clock import Stamp
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.optoforce.counter import CounterStep
from deformscope_drivers.optoforce.protocol import Kind, Status

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ForceMeasurement:
    """Loads on all channels at one moment, in each sensor's own frame. Positive Fz is compression, as far as is known.

    stamp: arrival, with the DAQ's counter (u16, wraps) as ticks
    status: of DAQ and sensors; counts: (channels, axes) as sent
    per_count: (channels, axes) what a count is worth [N], [N m]; None = no sensitivity report was given
    offset_counts: (channels, axes) subtracted here, because the DAQ has lost the zero point that it was given
    lost_before: readings missing right before this one; negative where that many, counted as missing before, were not
    follows: what the counter says of it
    doubts: why it is not to be believed: `status` and `load` are beyond what can be, `counter` and `kind` do not follow
    what came before, `zero` = it came while the zero point was changed or may have been lost
    """

    stamp: Stamp
    kind: Kind
    status: Status
    counts: tuple[tuple[int, ...], ...]
    per_count: FloatArray | None = None
    offset_counts: FloatArray | None = None
    lost_before: int = 0
    follows: CounterStep = CounterStep.NEXT
    doubts: tuple[str, ...] = ()

    @property
    def load(self) -> FloatArray:
        """(channels, axes) forces [N] and torques [N m]. Raises DeviceError without a sensitivity report."""
        if self.per_count is None:
            raise DeviceError(
                "a sensitivity report, with what a count is worth",
                "none that fits this sensor: it differs from sensor to sensor",
                "OptoforceConfig(sensitivity=Sensitivity(counts_at_nominal=..., nominal=...)); counts need none",
            )
        counts = np.array(self.counts, float)
        if self.offset_counts is not None:
            counts -= self.offset_counts
        return counts * self.per_count

    @property
    def force_n(self) -> FloatArray:
        """(channels, 3) Fx Fy Fz [N]. Raises DeviceError without a sensitivity report."""
        return self.load[:, :3]

    @property
    def torque_nm(self) -> FloatArray | None:
        """(channels, 3) Tx Ty Tz [N m]; None for a sensor that measures none. Raises as `force_n` does."""
        return self.load[:, 3:] if self.kind is Kind.SIX_AXIS else None

    @property
    def overload(self) -> tuple[str, ...]:
        """The overloaded axes, of `fx fy fz tx ty tz`."""
        return self.status.overload

    @property
    def usable(self) -> bool:
        """DAQ and sensor are well, and nothing speaks against the reading; it may be overloaded."""
        return self.status.usable and not self.doubts
