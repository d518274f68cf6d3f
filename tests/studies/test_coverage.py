"""Random objects through the calibration: intervals hold the truth about as often as they say, in each condition."""

import numpy as np
import pytest

from deformscope.stages.msm import clusters, reference
from studies import random_bodies
from studies.coverage import coverage_rows
from studies.quantities import Rate
from studies.random_bodies import CONDITIONS, NOTHING, Case, NothingCase, Outcome, random_body, rank_counts, ranks_png
from studies.unseen_pokes import FoamBody, PokeCase, try_unseen_poke
from tests.cases import slow_but
from tests.stages import reference_states

FAST = 12
EXACT = [one.name for one in CONDITIONS].index("independent noise, held stated exact")


def rate_of(outcomes: list[Outcome]) -> Rate:
    return Rate(len(outcomes), sum(one.covered for one in outcomes))


@pytest.mark.parametrize("condition", slow_but([EXACT], range(len(CONDITIONS))), ids=[one.name for one in CONDITIONS])
def test_intervals_hold_truths_at_their_level(condition: int) -> None:
    """Within 3 binomial deviations of 90 %, on few objects; thousands by `deformscope coverage`."""
    outcomes = [random_bodies.try_object(Case(condition, "prior", number, seed=5)) for number in range(FAST)]
    assert rate_of(outcomes).rate >= 0.9 - 3.0 * np.sqrt(0.9 * 0.1 / FAST)
    assert sum(one.confident_wrong for one in outcomes) == 0
    assert all(one.interval[0] <= one.value <= one.interval[1] for one in outcomes)


@pytest.mark.slow
@pytest.mark.parametrize("condition", range(len(CONDITIONS)), ids=[one.name for one in CONDITIONS])
def test_coverage_of_many_is_close_to_the_level(condition: int) -> None:
    outcomes = [random_bodies.try_object(Case(condition, "prior", number, seed=6)) for number in range(400)]
    assert 0.87 - 2.0 * 0.015 <= rate_of(outcomes).rate <= 0.93 + 2.0 * 0.015
    assert sum(one.confident_wrong for one in outcomes) <= 4


def test_the_truths_are_static_states_of_the_reference() -> None:
    body = random_body(np.random.default_rng(1), 2)
    grouped = clusters.lattice(body.rest, body.shape, np.arange(len(body.rest)), body.cluster_size)
    spec = reference.build_rest(body.rest, grouped, body.held)
    expected, _ = reference_states.relax(spec, body.held_position, beta=0.7)
    np.testing.assert_allclose(body.deform(0.7), expected, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", NOTHING)
def test_data_without_information_are_called_unidentified(kind: random_bodies.Nothing) -> None:
    verdicts = [random_bodies.try_nothing(NothingCase(kind, number, seed=5)) for number in range(8)]
    assert verdicts.count("unidentified") >= 7


def test_correlated_noise_has_unit_variance_and_a_reach_of_about_a_cell() -> None:
    rng = np.random.default_rng(2)
    rest = np.stack(np.meshgrid(np.arange(8) * 0.01, np.arange(8) * 0.01, indexing="ij"), -1).reshape(-1, 2)
    draws = np.stack([random_bodies.random_noise(rng, rest, correlated=True) for _ in range(400)])
    assert draws.var() == pytest.approx(1.0, rel=0.1)
    beside = np.mean(draws[:, 27] * draws[:, 28])
    beyond = np.mean(draws[:, 27] * draws[:, 31])
    assert 0.3 < beside < 0.7
    assert beyond < 0.1


def test_rates_have_wilson_bands() -> None:
    low, high = Rate(100, 90).band  # Wilson 1927: 0.8256 to 0.9448
    assert (low, high) == pytest.approx((0.8256, 0.9448), abs=5e-4)


def test_the_table_counts_ends_of_the_range_apart() -> None:
    def outcome(beta: float, low: float, high: float, dim: int = 2) -> Outcome:
        return Outcome("a", dim, 3, 20, beta, low, (low, high), 0.5, "identified", 0.1)

    between = [outcome(0.5, 0.4, 0.6), outcome(0.5, 0.6, 0.7), outcome(0.5, 0.7, 0.8, 3)]
    found = {row["group"]: row for row in coverage_rows([*between, outcome(0.0, 0.0, 0.1), outcome(0.98, 0.9, 0.99)])}
    assert (found["all"]["covered"].cases, found["all"]["covered"].hits) == (3, 1)
    assert found["all"]["confident_wrong"] == 1
    assert found["3D"]["covered"].cases == 1
    assert found["beta = 0"]["covered"].rate == found["beta > 0.97"]["covered"].rate == 1.0


def test_ranks_are_counted_and_drawn() -> None:
    rng = np.random.default_rng(3)
    outcomes = [
        Outcome(name, 2, 3, 20, 0.5, 0.5, (0.4, 0.6), float(rng.uniform()), "identified", 0.1)
        for name in ("a", "b")
        for _ in range(50)
    ]
    counts = rank_counts(outcomes)
    assert {name: sum(count) for name, count in counts.items()} == {"a": 50, "b": 50}
    assert len(ranks_png(counts)) > 10_000


@pytest.mark.parametrize("dim", [2, 3])
def test_a_foam_body_follows_its_pokes(dim: int) -> None:
    """Held layers stand still, the patch moves as one, and the rest moves less."""
    rng = np.random.default_rng(dim)
    body = FoamBody(rng, dim)
    held, deformed = body.poke(rng)
    moved = deformed - body.rest
    still = body.rest[held][:, 0] <= 0.0
    np.testing.assert_allclose(moved[held[still]], 0.0, atol=1e-12)
    np.testing.assert_allclose(moved[held[~still]], moved[held[~still]][:1].repeat((~still).sum(), 0), atol=1e-12)
    push = np.linalg.norm(moved[held[~still]][0])
    assert 0.0 < np.linalg.norm(moved, axis=1).mean() < push


def test_unseen_pokes_lie_within_predictive_intervals() -> None:
    every = [try_unseen_poke(PokeCase(number, seed=5)) for number in range(2)]
    rate = sum(one.covered for one in every) / sum(one.coordinates for one in every)
    assert 0.7 <= rate <= 1.0
    assert all(one.error < one.motion for one in every)
