"""A hand's tactile arrays as the force sensor of the arm that carries it, with the interface for `Robot`."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope_drivers.clock import Stamp
from deformscope_drivers.dsa import Dsa, TactileReading
from deformscope_drivers.dsa.scene import TEXEL_PITCH_MM
from deformscope_drivers.health import Health, Link
from deformscope_drivers.sdh.kinematics import FINGERS
from deformscope_drivers.subscription import Subscription

TEXEL_M2 = (TEXEL_PITCH_MM * 1e-3) ** 2
"""Area of one texel, from its assumed pitch. Larger, the arm stops earlier."""
PADS_HZ = 11.0
"""Frames a second of all arrays at worst, on the controller's serial line; in the air, where they compress, 30."""


@dataclass(frozen=True, slots=True, eq=False)
class FingertipReading:
    """force_n: (1, 3) sum of each finger's arrays [N], one finger per axis; counts: the controller's time, which
    advances although arrays in the air may all read 0"""

    stamp: Stamp
    force_n: FloatArray
    counts: Hashable
    usable: bool = True


@dataclass(frozen=True, slots=True)
class PadRate:
    """rate_hz: rate of the arrays' frames"""

    rate_hz: float


class FingertipForce:
    """pads: the opened arrays, two for each finger in the controller's order; squeezing: the squeeze supervisor judges
    the fingers' forces, which are no push on the arm. They then read 0; silence and equal frames are still reported"""

    def __init__(self, pads: Dsa, *, squeezing: bool = False) -> None:
        self._pads, self._squeezing = pads, squeezing
        self.config = PadRate(PADS_HZ)

    @property
    def link(self) -> Link:
        return self._pads.link

    @property
    def damaged(self) -> int:
        return self._pads.damaged

    def health(self) -> Health:
        return self._pads.health()

    def readings(self) -> "_Queue":
        """Return all readings from now on."""
        return _Queue(self._pads.readings(), self._force)

    def _force(self, reading: TactileReading) -> FingertipReading:
        force_n = np.zeros(len(FINGERS))
        if not self._squeezing:
            sums_n = [float(pressure.sum()) * TEXEL_M2 for pressure in self._pads.pressure_pa(reading)]
            force_n = np.array(sums_n).reshape(len(FINGERS), -1).sum(axis=1)
        return FingertipReading(reading.stamp, force_n[None], reading.stamp.device_ticks)


class _Queue:
    """A reader's queue whose items are forces."""

    def __init__(
        self, queue: Subscription[TactileReading], force: Callable[[TactileReading], FingertipReading]
    ) -> None:
        self._queue, self._force = queue, force

    def take(self) -> list[FingertipReading]:
        return [self._force(one) for one in self._queue.take()]

    def close(self) -> None:
        self._queue.close()
