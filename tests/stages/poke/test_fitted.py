"""Models that can be poked: predictions against what the same law does, scaling, intervals, models of particles."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.fit.force import contact_stiffness
from deformscope.stages.fit.model import Observation
from deformscope.stages.msm import clusters
from deformscope.stages.msm.poke import Law, Poke, Tip
from deformscope.stages.msm.solver import Msm
from deformscope.stages.poke.fitted import FittedModel, from_pair, predict
from deformscope.stages.poke.poke_estimate import conclude
from deformscope.stages.poke.poke_fit import fit_pokes, seen_poke
from tests.stages.pokes import LAW, SPACING, STIFFNESS, poked, surface


@pytest.fixture(scope="module")
def model() -> FittedModel:
    found = fit_pokes(surface(), [seen_poke(poked((0.09, 0.08)))], spacing=SPACING, cluster_sizes=[3])
    return conclude(found, level=0.9, settings={}, provenance={}).model


def test_a_poke_with_another_tip_depth_and_place_is_as_the_law_that_made_both(model: FittedModel) -> None:
    truth = poked((0.11, 0.07), side=0.04, depth=0.001)
    asked = seen_poke(truth)
    found = predict(model, Poke(asked.at, asked.tip, depth=asked.depth))
    assert np.sqrt(np.mean(np.linalg.norm(found.at(truth.rest) - truth.deformed, axis=1) ** 2)) < 0.01 * asked.depth
    assert found.force == pytest.approx(truth.force_n, rel=0.02)
    assert found.force_interval[0] < found.force < found.force_interval[1]
    assert found.converged


def test_a_force_gives_the_depth_that_makes_it(model: FittedModel) -> None:
    tip = Tip("flat", (0.02, 0.02))
    at = np.array([0.08, 0.08, 0.03])
    found = predict(model, Poke(at, tip, force=1.5))
    assert found.force == pytest.approx(1.5, rel=2e-3)
    assert predict(model, Poke(at, tip, depth=found.depth)).force == pytest.approx(1.5, rel=1e-2)


def test_a_poke_that_the_material_has_no_room_for_is_refused(model: FittedModel) -> None:
    at, tip = np.array([0.08, 0.08, 0.03]), Tip("flat", (0.02, 0.02))
    with pytest.raises(InputError, match="less deep than the 30 mm"):
        predict(model, Poke(at, tip, depth=3.0))
    with pytest.raises(InputError, match="a force that the 30 mm of material under the tip can bear; got 500 N"):
        predict(model, Poke(at, tip, force=500.0))


def test_what_lies_beyond_what_was_fitted_is_called_extrapolated(model: FittedModel) -> None:
    """Fitted to 2 mm with a tip of 20 mm, in 30 mm of material."""
    tip, narrow = Tip("flat", (0.02, 0.02)), Tip("flat", (0.01, 0.01))
    assert model.fitted_depth == pytest.approx(0.002)
    assert model.fitted_strain == pytest.approx(0.1)
    assert model.beyond(0.002, tip) == ()
    assert model.beyond(0.0024, tip) == ()
    assert model.beyond(0.004, tip) == ("4 mm deep, fitted to 2 mm", "depth over tip width 0.2, fitted to 0.1")
    assert model.beyond(0.0018, narrow) == ("depth over tip width 0.18, fitted to 0.1",)
    assert model.beyond(0.015, tip)[-1].startswith("50% of the thickness deep")
    unknown = dataclasses.replace(model, fitted_depth=float("nan"), fitted_strain=float("nan"))
    assert unknown.beyond(0.004, tip) == ()  # a model saved before these were kept
    at = np.array([0.08, 0.08, 0.03])
    assert predict(model, Poke(at, tip, depth=0.004)).extrapolated == model.beyond(0.004, tip)


def test_a_finer_lattice_of_the_same_material_has_nearly_the_same_force(model: FittedModel) -> None:
    at, tip = np.array([0.08, 0.08, 0.03]), Tip("flat", (0.04, 0.04))
    coarse = predict(model, Poke(at, tip, depth=0.001))
    fine = predict(
        dataclasses.replace(model, spacing=SPACING / 2, stiffness=model.stiffness / 2), Poke(at, tip, depth=0.001)
    )
    assert coarse.force is not None
    assert fine.force == pytest.approx(coarse.force, rel=0.25)
    assert len(fine.rest) > 4 * len(coarse.rest)


def test_what_rivals_say_of_another_tip_counts_in_place_of_what_tips_do_at_most(model: FittedModel) -> None:
    """One poke, a tip twice as wide: half widths of Student's t by hand. A rival that hardly differs adds nothing."""
    from scipy.stats import t

    from deformscope.stages.poke.fitted import TIP_SHARE, Rival
    from deformscope.stages.poke.stiffness_field import ERROR, FREEDOM, OWN_SD

    asked = Poke(np.array([0.08, 0.08, 0.03]), Tip("flat", (0.04, 0.04)), depth=0.001)

    def half_width(*factors: float) -> float:
        rivals = tuple(Rival(LAW, np.array([one * STIFFNESS]), 0.01) for one in factors)
        found = predict(dataclasses.replace(model, rivals=rivals), asked)
        return 0.5 * float(np.log(found.force_interval[1] / found.force_interval[0]))

    in_deviations = t(FREEDOM).ppf(0.95) / t(FREEDOM).std()
    place = OWN_SD**2 + ERROR.touch_sd**2
    alone = in_deviations * np.sqrt(place + TIP_SHARE**2)
    assert half_width() == pytest.approx(alone, rel=0.01)
    assert half_width(1.03) == pytest.approx(alone, rel=0.01)
    assert half_width(1.5) == pytest.approx(in_deviations * np.sqrt(place + np.log(1.5) ** 2), rel=0.05)
    assert half_width(1.5, 1.0 / 1.5) == pytest.approx(half_width(1.5), rel=0.05)


