"""The goal of an exploration, and its posterior by the touches so far: regions of one stiffness each, the thesis's
regions of beta, or inclusions below a homogeneous surface. `ExploreOptions.search` chooses."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import ClassVar

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.map.exploration import InclusionsResult, MapEstimate
from deformscope.stages.map.field import BETA_PRIOR, fit_field, levels_of
from deformscope.stages.map.inclusion_plan import plan_inclusion_touch
from deformscope.stages.map.inclusion_posterior import InclusionPosterior
from deformscope.stages.map.map_score import boundary_distance, match_regions
from deformscope.stages.map.perception import TrainedField
from deformscope.stages.map.plan import FieldKernel, TouchChoice, plan_touch
from deformscope.stages.map.thesis import FIRST_SHARE, SIGMA_E, SIGMA_N, ThesisField, contoured, plan_thesis_touch
from deformscope.stages.poke.contact import EXPONENT_SD, LEAST_SHARE, LOADED, ContactFit
from deformscope.stages.regions.posterior import RegionMap, RegionPosterior
from deformscope.stages.regions.touches import MapGrid, StiffnessSample

FEWEST_FOR_FIELD = 2
"""Number of touches with a beta from which there is a field of beta."""
FREE_EXPONENT_SD = 0.3
"""Prior deviation of the contact's exponent in a search for inclusions, which change it: nearly uninformative."""


@dataclass(frozen=True, eq=False)
class SurfaceSearch(ABC):
    """The goal's posterior by the touches so far; `with_touch` adds a touch.

    exponent_sd, least_share: options of `fit_approach`, which fits each contact
    on_level_layer: whether touches are always compared as on a level layer, however even the surface is
    first_share: place of the first touch, in shares of the surface; None = the most informative one"""

    posterior: RegionPosterior | InclusionPosterior
    exponent_sd: ClassVar[float] = EXPONENT_SD
    least_share: ClassVar[float] = LOADED
    on_level_layer: ClassVar[bool] = False
    first_share: ClassVar[tuple[float, float] | None] = None

    @cached_property
    def region_map(self) -> RegionMap:
        """Regions with their levels and intervals."""
        return self.posterior.region_map()

    def with_touch(self, touch: StiffnessSample) -> "SurfaceSearch":
        """The search after one more touch."""
        return dataclasses.replace(self, posterior=self.posterior.with_touch(touch))

    def with_beta(self, dented_m: FloatArray, beta: float) -> "SurfaceSearch":
        """The search after a touch that dented places (m, 2) [m] and has this beta."""
        return self

    @abstractmethod
    def planner(self, touches: int) -> Callable[..., TouchChoice]:
        """The function that chooses the next touch; its arguments are those of `plan_inclusion_touch` without the
        posterior. touches: number of touches made so far, usable or not"""

    def sample(self, xy_m: FloatArray, fit: ContactFit) -> StiffnessSample:
        """The stiffness sample of a contact at a place (2,) [m]."""
        return StiffnessSample(
            xy_m, log_stiffness=fit.log_stiffness, log_sd=fit.own_log_sd, rigid=fit.rigid, arm_sd=fit.arm_log_sd
        )

    def beta_field(
        self, grid: MapGrid, places_m: FloatArray, beta: FloatArray, beta_sd: FloatArray
    ) -> tuple[FloatArray, FloatArray, TrainedField] | None:
        """Mean and deviation (rows, columns) of beta from touches at places (n, 2) [m] with values and deviations (n,),
        nan = unknown; and the training data. The field of beta, None with too few touches."""
        if len(beta) < FEWEST_FOR_FIELD:
            return None
        sds = np.where(np.isfinite(beta_sd), beta_sd, BETA_PRIOR.nugget)
        field = fit_field(places_m, beta, sds, BETA_PRIOR)
        found = field.on(grid)
        trained = TrainedField(
            kernel=field.kernel,
            noise=field.nugget,
            place_m=field.places_m,
            value=field.value,
            weight=1.0 / (field.sd**2 + field.nugget**2),
        )
        return found.mean.clip(0.0, 1.0), found.deviation, trained

    def divided(self, maps: MapEstimate) -> MapEstimate:
        """The maps with their final regions."""
        return maps

    def inclusions(self, truth_m: FloatArray | None) -> InclusionsResult | None:
        """The inclusions found; None if they are not searched for. truth_m: (m, 4) x, y, radius, depth [m]"""
        return None


