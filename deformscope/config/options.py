"""Methods that all options have, options of most commands, and the meaning of annotations."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, Self, TypeVar, get_args, get_origin, get_type_hints

from tyro.constructors import PrimitiveConstructorSpec

from deformscope.config import flags
from deformscope.errors import InputError

MarkT = TypeVar("MarkT")


@dataclass(frozen=True, slots=True)
class Written:
    """An output file of a command.

    flag: the flag of its name; replace: whether an existing file may be replaced"""

    flag: str
    path: Path
    replace: bool = True


def marks_of(kind: type) -> dict[str, tuple[object, ...]]:
    """The marks in the annotation of each field, besides its type."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}


def flags_of(kind: type) -> dict[str, str]:
    """The flag of each field: `arg(name=...)` of its annotation, else the field's name."""
    names = {name: [getattr(mark, "name", None) for mark in marks] for name, marks in marks_of(kind).items()}
    return {name: "--" + (next(filter(None, said), None) or name.replace("_", "-")) for name, said in names.items()}


class Flags:
    """Flags: each value is checked by its annotation, then all together by `check`."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for flag, value, rule in self._marked(flags.Rule, inner=False):
            rule.check(flag, value)
        self.check()

    def check(self) -> None:
        """Raises InputError for values that exclude each other."""

    @classmethod
    def of(cls, **given: Any) -> Self:
        """Makes options from a script's arguments by name, each in its group of flags. Paths may be strings, tuples may
        be any sequences, and a value with its own form on the command line may be that text. Raises TypeError for
        unknown names."""
        own: dict[str, Any] = {}
        hints, marks, named, names = get_type_hints(cls), marks_of(cls), flags_of(cls), cls.option_names()
        known = [*names]
        given = {names.get(name, name): value for name, value in given.items()}
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]  # all that derive from it are dataclasses
            name, group = field.name, field.default_factory
            if isinstance(group, type) and issubclass(group, Flags):
                known += group.option_names()
                own[name] = group.of(**{one: given.pop(one) for one in group.option_names().keys() & given.keys()})
            elif name in given:
                value = given.pop(name)
                typed = next((mark for mark in marks[name] if isinstance(mark, PrimitiveConstructorSpec)), None)
                own[name] = value if value is None else _converted(named[name], hints[name], typed, value)
        if given:
            near = sorted({close for one in given for close in get_close_matches(one, known, 1)})
            hint = f"; near: {', '.join(near)}" if near else ""
            raise TypeError(f"unexpected options: {', '.join(sorted(given))}{hint}")
        return cls(**own)

    @classmethod
    def option_names(cls) -> dict[str, str]:
        """The field of each name that a script may use: the field's own, or the flag's."""
        return {flag[2:].replace("-", "_"): name for name, flag in flags_of(cls).items()} | {
            name: name for name in marks_of(cls)
        }

    def shared(self, kind: type) -> dict[str, Any]:
        """The values of fields that another class of options has too, by name."""
        names = {one.name for one in dataclasses.fields(kind)}
        return {name: getattr(self, name) for name in marks_of(type(self)).keys() & names}

    def reads(self) -> tuple[str, ...]:
        """The sources, none of which may be overwritten."""
        found = (value if isinstance(value, tuple) else (value,) for _, value, _ in self._marked(flags.Reads))
        return tuple(str(one) for some in found for one in some if str(one))

    def writes(self) -> tuple[Written, ...]:
        """The output files; all are checked before any heavy work."""
        overwrite = getattr(getattr(self, "output", self), "overwrite", False)
        found = ((flag, value, mark) for flag, value, mark in self._marked(flags.Writes) if value != "-")
        return tuple(Written(flag, Path(value), overwrite or mark.replace) for flag, value, mark in found)

    def made(self) -> tuple[tuple[str, Path], ...]:
        """Outputs that the command has written: the flag and path of each file or folder."""
        folders = ((flag, value) for flag, value, _ in self._marked(flags.Makes) if value.is_dir())
        return (*((one.flag, one.path) for one in self.writes() if one.path.is_file()), *folders)

    def _marked(self, kind: type[MarkT], *, inner: bool = True) -> Iterator[tuple[str, Any, MarkT]]:
        """Flag, value and mark of each field with a value and a mark of this kind; inner: also of nested groups of
        flags"""
        marks, named = marks_of(type(self)), flags_of(type(self))
        for field in dataclasses.fields(self):  # type: ignore[arg-type]  # all that derive from it are dataclasses
            value = getattr(self, field.name)
            if inner and isinstance(value, Flags):
                yield from value._marked(kind)
            for mark in marks[field.name] if value is not None else ():
                if isinstance(mark, kind):
                    yield named[field.name], value, mark


def _converted(flag: str, hint: Any, typed: PrimitiveConstructorSpec[Any] | None, value: Any) -> Any:
    """A script's value in its field's type. typed: how it is read from the command line, where it has a form there"""
    kinds = (hint, *get_args(hint))
    choices = next((get_args(kind) for kind in kinds if get_origin(kind) is Literal), ())
    if choices and value not in choices:
        raise InputError(f"a {flag} out of {', '.join(map(str, choices))}", repr(value))
    try:
        if typed is not None:
            return typed.instance_from_str([value] if isinstance(value, str) else typed.str_from_instance(value))
        if any(get_origin(kind) is tuple for kind in kinds):
            return (value,) if isinstance(value, str | Path) else tuple(value)
        read = next((kind for kind in (int, float, Path) if kind in kinds), None)
        return value if read is None or (isinstance(value, int | float) and read is not Path) else read(value)
    except (TypeError, ValueError, AttributeError) as error:
        said = str(error) if isinstance(error, ValueError) and str(error).startswith("expected") else ""
        form = getattr(typed, "metavar", getattr(hint, "__name__", str(hint)))
        raise InputError.about(Exception(f"{flag}: {said or f'expected {form}; got {value!r}'}"), "") from None


class CommandOptions(Flags):
    """Methods that the command line calls on any command's options before it runs the command."""

    __slots__ = ()

    def json_target(self) -> str | None:
        """Where the JSON goes: a path, `-` for stdout, None without JSON."""
        target: str | None = getattr(getattr(self, "output", self), "json", None)
        return target


@dataclass(frozen=True, slots=True)
class ViewOptions(Flags):
    """Output files and viewer."""

    json: flags.JsonFlag = None
    """Write the result as JSON; with -, stdout is the JSON alone. An existing file is replaced."""
    record: flags.RecordFlag = None
    """Write a rerun recording (.rrd). Without this flag only `deformscope record` records, under a new name in
    runs/."""
    viewer: Literal["auto", "native", "page", "none"] = "auto"
    """Show every stage live: in rerun's window (stays open after the command), on a web page (ends with the command, at
    a terminal with Ctrl-C), or not at all; auto: the window if there is a display. The page answers only requests to
    its printed address. The window opens a port on 127.0.0.1 without a password. Other users of this machine, and web
    sites in its browsers by DNS rebinding, can read and control the viewer (open files, take pictures)."""
    overwrite: bool = False
    """Replace an existing recording; without it an existing one is refused."""


@dataclass(frozen=True, slots=True)
class OutputOptions(ViewOptions):
    """Output files and viewer of commands with random numbers."""

    seed: flags.SeedFlag = 0
    """Seed of every random number."""


class RecordedOptions(CommandOptions):
    """A command that computes: it writes JSON and a recording, and has a live view."""

    __slots__ = ()
    output: ViewOptions


def either(first: str, second: str, *given: object) -> None:
    """Raises InputError where both flags are given."""
    if all(given):
        raise InputError(f"{first} or {second}", "both", "leave one out")