def test_between_pokes_that_differ_the_force_may_be_of_either_material(model: FittedModel) -> None:
    """Four pokes, two of 50 N/m and two of 250: between them the interval spans both, at each it is narrow."""
    tip = Tip("flat", (0.02, 0.02))
    places = np.array([[x, y, 0.03] for x in (0.04, 0.12) for y in (0.05, 0.11)])
    stiffness = STIFFNESS * np.array([1.0, 1.02, 5.0, 5.1])
    unsure = dataclasses.replace(model, places=places, stiffness=stiffness, left_out=np.zeros(4))
    soft, between, stiff = (
        predict(unsure, Poke(np.array([x, 0.08, 0.03]), tip, depth=0.001)) for x in (0.03, 0.08, 0.13)
    )
    assert soft.force is not None
    assert stiff.force > 4.0 * soft.force
    assert between.force_interval[0] < 1.2 * soft.force  # the lattice is wider there than near the surface's side
    assert between.force_interval[1] > 0.9 * stiff.force
    for one in places:
        there = predict(unsure, Poke(one, tip, depth=0.001))
        assert there.force is not None
        assert there.force_interval[1] < 2.0 * there.force


def test_another_tip_and_a_greater_depth_widen_the_interval(model: FittedModel) -> None:
    at = np.array([0.08, 0.08, 0.03])

    def ratio(width: float, depth: float) -> float:
        found = predict(model, Poke(at, Tip("flat", (width, width)), depth=depth))
        return found.force_interval[1] / found.force_interval[0]

    same = ratio(0.02, 0.002)
    assert ratio(0.02, 0.001) == pytest.approx(same, rel=1e-3)
    assert ratio(0.04, 0.002) > 1.05 * same
    assert ratio(0.02, 0.006) > 1.2 * same


