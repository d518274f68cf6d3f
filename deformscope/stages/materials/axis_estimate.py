"""What pairs show of a material's axes: a beta along each, and whether one would do."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope.arrays import FloatArray
from deformscope.stages.fit.estimate import Doubt, Identifiability, LengthUnit, Verdict, lengths

SEEN_SDS = 3.0
"""A strain counts as seen from so many of its deviations on."""

ACROSS_VIEW = "one view, or a plane of particles, shows nothing along the third axis: film from another side, or in 3D"


@dataclass(frozen=True, slots=True)
class AxisEstimate:
    """Betas along the axes of a material (linear clusters, theta = 0).

    axes: (d, d) columns; value: (d,); interval: (d, 2) at `level`; correlation: (d, d) of -log(1 - beta)
    verdict: (d,) of each, as for one beta; reasons: (d,) to doubt each, what concerns all of them included
    anisotropic: one beta for all axes is ruled out (p_isotropic below 1 %)
    beta: the best single one, and p_isotropic: how likely it leaves so much more error if it were true
    identifiability: (d,) of each axis, its rise with the betas along the others as they are
    aee, aee_isotropic: average Euclidean error over all observed particles [unit] (Thesis eq. 3.18)
    strain: (d,) mean strain along each axis, of all observations, and strain_sd: (d,) what noise makes of it
    unit, metres_per_unit: of all lengths; None: not known
    """

    axes: FloatArray
    value: FloatArray
    interval: FloatArray
    level: float
    correlation: FloatArray
    verdict: tuple[Verdict, ...]
    reasons: tuple[tuple[Doubt, ...], ...]
    identifiability: tuple[Identifiability, ...]
    anisotropic: bool
    p_isotropic: float
    beta: float
    aee: float
    aee_isotropic: float
    noise: float
    converged: bool
    settings: dict[str, object]
    strain: FloatArray
    strain_sd: FloatArray
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0

    @property
    def pressed(self) -> int | None:
        """The axis along which the material was shortened most; None where along none."""
        return self._most(-self.strain)

    @property
    def bulges(self) -> int | None:
        """The axis along which it became longer by most; None where along none."""
        return self._most(self.strain)

    def _most(self, strain: FloatArray) -> int | None:
        most = int(strain.argmax())
        return most if strain[most] > SEEN_SDS * self.strain_sd[most] else None

    @property
    def explained(self) -> float:
        """Share of the motion beyond a rigid one that the betas explain."""
        return self.identifiability[0].explained

    def as_json(self) -> dict[str, object]:
        """The public form."""
        return {
            "parameter": "beta",
            "axes": [
                {
                    "axis": [float(x) for x in self.axes[:, k]],
                    "value": float(self.value[k]),
                    "interval": [float(x) for x in self.interval[k]],
                    "verdict": self.verdict[k],
                    "reasons": [one.as_json() for one in self.reasons[k]],
                }
                for k in range(len(self.value))
            ],
            "level": self.level,
            "correlation": self.correlation.tolist(),
            "anisotropic": self.anisotropic,
            "p_isotropic": self.p_isotropic,
            "isotropic_beta": self.beta,
            **lengths("aee", self.aee, self.unit, self.metres_per_unit),
            **lengths("aee_isotropic", self.aee_isotropic, self.unit, self.metres_per_unit),
            **lengths("noise", self.noise, self.unit, self.metres_per_unit),
            "strain": self.strain.tolist(),
            "strain_sd": self.strain_sd.tolist(),
            "pressed_axis": self.pressed,
            "bulging_axis": self.bulges,
            "across_view": {"verdict": "unidentified", "text": ACROSS_VIEW} if len(self.value) == 2 else None,
            "explained": self.explained,
            "identifiability": {"rise_sd": [one.rise for one in self.identifiability], "explained": self.explained},
            "converged": self.converged,
            "settings": self.settings,
        }
