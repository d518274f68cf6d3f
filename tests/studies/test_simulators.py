"""Slabs of finite elements in MuJoCo."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deformscope.config.simulate import Target
from deformscope.errors import InputError
from deformscope.lab.slab import RigidTip, Slab, press
from deformscope.recording.items import read_results
from deformscope.stages.map.exploration import MapEstimate, TouchEstimate
from studies.simulators import (
    CASES,
    EDGE,
    EXAMPLE,
    PRESSED,
    TWO,
    RegionsCase,
    SimulatorsConfig,
    SlabCase,
    SlabOutcome,
    ends,
    record_regions,
    report,
    surprises,
    touch_of,
    trials,
    try_slab,
)
from tests.cases import Patch
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


def test_two_materials_beside_one() -> None:
    options = SimulatorsConfig(two_materials=True, vertices=(900,), target="newton")
    (bodies,) = trials(options)
    assert [(one.regions, one.vertices, one.target) for one in bodies.cases if isinstance(one, RegionsCase)] == [
        (1, 900, "newton"),
        (2, 900, "newton"),
    ]
    poke = {"force_error": 0.5, "force_error_before": 0.5, "dent_error": 0.5, "dent_error_beyond_edge": 0.5}
    unseen = {"force_error": 0.03, "force_error_before": -0.1, "dent_error": 0.06, "dent_error_beyond_edge": 0.05}
    found = {
        "version": "1.8.0",
        "vertices": 880,
        "needed": {"poisson": 0.31},
        "materials": [{"measured_young_pa": 2e4, "young_pa": 1.9e4}, {"measured_young_pa": 6e4, "young_pa": 5.8e4}],
        "determined": {"young": False, "ratio 1": True},
        "seconds": 60.0,
        "converged": True,
        "pokes": [poke | {"held_out": False}, unseen | {"held_out": True}],
    }
    (table,) = report(options, 1.0, [SlabOutcome(bodies.cases[1], found, float("nan"))]).tables
    assert len(table.names) == len(table.rows[0])
    assert table.rows[0][:6] == ("2", "880", "20, 60", "19, 58", "0.31", "ratio 1")
    assert table.rows[0][6:] == ("10.0%", "50.0%", "3.0%", "6%", "5%", "60", "yes")


def test_a_touch_of_two_materials_is_that_of_a_slab_whose_modulus_changes() -> None:
    """Elements of 7.5 mm in both: the modulus differs in those that the line crosses in the other."""
    (template,) = [row.item for row in read_results(EXAMPLE, (TouchEstimate,))][-1:]
    assert isinstance(template, TouchEstimate)
    at, coarse = PRESSED[2], 0.0075
    touch = touch_of(template, 3, coarse)
    assert touch.xyz_m.tolist() == [*at, 0.03]
    slab = Slab((0.2, 0.2, 0.03), lambda places: np.where(places[:, 0] < EDGE, *TWO), 0.3)
    known = press(slab, at, RigidTip((0.015, 0.015)), np.zeros((0, 3)), depth=touch.depth_m, finest=coarse)
    assert touch.peak_force_n == pytest.approx(known.force, rel=0.02)
    soft = press(replace(slab, young=TWO[0]), at, RigidTip((0.015, 0.015)), np.zeros((0, 3)), depth=touch.depth_m)
    assert touch.peak_force_n > soft.force
    below = np.abs(touch.observed_m[:, :2] - at).max(axis=1) < 0.01
    np.testing.assert_allclose(touch.observed_m[below, 2], 0.03 - touch.depth_m, atol=1e-9)


def test_the_recorded_slab_has_its_regions_and_touches(tmp_path: Path, monkeypatch: Patch) -> None:
    coarse = functools.partial(touch_of, fine=0.0075)
    monkeypatch.setattr("studies.simulators.touch_of", coarse)
    monkeypatch.setattr("studies.simulators.PRESSED", PRESSED[:1])
    record_regions(tmp_path / "two.rrd", 2)
    maps, touch = (
        next(row.item for row in read_results(tmp_path / "two.rrd", (kind,))) for kind in (MapEstimate, TouchEstimate)
    )
    assert isinstance(maps, MapEstimate)
    assert isinstance(touch, TouchEstimate)
    assert maps.region_count == 2
    across = (np.arange(maps.labels.shape[1]) + 0.5) * maps.cell_m
    np.testing.assert_array_equal(maps.labels, np.broadcast_to(across > EDGE, maps.labels.shape))
    assert touch.xyz_m.tolist() == [*PRESSED[0], 0.03]


@pytest.mark.slow
@pytest.mark.skipif(not has("mujoco"), reason="needs mujoco, or DEFORMSCOPE_TARGETS_PYTHON with it")
def test_an_unseen_depth_is_within_5_percent_after_the_fit() -> None:
    found = try_slab(SlabCase(50e3, 0.3, 2400, 0.005, WITH_TARGETS)).found
    pokes = found["pokes"]
    assert isinstance(pokes, list)
    assert abs(pokes[1]["force_error"]) < 0.05
    assert pokes[1]["dent_error"] < 0.05  # .19 with a tip as wide as the measured one
    assert abs(pokes[1]["force_error_before"]) < 0.1  # .39


@pytest.mark.slow
def test_a_body_that_ends_near_the_tip_moves_the_dent_of_nearly_incompressible_foam() -> None:
    rows = ends((0.3, 0.45))
    near, far = ([float(row[3].rstrip("%")) for row in rows[one::2]] for one in (0, 1))
    assert near[0] < 2.5
    assert near[1] > 5.0
    assert far[1] < 0.5 * near[1]


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
