"""Imports point one way, and what every command loads stays light."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import yaml

import deformscope
from tests.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "deformscope": ROOT / "deformscope",
    "deformscope_drivers": ROOT / "drivers" / "deformscope_drivers",
    "studies": ROOT / "studies",
}

STAGES = tuple(
    f"stages.{name}"
    for name in "gaussian_process msm see fit regions poke simulate materials map squeeze setup".split()  # noqa: SIM905
)
LAYERS: dict[str, tuple[str, ...]] = {
    "arrays": (),
    "bench_cases": (),
    "errors": (),
    "plain": (),
    "processes": ("errors",),
    "version": (),
    "executor": ("errors", "processes", "version"),
    # What is reported of a result, declared where its dataclass is.
    "results": ("plain",),
    "solid": ("arrays",),
    "images": ("arrays", "errors", "file_io"),
    "frames": ("arrays",),
    # Stages are pure: arrays in, frozen results out.
    "stages.gaussian_process": ("arrays", "errors"),
    "stages.msm": ("arrays", "errors"),
    "stages.see": ("arrays", "errors", "solid"),
    "stages.fit": ("arrays", "errors", "results", "stages.gaussian_process", "stages.msm"),
    "stages.regions": ("arrays", "errors", "stages.gaussian_process"),
    "stages.poke": (
        *("arrays", "errors", "results", "stages.gaussian_process", "stages.msm", "stages.fit", "stages.regions"),
    ),
    "stages.materials": ("arrays", "errors", "results", "stages.gaussian_process", "stages.msm", "stages.fit"),
    "stages.map": (
        *("arrays", "errors", "results", "stages.gaussian_process", "stages.msm", "stages.see", "stages.fit"),
        *("stages.regions", "stages.poke"),
    ),
    "stages.squeeze": ("arrays", "solid", "errors", "executor", "processes", "results", "stages.see"),
    "stages.setup": ("arrays", "errors"),
    "stages.simulate": ("arrays", "errors", "stages.msm", "stages.fit", "stages.poke"),
    "simulators": ("arrays", "errors", "processes", "stages.simulate"),
    "pictures": ("arrays", "errors", "images", "processes", "results", *STAGES),
    "log": ("arrays", "frames", "images", "pictures", "plain", "rows", *STAGES),
    "rig": ("errors", "file_io", "frames"),
    "robot": ("arrays", "errors", "rig", "solid"),
    # The simulated world must not share the model that is fitted to it.
    "lab": ("arrays", "errors", "processes", "rig", "robot", "solid"),
    "session": ("frames",),
    "rows": ("arrays", "frames", "images", "results", "stages.map", "stages.squeeze"),
    "page.server": ("errors",),
    "recording": (
        *("arrays", "errors", "file_io", "frames", "images", "log", "page.server", "plain", "results", "rows"),
        *("session", *STAGES),
    ),
    "files": ("arrays", "errors", "file_io", "frames", "images", "recording", *STAGES),
    # What others recorded, as frames.
    "imports": ("arrays", "errors", "file_io", "files", "frames", "images", "recording", "rig", "rows"),
    "experiments": (
        *("arrays", "solid", "config", "errors", "file_io", "files", "frames", "images", "processes", "recording"),
        *("results", "rig", "robot", "rows", "session", "version", *STAGES),
    ),
    # A GPU machine that has numpy, scipy and warp alone runs it.
    "bench": ("arrays", "bench_cases", "errors", "plain", "version", *STAGES),
    "config": ("bench_cases", "errors", "file_io"),
    "file_io": ("errors",),
    "terminal": ("errors",),
    # What pages show of runs, and how they steer them.
    "page": (
        *("arrays", "config", "errors", "experiments", "file_io", "files", "frames", "images"),
        *("log", "page.server", "pictures", "processes", "recording", "rig", "robot"),
        *("session", "terminal", *STAGES),
    ),
    # From options to results, with devices, files or a recording, and doubles where they are asked for.
    "runs": (
        *("arrays", "config", "errors", "experiments", "file_io", "files", "frames", "images", "lab"),
        *(
            "executor",
            "imports",
            "log",
            "page",
            "page.server",
            "pictures",
            "plain",
            "recording",
            "results",
            "rig",
            "robot",
            "simulators",
        ),
        *("rows", "session", "terminal", "version", *STAGES),
    ),
    # The functions behind `import deformscope`.
    "library": ("arrays", "config", "errors", "file_io", "files", "runs", "terminal", *STAGES),
}
"""What each folder may import of the others, also inside functions and for type checking. Nothing imports `cli`."""
FORBIDDEN = {
    # Nothing that is installed imports what validates it.
    "deformscope": ("studies",),
    # Drivers can be split out one day by moving a folder.
    "deformscope_drivers": ("deformscope", "studies", "rerun", "warp", "open3d", "tyro", "rich"),
    "deformscope.stages": ("rerun", "tyro", "rich", "deformscope_drivers"),
    "deformscope.frames": ("rerun", "tyro", "rich"),
    "deformscope.pictures": ("rerun",),
    "deformscope.session": ("rerun",),
    "deformscope.page.server": ("rerun", "tyro", "rich", "numpy"),
    "deformscope.experiments": ("rerun", "tyro"),
    "deformscope.robot": ("rerun", "tyro", "rich"),
    "deformscope.config": ("numpy", "rich", "rerun", "warp"),
    "deformscope.bench": ("rerun", "tyro", "rich", "open3d", "cv2", "sklearn", "threadpoolctl"),
}


def modules() -> dict[str, Path]:
    """Every module of the packages that users install, and of the studies."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            name = ".".join((package, *path.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__")
            found[name] = path
    return found


