"""Squeezes of the laboratory are found as they were simulated: events, poses, changes of depth."""

from pathlib import Path

import numpy as np
import pytest

from deformscope.executor.local import open_workers
from deformscope.executor.tasks import compute
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.track import PoseEstimate
from deformscope.stages.squeeze.trial import SqueezeFeatures
from studies.reproduce import squeeze_truth
from studies.reproduce.container_trials import SqueezeJob, squeeze_jobs
from studies.reproduce.squeeze_truth_figure import truth_png

MS = 1_000_000


def estimate(observed: list[bool]) -> PoseEstimate:
    """At the origin; directions along the axes, rotation with a lever of 0.1 m."""
    deviation = np.where(observed, 1e-4, 1.0)
    known = np.array(observed)
    return PoseEstimate(np.eye(4), np.eye(6), deviation, known, 0.1, 1000, 0.99, 1e-3, True, "")


def test_a_pose_is_wrong_by_what_it_is_off_in_the_directions_that_are_observed() -> None:
    true = np.eye(4)
    turn = np.radians(0.5)
    true[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    true[:3, 3] = [0.003, 0.004, 0.0]
    whole = squeeze_truth.pose_error(estimate([True] * 6), true)
    assert (1e3 * whole.shift_m, whole.turn_deg) == pytest.approx((5.0, 0.5))
    assert whole.off
    part = squeeze_truth.pose_error(estimate([False, False, True, True, True, True]), true)
    assert (1e3 * part.shift_m, part.turn_deg) == pytest.approx((0.0, 0.5))
    assert not part.off


def test_events_are_off_in_periods_of_their_device() -> None:
    found = SqueezeEvents(1000 * MS, (930 * MS, 1070 * MS), 0, (0, 0), np.zeros(2, np.int64), 0.035, 0.02, 40.0)
    errors = squeeze_truth.event_errors(found, (930 * MS, 1500 * MS), (0.035, 0.02), "_lost")
    assert errors["first_lost"] == pytest.approx(2.0)
    assert errors["first_held_lost"] == 1.0
    assert np.isnan(errors["steady_lost"])
    assert errors["steady_held_lost"] == 0.0


@pytest.fixture(scope="module")
def rice(tmp_path_factory: pytest.TempPathFactory) -> squeeze_truth.Numbers:
    return squeeze_truth.squeeze_errors(SqueezeJob("rice", "box-103", "lab-102", 4, tmp_path_factory.mktemp("d")))[1]


def test_a_squeeze_is_found_as_it_was(rice: squeeze_truth.Numbers) -> None:
    for name in ("first", "steady", "first_lost", "steady_lost"):
        assert abs(float(rice[name])) <= 2.0, name
    assert float(rice["shift_mm"]) < 1.0
    assert float(rice["turn_deg"]) < 1.0
    assert float(rice["depth_rms_mm"]) < float(rice["noise_mm"])
    assert abs(float(rice["depth_mean_mm"])) < 0.4
    assert rice["depth_off"] == 0
    assert max(float(rice["depth_worst"]), float(rice["depth_filled_worst"])) < 5.0
    assert float(rice["depth_known"]) > 3000
    assert (rice["refused"], rice["used_off"], rice["hidden_used_off"], rice["wrong_used_off"]) == (0, 0, 0, 0)
    assert rice["wrong_refused"] == rice["wrong_tracked"]


def test_values_off_by_more_than_five_deviations_are_counted_and_those_beside_the_container_too() -> None:
    true = np.zeros((61, 61))
    true[:, :10] = np.nan
    vision = np.zeros((61, 61))
    vision[:, :10] = vision[20:30, 20:30] = np.nan
    vision[0, 0], vision[1, 40], vision[2, 40] = 0.001, 0.011, 0.009
    features = SqueezeFeatures(*[np.zeros(1)] * 4, vision=vision, missing=0.2, noise_m=0.002)
    found = squeeze_truth.depth_errors(features, true)
    assert (found["depth_off"], found["depth_known"]) == (2, 61 * 51 + 1)
    assert found["depth_worst"] == np.inf
    vision[0, 0] = np.nan
    assert squeeze_truth.depth_errors(features, true)["depth_worst"] == pytest.approx(5.5)


def test_many_are_summed_up_and_drawn(rice: squeeze_truth.Numbers) -> None:
    late = {**rice, "first": 5.0, "shift_mm": 4.0}
    rows = dict(squeeze_truth.truth_rows([rice, late, {"trial": "x", "content": "rice", "stopped": "saturated"}]))
    assert rows["squeezes"] == "3, 1 of them stopped early"
    assert rows["first contact, all frames"].startswith("50.0% within 2 sample periods")
    assert rows["off by 5 times the stated noise"].startswith("0 of ")
    assert rows["pose"].startswith("50.0% within 2 mm and 1 deg")
    assert truth_png([rice, late]).startswith(b"\x89PNG")


@pytest.mark.slow
def test_of_a_hundred_squeezes_nearly_all_are_found_as_they_were() -> None:
    jobs = squeeze_jobs(Path("nowhere"), 80, 20, 0, 0, new=True)
    with open_workers("local", None, None) as workers:
        every = [one.value[1] for one in compute(workers, squeeze_truth.squeeze_errors, jobs) if one.value is not None]
    assert len(every) == len(jobs)
    assert not any("stopped" in one for one in every)
    for name in ("first", "steady", "first_lost", "steady_lost"):
        assert np.mean(np.abs(squeeze_truth.numbers_of(every, name)) <= 2.0) >= 0.95, name
    assert squeeze_truth.numbers_of(every, "shift_mm").max() <= 2.0
    assert squeeze_truth.numbers_of(every, "turn_deg").max() <= 1.0
    assert (squeeze_truth.numbers_of(every, "depth_rms_mm") <= squeeze_truth.numbers_of(every, "noise_mm")).all()
    assert squeeze_truth.numbers_of(every, "depth_off").sum() == 0
    for start in ("", "hidden_"):
        assert squeeze_truth.numbers_of(every, f"{start}used_off").sum() == 0
    assert (
        squeeze_truth.numbers_of(every, "wrong_refused").sum()
        >= 0.95 * squeeze_truth.numbers_of(every, "wrong_tracked").sum()
    )
