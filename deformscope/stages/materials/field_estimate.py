"""What one deformation shows of a body's stiffness from place to place."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.fit.estimate import Doubt, LengthUnit, Verdict, lengths

FieldVerdict = Literal["uniform", "materials", "gradual", "unidentified"]

IDENTIFIED_FACTOR, WEAK_FACTOR = 1.5, 2.5
"""A place whose interval spans less than these factors is identified, or weak."""


def place_verdicts(interval: FloatArray) -> tuple[Verdict, ...]:
    """Of each place, by the factor that its interval spans. interval: (C, 2) of a stiffness"""
    factor = interval[:, 1] / interval[:, 0]
    return tuple(
        "identified" if x <= IDENTIFIED_FACTOR else "weak" if x <= WEAK_FACTOR else "unidentified" for x in factor
    )


@dataclass(frozen=True, slots=True)
class FieldEstimate:
    """What one deformation shows of a body's stiffness from place to place.

    place: (C, d) middles of the cells [unit]; spacing: of the particles [unit]
    stiffness: (C,) of each place over the geometric mean of all, interval: (C, 2) at `level`, verdicts: (C,)
    material: (C,) which of the materials, from the softest on; -1 where the field is smooth
    ratio: stiffest over softest, and its interval
    beta: (C,) of clusters of 2^d particles, beta_interval: (C, 2); beta_ratio: of 1 - beta, largest over smallest
    absolute: (C,) stiffness of a cell [N per unit], absolute_interval: (C, 2); None without a force
    verdict: "uniform", "materials", "gradual"; "unidentified" where at most of the places the data do not tell
    reasons: to doubt it
    poisson, poisson_sd: Poisson's ratio; reach: of the smooth field [spacings]
    held_out: (h,) error of what was left out, chi2 for each number, of each of `tried` (borders as they were found from
    all); probability: (h,) of each by its evidence; plausible: (h,) whether intervals hold it
    noise, noise_reach: of a coordinate [unit], [spacings]; aee, beta_aee: average Euclidean error (Thesis eq. 3.18) of
    the elastic body and of the engine with its betas [unit]
    explained: share of the motion beyond a rigid one that the elastic body explains
    """

    place: FloatArray
    spacing: float
    stiffness: FloatArray
    interval: FloatArray
    level: float
    verdicts: tuple[str, ...]
    material: IntArray
    ratio: float
    ratio_interval: tuple[float, float]
    beta: FloatArray
    beta_interval: FloatArray
    beta_ratio: float
    absolute: FloatArray | None
    absolute_interval: FloatArray | None
    verdict: FieldVerdict
    reasons: tuple[Doubt, ...]
    poisson: float
    poisson_sd: float
    reach: float
    tried: tuple[str, ...]
    held_out: FloatArray
    probability: FloatArray
    plausible: tuple[bool, ...]
    noise: float
    noise_reach: float
    aee: float
    beta_aee: float
    explained: float
    converged: bool
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    settings: dict[str, object] = field(default_factory=dict)

    @property
    def materials(self) -> int:
        """How many materials there are; 0 where the field is smooth."""
        return int(self.material.max()) + 1

    @property
    def determined(self) -> float:
        """Share of the places whose stiffness is identified or weak."""
        return float(np.mean([one != "unidentified" for one in self.verdicts]))

    def levels(self) -> list[dict[str, object]]:
        """Each material's stiffness over the softest one's, and its share of the cells."""
        found: list[dict[str, object]] = []
        middle = [float(np.median(self.stiffness[self.material == k])) for k in range(self.materials)]
        for k in range(self.materials):
            some = self.material == k
            found.append(
                {
                    "stiffness_over_softest": middle[k] / min(middle),
                    "beta": float(np.median(self.beta[some])),
                    "share": float(some.mean()),
                }
            )
        return found

    def as_json(self) -> dict[str, object]:
        """The public form."""
        metres = 1.0 if self.unit == "m" else self.metres_per_unit
        per = None if metres is None else 1.0 / metres

        def force(value: FloatArray | None) -> object:
            return None if value is None or per is None else (per * value).tolist()

        return {
            "parameter": "field",
            "verdict": self.verdict,
            "reasons": [one.as_json() for one in self.reasons],
            "level": self.level,
            "ratio": {"value": self.ratio, "interval": list(self.ratio_interval)},
            "materials": self.levels(),
            "determined_share": self.determined,
            "places": {
                **lengths("at", self.place, self.unit, self.metres_per_unit),
                "stiffness": self.stiffness.tolist(),
                "interval": self.interval.tolist(),
                "verdict": list(self.verdicts),
                "material": [int(k) if k >= 0 else None for k in self.material],
                "beta": self.beta.tolist(),
                "beta_interval": self.beta_interval.tolist(),
                "stiffness_n_per_m": force(self.absolute),
                "stiffness_interval_n_per_m": force(self.absolute_interval),
            },
            **lengths("spacing", self.spacing, self.unit, self.metres_per_unit),
            "beta_ratio": self.beta_ratio,
            "poisson": {"value": self.poisson, "deviation": self.poisson_sd},
            "held_out": [
                {"field": name, "chi2": float(error), "probability": float(likely), "plausible": bool(kept)}
                for name, error, likely, kept in zip(
                    self.tried, self.held_out, self.probability, self.plausible, strict=True
                )
            ],
            "reach_spacings": self.reach,
            **lengths("noise", self.noise, self.unit, self.metres_per_unit),
            "noise_reach_spacings": self.noise_reach,
            **lengths("aee", self.aee, self.unit, self.metres_per_unit),
            **lengths("beta_aee", self.beta_aee, self.unit, self.metres_per_unit),
            "explained": self.explained,
            "converged": self.converged,
            "settings": self.settings,
        }
