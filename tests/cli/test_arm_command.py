"""Where the arm is, and moving it by keys or over a place: watched as in an exploration, on a simulated clock."""

import contextlib
import dataclasses
import json
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.cli.common import EXIT_LOSSES
from deformscope.config import JogConfig
from deformscope.recording.recorder import Recorder
from deformscope.runs import arm_commands
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.jaco.chains import J2N6S300
from deformscope_drivers.jaco.config import JacoConfig
from deformscope_drivers.optoforce.device import Optoforce
from tests.cases import DEPTH, OPTOFORCE, SURFACE, Capture, Patch, slow
from tests.cli.rig_on_a_simulated_clock import use_a_simulated_clock
from tests.cli.test_explore_arms import RIGS
from tests.drivers.arm.test_homing import Unhomed, moves_home, until
from tests.verified import verify_here

RIG = '[devices.arm]\ndriver = "jaco"\ndouble = true\n' + OPTOFORCE + DEPTH + SURFACE
BOX = "[workspace]\nlow_m = [-0.40, -0.66, 0.0]\nhigh_m = [0.45, 0.10, 0.75]\n"


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: Patch) -> Path:
    use_a_simulated_clock(monkeypatch)
    path = tmp_path / "rig.toml"
    path.write_text(RIG + BOX)
    return path


class NoRecorder:
    """Takes what it is given."""

    def start(self, *_: object) -> None: ...

    def write(self, items: object) -> None: ...

    def stopped_because(self, reason: str) -> None: ...

    def summary(self) -> object:
        return type("Summary", (), {"path": None})()


def typed(presses: list[tuple[int, str]]) -> Iterator[str]:
    """The keys of each control period: (period, key)."""
    at = dict(presses)
    for period in range(10_000):
        yield at.get(period, "")


def jogged(rig: Path, presses: list[tuple[int, str]]) -> np.ndarray:
    keys = typed(presses)
    return np.asarray(arm_commands.jog(JogConfig(str(rig)), no_recording(), lambda: next(keys)))


def no_recording() -> contextlib.AbstractContextManager[Recorder]:
    return contextlib.nullcontext(NoRecorder())  # type: ignore[arg-type]


def test_keys_move_the_tip_a_step_each(rig: Path) -> None:
    rig.write_text(RIG)  # before there is any box
    start_m = jogged(rig, [(5, "q")])
    moved_m = jogged(rig, [(5, "d"), (60, "r"), (120, "2"), (130, "s"), (200, "q")])
    assert moved_m - start_m == pytest.approx([0.005, -0.005, 0.005], abs=8e-4)


def test_a_jog_is_stopped_by_the_supervisor_at_the_box(rig: Path) -> None:
    """A key that is held runs into the box's side: the same verdict as in an exploration."""
    start_m = jogged(rig, [(5, "q")])
    rig.write_text(RIG + BOX.replace("0.10, 0.75]", "0.10, 0.3]").replace("0.3]", f"{start_m[2] + 0.03:.3f}]"))
    with pytest.raises(Exception, match="workspace left"):
        jogged(rig, [(5 + 3 * count, "r") for count in range(200)])


def test_go_by_an_arm_without_joint_torques_begins_with_a_finger_on_its_tip(rig: Path, capsys: Capture) -> None:
    rig.write_text(RIGS["kuka"])
    assert main(["arm", "go", str(rig), "--above", "0.3,0.2", "--height", "0.12"]) == 0
    assert "ok  force sensor: finger" in capsys.readouterr().err


def test_a_device_that_fails_at_closing_is_said(rig: Path, monkeypatch: Patch, capsys: Capture) -> None:
    close = Optoforce.close

    def fail(device: Optoforce) -> None:
        close(device)
        raise DeviceError("a sensor that lets go of its port", "one that did not")

    monkeypatch.setattr(Optoforce, "close", fail)
    said = "deformscope: device tip failed: expected a sensor that lets go of its port; got one that did not\n"
    jogged(rig, [(5, "q")])
    assert capsys.readouterr().err.count(said) == 1
    with pytest.raises(StopIteration):  # whatever ends it
        arm_commands.jog(JogConfig(str(rig)), no_recording(), iter(["d"]).__next__)
    assert capsys.readouterr().err.count(said) == 1


def interrupted() -> Iterator[str]:
    yield from [""] * 20
    os.kill(os.getpid(), signal.SIGINT)
    yield from [""] * 1000


