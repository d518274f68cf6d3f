"""Drivers are found by entry points, those of this project and those of strangers alike."""

import json
import os
import re
import shutil
import subprocess
import sys
import typing
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope_drivers import interface
from deformscope_drivers.arms import chains
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS, DeviceDriver, Drivers
from deformscope_drivers.new_package import PackageKind, write_package
from tests.cases import Capture, Patch
from tests.patience import PATIENCE_S
from tests.verified import verify_here

PACKAGES = Path(__file__).parents[2] / "drivers" / "packages"
ALONE = """
import importlib, pkgutil, sys, threading
class Alone:
    \"\"\"What a computer with numpy, pyserial and python-can alone has.\"\"\"
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top not in {"numpy", "serial", "can", "deformscope_drivers"} | SEEN:
            raise ModuleNotFoundError(name)
import can
SEEN = {name.partition(".")[0] for name in sys.modules}
sys.meta_path.insert(0, Alone())
import deformscope_drivers
for module in pkgutil.walk_packages(deformscope_drivers.__path__, "deformscope_drivers."):
    if ".contract" not in module.name:
        importlib.import_module(module.name)
print("imported")
"""


def python(*arguments: str, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    folders = [str(path)] if path is not None else []
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*folders, *(one for one in sys.path if one)])}
    command = [sys.executable, "-W", "ignore", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=PATIENCE_S)


def deformscope(*arguments: object, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    words = list(map(str, arguments))
    return python("-c", "import sys; from deformscope.cli import main; sys.exit(main(sys.argv[1:]))", *words, path=path)


@pytest.fixture
def install_here(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Path], None]]:
    """The packages of a folder, in this process until the test ends."""
    known = set(sys.modules)
    for name in ("_entries", "_loaded"):
        monkeypatch.setattr(DRIVERS, name, {})
    yield monkeypatch.syspath_prepend
    for name in set(sys.modules) - known:
        if name.startswith(("deformscope_my", "deformscope_netft", "broken")):
            del sys.modules[name]


def install(folder: Path, name: str, module: str, content: str) -> None:
    """A package as pip leaves it: its module, and the entry point in its metadata."""
    if content:
        (folder / f"{module}.py").write_text(content)
    about = folder / f"deformscope_{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: deformscope-{name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{interface.GROUP}]\n{name} = {module}:DRIVER\n")


def test_the_drivers_need_numpy_pyserial_and_python_can_alone() -> None:
    ran = python("-c", ALONE)
    assert ran.stdout == "imported\n", ran.stderr


def test_each_driver_of_this_project_can_be_loaded() -> None:
    for name in DRIVERS:
        assert (DRIVERS[name].name, DRIVERS[name].interface) == (name, interface.VERSION)


def test_only_the_driver_of_the_rig_is_imported() -> None:
    script = """
import sys
from deformscope.rig.rig_file import parse_rig
rig = parse_rig('[devices.tip]\\ndriver = "optoforce"\\nport = "/dev/x"', "rig")
print([name for name in ("jaco", "kuka", "dsa", "webcam") if f"deformscope_drivers.{name}" in sys.modules])
"""
    assert python("-c", script).stdout == "[]\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("import nowhere_to_be_found", "expected a package that can be imported; got ModuleNotFoundError"),
        ("DRIVER = 3", "expected a DeviceDriver of interface 1; got none"),
        (
            "from deformscope_drivers import interface\nDRIVER = interface.DeviceDriver('arm', int, int, interface=9)",
            "expected a DeviceDriver of interface 1; got 9",
        ),
    ],
)
def test_a_package_that_cannot_be_used_is_refused_where_a_rig_names_it(
    content: str, words: str, install_here: Callable[[Path], None], tmp_path: Path, capsys: Capture
) -> None:
    install(tmp_path, "broken", "broken_package", content)
    install_here(tmp_path)
    (tmp_path / "rig.toml").write_text('[devices.tip]\ndriver = "broken"\n')
    assert main(["doctor", str(tmp_path / "rig.toml")]) == 2
    errors = capsys.readouterr().err
    assert words in errors
    assert "driver broken (broken_package:DRIVER)" in errors
    assert len(errors.splitlines()) <= 5
    assert len(chains()) >= 5, "others still work"


