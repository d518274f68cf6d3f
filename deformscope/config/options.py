"""What every command's options can be asked, what most commands leave behind, and what annotations say of a flag."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, TypeVar, get_args, get_origin, get_type_hints

from deformscope.config import flags
from deformscope.errors import InputError

MarkT = TypeVar("MarkT")


@dataclass(frozen=True, slots=True)
class Written:
    """A file that a command will write.

    flag: the flag that names it; replace: whether a file that is there already may go
    """

    flag: str
    path: Path
    replace: bool = True


def marks_of(kind: type) -> dict[str, tuple[object, ...]]:
    """What the annotation of each field says beside its type."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}


def flags_of(kind: type) -> dict[str, str]:
    """The flag of each field: as `arg(name=...)` in its annotation has it, else as the field is called."""
    names = {name: [getattr(mark, "name", None) for mark in marks] for name, marks in marks_of(kind).items()}
    return {name: "--" + (next(filter(None, said), None) or name.replace("_", "-")) for name, said in names.items()}


class Flags:
    """Flags: each value is checked as its annotation wants it, then together by `check`."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for flag, value, rule in self._marked(flags.Rule, inner=False):
            rule.check(flag, value)
        self.check()

    def check(self) -> None:
        """Raises InputError for values that do not go together."""

    @classmethod
    def of(cls, **given: Any) -> Self:
        """Options out of a script's arguments by name, each in its group of flags. Paths may be words, tuples any
        sequences. Raises TypeError for other names."""
        own: dict[str, Any] = {}
        hints = get_type_hints(cls)
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]  # all that derive from it are dataclasses
            name, group = field.name, field.default_factory
            if isinstance(group, type) and issubclass(group, Flags):
                own[name] = group.of(**{one: given.pop(one) for one in marks_of(group).keys() & given.keys()})
            elif name in given:
                kinds, value = (hints[name], *get_args(hints[name])), given.pop(name)
                choices = next((get_args(kind) for kind in kinds if get_origin(kind) is Literal), ())
                if choices and value is not None and value not in choices:
                    expected = f"a {flags_of(cls)[name]} out of {', '.join(map(str, choices))}"
                    raise InputError(expected, repr(value))
                convert = Path if Path in kinds else tuple if any(get_origin(kind) is tuple for kind in kinds) else None
                own[name] = value if value is None or convert is None else convert(value)
        if given:
            raise TypeError(f"unexpected options: {', '.join(sorted(given))}")
        return cls(**own)

    def shared(self, kind: type) -> dict[str, Any]:
        """The values of the fields that another class of options has too, by name."""
        names = {one.name for one in dataclasses.fields(kind)}
        return {name: getattr(self, name) for name in marks_of(type(self)).keys() & names}

    def reads(self) -> tuple[str, ...]:
        """The sources, none of which may be written over."""
        found = (value if isinstance(value, tuple) else (value,) for _, value, _ in self._marked(flags.Reads))
        return tuple(str(one) for some in found for one in some if str(one))

    def writes(self) -> tuple[Written, ...]:
        """The files to come; all are checked before any heavy work."""
        overwrite = getattr(getattr(self, "output", self), "overwrite", False)
        found = ((flag, value, mark) for flag, value, mark in self._marked(flags.Writes) if value != "-")
        return tuple(Written(flag, Path(value), overwrite or not mark.kept) for flag, value, mark in found)

    def _marked(self, kind: type[MarkT], *, inner: bool = True) -> Iterator[tuple[str, Any, MarkT]]:
        """Flag, value and mark of each field with a value and a mark of this kind; inner: of groups of flags too"""
        marks, named = marks_of(type(self)), flags_of(type(self))
        for field in dataclasses.fields(self):  # type: ignore[arg-type]  # all that derive from it are dataclasses
            value = getattr(self, field.name)
            if inner and isinstance(value, Flags):
                yield from value._marked(kind)
            for mark in marks[field.name] if value is not None else ():
                if isinstance(mark, kind):
                    yield named[field.name], value, mark


class CommandOptions(Flags):
    """What the command line asks of any command's options before it runs the command."""

    __slots__ = ()

    def json_target(self) -> str | None:
        """Where the JSON goes: a path, `-` for stdout, None for nowhere."""
        target: str | None = getattr(getattr(self, "output", self), "json", None)
        return target


@dataclass(frozen=True, slots=True)
class ViewOptions(Flags):
    """What is left behind and what is shown."""

    json: flags.JsonFlag = None
    """Write the result as JSON; with -, stdout is the JSON alone. An existing file is replaced."""
    record: flags.FileKept = None
    """Write a rerun recording (.rrd). Without it nothing is recorded; `record` alone then takes a new name in runs/."""
    viewer: Literal["auto", "native", "page", "none"] = "auto"
    """Show every stage live: in rerun's window (stays when the command has ended), on a web page (ends with it, at a
    terminal with Ctrl-C), or not at all; auto: the window where there is a display. A page answers to the address alone
    that is printed. A window opens a port on 127.0.0.1 that asks for no password: other users of this machine, and by
    DNS rebinding web sites in its browsers, can read all that is shown, and steer it (open files, take pictures)."""
    overwrite: bool = False
    """Replace a recording that exists; without it an existing one is refused."""


@dataclass(frozen=True, slots=True)
class OutputOptions(ViewOptions):
    """The same of what draws random numbers."""

    seed: flags.SeedFlag = 0
    """Seed of every random number."""


class RecordedOptions(CommandOptions):
    """A command that computes: it leaves JSON and a recording, and can be watched."""

    __slots__ = ()
    output: ViewOptions


def either(first: str, second: str, *given: object) -> None:
    """Raises InputError where both flags are given."""
    if all(given):
        raise InputError(f"{first} or {second}", "both", "leave one out")
