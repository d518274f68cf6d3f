"""Table 4.1: the truth it is held against, one row of it, and what it says of many rows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deformscope.experiments.explore.options import ExploreOptions
from deformscope.lab.scenes import built_in
from deformscope.stages.poke.contact import layer_modulus
from studies.map_score import MapScore
from studies.reproduce.surface_robot import true_map
from studies.reproduce.table41_robot import run_table
from studies.reproduce.table41_runs import MapAfter, TableJob, TableRun
from studies.reproduce.table41_summary import compare, curves, first_passage, summarise

SCORE = MapScore(2, "regions", True, 0.9, 0.8, 0.01, True, None, 1.0, 0.05, 0.9)


def after(touches: int, iou: float) -> MapAfter:
    place = (0.1, 0.1)
    score = replace(SCORE, iou=iou, least_iou=iou - 0.1)
    return MapAfter(touches, 0.2 * touches, 8.0 * touches, 0.5, place, 0.0, 0.05, False, 0.0, True, score, {"2": 1.0})


def run(seed: int, gain: float, planner: str = "regions", stop: int | None = None) -> TableRun:
    """IoU that rises by `gain` with every of ten touches."""
    job = TableJob("disc", seed, planner, 10)  # type: ignore[arg-type]
    return TableRun(job, 2, tuple(after(n, min(gain * n, 1.0)) for n in range(1, 11)), 3.0, stop, 1.0)


def test_the_truth_is_what_the_closed_form_of_a_bonded_layer_says() -> None:
    """Dimitriadis et al. (2002); they press a paraboloid, and the lab's elements are within 3 % of a ball's force."""
    scene = built_in("two-150-300", 3)
    truth = true_map(scene, ExploreOptions())
    for piece, level in zip(scene.pieces, truth.level, strict=True):
        depth_m = 1e-3 * 3.0 / np.exp(level)
        found = layer_modulus(depth_m, 3.0, radius_m=0.01, thickness_m=scene.thickness_m, poisson=scene.poisson)
        assert found == pytest.approx(piece.modulus_pa, rel=0.04)
    assert truth.labels is not None
    np.testing.assert_array_equal(truth.log_stiffness, truth.level[truth.labels])


def test_the_truth_of_a_gradient_rises_with_its_modulus_and_rigid_is_known() -> None:
    scene = built_in("gradient", 1)
    truth = true_map(scene, ExploreOptions())
    order = np.argsort(scene.modulus_pa(scene.cells_m()), axis=None)
    assert truth.region_count == 0
    assert (np.diff(truth.log_stiffness.ravel()[order]) >= 0.0).all()
    assert true_map(built_in("two-150-rigid", 1), ExploreOptions()).rigid.tolist() == [False, True]


@pytest.mark.slow
def test_a_row_of_the_table() -> None:
    found = run_table(TableJob("two-150-rigid", 1, touches=3))
    assert len(found.after) == 3
    assert found.max_force_n < 8.0
    last = found.after[-1]
    assert last.score.ordered
    assert last.travel_m > 0.1
    assert last.robot_s > last.travel_m / 0.05
    soft = [one for one in found.after if not one.rigid]
    assert soft
    assert all(abs(one.log_stiffness - one.felt_log_stiffness) < 0.1 for one in soft)


def test_a_plan_that_says_enough_ends_the_robots_run_and_not_the_comparison() -> None:
    stopped = run(0, 0.1, stop=5)
    assert stopped.at(3).touches == 3
    assert stopped.at(8).touches == 5
    assert run(0, 0.1).at(12).touches == 10
    assert first_passage(stopped, 0.75)[0]["touches"] == 8


def test_first_passage_and_its_ratio() -> None:
    slow = [run(seed, 0.1, "max-variance") for seed in range(5)]
    fast = [run(seed, 0.2) for seed in range(5)]
    assert first_passage(slow[0], 0.75) == ({"touches": 8, "travel_m": pytest.approx(1.6), "robot_s": 64}, True)
    assert first_passage(run(0, 0.05), 0.75)[1] is False
    reported = compare(fast, slow, 0.75)
    assert (reported["touches"], reported["touches_against"]) == (4.0, 8.0)
    assert [reported[f"touches_{what}"] for what in ("ratio", "low", "high")] == [0.5, 0.5, 0.5]
    assert [reported[f"travel_m_{what}"] for what in ("ratio", "low", "high")] == [0.5, 0.5, 0.5]
    assert (reported["reached"], reported["reached_against"]) == (1.0, 1.0)


def test_paces_are_compared_as_planners_are() -> None:
    job = TableJob("two-60-150", 0, pace="quick")
    assert (job.way, replace(job, pace="careful").way) == ("regions quick", "regions")


def test_a_ratio_has_the_spread_of_its_layouts() -> None:
    slow = [run(seed, 0.1, "max-variance") for seed in range(6)]
    fast = [run(seed, 0.1 if seed % 2 else 0.5) for seed in range(6)]
    reported = compare(fast, slow, 0.75)
    assert 0.25 <= reported["touches_low"] < reported["touches_ratio"] < reported["touches_high"] <= 1.0


def test_a_summary_is_of_all_layouts_and_leaves_out_what_is_not_known() -> None:
    one, other = run(0, 0.1), run(1, 0.2)
    wrong = replace(SCORE, right=False, levels_covered=None, boundary_m=None, iou=0.4, least_iou=0.0)
    third = replace(run(2, 0.1), after=(replace(after(1, 0.4), score=wrong, touch_covered=False),), stop_after=1)
    reported = summarise([one, other, third], 8)
    assert reported["iou"] == pytest.approx(0.8)
    assert reported["good"] == pytest.approx(1 / 3, abs=1e-3)
    assert reported["right"] == reported["found"] == pytest.approx(2 / 3, abs=1e-3)
    assert (reported["levels_covered"], reported["levels_runs"]) == (1.0, 2)
    assert reported["touches_covered"] == pytest.approx(16 / 17, abs=1e-3)
    assert reported["rigid_found"] is None
    assert reported["made"] == 8


def test_a_disc_that_no_touch_met_is_as_large_as_the_touches_leave_room() -> None:
    """All touches at (0.1, 0.1) on 0.6 x 0.4 m: a disc of 0.2 m fits beside them, and touches three edges."""
    assert summarise([run(0, 0.1)], 8)["unmet_m"] == pytest.approx(0.2, abs=0.005)


def test_a_scene_without_regions_has_no_iou() -> None:
    score = replace(SCORE, iou=None, least_iou=None, boundary_m=None, verdict="gradual")
    reported = summarise([replace(run(0, 0.1), region_count=0, after=(replace(after(1, 0.0), score=score),))], 8)
    assert (reported["iou"], reported["good"], reported["found"], reported["boundary_m"]) == (None, None, None, None)
    assert reported["gradual"] == 1.0


def test_curves_are_drawn(tmp_path: Path) -> None:
    curves([run(0, 0.1), run(0, 0.2, "max-variance")], tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000
