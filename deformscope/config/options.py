"""What every command's options can be asked, what most commands leave behind, and what several commands check."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deformscope.config.flags import FileFlag, JsonFlag, Span
from deformscope.errors import InputError

# What several commands check -----------------------------------------------------------------------------------------


def check_sources(sources: tuple[str, ...]) -> None:
    if not sources:
        raise InputError("at least one SOURCE", "none", "a video, a folder of frames, images, or pair files (.npz)")


def check_unit(flag: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise InputError(f"a {flag} between 0 and 1", str(value))


BETA_LIMIT = 0.9999
"""Highest beta that can be searched (`deformscope.stages.fit.calibrate.BETA_LIMIT`, which would import numpy here)."""


def check_span(flag: str, span: Span, limit: float = 1.0) -> None:
    lowest, highest = span
    if not lowest < highest:
        raise InputError(f"a {flag} that rises", f"{lowest:g},{highest:g}", f"{flag} {highest:g},{lowest:g}")
    if lowest < 0 or highest > limit:  # neither is NaN: `finite` has seen to that
        raise InputError(f"a {flag} within 0,{limit:g}", f"{lowest:g},{highest:g}")


def check_alpha(alpha: float) -> None:
    if not 0 < alpha <= 1:
        raise InputError("an --alpha above 0 and at most 1", str(alpha))


def check_cluster_size(size: int | None) -> None:
    if size is not None and size < 2:
        raise InputError("a --cluster-size of 2 or more", str(size))


def check_level(level: float) -> None:
    if not 0 < level < 1:
        raise InputError("a --level between 0 and 1", str(level), "--level 0.9")


def check_seed(seed: int) -> None:
    if seed < 0:
        raise InputError("a --seed of 0 or more", str(seed))


def check_suffix(flag: str, path: Path | None, suffix: str) -> None:
    if path is not None and path.suffix != suffix:
        raise InputError(f"a file that ends in {suffix} after {flag}", repr(str(path)))


# What every command's options can be asked ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Written:
    """A file that a command will write.

    flag: the flag that names it; replace: whether a file that is there already may go
    """

    flag: str
    path: Path
    replace: bool = True


class CommandOptions:
    """What the command line asks of any command's options before it runs the command."""

    __slots__ = ()

    def reads(self) -> tuple[str, ...]:
        """The sources, none of which may be written over."""
        return ()

    def writes(self) -> tuple[Written, ...]:
        """The files to come; all are checked before any heavy work."""
        return ()

    def json_target(self) -> str | None:
        """Where the JSON goes: a path, `-` for stdout, None for nowhere."""
        return None


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """What is left behind and what is shown."""

    json: JsonFlag = None
    """Write the result as JSON; with -, stdout is the JSON alone. An existing file is replaced."""
    record: FileFlag = None
    """Write a rerun recording (.rrd). Without it nothing is recorded."""
    viewer: Literal["auto", "native", "page", "none"] = "auto"
    """Show every stage live: in rerun's window (stays when the command has ended), on a web page (ends with it, at a
    terminal with Ctrl-C), or not at all; auto: the window where there is a display. A window or page opens a port on
    127.0.0.1 that asks for no password: other users of this machine, and by DNS rebinding web sites in its browsers,
    can read all that is shown, and steer a window (open files, take pictures). On a shared machine: none."""
    overwrite: bool = False
    """Replace a recording that exists; without it an existing one is refused."""

    def __post_init__(self) -> None:
        check_suffix("--record", self.record, ".rrd")

    def writes(self) -> tuple[Written, ...]:
        record = () if self.record is None else (Written("--record", self.record, replace=self.overwrite),)
        return (*record, *written_json(self.json))


@dataclass(frozen=True, slots=True)
class OutputOptions(ViewOptions):
    """The same of what draws random numbers."""

    seed: int = 0
    """Seed of every random number."""

    def __post_init__(self) -> None:
        ViewOptions.__post_init__(self)
        check_seed(self.seed)


class JsonOptions(CommandOptions):
    """A command that leaves its result as JSON, and nothing else unless it says so."""

    __slots__ = ()
    json: str | None

    def writes(self) -> tuple[Written, ...]:
        return written_json(self.json)

    def json_target(self) -> str | None:
        return self.json


class RecordedOptions(CommandOptions):
    """A command that computes: it leaves JSON and a recording, and can be watched."""

    __slots__ = ()
    output: ViewOptions

    def own_files(self) -> tuple[tuple[str, Path | None], ...]:
        """Flag and path of what it writes besides; None where it is not wanted."""
        return ()

    def writes(self) -> tuple[Written, ...]:
        return (*written_files(*self.own_files()), *self.output.writes())

    def json_target(self) -> str | None:
        return self.output.json


def written_files(*named: tuple[str, Path | None]) -> tuple[Written, ...]:
    """named: flag and path, None where the file is not wanted"""
    return tuple(Written(flag, path) for flag, path in named if path is not None)


def written_json(target: str | None) -> tuple[Written, ...]:
    return () if target is None or target == "-" else (Written("--json", Path(target)),)