@dataclass(frozen=True, eq=False)
class RegionSearch(SurfaceSearch):
    """Search for regions of one stiffness each."""

    posterior: RegionPosterior

    def planner(self, touches: int) -> Callable[..., TouchChoice]:
        return partial(plan_touch, self.posterior, FieldKernel())


@dataclass(frozen=True, eq=False)
class ThesisSearch(RegionSearch):
    """Search for the thesis's regions, between isopleths of its field of beta. seed: seed of the random
    choices; thesis: the field of beta"""

    seed: int = 0
    thesis: ThesisField = field(default_factory=ThesisField)
    first_share = FIRST_SHARE

    def planner(self, touches: int) -> Callable[..., TouchChoice]:
        return partial(plan_thesis_touch, self.thesis, self.posterior, seed=self.seed + touches)

    def with_beta(self, dented_m: FloatArray, beta: float) -> "ThesisSearch":
        return dataclasses.replace(self, thesis=self.thesis.with_touch(dented_m, beta))

    def beta_field(
        self, grid: MapGrid, places_m: FloatArray, beta: FloatArray, beta_sd: FloatArray
    ) -> tuple[FloatArray, FloatArray, TrainedField]:
        """Mean and deviation (rows, columns) of beta [-] by the thesis's own field, from the first touch on."""
        thesis = self.thesis
        found = thesis.on(grid)
        trained = TrainedField(
            kernel=Kernel(SIGMA_E, thesis.width_m),
            noise=SIGMA_N,
            place_m=thesis.places_m,
            value=thesis.beta,
            weight=np.full(len(thesis.beta), SIGMA_N**-2),
        )
        return found.mean.clip(0.0, 1.0), found.deviation, trained

    def divided(self, maps: MapEstimate) -> MapEstimate:
        """The map with the thesis's regions in place of those by stiffness, softest first. Levels are means of the
        field of stiffness. The probability of the number of regions is that by stiffness, as the thesis has none."""
        found = self.thesis.on(self.posterior.grid)
        cut = contoured(found, self.thesis.isopleths)
        stiffness = np.log(maps.stiffness_n_per_mm)
        every = [cut.labels == label for label in range(int(cut.labels.max()) + 1)]
        every.sort(key=lambda cells: float(stiffness[cells].mean()))
        labels = np.select(every, range(len(every)))
        level, interval = levels_of(stiffness, maps.stiffness_log_sd, labels, len(every))
        truth = maps.truth_labels
        return dataclasses.replace(
            maps,
            labels=labels,
            label_probability=cut.probability,
            region_count=len(every),
            at_least=False,
            verdict="regions",
            probability=self.region_map.probability.get(str(len(every)), 0.0),
            level_n_per_mm=np.exp(level),
            level_interval_n_per_mm=np.exp(interval),
            level_rigid=np.zeros(len(every), dtype=bool),
            isopleths=self.thesis.isopleths,
            iou=None if truth is None else match_regions(labels, truth)[0],
            boundary_m=None if truth is None else boundary_distance(labels, truth, maps.cell_m),
        )


@dataclass(frozen=True, eq=False)
class InclusionSearch(SurfaceSearch):
    """Search for inclusions that the surface does not show: they change the stiffness and the exponent of contacts."""

    posterior: InclusionPosterior
    exponent_sd = FREE_EXPONENT_SD
    least_share = LEAST_SHARE
    on_level_layer = True

    def planner(self, touches: int) -> Callable[..., TouchChoice]:
        return partial(plan_inclusion_touch, self.posterior)

    def sample(self, xy_m: FloatArray, fit: ContactFit) -> StiffnessSample:
        """The stiffness sample of a place (2,) [m], with the exponent, which is fitted."""
        sample = super().sample(xy_m, fit)
        if fit.rigid:
            return sample
        return dataclasses.replace(
            sample, exponent=fit.exponent, exponent_sd=fit.exponent_sd, exponent_related=fit.exponent_related
        )

    def inclusions(self, truth_m: FloatArray | None) -> InclusionsResult:
        return self.posterior.inclusions(truth_m)
