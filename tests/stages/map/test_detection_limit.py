"""What may have been missed: against counts by hand, and against worlds with and without inclusions."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.special import ndtr

from deformscope.stages.map.plan import INCLUSION_CONTRAST, INCLUSION_PRIOR, UnseenInclusions, detection_limit
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid, StiffnessSample

GRID = MapGrid(cell_m=0.01)
SD = 0.03


def touched(places: Sequence[tuple[float, float]], rigid: bool = False) -> RegionPosterior:
    samples = [StiffnessSample(np.array(at), 0.0, SD, rigid) for at in places]
    start = RegionPosterior.before_touches(GRID, particle_count=50)
    return functools.reduce(RegionPosterior.with_touch, samples, start)


def test_before_any_touch_a_lump_is_as_likely_as_stated() -> None:
    posterior = touched([])
    assert UnseenInclusions(posterior, 0.06).probability == INCLUSION_PRIOR
    found = detection_limit(posterior, np.zeros((0, 2)))
    assert found.untouched_m == pytest.approx(0.2, abs=0.01)
    assert found.lump_probability.tolist() == [INCLUSION_PRIOR] * 5


def test_the_largest_untouched_circle() -> None:
    """Between four touches in a square, and a border."""
    made = np.array([(0.1, 0.1), (0.3, 0.1), (0.1, 0.3), (0.3, 0.3), (0.5, 0.2)])
    found = detection_limit(touched([]), made)
    assert found.untouched_m == pytest.approx(np.sqrt(0.02), abs=0.01)
    np.testing.assert_allclose(found.untouched_at_m, [0.2, 0.2], atol=0.01)


def test_touches_exclude_the_lumps_that_they_lie_in() -> None:
    """By counting: of inclusions of 6 cm, all on the surface, the share without a touch far enough inside."""
    places = [(0.15, 0.15), (0.33, 0.21), (0.45, 0.11)]
    posterior = touched(places)
    centres = np.random.default_rng(0).uniform(0.06, [0.54, 0.34], (20000, 2))
    deep = 0.06 - np.min([np.hypot(*(centres - at).T) for at in places], axis=0)
    # a share of 0.2 of twice the stiffness is 14 %, more than three deviations; at 0.05 it is less than one
    at_most, at_least = (float((ndtr(deep / posterior.prior.blur_m) < share).mean()) for share in (0.2, 0.05))
    low, high = (
        INCLUSION_PRIOR * share / (1.0 - INCLUSION_PRIOR + INCLUSION_PRIOR * share) for share in (at_least, at_most)
    )
    assert low < UnseenInclusions(posterior, 0.06).probability < high


def test_of_worlds_that_read_the_same_so_many_have_a_lump() -> None:
    """Bayes by simulation: worlds with an inclusion in one of two, kept where three touches read as without one."""
    places = np.array([(0.15, 0.15), (0.33, 0.21), (0.45, 0.11)])
    posterior = touched([(float(x), float(y)) for x, y in places])
    sd = float(np.hypot(SD, posterior.scatter))
    random = np.random.default_rng(1)
    count = 400_000
    centres = random.uniform(0.085, [0.515, 0.315], (count, 2))
    there = random.random(count) < INCLUSION_PRIOR
    inside_m = 0.085 - np.hypot(*(places[:, None] - centres).transpose(2, 0, 1))
    felt = np.log(INCLUSION_CONTRAST) * ndtr(inside_m / posterior.prior.blur_m)
    read = felt * there + sd * random.standard_normal((3, count))
    same = (np.abs(read) < 0.5 * sd).all(axis=0)
    assert same.sum() > 5000
    assert UnseenInclusions(posterior, 0.085).probability == pytest.approx(float(there[same].mean()), abs=0.02)


def test_what_is_rigid_has_no_lumps() -> None:
    """Left foam, right rigid: inclusions are sought in the foam alone, and no touch of what is rigid would show one."""
    left = [(0.1, 0.1), (0.1, 0.3), (0.2, 0.2)]
    right = [(0.4, 0.1), (0.4, 0.3), (0.5, 0.2), (0.55, 0.05), (0.55, 0.35)]
    samples = [StiffnessSample(np.array(at), 0.0, SD) for at in left]
    samples += [StiffnessSample(np.array(at), 2.0, SD, rigid=True) for at in right]
    start = RegionPosterior.before_touches(GRID, particle_count=100)
    lumps = UnseenInclusions(functools.reduce(RegionPosterior.with_touch, samples, start), 0.06)
    in_foam, in_rigid = lumps.gain(np.array([(0.1, 0.2), (0.5, 0.12)]))
    assert in_rigid < 0.1 * in_foam


def test_the_gain_is_the_chance_of_the_first_touch_that_shows_one() -> None:
    """None where a touch is; in the middle of nowhere, the share of inclusions around it."""
    lumps = UnseenInclusions(touched([(0.15, 0.15)]), 0.06)
    here, away, beside = lumps.gain(np.array([(0.15, 0.15), (0.45, 0.25), (0.22, 0.15)]))
    assert here < 0.02 < beside < away
    reach = np.pi * 0.06**2 / (0.48 * 0.28)
    assert 1.0 < away / (reach * lumps.probability) < 2.0  # a rim is felt as well


def test_what_does_not_fit_cannot_be_there() -> None:
    small = RegionPosterior.before_touches(MapGrid((0.25, 0.15), 0.005), particle_count=50)
    found = detection_limit(small, np.zeros((0, 2)))
    assert found.lump_radius_m.tolist() == [0.03, 0.045, 0.06]
    assert found.probability(0.12) == 0.0


def test_touches_everywhere_leave_no_lump() -> None:
    places = [(x, y) for x in np.arange(0.03, 0.6, 0.03) for y in np.arange(0.03, 0.4, 0.03)]
    touches = tuple(StiffnessSample(np.array(at), 0.0, SD) for at in places)
    lumps = UnseenInclusions(dataclasses.replace(touched([]), touches=touches), 0.06)
    assert lumps.probability < 1e-9
    assert np.isfinite(lumps.gain(GRID.centres_m)).all()
