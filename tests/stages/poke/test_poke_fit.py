"""Layers fitted to pokes: known laws come back, and what was measured of each poke is read rightly."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.msm.poke import Law, Poke, Tip
from deformscope.stages.poke.poke_estimate import conclude, continuum
from deformscope.stages.poke.poke_fit import default_spacing, fit_pokes, seen_poke
from tests.stages import reference_states
from tests.stages.pokes import LAW, SPACING, STIFFNESS, poked, surface


def fit(*seen: object, **options: object):  # type: ignore[no-untyped-def]
    pokes = [seen_poke(one) for one in seen]  # type: ignore[arg-type]
    return fit_pokes(surface(), pokes, spacing=SPACING, **options)  # type: ignore[arg-type]


def test_a_poke_is_read_from_what_was_touched() -> None:
    poke = seen_poke(poked((0.09, 0.08), side=0.02, depth=0.002))
    np.testing.assert_allclose(poke.at, [0.09, 0.08, 0.03])
    assert poke.tip.shape == "flat"
    assert poke.tip.size == pytest.approx((0.02, 0.02))
    assert poke.tip.slips
    assert poke.depth == pytest.approx(0.002)
    assert len(poke.touched) == 9


def test_a_tip_that_sticks_is_seen_to_stick_and_a_tip_that_is_reported_is_believed() -> None:
    sticking = poked((0.09, 0.08), slips=False)
    assert not seen_poke(sticking).tip.slips
    reported = dataclasses.replace(sticking, tip=Tip("disc", (0.025,)))
    assert seen_poke(reported).tip == Tip("disc", (0.025,), slips=False)


def test_a_known_law_and_stiffness_come_back() -> None:
    found = fit(poked((0.09, 0.08)), cluster_sizes=[3])
    assert found.best.law.beta == pytest.approx(LAW.beta, abs=0.002)
    assert found.best.law.theta == pytest.approx(LAW.theta, abs=0.005)
    assert found.stiffness(found.best)[1] == pytest.approx([STIFFNESS], rel=0.001)
    assert found.best.surface_error.max() < 0.003
    assert found.best.converged


def test_a_tip_whose_place_is_known_presses_all_below_it() -> None:
    at = (0.0938, 0.0835)  # points 1 cm apart show four of nine columns
    seen = poked(at)
    known = dataclasses.replace(seen, tip=Tip("flat", (0.02, 0.02)), tip_at=np.array([*at, 0.03]))
    np.testing.assert_allclose(seen_poke(known).at, [*at, 0.03])
    found, without = (fit(one, cluster_sizes=[3]) for one in (known, seen))
    assert found.best.law.beta == pytest.approx(LAW.beta, abs=0.02)
    assert found.stiffness(found.best)[1] == pytest.approx([STIFFNESS], rel=0.01)
    assert abs(without.stiffness(without.best)[1][0] / STIFFNESS - 1.0) > 0.2


def test_the_true_cluster_size_is_chosen_and_theta_stays_where_it_is_reported() -> None:
    found = fit(poked((0.09, 0.08), law=Law(0.45, 0.7, 4)), poked((0.06, 0.09), law=Law(0.45, 0.7, 4), side=0.04))
    assert found.best.law.cluster_size == 4
    assert np.isfinite(found.best.held_out).all()
    kept = fit(poked((0.09, 0.08), law=Law(0.45, 0.0, 3)), cluster_sizes=[3], theta=0.0)
    assert kept.best.law.theta == 0.0
    assert kept.best.law.beta == pytest.approx(0.45, abs=0.01)


def test_each_poke_has_its_stiffness_and_the_field_is_judged_by_pokes_left_out() -> None:
    soft = [(0.04, 0.05), (0.06, 0.08), (0.04, 0.08), (0.04, 0.11), (0.06, 0.12)]
    stiff = [(0.12, 0.05), (0.14, 0.06), (0.14, 0.09), (0.12, 0.10), (0.14, 0.12)]
    seen = [poked(one, stiffness=40.0) for one in soft] + [poked(one, stiffness=90.0) for one in stiff]
    reported = conclude(fit(*seen, cluster_sizes=[3]), level=0.9, settings={}, provenance={})
    np.testing.assert_allclose(reported.model.stiffness, [40.0] * 5 + [90.0] * 5, rtol=0.02)
    assert reported.model.field_kind == "materials"
    beside = Poke(np.array([0.15, 0.05, 0.03]), Tip("flat", (0.02, 0.02)), depth=1e-3)
    value, (low, high) = reported.model.stiffness_at(beside, SPACING)
    assert value == pytest.approx(90.0, rel=0.03)
    assert low < 90.0 < high
    assert [row.stiffness_n_per_m for row in reported.rows()] == pytest.approx(reported.model.stiffness.tolist())
    # each has pokes of its own material beside it, none stands on the border; the other material is -56 or +125 % off
    assert np.abs(reported.model.left_out).max() < 0.15


@pytest.mark.slow
def test_the_interval_holds_the_truth_under_noise_and_shrinks_with_it() -> None:
    widths = []
    for noise in (2e-5, 1e-4):
        found = fit(poked((0.09, 0.08), noise=noise, seed=3), cluster_sizes=[3])
        reported = conclude(found, level=0.9, settings={}, provenance={}).estimate
        low, high = reported.interval
        assert low <= LAW.beta <= high
        assert low <= reported.value <= high
        assert reported.stiffness[1][0] <= STIFFNESS <= reported.stiffness[1][1]
        widths.append(high - low)
    assert widths[0] < widths[1]


def test_without_a_force_there_is_no_stiffness() -> None:
    found = fit(poked((0.09, 0.08), stiffness=None), cluster_sizes=[3])
    reported = conclude(found, level=0.9, settings={}, provenance={})
    assert reported.estimate.stiffness is None
    assert reported.estimate.stiffness_verdict == "unidentified"
    assert reported.model.stiffness.size == 0


def test_what_is_no_poke_of_a_surface_is_refused() -> None:
    seen = poked((0.09, 0.08))
    lifted = dataclasses.replace(seen, deformed=2 * seen.rest - seen.deformed)
    with pytest.raises(InputError, match="presses the surface down"):
        seen_poke(lifted)
    flat = dataclasses.replace(seen, rest=seen.rest[:, :2].copy(), deformed=seen.deformed[:, :2].copy())
    with pytest.raises(InputError, match="surface in space"):
        seen_poke(flat)


def test_the_default_spacing_resolves_the_tip() -> None:
    assert default_spacing(surface(), Tip("flat", (0.02, 0.03))) == pytest.approx(0.005)
    assert default_spacing(surface(), Tip("disc", (1e-4,))) == pytest.approx(0.001)


def test_the_moduli_of_an_even_strain_are_those_of_the_energy() -> None:
    """Energy of one window under a small even strain, by the reference, over the volume that one window stands for."""
    from deformscope.stages.msm import clusters, reference
    from tests.stages.bodies import lattice

    law, k, h = Law(0.45, 0.7, 3), 50.0, 0.01
    rest = lattice((3, 3, 3), h)
    body = reference.build_rest(rest, clusters.single(27), np.array([], dtype=int))
    young, poisson = continuum(law, k, h)
    lame, mu = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), 0.5 * young / (1 + poisson)
    for strain in (np.diag([1e-5, 0, 0]), np.diag([1e-5, -1e-5, 0]), np.full((3, 3), 1e-5)):
        energy = k * reference_states.energy(rest @ (np.eye(3) + strain), body, law.beta, law.theta) / h**3
        expected = 0.5 * lame * np.trace(strain) ** 2 + mu * np.sum(strain**2)
        assert energy == pytest.approx(expected, rel=1e-3)