@cache
def parsed(path: Path) -> ast.Module:
    """Once, for all that look at the source."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def import_statements(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """All of a file, inside functions and for type checking too. Expressions, which hold none, are passed over."""
    found: list[ast.Import | ast.ImportFrom] = []
    left: list[ast.AST] = [parsed(path)]
    while left:
        node = left.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, part, ())
            left += inner if isinstance(inner, list) else ()
    return tuple(found)


@cache
def imported(path: Path) -> frozenset[str]:
    """The modules that a file imports anywhere, inside functions and for type checking too."""
    names: set[str] = set()
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif node.module is not None:
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return frozenset(names)


@cache
def module_graph() -> dict[str, frozenset[str]]:
    """The modules of ours that each one imports, typing included; a name of a package is one of its `__init__`."""
    known, graph = modules(), {}
    for name, path in known.items():
        targets: set[str] = set()
        for node in import_statements(path):
            if isinstance(node, ast.Import):
                targets.update(alias.name for alias in node.names)
            elif node.module is not None:
                full = [f"{node.module}.{alias.name}" for alias in node.names]
                targets.update(one if one in known else node.module for one in full)
        graph[name] = frozenset(targets & known.keys() - {name})
    return graph


def circles(graph: Mapping[str, Iterable[str]]) -> list[tuple[str, ...]]:
    """The strongly connected components of more than one node, in order."""
    reached = {name: _reached(name, graph) for name in graph}
    found = {tuple(sorted(other for other in far if name in reached[other])) for name, far in reached.items()}
    return sorted(found - {()})


def _reached(name: str, graph: Mapping[str, Iterable[str]]) -> set[str]:
    found: set[str] = set()
    left = [name]
    while left:
        for one in graph[left.pop()]:
            if one not in found:
                found.add(one)
                left.append(one)
    return found


def layer_imports() -> dict[str, set[str]]:
    """What the files of each layer import of other layers: the picture of `tools/layers.py`."""
    graph: dict[str, set[str]] = {name: set() for name in (*LAYERS, "cli")}
    for name, targets in module_graph().items():
        if within(name, "deformscope") and (mine := layer_of(name)) in graph:
            ours = {layer_of(one) for one in targets if within(one, "deformscope")}
            graph[mine] |= ours & graph.keys() - {mine}
    return graph


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


def layer_of(name: str) -> str:
    """The folder that a module of ours is in, or the module itself beside the folders."""
    parts = name.split(".")[1:]
    return ".".join(parts[: 2 if parts[:1] == ["stages"] or parts[:2] == ["page", "server"] else 1])


def test_each_folder_imports_what_it_may() -> None:
    known = modules()
    wrong = []
    for name, path in known.items():
        for target in sorted(imported(path) & set(known)):
            mine, other = layer_of(name), layer_of(target)
            free = mine in ("", "cli", "__main__", other) or other == "stages"
            free = free or not name.startswith("deformscope.") or not target.startswith("deformscope.")
            if not free and other not in LAYERS[mine]:
                wrong.append(f"{name} imports {target}")
    assert wrong == []


def test_circles_are_found() -> None:
    assert circles({"a": "b", "b": "cd", "c": "a", "d": "e", "e": "d", "f": "a"}) == [("a", "b", "c"), ("d", "e")]


def test_no_files_import_each_other() -> None:
    """Typing included: each file can be understood with those alone that it imports."""
    assert circles(module_graph()) == []


def test_there_are_no_cycles() -> None:
    """Each folder can be understood with those alone that it imports. Files know recordings, which know no files."""
    TopologicalSorter(LAYERS).prepare()


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
    children = [f"deformscope.simulators.{engine}_child" for engine in engines]
    assert set(importers) <= {
        "studies.engines.peer_process",
        "studies.mujoco_surprises",
        "studies.newton_surprises",
        *children,
    }


def _prints(script: str, expected: str) -> None:
    """A script runs in a process of its own and prints this alone."""
    # Not installed, the packages are found where pytest found them.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    shown = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=environment
    )
    assert shown.stderr == ""
    assert shown.stdout == expected


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
    _prints(script, "[]\n")


def test_a_command_loads_what_it_needs_as_it_needs_it() -> None:
    script = """
