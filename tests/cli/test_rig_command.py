"""`deformscope rig new`: a rig file with what was found and named, which says what it lacks."""

import socket
from pathlib import Path

import pytest

from deformscope.cli import devices, main, rig
from deformscope.rig.rig_file import Rig, load_rig
from deformscope_drivers.ports import FoundDevice
from tests.cases import Capture, Patch

PLUGGED_IN = [
    FoundDevice("optoforce", "/dev/serial/by-id/usb-OptoForce", "OptoForce DAQ", "ISE0A129"),
    FoundDevice("", "/dev/ttyUSB0", "FT232R", note="a serial adapter"),
    FoundDevice("webcam", "/dev/video0", "Webcam"),
    FoundDevice("webcam", "/dev/video2", "Webcam"),
    FoundDevice("realsense", "serial 12345", "RealSense D435", "12345"),
    FoundDevice("", "socketcan:can0", "CAN interface"),
]


@pytest.fixture
def path(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.setattr(devices, "search", lambda: PLUGGED_IN)
    monkeypatch.setattr(rig, "at_terminal", lambda: False)
    return tmp_path / "rig.toml"


def configs(found: Rig) -> dict[str, tuple[str, str]]:
    """Of each device: driver, and where it is."""
    return {
        one.name: (
            one.driver.name,
            next((str(at) for key in ("port", "bus", "serial") if (at := getattr(one.config, key, ""))), ""),
        )
        for one in found.devices
    }


def test_what_is_found_and_named_is_in_the_file(path: Path, capsys: Capture) -> None:
    named = ["--device", "arm=kuka", "--device", "wrist=sdh:socketcan:can0"]
    assert main(["rig", "new", str(path), *named]) == 0
    assert configs(load_rig(path)) == {
        "arm": ("kuka", "59152"),
        "wrist": ("sdh", "socketcan:can0"),
        "tip": ("optoforce", "/dev/serial/by-id/usb-OptoForce"),
        "camera": ("webcam", "/dev/video0"),
        "camera2": ("webcam", "/dev/video2"),
        "depth": ("realsense", "12345"),
    }
    text, shown = path.read_text(), capsys.readouterr().err
    assert load_rig(path).camera.device == "depth"
    assert "# it lacks" in text, "the sensitivity of its own report"
    assert "sensitivity" not in "".join(line for line in text.splitlines() if not line.startswith("#"))
    assert {"[workspace]", "[surface]", "[hand]", "[record]"} <= {line.split(" ")[0] for line in text.splitlines()}
    assert "left out: /dev/ttyUSB0" in shown
    assert f"Next: deformscope doctor {path}" in shown


def test_a_person_is_asked_for_what_its_usb_identity_does_not_say(path: Path, monkeypatch: Patch) -> None:
    answers = iter(["", "dsa", "-", "-", "-", "sdh", "arm=jaco"])

    def answer(prompt: str) -> str:
        try:
            return next(answers)
        except StopIteration:
            raise EOFError from None

    monkeypatch.setattr(rig, "at_terminal", lambda: True)
    monkeypatch.setattr("builtins.input", answer)
    assert main(["rig", "new", str(path)]) == 0
    found = configs(load_rig(path))
    assert found["tip"][0] == "optoforce"
    assert found["pads"] == ("dsa", "/dev/ttyUSB0")
    assert found["hand"] == ("sdh", "socketcan:can0")
    assert set(found) == {"tip", "pads", "hand", "arm"}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--device", "arm"], "NAME=DRIVER:ADDRESS"),
        (["--device", "arm=franka"], "a driver out of"),
        (["--device", "tip=optoforce:nowhere"], "an address as a rig file has it"),
        (["--device", "a/b=kuka"], "NAME=DRIVER:ADDRESS"),
    ],
)
def test_what_cannot_be_written_is_refused(given: list[str], expected: str, path: Path, capsys: Capture) -> None:
    assert main(["rig", "new", str(path), *given]) == 2
    assert expected in capsys.readouterr().err
    assert not path.exists()


def test_an_existing_file_is_kept_and_an_empty_one_filled(path: Path, capsys: Capture) -> None:
    path.write_text("[devices]\n")
    assert main(["rig", "new", str(path), "--doubles"]) == 2
    assert path.read_text() == "[devices]\n"
    path.write_text("")
    assert main(["rig", "new", str(path), "--doubles"]) == 0
    assert all(one.double for one in load_rig(path).devices)


def test_without_any_device_it_has_an_example_of_each(path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    monkeypatch.setattr(devices, "search", list)
    assert main(["rig", "new", str(path)]) == 0
    assert len(load_rig(path).devices) == 6
    assert "no device was found" in capsys.readouterr().err


def test_whether_an_address_answers_is_said(path: Path, capsys: Capture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        at = f"socket://127.0.0.1:{server.getsockname()[1]}"
        assert main(["rig", "new", str(path), "--device", f"pads=dsa:{at}"]) == 0
        assert f"pads: dsa, {at} answers" in capsys.readouterr().err
    path.unlink()
    assert main(["rig", "new", str(path), "--device", f"pads=dsa:{at}"]) == 0
    assert f"{at} does not answer" in capsys.readouterr().err
