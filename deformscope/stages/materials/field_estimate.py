"""Stiffness of a body from place to place, by one deformation."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.results.render import ReportedResult, derived, reported
from deformscope.stages.fit.estimate import Doubt, LengthUnit, Verdict, converged_text, explained_text

FieldKind = Literal["uniform", "anisotropic", "materials", "gradual", "unidentified"]

IDENTIFIED_FACTOR, WEAK_FACTOR = 1.5, 2.5
"""A place whose interval spans less than these factors is identified, or weak."""


def place_verdicts(interval: FloatArray) -> tuple[Verdict, ...]:
    """Verdict of each place, by the factor that its interval spans. interval: (C, 2) interval of a stiffness"""
    factor = interval[:, 1] / interval[:, 0]
    return tuple(
        "identified" if x <= IDENTIFIED_FACTOR else "weak" if x <= WEAK_FACTOR else "unidentified" for x in factor
    )


@dataclass(frozen=True, slots=True)
class DirectionalStiffness:
    """Stiffness of a material that is stiffer along one direction. stiffest, softest: (d,) directions of unit length

    ratio: ratio of Young's moduli along these: an estimate that has no interval"""

    stiffest: FloatArray
    softest: FloatArray
    ratio: float


def directions_text(found: DirectionalStiffness | None) -> str:
    """Ratio and direction as text; empty without them."""
    if found is None:
        return ""
    along = ", ".join(f"{one:.2f}" for one in found.stiffest)
    return f"about {found.ratio:.2g}, stiffest along ({along})"


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldEstimate(ReportedResult):
    """Stiffness of a body from place to place, by one deformation.

    place: (C, d) middles of the cells [unit]; spacing: spacing of the particles [unit]
    stiffness: (C,) stiffness of each place over the geometric mean of all, interval: (C, 2) at `level`, verdicts: (C,)
    material: (C,) index of the material, from the softest; -1 where the field is smooth
    ratio: stiffest over softest, and its interval
    beta: (C,) beta of clusters of 2^d particles, beta_interval: (C, 2); beta_ratio: largest 1 - beta over the smallest
    absolute: (C,) stiffness of a cell [N per unit], absolute_interval: (C, 2); None without a force
    directions: directions of one anisotropic material, else None; verdict: "uniform", "anisotropic" (one material,
    stiffer along a direction), "materials", "gradual"; "unidentified" if the data do not determine most of the places
    reasons: reasons to doubt it; poisson, poisson_sd: Poisson's ratio; reach: reach of the smooth field [spacings]
    held_out: (h,) error of left-out data, chi2 for each number, of each of `tried` (with the borders found from all
    data); probability: (h,) probability of each by its evidence; plausible: (h,) whether intervals hold it
    noise, noise_reach: noise and noise reach of a coordinate [unit], [spacings]; aee, beta_aee: average Euclidean error
    (Thesis eq. 3.18) of the elastic body and of the engine with its betas [unit]
    explained: share of the motion beyond a rigid one that the elastic body explains"""

    parameter: ClassVar[str] = "field"

    verdict: FieldKind = field(metadata=reported())
    reasons: tuple[Doubt, ...] = field(metadata=reported())
    level: float = field(metadata=reported())
    ratio: float = field(metadata=reported("stiffest over softest", key="ratio.value", interval="ratio_interval"))
    ratio_interval: tuple[float, float] = field(metadata=reported(key="ratio.interval"))

    @derived(key="materials")
    def levels(self) -> list[dict[str, object]]:
        """Each material's stiffness over the softest one's, and its share of the cells."""
        found: list[dict[str, object]] = []
        middle = [float(np.median(self.stiffness[self.material == k])) for k in range(self.materials)]
        for k in range(self.materials):
            some = self.material == k
            beta, share = float(np.median(self.beta[some])), float(some.mean())
            found.append({"stiffness_over_softest": middle[k] / min(middle), "beta": beta, "share": share})
        return found

    @property
    @derived(
        "places determined", key="determined_share", words=lambda found: f"{found.determined:.0%} of {len(found.place)}"
    )
    def determined(self) -> float:
        """Share of the places whose stiffness is identified or weak."""
        return float(np.mean([one != "unidentified" for one in self.verdicts]))

    place: FloatArray = field(metadata=reported(key="places.at", length=True))
    stiffness: FloatArray = field(metadata=reported(key="places.stiffness"))
    interval: FloatArray = field(metadata=reported(key="places.interval"))
    verdicts: tuple[str, ...] = field(metadata=reported(key="places.verdict"))
    material: IntArray = field(
        metadata=reported(
            key="places.material", json=lambda material: [k if k >= 0 else None for k in material.tolist()]
        )
    )
    beta: FloatArray = field(metadata=reported(key="places.beta"))
    beta_interval: FloatArray = field(metadata=reported(key="places.beta_interval"))
    absolute: FloatArray | None = field(metadata=reported(key="places.stiffness_n_per_m", per_length=True))
    absolute_interval: FloatArray | None = field(
        metadata=reported(key="places.stiffness_interval_n_per_m", per_length=True)
    )
    spacing: float = field(metadata=reported(length=True))
    beta_ratio: float = field(metadata=reported())
    directions: DirectionalStiffness | None = field(
        default=None,
        metadata=reported("stiffest over softest direction", words=lambda found: directions_text(found.directions)),
    )
    poisson: float = field(
        metadata=reported(
            "Poisson's ratio",
            key="poisson.value",
            words=lambda found: f"{found.poisson:.2g} (deviation {found.poisson_sd:.2g})",
        )
    )
    poisson_sd: float = field(metadata=reported(key="poisson.deviation"))
    tried: tuple[str, ...]
    held_out: FloatArray
    probability: FloatArray
    plausible: tuple[bool, ...]

    @property
    @derived(key="held_out")
    def held_out_json(self) -> list[dict[str, object]]:
        """JSON of each kind of field that was tried."""
        each = zip(self.tried, self.held_out, self.probability, self.plausible, strict=True)
        return [dict(zip(("field", "chi2", "probability", "plausible"), one, strict=True)) for one in each]

    reach: float = field(metadata=reported(key="reach_spacings"))
    noise: float = field(metadata=reported("noise (a coordinate)", length=True))
    noise_reach: float = field(metadata=reported(key="noise_reach_spacings"))
    aee: float = field(metadata=reported(length=True))
    beta_aee: float = field(metadata=reported(length=True))
    explained: float = field(
        metadata=reported("explained", words=lambda found: explained_text(found.explained, found.reasons))
    )
    converged: bool = field(metadata=reported("converged", words=converged_text))
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    settings: dict[str, object] = field(default_factory=dict, metadata=reported())

    @property
    def materials(self) -> int:
        """How many materials there are; 0 where the field is smooth."""
        return int(self.material.max()) + 1
