"""What a reader passes who follows a datum through the calls: python tools/walks.py [WALK...] [--files]

Begins at a function with the parameters that carry the datum, and goes into every call that is given it, or a part of
it, as an argument; each function once. What a name is assigned out of the datum carries it too. A call goes where its
name leads: imports, annotations, `self`, or the only method of that name
in what the file imports. Functions that are handed on (`partial`,
executors) are followed as well. Calls that only a run knows (queues, processes, tables of views) end a walk: the next
start of the same walk goes on after them.

stays: visits to a file; files: different ones; returns: visits to a file that was visited before; functions: entered.
"""

import argparse
import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
Function = ast.FunctionDef | ast.AsyncFunctionDef
WALKS: dict[str, tuple[str, ...]] = {
    "pair": ("deformscope/cli/calibrate.py run config",),
    "squeeze": ("deformscope/cli/explore.py squeeze config",),
    "touch": ("deformscope/experiments/explore/explorer.py Explorer.touch touched dent",),
    "trial features": ("deformscope/experiments/squeeze/features.py trial_features frames tracked",),
    "depth frame": (
        "drivers/deformscope_drivers/depth_camera/hosted.py HostedCamera._picture frame",
        "drivers/deformscope_drivers/device.py Device._publish reading",
        "deformscope/experiments/explore/touching_robot.py TouchingRobot.look self",
        "deformscope/session.py run source",
        "deformscope/experiments/explore/explore.py _computed stage inputs",
        "deformscope/experiments/explore/stage_executor.py _compute inputs",
        "deformscope/experiments/explore/explorer.py ExplorationStages.look looked",
        "deformscope/experiments/explore/robot_geometry.py FromFrames.look looked",
        "deformscope/experiments/explore/explorer.py UnseenSurface.look looked",
        "deformscope/recording/recorder.py Recorder._take_step step",
        "deformscope/log/exploration/results.py exploration_views maps",
        "deformscope/log/result_batch.py ResultBatch.show_png self given",
        "deformscope/pictures/exploration.py draw_height axes surface",
    ),
}
"""For each walk: file, function, and the parameters that carry the datum."""


@dataclass
class Module:
    """A file's functions and classes by name, and what its imports mean: (file, name), or (file, "") for a module."""

    defined: dict[str, Function | ast.ClassDef]
    imports: dict[str, tuple[str, str]]


@dataclass(frozen=True)
class Place:
    """A function or class: its file, and its name there (`Class.method`)."""

    file: str
    name: str


@cache
def _file_of(dotted: str) -> str | None:
    path = dotted.replace(".", "/")
    for name in (f"{path}.py", f"{path}/__init__.py", f"drivers/{path}.py", f"drivers/{path}/__init__.py"):
        if (ROOT / name).is_file():
            return name
    return None


@cache
def module(file: str) -> Module:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    defined: dict[str, Function | ast.ClassDef] = {}
    for node in tree.body:
        if isinstance(node, Function | ast.ClassDef):
            defined[node.name] = node
        if isinstance(node, ast.ClassDef):
            defined |= {f"{node.name}.{one.name}": one for one in node.body if isinstance(one, Function)}
    imports: dict[str, tuple[str, str]] = {}
    for one in ast.walk(tree):
        if isinstance(one, ast.ImportFrom) and one.module:
            for alias in one.names:
                if inner := _file_of(f"{one.module}.{alias.name}"):
                    imports[alias.asname or alias.name] = inner, ""
                elif outer := _file_of(one.module):
                    imports[alias.asname or alias.name] = outer, alias.name
    return Module(defined, imports)


def resolved(file: str, name: str) -> Place | None:
    """Where a name of a file leads, through files that only pass it on."""
    while name not in module(file).defined:
        if name not in module(file).imports or not module(file).imports[name][1]:
            return None
        file, name = module(file).imports[name]
    return Place(file, name)


def method(owner: Place | None, name: str) -> Place | None:
    """The method of a class or of its bases."""
    while owner is not None:
        if f"{owner.name}.{name}" in module(owner.file).defined:
            return Place(owner.file, f"{owner.name}.{name}")
        node = module(owner.file).defined[owner.name]
        bases = [one.id for one in node.bases if isinstance(one, ast.Name)] if isinstance(node, ast.ClassDef) else []
        owner = next((place for base in bases if (place := resolved(owner.file, base))), None)
    return None


