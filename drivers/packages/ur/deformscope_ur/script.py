"""A reading of URScript, for the simulated controller: as much of the language as a program of velocities needs.

It is Python but for `end` behind a block, `local` and `global`. A program is parsed as Python after these are replaced,
and refused unless it has nothing but numbers, lists, names, operators, `if`, `while`, and calls of known functions.
What takes cycles of the controller (`speedj`, `stopj`) is yielded."""

import ast
import math
import re
from collections.abc import Callable, Generator, Mapping
from typing import Any

Step = tuple[Any, ...]
"""A function that takes time: its name and its arguments."""
_KNOWN = """Module FunctionDef arguments Assign While If Expr Call Name Constant List Tuple Subscript Compare BoolOp
BinOp UnaryOp Yield Return Pass Load Store Add Sub Mult Div USub UAdd Not And Or Eq NotEq Lt LtE Gt GtE"""
"""What a program may have, as Python calls it."""


class ScriptError(Exception):
    """A program that the controller does not run, and why."""


def norm(value: Any) -> float:
    """URScript's norm: the length of a list, the magnitude of a number."""
    return math.hypot(*value) if isinstance(value, list) else abs(value)


class Program:
    """A program that calls functions of the controller. Raises ScriptError for a text that it cannot read"""

    def __init__(self, text: str, functions: Mapping[str, Callable[..., Any]]) -> None:
        self._functions = {"norm": norm, **functions}
        try:
            tree = ast.parse(_as_python(text))
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise ScriptError(f"syntax error: {error}") from error
        match tree.body:
            case [ast.FunctionDef(name=name, args=ast.arguments(args=[]))]:
                self._name = name
            case _:
                raise ScriptError("expected one function without arguments")
        for node in ast.walk(tree):
            self._check(node)
        self._code = compile(tree, "URScript", "exec")

    def run(self) -> Generator[Step, None, None]:
        """The program's steps. Raises ScriptError where a line fails."""
        names: dict[str, Any] = {"__builtins__": {}, **self._functions}
        exec(self._code, names)  # no more than `_check` lets through
        try:
            yield from names[self._name]()
        except (ArithmeticError, LookupError, TypeError, ValueError, NameError) as error:
            raise ScriptError(str(error)) from error

    def _check(self, node: ast.AST) -> None:
        if type(node).__name__ not in _KNOWN.split():
            raise ScriptError(f"{type(node).__name__} is not known here")
        if isinstance(node, ast.Name) and node.id.startswith("_"):
            raise ScriptError(f"{node.id} is not a name")
        if isinstance(node, ast.Call) and (node.keywords or ast.unparse(node.func) not in self._functions):
            raise ScriptError(f"{ast.unparse(node)} calls nothing that is known")
        if isinstance(node, ast.While) and not any(isinstance(one, ast.Yield) for one in ast.walk(node)):
            raise ScriptError("an infinite loop: nothing in it takes time")


def _as_python(text: str) -> str:
    """The same program with Python's blocks."""
    lines, depth = [], 0
    for line in text.splitlines():
        words = re.sub(r"^(local|global)\s+", "", line.partition("#")[0].strip())
        if words == "end":
            depth -= 1
        elif words:
            back = words.startswith(("elif ", "else:"))
            lines.append("  " * (depth - back) + re.sub(r"^(speedj|stopj)\((.*)\)$", r"yield ('\1', \2)", words))
            depth += words.endswith(":") - back
    if depth:
        raise ScriptError("an `end` is missing")
    return "\n".join(lines) + "\n"
