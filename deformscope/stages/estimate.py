"""What a calibration says: the parameter, its interval, the verdicts, and the evidence they rest on."""

from __future__ import annotations

import math
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
    stiffness: the energy's stiffness k and its interval over `interval` [N/m], where a force was given
    metres_per_unit: the scale of the lengths; None where pixels have no known size
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
    stiffness: tuple[float, tuple[float, float]] | None = None
    metres_per_unit: float | None = 1.0

    def as_json(self) -> dict[str, object]:
        """The public form of an estimate. Lengths are in metres where the scale is known, and in pixels too where
        they were measured in an image; what is not known is null."""
        metres = self.metres_per_unit

        def in_metres(length: float) -> float | None:
            return None if metres is None else length * metres

        def in_pixels(length: float) -> float | None:
            return length if self.unit == "px" else None

        aee = self.curve.aee if metres is None else self.curve.aee * metres
        found: dict[str, object] = {
            "parameter": self.parameter,
            "value": self.value,
            "interval": list(self.interval),
            "level": self.level,
            "bounds": list(self.bounds),
            "verdict": self.verdict,
            "stiffness_verdict": self.stiffness_verdict,
            "aee_m": in_metres(self.aee),
            "aee_free_m": in_metres(self.aee_free),
            "nearest_m": in_metres(self.nearest),
            "aee_px": in_pixels(self.aee),
            "aee_free_px": in_pixels(self.aee_free),
            "nearest_px": in_pixels(self.nearest),
            "curve": {
                "parameter": [float(v) for v in self.curve.parameter],
                "aee": [float(v) if math.isfinite(v) else None for v in aee],
                "unit": "px" if metres is None else "m",
            },
            "converged": self.converged,
            "settings": self.settings,
        }
        if self.stiffness is not None:
            found["stiffness_n_per_m"] = {"value": self.stiffness[0], "interval": list(self.stiffness[1])}
        return found


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
