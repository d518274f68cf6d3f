"""The posterior over maps: against the same sums done the long way, and on surfaces whose regions are known."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.regions import levels
from deformscope.stages.regions.levels import RegionPrior
from deformscope.stages.regions.partitions import Family, draw
from deformscope.stages.regions.posterior import RegionPosterior, resampled
from deformscope.stages.regions.touches import MapGrid, StiffnessSample, TouchErrorModel
from tests.cases import slow_but

GRID = MapGrid(cell_m=0.01)
SPREAD = ((0.1, 0.1), (0.5, 0.3), (0.1, 0.3), (0.5, 0.1), (0.3, 0.2), (0.22, 0.1), (0.38, 0.3), (0.3, 0.35))


def touches(values: FloatArray | list[float], sd: float = 0.05, rigid_above: float = np.inf) -> list[StiffnessSample]:
    return [
        StiffnessSample(np.array(xy), min(float(value), rigid_above), sd, bool(value > rigid_above))
        for xy, value in zip(SPREAD, values, strict=False)
    ]


def halves(contrast: float, seed: int = 0) -> list[StiffnessSample]:
    """Left soft, right stiff, the boundary at x = 0.3 m, blurred."""
    x = np.array(SPREAD)[:, 0]
    noise = 0.05 * np.random.default_rng(seed).standard_normal(len(x))
    return touches(contrast * norm.cdf((x - 0.3) / 0.012) + noise)


def posterior(seen: list[StiffnessSample], *, particle_count: int = 200, seed: int = 0) -> RegionPosterior:
    """With few particles: quick, and no less right on such plain surfaces."""
    nothing = RegionPosterior.before_touches(GRID, particle_count=particle_count, seed=seed)
    return functools.reduce(RegionPosterior.with_touch, seen, nothing)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_levels_are_integrated_as_a_gaussian_s_marginal(k: int) -> None:
    """Without a least contrast, and were a mean of logarithms felt, the likelihood is that of y ~ N(0, F P F^T + R),
    the levels its conditional mean."""
    rng = np.random.default_rng(k)
    shares = rng.dirichlet(np.ones(k), (4, 6))
    prior = RegionPrior(least_contrast=0.0, mixed_share=0.0, forces_add=False)
    before = prior.level_sd**2 * np.eye(k) + prior.common_sd**2
    readings = levels.readings_of(touches(rng.standard_normal(6)), prior)
    found, level, cov = levels.levels_of(shares, readings, prior)
    for one in range(4):
        joint = shares[one] @ before @ shares[one].T + np.diag(readings.variance)
        assert found[one] == pytest.approx(multivariate_normal(np.zeros(6), joint).logpdf(readings.value), rel=1e-9)
        gain = before @ shares[one].T @ np.linalg.inv(joint)
        np.testing.assert_allclose(level[one], gain @ readings.value, atol=1e-9)
        np.testing.assert_allclose(cov[one], before - gain @ shares[one] @ before, atol=1e-9)


def test_memory_of_the_factors_is_bounded_and_the_maps_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """All maps at once against a few at a time, to the last bit."""
    rng, prior, sizes = np.random.default_rng(0), RegionPrior(), list[int]()
    readings = levels.readings_of(touches(rng.standard_normal(8)), prior)
    shares = rng.dirichlet(np.ones(3), (50, 8))
    whole = levels.log_likelihood_by_scatter(shares, readings, prior)
    at_once = levels._block_levels
    monkeypatch.setattr(levels, "FACTORS_BYTES", 8 * 8**2 * whole.shape[0] * 7)
    monkeypatch.setattr(
        levels, "_block_levels", lambda shares, *given: (sizes.append(len(shares)), at_once(shares, *given))[1]
    )
    np.testing.assert_array_equal(levels.log_likelihood_by_scatter(shares, readings, prior), whole)
    assert sizes == [7] * 7 + [1]


def test_under_a_contact_forces_add() -> None:
    """Evidence and levels against a sum over all levels: contacts feel the logarithm of the mean stiffness, which the
    model takes as linear about where the levels roughly are. One side is twelve times the other."""
    share = np.array([1.0, 0.97, 0.5, 0.2, 0.0, 0.0])
    shares, at = np.stack([share, 1.0 - share], axis=-1)[None], np.array([-0.5, 2.0])
    prior = RegionPrior(least_contrast=0.0, mixed_share=0.0)
    felt = np.log(shares[0] @ np.exp(at))
    off = 0.03 * np.random.default_rng(1).standard_normal(6)
    readings = levels.readings_of(touches(felt + off), prior)
    found, level, cov = levels.levels_of(shares, readings, prior)
    axis = np.linspace(-0.25, 0.25, 201)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2) + at - readings.centre
    before = prior.level_sd**2 * np.eye(2) + prior.common_sd**2
    noise = multivariate_normal(np.zeros(6), np.diag(readings.variance))
    joint = multivariate_normal(np.zeros(2), before).logpdf(grid)
    joint += noise.logpdf(readings.value - np.log(np.exp(grid) @ shares[0].T))
    weight = np.exp(joint - joint.max())
    assert found[0] == pytest.approx(joint.max() + np.log(weight.sum() * (axis[1] - axis[0]) ** 2), abs=0.05)
    weight /= weight.sum()
    np.testing.assert_allclose(level[0], weight @ grid, atol=0.004)
    np.testing.assert_allclose(np.diagonal(cov[0]), weight @ (grid - weight @ grid) ** 2, rtol=0.05)
    # a mean of logarithms would be off by 0.4
    assert np.abs(felt - shares[0] @ at).max() > 0.4


def test_where_touches_were_made_says_nothing_of_the_levels() -> None:
    """Two foams and something rigid: more touches on the latter leave the evidence of the former as it is."""
    three = np.eye(3)[[0, 0, 1, 1, 2, 2]]
    two = np.column_stack([three[:, 0] + three[:, 1], three[:, 2]])
    gained = []
    for more in (0, 2):
        values = np.array([0.0, 0.02, 0.4, 0.38, 3.0, 3.0] + more * [3.0])
        readings = levels.readings_of(touches(values, sd=0.05), prior := RegionPrior())
        evidence = [
            levels.levels_of(np.vstack([some, np.tile(some[-1], (more, 1))])[None], readings, prior, 0.05)[0][0]
            for some in (three, two)
        ]
        gained.append(evidence[0] - evidence[1])
    assert gained[1] == pytest.approx(gained[0], abs=0.1)


def test_least_contrast_cuts_the_prior_where_levels_are_alike() -> None:
    """By rejection: evidence of two levels that differ, against draws of them."""
    rng = np.random.default_rng(0)
    shares = np.repeat([[1.0, 0.0], [0.0, 1.0]], 2, axis=0)[None]
    prior = RegionPrior(least_contrast=0.4, mixed_share=0.0)
    readings = levels.readings_of(touches([0.0, 0.1, 0.3, 0.5], sd=0.2), prior)
    found, _, _ = levels.levels_of(shares, readings, prior)
    drawn = rng.standard_normal((400_000, 2)) + prior.common_sd * rng.standard_normal((400_000, 1))
    drawn = drawn[np.abs(drawn[:, 0] - drawn[:, 1]) > 0.4]
    off = readings.value - drawn @ shares[0].T
    likelihood = np.exp(-0.5 * (off**2 / readings.variance + np.log(2.0 * np.pi * readings.variance)).sum(axis=1))
    assert np.exp(found[0]) == pytest.approx(likelihood.mean(), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("regions", [2, 4])
def test_evidence_of_the_particles_is_that_of_the_prior(regions: int) -> None:
    """Sequential importance sampling with moves, against the plain mean over very many prior maps."""
    seen = halves(0.6)[:5]
    prior = RegionPrior()
    readings = levels.readings_of(seen, prior)
    maps = draw(np.random.default_rng(99), regions, GRID.size_m, 20_000)
    plain = levels.log_likelihood_of(maps.shares(readings.xy_m, prior.blur_m), readings, prior)
    expected = np.log(np.mean(np.exp(plain - plain.max()))) + plain.max()
    found = [posterior(seen, seed=seed, particle_count=600)._followed(regions).log_evidence for seed in range(2)]
    assert np.mean(found) == pytest.approx(expected, abs=0.3)


def quadrants() -> list[StiffnessSample]:
    """Four foams that meet in the middle."""
    rng = np.random.default_rng(2)
    places = [(x, y) for x in (0.06, 0.22, 0.38, 0.54) for y in (0.06, 0.15, 0.25, 0.34)]
    level = [0.7 * (x > 0.3) + 1.4 * (y > 0.2) for x, y in places]
    values = np.array(level) + 0.03 * rng.standard_normal(len(places))
    return [StiffnessSample(np.array(places[i]), float(values[i]), 0.03) for i in rng.permutation(len(places))]


@pytest.mark.slow
def test_four_materials_are_four_regions() -> None:
    found = posterior(quadrants())
    shown = found.region_map()
    x, y = GRID.centres_m.T
    truth = (1 * (x > 0.3) + 2 * (y > 0.2)).reshape(GRID.shape)
    assert (shown.verdict, shown.region_count, shown.at_least) == ("regions", 4, False)
    assert np.mean(shown.labels == truth) > 0.85
    np.testing.assert_allclose(shown.level, [0.0, 0.7, 1.4, 2.1], atol=0.08)
    assert found.probability["3"] < 0.05
    # maps of more regions are of the same touches, whenever they were begun
    later = found._followed(4)
    assert later.log_evidence == next(one for one in found.particles if one.maps.regions == 4).log_evidence


def stripes(seed: int) -> list[StiffnessSample]:
    """Three foams side by side."""
    rng = np.random.default_rng(seed)
    places = [np.array([(i % 6 + 0.5) / 6 * 0.6, ((i * 7) % 16 + 0.5) / 16 * 0.4]) for i in range(12)]
    return [StiffnessSample(at, int(at[0] // 0.2) - 1.0 + 0.03 * rng.standard_normal(), 0.03) for at in places]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2000, 2003))
def test_three_materials_are_no_more(seed: int) -> None:
    """A fourth region that no touch met would cost no evidence; with it 3 had 0.52 of seed 2001."""
    found = posterior(stripes(seed), seed=seed, particle_count=300)
    assert len(found.particles) > 2
    assert found.probability["3"] > 0.8


@pytest.mark.slow
def test_maps_of_more_regions_count_where_each_is_met() -> None:
    """Their evidence is that of very many prior maps, those that the touches do not meet every region of left out."""
    seen, prior = quadrants()[:6], RegionPrior()
    readings = levels.readings_of(seen, prior)
    shares = draw(np.random.default_rng(98), 4, GRID.size_m, 40_000).shares(readings.xy_m, prior.blur_m)
    plain = levels.log_likelihood_of(shares, readings, prior)
    met = shares.sum(axis=1).min(axis=1) >= 0.5
    expected = np.log(np.mean(np.exp(plain - plain.max()) * met)) + plain.max()
    every = [posterior(seen, seed=seed, particle_count=600) for seed in range(2)]
    every = [replace(one, particles=(*one.particles[:2], one._followed(4))) for one in every]
    found = [one._joint_logs[3] - np.log(prior.four + prior.five) for one in every]
    assert np.mean(found) == pytest.approx(expected, abs=0.3)
    for one in every:
        more, joint = one._counted[2], np.array([*prior.regions[:3], prior.four + prior.five])
        felt = more.maps.shares(readings.xy_m, prior.blur_m).sum(axis=1).min(axis=1)
        assert np.exp(more.log_weight[felt < 0.5]).sum() == 0.0
        assert np.exp(more.log_weight).sum() == pytest.approx(1.0)
        # what is not counted of four is of three
        both = joint[2:] @ np.exp([part.log_evidence for part in one.particles[1:]])
        assert np.exp(one._joint_logs[2:4]).sum() == pytest.approx(both)


def test_more_regions_than_are_told_apart_are_named() -> None:
    nothing = RegionPosterior.before_touches(GRID, particle_count=100, most_regions=3)
    assert list(nothing.probability) == ["1", "2", "3", "gradual"]
    shown = functools.reduce(RegionPosterior.with_touch, quadrants(), nothing).region_map()
    assert (shown.region_count, shown.at_least) == (3, True)
    assert set(shown.probability) == {"1", "2", "3", "gradual"}
    shown = replace(shown, probability={"1": 0.01, "2": 0.04, "3": 0.5, "4": 0.3, "5": 0.1, "gradual": 0.05})
    assert shown.claimed == pytest.approx(0.9)
    assert replace(shown, region_count=2).claimed == 0.04
    assert replace(shown, region_count=0, verdict="gradual").claimed == 0.05


@pytest.mark.parametrize("slope", [0.6, 0.7, 0.8])
def test_what_is_reported_is_the_likeliest(slope: float) -> None:
    """Few touches of a slope, where regions of any number together are as likely as a gradual change."""
    shown = posterior(touches(slope * np.array(SPREAD)[:5, 0])).region_map()
    assert shown.claimed >= max(shown.probability.values())


@pytest.mark.parametrize(
    ("shares", "verdict"),
    [
        ((0.12, 0.31, 0.09, 0.03, 0.01, 0.44), "gradual"),
        ((0.02, 0.08, 0.30, 0.15, 0.05, 0.40), "regions"),  # at least three
        ((0.02, 0.45, 0.05, 0.04, 0.00, 0.44), "regions"),
    ],
)
def test_gradual_is_likelier_than_the_number_that_would_be_reported(shares: tuple[float, ...], verdict: str) -> None:
    one = posterior(halves(0.0))
    one.__dict__["probability"] = dict(zip(("1", "2", "3", "4", "5", "gradual"), shares, strict=True))
    assert one.verdict == verdict


def test_regions_that_are_not_followed_have_their_share_of_the_most_that_are() -> None:
    found = posterior(halves(0.9)[:6])
    assert len(found.particles) == 2
    prior = found.prior
    assert found.probability["4"] / found.probability["3"] == pytest.approx(prior.four / prior.three)
    assert sum(found.probability.values()) == pytest.approx(1.0)


def test_two_halves_are_found_with_their_levels_and_order() -> None:
    shown = posterior(halves(0.9)).region_map()
    truth = (GRID.centres_m[:, 0] > 0.3).reshape(GRID.shape)
    assert (shown.verdict, shown.region_count) == ("regions", 2)
    assert np.mean(shown.labels == truth) > 0.9
    np.testing.assert_allclose(shown.level, [0.0, 0.9], atol=0.08)
    assert ((shown.level_interval[:, 0] < [0.0, 0.9]) & (shown.level_interval[:, 1] > [0.0, 0.9])).all()
    assert shown.label_probability.shape == GRID.shape
    assert 0.5 * shown.probability["2"] <= shown.label_probability.min() + 1e-12
    assert shown.label_probability.max() <= shown.probability["2"]
    assert sum(shown.probability.values()) == pytest.approx(1.0, abs=1e-6)
    assert not shown.rigid.any()
    # what it expects to have wrong is about what is wrong
    assert 0.005 < shown.wrong_share < 0.12
    assert shown.field[20, 5] == pytest.approx(0.0, abs=0.1)
    assert shown.field[20, 55] == pytest.approx(0.9, abs=0.1)


@pytest.mark.parametrize("seed", slow_but([0, 1], range(4)))
def test_one_material_stays_one_region(seed: int) -> None:
    shown = posterior(halves(0.0, seed)).region_map()
    assert (shown.verdict, shown.region_count) == ("regions", 1)
    assert shown.wrong_share == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", slow_but([0], range(4)))
def test_a_slope_is_called_gradual_and_its_field_followed(seed: int) -> None:
    noise = 0.05 * np.random.default_rng(seed).standard_normal(len(SPREAD))
    shown = posterior(touches(1.5 * np.array(SPREAD)[:, 0] + noise)).region_map()
    truth = 1.5 * GRID.centres_m[:, 0].reshape(GRID.shape)
    assert (shown.verdict, shown.region_count) == ("gradual", 0)
    assert len(shown.level) == len(shown.level_interval) == len(shown.rigid) == 0
    assert (shown.labels == -1).all()
    assert (shown.label_probability == shown.probability["gradual"]).all()
    assert np.sqrt(np.mean((shown.field - truth) ** 2)) < 0.1


def test_a_single_touch_between_two_levels_is_no_region() -> None:
    values = 0.9 * (np.array(SPREAD)[:, 0] > 0.29) - 0.45 * (np.arange(8) == 4)
    assert posterior(touches(values)).region_map().region_count == 2


def test_rigid_touches_make_a_region_whose_level_is_a_bound() -> None:
    shown = posterior(touches([0.0, 3.2, 0.05, 2.9, 0.0, -0.04, 3.0, 0.0], rigid_above=2.5)).region_map()
    assert shown.region_count == 2
    np.testing.assert_array_equal(shown.rigid, [False, True])
    assert shown.level[0] == pytest.approx(0.0, abs=0.1)
    np.testing.assert_array_equal(np.isinf(shown.level_interval[:, 1]), shown.rigid)
    assert shown.level[1] == shown.level_interval[1, 0] == 2.5  # the bound that its touches give


def test_one_touch_makes_no_cell_sure() -> None:
    shown = posterior(halves(0.9)[:1]).region_map()
    assert shown.region_count == 1
    np.testing.assert_allclose(shown.label_probability, shown.probability["1"])
    assert shown.label_probability.max() < 0.6


def test_a_rigid_region_stays_one_when_most_of_its_touches_are_near_its_boundary() -> None:
    seen = touches([0.0, 3.2, 0.05, 2.9, 0.0, -0.04], rigid_above=2.5)
    near = [StiffnessSample(np.array([0.35, y]), 2.1, 0.05) for y in (0.08, 0.2, 0.32)]
    shown = posterior([*seen, *near]).region_map()
    np.testing.assert_array_equal(shown.rigid, np.arange(shown.region_count) == shown.region_count - 1)


@pytest.mark.slow
def test_the_same_touches_give_the_same_map_bit_for_bit() -> None:
    first, again = (posterior(halves(0.5), seed=3).region_map() for _ in range(2))
    for name in ("labels", "label_probability", "level_interval", "field"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


@pytest.mark.slow
def test_levels_come_with_the_scale_of_the_touches() -> None:
    """A shift of all log stiffness (another unit) shifts levels and changes nothing else."""
    seen = halves(0.9)
    moved = [StiffnessSample(touch.xy_m, touch.log_stiffness + 6.9, touch.log_sd) for touch in seen]
    first, second = (posterior(some).region_map() for some in (seen, moved))
    assert (first.labels != second.labels).mean() < 0.002  # where two labels are as probable, rounding decides
    np.testing.assert_allclose(second.level - first.level, 6.9, atol=1e-6)


def test_before_any_touch_every_hypothesis_has_its_prior() -> None:
    prior = RegionPrior()
    reported = RegionPosterior.before_touches(GRID, prior).probability
    assert RegionPosterior.before_touches(GRID, prior, particle_count=300).region_map().region_count == 1
    regions = {str(number): share for number, share in enumerate(prior.regions, start=1)}
    assert reported == pytest.approx(regions | {"gradual": prior.gradual})


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(InputError, match="deviation"):
        StiffnessSample(np.zeros(2), 0.0, 0.0)
    with pytest.raises(InputError, match="place"):
        StiffnessSample(np.array([0.1, np.nan]), 0.0, 0.1)
    with pytest.raises(InputError, match="add up to 1"):
        RegionPrior(one=0.9)
    with pytest.raises(InputError, match="particles"):
        RegionPosterior.before_touches(GRID, particle_count=3)
    with pytest.raises(InputError, match="two cells"):
        MapGrid((0.0, 0.4))


def test_an_arm_that_is_off_moves_all_touches_together() -> None:
    """The likelihood is that of y ~ N(0, F P F^T + a a^T + R), scatter and the touches' own noise in R."""
    rng = np.random.default_rng(0)
    shares, arm = rng.dirichlet(np.ones(2), (1, 6)), rng.uniform(0.0, 0.3, 6)
    prior = RegionPrior(least_contrast=0.0, mixed_share=0.0, forces_add=False)
    before = prior.level_sd**2 * np.eye(2) + prior.common_sd**2
    seen = [
        StiffnessSample(one.xy_m, one.log_stiffness, one.log_sd, arm_sd=float(shift))
        for one, shift in zip(touches(rng.standard_normal(6)), arm, strict=False)
    ]
    readings = levels.readings_of(seen, prior)
    found, level, cov = levels.levels_of(shares, readings, prior, 0.1)
    related = TouchErrorModel().related(np.array(SPREAD[:6]))
    joint = shares[0] @ before @ shares[0].T + np.outer(arm, arm) + 0.05**2 * np.eye(6) + 0.1**2 * related
    assert found[0] == pytest.approx(multivariate_normal(np.zeros(6), joint).logpdf(readings.value), rel=1e-9)
    gain = before @ shares[0].T @ np.linalg.inv(joint)
    np.testing.assert_allclose(level[0], gain @ readings.value, atol=1e-9)
    np.testing.assert_allclose(cov[0], before - gain @ shares[0] @ before, atol=1e-9)