def test_an_unknown_name_is_no_driver() -> None:
    assert "franka" not in DRIVERS
    with pytest.raises(KeyError):
        DRIVERS["franka"]


def test_a_driver_has_the_name_of_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.metadata

    entry = importlib.metadata.EntryPoint("mine", "deformscope_drivers.optoforce.driver:DRIVER", interface.GROUP)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry])
    found = Drivers()
    assert found["mine"].name == "mine"
    assert isinstance(found["mine"], DeviceDriver)
    assert "optoforce" in found, "the checkout's own are there too"


def test_a_package_does_not_replace_a_driver_of_this_project(tmp_path: Path) -> None:
    install(tmp_path, "optoforce", "another_optoforce", "raise SystemExit('it was imported')")
    script = "from deformscope_drivers.interface import DRIVERS; print(DRIVERS['optoforce'].config.__name__)"
    ran = python("-c", script, path=tmp_path)
    assert ran.stdout == "OptoforceConfig\n", ran.stderr


def test_an_entry_point_that_leads_nowhere_names_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.metadata

    entry = importlib.metadata.EntryPoint("lost", "deformscope_lost:DRIVER", interface.GROUP)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry])
    with pytest.raises(DeviceError, match="deformscope_lost"):
        Drivers()["lost"]
    assert Drivers().of_kind("wrench"), "a broken one does not hide the others"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording of a stranger's devices, and the folder in which their packages are installed."""
    folder, site = tmp_path_factory.mktemp("rig"), tmp_path_factory.mktemp("site")
    text = ""
    for kind in typing.get_args(PackageKind):
        package = write_package(folder, f"my{kind}", kind)
        shutil.copytree(package / f"deformscope_my{kind}", site / f"deformscope_my{kind}")
        install(site, f"my{kind}", f"deformscope_my{kind}", "")
        text += f'[devices.{kind}]\ndriver = "my{kind}"\ndouble = true\n'
    install(site, "netft", "deformscope_netft", "")
    (about,) = site.glob("deformscope_netft-*")
    (about / "entry_points.txt").write_text(f"[{interface.GROUP}]\nnetft = deformscope_netft:NETFT\n")
    shutil.copytree(PACKAGES / "netft" / "deformscope_netft", site / "deformscope_netft")
    text += (
        '[devices.netft]\ndriver = "netft"\ndouble = true\n[devices.optoforce]\ndriver = "optoforce"\ndouble = true\n'
    )
    rig = folder / "rig.toml"
    rig.write_text(text.replace('"myforce"', '"myforce"\nn_per_count = 0.02'))
    ran = deformscope("record", rig, "--seconds", "1.5", "--record", folder / "run.rrd", path=site)
    assert ran.returncode in (0, 3), ran.stderr  # 3: a busy machine
    return folder / "run.rrd", site


def test_a_strangers_devices_are_recorded_and_decoded_again(
    recorded: tuple[Path, Path], install_here: Callable[[Path], None], tmp_path: Path
) -> None:
    recording, site = recorded
    install_here(site)
    assert main(["replay", str(recording), "--json", str(tmp_path / "replay.json")]) == 0
    found = {one["device"]: one for one in json.loads((tmp_path / "replay.json").read_text())["devices"]}
    assert set(found) == {*typing.get_args(PackageKind), "netft", "optoforce"}
    assert all(one["driver"] == f"my{name}" for name, one in found.items() if name in typing.get_args(PackageKind))
    assert all(one["frames"] > 5 for one in found.values())
    for name in ("force", "tactile", "hand", "netft", "optoforce"):  # the last two have what their double gives them
        assert found[name]["compared"] == found[name]["frames"]
        assert found[name]["difference"] == ""
    assert found["arm"]["left_out"] == "its driver gives no bytes"


