"""Names mean one thing, functions stay short, and numbers that a robot moves by are documented with their source."""

import ast
import re
import runpy
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_imports import PACKAGES, ROOT, parsed

SHARED = {"Decoder", "Reading", "CommandDecoder"}
"""Every byte-stream driver has one of each: the public contract."""

LONGEST_FUNCTION = 100
"""Lines, of a function that is no kernel nor a factory of kernels."""


Trees = dict[Path, ast.Module]


@pytest.fixture(scope="module")
def trees() -> Trees:
    """Every file of both packages, parsed once."""
    return {
        path.relative_to(ROOT): parsed(path) for folder in PACKAGES.values() for path in sorted(folder.rglob("*.py"))
    }


def within(trees: Trees, folder: Path) -> Iterator[tuple[Path, ast.Module]]:
    return ((path, tree) for path, tree in trees.items() if path.is_relative_to(folder.relative_to(ROOT)))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_class_name_stands_for_one_class(package: str, trees: Trees) -> None:
    """Structs of kernels too: a reader who searches for a name finds one place."""
    places: dict[str, list[Path]] = defaultdict(list)
    for path, tree in within(trees, PACKAGES[package]):
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(path)
    assert {name: found for name, found in places.items() if len(found) > 1 and name not in SHARED} == {}


def test_functions_are_short(trees: Trees) -> None:
    long = [
        f"{path}: {node.name} has {length} lines"
        for path, tree in trees.items()
        if not path.stem.endswith(("_kernels", "functions"))
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if (length := (node.end_lineno or node.lineno) - node.lineno + 1) > LONGEST_FUNCTION
    ]
    assert long == []


def test_what_kernel_factories_make_has_names(trees: Trees) -> None:
    """They return one thing whose fields are named where it is made: never a long tuple, nor many unnamed arguments."""
    wrong = []
    for path, tree in within(trees, PACKAGES["deformscope"] / "stages" / "msm"):
        for node in ast.walk(tree):
            value = node.value if isinstance(node, ast.Return) else None
            many = isinstance(value, ast.Tuple) and len(value.elts) > 6
            unnamed = (
                isinstance(value, ast.Call) and len(value.args) > 6 and path.stem.endswith(("_kernels", "functions"))
            )
            if many or (unnamed and isinstance(value, ast.Call) and _made(value)):
                wrong.append(f"{path}:{node.lineno}")
    assert wrong == []


def _made(call: ast.Call) -> bool:
    """Whether it makes a class, by its name."""
    return isinstance(call.func, ast.Name) and call.func.id[:1].isupper()


def test_constants_that_a_robot_moves_by_name_their_source(trees: Trees) -> None:
    """A docstring stands below each: where the number is from, or what was measured."""
    bare = []
    for path, tree in within(trees, PACKAGES["deformscope"] / "robot"):
        for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
            name = _constant(node)
            explained = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if name and not (explained and isinstance(after.value.value, str)):
                bare.append(f"{path}: {name}")
    assert bare == []


def _constant(node: ast.stmt) -> str:
    """The first name of a module's constant that holds numbers; empty for any other statement."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    names = [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
    value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
    numbers = value is not None and any(
        isinstance(one, ast.Constant) and isinstance(one.value, int | float) for one in ast.walk(value)
    )
    return names[0] if numbers and names[0].lstrip("_").isupper() else ""


def test_the_picture_of_the_layers_is_drawn_from_the_whitelist() -> None:
    tool = runpy.run_path(str(ROOT / "tools" / "layers.py"))
    page = (ROOT / "docs" / "developers" / "architecture.md").read_text(encoding="utf-8")
    shown = page.split(tool["BEGIN"])[1].split(tool["END"])[0]
    assert shown == tool["drawing"](), "draw it again: python tools/layers.py --write"


def test_arms_are_known_by_their_declaration_not_by_name() -> None:
    """Any arm's package is used alike: names of arms stand in the laboratory, and in the example of a command."""
    names = re.compile(r"(?<![a-z])(jacos?|kukas?|j2n6s300|kr6r900sixx)(?![a-z])", re.IGNORECASE)
    kept = {ROOT / "deformscope" / "cli" / "examples.py"}
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in sorted((ROOT / "deformscope").rglob("*.py"))
        if path not in kept and "lab" not in path.relative_to(ROOT).parts
        for line in path.read_text(encoding="utf-8").splitlines()
        if names.search(line)
    ]
    assert not found, "\n".join(found)
