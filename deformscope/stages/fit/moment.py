"""A fit of one moment of something that goes on: where its particles are, and what one parameter must be for that."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class MomentFit:
    """Particles at one moment, and the parameter that the pose at this moment gives, by itself.

    rest_px, observed_px, simulated_px: (K, 2) positions at rest, as seen, as simulated with `value` (NaN without a fit)
    [px]; seen: (K,) whether the flow followed it; held: (n,) particles whose motion is prescribed
    noise_px: (K,) one standard deviation of each observed coordinate [px]
    parameter: beta or theta; value, interval: NaN without a fit; verdict, verdict_text: as of any estimate, or why
    there is none; aee_px: mean error over all seen particles (Thesis eq. 3.18) [px]
    explained: share of the motion beyond a rigid one that the model explains
    """

    rest_px: FloatArray
    observed_px: FloatArray
    simulated_px: FloatArray
    seen: BoolArray
    held: IntArray
    noise_px: FloatArray
    parameter: str
    value: float
    interval: tuple[float, float]
    verdict: str
    verdict_text: str
    aee_px: float
    explained: float