@cache
def only_method(file: str, name: str) -> Place | None:
    """The method of this name, if one class alone has it in a file and in what it imports."""
    files = sorted({file, *(other for other, _ in module(file).imports.values())})
    found = [Place(one, full) for one in files for full in module(one).defined if full.endswith(f".{name}")]
    return found[0] if len(found) == 1 else None


def annotated(file: str, annotation: ast.expr | None) -> Place | None:
    """The class of ours that an annotation names first."""
    for one in ast.walk(annotation) if annotation is not None else ():
        place = resolved(file, one.id) if isinstance(one, ast.Name) else None
        if place is not None and isinstance(module(place.file).defined[place.name], ast.ClassDef):
            return place
    return None


@cache
def attribute(owner: Place, name: str) -> Place | None:
    """The class of an object's attribute: from the class, or from what `__init__` assigns to it."""
    for one in ast.walk(module(owner.file).defined[owner.name]):
        if isinstance(one, ast.AnnAssign) and name == (
            getattr(one.target, "id", "") or getattr(one.target, "attr", "")
        ):
            return annotated(owner.file, one.annotation)
    start = module(owner.file).defined.get(f"{owner.name}.__init__")
    for one in ast.walk(start) if isinstance(start, Function) else ():
        for target, value in pairs(one) if isinstance(one, ast.Assign) else ():
            if isinstance(target, ast.Attribute) and target.attr == name and isinstance(start, Function):
                return Walk().kind(value, Scope(owner.file, owner, start))
    result = module(owner.file).defined.get(f"{owner.name}.{name}")
    return annotated(owner.file, result.returns) if isinstance(result, Function) else None


def pairs(node: ast.Assign) -> list[tuple[ast.expr, ast.expr]]:
    """What is assigned to what, also of tuples."""
    target, value = node.targets[0], node.value
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        return list(zip(target.elts, value.elts, strict=False))
    return [(one, value) for one in node.targets]


class Scope:
    """A function while it is read: which names carry the datum, and the classes of its names."""

    def __init__(self, file: str, owner: Place | None, node: Function, carrying: set[str] | None = None) -> None:
        self.file, self.owner, self.node, self.carrying = file, owner, node, carrying or set()
        every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        self.kinds = {one.arg: annotated(file, one.annotation) for one in every}
        if owner is not None:
            self.kinds["self"] = owner

    def carries(self, node: ast.AST) -> bool:
        """Whether the datum is in an expression."""
        return any(isinstance(one, ast.Name) and one.id in self.carrying for one in ast.walk(node))

    def is_part(self, node: ast.expr) -> bool:
        """Whether an expression is the datum, or a part of it."""
        while isinstance(node, ast.Attribute | ast.Subscript | ast.Starred):
            node = node.value
        return isinstance(node, ast.Name) and node.id in self.carrying


