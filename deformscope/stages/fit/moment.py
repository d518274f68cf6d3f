"""One frame of a motion: positions of its particles, and the parameters that were fitted to them."""

from dataclasses import dataclass

from deformscope.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class MomentFit:
    """Particles at one time, and the parameter fitted to this pose alone.

    rest_px, observed_px, simulated_px: (K, 2) positions at rest, as seen, as simulated with `value` (NaN without a fit)
    [px]; seen: (K,) whether the flow followed it; held: (n,) particles whose motion is prescribed
    noise_px: (K,) one standard deviation of each observed coordinate [px]
    parameter: its name; value, interval: NaN without a fit; verdict, verdict_text: as in any estimate, or why
    there is none; aee_px: mean error over all seen particles (Thesis eq. 3.18) [px]
    explained: share of the motion beyond a rigid one that the model explains"""

    rest_px: FloatArray
    observed_px: FloatArray
    simulated_px: FloatArray
    seen: BoolArray
    held: IntArray
    noise_px: FloatArray
    parameter: str
    value: float = float("nan")
    interval: tuple[float, float] = (float("nan"), float("nan"))
    verdict: str = "unidentified"
    verdict_text: str = ""
    aee_px: float = float("nan")
    explained: float = float("nan")
