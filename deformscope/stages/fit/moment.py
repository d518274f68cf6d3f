"""One frame of a motion: positions of its particles, and the parameters that were fitted to them."""

from dataclasses import dataclass

from deformscope.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class MomentFit:
    """Particles at one time, and the parameter fitted to this pose alone.

    rest_px, observed_px, simulated_px: (K, 2) positions at rest, as seen, as simulated with `value` (NaN without a fit)
    [px]; seen: (K,) whether the flow followed it; held: (n,) particles whose motion is prescribed
    noise_px: (K,) one standard deviation of each observed coordinate [px]
    parameter: beta or theta; value, interval: NaN without a fit; verdict, verdict_text: as in any estimate, or why
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


@dataclass(frozen=True, slots=True)
class ParticleMoment:
    """Particles at one moment. rest_px, position_px: (K, 2) positions; a lost particle has its last seen one [px];
    noise_px: (K,) one standard deviation of each coordinate [px]; seen: (K,)"""

    rest_px: FloatArray
    position_px: FloatArray
    noise_px: FloatArray
    seen: BoolArray


@dataclass(frozen=True, slots=True)
class FieldMoment:
    """Relative stiffness of each place at one moment, as in `calibrate field` for a frame.

    place_px: (C, 2) present middles of the cells [px]; spacing_px: spacing of the particles [px]; stiffness:
    (C,) stiffness over the geometric mean of all; interval: (C, 2); determined: (C,) whether it is identified or weak
    ratio, ratio_interval: stiffest over softest; verdict: as in a `FieldEstimate`; explained: share of the motion"""

    place_px: FloatArray
    spacing_px: float
    stiffness: FloatArray
    interval: FloatArray
    determined: BoolArray
    ratio: float
    ratio_interval: tuple[float, float]
    verdict: str
    explained: float
