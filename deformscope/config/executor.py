"""How many cases are computed in parallel, and the flags of sweeps and catalogs."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.options import CommandOptions, Flags
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class ExecutorOptions(Flags):
    """Where the cases are computed."""

    executor: Literal["local", "ray"] = "local"
    """Processes of this machine, or a running Ray cluster with this version on all nodes (deformscope[ray]). Ray's
    usage statistics are turned off."""
    address: Annotated[str | None, flags.one_word("ADDRESS", str), flags.unset] = None
    """Address of the Ray cluster: HOST:PORT where this machine is a node of it, ray://HOST:PORT otherwise."""

    def check(self) -> None:
        if self.executor == "ray" and self.address is None:
            raise InputError("the --address of a Ray cluster", "none", "as `ray start --head` names it")
        if self.executor == "local" and self.address is not None:
            raise InputError("--executor ray with --address", "--executor local", "leave --address out")


WhereFlag = Annotated[str, arg(metavar="CONDITION")]


@dataclass(frozen=True, slots=True)
class SweepConfig(CommandOptions):
    """Run a command on every recording, pair file and video of a folder, and store each result as soon as it is
    computed. The same command line continues an interrupted sweep and repeats failed tasks; files computed before are
    identified by their content. Ctrl-C preserves finished results."""

    source: Annotated[Path, Positional, arg(metavar="DIR|CATALOG"), flags.Reads()]
    """A folder, with its subfolders, or the catalog.parquet of `deformscope catalog`."""
    command: Annotated[tuple[str, ...], Positional, arg(metavar="-- COMMAND...", help_behavior_hint="")] = ()
    """After --: a command with its flags, as typed, without the SOURCE. The command needs --json, which sweep adds. In
    names of its output files, {key} is replaced by a unique name of the task, in OUT/files."""
    out: flags.Folder = Path("runs/sweep")
    """Folder of the results: tasks.jsonl (each whole result), results.parquet (a row per task), index.html."""
    vary: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="FLAG=VALUE,VALUE...", help_behavior_hint="(repeatable)")
    ] = ()
    """Run the command with each of these values of a flag: cluster-size=3,4,5. | separates values with commas.
    Several flags: every combination."""
    match: Annotated[str, arg(metavar="GLOB")] = ""
    """Only files whose names match this pattern: '*.npz'."""
    where: WhereFlag = ""
    """Only recordings whose row in the catalog satisfies this: 'verdict == "identified" and not damaged'."""
    send: bool = False
    """Send each file to its worker instead of its path: for nodes without a shared disk."""
    limit_s: flags.PositiveFlag = None
    """Abandon a task that takes longer than this [s]; the start of a worker takes some seconds of it."""
    workers: flags.SomeFlag = None
    """Number of parallel tasks; default: the cores of this machine, or of the cluster."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    json: flags.JsonFlag = None
    """Write the outcome as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if not self.command:
            raise InputError("a command after --", "none", "deformscope sweep DIR --out FOLDER -- calibrate beta")
        for one in self.vary:
            if not one.partition("=")[0] or not one.partition("=")[2]:
                raise InputError("FLAG=VALUE,VALUE after --vary", repr(one), "--vary cluster-size=3,4,5")


@dataclass(frozen=True, slots=True)
class CatalogConfig(CommandOptions):
    """List the recordings of a folder: command, duration, results, losses, and damage. The index is
    DIR/catalog.parquet, which any tool can read; files with the same size and time are not read again. `deformscope
    catalog compare A B` compares two recordings."""

    folder: Annotated[Path, Positional, arg(metavar="DIR"), flags.Reads()]
    """A folder, with its subfolders."""
    where: WhereFlag = ""
    """Only recordings that satisfy this: 'stiffness < 0.5 and verdict == "identified"'. --json lists the columns; the
    end of a column's name is enough if it is unique."""
    sort: Annotated[str, arg(metavar="KEY")] = ""
    """Sort by this column; --sort=-KEY: largest first."""
    columns: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """Columns to show; default: the main ones."""
    page: bool = False
    """Write DIR/catalog.html too: a picture of each recording, with a link that opens it."""
    serve: bool = False
    """Serve that page to browsers of this machine until Ctrl-C: a click plays the recording."""
    workers: flags.SomeFlag = None
    """Number of processes that read recordings; default: the cores of this machine."""
    json: flags.JsonFlag = None
    """Write the rows with all their columns as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class CompareConfig(CommandOptions):
    """Compare two recordings: settings, results with their intervals, and measurements of their devices, both from the
    first contact on."""

    first: flags.RecordingFlag
    """A recording (.rrd)."""
    second: flags.RecordingFlag
    """The other recording."""
    corrected: bool = False
    """Take the certified bias of each rig out of its moduli and stiffnesses (`deformscope certify`)."""
    json: flags.JsonFlag = None
    """Write the differences as JSON; with -, stdout is the JSON alone."""
