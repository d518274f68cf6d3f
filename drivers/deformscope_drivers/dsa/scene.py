"""Contacts of a simulated tactile hand: pressures on its pads as a function of time."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from deformscope_drivers.dsa.messages import MatrixInfo

Scene = Callable[[float], Sequence[npt.NDArray[np.float64]]]
"""Time since power-up [s] -> for each matrix the pressure on its texels (rows, columns) [Pa]."""

TEXEL_PITCH_MM = float(np.float32(3.4))
"""An assumption: no public source gives the SDH's pitch. A real controller reports its own."""

ROWS_PROXIMAL, ROWS_DISTAL, COLUMNS = 14, 13, 6
"""That the proximal pads are the longer ones is an assumption too; the sizes are public."""

GRASP_PERIOD_S = 8.0
GRASP_PRESSURE_PA = 2400.0


def sdh_matrices() -> list[MatrixInfo]:
    """The six matrices of an SDH, as its controller might describe them."""
    zero = (0.0, 0.0, 0.0)
    return [
        MatrixInfo(0, TEXEL_PITCH_MM, TEXEL_PITCH_MM, COLUMNS, rows, bytes([i]) * 6, bytes(2), 1, zero, zero, 0.0, 0)
        for i, rows in enumerate((ROWS_PROXIMAL, ROWS_DISTAL) * 3)
    ]


class GraspScene:
    """A hand that closes on something round and opens, again and again.

    Each pad is pressed by a patch that grows, drifts and shrinks: the distal pads first and most. At time 0 there is no
    contact. shapes: (rows, columns) shapes of each matrix; seed: where the patches are"""

    def __init__(self, shapes: Sequence[tuple[int, int]], seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        self._grids = [np.mgrid[0:rows, 0:columns].astype(np.float64) for rows, columns in shapes]
        self._middles = [np.array(shape) * random.uniform(0.3, 0.6, 2) for shape in shapes]
        self._phases = random.uniform(0.0, 2 * math.pi, len(shapes))

    def __call__(self, time_s: float) -> list[npt.NDArray[np.float64]]:
        closing = math.sin(math.pi * time_s / GRASP_PERIOD_S) ** 2
        return [self._pad(index, closing, time_s) for index in range(len(self._grids))]

    def _pad(self, index: int, closing: float, time_s: float) -> npt.NDArray[np.float64]:
        """(rows, columns) pressure on a pad [Pa]."""
        distal = index % 2 == 1
        held = max(0.0, closing - (0.1 if distal else 0.5)) / (0.9 if distal else 0.5)
        drift = 0.8 * np.array([math.sin(0.7 * time_s + self._phases[index]), math.cos(0.5 * time_s)])
        row, column = self._grids[index] - (self._middles[index] + drift)[:, None, None]
        # a ball's pressure on something soft (Hertz): an ellipse over the patch, whose size grows with the load
        reach = 0.5 + 2.5 * math.sqrt(held)
        inside = np.clip(1.0 - (row**2 + column**2) / reach**2, 0.0, None)
        pressure: npt.NDArray[np.float64] = GRASP_PRESSURE_PA * (1.0 if distal else 0.6) * math.sqrt(held) * inside**0.5
        return pressure
