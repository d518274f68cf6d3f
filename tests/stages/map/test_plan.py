"""Where the next touch goes, where it may not, and when it is enough."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from deformscope.errors import InputError
from deformscope.stages.map.plan import (
    ALLOWED,
    AT_BORDER,
    INCLUSION_M,
    INCLUSION_WORTH,
    LARGER,
    OUT_OF_REACH,
    TOUCHED_BEFORE,
    FieldKernel,
    PlanOptions,
    UnseenInclusions,
    information,
    label_gain,
    plan_touch,
)
from deformscope.stages.regions.hypotheses import RegionHypotheses, RelatedTouches
from deformscope.stages.regions.levels import RegionPrior, readings_of
from deformscope.stages.regions.partitions import draw
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid, StiffnessSample, TouchErrorModel

GRID = MapGrid(cell_m=0.01)
KERNEL = FieldKernel()
SPREAD = ((0.1, 0.1), (0.5, 0.3), (0.1, 0.3), (0.5, 0.1), (0.22, 0.2), (0.38, 0.22))


def mapped(touches: list[StiffnessSample]) -> RegionPosterior:
    return functools.reduce(
        RegionPosterior.with_touch, touches, RegionPosterior.before_touches(GRID, particle_count=200)
    )


@pytest.fixture(scope="module")
def halves() -> RegionPosterior:
    """Left soft, right stiff; where between x = 0.22 and 0.38 m the boundary runs is open."""
    return mapped([StiffnessSample(np.array(xy), 0.9 * (xy[0] > 0.3), 0.08) for xy in SPREAD])


@pytest.fixture(scope="module")
def one_material() -> RegionPosterior:
    return mapped([StiffnessSample(np.array(xy), 0.02 * (-1.0) ** i, 0.08) for i, xy in enumerate(SPREAD)])


def test_no_target_is_out_of_reach_at_the_border_or_where_it_was_touched(halves: RegionPosterior) -> None:
    reachable = GRID.centres_m[:, 0].reshape(GRID.shape) < 0.45
    plan = plan_touch(halves, KERNEL, PlanOptions(), reachable=reachable)
    assert plan.target_m[0] < 0.45
    assert 0.02 < plan.target_m[1] < 0.38
    assert np.hypot(*(plan.target_m - np.array(SPREAD)).T).min() >= 0.025
    np.testing.assert_array_equal(np.isnan(plan.gain), plan.excluded != ALLOWED)
    assert {ALLOWED, OUT_OF_REACH, AT_BORDER, TOUCHED_BEFORE} == set(plan.excluded.ravel().tolist())
    assert plan.gain.shape == plan.cost_s.shape == plan.excluded.shape == plan.grid.shape


def test_cost_is_the_touch_and_the_way_to_it(halves: RegionPosterior) -> None:
    tip = np.array([0.11, 0.09])
    plan = plan_touch(halves, KERNEL, PlanOptions(), tip_m=tip)
    away = np.hypot(*(plan.grid.centres_m - tip).T).reshape(plan.grid.shape)
    np.testing.assert_allclose(plan.cost_s, 6.0 + away / 0.1)


def test_integrated_variance_is_what_one_more_touch_really_takes_off(one_material: RegionPosterior) -> None:
    """Against the variance of the process computed anew with the touch in it."""
    plan = plan_touch(one_material, KERNEL, PlanOptions(fill=20, cell_m=0.05, border_m=0.0, apart_m=0.0))
    places, touched = plan.grid.centres_m, np.array(SPREAD)

    def mean_variance(at: np.ndarray) -> float:
        cross = KERNEL.covariance(at, places)
        own = KERNEL.covariance(at, at) + KERNEL.noise_sd**2 * np.eye(len(at))
        return float(np.mean(KERNEL.sd**2 - (cross * np.linalg.solve(own, cross)).sum(axis=0)))

    before = mean_variance(touched)
    for place in (0, 17, 50, 95):
        drop = before - mean_variance(np.vstack([touched, places[place]]))
        assert plan.gain.ravel()[place] == pytest.approx(drop, rel=1e-6)


def test_information_is_that_of_two_hypotheses_in_closed_form() -> None:
    """Two maps that are equally likely: the entropy of a mixture of two normals, by quadrature."""
    maps = draw(np.random.default_rng(0), 2, GRID.size_m, 200)
    places = MapGrid(cell_m=0.1).centres_m
    labels = maps.labels(places)
    one = 0
    pair = maps.take(np.array([one, int(np.argmax((labels != labels[one]).sum(axis=1)))]))
    level = np.array([[0.0, 0.5], [0.0, 0.5]])
    weighed = ((pair, level, np.zeros((2, 2, 2)), np.array([0.5, 0.5])),)
    hypotheses = RegionHypotheses(weighed, (), True, (np.zeros(2),))
    prior = RegionPrior(mixed_share=0.0)
    new = RelatedTouches(places, readings_of((), prior), prior, 0.2)
    found = information(new.expected(hypotheses, 0.012))
    mean = np.log(pair.shares(places, 0.012) @ np.exp(level[0]))[..., None]
    y = np.linspace(-2.0, 3.0, 5001)
    density = norm.pdf(y, mean, 0.2).mean(axis=0)
    entropy = -np.sum(density * np.log(density + 1e-300), axis=-1) * (y[1] - y[0])
    expected = entropy - 0.5 * np.log(2.0 * np.pi * np.e * 0.2**2)
    np.testing.assert_allclose(found, expected, atol=0.02)  # bins lose a little
    assert expected.max() > 0.3
    # where both maps agree nothing is gained; where they differ the right labels are, by about as much as is learned
    gain = label_gain(hypotheses, new, places, 0.012)
    assert gain[expected < 1e-6].max(initial=0.0) < 0.01
    assert gain[np.argmax(expected)] > 0.8 * gain.max() > 0.0


def test_the_default_looks_between_the_regions(halves: RegionPosterior) -> None:
    plan = plan_touch(halves, KERNEL, PlanOptions())
    assert plan.stop is None
    assert 0.2 < plan.target_m[0] < 0.4
    assert plan.unit == "label"
    assert "expected to correct" in plan.reason


def test_the_way_counts(halves: RegionPosterior) -> None:
    """On a slow arm the next touch is nearer to where the tip is."""
    tip = np.array([0.3, 0.05])
    away = []
    for speed in (0.01, 10.0):
        plan = plan_touch(halves, KERNEL, PlanOptions(speed_m_s=speed, touch_s=1.0), tip_m=tip)
        assert plan.target_m is not None
        away.append(np.hypot(*(plan.target_m - tip)))
    assert away[0] < away[1]


def test_it_fills_the_space_first_and_looks_for_lumps_while_there_is_one_material(
    one_material: RegionPosterior,
) -> None:
    assert plan_touch(RegionPosterior.before_touches(GRID), KERNEL, PlanOptions()).unit == "mean variance"
    plan = plan_touch(one_material, KERNEL, PlanOptions())
    assert "one material so far" in plan.reason
    assert UnseenInclusions(one_material, INCLUSION_M).gain(plan.target_m[None])[0] > 0.05


def test_lumps_are_sought_where_there_are_two_materials_too(halves: RegionPosterior) -> None:
    """What a touch far from the border is worth is what it may show of lumps."""
    plan = plan_touch(halves, KERNEL, PlanOptions())
    away = np.array([0.09, 0.21])
    here = int(np.hypot(*(plan.grid.centres_m - away).T).argmin())
    chance = [UnseenInclusions(halves, times * INCLUSION_M).gain(away[None])[0] for times in LARGER]
    assert plan.gain.ravel()[here] >= INCLUSION_WORTH * np.mean(chance) > 0.004
    assert plan_touch(halves, KERNEL, PlanOptions(sure=0.1, least_gain=1.0, threshold=0.0)).stop is None


def test_one_material_is_enough_once_lumps_would_have_been_felt() -> None:
    """It stops by itself, before its budget; later where smaller lumps are asked for, and then all have been met."""
    made = []
    for inclusion_m in (0.06, 0.045):
        options = PlanOptions(budget=30, inclusion_m=inclusion_m)
        posterior = RegionPosterior.before_touches(GRID, particle_count=200)
        while (plan := plan_touch(posterior, KERNEL, options)).stop is None:
            assert plan.target_m is not None
            assert plan.missed.probability(inclusion_m) > options.unmet or len(posterior.touches) < 8
            noise = 0.02 * (-1.0) ** len(posterior.touches)
            posterior = posterior.with_touch(StiffnessSample(plan.target_m, noise, 0.03))
        assert plan.stop == "little left to learn"
        assert plan.missed.probability(inclusion_m) <= options.unmet
        made.append(len(posterior.touches))
    assert made[0] <= 12 < made[1]


def test_it_never_stops_while_the_number_of_regions_is_in_doubt(halves: RegionPosterior) -> None:
    content = {"least_gain": 10.0, "threshold": 10.0, "unmet": 1.0}
    assert plan_touch(halves, KERNEL, PlanOptions(sure=1.0, **content)).stop is None
    assert plan_touch(halves, KERNEL, PlanOptions(sure=0.1, **content)).stop is not None
    assert plan_touch(halves, KERNEL, PlanOptions(sure=1.0, budget=6, **content)).stop == "budget"


def test_why_it_stops(halves: RegionPosterior, one_material: RegionPosterior) -> None:
    content = {"sure": 0.1, "unmet": 1.0}
    plan = plan_touch(halves, KERNEL, PlanOptions(**content, threshold=0.0, least_gain=1.0))
    assert plan.stop == "little left to learn"
    plan = plan_touch(one_material, FieldKernel(length_m=1.0), PlanOptions(**content))
    assert plan.stop == "nothing above the threshold"
    nowhere = plan_touch(halves, KERNEL, PlanOptions(), reachable=np.zeros(GRID.shape, dtype=bool))
    assert (nowhere.stop, nowhere.target_m) == ("nowhere to go", None)


def test_what_makes_no_sense_is_refused(halves: RegionPosterior) -> None:
    with pytest.raises(InputError, match="above 0"):
        PlanOptions(budget=0)
    with pytest.raises(InputError, match="mask"):
        plan_touch(halves, KERNEL, PlanOptions(), reachable=np.ones((2, 2), dtype=bool))


def test_a_touch_may_be_repeated_at_its_very_place_and_says_less_than_one_beside_it() -> None:
    """A reading that contradicts its neighbours: either it is off, or something small is there."""
    xy = np.array([(0.1, 0.1), (0.31, 0.21), (0.5, 0.3), (0.1, 0.3), (0.5, 0.1), (0.301, 0.305)])
    posterior = mapped([StiffnessSample(one, 0.4 * (i == 1), 0.12) for i, one in enumerate(xy)])
    plan = plan_touch(posterior, KERNEL, PlanOptions())
    here, beside = np.array([0.31, 0.21]), np.array([0.33, 0.21])
    cells = [int(np.hypot(*(plan.grid.centres_m - one).T).argmin()) for one in (here, beside)]
    assert plan.excluded.ravel()[cells].tolist() == [ALLOWED, TOUCHED_BEFORE]
    assert plan.gain.ravel()[cells[0]] > 0.0
    # where that touch gave nothing it is not made again; nor in a filling
    failed = plan_touch(posterior, KERNEL, PlanOptions(), left_out_m=here[None])
    assert failed.excluded.ravel()[cells[0]] == TOUCHED_BEFORE
    assert plan_touch(posterior, KERNEL, PlanOptions(fill=20)).excluded.ravel()[cells[0]] == TOUCHED_BEFORE
    # the place itself is touched, not its cell's middle; and it was as good as known what it reads
    off = xy[5]
    at_m, again = posterior.repeated(np.array([[0.31, 0.31], off, [0.4, 0.2]]), 0.01)
    np.testing.assert_array_equal(at_m, [off, off, [0.4, 0.2]])
    np.testing.assert_array_equal(again, [True, True, False])
    once, new = information(posterior.related(at_m[1:]).expected(posterior.hypotheses(), 0.0075))
    assert 0.0 < once < new


def test_what_touches_near_others_are_expected_to_read_is_the_conditional_of_one_gaussian() -> None:
    """One material of a known scatter: levels, scatter that neighbours share and own errors are jointly Gaussian."""
    rng = np.random.default_rng(5)
    made, new = rng.uniform((0.0, 0.0), GRID.size_m, (2, 9, 2))
    new[0] = made[0] + (0.02, 0.0)
    samples = [StiffnessSample(xy, value, 0.04) for xy, value in zip(made, rng.normal(0.7, 0.1, 9), strict=True)]
    error = TouchErrorModel(scatter_median=0.08, scatter_spread=0.0)
    posterior = RegionPosterior.before_touches(GRID, RegionPrior(error=error), particle_count=50)
    posterior = replace(posterior, touches=tuple(samples))
    every = posterior.hypotheses()
    one = replace(every, maps=every.maps[:1], scatter=every.scatter[:1], smooth=())
    mean, variance, sd, weight = posterior.related(new).expected(one, posterior.prior.blur_m)
    errors = 0.08**2 * error.related(np.concatenate([made, new])) + 0.04**2 * np.eye(18)
    cov = posterior.prior.any_level_sd**2 + errors
    value = np.array([sample.log_stiffness for sample in samples])
    centre = value.mean()
    gain = np.linalg.solve(cov[:9, :9], cov[:9, 9:]).T
    np.testing.assert_allclose(mean[0], centre + gain @ (value - centre), atol=1e-9)
    np.testing.assert_allclose(sd[0] ** 2, np.diag(cov[9:, 9:] - gain @ cov[:9, 9:]), rtol=1e-7)
    assert variance.shape == (1, 9)
    assert weight.tolist() == [1.0]
    # 2 cm from a touch a reading is better known than far from all
    assert sd[0, 0] < 0.85 * sd[0, np.hypot(*(new[:, None] - made).transpose(2, 0, 1)).min(axis=1).argmax()]


def test_a_touch_next_to_others_of_its_material_says_less_than_one_between_them_and_the_next() -> None:
    """Three touches within 4 cm of each other read alike; the scatter that they share is known there."""
    xy = np.array([(0.1, 0.2), (0.29, 0.33), (0.27, 0.31), (0.31, 0.31), (0.5, 0.2), (0.5, 0.33), (0.2, 0.1)])
    value = [-0.4, 0.0, 0.02, -0.02, 2.5, 2.5, -0.3]
    posterior = mapped([StiffnessSample(one, read, 0.03) for one, read in zip(xy, value, strict=True)])
    new = np.array([(0.29, 0.29), (0.31, 0.33), (0.2, 0.2)])
    hypotheses, blur = replace(posterior.hypotheses(), smooth=()), posterior.prior.blur_m
    related = posterior.related(new)
    alone = information(replace(related, readings=readings_of((), posterior.prior)).expected(hypotheses, blur))
    known = information(related.expected(hypotheses, blur))
    assert (known[:2] < 0.8 * alone[:2]).all()
    assert known[2] == pytest.approx(alone[2], rel=0.25)
