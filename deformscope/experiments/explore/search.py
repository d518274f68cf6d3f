"""The goal of an exploration, and its posterior by the touches so far: regions of one stiffness each, or
inclusions below a homogeneous surface. `ExploreOptions.search` chooses."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import ClassVar

from deformscope.arrays import FloatArray
from deformscope.stages.map.exploration import InclusionsResult
from deformscope.stages.map.inclusion_plan import plan_inclusion_touch
from deformscope.stages.map.inclusion_posterior import InclusionPosterior
from deformscope.stages.map.plan import FieldKernel, TouchChoice, plan_touch
from deformscope.stages.poke.contact import EXPONENT_SD, LEAST_SHARE, LOADED, ContactFit
from deformscope.stages.regions.posterior import RegionMap, RegionPosterior
from deformscope.stages.regions.touches import StiffnessSample

FREE_EXPONENT_SD = 0.3
"""Prior deviation of the contact's exponent in a search for inclusions, which change it: nearly uninformative."""


@dataclass(frozen=True, eq=False)
class SurfaceSearch(ABC):
    """The goal's posterior by the touches so far; `with_touch` adds a touch.

    exponent_sd, least_share: options of `fit_approach`, which fits each contact
    on_level_layer: whether touches are always compared as on a level layer, however even the surface is"""

    posterior: RegionPosterior | InclusionPosterior
    exponent_sd: ClassVar[float] = EXPONENT_SD
    least_share: ClassVar[float] = LOADED
    on_level_layer: ClassVar[bool] = False

    @cached_property
    def region_map(self) -> RegionMap:
        """Regions with their levels and intervals."""
        return self.posterior.region_map()

    def with_touch(self, touch: StiffnessSample) -> "SurfaceSearch":
        """The search after one more touch."""
        return dataclasses.replace(self, posterior=self.posterior.with_touch(touch))

    @abstractmethod
    def planner(self) -> Callable[..., TouchChoice]:
        """The function that chooses the next touch; its arguments are those of `plan_inclusion_touch` without the
        posterior"""

    def sample(self, xy_m: FloatArray, fit: ContactFit) -> StiffnessSample:
        """The stiffness sample of a contact at a place (2,) [m]."""
        return StiffnessSample(
            xy_m, log_stiffness=fit.log_stiffness, log_sd=fit.own_log_sd, rigid=fit.rigid, arm_sd=fit.arm_log_sd
        )

    def inclusions(self, truth_m: FloatArray | None) -> InclusionsResult | None:
        """The inclusions found; None if they are not searched for. truth_m: (m, 4) x, y, radius, depth [m]"""
        return None


@dataclass(frozen=True, eq=False)
class RegionSearch(SurfaceSearch):
    """Search for regions of one stiffness each."""

    posterior: RegionPosterior

    def planner(self) -> Callable[..., TouchChoice]:
        return partial(plan_touch, self.posterior, FieldKernel())


@dataclass(frozen=True, eq=False)
class InclusionSearch(SurfaceSearch):
    """Search for inclusions that the surface does not show: they change the stiffness and the exponent of contacts."""

    posterior: InclusionPosterior
    exponent_sd = FREE_EXPONENT_SD
    least_share = LEAST_SHARE
    on_level_layer = True

    def planner(self) -> Callable[..., TouchChoice]:
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
