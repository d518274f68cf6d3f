"""`replay` of a `calibrate wrench`: its worth comes again of the arm's recorded states; what was edited is found."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.frames import ArmFrame, InputFile, Item, Stream, host_ns
from deformscope.log.layout import RIG as RIG_APPLICATION
from deformscope.log.layout import RigLayout
from deformscope.recording.recorder import Recorder
from deformscope.rig.rig_file import Tool
from deformscope.rig.source import RigMember, RigSource
from deformscope.runs.arm_calibration import learned_wrench
from deformscope.session import Step
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.memory import SimulatedClock
from tests.cases import Capture

RIG = """
[devices.arm]
driver = "jaco"
double = true
[devices.own]
driver = "arm"
filter_hz = 4.0
"""
SECONDS = 24
Recorded = tuple[list[Item], tuple[Stream, ...], int, "tuple[InputFile | Step, ...]"]


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """A calibrated Jaco in free air, before which and after which it was pushed."""
    clock = SimulatedClock(10**9)
    double = JacoDouble("j2n6s300", clock)
    double.blur_torques(0.05, 0.5)
    arm = Jaco(JacoConfig(), double, clock=clock)
    items: list[Item] = []
    with RigSource(
        [RigMember("arm", DRIVERS["jaco"], arm)], clock=clock, opener=lambda: arm.open(own_thread=False)
    ) as source:
        start_ns = source.start_ns

        def motion(seconds: int) -> None:
            for step in range(50 * seconds):
                if step % 25 == 0:
                    rates = 6.0 * np.sin(0.05 * step * np.arange(1.0, 7.0))
                    arm.set_velocity(JointVelocity(tuple(rates.tolist())), 1.0)
                clock.advance_to(clock() + 20_000_000)
                arm.poll(0.0)
                items.extend(source.take(0.0))

        double.push([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
        motion(1)
        double.push([0.0] * 6)
        states = arm.readings(10_000)
        motion(SECONDS)
        made = learned_wrench(states.take(), arm.chain, 4.0, Tool(), "own")
        double.push([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
        motion(1)
        streams = source.streams
        source.close()
        items += source.rest()
    return sorted(items, key=host_ns), streams, start_ns, tuple(made.kept)


def replayed(
    recorded: Recorded, folder: Path, items: list[Item], kept: "tuple[InputFile | Step, ...]", rig: str = RIG
) -> int:
    _, streams, start_ns, _ = recorded
    settings = {"rig": rig, "rig_name": "rig"}
    with Recorder(folder / "r.rrd", "none", settings, application=RIG_APPLICATION) as made:
        made.start(RigLayout(streams), start_ns)
        made.write(items)
        for one in kept:
            made.write(one)
    return main(["replay", str(folder / "r.rrd")])


@pytest.mark.parametrize("rig", [RIG, ""], ids=["rig", "laboratory"])
def test_the_worth_comes_again_of_the_recorded_states(
    rig: str, recorded: Recorded, tmp_path: Path, capsys: Capture
) -> None:
    items, _, _, kept = recorded
    frames = [one for one in items if isinstance(one, ArmFrame)]
    assert isinstance(kept[0], InputFile)
    count, first_ns, last_ns, filter_hz = json.loads(kept[0].content)
    assert 0.9 * 50 * SECONDS < count < len(frames) - 80, "the pushes are outside"
    assert frames[0].stamp.host_ns < first_ns < last_ns < frames[-1].stamp.host_ns
    assert filter_hz == 4.0
    assert replayed(recorded, tmp_path, items, kept, rig) == 0
    said = "the worth of the arm's own force computed again from its states, identical to the recorded one"
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", ["joint_torque_nm", "joint_deg"])
def test_an_edited_state_is_found(name: str, recorded: Recorded, tmp_path: Path, capsys: Capture) -> None:
    items = list(recorded[0])
    at = len(items) // 2
    items[at] = dataclasses.replace(items[at], **{name: getattr(items[at], name) + 1e-6})  # type: ignore[arg-type]
    assert replayed(recorded, tmp_path, items, recorded[3]) == 2
    assert "of WrenchWorth" in capsys.readouterr().err.splitlines()[-1]


def test_an_edited_worth_or_a_missing_state_is_found(recorded: Recorded, tmp_path: Path, capsys: Capture) -> None:
    items, _, _, (states, step) = recorded
    assert isinstance(step, Step)
    (worth,) = step.results
    less = dataclasses.replace(worth, off_n=0.9 * worth.off_n)  # type: ignore[type-var,attr-defined]
    assert replayed(recorded, tmp_path, items, (states, Step((less,)))) == 2
    assert "another off_n of WrenchWorth" in capsys.readouterr().err
    at = len(items) // 2
    (tmp_path / "less").mkdir()
    assert replayed(recorded, tmp_path / "less", [*items[:at], *items[at + 1 :]], (states, step)) == 2
    assert "expected the" in (said := capsys.readouterr().err)
    assert "states of the arm in its motion" in said
