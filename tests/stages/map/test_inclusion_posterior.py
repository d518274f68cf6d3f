"""Inclusions below a surface that shows nothing: what touches say of them, where to touch next, and when it is
enough."""

from collections.abc import Callable

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.session_errors import LabErrors
from deformscope.stages.map import inclusion_posterior
from deformscope.stages.map.inclusion_plan import plan_inclusion_touch
from deformscope.stages.map.inclusion_posterior import (
    EXISTS,
    HERTZ,
    STIFFER,
    InclusionHypotheses,
    InclusionPosterior,
    InclusionPrior,
)
from deformscope.stages.map.plan import PlanOptions
from deformscope.stages.poke.inclusion_footprint import contrast_share, footprint, inclusion_shift
from deformscope.stages.regions.touches import MapGrid, StiffnessSample
from tests.cases import slow

GRID = MapGrid((0.2, 0.2))
PRIOR = InclusionPrior(set_force_n=5.0)
LEVEL, NOISE = float(np.log(0.52)), 0.005
Foam = Callable[[FloatArray], float]


def foam(*lumps: tuple[float, float, float, float, float], seed: int = 0) -> Foam:
    """Log stiffness of a touch; each inclusion: x, y, radius, depth [m] and how many times as stiff."""
    random = np.random.default_rng(seed)

    def felt(xy_m: FloatArray) -> float:
        log = LEVEL + NOISE * float(random.standard_normal())
        for x, y, radius, depth, times in lumps:
            aside = np.array([np.hypot(xy_m[0] - x, xy_m[1] - y)])
            share = footprint(0.0098, np.array([radius]), np.array([depth]), aside)
            log += float(inclusion_shift(contrast_share(times), share)[0, 0, 0])
        return log

    return felt


def scattering(foam_: Foam, sd: float, seed: int) -> Foam:
    """The same in foam that varies over 4 cm."""
    errors = LabErrors(scatter=(sd, sd)).draw(seed)
    return lambda xy_m: foam_(xy_m) + float(errors.scatter(xy_m))


def touched(at: FloatArray, felt: Foam) -> InclusionPosterior:
    samples = (StiffnessSample(xy_m, felt(xy_m), float(np.hypot(NOISE, 0.02))) for xy_m in at)
    return InclusionPosterior(GRID, PRIOR, tuple(samples))


def lattice(step_m: float) -> FloatArray:
    side = np.arange(0.03, 0.171, step_m)
    return np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)


def sought(felt: Foam, budget: int = 30) -> tuple[InclusionPosterior, str]:
    """Touched as planned, until it stops; and why."""
    posterior = InclusionPosterior(GRID, PRIOR)
    while True:
        choice = plan_inclusion_touch(posterior, PlanOptions(budget=budget))
        if choice.stop is not None or choice.target_m is None:
            return posterior, str(choice.stop)
        sample = StiffnessSample(choice.target_m, felt(choice.target_m), float(np.hypot(NOISE, 0.02)))
        posterior = posterior.with_touch(sample)


def test_before_any_touch_it_is_the_prior() -> None:
    before = InclusionPosterior(GRID, PRIOR)
    np.testing.assert_allclose(before.missed, EXISTS)
    assert not before.found
    assert before.missed_smallest == pytest.approx(EXISTS)


def test_a_lattice_of_touches_excludes_the_larger_lumps_the_more() -> None:
    found = touched(lattice(0.035), foam())
    assert not found.found
    assert (np.diff(found.missed[:5]) < 0.0).all()
    assert found.missed_smallest < 0.05 < found.missed[0]
    shown = found.region_map()
    assert shown.region_count == 1
    assert float(np.abs(shown.field - LEVEL).max()) < 0.01


def test_a_lump_is_found_where_it_is_whatever_the_order_of_the_touches() -> None:
    at = lattice(0.035)
    felt = foam((0.115, 0.075, 0.02, 0.013, 10.0))
    readings = {tuple(place): felt(place) for place in at}
    ahead, back = (touched(some, lambda xy_m: readings[tuple(xy_m)]) for some in (at, at[::-1]))
    (one,) = ahead.found
    assert np.hypot(*(one.centre_m - (0.115, 0.075))) < 0.012
    assert one.stiff
    assert one.radius_interval_m[0] < 0.02 < one.radius_interval_m[1]
    np.testing.assert_allclose(back.found[0].centre_m, one.centre_m, atol=1e-9)
    np.testing.assert_allclose(back.missed, ahead.missed, atol=1e-9)
    shown = ahead.region_map()
    assert (shown.region_count, shown.labels[15, 23], shown.labels[30, 5]) == (2, 1, 0)
    assert shown.level[1] > shown.level[0]


