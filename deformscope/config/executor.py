"""Who computes many cases, and the flags of sweeps and catalogs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.options import CommandOptions, Flags
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class ExecutorOptions(Flags):
    """Who computes the cases."""

    executor: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster that runs already, with this version on all nodes
    (deformscope[ray]). Its statistics of use are turned off."""
    address: Annotated[str | None, flags.one_word("ADDRESS", str), flags.unset] = None
    """Of the Ray cluster: HOST:PORT where this machine is a node of it, ray://HOST:PORT otherwise."""

    def check(self) -> None:
        if self.executor == "ray" and self.address is None:
            raise InputError("the --address of a Ray cluster", "none", "as `ray start --head` names it")
        if self.executor == "local" and self.address is not None:
            raise InputError("--executor ray with --address", "--executor local", "leave --address out")


WhereFlag = Annotated[str, arg(metavar="CONDITION")]


@dataclass(frozen=True, slots=True)
class SweepConfig(CommandOptions):
    """Run a command on every recording, pair file and video of a folder, and keep each result as it comes. The same
    line again goes on where it was cut off, and tries again what failed; files that were computed before are known by
    their content. Ctrl-C leaves what is done."""

    source: Annotated[Path, Positional, arg(metavar="DIR|CATALOG"), flags.Reads()]
    """A folder, with those in it, or the catalog.parquet that `deformscope catalog` made."""
    command: Annotated[tuple[str, ...], Positional, arg(metavar="-- COMMAND...", help_behavior_hint="")] = ()
    """After --: a command with its flags, as it is typed, without the SOURCE. It needs --json, which it is given. In
    names of files that it writes, {key} stands for a name of its own for each task, in OUT/files."""
    out: flags.Folder = Path("runs/sweep")
    """Folder of the results: tasks.jsonl (each result whole), results.parquet (a row a task), index.html."""
    vary: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="FLAG=VALUE,VALUE...", help_behavior_hint="(repeatable)")
    ] = ()
    """Run it with each of these values of a flag: cluster-size=3,4,5. Values that hold commas have | between them.
    Several: every combination."""
    match: Annotated[str, arg(metavar="GLOB")] = ""
    """Files whose names are like this alone: '*.npz'."""
    where: WhereFlag = ""
    """Recordings alone for which this holds in the catalog: 'verdict == "identified" and not damaged'."""
    send: bool = False
    """Send each file to its worker, instead of its path: for nodes that share no disk."""
    limit_s: flags.PositiveFlag = None
    """Give up a task that takes longer than this [s]; a worker that begins with it takes some seconds for that."""
    workers: flags.SomeFlag = None
    """Tasks at once; default: the cores of this machine, or of the cluster."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    json: flags.JsonFlag = None
    """Write what became of it as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if not self.command:
            raise InputError("a command after --", "none", "deformscope sweep DIR --out FOLDER -- calibrate beta")
        for one in self.vary:
            if not one.partition("=")[0] or not one.partition("=")[2]:
                raise InputError("FLAG=VALUE,VALUE after --vary", repr(one), "--vary cluster-size=3,4,5")


@dataclass(frozen=True, slots=True)
class CatalogConfig(CommandOptions):
    """List the recordings of a folder: what made them, how long they are, what they found, what was lost, and which are
    damaged. The index is DIR/catalog.parquet, which any tool can read; files whose size and time stay are not read
    again. `deformscope catalog compare A B` says how two differ."""

    folder: Annotated[Path, Positional, arg(metavar="DIR"), flags.Reads()]
    """A folder, with those in it."""
    where: WhereFlag = ""
    """Those alone for which this holds: 'stiffness < 0.5 and verdict == "identified"'. Columns are listed with --json;
    the end of a name does where it is of one alone."""
    sort: Annotated[str, arg(metavar="KEY")] = ""
    """By this column; --sort=-KEY: the largest first."""
    columns: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """Columns to show; default: those that say most."""
    page: bool = False
    """Write DIR/catalog.html too: with a picture of each recording, which opens it."""
    serve: bool = False
    """Serve that page to browsers of this machine, at a terminal until Ctrl-C: a click plays the recording."""
    workers: flags.SomeFlag = None
    """Processes that read recordings; default: the cores of this machine."""
    json: flags.JsonFlag = None
    """Write the rows with all their columns as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class CompareConfig(CommandOptions):
    """How two recordings differ: in settings, in results with their intervals, and in what their devices measured,
    both from their first contact on."""

    first: flags.RecordingFlag
    """A recording (.rrd)."""
    second: flags.RecordingFlag
    """Another."""
    json: flags.JsonFlag = None
    """Write the differences as JSON; with -, stdout is the JSON alone."""
