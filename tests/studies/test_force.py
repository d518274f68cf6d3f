"""Random slabs and the forces predicted on them: what `python -m studies force` counts."""

import dataclasses

import numpy as np
import pytest

from deformscope.lab.slab import RigidTip, press
from deformscope.stages.poke import stiffness_field
from studies.force import ForceCase, TriedSlab, UnseenForce, apparent, force_rows, slab_cases, try_slab
from studies.reproduce.poke_slabs import BORDER, KINDS, SIZE, draw_slab
from studies.reproduce.poke_study import Press, observe, plan_of


@pytest.fixture(autouse=True)
def _fewer_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as these surfaces need: a third of the time."""
    monkeypatch.setattr(stiffness_field, "PARTICLES", 300)


@pytest.mark.parametrize("kind", KINDS)
def test_a_slab_has_24_places_and_inclusions_that_were_met(kind: str) -> None:
    for seed in range(1000, 1010):
        drawn = draw_slab(kind, seed)  # type: ignore[arg-type]
        assert drawn.places.shape == (24, 2)
        assert drawn.fitted.sum() == 12
        assert np.all((drawn.places > 0.02) & (drawn.places < np.array(SIZE[:2]) - 0.02))
        if "disc" in kind:
            inner = drawn.inside(drawn.places) > 0.0
            assert (inner & drawn.fitted).sum() >= 3
        again = draw_slab(kind, seed)  # type: ignore[arg-type]
        np.testing.assert_array_equal(drawn.places, again.places)


def test_groups_are_by_the_distance_to_the_border() -> None:
    drawn = draw_slab("stiff disc", 1000)
    middle = drawn.middle
    along = np.array([1.0, 0.0])
    assert drawn.group(middle) == "on the inclusion"
    assert drawn.group(middle + (drawn.radius - 0.9 * BORDER) * along) == "near a border"
    assert drawn.group(middle + (drawn.radius + 1.1 * BORDER) * along) == "in one material"
    assert draw_slab("gradual", 1000).group(middle) == "in one material"


@pytest.mark.slow
@pytest.mark.parametrize("aside", [-0.01, 0.02])
def test_what_a_poke_meets_beside_a_border_is_that_of_finite_elements(aside: float) -> None:
    """To 4 % of the difference of the two materials; the elements are other ones than the table's."""
    drawn = dataclasses.replace(
        draw_slab("halves", 1000), normal=np.array([1.0, 0.0]), middle=np.array([0.2, 0.15]), modulus=(20e3, 80e3)
    )
    at, tip = (0.2 + aside, 0.15), RigidTip((0.01, 0.01))
    point = np.array([[0.2, 0.15, SIZE[2]]])
    met = press(drawn.slab(), at, tip, point, depth=1e-3, finest=0.003).force
    alike = press(dataclasses.replace(drawn.slab(), young=20e3), at, tip, point, depth=1e-3, finest=0.003).force
    assert apparent(drawn, np.array([at]))[0] == pytest.approx(20e3 * met / alike, abs=0.04 * 60e3)
    swapped = dataclasses.replace(drawn, modulus=(80e3, 20e3), normal=-drawn.normal)
    np.testing.assert_allclose(swapped.apparent(np.array([at])), apparent(drawn, np.array([at])))


@pytest.mark.slow
def test_a_fast_slab_is_fitted_and_its_other_half_predicted() -> None:
    (found,) = try_slab((ForceCase("halves", 1003, scatter=0.03),))
    assert found.field == "materials"
    assert len(found.pokes) == 12
    sure = [poke for poke in found.pokes if poke.inside is not None and abs(poke.inside) > 0.06]
    assert sure
    assert max(abs(poke.error) for poke in sure) < 0.2
    for poke in found.pokes:
        assert poke.surface_error is None
        assert poke.held == (poke.low <= 1.0 <= poke.high)


def poke(error: float, held: bool, group: str = "in one material", own: bool = True) -> UnseenForce:
    return UnseenForce(group, (0.1, 0.1), 0.05, True, 1.0, error, 0.9, 1.1, held, 0.2, 0.04, own)  # type: ignore[arg-type]


def test_rows_pool_pokes_by_slab_and_group() -> None:
    tried = [
        TriedSlab(ForceCase("halves", 0), "materials", (poke(0.3, False, own=False), poke(-0.1, True))),
        TriedSlab(ForceCase("stiff disc", 0), "materials", (poke(0.0, True, "on the inclusion"),)),
        TriedSlab(ForceCase("halves", 1, 0.1), "materials", (poke(0.0, True),)),
    ]
    rows = force_rows(tried)
    assert [(row["slab"], row["group"], row["scatter"]) for row in rows] == [
        ("all", "in one material", 0.0),
        ("all", "on the inclusion", 0.0),
        ("halves", "in one material", 0.0),
        ("stiff disc", "on the inclusion", 0.0),
        ("all", "in one material", 0.1),
        ("halves", "in one material", 0.1),
    ]
    assert rows[0]["error"] == pytest.approx(np.sqrt(0.05))
    assert rows[0]["own_error"] == pytest.approx(0.1)
    assert (rows[0]["wrong"], rows[0]["held"].hits, rows[0]["held"].cases) == (1, 1, 2)
    assert rows[0]["width"] == pytest.approx(0.2)
    assert rows[0]["surface_error"] == pytest.approx(0.04)
    assert rows[2]["surface_error"] == pytest.approx(0.04)


def test_cases_are_every_slab_under_every_scatter() -> None:
    slabs = slab_cases(("halves", "one material"), range(1000, 1002), (0.0, 0.1), False)
    assert [cases[0].kind for cases in slabs] == ["halves", "one material"] * 2
    assert [(case.seed, case.scatter) for case in slabs[3]] == [(1001, 0.0), (1001, 0.1)]


def test_each_condition_is_a_case_and_a_row_of_its_own() -> None:
    slabs = slab_cases(("halves",), range(2000, 2001), (0.0,), True, conditions=("as given", "twice as deep"))
    assert [cases[0].condition for cases in slabs] == ["as given", "twice as deep"]
    rows = force_rows([TriedSlab(cases[0], "materials", (poke(0.1 * i, True),)) for i, cases in enumerate(slabs)])
    assert [(row["slab"], row["condition"], row["error"]) for row in rows] == [
        ("all", "as given", 0.0),
        ("halves", "as given", 0.0),
        ("all", "twice as deep", pytest.approx(0.1)),
        ("halves", "twice as deep", pytest.approx(0.1)),
    ]


def test_a_plan_has_the_slabs_own_places() -> None:
    drawn = draw_slab("stiff disc", 1001)
    plan = plan_of(drawn)
    np.testing.assert_allclose([press.at for press in plan.fitted], drawn.places[drawn.fitted])
    np.testing.assert_allclose([press.at for press in plan.unseen], drawn.places[~drawn.fitted])
    seen = observe(dataclasses.replace(plan.slab, size=(0.08, 0.08, 0.02)), Press((0.04, 0.04), (0.02, 0.02), 1.0))
    assert seen.force_n == 1.0
