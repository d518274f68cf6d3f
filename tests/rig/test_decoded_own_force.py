"""An arm's own force comes again of the arm's recorded states; one value that was altered in either is found."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.frames import ArmFrame, HealthReport, Item, Stream, WrenchFrame, host_ns
from deformscope.log.layout import RIG as RIG_APPLICATION
from deformscope.log.layout import RigLayout
from deformscope.recording.recorder import Recorder
from deformscope.rig.decoded import DeviceComparison, compare_with_bytes
from deformscope.rig.rig_file import parse_rig
from deformscope.rig.source import RigMember, RigSource
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.arm.wrench import ArmWrench
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.jaco import Jaco, JacoDouble
from deformscope_drivers.memory import SimulatedClock

MODEL = "j2s7s300"
BIAS_N = [[0.1 * number, -0.2, 0.3] for number in range(36)]
RIG = f"""
[devices.arm]
driver = "jaco"
state_hz = 100
[devices.own]
driver = "arm"
filter_hz = 5.0
middle_deg = [{", ".join(["180.0"] * 7)}]
half_deg = [{", ".join(["90.0"] * 7)}]
bias_n = {BIAS_N}
friction_n = {[[0.5, 0.0, -0.5]] * 7}
"""
Recorded = tuple[list[Item], tuple[Stream, ...], int]


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """Four seconds of an arm that moves, whose own force is zeroed twice; its model is in no rig file."""
    clock = SimulatedClock(10**9)
    double = JacoDouble(MODEL, clock)
    double.blur_torques(0.05, 0.0)
    configs = {entry.name: entry.config for entry in parse_rig(RIG, "rig").devices}
    arm, own = Jaco(configs["arm"], double, clock=clock), ArmWrench(configs["own"])
    members = [RigMember("arm", DRIVERS["jaco"], arm, late_ns=3_000_000), RigMember("own", DRIVERS["arm"], own)]
    items: list[Item] = []

    def opener() -> None:
        for device in (arm, own):
            device.open(own_thread=False)

    with RigSource(members, clock=clock, opener=opener) as source:
        start_ns = source.start_ns
        for step in range(400):
            if step == 200:
                arm.set_velocity(JointVelocity((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0)), 1.0)
            if step in (100, 110):
                own.zero()
            clock.advance_to(clock() + 10_000_000)
            arm.poll(0.0)
            own.poll(0.0)
            items += source.take(0.0)
        streams = source.streams
        source.close()
        items += [*source.rest(), source.look()]
    return sorted(items, key=host_ns), streams, start_ns


def compared(recorded: Recorded, items: list[Item], device: str = "own") -> DeviceComparison:
    found = compare_with_bytes(parse_rig(RIG, "rig"), recorded[1], items)
    return next(one for one in found if one.device == device)


def at(items: list[Item], kind: type[ArmFrame] | type[WrenchFrame], share: float) -> int:
    places = [place for place, item in enumerate(items) if isinstance(item, kind)]
    return places[int(share * len(places))]


def next_up(name: str) -> Callable[[Item], Item]:
    def change(item: Item) -> Item:
        value = getattr(item, name)
        if isinstance(value, bool):
            return dataclasses.replace(item, **{name: not value})
        other = value + (1 if value.dtype.kind == "i" else 1e-9 if isinstance(item, ArmFrame) else np.spacing(value))
        return dataclasses.replace(item, **{name: other})

    return change


def test_the_states_give_the_forces_to_the_last_bit(recorded: Recorded) -> None:
    count = sum(isinstance(item, WrenchFrame) for item in recorded[0])
    found = compared(recorded, recorded[0])
    assert (found.frames, found.compared, found.difference, found.left_out) == (count, count, "", "")
    assert count > 390
    forces_n = np.array([item.force_n[0] for item in recorded[0] if isinstance(item, WrenchFrame)])
    assert np.linalg.norm(forces_n[90]) > 5.0 * np.linalg.norm(forces_n[130:190].mean(axis=0)), "it was zeroed"


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *((WrenchFrame, name) for name in ("force_n", "counts", "usable", "overload")),
        *((ArmFrame, name) for name in ("joint_torque_nm", "joint_deg", "rotation_rad")),
    ],
)
@pytest.mark.parametrize("share", [0.1, 0.7])
def test_one_altered_value_is_found(share: float, kind: type, name: str, recorded: Recorded) -> None:
    items = recorded[0]
    place = at(items, kind, share)
    found = compared(recorded, [*items[:place], next_up(name)(items[place]), *items[place + 1 :]])
    assert found.difference, "before the low pass too"
    assert "of own" in found.difference


def test_a_force_or_a_state_that_is_missing_is_found(recorded: Recorded) -> None:
    items = recorded[0]
    for kind in (WrenchFrame, ArmFrame):
        place = at(items, kind, 0.5)
        without = [*items[:place], *items[place + 1 :]]
        assert "before which a frame or a state of the arm is missing" in compared(recorded, without).difference
        report = next(item for item in reversed(items) if isinstance(item, HealthReport))
        lost = tuple((name, dataclasses.replace(one, dropped=name == "arm")) for name, one in report.devices)
        found = compared(recorded, [*without, dataclasses.replace(report, devices=lost)])
        assert not found.difference
        assert "1 readings or pieces of bytes were dropped" in found.left_out


def test_replay_finds_a_changed_force_in_a_recording(
    recorded: Recorded, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    items, streams, start_ns = recorded
    place = at(items, WrenchFrame, 0.6)
    for name, given in (("r", items), ("x", [*items[:place], next_up("force_n")(items[place]), *items[place + 1 :]])):
        settings = {"rig": RIG, "rig_name": "rig"}
        with Recorder(tmp_path / f"{name}.rrd", "none", settings, application=RIG_APPLICATION) as made:
            made.start(RigLayout(streams), start_ns)
            made.write(given)
    assert main(["replay", str(tmp_path / "r.rrd"), "--json", "-"]) == 0
    found = {one["device"]: one for one in json.loads(capfd.readouterr().out)["devices"]}
    assert found["own"]["compared"] == found["own"]["frames"] > 390
    assert main(["replay", str(tmp_path / "x.rrd")]) == 2
    assert "got another force_n of frame" in capfd.readouterr().err.splitlines()[-1]