import importlib, sys
from deformscope.cli import COMMANDS
for name in ("record", "verify", "export"):  # what the small installation has
    importlib.import_module(COMMANDS[name].module)
print(sorted({"open3d", "sklearn", "skfem", "matplotlib"} & set(sys.modules)))
for command in COMMANDS.values():
    importlib.import_module(command.module)
heavy = "open3d sklearn scipy.stats matplotlib can mcap rosbags ray".split()
print(sorted(set(heavy) & set(sys.modules)))
"""
    _prints(script, "[]\n[]\n")


@pytest.mark.slow  # what commands load is looked at above
def test_the_small_installation_records_verifies_and_exports(tmp_path: Path) -> None:
    """With all dependencies but those that docs/howto/install.md leaves out."""
    page = (ROOT / "docs" / "howto" / "install.md").read_text(encoding="utf-8")
    lines = re.findall(r"(?m)^pip install ([rp].*)", page)
    typed = {word.strip("'").split("==")[0] for line in lines for word in line.split()}
    built = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    absent = {re.split(r"[=>]", one)[0] for one in built} - typed - {"numpy"}  # which others bring
    assert absent == {"open3d", "scikit-learn", "scikit-fem", "matplotlib"}
    script = f"""
import contextlib, io, pathlib, sys
sys.modules |= dict.fromkeys(["open3d", "sklearn", "skfem", "matplotlib"])
from deformscope.cli import main
made = "{tmp_path}/made.rrd"
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    main(["record", "lab:bench", "--seconds", "0.5", "--record", made])
    ended = [
        pathlib.Path(made).exists(),  # however much a busy machine loses
        main(["verify", "{ROOT}/recordings/rig.rrd"]) == 0,
        main(["export", "{ROOT}/recordings/rig.rrd", "--to", "csv", "--out", "{tmp_path}/csv"]) == 0,
    ]
print(ended)
"""
    _prints(script, "[True, True, True]\n")


def test_version_is_declared_once_and_cited() -> None:
    built = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"]
    assert "version" in built["project"]["dynamic"]
    assert built["tool"]["hatch"]["version"] == {"path": "deformscope/version.py"}
    assert deformscope.__version__ == cited


def test_a_driver_in_a_users_script_loads_nothing_of_ours() -> None:
    script = """
import sys
import deformscope_drivers.dsa, deformscope_drivers.sdh, deformscope_drivers.optoforce, deformscope_drivers.jaco
import deformscope_drivers.webcam, deformscope_drivers.depth_camera
import deformscope_drivers.kuka, deformscope_drivers.manual_arm
import deformscope_drivers.wires, deformscope_drivers.ports
heavy = "rerun warp open3d sklearn scipy cv2 matplotlib skfem pyarrow rich tyro deformscope pytest".split()
print(sorted(set(heavy) & set(sys.modules)))
"""
    _prints(script, "[]\n")
