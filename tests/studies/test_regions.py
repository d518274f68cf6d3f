"""What is counted of maps of known surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from deformscope.lab.session_errors import LabErrors
from deformscope.stages.regions.levels import RegionPrior
from studies import regions
from studies.independent.random_maps import random_surface
from studies.quantities import rows


@pytest.mark.parametrize("count", range(6))
def test_random_surfaces_are_of_as_many_materials_that_all_cover_enough(count: int) -> None:
    x, y = np.meshgrid(np.linspace(0.005, 0.595, 60), np.linspace(0.005, 0.395, 40))
    places = np.column_stack([x.ravel(), y.ravel()])
    for seed in range(2990, 2995):
        surface, again = random_surface(count, seed), random_surface(count, seed)
        assert np.array_equal(surface.felt(places), again.felt(places))
        assert len(np.unique(surface.labels(places))) == max(count, 1)
        if count:
            assert np.bincount(surface.labels(places)).min() > 0.07 * len(places)
            assert set(surface.log_stiffness(places)) == set(surface.level)
            # a contact feels what is under it
            off = surface.felt(places) - surface.scatter(places)
            assert off.min() > surface.level.min() - 1e-9
            assert off.max() < surface.level.max() + 1e-9
        assert np.std(surface.scatter(places)) < 3.0 * surface.scatter_sd


NOTHING = regions.RegionOutcome("one", 0, 1, 1, 0.5, {}, 1, 1, (0.0,), 0.1, np.nan, np.nan, 0.05, 0.05, 12)


def test_bins_hold_as_many_each_and_their_band_is_the_binomial_s() -> None:
    rng = np.random.default_rng(0)
    claims = rng.uniform(0.3, 1.0, 500)
    honest = [
        replace(NOTHING, seed=i, claimed=float(p), count=1 if rng.random() < p else 2) for i, p in enumerate(claims)
    ]
    bins = regions.reliability(honest)
    assert [one.cases for one in bins] == [100] * 5
    assert all(one.holds for one in bins)
    assert sum(one.right for one in bins) == sum(one.right for one in honest)
    bold = regions.reliability([replace(one, claimed=min(one.claimed + 0.2, 1.0)) for one in honest])
    assert not all(one.holds for one in bold)
    low, high = regions.clopper_pearson(7, 20)
    assert binom.sf(6, 20, low) == pytest.approx(0.05)
    assert binom.cdf(7, 20, high) == pytest.approx(0.05)
    assert regions.clopper_pearson(0, 20)[0] == 0.0
    assert regions.clopper_pearson(20, 20)[1] == 1.0


def test_a_row_counts_levels_where_the_number_is_right() -> None:
    several = {"1": 0.3, "2": 0.5, "3": 0.2}
    right = replace(
        NOTHING, levels=2, levels_covered=1, true_count=2, count=2, wrong=0.1, wrong_claimed=0.2, probability=several
    )
    off = replace(NOTHING, count=3, levels=0, levels_covered=0, width=np.nan, probability=several)
    (row,) = rows([[right, off]], regions.QUANTITIES)
    assert (row["objects"], row["number_right"].hits) == (2, 1)
    assert (row["levels"].cases, row["levels"].hits) == (2, 1)
    assert (row["wrong_share"], row["wrong_share_claimed"]) == (0.1, 0.2)
    assert row["true_number_probability"] == pytest.approx(0.4)


def test_touches_have_the_errors_of_their_session() -> None:
    """A surface touched often at one place: its gain, its arm and its own noise, and what is stated of them."""
    surface = regions.known_surface(
        next(one for one in regions.REGION_CONDITIONS if one.gain_at is not None), 0, RegionPrior()
    )
    assert abs(surface.gain) == pytest.approx(0.03)
    place = surface.places_m[77]
    made = [surface.touch(place, 0.1) for _ in range(400)]
    values = np.array([one.log_stiffness for one in made])
    assert values.mean() == pytest.approx(surface.felt[77] + surface.gain + surface.arm * made[0].arm_sd, abs=0.005)
    assert values.std() == pytest.approx(made[0].log_sd, rel=0.1)
    n_per_m = 1e3 * np.exp(surface.felt[77])
    assert made[0].arm_sd == pytest.approx(0.1 * n_per_m / 5000.0)


def test_scatter_and_blur_are_in_what_a_contact_feels() -> None:
    clean = regions.RegionCondition("clean", "scenes", LabErrors.none())
    one, other = (regions.known_surface(condition, 2, RegionPrior()) for condition in (clean, regions.scattered(0.08)))
    difference = other.felt - one.felt
    assert difference.std() == pytest.approx(0.08, rel=0.25)
    low, high = np.sort(one.true.level)
    assert low - 1e-9 <= one.felt.min() < low + 0.02
    assert high - 0.02 < one.felt.max() <= high + 1e-9
    assert ((one.felt > low + 0.05) & (one.felt < high - 0.05)).any()


def test_truths_of_the_prior_are_as_often_of_each_kind() -> None:
    prior = RegionPrior()
    counts = [regions.known_surface(regions.REGION_CONDITIONS[0], seed, prior).true.region_count for seed in range(200)]
    for count, share in ((1, prior.one), (2, prior.two), (3, prior.three), (0, prior.gradual)):
        assert counts.count(count) / 200 == pytest.approx(share, abs=0.1)


def test_an_exploration_of_a_known_surface_is_scored() -> None:
    (found,) = regions.explore_known(regions.RegionCase(regions.scattered(0.03), 0, touches=5))
    assert (found.true_count, found.count, found.touches) == (1, 1, 5)
    assert found.levels == 1
    assert found.claimed == found.probability["1"]
