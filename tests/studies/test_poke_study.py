"""Pokes that were not fitted, on slabs of finite elements: what `deformscope reproduce pokes` promises."""

from __future__ import annotations

import pytest

from deformscope.lab.slab import Slab
from deformscope.studies.poke_study import PLANS, Press, rows, study


def test_unseen_pokes_lie_away_from_borders_and_edges() -> None:
    for plan in PLANS:
        for press in plan.unseen:
            for side, place in enumerate(press.at):
                assert 0.03 <= place <= plan.slab.size[side] - 0.03
            assert all(press.at != fitted.at for fitted in plan.fitted)
        if callable(plan.slab.young):
            assert all(abs(press.at[0] - 0.2) >= 0.03 + 0.5 * press.sides[0] for press in plan.unseen)
        tips = {press.sides for press in plan.unseen} - {press.sides for press in plan.fitted}
        assert tips


@pytest.mark.slow
@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.name)
def test_unseen_pokes_are_predicted(plan: object) -> None:
    studied = study(plan)  # type: ignore[arg-type]
    limit = 0.055 if not callable(studied.plan.slab.young) else 0.1
    table = rows([studied])
    ours = [row for row in table if row["method"] == "MSM"]
    assert len(ours) == len(studied.plan.unseen)
    for row in ours:
        assert float(str(row["surface_error"])) <= limit
        assert abs(float(str(row["force_error"]))) <= 0.1
    assert {row["method"] for row in table} == {"MSM", "rigid", "half-space", "finite elements"}
    if callable(studied.plan.slab.young):
        assert studied.found.model.field_kind == "materials"


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_other_slabs_are_predicted_too(poisson: float) -> None:
    from deformscope.studies.poke_study import TIP, PokeStudyPlan

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