def test_without_its_package_a_recording_opens_verifies_and_is_exported(
    recorded: tuple[Path, Path], tmp_path: Path, capsys: Capture
) -> None:
    recording, _ = recorded
    assert verify_here(recording) == 0
    assert main(["export", str(recording), "--to", "csv", "--out", str(tmp_path / "csv")]) in (0, 3)
    assert "force" in "".join(path.read_text() for path in (tmp_path / "csv").rglob("*.csv"))
    capsys.readouterr()
    assert main(["replay", str(recording)]) == 0
    assert "no package of driver myforce is installed" in "".join(capsys.readouterr())
    assert main(["catalog", str(recording.parent)]) == 0


def test_a_key_that_its_driver_does_not_have_is_refused(
    recorded: tuple[Path, Path], install_here: Callable[[Path], None], tmp_path: Path, capsys: Capture
) -> None:
    install_here(recorded[1])
    (tmp_path / "rig.toml").write_text('[devices.tip]\ndriver = "myforce"\nn_per_cuont = 0.02\n')
    assert main(["doctor", str(tmp_path / "rig.toml")]) == 2
    errors = capsys.readouterr().err
    assert "'n_per_cuont'" in errors
    assert "n_per_count" in errors


@pytest.mark.parametrize("kind", ["force", "camera", "tactile", "arm", "hand"])
def test_a_new_package_passes_its_tests_as_it_is(kind: str, tmp_path: Path) -> None:
    words = ["new-device", "mydevice", "--kind", kind, "--out", str(tmp_path)]
    assert main(words) == 0
    folder = tmp_path / "mydevice"
    ran = python("-m", "pytest", "-q", "-c", str(folder / "pyproject.toml"), str(folder / "tests"), path=folder)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert " passed" in ran.stdout
    assert main(words) == 2, "it exists"


@pytest.mark.parametrize("name", ["optoforce", "My-Sensor", "", "x" * 41])
def test_a_name_that_cannot_be_used_is_refused(name: str, tmp_path: Path, capsys: Capture) -> None:
    assert main(["new-device", name, "--kind", "force", "--out", str(tmp_path)]) == 2
    assert "| try: " in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_printed_installation_is_of_the_folder(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """`pip install mysensor` would ask a registry for a package of that name."""
    monkeypatch.chdir(tmp_path)
    assert main(["new-device", "mysensor", "--kind", "force"]) == 0
    (installed,) = re.findall(r"pip install -e ([^;]+);", capsys.readouterr().err)
    assert os.sep in installed
    assert (Path(installed) / "pyproject.toml").is_file()


def test_the_documented_driver_is_the_one_that_is_written(tmp_path: Path) -> None:
    """The tests of that one are above: the page needs none of its own."""
    page = (Path(__file__).parents[2] / "drivers" / "interface.md").read_text(encoding="utf-8")
    written = write_package(tmp_path, "mysensor", "force") / "deformscope_mysensor" / "__init__.py"
    assert page.count("```python\n") == 1
    assert page.partition("```python\n")[2].partition("```")[0] == written.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_strangers_arm_and_force_sensor_explore_simulated_foam(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    """No file of the product knows them."""
    _, site = recorded
    text = "".join(f'[devices.{name}]\ndriver = "my{name}"\ndouble = true\n' for name in ("arm", "force", "camera"))
    text = text.replace('"myforce"', '"myforce"\nn_per_count = 0.02\nrate_hz = 100.0')
    text = text.replace('"mycamera"', '"mycamera"\nfps = 10.0')
    box = "[workspace]\nlow_m = [-0.4, -0.66, 0.0]\nhigh_m = [0.45, 0.1, 0.75]\ncamera_silent_s = 0.5\n"
    box += "arm_silent_s = 0.5\nforce_silent_s = 0.5\n"
    (tmp_path / "rig.toml").write_text(f'{text}[surface]\nscene = "two-60-150"\n{box}')
    given = ["explore", tmp_path / "rig.toml", "--yes", "--touches", "1", "--viewer", "none"]
    ran = deformscope(*given, "--json", tmp_path / "found.json", path=site)
    assert ran.returncode in (0, 3), ran.stderr  # 3: a busy machine
    (touch,) = json.loads((tmp_path / "found.json").read_text())["touches"]
    assert touch["peak_force_n"] == pytest.approx(3.0, abs=0.6)
