"""Five broken rigs: `doctor` names each fault in one line, with what to do; an arm's gain shows as it first moves."""

import contextlib
import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deformscope.cli import main
from deformscope_drivers.interface import DRIVERS, GROUP
from deformscope_drivers.wires import LOOPBACK, DatagramWire, PortsWire
from tests.cases import AHEAD, COMPLIANCE, DEPTH, OPTOFORCE, Capture, Patch
from tests.cli.quick_scene import use_quick_scene
from tests.cli.rig_on_a_simulated_clock import use_a_simulated_clock

PACKAGES = Path(__file__).parents[2] / "drivers" / "packages"
TIP = '[devices.tip]\ndriver = "netft"\n'
DOUBLED = f"{TIP}double = true\n"
WHOLE = '[devices.arm]\ndriver = "ur"\ndouble = true\n' + OPTOFORCE + DEPTH + COMPLIANCE + AHEAD
MIRRORED = "[[1, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: Patch) -> None:
    """The vendors' packages, as pip leaves them: for processes of their own too."""
    for name, driver in (("ur", "DRIVER"), ("netft", "NETFT")):
        monkeypatch.syspath_prepend(str(PACKAGES / name))
        about = tmp_path / f"deformscope_{name}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: deformscope-{name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(f"[{GROUP}]\n{name} = deformscope_{name}:{driver}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("_entries", "_loaded"):
        monkeypatch.setattr(DRIVERS, name, {})


def doctor(text: str, tmp_path: Path, capsys: Capture) -> tuple[int, list[str], str]:
    """The exit status, the rows that fail, and what is on the standard error."""
    rig = tmp_path / "rig.toml"
    rig.write_text(text)
    capsys.readouterr()
    status = main(["doctor", str(rig), "--seconds", "0.1", "--json", str(tmp_path / "found.json")])
    shown = capsys.readouterr()
    rows = [line for line in shown.out.splitlines() if line.startswith("FAIL ")]
    if shown.out:
        found = json.loads((tmp_path / "found.json").read_text())["findings"]
        assert [one["told"] for one in found if one["verdict"] == "FAIL"] == [
            row.split("  ", 2)[-1].strip() for row in rows
        ]
    return status, rows, shown.err


def check_line(line: str, *words: str) -> None:
    """One line that says what was expected, what came, and what to do."""
    for word in ("expected ", "; got ", " | try: ", *words):
        assert word in line


@contextlib.contextmanager
def controller(broken: Callable[..., object] = lambda double: None) -> Iterator[str]:
    """A rig file with a UR whose controller is broken so, and a force sensor that is well."""
    from deformscope_ur import UrDouble

    double = UrDouble()
    broken(double)
    with PortsWire(double) as wire:
        yield f'{DOUBLED}[devices.arm]\ndriver = "ur"\nport = "{wire.port}"\n'


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(type=kind) as tried:
        tried.bind((LOOPBACK, 0))
        return int(tried.getsockname()[1])


def test_a_rig_without_a_fault_works(tmp_path: Path, capsys: Capture) -> None:
    with controller() as text:
        assert doctor(text, tmp_path, capsys)[:2] == (0, [])


def test_a_wrong_address(tmp_path: Path, capsys: Capture) -> None:
    here = f"{LOOPBACK}:{free_port(socket.SOCK_STREAM)}"
    text = f'{DOUBLED}[devices.arm]\ndriver = "ur"\nport = "socket://{here}"\n'
    status, (row,), err = doctor(text, tmp_path, capsys)
    check_line(row, "arm (ur) ", "Connection refused", "`port` with the address of PolyScope's Settings", here)
    assert status == 2
    check_line(err.splitlines()[-1], "trouble with arm (ur)")


@pytest.mark.parametrize(
    ("more", "what_to_do"),
    [("", "`port` with its address"), ("counts_per_n = 1e6\ncounts_per_nm = 1e6\n", "check power, cable and address")],
    ids=["its page too", "its counts are known"],
)
def test_a_wrong_address_of_a_force_sensor(more: str, what_to_do: str, tmp_path: Path, capsys: Capture) -> None:
    port, http_port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    text = f'{TIP}port = "udp://{LOOPBACK}:{port}"\nhttp_port = {http_port}\n'
    status, (row,), _ = doctor(f"{text}{more}", tmp_path, capsys)
    check_line(row, "tip (netft) ", what_to_do, LOOPBACK)
    assert status == 2


@pytest.mark.parametrize(
    ("broken", "came", "what_to_do"),
    [
        (lambda double: setattr(double, "remote", False), "local control", "choose remote control at the top right"),
        (lambda double: double.protective_stop(), "a protective stop", "look for its cause, then unlock it"),
    ],
    ids=["local mode", "protective stop"],
)
def test_a_controller_that_is_not_ready(
    broken: Callable[..., object], came: str, what_to_do: str, tmp_path: Path, capsys: Capture
) -> None:
    with controller(broken) as text:
        status, (row,), _ = doctor(text, tmp_path, capsys)
    check_line(row, "arm (ur) ", f"; got {came} | try: {what_to_do}")
    assert status == 2


@pytest.mark.parametrize(("key", "other"), [("counts_per_n", "counts_per_nm"), ("counts_per_nm", "counts_per_n")])
def test_a_gain_of_ten_of_a_force_sensor(key: str, other: str, tmp_path: Path, capsys: Capture) -> None:
    """Its page knows better than the rig file."""
    from deformscope_netft import NetftConfig
    from deformscope_netft.double import NetftDouble, NetftPage

    with DatagramWire(NetftDouble(NetftConfig())) as wire, NetftPage() as page:
        text = f'{TIP}port = "{wire.port}"\nhttp_port = {page.port}\n'
        status, (row,), _ = doctor(f"{text}{key} = 1e5\n{other} = 1e6\n", tmp_path, capsys)
        check_line(row, "tip (netft) ", f"expected {key} = 1e+06, as on its page; got 100000 | try: take both keys out")
        assert status == 2
        assert doctor(f"{text}{key} = 1.001e6\n{other} = 1e6\n", tmp_path, capsys)[:2] == (0, [])
        assert doctor(text, tmp_path, capsys)[:2] == (0, [])


@pytest.mark.parametrize(
    ("section", "key"),
    [("surface", "T_arm_surface"), ("camera", "T_arm_camera"), ("tool", "T_ee_tip"), ("hand", "T_camera_hand")],
)
def test_a_mirrored_frame(section: str, key: str, tmp_path: Path, capsys: Capture) -> None:
    status, _, err = doctor(f"{DOUBLED}[{section}]\n{key} = {MIRRORED}\n", tmp_path, capsys)
    (line,) = err.splitlines()
    check_line(line, f"[{section}] with {key} that is no mirror image", "reverse one of its axes")
    assert status == 2


def test_a_gain_of_ten_of_an_arm(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """Nothing moves while doctor listens: the first motion ends at once, in one line."""
    import deformscope_ur.double

    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    made = deformscope_ur.double.UrDouble.__init__

    def tenfold(double: Any, *given: Any, **more: Any) -> None:
        made(double, *given, **more)
        double.gain = 10.0

    monkeypatch.setattr(deformscope_ur.double.UrDouble, "__init__", tenfold)
    rig = tmp_path / "rig.toml"
    rig.write_text(WHOLE)
    assert main(["arm", "go", str(rig), "--above", "0.1,0.1", "--viewer", "none"]) == 2
    (line,) = (line for line in capsys.readouterr().err.splitlines() if "error: " in line)
    check_line(line, "a joint turned at ", "was asked: end other programs that move it", "the arm is stopped")
