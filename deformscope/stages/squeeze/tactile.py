"""The tactile feature of a squeeze: 36 cells of each of two fingertip arrays, in counts (Thesis 5.1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError

CELLS = 36
"""6x6 of each array."""
End = Literal["first", "last"]


def tactile_feature(arrays: Sequence[npt.NDArray[np.generic]], end: End = "first") -> FloatArray:
    """(36 n,) cells at one end of each of n fingertip arrays (rows, columns), row by row, float64.

    end: the first 36 as the controller sends them, as in the thesis, or the last. It is not published which of the two
    ends is at the fingertip: touch one and look in `deformscope live`."""
    short = [array.size for array in arrays if array.size < CELLS]
    if short:
        raise InputError(f"arrays of {CELLS} cells or more", f"{short[0]}")
    cells = [np.asarray(array, np.float64).ravel() for array in arrays]
    return np.concatenate([one[:CELLS] if end == "first" else one[-CELLS:] for one in cells])


def series_of(time_s: FloatArray, features: FloatArray, step_s: float = 0.1) -> tuple[FloatArray, FloatArray]:
    """The feature over a squeeze: (k,) times 0, 0.1, 0.2... [s] until the last frame, and (k, p) the newest features
    then.

    time_s: (n,) times of the frames since first contact, rising; features: (n, p) features of each. Raises InputError
    without any frame at or after first contact."""
    if not len(time_s) or not time_s[-1] >= 0.0:
        raise InputError("tactile frames after first contact", "none")
    steps = np.arange(int(np.floor(float(time_s[-1]) / step_s + 1e-9)) + 1) * step_s
    newest = np.maximum(np.searchsorted(time_s, steps + 1e-9, side="right") - 1, 0)
    return steps, np.asarray(features, np.float64)[newest]
