"""Every interval that a result declares has a count behind it, or is called an estimate where it is shown."""

import ast
import contextlib
import dataclasses
import importlib
import inspect
import pkgutil
import re
import sys
import textwrap
from pathlib import Path

import numpy as np

from deformscope import runs, stages
from deformscope.results.render import format_value, quantities
from deformscope.stages.map.exploration import InclusionsResult, MapRegion
from studies.__main__ import summaries

DOC = Path(__file__).parents[1] / "docs" / "results" / "coverage.md"
HEADING = "## Which study counts each interval"


def written_hints(kind: type) -> dict[str, str]:
    """Types of a class's fields and properties as they are written: an evaluated alias has lost its name."""
    hints = {}
    for node in ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body:  # type: ignore[attr-defined]
        if isinstance(node, ast.AnnAssign):
            hints[ast.unparse(node.target)] = ast.unparse(node.annotation)
        elif isinstance(node, ast.FunctionDef) and isinstance(vars(kind).get(node.name), property) and node.returns:
            hints[node.name] = ast.unparse(node.returns)
    return hints


def with_ends() -> set[str]:
    """`Class.name` of all that has two ends: fields and properties of results that are called intervals, or that hold a
    value with one. The laboratory's own and what only carries a result on are left out."""
    for package in (stages, runs):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            with contextlib.suppress(ImportError):  # an optional package is not there
                importlib.import_module(module.name)
    found = set()
    modules = [one for name, one in sys.modules.items() if name.startswith(("deformscope.stages", "deformscope.runs"))]
    for kind in {kind for module in modules for kind in vars(module).values() if dataclasses.is_dataclass(kind)}:
        if not isinstance(kind, type) or not kind.__module__.startswith(("deformscope.stages", "deformscope.runs")):
            continue
        hints = written_hints(kind)
        declared = {one.name: one for one in quantities(kind)}
        for name, hint in hints.items():
            one = declared.get(name)
            ends = one is not None and (one.interval or one.interval_key)
            if ends or "interval" in name or re.search(r"Estimated|Interval\b|tuple\[float, tuple\[float, float", hint):
                found.add(f"{kind.__name__}.{name}")
    return found


def table() -> dict[str, tuple[str, str]]:
    """Command and row by `Class.quantity`, of the table in the documentation."""
    text = DOC.read_text(encoding="utf-8").split(HEADING)[1].split("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| `")
    ]
    return {name: (command, where) for names, command, where in rows for name in re.findall(r"`([\w.]+)`", names)}


def test_every_interval_is_in_the_table_and_the_table_names_no_other() -> None:
    found = with_ends()
    assert len(found) > 20
    assert found == set(table())


def test_each_has_a_study_that_is_there_or_is_called_an_estimate() -> None:
    root, known = DOC.parents[2], summaries()
    for name, (command, where) in table().items():
        if command == "open":
            continue
        if command == "estimate":
            assert where, name
            continue
        study = re.search(r"`(?:python -m studies ((?:reproduce )?\w+)|(?:deformscope|pytest) [\w ./]+)`", command)
        assert study, (name, command)
        assert study[1] is None or study[1] in known, (name, command)
        page, words = re.match(r"(\S+\.md): (.+)", where).groups()  # type: ignore[union-attr]
        assert words in (root / "docs" / page).read_text(encoding="utf-8"), (name, where)


def test_nothing_is_added_to_what_is_not_counted() -> None:
    assert sum(command == "open" for command, _ in table().values()) <= 17


def test_what_is_not_counted_is_shown_as_an_estimate() -> None:
    region = MapRegion(0.5, np.array([0.4, 0.6]), 50e3, np.array([40e3, 60e3]), False)
    assert format_value(region, "modulus_pa") == "about 50 kPa"
    each = np.array([[0.1, 0.1, 0.02, 0.03]])
    lumps = InclusionsResult(
        centre_m=each[:, :2],
        within_m=each[:, 2],
        radius_m=each[:, 2],
        radius_interval_m=each[:, 2:] * [0.8, 1.3],
        stiff=np.array([True]),
        probability=np.array([0.9]),
        depth=("deep",),
        covered=np.zeros((2, 2)),
        cell_m=0.01,
        size_m=np.array([0.01, 0.02]),
        missed=np.array([0.2, 0.14]),
        smallest_m=0.02,
        missed_smallest=0.14,
        prior=0.5,
        contrast=3.0,
        deepest_m=0.03,
        deep_m=0.02,
        scatter=0.05,
        contacts_m=np.zeros((3, 2)),
    )
    words = dict(lumps.rows)
    assert "radius about 2.0 cm," in words["inclusion 1"]
    assert " to " not in words["inclusion 1"].split("radius")[1].split(",")[0]
    assert "chance about 0.14" in words["an inclusion missed"]
