"""The rules that look at variance alone: the place where it is largest, and any above a threshold."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from deformscope.arrays import FloatArray
from deformscope.stages.map.exploration import PlannedTouch
from deformscope.stages.map.plan import FieldKernel, PlanOptions, plan_touch
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid, StiffnessSample
from studies.planners import PLANNERS, MaximumVariance, RandomAbove, variance_of

SIZE_M, CELL_M = (0.6, 0.4), 0.02
PLACES_M = MapGrid(SIZE_M, CELL_M).centres_m
TOUCHED_M = np.array(((0.1, 0.1), (0.5, 0.3), (0.1, 0.3), (0.5, 0.1)))


def planned(excluded: np.ndarray[Any, Any] | None = None) -> PlannedTouch:
    shape = MapGrid(SIZE_M, CELL_M).shape
    none = np.zeros(shape, bool) if excluded is None else excluded.reshape(shape)
    return PlannedTouch(np.array([0.3, 0.2]), np.zeros(shape), np.zeros(shape), none, "as planned")


def so_far(touched_m: FloatArray | Sequence[FloatArray]) -> Any:
    surface = SimpleNamespace(height_m=np.zeros((80, 120)), cell_m=0.005)
    touches = [SimpleNamespace(xyz_m=np.append(one, 0.05), usable=True) for one in touched_m]
    return SimpleNamespace(surface=surface, touches=touches)


def test_variance_is_that_of_another_gaussian_process() -> None:
    kernel = FieldKernel()
    places, variance = variance_of(planned(), so_far(TOUCHED_M), kernel)
    np.testing.assert_allclose(places, PLACES_M)
    length = kernel.length_m
    other = GaussianProcessRegressor(
        ConstantKernel(kernel.sd**2, "fixed") * RBF(length, "fixed"), alpha=kernel.noise_sd**2, optimizer=None
    ).fit(TOUCHED_M, np.zeros(len(TOUCHED_M)))
    np.testing.assert_allclose(variance, other.predict(places, return_std=True)[1] ** 2, rtol=1e-6)
    unusable = so_far(TOUCHED_M)
    unusable.touches.append(SimpleNamespace(xyz_m=np.array([0.3, 0.2, 0.05]), usable=False))
    np.testing.assert_array_equal(variance_of(planned(), unusable, kernel)[1], variance)


def test_maximum_variance_takes_the_largest_of_what_may_be_touched() -> None:
    _, variance = variance_of(planned(), so_far(TOUCHED_M), FieldKernel())
    np.testing.assert_allclose(MaximumVariance()(planned(), so_far(TOUCHED_M)), PLACES_M[np.argmax(variance)])
    excluded = variance == variance.max()
    other = MaximumVariance()(planned(excluded), so_far(TOUCHED_M))
    np.testing.assert_allclose(other, PLACES_M[np.argmax(np.where(excluded, 0.0, variance))])


def test_random_takes_any_above_the_threshold_and_else_the_planned_one() -> None:
    kernel = FieldKernel()
    _, variance = variance_of(planned(), so_far(TOUCHED_M), kernel)
    chosen = {tuple(RandomAbove(seed, threshold=0.5)(planned(), so_far(TOUCHED_M)) or ()) for seed in range(12)}
    assert len(chosen) > 8
    for place in chosen:
        assert variance[np.hypot(*(PLACES_M - place).T).argmin()] > 0.5 * kernel.sd**2
    assert RandomAbove(0, threshold=2.0)(planned(), so_far(TOUCHED_M)) is None


def test_a_search_for_inclusions_leaves_smaller_holes_than_the_variance() -> None:
    """Ten touches of one material: what fits between them."""
    grid = MapGrid(cell_m=CELL_M)
    inner = np.minimum(PLACES_M, np.asarray(grid.size_m) - PLACES_M).min(axis=1)

    def hole(planner: str) -> float:
        touched: list[FloatArray] = []
        posterior, own = RegionPosterior.before_touches(grid, particle_count=50), PLANNERS[planner](0)
        for _ in range(10):
            plan = plan_touch(posterior, FieldKernel(), PlanOptions())
            assert plan.target_m is not None
            given = planned(plan.excluded > 0)
            place = plan.target_m if own is None else np.array(own(given, so_far(touched)))
            touched.append(place)
            posterior = posterior.with_touch(StiffnessSample(place, 0.0, 0.03))
        return float(np.minimum(np.min([np.hypot(*(PLACES_M - one).T) for one in touched], axis=0), inner).max())

    assert hole("regions") < 0.95 * hole("max-variance")


@pytest.mark.parametrize("name", PLANNERS)
def test_each_is_chosen_by_its_name(name: str) -> None:
    planner = PLANNERS[name](3)
    assert (planner is None) == (name == "regions")
    if planner is not None:
        assert planner(planned(), so_far(TOUCHED_M)) is not None
