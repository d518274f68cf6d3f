"""Arms that are driven to where they must not go stand in time; layouts keep their margins: a few, the others are
`python -m studies safety`."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from deformscope.lab.faults import Injected
from deformscope_drivers.jaco import JacoDouble
from deformscope_drivers.jaco.structures import AngularInfo, PositionType, TrajectoryPoint
from deformscope_drivers.kuka.config import CHAINS
from deformscope_drivers.memory import SimulatedClock
from studies import layouts
from studies.__main__ import main
from studies.driven_faults import KINDS, Driven, run_any, run_driven, run_killed
from studies.fault_study import ACCELERATION_DEG_S2, FaultRun
from studies.layouts import run_layout, walk_to_singularity_deg
from studies.silent_kuka import SILENCES, Silence, SilentRun, run_silent


@pytest.mark.parametrize("driven", [*list(Driven)[:3], pytest.param(Driven.SINGULAR, marks=pytest.mark.slow)])
def test_an_arm_driven_where_it_must_not_go_stands_before_it_is_there(driven: Driven) -> None:
    run = run_driven(20_002, driven)
    assert run.in_time, run
    assert run.standstill.seconds < 0.2


@pytest.mark.slow  # three processes on the host's clock
def test_a_killed_program_no_longer_moves_its_arm() -> None:
    run = run_killed(20_000)
    assert run.in_time, run


def test_every_kind_has_its_turn() -> None:
    assert len(set(KINDS)) == len(KINDS) >= 22


def test_joints_speed_up_and_slow_down_no_faster_than_the_arms_firmware_lets_them() -> None:
    clock = SimulatedClock()
    double = JacoDouble("j2n6s300", clock)
    double.accelerate(ACCELERATION_DEG_S2)
    for name in ("InitAPI", "StartControlAPI"):
        double.function(name)()
    point = TrajectoryPoint()
    point.Position.Type = PositionType.ANGULAR_VELOCITY
    point.Position.Actuators = AngularInfo(0.0, 0.0, 0.0, 20.0)
    rates = []
    for number in range(40):
        if number < 20:
            double.function("SendBasicTrajectory")(point)
        clock.advance_to(clock() + 10_000_000)
        rates.append(float(double.rates_deg_s[3]))
    assert max(rates) == pytest.approx(20.0)
    np.testing.assert_allclose(np.abs(np.diff(rates)).max(), 2.0, atol=1e-9)
    assert rates[20:30] == pytest.approx(np.arange(18.0, -1.0, -2.0))  # v^2 / 2 a = 1 deg after the last point


def test_a_walk_finds_the_singular_wrist_of_a_kuka() -> None:
    chain = CHAINS["kr6r900sixx"]
    joints_deg = np.array([0.0, -90.0, 100.0, 20.0, 8.0, 0.0])
    towards = np.array([0.0, 0.0, 0.0, 0.0, -1.0, 0.0])
    assert walk_to_singularity_deg(chain, joints_deg, towards) == pytest.approx(8.0, abs=1.0)
    assert walk_to_singularity_deg(chain, joints_deg, -towards) == float("inf")


@pytest.mark.slow  # three of each kind; a thousand are `python -m studies safety`
def test_faults_of_all_kinds_end_in_time() -> None:
    runs = [run_any(seed) for seed in range(3 * len(KINDS))]
    assert [run for run in runs if not run.in_time] == []
    assert max(run.max_force_n for run in runs if isinstance(run, FaultRun)) < 8.0


@pytest.mark.parametrize("seed", range(20_000, 20_010))
@pytest.mark.slow  # two processes on the host's clock; 500 are `deformscope coverage safety --arm kuka`
def test_a_kuka_whose_answers_end_stands_or_was_refused(seed: int) -> None:
    run = run_silent(seed)
    holdon, silence = SILENCES[seed % len(SILENCES)]
    assert (run.holdon, run.silence) == (holdon, silence)
    assert run.refused == bool(holdon)
    assert not run.moved_later
    if holdon or silence not in (Silence.CLOSE, Silence.HALT):  # those wait for this machine besides
        assert run.in_time, run


def test_a_kuka_that_goes_on_is_not_in_time() -> None:
    refused = SilentRun(0, 1, Silence.CABLE, 0.012, refused=True, moved_m=5e-4, moved_later=False)
    assert refused.in_time
    for wrong in ({"refused": False}, {"holdon": 0}, {"moved_m": 2.1e-3}, {"moved_later": True}):
        assert not dataclasses.replace(refused, **wrong).in_time
    assert dataclasses.replace(refused, holdon=0, refused=False).in_time


def test_the_command_counts_a_kuka_whose_answers_end(tmp_path: Path) -> None:
    found = tmp_path / "safety.json"
    flags = ["--arm", "kuka", "--faults", "1", "--layouts", "0", "--rigid", "0", "--jobs", "1", "--seed", "5"]
    assert main(["safety", *flags, "--json", str(found), "--viewer", "none"]) == 0
    told = json.loads(found.read_text())
    assert told["in_time"] == told["faults"] == 1
    (run,) = told["kinds"]["HOLDON 1: cable pulled"]
    assert run["refused"]


@pytest.mark.slow
def test_layouts_keep_five_degrees_or_are_refused() -> None:
    runs = [run_layout(seed) for seed in range(20_000, 20_010)]
    assert min(run.margin_deg for run in runs) >= 5.0
    assert any(run.refused for run in runs)
    assert any(run.endings for run in runs)


@pytest.mark.parametrize("drawn", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_command_counts_faults_and_layouts(drawn: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layouts, "TOUCHES", 1)
    found = tmp_path / "safety.json"
    flags = ["--faults", "1", "--layouts", str(drawn), "--rigid", "1", "--jobs", "1", "--seed", "12"]
    assert main(["safety", *flags, "--json", str(found), "--viewer", "none"]) == 0
    told = json.loads(found.read_text())
    assert told["in_time"] == told["faults"] == 1
    assert told["kinds"][Injected.ARM_LATE][0]["noticed"]
    assert len(told["layouts"]) == drawn
    (touch,) = told["rigid"]
    assert touch["refused"].startswith("force sensor: finger")
    assert touch["max_force_n"] == 0.0