@dataclass
class Walk:
    """Files in the order in which they are visited, and the functions entered."""

    files: list[str] = field(default_factory=list)
    functions: dict[Place, set[str]] = field(default_factory=dict)

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Stays, files, returns and functions."""
        stays = sum(one != before for before, one in zip(["", *self.files], self.files, strict=False))
        different = len(set(self.files))
        return stays, different, stays - different, len(self.functions)

    def enter(self, place: Place, carrying: set[str]) -> None:
        node = module(place.file).defined[place.name]
        if isinstance(node, ast.ClassDef):
            start = method(place, "__init__")
            self.files.append(place.file)
            if start is not None:
                self.enter(start, carrying)
            return
        if place in self.functions:
            return
        self.functions[place] = carrying
        self.files.append(place.file)
        owner = Place(place.file, place.name.split(".")[0]) if "." in place.name else None
        self.read(node.body, Scope(place.file, owner, node, set(carrying)))

    def read(self, body: list[ast.stmt], scope: Scope) -> None:
        for statement in body:
            self.visit(statement, scope)

    def visit(self, node: ast.AST, scope: Scope) -> None:
        if isinstance(node, ast.Assign | ast.AnnAssign | ast.NamedExpr | ast.For | ast.comprehension | ast.withitem):
            self.assign(node, scope)
        for child in in_order(node) if not isinstance(node, ast.Raise) else ():
            self.visit(child, scope)
        if isinstance(node, ast.Call):
            given = {number: one for number, one in enumerate(node.args) if scope.is_part(one)}
            named = {word.arg: word.value for word in node.keywords if word.arg and scope.is_part(word.value)}
            if given or named:
                self.call(node, scope, set(given), set(named))

    def assign(self, node: ast.AST, scope: Scope) -> None:
        source = getattr(node, "value", None) or getattr(node, "iter", None) or getattr(node, "context_expr", None)
        target = getattr(node, "target", None) or getattr(node, "optional_vars", None)
        targets = node.targets if isinstance(node, ast.Assign) else [target] if target is not None else []
        if source is None:
            return
        for one in (name for each in targets for name in ast.walk(each) if isinstance(name, ast.Name)):
            if scope.carries(source) and one.id != "self":
                scope.carrying.add(one.id)
        if len(targets) == 1 and isinstance(targets[0], ast.Name) and not isinstance(node, ast.For | ast.comprehension):
            scope.kinds[targets[0].id] = self.kind(source, scope)

    def call(self, node: ast.Call, scope: Scope, given: set[int], named: set[str]) -> None:
        for one in (*node.args, *(word.value for word in node.keywords)):  # functions handed on
            handed = self.callee(one, scope) if isinstance(one, ast.Name | ast.Attribute) else None
            if handed is not None and isinstance(module(handed.file).defined[handed.name], Function):
                self.enter(handed, set(names(handed)))
        callee = self.callee(node.func, scope)
        if callee is not None:
            places = names(callee)
            self.enter(callee, named | {places[min(one, len(places) - 1)] for one in given if places})

    def callee(self, func: ast.expr, scope: Scope) -> Place | None:
        if isinstance(func, ast.Name):
            return resolved(scope.file, func.id)
        if not isinstance(func, ast.Attribute):
            return None
        if isinstance(func.value, ast.Name) and func.value.id in module(scope.file).imports:
            file, name = module(scope.file).imports[func.value.id]
            if not name:
                return resolved(file, func.attr)
        owner = self.kind(func.value, scope)
        if owner is not None:
            return method(owner, func.attr)
        return only_method(scope.file, func.attr)

    def kind(self, node: ast.expr, scope: Scope) -> Place | None:
        """The class of ours of an expression."""
        if isinstance(node, ast.Name):
            if node.id in scope.kinds:
                return scope.kinds[node.id]
            place = resolved(scope.file, node.id)
            return place if place and isinstance(module(place.file).defined[place.name], ast.ClassDef) else None
        if isinstance(node, ast.Attribute):
            owner = self.kind(node.value, scope)
            return attribute(owner, node.attr) if owner is not None else None
        if isinstance(node, ast.Call):
            place = self.callee(node.func, scope)
            called = module(place.file).defined[place.name] if place is not None else None
            return annotated(place.file, called.returns) if place and isinstance(called, Function) else place
        return None


def names(place: Place) -> list[str]:
    """A function's or class's parameters by position; the last takes the others where it is variable."""
    node = module(place.file).defined[place.name]
    if isinstance(node, ast.ClassDef):
        start = method(place, "__init__")
        return names(start) if start is not None else []
    more = [node.args.vararg] if node.args.vararg is not None else []
    every = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *more)]
    return every[1:] if every[:1] in (["self"], ["cls"]) else every


def in_order(node: ast.AST) -> Iterator[ast.AST]:
    """Children, as they are evaluated: generators of a comprehension before its element."""
    inner = [one for one in ast.iter_child_nodes(node) if isinstance(one, ast.comprehension)]
    yield from inner
    yield from (one for one in ast.iter_child_nodes(node) if one not in inner)


def walked(name: str) -> Walk:
    """A walk from all its starts."""
    walk = Walk()
    for words in WALKS.get(name, (name,)):
        file, function, *carrying = words.split()
        assert function in module(file).defined, f"{words}: no such function"
        walk.enter(Place(file, function), set(carrying))
    return walk


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walks", nargs="*", help=f"{', '.join(WALKS)}, or 'FILE FUNCTION PARAMETER...'")
    parser.add_argument("--files", action="store_true", help="list the files")
    options = parser.parse_args()
    print(f"{'':<16}{'stays':>7}{'files':>7}{'returns':>9}{'functions':>11}")
    for name in options.walks or WALKS:
        walk = walked(name)
        stays, files, returns, functions = walk.counts
        print(f"{name:<16}{stays:>7}{files:>7}{returns:>9}{functions:>11}")
        if options.files:
            print("\n".join(f"    {file}" for file in dict.fromkeys(walk.files)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
