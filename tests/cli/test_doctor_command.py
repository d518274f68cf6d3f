"""`doctor` prints its whole table whatever one device does; the example rig works with doubles in every place."""

import contextlib
import json
from importlib import resources
from pathlib import Path

import pytest

from deformscope.cli import doctor, main
from deformscope.cli.common import EXIT_LOSSES
from deformscope.lab import double_device
from deformscope_drivers import kuka
from tests.cases import Capture, Patch, slow

DEVICES = ("tip", "pads", "hand", "arm", "camera", "depth")


@pytest.fixture
def example(tmp_path: Path) -> str:
    text = (resources.files("deformscope") / "lab" / "rig-example.toml").read_text(encoding="utf-8")
    return text.replace('folder = "runs"', f'folder = "{tmp_path}"')


def doubled(text: str, *but: str) -> str:
    """The same with doubles in the place of all devices, but for these."""
    lines = []
    for line in text.splitlines():
        lines.append(line)
        if line.startswith("[devices.") and line.split("]")[0].removeprefix("[devices.") not in but:
            lines.append("double = true")
    return "\n".join(lines)


def verdicts(path: Path, capsys: Capture, *arguments: str) -> tuple[int, dict[str, tuple[str, str]]]:
    """The exit status, and verdict and words by device; what else there is to look at, as losses on a busy machine, is
    left out."""
    status = main(["doctor", str(path), "--seconds", "0.1", "--json", "-", *arguments])
    found = json.loads(capsys.readouterr().out)["findings"]
    rows = [(f["what"].split()[0], (f["verdict"], f["told"])) for f in found if "(" in f["what"]]
    return status, {name: row for name, row in rows if row[0] != "look"}


