"""What `explore` prints: every number with what it is, and no verdict that its own probability contradicts."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from deformscope.pictures.messages import ENDED, format_stop, format_verdict
from deformscope.results.render import to_line
from deformscope.runs import exploration_result
from deformscope.runs.exploration_run import _remarks, _with_messages
from deformscope.session import Step
from deformscope.stages.map.exploration import PlannedTouch
from deformscope.stages.map.plan import StopReason
from tests.log.synthetic_exploration import maps as maps_after
from tests.log.synthetic_exploration import touch


def found_with(**changed: Any) -> exploration_result.ExplorationResult:
    """An exploration of three touches of a foam beside something rigid."""
    estimate = dataclasses.replace(
        maps_after(2),
        level_n_per_mm=np.array([0.5, 8.57]),
        level_interval_n_per_mm=np.array([[0.45, 0.55], [8.57, np.inf]]),
        level_rigid=np.array([False, True]),
        level_modulus_pa=np.array([5e4, 5e4]),
        level_modulus_interval_pa=np.array([[4e4, 6e4], [4e4, 6e4]]),
        probability=0.6,
    )
    felt = dataclasses.replace(touch(0), beta=0.95, beta_verdict="at-bound", peak_force_n=4.86)
    given = {
        "scenario": "lab:here",
        "seed": 0,
        "version": "",
        "estimate": estimate,
        "probability": {"1": 0.05, "2": 0.6, "3": 0.31, "gradual": 0.04},
        "feel": "apparent",
        "set_force_n": 3.0,
        "more_force_n": 5.0,
        "max_force_n": 5.372,
        "measured_max_force_n": 4.99,
        "thickness": exploration_result.LayerThickness(0.05, 0.0, "stated"),
        "truth": exploration_result.TruthScore(3, 0.513, 0.046),
        "touches": (exploration_result.TouchOutcome(felt, 1.0, None, [], False),),
        "inclusions": None,
        "missed": None,
        "failures": (),
        "travel_m": 0.65,
        "stop_reason": "budget",
        "arm_stands": True,
        "supervisor_gaps_ms": {"p50": 10.0, "p99_9": 10.4, "max": 31.0},
        "seconds": {"session": 42.0, "wall": 26.0},
        "losses": {},
        "recording": None,
        "fault": None,
        "laboratory": None,
    }
    return exploration_result.ExplorationResult(**(given | changed))


def test_every_number_has_its_meaning() -> None:
    rows = dict(found_with().rows())
    assert rows["verdict"] == "2 regions (probability 0.60, 3 regions 0.31; more touches decide)"
    assert rows["region 1"] == "0.5 N/mm (0.45 to 0.55) at 3 N; modulus about 50 kPa if linear"
    assert rows["modulus"] == "no interval: foam on its plateau may have up to 2.8 times as much"
    assert rows["region 2"] == "> 8.57 N/mm (a lower bound: hardly dented)"
    assert rows["truth"] == "3 regions; IoU of map and truth 0.513, border 4.6 cm off"
    assert rows["ended"] == "the allowed number of touches is reached"
    assert rows["contact force"] == (
        "set to 3 N (5 N if the dent is below 2 mm); "
        "largest: measured 4.99 N, true 5.37 N (available in simulation only)"
    )
    assert rows["safety checks"] == ("every 10 ms, at most 31 ms apart; a stop may be that late: close other programs")
    calm = found_with(supervisor_gaps_ms={"p50": 10.0, "p99_9": 10.0, "max": 12.0})
    assert dict(calm.rows())["safety checks"] == "every 10 ms, at most 12 ms apart"
    assert rows["time"] == "42 s by the robot's clock, 26 s on this computer"


def test_forces_of_a_real_arm_are_the_sensors() -> None:
    found = found_with(max_force_n=None, more_force_n=None, measured_max_force_n=3.08)
    assert found.force_text == "set to 3 N; largest: measured 3.08 N"


@pytest.mark.parametrize(
    ("share", "words"),
    [
        ({"1": 0.01, "2": 0.98, "3": 0.01, "gradual": 0.0}, "2 regions (probability 0.98)"),
        (
            {"1": 0.0, "2": 0.42, "3": 0.1, "gradual": 0.48},
            "2 regions (probability 0.42, gradual 0.48; more touches decide)",
        ),
    ],
)
def test_a_rival_is_named_where_there_is_one(share: dict[str, float], words: str) -> None:
    found = found_with(probability=share)
    maps = dataclasses.replace(found.estimate, probability=share["2"])
    assert dataclasses.replace(found, estimate=maps).verdict_text == words


@pytest.mark.parametrize(
    ("betas", "verdict", "words"),
    [
        ((0.0, 0.0), "thesis: swept", "0.00 in 2 touches, the end of its range: beta does not distinguish"),
        ((0.95, 0.95), "at-bound", "0.95 in 2 touches, the end of its range: beta does not distinguish"),
        ((0.93, 0.95), "at-bound", "0.93 to 0.95 in 2 touches, as expected of linear foam, whose"),
        ((0.3, 0.7), "identified", "0.30 to 0.70 in 2 touches"),
    ],
)
def test_what_beta_says_follows_its_values(betas: tuple[float, ...], verdict: str, words: str) -> None:
    said = exploration_result.format_betas(
        [dataclasses.replace(touch(0), beta=beta, beta_verdict=verdict) for beta in betas]
    )
    assert said.startswith(words)
    assert said.endswith("by stiffness (interval at the end of its range: 2 touches)") == (betas == (0.93, 0.95))


def test_every_reason_of_a_plan_has_words() -> None:
    assert set(ENDED) == set(StopReason.__args__)  # type: ignore[attr-defined]
    assert format_stop("stopped: link lost") == "stopped: link lost"
    assert format_stop("")


def test_touches_are_counted_and_the_time_left_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    plan = PlannedTouch(np.array([0.15, 0.2]), None, None, np.zeros((2, 2), bool), "because")
    end = dataclasses.replace(plan, target_m=None, reason="stopped: budget", stop_reason="budget")
    steps = [Step((plan,)), Step((touch(0),)), Step((plan,)), Step((end,))]
    for _ in _with_messages((step for step in steps), lambda line: None, 12):  # type: ignore[arg-type]
        pass
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "touch 1 of at most 12, at (15, 20) cm: because"
    assert said[2].startswith("touch 2 of at most 12, at (15, 20) cm: because; about ")
    assert said[2].endswith(" s left for all 12")
    assert said[-1] == "no further touch: the allowed number of touches is reached"


def test_touches_stand_in_a_table_of_what_was_measured_of_any() -> None:
    touches = tuple(exploration_result.TouchOutcome(touch(number), 1.0, None, [], False) for number in range(2))
    _, table = found_with(touches=touches).tables()
    assert table.names == ("touch", "stiffness", "dent", "modulus", "peak force rate")
    assert [row[0] for row in table.rows] == ["1", "2"]
    assert all("N/mm (" in str(row[1]) for row in table.rows)
    assert len(found_with(touches=()).tables()) == 1
    assert '<th scope="col">stiffness</th>' in found_with(touches=touches).findings().html()


def test_the_peak_force_rate_of_a_touch_is_shown_with_its_interval_everywhere() -> None:
    measured, without = touch(0), dataclasses.replace(touch(0), peak_rate_n_per_s=None, peak_rate_interval_n_per_s=None)
    found = found_with(touches=(exploration_result.TouchOutcome(measured, 1.0, None, [], False),))
    (one,) = found.to_dict()["touches"]
    assert (one["peak_rate_n_per_s"], one["peak_rate_interval_n_per_s"]) == (6.0, [5.5, 6.5])
    assert found.to_dict()["units"]["peak_rate_n_per_s"] == "N/s"
    assert "<td>6 N/s (5.5 to 6.5)</td>" in found.findings().html()
    assert "peak force rate 6 N/s (5.5 to 6.5)" in next(_remarks(measured, 1, 3, 1.0))
    assert "peak rate 6 N/s (5.5 to 6.5)" in to_line(measured, "caption")
    assert "rate" not in next(_remarks(without, 1, 3, 1.0)) + to_line(without, "caption")


@pytest.mark.parametrize(("count", "says"), [(1, "1 region"), (2, "2 regions"), (3, "at least 3 regions")])
def test_three_regions_may_be_more(count: int, says: str) -> None:
    assert format_verdict(dataclasses.replace(maps_after(3), region_count=count, verdict="regions")) == says


def test_more_regions_than_the_verdicts_are_no_rival_of_at_least() -> None:
    maps = dataclasses.replace(maps_after(3), region_count=3, verdict="regions", probability=0.75)
    shares = {"1": 0.01, "2": 0.2, "3": 0.35, "4": 0.3, "5": 0.1, "gradual": 0.04}
    assert found_with(estimate=maps, probability=shares).verdict_text == (
        "at least 3 regions (probability 0.75, 2 regions 0.20; more touches decide)"
    )
