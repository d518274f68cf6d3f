"""A material's axes from pairs: a beta along each, and whether a single one is sufficient."""

from dataclasses import dataclass, field
from typing import ClassVar

from deformscope.arrays import FloatArray
from deformscope.results.render import ReportedResult, derived, reported
from deformscope.stages.fit.estimate import Doubt, Identifiability, LengthUnit, Verdict, converged_text, explained_text

SEEN_SDS = 3.0
"""Number of its standard deviations from which a strain counts as observed."""

ACROSS_VIEW = "one view, or a plane of particles, shows nothing along the third axis: film from another side, or in 3D"


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisEstimate(ReportedResult):
    """Betas along the axes of a material (linear clusters, theta = 0).

    axes: (d, d) columns; value: (d,); interval: (d, 2) interval at `level`; correlation: (d, d) correlation of -log(1 -
    beta); verdict: (d,) verdict of each, as for one beta; reasons: (d,) reasons to doubt each, including those that
    concern all; anisotropic: one beta for all axes is ruled out (p_isotropic below 1 %)
    beta: the best single one, and p_isotropic: probability of this additional error if it were true
    identifiability: (d,) identifiability of each axis, its rise with fixed betas along the others
    aee, aee_isotropic: average Euclidean error over all observed particles [unit] (Thesis eq. 3.18)
    strain: (d,) mean strain along each axis, of all observations, and strain_sd: (d,) its standard deviation by noise
    unit, metres_per_unit: unit and scale of all lengths; None: not known"""

    parameter: ClassVar[str] = "beta"

    @property
    @derived(key="axes")
    def by_axis(self) -> list[dict[str, object]]:
        """Results of each axis."""
        each = zip(self.axes.T, self.value, self.interval, self.verdict, self.reasons, strict=True)
        return [dict(zip(("axis", "value", "interval", "verdict", "reasons"), one, strict=True)) for one in each]

    axes: FloatArray
    value: FloatArray
    interval: FloatArray
    level: float = field(metadata=reported())
    correlation: FloatArray = field(metadata=reported())
    verdict: tuple[Verdict, ...]
    reasons: tuple[tuple[Doubt, ...], ...]
    identifiability: tuple[Identifiability, ...]
    anisotropic: bool = field(metadata=reported())
    p_isotropic: float = field(metadata=reported())
    beta: float = field(metadata=reported("one beta", key="isotropic_beta", digits=".4g"))
    aee: float = field(metadata=reported(length=True))
    aee_isotropic: float = field(metadata=reported(length=True))
    noise: float = field(metadata=reported("noise of a position", length=True))
    strain: FloatArray = field(metadata=reported())
    strain_sd: FloatArray = field(metadata=reported())

    @property
    @derived(key="pressed_axis")
    def pressed(self) -> int | None:
        """The axis along which the material was shortened most; None where along none."""
        return self._most(-self.strain)

    @property
    @derived(key="bulging_axis")
    def bulges(self) -> int | None:
        """The axis along which it became longer by most; None where along none."""
        return self._most(self.strain)

    @property
    @derived()
    def across_view(self) -> dict[str, str] | None:
        """Results along the third axis, if one view or a plane shows nothing of it."""
        return {"verdict": "unidentified", "text": ACROSS_VIEW} if len(self.value) == 2 else None

    @property
    @derived("explained", words=lambda found: explained_text(found.explained, found.reasons[0]))
    def explained(self) -> float:
        """Share of the motion beyond a rigid one that the betas explain."""
        return self.identifiability[0].explained

    @property
    @derived(key="identifiability")
    def identifiability_json(self) -> dict[str, object]:
        """How far the data separate the betas."""
        return {"rise_sd": [one.rise for one in self.identifiability], "explained": self.explained}

    converged: bool = field(metadata=reported("converged", words=converged_text))
    settings: dict[str, object] = field(metadata=reported())
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0

    def _most(self, strain: FloatArray) -> int | None:
        most = int(strain.argmax())
        return most if strain[most] > SEEN_SDS * self.strain_sd[most] else None