@pytest.mark.parametrize("scatter", [0.0, 0.1])
def test_the_scatter_of_touches_is_learned_and_makes_no_regions(scatter: float) -> None:
    """One material of twelve touches: what scatters by 10 % is one region with wider intervals, not several."""
    rng = np.random.default_rng(5)
    places = rng.uniform([0.03, 0.03], [0.57, 0.37], (12, 2))
    seen = [StiffnessSample(xy, scatter * rng.standard_normal(), 0.02) for xy in places]
    shown = posterior(seen).region_map()
    assert shown.region_count == 1
    assert shown.scatter < 0.05 if scatter == 0.0 else shown.scatter == pytest.approx(scatter, rel=0.35)
    low, high = shown.level_interval[0]
    model = TouchErrorModel()
    precision = np.linalg.inv(shown.scatter**2 * model.related(places) + 0.02**2 * np.eye(12)).sum()
    expected = 2.0 * 1.645 * np.sqrt(model.gain_sd**2 + 1.0 / precision)
    assert high - low == pytest.approx(expected, rel=0.15)


def test_a_gain_widens_levels_and_no_contrast() -> None:
    """Touches cannot see it: the regions, their probability and their contrast are what they are without it."""
    without, with_gain = (
        functools.reduce(
            RegionPosterior.with_touch,
            halves(0.9)[:6],
            RegionPosterior.before_touches(
                GRID, RegionPrior(error=TouchErrorModel(gain_sd=gain_sd)), particle_count=100
            ),
        )
        for gain_sd in (0.0, 0.2)
    )
    assert with_gain.probability == without.probability
    one, other = without.region_map(), with_gain.region_map()
    np.testing.assert_allclose(other.level_sd, np.hypot(one.level_sd, 0.2), rtol=0.05)
    np.testing.assert_allclose(np.diff(other.level), np.diff(one.level), atol=0.02)


