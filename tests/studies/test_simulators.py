"""Slabs of finite elements in MuJoCo."""

from pathlib import Path

import pytest

from deformscope.config.simulate import Target
from deformscope.errors import InputError
from studies.simulators import CASES, SimulatorsConfig, SlabCase, SlabOutcome, report, surprises, trials, try_slab
from tests.cli.test_simulate_command import WITH_TARGETS, has


def test_a_line_of_each_slab_and_setting() -> None:
    options = SimulatorsConfig(cases=2, vertices=(500, 1000))
    (slabs,) = trials(options)
    assert [(one.young, one.vertices) for one in slabs.cases] == [
        (young, vertices) for young, _ in CASES[:2] for vertices in (500, 1000)
    ]
    (slabs,) = trials(SimulatorsConfig(only=(12, 3)))
    assert [(one.young, one.poisson) for one in slabs.cases] == [CASES[11], CASES[2]]
    poke = {"force_error": 0.03, "force_error_before": 0.5, "dent_error": 0.2, "held_out": False}
    poke |= {"dent_error_beyond_edge": 0.1}
    found = {
        "version": "4.0.0",
        "vertices": 484,
        "needed": {"young_pa": 3e4, "poisson": 0.3},
        "seconds": 60.0,
        "timestep_s": 0.005,
        "converged": False,
    }
    found |= {"determined": {"young": True, "poisson": False, "contact": False}, "seconds_per_step": 0.03}
    found |= {"pokes": [poke, poke | {"held_out": True, "force_error": -0.01}, poke, poke]}
    (table,) = report(options, 1.0, [SlabOutcome(slabs.cases[0], found, 0.12)]).tables
    assert len(table.names) == len(table.rows[0])
    assert table.rows[0][-1] == "no"
    assert table.rows[0][4:13] == ("30", "0.30", "young", "+50%", "3.0%", "1.0%", "+12%", "20%", "10%")


@pytest.mark.slow
@pytest.mark.skipif(not has("mujoco"), reason="needs mujoco, or DEFORMSCOPE_TARGETS_PYTHON with it")
def test_an_unseen_depth_is_within_5_percent_after_the_fit() -> None:
    found = try_slab(SlabCase(50e3, 0.3, 500, 0.005, WITH_TARGETS)).found
    pokes = found["pokes"]
    assert isinstance(pokes, list)
    assert abs(pokes[1]["force_error"]) < 0.05
    assert pokes[1]["dent_error"] < 0.07  # .19 with a tip as wide as the measured one
    assert abs(pokes[1]["force_error_before"]) < 0.1  # .39


@pytest.mark.slow
@pytest.mark.parametrize(("target", "count"), [("mujoco", 7), ("newton", 8)])
def test_the_surprises_are_those_in_docs(target: Target, count: int) -> None:
    if not has(target):
        pytest.skip(f"needs {target}, or DEFORMSCOPE_TARGETS_PYTHON with it")
    docs = (Path(__file__).parents[2] / "docs" / "results" / "simulators.md").read_text(encoding="utf-8")
    rows = surprises(Path(WITH_TARGETS), target)
    assert len(rows) == count
    for what, guess, seen in rows:
        assert f"| {what} | {guess} |" in docs
        assert target == "mujoco" or f"| {seen} |" in docs


def test_without_the_target_its_surprises_are_one_line(tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho No module named mujoco >&2; exit 1\n")
    python.chmod(0o755)
    with pytest.raises(InputError, match="No module named mujoco"):
        surprises(python)
