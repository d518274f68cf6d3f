"""Imports point one way, and what every command loads stays light."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import deformscope
from tests.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"deformscope": ROOT / "deformscope", "deformscope_drivers": ROOT / "drivers" / "deformscope_drivers"}

ABOVE_FRAMES = tuple(
    f"deformscope.{name}"
    for name in (
        *("sources", "replay", "log", "recorder", "session", "experiments", "cli", "config", "lab", "bench"),
        *("closeup", "pictures", "report", "rig_replay", "rig_streams", "exploration_pictures", "exploration_replay"),
    )
)
FORBIDDEN = {
    # Drivers can be split out one day by moving a folder.
    "deformscope_drivers": ("deformscope", "rerun", "warp", "open3d", "tyro", "rich"),
    # Stages are pure: arrays in, frozen results out.
    "deformscope.stages": ("deformscope.frames", *ABOVE_FRAMES, "rerun", "tyro", "rich"),
    "deformscope.frames": ("deformscope.stages", *ABOVE_FRAMES, "rerun", "tyro", "rich"),
    # What is recorded of a rig can be read back without what logs and shows it.
    "deformscope.rig_streams": ("numpy", "deformscope.stages", "deformscope.log", "rerun", "tyro", "rich"),
    "deformscope.rig_replay": (
        *("deformscope.stages", "deformscope.log", "deformscope.recorder", "deformscope.session", "deformscope.lab"),
        *("deformscope.experiments", "deformscope.cli"),
    ),
    "deformscope.sources": ("deformscope.lab", "deformscope.stages", "deformscope.log", "deformscope.experiments"),
    "deformscope.log": ("deformscope.session", "deformscope.experiments", "deformscope.cli", "deformscope.lab"),
    # Pictures go into recordings and reports alike.
    "deformscope.pictures": (
        *("deformscope.log", "deformscope.session", "deformscope.recorder", "deformscope.experiments"),
        *("deformscope.cli", "deformscope.lab", "rerun"),
    ),
    "deformscope.exploration_pictures": (
        *("deformscope.log", "deformscope.session", "deformscope.recorder", "deformscope.experiments"),
        *("deformscope.cli", "deformscope.lab", "rerun"),
    ),
    "deformscope.exploration_replay": (
        *("deformscope.log", "deformscope.recorder", "deformscope.session", "deformscope.lab"),
        *("deformscope.experiments", "deformscope.cli", "rerun"),
    ),
    "deformscope.report": ("deformscope.stages", "deformscope.cli", "deformscope.pictures", "numpy", "rerun"),
    "deformscope.recorder": ("deformscope.experiments", "deformscope.cli", "deformscope.lab"),
    "deformscope.session": ("deformscope.experiments", "deformscope.cli", "deformscope.lab", "rerun"),
    "deformscope.experiments": ("deformscope.cli", "rerun", "tyro"),
    # How the robot touches knows devices and geometry; who simulates, shows or plans wires it.
    "deformscope.robot": (
        *("deformscope.stages", "deformscope.log", "deformscope.recorder", "deformscope.session"),
        *("deformscope.experiments", "deformscope.cli", "deformscope.lab", "rerun", "tyro", "rich"),
    ),
    # The simulated world must not share the model that is fitted to it.
    "deformscope.lab": ("deformscope.stages.msm", "deformscope.experiments", "deformscope.cli"),
    "deformscope.config": ("numpy", "rich", "rerun", "warp"),
    # A GPU machine that has numpy, scipy and warp alone runs it.
    "deformscope.bench": (
        *("deformscope.cli", "deformscope.config", "deformscope.experiments", "deformscope.log", "deformscope.session"),
        *("rerun", "tyro", "rich", "open3d", "cv2", "sklearn", "threadpoolctl"),
    ),
}


def modules() -> dict[str, Path]:
    """Every module of both packages."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            name = ".".join((package, *parts)).removesuffix(".__init__")
            found[name] = path
    return found


def imported(path: Path) -> set[str]:
    """The modules that a file imports anywhere, inside functions and for type checking too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


@pytest.mark.parametrize("layer", FORBIDDEN)
def test_imports_point_one_way(layer: str) -> None:
    wrong = [
        f"{name} imports {target}"
        for name, path in modules().items()
        if within(name, layer)
        for target in sorted(imported(path))
        for forbidden in FORBIDDEN[layer]
        if within(target, forbidden)
    ]

    assert wrong == []


def test_other_engines_are_imported_in_their_own_processes_alone() -> None:
    engines = ("pypbd", "mujoco", "newton")
    importers = [
        name for name, path in modules().items() if any(within(to, e) for to in imported(path) for e in engines)
    ]

    assert importers == ["deformscope.bench.peer_process"]


def test_help_loads_nothing_heavy() -> None:
    pytest.importorskip("tyro")
    script = """
import contextlib, io, sys
from deformscope.cli import COMMANDS, main
assert "tyro" not in sys.modules, "tyro is for a command's own flags"
with contextlib.redirect_stdout(io.StringIO()):
    for name in ["", *{name.split()[0] for name in COMMANDS}, *COMMANDS]:
        assert main([*name.split(), "--help"]) == 0, name
    assert main(["--version"]) == 0
heavy = "rerun warp open3d sklearn scipy cv2 matplotlib skfem numpy serial can pyarrow rich".split()
print(sorted(set(heavy) & set(sys.modules)))
"""
    # Not installed, the packages are found where pytest found them.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    shown = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=environment
    )

    assert shown.stderr == ""
    assert shown.stdout == "[]\n"


def test_version_is_told_once() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]

    assert deformscope.__version__ == declared


def test_a_driver_in_a_users_script_loads_nothing_of_ours() -> None:
    script = """
import sys
import deformscope_drivers.dsa, deformscope_drivers.sdh, deformscope_drivers.optoforce, deformscope_drivers.jaco
import deformscope_drivers.webcam, deformscope_drivers.depth_camera
import deformscope_drivers.wires, deformscope_drivers.ports
heavy = "rerun warp open3d sklearn scipy cv2 matplotlib skfem pyarrow rich tyro deformscope pytest".split()
print(sorted(set(heavy) & set(sys.modules)))
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    shown = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=environment
    )

    assert shown.stderr == ""
    assert shown.stdout == "[]\n"