def test_a_model_without_force_predicts_shape_alone(model: FittedModel) -> None:
    mute = dataclasses.replace(model, stiffness=np.zeros(0), places=np.zeros((0, 3)), left_out=np.zeros(0))
    at, tip = np.array([0.08, 0.08, 0.03]), Tip("flat", (0.02, 0.02))
    found = predict(mute, Poke(at, tip, depth=0.001))
    assert found.force is None
    assert found.force_interval is None
    with pytest.raises(InputError, match="a depth"):
        predict(mute, Poke(at, tip, force=1.0))


def block(depth: float = 0.004) -> tuple[Observation, float]:
    """A sheet pressed from above in the middle, its lower edge held; and the reaction per unit of stiffness."""
    x, y = np.meshgrid(np.arange(13) * 0.01, np.arange(6) * 0.01, indexing="ij")
    rest = np.column_stack([x.ravel(), y.ravel()])
    bottom, top = (
        np.flatnonzero(rest[:, 1] < 1e-9),
        np.flatnonzero((rest[:, 1] > 0.049) & (abs(rest[:, 0] - 0.06) < 0.011)),
    )
    held = np.concatenate([bottom, top])
    body = Msm(rest, clusters.lattice(rest, (13, 6), np.arange(78), 3), held)
    target = rest[held].copy()
    target[len(bottom) :, 1] -= depth
    position = body.relax(target, 0.6).position[0]
    force = float(-body.reaction(position, 0.6)[0, top, 1].sum())
    seen = Observation(
        rest, position, held, np.ones(78, dtype=bool), shape=(13, 6), cell=np.arange(78), force_n=force, contact=top
    )
    return seen, force


def test_particles_of_a_pair_can_be_poked_where_they_were_not() -> None:
    seen, force = block()
    made = from_pair(seen, Law(0.6, 0.0, 3), 40.0, 1e-5, {})
    np.testing.assert_array_equal(made.toward, [0.0, -1.0])
    assert made.tip.size == pytest.approx((0.02,))
    assert not made.tip.slips
    same = predict(
        made, Poke(np.array([0.06, 0.05]), Tip("flat", (0.02,), slips=False), depth=0.004), precision="float64"
    )
    np.testing.assert_allclose(same.position, seen.deformed, atol=1e-7)
    assert same.force == pytest.approx(40.0 * force, rel=1e-3)
    aside = predict(
        made, Poke(np.array([0.03, 0.05]), Tip("flat", (0.02,), slips=False), depth=0.004), precision="float64"
    )
    np.testing.assert_allclose(made.rest[aside.touched, 0], [0.02, 0.03, 0.04])
    assert aside.position[aside.touched, 1].max() == pytest.approx(0.046)
    with pytest.raises(InputError, match="layers below a surface"):
        aside.at(np.zeros((1, 3)))


def test_a_model_of_images_has_the_measured_stiffness_at_the_face_of_the_contact() -> None:
    seen, _ = block()
    filmed = dataclasses.replace(
        seen, rest=1e4 * seen.rest, deformed=1e4 * seen.deformed, unit="px", metres_per_unit=1e-4, force_n=3.0
    )
    stiffness = contact_stiffness([filmed], 0.9)
    assert stiffness is not None
    made = from_pair(filmed, Law(0.6, 0.0, 3), 40.0, 0.1, {})
    assert made.fitted_depth > 1.02 * 0.004
    for share in (1.0, 0.5):
        depth = share * 3.0e-3 / stiffness[0]
        same = predict(made, Poke(made.places[0], made.tip, depth=depth))
        assert same.force == pytest.approx(share * 3.0, rel=0.02)
        assert same.force_interval[0] < share * 3.0 < same.force_interval[1]
    assert not len(from_pair(filmed, Law(0.6, 0.0, 3), None, 0.1, {}).stiffness)


def test_a_model_of_pixels_without_a_scale_is_refused() -> None:
    seen, _ = block()
    with pytest.raises(InputError, match="in metres"):
        from_pair(dataclasses.replace(seen, metres_per_unit=None, unit="px"), Law(0.6), None, 0.0, {})
