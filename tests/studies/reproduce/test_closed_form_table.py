"""Table 4.1 in closed form: what a contact feels, and an exploration of it."""

import numpy as np
import pytest

from deformscope.lab.scenes import built_in
from deformscope.stages.regions.levels import RegionPrior
from studies.reproduce.closed_form_table import MOST_LOG, RIGID_LOG, _felt, run_closed_form, true_log_stiffness
from studies.reproduce.table41_runs import TableJob


def test_a_contact_feels_what_is_around_it() -> None:
    """One material far from the border, the mean of their stiffness on it; what is rigid counts for no more than its
    bound."""
    scene = built_in("two-60-rigid", 4)
    x, y = scene.drawn["border x"], scene.size_m[1] / 2
    middle, left, right = (_felt(scene, np.array([x + aside, y]), RegionPrior()) for aside in (0.0, -0.1, 0.1))
    soft = float(true_log_stiffness(np.array(scene.pieces[0].modulus_pa)))
    assert sorted((left, right)) == pytest.approx([soft, MOST_LOG], abs=1e-6)
    assert middle == pytest.approx(np.log(0.5 * (np.exp(left) + np.exp(right))), abs=0.2)


def test_an_exploration_in_closed_form_is_a_row_as_any() -> None:
    run = run_closed_form(TableJob("two-60-rigid", 2, touches=4, closed_form=True, clean=True))
    assert [one.touches for one in run.after] == [1, 2, 3, 4]
    assert any(one.rigid and one.log_stiffness == RIGID_LOG for one in run.after)
    last = run.after[-1]
    assert last.score.right
    assert last.score.rigid_found
    assert last.score.iou is not None
    # two regions: what is not in the union's intersection is wrong
    assert 0.5 * (1.0 - last.score.iou) < last.score.wrong < 1.0 - last.score.iou
    assert 0.2 < last.unseen < 0.5
    assert run.stop_after is None