def test_the_example_works_with_doubles(example: str, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(doubled(example))
    status, found = verdicts(path, capsys)
    assert {name: verdict for name, (verdict, _) in found.items()} == dict.fromkeys(DEVICES, "ok")
    assert status == 0


def test_devices_that_fail_are_rows_among_the_others(example: str, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rig.toml"
    for there, missing in (("usb-OptoForce_DAQ-if00", "none"), ("ttyUSB0", "ttyNONE"), ('bus = "socketcan:can0"', "")):
        assert there in example
        example = example.replace(there, missing)
    path.write_text(doubled(example, "tip", "pads", "hand"))
    status, found = verdicts(path, capsys)
    assert tuple(found) == DEVICES
    assert [name for name in DEVICES if found[name][0] == "ok"] == ["arm", "camera", "depth"]
    assert all("| try: " in told for verdict, told in found.values() if verdict == "FAIL")
    assert status == 2
    assert main(["doctor", str(path), "--seconds", "0.1"]) == 2
    printed = capsys.readouterr()
    last = printed.out.splitlines()[-1]
    assert last == f"next: repair tip (optoforce) (its line above says how), then deformscope doctor {path}"
    assert "repair tip (optoforce) first" in printed.err


def test_whatever_a_device_raises_is_a_row(example: str, tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    whole = double_device._wire_process

    def fail(driver: str, config: object) -> contextlib.AbstractContextManager[str]:
        if driver == "dsa":
            raise ZeroDivisionError("by zero")
        return whole(driver, config)

    path = tmp_path / "rig.toml"
    path.write_text(doubled(example))
    monkeypatch.setattr(double_device, "_wire_process", fail)
    status, found = verdicts(path, capsys)
    assert found.pop("pads")[1].startswith("unexpected ZeroDivisionError: by zero | try: ")
    assert {verdict for verdict, _ in found.values()} == {"ok"}
    assert len(found) == len(DEVICES) - 1
    assert status == 2


def test_what_the_robot_looks_like_is_a_row(tmp_path: Path, capsys: Capture) -> None:
    rig = tmp_path / "rig.toml"
    arm = '[devices.arm]\ndriver = "kuka"\ndouble = true\n'
    rig.write_text(f'{arm}[shape]\nurdf = "none.urdf"\n', encoding="utf-8")
    assert main(["doctor", str(rig), "--seconds", "0.1"]) == 2
    told = capsys.readouterr().out
    assert "FAIL  shape" in told
    assert "none.urdf" in told
    cable = "cables = [{ points_m = [[0, 0, 0], [0, 0, 0.1]] }]"
    rig.write_text(f'{arm}[shape]\nurdf = "{kuka.__path__[0]}/kr6r900sixx.urdf"\n{cable}\n', encoding="utf-8")
    main(["doctor", str(rig), "--seconds", "0.1"])
    assert "mesh: 7 solids of" in capsys.readouterr().out


def test_a_folder_that_no_disk_can_have_is_a_row(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f'[devices.arm]\ndriver = "jaco"\ndouble = true\n[record]\nfolder = "{"a" * 5000}"\n')
    assert main(["doctor", str(path), "--seconds", "0.1"]) == 2
    told = capsys.readouterr().out
    assert "FAIL  disk" in told
    assert "ok    arm" in told


@pytest.mark.parametrize("command", [["record"], slow(["live", "--viewer", "none"])])
def test_the_example_with_doubles_is_recorded(command: list[str], example: str, tmp_path: Path) -> None:
    path, told = tmp_path / "rig.toml", tmp_path / "told.json"
    path.write_text(doubled(example))
    status = main([*command, str(path), "--seconds", "1", "--json", str(told)])
    found = json.loads(told.read_text())
    devices = found["devices"]
    assert tuple(devices) == DEVICES
    assert all(health["received"] for health in devices.values())
    assert not found["failures"]
    # doubles keep to the host's clock: a busy machine loses readings of theirs
    assert status == (EXIT_LOSSES if found["losses"] and command == ["record"] else 0)


@pytest.mark.parametrize("all_doubled", [True, False])
def test_doubles_of_the_example_run_for_others(
    all_doubled: bool, example: str, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = tmp_path / "rig.toml"
    path.write_text(doubled(example) if all_doubled else example)
    assert main(["double", str(path), "--seconds", "0.1"]) == 0
    said = capsys.readouterr()
    assert [line for line in said.out.splitlines() if line.startswith("[")] == [
        f"[devices.{name}]" for name in ("tip", "pads", "hand")
    ]
    assert "arm, camera, depth: simulated only within a command" in said.err


def test_a_rig_without_anything_to_double_is_told(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('[devices.camera]\ndriver = "webcam"\n')
    assert main(["double", str(path)]) == 2
    assert "expected a rig with devices of dsa, optoforce, sdh; got none" in capsys.readouterr().err


def test_what_a_device_remarks_of_itself_is_to_be_looked_at(
    tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    from deformscope_drivers.realsense.double import CAMERAS_FILE, DoubleCamera, plug

    plug(tmp_path / "cameras.json", DoubleCamera(usb="2.1"))
    monkeypatch.setenv(CAMERAS_FILE, str(tmp_path / "cameras.json"))
    keys = 'driver = "realsense"\ndouble = true\nwidth = 64\nheight = 48\nfps = 6\nwarm_up_s = 0.1'
    path = tmp_path / "rig.toml"
    path.write_text(f"[devices.depth]\n{keys}\n")
    assert main(["doctor", str(path), "--seconds", "0.1", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)["findings"]
    (fine, look) = [one for one in found if "(realsense" in one["what"] and "lost" not in one["told"]]
    assert fine["verdict"] == "ok"
    assert "Intel RealSense D435 837212070000 5.16.0.1" in fine["told"]
    assert (look["verdict"], look["told"].split(":")[0]) == ("look", "it is on USB 2.1")


@pytest.mark.parametrize(("allowed", "verdict"), [(True, "ok"), (False, "look")])
def test_whether_the_robots_threads_may_be_real_time_is_a_row(
    tmp_path: Path, capsys: Capture, monkeypatch: Patch, allowed: bool, verdict: str
) -> None:
    monkeypatch.setattr(doctor, "may_be_prompt", lambda: allowed)
    rig = tmp_path / "rig.toml"
    rig.write_text('[devices.arm]\ndriver = "kuka"\ndouble = true\n', encoding="utf-8")
    main(["doctor", str(rig), "--seconds", "0.1"])
    told = capsys.readouterr().out
    assert f"{verdict:<5} real time" in told
    assert ("rtprio" in told) is not allowed
