"""What `explore` prints: every number with what it is, and no verdict that its own probability contradicts."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from deformscope.api.exploration import beta_words, exploration_rows, force_words, verdict_of
from deformscope.api.exploration_run import _said
from deformscope.pictures.words import ENDED, claim_words, ended_words, verdict_words
from deformscope.session import Step
from deformscope.stages.map.exploration import PlannedTouch
from deformscope.stages.map.plan import StopReason
from tests.log.synthetic_exploration import maps as maps_after
from tests.log.synthetic_exploration import touch


def found_with(**changed: Any) -> dict[str, Any]:
    """The JSON of an exploration of three touches of a foam beside something rigid."""
    region = {"modulus_pa": 5e4, "modulus_interval_pa": (4e4, 6e4), "loss": None, "loss_interval": None}
    return {
        "verdict": "regions",
        "verdict_probability": 0.6,
        "regions_by": "stiffness",
        "region_count": 2,
        "probability": {"1": 0.05, "2": 0.6, "3": 0.31, "gradual": 0.04},
        "stiffness": "apparent",
        "regions": [
            {"log_stiffness": np.log(0.5), "interval": np.log([0.45, 0.55]), "rigid": False, **region},
            {"log_stiffness": np.log(8.57), "interval": np.log([8.57, np.inf]), "rigid": True, **region},
        ],
        "set_force_n": 3.0,
        "more_force_n": 5.0,
        "max_force_n": 5.372,
        "measured_max_force_n": 4.99,
        "levelled_m": None,
        "thickness": {"known_by": "stated"},
        "truth": {"region_count": 3, "iou": 0.513, "boundary_m": 0.046},
        "touches": [{"beta": 0.95, "beta_verdict": "at-bound", "peak_force_n": 4.86}],
        "inclusions": None,
        "missed": None,
        "failures": [],
        "travel_m": 0.65,
        "stop_reason": "budget",
        "arm_stands": True,
        "supervisor_gaps_ms": {"p50": 10.0, "p99_9": 10.4, "max": 31.0},
        "seconds": {"session": 42.0, "wall": 26.0},
        "losses": {},
        "recording": None,
    } | changed


def test_every_number_has_its_meaning() -> None:
    rows = dict(exploration_rows(found_with()))
    assert rows["verdict"] == "2 regions (probability 0.60, 3 regions 0.31)"
    assert rows["region 1"] == "0.5 N/mm (0.45 to 0.55) at 3 N; modulus 50 kPa (40 to 60)"
    assert rows["region 2"] == "> 8.57 N/mm (a lower bound: hardly dented)"
    assert rows["truth"] == "3 regions; IoU of the map's with them 0.513, border 4.6 cm off"
    assert rows["ended"] == "all touches that were allowed are made"
    assert rows["contact force"] == (
        "set to 3 N (5 N where that dents less than 2 mm); "
        "largest: measured 4.99 N, true 5.37 N (known in the simulation alone)"
    )
    assert rows["safety checks"] == "every 10 ms; 99.9 % within 10 ms, all within 31 ms"
    assert rows["time"] == "42 s by the robot's clock, 26 s on this computer"


def test_forces_of_a_real_arm_are_the_sensors() -> None:
    words = force_words(found_with(max_force_n=None, more_force_n=None, measured_max_force_n=3.08))
    assert words == "set to 3 N; largest: measured 3.08 N"


@pytest.mark.parametrize(
    ("share", "words"),
    [
        ({"1": 0.01, "2": 0.98, "3": 0.01, "gradual": 0.0}, "2 regions (probability 0.98)"),
        ({"1": 0.0, "2": 0.42, "3": 0.1, "gradual": 0.48}, "2 regions (probability 0.42, gradual 0.48)"),
    ],
)
def test_a_rival_is_named_where_there_is_one(share: dict[str, float], words: str) -> None:
    assert verdict_of(found_with(probability=share, verdict_probability=share["2"])) == words


def test_the_thesiss_rule_has_no_probability_of_its_own() -> None:
    """Two foams, one region between isopleths: by stiffness that number has 4e-7."""
    maps = dataclasses.replace(maps_after(2), isopleths=np.zeros(0), region_count=1, probability=4e-7)
    assert maps.claimed is None
    assert maps.mapped == "beta"
    assert verdict_words(maps) == "1 region between isopleths of beta"
    assert claim_words(maps.claimed) == "the thesis's rule gives no probability"
    share = {"1": 4e-7, "2": 0.93, "3": 0.05, "gradual": 0.02}
    found = found_with(regions_by="beta", verdict_probability=maps.claimed, region_count=1, probability=share)
    rule = "1 region between isopleths of beta (the thesis's rule gives no probability"
    assert verdict_of(found) == f"{rule}; by stiffness 2 regions, probability 0.93)"
    assert maps_after(2).claimed == maps_after(2).probability


@pytest.mark.parametrize(
    ("betas", "verdict", "words"),
    [
        ((0.0, 0.0), "thesis: swept", "0.00 in 2 touches, the end of its range: beta does not distinguish"),
        ((0.95, 0.95), "at-bound", "0.95 in 2 touches, the end of its range: beta does not distinguish"),
        ((0.93, 0.95), "at-bound", "0.93 to 0.95 in 2 touches; in 2 its interval reaches the end of its range: linear"),
        ((0.3, 0.7), "identified", "0.30 to 0.70 in 2 touches"),
    ],
)
def test_what_beta_says_follows_its_values(betas: tuple[float, ...], verdict: str, words: str) -> None:
    said = beta_words([{"beta": beta, "beta_verdict": verdict} for beta in betas])
    assert said.startswith(words)
    assert ("stiffness decides" in said) == (betas == (0.93, 0.95))


def test_every_reason_of_a_plan_has_words() -> None:
    assert set(ENDED) == set(StopReason.__args__)  # type: ignore[attr-defined]
    assert ended_words("stopped: link lost") == "stopped: link lost"
    assert ended_words("")


def test_touches_are_counted_and_the_time_left_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    plan = PlannedTouch(np.array([0.15, 0.2]), None, None, np.zeros((2, 2), bool), "because")
    end = dataclasses.replace(plan, target_m=None, reason="stopped: budget", stop_reason="budget")
    steps = [Step((plan,)), Step((touch(0),)), Step((plan,)), Step((end,))]
    for _ in _said((step for step in steps), lambda line: None, 12):  # type: ignore[arg-type]
        pass
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "touch 1 of at most 12, at (15, 20) cm: because"
    assert said[2].startswith("touch 2 of at most 12, at (15, 20) cm: because; some ")
    assert said[2].endswith(" s to go for all 12")
    assert said[-1] == "no further touch: all touches that were allowed are made"
