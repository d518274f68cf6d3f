"""A recorded UR's bytes give its frames again: through a stop and a protective stop."""

import dataclasses
import importlib.metadata
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from deformscope_ur import Ur, UrConfig, UrDouble

from deformscope.cli import main
from deformscope.cli.common import EXIT_LOSSES
from deformscope.frames import ArmFrame, Item, RawBytes, Stream, host_ns
from deformscope.rig.decoded import DeviceComparison, compare_with_bytes
from deformscope.rig.rig_file import parse_rig
from deformscope.rig.source import RigMember, RigSource
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.interface import DRIVERS, GROUP
from deformscope_drivers.memory import SimulatedClock
from tests.cases import Capture, Patch
from tests.drivers.packages.ur_memory import MemoryPorts

RIG = '[devices.arm]\ndriver = "ur"\nown_process = false\n'
DELTAS = {"delta_theta": (0.01, 0.0, 0.0, 0.0, 0.0, 0.0)}
Recorded = tuple[list[Item], tuple[Stream, ...]]
CALIBRATED = f"{RIG}delta_theta = {list(DELTAS['delta_theta'])}\n"


@pytest.fixture(scope="module", autouse=True)
def installed() -> object:
    with pytest.MonkeyPatch.context() as patch:
        entry = importlib.metadata.EntryPoint("ur", "deformscope_ur:DRIVER", GROUP)
        patch.setattr(DRIVERS, "_entries", {**DRIVERS._found(), "ur": entry})
        yield


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """Some seconds of a calibrated arm that moves, is stopped, and is unlocked after a protective stop."""
    clock = SimulatedClock(10**9)
    double = UrDouble(UrConfig(**DELTAS))
    arm = Ur(UrConfig(own_process=False, **DELTAS), MemoryPorts(double, clock), clock=clock)
    members = [RigMember("arm", DRIVERS["ur"], arm)]
    items: list[Item] = []
    with RigSource(members, clock=clock, opener=lambda: arm.open(own_thread=False)) as made:

        def advance(seconds: float) -> None:
            until_ns = clock() + round(seconds * 1e9)
            while clock() < until_ns:
                arm.poll(0.005)
                items.extend(made.take(0.0))

        advance(0.5)
        arm.set_velocity(JointVelocity((6.0, 0.0, 0.0, -4.0, 0.0, 0.0)), 30.0)
        advance(0.5)
        arm.stop()
        advance(0.2)
        double.protective_stop()
        advance(6.0)
        arm.acknowledge_stop()
        advance(0.2)
        advance(0.5)
        streams = made.streams
        made.close()
        items += [*made.rest(), made.look()]
    assert double.rates_deg_s.max() == 0.0
    return sorted(items, key=host_ns), streams


def compared(recorded: Recorded, items: list[Item], rig: str = CALIBRATED) -> DeviceComparison:
    (found,) = compare_with_bytes(parse_rig(rig, "rig"), recorded[1], items)
    return found


def test_the_bytes_give_the_frames_to_the_last_bit(recorded: Recorded) -> None:
    found = compared(recorded, recorded[0])
    count = sum(isinstance(item, ArmFrame) for item in recorded[0])
    assert (found.frames, found.compared, found.difference, found.left_out) == (count, count, "", "")
    assert count > 900


def altered(name: str) -> Callable[[Item], Item]:
    def change(item: Item) -> Item:
        value = getattr(item, name)
        return dataclasses.replace(item, **{name: np.nextafter(value, np.inf)})

    return change


def flipped(item: Item) -> Item:
    """One bit of a joint's angle: behind header, recipe and time."""
    assert isinstance(item, RawBytes)
    data = bytearray(item.data)
    data[3 + 1 + 8 + 7] ^= 1
    return dataclasses.replace(item, data=bytes(data))


FIELDS = ("joint_deg", "joint_velocity_deg_s", "position_m", "rotation_rad", "force_n", "torque_nm")


@pytest.mark.parametrize(("kind", "change"), [(RawBytes, flipped), *((ArmFrame, altered(name)) for name in FIELDS)])
def test_one_altered_bit_is_found(kind: type, change: Callable[[Item], Item], recorded: Recorded) -> None:
    items = recorded[0]
    places = [at for at, item in enumerate(items) if isinstance(item, kind) and not getattr(item, "sent", False)]
    at = places[int(0.05 * len(places))]
    assert compared(recorded, [*items[:at], change(items[at]), *items[at + 1 :]]).difference


def test_another_calibration_is_found(recorded: Recorded) -> None:
    assert "another position_m of frame" in compared(recorded, recorded[0], RIG).difference


def test_lost_bytes_are_found(recorded: Recorded) -> None:
    items = recorded[0]
    places = [at for at, item in enumerate(items) if isinstance(item, RawBytes) and not item.sent]
    at = places[40]
    assert "which its bytes do not contain" in compared(recorded, [*items[:at], *items[at + 1 :]]).difference


@pytest.mark.parametrize("own_process", ["false", "true"])
def test_a_recorded_double_is_replayed(own_process: str, tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    rig, run = tmp_path / "rig.toml", tmp_path / "r.rrd"
    rig.write_text(f'[devices.arm]\ndriver = "ur"\ndouble = true\nown_process = {own_process}\n')
    about = tmp_path / "deformscope_ur-1.0.dist-info"  # for the double, which has a process of its own
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: deformscope-ur\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{GROUP}]\nur = deformscope_ur:DRIVER\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    status = main(["record", str(rig), "--seconds", "1", "--record", str(run), "--viewer", "none"])
    assert status in (0, EXIT_LOSSES), capsys.readouterr().err  # a busy machine loses reports
    capsys.readouterr()
    assert main(["replay", str(run), "--json", "-"]) == 0
    (arm,) = json.loads(capsys.readouterr().out)["devices"]
    assert arm["compared"] == arm["frames"] > 20
    assert not arm["left_out"]
