"""Pokes that were not fitted, on slabs of finite elements: what `python -m studies reproduce pokes` promises."""

import pytest

from deformscope.lab.slab import Slab
from studies.reproduce.poke_study import Press, plans, rows, study


def test_unseen_pokes_have_other_places_and_tips() -> None:
    for plan in plans():
        fitted = {press.sides for press in plan.fitted}
        assert all(press.sides not in fitted for press in plan.unseen)
        assert not {press.at for press in plan.unseen} & {press.at for press in plan.fitted}
        for press in (*plan.fitted, *plan.unseen):
            assert all(0.02 <= place <= side - 0.02 for place, side in zip(press.at, plan.slab.size, strict=False))
        if plan.drawn is not None:
            assert len(plan.fitted) == len(plan.unseen) == 12


@pytest.mark.slow
def test_unseen_pokes_are_predicted() -> None:
    studied = study(plans()[0])
    table = rows([studied])
    ours = [row for row in table if row["method"] == "MSM"]
    assert len(ours) == len(studied.plan.unseen)
    for row in ours:
        assert float(str(row["surface_error"])) <= 0.055
        assert abs(float(str(row["force_error"]))) <= 0.1
        low, high = row["force_interval_n"]  # type: ignore[misc]
        assert low <= row["force_n"] <= high
    assert {row["method"] for row in table} == {"MSM", "rigid", "half-space", "finite elements"}


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_other_slabs_are_predicted_too(poisson: float) -> None:
    from studies.reproduce.poke_study import TIP, PokeStudyPlan

    slab = Slab((0.24, 0.24, 0.04), 80e3, poisson)
    plan = PokeStudyPlan(
        "thin",
        slab,
        (Press((0.12, 0.12), TIP, 4.0),),
        (Press((0.1, 0.13), (0.04, 0.04), 8.0), Press((0.14, 0.11), (0.03, 0.03), 2.0)),
    )
    for row in rows([study(plan)]):
        if row["method"] == "MSM":
            assert float(str(row["surface_error"])) <= 0.055
            assert abs(float(str(row["force_error"]))) <= 0.1