def test_maps_that_are_kept_weigh_what_they_did_and_no_family_dies_out() -> None:
    """Lines hold nearly all of the weight, rings a ten-thousandth, blobs nothing."""
    random = np.random.default_rng(0)
    family = np.repeat([Family.LINE, Family.RING, Family.BLOB], [900, 90, 10])
    weight = np.where(family == Family.RING, 1e-4, 1.0) * random.random(1000)
    weight[family == Family.BLOB] = 0.0
    with np.errstate(divide="ignore"):
        log_weight = np.log(weight / weight.sum())
    kept, logs = resampled(log_weight, family, 300, 0.5)
    share = {kind: np.exp(log_weight[family == kind]).sum() for kind in (Family.LINE, Family.RING)}
    for kind, expected in share.items():
        here = family[kept] == kind
        assert np.exp(logs[here]).sum() == pytest.approx(expected)
        # each as often as its weight in the family says, to within one
        wanted = np.exp(log_weight[family == kind]) / expected * here.sum()
        assert np.abs(np.bincount(kept[here], minlength=1000)[family == kind] - wanted).max() <= 1.0
    rings = np.sum(family[kept] == Family.RING)
    assert rings / np.sum(family[kept] == Family.LINE) == pytest.approx(np.cbrt(share[Family.RING]), rel=0.2)
    assert not np.any(family[kept] == Family.BLOB)
    assert len(kept) == pytest.approx(300, abs=3)
