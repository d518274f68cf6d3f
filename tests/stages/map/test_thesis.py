"""The thesis's field of beta: its Gaussian process beside scikit-learn's, its isopleths, and the plan that it ends."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from deformscope.stages.map.field import FieldMap
from deformscope.stages.map.perception import SeenDent
from deformscope.stages.map.plan import PlanOptions
from deformscope.stages.map.thesis import SIGMA_E, SIGMA_N, SIGMA_W_M, ThesisField, contoured, plan_thesis_touch
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid

GRID = MapGrid((0.6, 0.4), 0.02)
DENT = MapGrid((0.04, 0.04), 0.01).centres_m


def touched(*touches: tuple[float, float, float]) -> ThesisField:
    """After touches at (x, y) with beta, each of which dented 4 x 4 cm."""
    field = ThesisField()
    for x, y, beta in touches:
        field = field.with_touch(DENT + np.array([x - 0.02, y - 0.02]), beta)
    return field


def test_mean_and_deviation_are_those_of_another_gaussian_process() -> None:
    field = touched((0.15, 0.2, 0.7), (0.4, 0.1, 0.2))
    length = SIGMA_W_M / np.sqrt(2.0)
    kernel = ConstantKernel(SIGMA_E**2, "fixed") * RBF(length, "fixed")
    other = GaussianProcessRegressor(kernel, alpha=SIGMA_N**2, optimizer=None).fit(field.places_m, field.beta)
    mean, deviation = other.predict(GRID.centres_m, return_std=True)
    found = field.on(GRID)
    assert found.mean.ravel() == pytest.approx(mean, abs=1e-9)
    assert found.deviation.ravel() == pytest.approx(deviation, abs=1e-6)


def test_before_any_touch_nothing_is_known() -> None:
    found = ThesisField().on(GRID)
    assert (found.mean == 0.0).all()
    assert (found.deviation == SIGMA_E).all()
    assert not len(ThesisField().isopleths)


def test_isopleths_run_halfway_between_touches_that_are_apart() -> None:
    field = touched((0.1, 0.1, 0.5), (0.2, 0.2, 0.0), (0.3, 0.3, 0.55), (0.4, 0.3, 0.9))
    assert field.isopleths == pytest.approx([0.25, 0.725])


def test_a_field_is_cut_into_the_bands_that_it_has() -> None:
    mean = np.array([[0.9, 0.5, 0.1], [0.8, 0.6, 0.0]])
    found = contoured(FieldMap(MapGrid((0.03, 0.02), 0.01), mean, np.full((2, 3), 0.1)), np.array([0.3, 0.7, 2.0]))
    assert found.labels.tolist() == [[0, 1, 2], [0, 1, 2]]
    assert found.probability[0, 1] == pytest.approx(0.9545, abs=1e-4)  # two deviations on either side
    assert found.probability[0, 0] == pytest.approx(0.9772, abs=1e-4)


def test_a_dent_is_all_that_sank_by_a_tenth_of_the_deepest() -> None:
    places = MapGrid((0.03, 0.02), 0.01).centres_m
    before = np.column_stack([places, np.full(6, 0.05)])
    after = before - np.outer([0.0, 0.009, 0.011, 0.1, -0.02, 0.05], [0.0, 0.0, 1.0])
    assert SeenDent(before, after, (2, 3)).dented_m.tolist() == places[[2, 3, 5]].tolist()


def test_the_plan_goes_where_the_field_is_unknown_and_ends_with_its_variance_alone() -> None:
    posterior = RegionPosterior.before_touches(MapGrid((0.6, 0.4)), seed=0)
    options = PlanOptions(budget=12)
    field, seen = touched((0.15, 0.2, 0.7)), set()
    for seed in range(8):
        plan = plan_thesis_touch(field, posterior, options, seed=seed)
        assert plan.stop is None
        assert float(field.at(plan.target_m[None]).deviation[0]) ** 2 > options.threshold * SIGMA_E**2
        seen.add(tuple(plan.target_m))
    assert len(seen) > 4
    plan = plan_thesis_touch(touched(*((x, y, 0.5) for x in (0.1, 0.3, 0.5) for y in (0.1, 0.3))), posterior, options)
    assert plan.stop == "nothing above the threshold"
