"""What a calibration says: the parameter, its interval, the verdicts, and the evidence they rest on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deformscope.arrays import BoolArray, FloatArray, IntArray

Parameter = Literal["beta", "theta"]
Verdict = Literal["identified", "weak", "at-bound", "unidentified"]
LengthUnit = Literal["m", "px"]


@dataclass(frozen=True, slots=True)
class Curve:
    """The error over the parameter.

    parameter: (n,) values tried, rising; aee: (n,) average Euclidean error there [the estimate's unit], NaN where
    the simulation did not stay finite
    """

    parameter: FloatArray
    aee: FloatArray


@dataclass(frozen=True, slots=True)
class Estimate:
    """One calibrated parameter with everything needed to judge it (Thesis eq. 3.18, 3.19, Algorithms 2 and 3).

    value: the parameter with the lowest error; interval: at `level`, always holds `value`; one-sided at a bound
    bounds: the range that was searched
    verdict: on the parameter; stiffness_verdict: on stiffness, which position alone cannot tell
    aee: mean error over all observed particles, held ones included (eq. 3.18); aee_free: over the free ones alone
    nearest: one-sided nearest-neighbour error (eq. 4.6); unit: of every length here
    converged: every simulation that the value and the interval rest on reached its static state
    """

    parameter: Parameter
    value: float
    interval: tuple[float, float]
    level: float
    bounds: tuple[float, float]
    verdict: Verdict
    stiffness_verdict: Verdict
    aee: float
    aee_free: float
    nearest: float
    unit: LengthUnit
    curve: Curve
    converged: bool
    settings: dict[str, object]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Observed and simulated particles of one moment, at the best parameter.

    rest, observed, simulated: (K, d) positions [unit]; seen: (K,) whether `observed` was measured;
    held: (n,) indices of the particles whose position was prescribed
    """

    rest: FloatArray
    observed: FloatArray
    simulated: FloatArray
    seen: BoolArray
    held: IntArray
    unit: LengthUnit