@pytest.mark.parametrize("by", [128 + signal.SIGINT, slow(2)], ids=["Ctrl-C", "supervisor"])
def test_a_jog_that_is_stopped_is_recorded_whole(
    by: int, rig: Path, tmp_path: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    keys = interrupted()
    if by == 2:
        keys = typed([(5 + 3 * count, "r") for count in range(200)])
        rig.write_text(RIG + BOX.replace("0.75]", "0.3]"))
    monkeypatch.setattr(arm_commands, "terminal_keys", lambda: contextlib.nullcontext(lambda: next(keys)))
    assert main(["arm", "jog", str(rig), "--record", str(tmp_path / "jog.rrd")]) == by
    assert (f"the recording is complete: {tmp_path / 'jog.rrd'}" in capsys.readouterr().err) == (by != 2)
    assert verify_here(tmp_path / "jog.rrd") in (0, EXIT_LOSSES)
    ended = "workspace left" if by == 2 else "a person asked: Ctrl-C"
    assert f"ended {ended}" in capsys.readouterr().out


def test_go_brings_the_tip_over_a_place(rig: Path, tmp_path: Path) -> None:
    found = tmp_path / "there.json"
    assert main(["arm", "go", str(rig), "--above", "0.2,0.15", "--height", "0.12", "--json", str(found)]) == 0
    assert json.loads(found.read_text())["center_m"] == pytest.approx([0.2, 0.15, 0.05 + 0.12 + 0.01], abs=3e-3)


def test_where_it_is_and_home(tmp_path: Path, capsys: Capture) -> None:
    """On the driver's own thread, with a double behind it."""
    path, found = tmp_path / "rig.toml", tmp_path / "where.json"
    path.write_text('[devices.arm]\ndriver = "jaco"\ndouble = true\n')
    assert main(["arm", "where", str(path), "--json", str(found)]) == 0
    there = json.loads(found.read_text())
    assert len(there["joints_deg"]) == 6
    assert there["tip_surface_m"] is None
    assert np.linalg.norm(np.array(there["T_base_ee"])[:3, 3] - there["tip_base_m"]) == pytest.approx(0.1, abs=1e-3)
    assert "to its limit" in capsys.readouterr().out
    assert main(["arm", "home", str(path)]) == 2
    assert "--yes" in capsys.readouterr().err


def test_the_double_of_a_bench_goes_home(tmp_path: Path, capsys: Capture) -> None:
    """Whoever leads it there lets go of it: it came home in no time at all."""
    path = tmp_path / "rig.toml"
    path.write_text('[devices.arm]\ndriver = "jaco"\ndouble = true\n')
    assert main(["arm", "home", str(path), "--yes"]) == 0
    assert "the arm is at home" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["where"], ["home", "--yes"]])
def test_what_is_wrong_with_an_arm_is_refused_in_a_line(words: list[str], tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('[devices.arm]\ndriver = "jaco"\nown_process = false\n')
    assert main(["arm", words[0], str(path), *words[1:]]) == 2
    err = capsys.readouterr().err
    assert err.splitlines()[-1].startswith("deformscope: error: expected the vendor's library")
    assert err.splitlines()[-1].endswith("| device arm")


@pytest.fixture
def unhomed(tmp_path: Path, monkeypatch: Patch) -> tuple[str, Path]:
    """A rig whose Jaco, in its own process, was just switched on; and the file of the calls to its library."""
    calls = tmp_path / "calls"
    calls.touch()

    @contextlib.contextmanager
    def opened(config: object, scene: object) -> Iterator[HostedArm]:
        yield HostedArm(Unhomed, JacoConfig(library=str(calls)))

    monkeypatch.setitem(DRIVERS._loaded, "jaco", dataclasses.replace(DRIVERS["jaco"], simulated=opened))
    path = tmp_path / "rig.toml"
    path.write_text('[devices.arm]\ndriver = "jaco"\ndouble = true\n')
    return str(path), calls


def test_an_arm_that_was_not_homed_is_not_ok_and_is_homed(unhomed: tuple[str, Path], capsys: Capture) -> None:
    """Through its own process: what `doctor` and `arm where` advise works."""
    rig, _ = unhomed
    assert main(["doctor", rig, "--seconds", "0.1"]) == 2
    row = next(line for line in capsys.readouterr().out.splitlines() if "arm (jaco" in line)
    assert row.startswith("FAIL")
    assert "deformscope arm home" in row
    assert main(["arm", "where", rig]) == 0
    assert "no: deformscope arm home" in capsys.readouterr().out
    assert main(["arm", "home", rig, "--yes"]) == 0
    assert "the arm is at home" in capsys.readouterr().err


def test_ctrl_c_stops_an_arm_on_its_way_home(unhomed: tuple[str, Path], capsys: Capture) -> None:
    rig, calls = unhomed

    def interrupt() -> None:
        until(lambda: moves_home(calls) == 1)
        os.kill(os.getpid(), signal.SIGINT)

    asker = threading.Thread(target=interrupt)
    asker.start()
    assert main(["arm", "home", rig, "--yes"]) == 128 + signal.SIGINT
    asker.join()
    assert "the arm is stopped" in capsys.readouterr().err
    lines = calls.read_text().splitlines()
    assert lines[-1].startswith(("StopControlAPI", "EraseAllTrajectories"))
    assert float(lines[-1].split()[2]) - J2N6S300.home_deg[0] > 1.0, "it was home by then"


def test_an_arm_without_a_home_is_not_sent_there(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('[devices.arm]\ndriver = "kuka"\nmodel = "kr6r900sixx"\ndouble = true\n')
    assert main(["arm", "home", str(path), "--yes"]) == 2
    assert "by hand" in capsys.readouterr().err