@pytest.mark.parametrize("fields", [2, slow(4)])
def test_foam_that_scatters_smoothly_is_learned_and_a_lump_told_from_it(fields: int) -> None:
    """Over 4 cm, by 6 %, without an inclusion and with one, 20 % at most: fields touched on a lattice of 2.8 cm."""
    at, found, alarms, scatter = lattice(0.028), 0, 0, []
    for seed in range(1000, 1000 + fields):
        lump = (0.08 + 0.01 * (seed - 1000), 0.085, 0.02, 0.012, 10.0)
        with_lump, without = (touched(at, scattering(foam(*some, seed=seed), 0.06, seed)) for some in ((lump,), ()))
        found += any(np.hypot(*(one.centre_m - lump[:2])) < 0.02 for one in with_lump.found)
        alarms += len(without.found)
        scatter.append(without.scatter)
    assert found >= fields - 1
    assert alarms == 0
    assert 0.03 < np.median(scatter) < 0.12


def test_the_exponent_tells_a_lump_from_foam_as_stiff() -> None:
    """What is felt the more the harder the tip presses lies below; foam that is stiffer is as much so at any force."""
    at, felt = lattice(0.035), scattering(foam((0.1, 0.1, 0.02, 0.015, 10.0)), 0.1, 1004)
    guess = InclusionHypotheses(*(np.array([one]) for one in ((0.1, 0.1), 0.02, 0.015, contrast_share(10.0), 1.0)))
    sd, logs = float(np.hypot(NOISE, 0.02)), [felt(xy_m) for xy_m in at]

    def given(rises: FloatArray) -> InclusionPosterior:
        each = zip(at, logs, HERTZ + STIFFER * (np.array(logs) - LEVEL) + rises, strict=True)
        samples = (StiffnessSample(xy_m, log, sd, exponent=bent, exponent_sd=0.024) for xy_m, log, bent in each)
        return InclusionPosterior(GRID, PRIOR, tuple(samples))

    assert not given(np.zeros(len(at))).found
    (one,) = given(guess.shifts(at, 0.0098).exponent[:, 0]).found
    assert np.hypot(*(one.centre_m - (0.1, 0.1))) < 0.01


@pytest.mark.slow
def test_a_search_finds_a_stiff_one_and_a_soft_one() -> None:
    posterior, stop = sought(foam((0.05, 0.06, 0.02, 0.012, 10.0), (0.15, 0.14, 0.025, 0.01, 0.1)))
    assert stop == "no lump missed"
    stiff = {one.stiff: one for one in posterior.found}
    assert len(posterior.found) == len(stiff) == 2
    assert np.hypot(*(stiff[True].centre_m - (0.05, 0.06))) < 0.02
    assert np.hypot(*(stiff[False].centre_m - (0.15, 0.14))) < 0.02
    levels = posterior.region_map().level
    assert levels[0] < LEVEL - 0.05
    assert levels[2] > LEVEL + 0.05


def test_a_search_of_foam_alone_ends_without_one_or_at_its_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("MOST_CENTRES", 250), ("DEPTHS_M", (0.01, 0.02)), ("TIMES", (4.0, 50.0))):
        monkeypatch.setattr(inclusion_posterior, name, value)  # quick
    posterior, stop = sought(foam())
    assert (stop, posterior.found) == ("no lump missed", ())
    assert posterior.missed_smallest < 0.05
    few, stop = sought(foam(), budget=4)
    assert (stop, len(few.touches)) == ("budget", 4)
    assert few.missed_smallest > 0.05


def test_it_refuses_lumps_that_do_not_fit() -> None:
    with pytest.raises(InputError, match="radius from"):
        InclusionPrior(smallest_m=0.2)
    with pytest.raises(InputError, match="smallest inclusions fit"):
        InclusionPosterior(MapGrid((0.1, 0.1)), InclusionPrior(smallest_m=0.06))


@pytest.mark.slow
@pytest.mark.parametrize("scatters", [False, True])
def test_what_it_says_of_missed_lumps_is_right_on_its_own_prior(scatters: bool) -> None:
    """Fields drawn from the prior, half with an inclusion of 2 cm radius, some touches each: as many inclusions are not
    found as it says, within three deviations. In even foam, and in foam that varies by 2 to 10 % over 4 cm."""
    random = np.random.default_rng(1000)
    said, missed = [], []
    for seed in range(120):
        lump = (*random.uniform(0.02, 0.18, 2), 0.02, random.choice([0.005, 0.01, 0.015, 0.02]), 10.0)
        there = bool(random.random() < EXISTS)
        at = random.uniform(0.03, 0.17, (random.integers(4, 20), 2))
        felt = foam(*([lump] if there else []), seed=seed)
        found = touched(at, scattering(felt, float(np.exp(random.uniform(-3.9, -2.3))), seed) if scatters else felt)
        said.append(found.missed[found.radii_m.index(0.02)])
        missed.append(there and not found.found)
    sd = float(np.sqrt(np.sum(np.multiply(said, 1.0 - np.array(said))))) / len(said)
    assert np.mean(missed) == pytest.approx(np.mean(said), abs=3.0 * sd + 0.02)
