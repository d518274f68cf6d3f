"""A sweep: one function on many files and settings, each result stored when it is done.

A task is identified by content: the bytes of its file and of the file's ledger, the function with its settings, and the
code of this package. A finished task is not computed again, under any name of the file."""

import hashlib
import importlib
import inspect
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

import deformscope_drivers
from deformscope.config.executor import ExecutorOptions
from deformscope.errors import InputError, printable
from deformscope.executor.local import one_thread as one_thread
from deformscope.executor.local import open_workers
from deformscope.executor.tasks import Journal, TaskOutcome, compute
from deformscope.file_io import make_folder, nearest_file, replacing, resolve
from deformscope.files.result_table import make_table, write_table
from deformscope.files.sources import RECORDING_SUFFIX, natural_key
from deformscope.pictures.figures import distributions_png
from deformscope.pictures.report import Figure, Link, ReportVerdict, Section, Table, html_report
from deformscope.plain import Json, plain
from deformscope.recording.ledger import ledger_path
from deformscope.results.render import HIGH, LOW, cell_text, to_cells
from deformscope.runs.result import LibraryResult
from deformscope.terminal import Progress
from deformscope.version import __version__

ENDINGS = (RECORDING_SUFFIX, ".npz", ".mp4", ".avi", ".mov", ".mkv", ".webm", ".mpg", ".mpeg", ".m4v", ".wmv")
"""Endings of recordings, pair files and videos."""
JOURNAL, RESULTS, OVERVIEW, FILES = "tasks.jsonl", "results.parquet", "index.html", "files"
TYPES = {name: pa.string() for name in ("source", "status", "reason", "key")} | {"seconds": pa.float64()}
VARIED = "vary."
"""Prefix of the names of varied settings in a table of results."""
PANELS, GROUPS, LISTED = 9, 6, 500
"""Quantities whose distribution is drawn, by this number of settings; rows of the overview."""
EXIT_STATUS = "exit_status"
"""Exit status of a command that wrote its JSON but did not end with 0, for example because devices lost frames."""
GREEN, AMBER = "#1b7f4b", "#b3541e"


@dataclass(frozen=True, slots=True)
class Variation:
    """One way to compute a file. settings: the varied ones, by name; argument: argument of the function, besides the
    file

    identity: text of everything that determines the result except the file"""

    settings: Mapping[str, object]
    argument: Any
    identity: str


@dataclass(frozen=True, slots=True)
class SweepTask:
    """source: the file; sent: its content by its name, and its ledger's; files: beginning of the names of its output
    files"""

    key: str
    source: str
    argument: Any
    files: str
    sent: Mapping[str, bytes]
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """How tasks are computed: the flags of `deformscope sweep`."""

    on: ExecutorOptions = field(default_factory=ExecutorOptions)
    workers: int | None = None
    send: bool = False
    limit_s: float | None = None


@dataclass(frozen=True, slots=True, repr=False)
class SweepResult(LibraryResult):
    """Outcome of the tasks. table: one row for each task; computed: how many were computed now; seconds: duration of
    this sweep"""

    folder: Path
    table: pa.Table
    computed: int
    seconds: float

    @property
    def failed(self) -> list[Json]:
        """Tasks without a result, with the reason."""
        rows = self.table.filter(pc.field("status") == "failed")
        names = [name for name in rows.schema.names if name in ("source", "reason") or name.startswith(VARIED)]
        found: list[Json] = rows.select(names).to_pylist()
        return found

    @property
    def marked(self) -> str:
        """Text with the number of commands that gave a result but did not exit with 0; empty if there are none."""
        count = pc.count(self.table[EXIT_STATUS]).as_py() if EXIT_STATUS in self.table.schema.names else 0
        return f", {count} of them with an exit status that is not 0" if count else ""

    def tables(self) -> tuple[Table, ...]:
        failed = self.failed
        rows = [
            ("done", f"{self.table.num_rows - len(failed)} of {self.table.num_rows}{self.marked}"),
            ("computed now", f"{self.computed} in {self.seconds:.1f} s"),
            ("results", str(self.folder / RESULTS)),
            ("overview", str(self.folder / OVERVIEW)),
        ]
        rows += [("failed", f"{one['source']}: {one['reason']}") for one in failed[:10]]
        rows += [("failed", f"and {len(failed) - 10} more")] * (len(failed) > 10)
        return (Table(rows, caption="Sweep"),)

    def as_json(self) -> Json:
        done = self.table.num_rows - len(self.failed)
        found = {"folder": self.folder, "tasks": self.table.num_rows, "done": done, "failed": self.failed}
        return found | {"computed": self.computed, "seconds": self.seconds, "columns": self.table.schema.names}


def sweep_on(
    function: Callable[[SweepTask], Any],
    sources: Sequence[Path | str],
    variations: Sequence[Variation],
    out: Path,
    options: SweepOptions,
    *,
    begin: Callable[[], None] | None = None,
    progress: Progress | None = None,
) -> SweepResult:
    """Compute each source with each variation that was not computed before, and write the outcome of all.

    function: function of a module; returns values of JSON's types Raises InputError without a worker, or for an
    unusable folder; a task that fails is a row with its reason."""
    make_folder(out)
    began, computed, skipped = time.monotonic(), 0, 0
    code = contents_of([Path(__file__).parents[1], Path(deformscope_drivers.__file__).parent])
    plan: list[tuple[str, str]] = []
    with Journal(out / JOURNAL, "the tasks of a sweep", "another folder after --out") as journal:
        known, contents = _known(journal)

        def tasks() -> Iterator[SweepTask]:
            nonlocal skipped
            for given in sources:
                source = str(Path(given).resolve()) if Path(given).exists() else str(given)  # wherever a worker runs
                about = _about(source, contents)
                content = [*code, about["content"], content_of(ledger_path(Path(source)))]
                for variation in variations:
                    key = hashlib.sha256(json.dumps([*content, variation.identity]).encode()).hexdigest()[:32]
                    plan.append((source, key))
                    if key in known:
                        skipped += 1
                    else:
                        known.add(key)
                        yield SweepTask(
                            key=key,
                            source=source,
                            argument=variation.argument,
                            files=str((out / FILES).resolve() / key),
                            sent=_sent(Path(source)) if options.send else {},
                            about=about | {"settings": dict(variation.settings)},
                        )

        try:
            with open_workers(options.on.executor, options.on.address, options.workers, apart=True) as workers:
                coming = compute(workers, function, tasks(), limit_s=options.limit_s, begin=begin)
                total = len(sources) * len(variations)
                for outcome in coming:
                    journal.add(_line(outcome))
                    computed += 1
                    if progress is not None:
                        progress("sweeping", skipped + computed, total)
        finally:  # also what is there where it is broken off
            found = SweepResult(out, _results(journal, plan), computed, time.monotonic() - began)
            write_table(found.table, out / RESULTS)
            with replacing(out / OVERVIEW) as file:
                file.write(_overview(found).encode())
    return found


def content_of(path: Path | str) -> str:
    """The SHA-256 of a file, or of all files in a folder with their names; empty where it cannot be read."""
    try:
        path = resolve(path)
        if not path.is_dir():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        files = [one for one in sorted(path.rglob("*")) if one.is_file() and one.parent.name != "__pycache__"]
        inner = [(str(one.relative_to(path)), content_of(one)) for one in files]
        return hashlib.sha256(json.dumps(inner).encode()).hexdigest()
    except (OSError, ValueError, InputError):
        return ""


def contents_of(named: Iterable[object]) -> list[str]:
    """The contents of settings that name files or folders, which a task reads besides its source."""
    contents = (content_of(one) for one in named if isinstance(one, str | Path) and str(one))
    return [one for one in contents if one]


def _sent(source: Path) -> dict[str, bytes]:
    """The content of a file and of its ledger; nothing where it cannot be read, which its worker says."""
    try:
        sent, ledger = {source.name: source.read_bytes()}, ledger_path(source)
        return sent | ({f"{source.name}.ledger": ledger.read_bytes()} if ledger.exists() else {})
    except OSError:
        return {}


def _about(source: str, contents: Mapping[tuple[str, int, int], str]) -> dict[str, Any]:
    """The journal's description of a source. contents: by name, size and time, of files read before"""
    path = resolve(source)
    size, mtime_ns = (path.stat().st_size, path.stat().st_mtime_ns) if path.is_file() else (-1, -1)
    known = contents.get((source, size, mtime_ns)) if size >= 0 else None
    content = known or content_of(path) or f"unreadable: {source}"
    return {"source": source, "size": size, "mtime_ns": mtime_ns, "content": content}


def _known(journal: Journal) -> tuple[set[str], dict[tuple[str, int, int], str]]:
    """Tasks that are done, and the contents of files, by name, size and time."""
    done, contents = set[str](), dict[tuple[str, int, int], str]()
    for line in journal.lines():
        try:
            contents[line["source"], line["size"], line["mtime_ns"]] = line["content"]
            if "result" in line:
                done.add(line["key"])
        except (TypeError, KeyError) as error:
            hint = "another folder after --out"
            raise InputError("the tasks of a sweep", "another file", hint, journal.path) from error
    return done, contents


def _line(outcome: TaskOutcome[SweepTask, Any]) -> dict[str, Any]:
    task = outcome.item
    line = {"key": task.key, **task.about, "seconds": outcome.seconds, "reasons": outcome.reasons}
    return line if outcome.error is not None else line | {"result": outcome.value}


def _results(journal: Journal, plan: Sequence[tuple[str, str]]) -> pa.Table:
    """A row for each task of the plan, source and key, of which something is known, in the plan's order."""
    wanted, at = {key for _, key in plan}, dict[str, int]()

    def rows() -> Iterator[dict[str, Any]]:
        count = 0
        for line in journal.lines():
            if line["key"] in wanted:
                at[line["key"]] = count  # the last line counts
                count += 1
                found = line.get("result", {})
                row = {"key": line["key"], "status": "done" if "result" in line else "failed"}
                row |= {"reason": line["reasons"][-1] if "result" not in line and line["reasons"] else None}
                row |= {"seconds": line["seconds"], "attempts": len(line["reasons"]) + ("result" in line)}
                row |= {VARIED + name: value for name, value in line["settings"].items()}
                cells = to_cells(found if isinstance(found, dict) else {"result": found})
                yield {**row, **cells, **row}  # what a result calls as the sweep does is in the journal alone

    table = make_table(rows(), TYPES)
    there = [one for one in plan if one[1] in at]
    table = table.take(pa.array([at[key] for _, key in there], pa.int64()))
    sources = pa.array([printable(source) for source, _ in there], pa.string())
    return table.set_column(table.schema.get_field_index("source"), "source", sources)


# The overview ---------------------------------------------------------------------------------------------------------


def _overview(found: SweepResult) -> str:
    table, failed = found.table, found.failed
    varied = [name for name in table.schema.names if name.startswith(VARIED)]
    quantities = _quantities(table)
    done = table.num_rows - len(failed)
    headline = f"{done} of {table.num_rows} tasks are done{found.marked}{f', {len(failed)} failed' if failed else ''}"
    words = (f"deformscope {__version__}; {found.computed} computed in {found.seconds:.1f} s by the last command.",)
    sections = [Section("", [ReportVerdict(headline, words, AMBER if failed else GREEN)])]
    drawn = _distributions(table, quantities, varied)
    if drawn:
        caption = "number of cases by value" + (", by the varied settings" if varied else "")
        sections.append(Section("Distributions", [Figure(distributions_png(drawn), caption)]))
    if failed:
        rows = [
            (_source_link(str(one["source"]), found.folder), *(one[name] for name in varied), one["reason"])
            for one in failed[:LISTED]
        ]
        sections.append(Section("Failed", [Table(rows, ("source", *_short(varied), "reason"))]))
    ends = (name + end for name in quantities for end in (LOW, HIGH))
    names = [*varied, "verdict", *quantities, *ends, "seconds", EXIT_STATUS]
    names = [name for name in names if name in table.schema.names]
    listed = table.filter(pc.field("status") == "done").slice(0, LISTED).to_pylist()
    rows = [(_source_link(one["source"], found.folder), *(cell_text(one[name]) for name in names)) for one in listed]
    shown = f"The first {LISTED}; all are in {RESULTS}." if done > LISTED else f"Also in {RESULTS}."
    sections.append(Section("Results", [shown, Table(rows, ("source", *_short(names)))]))
    return html_report(f"Sweep: {found.folder.name}", sections)


def _quantities(table: pa.Table) -> list[str]:
    """Numbers that differ between the tasks; those with an interval first."""
    ends = (LOW, HIGH)
    names = [
        field.name
        for field in table.schema
        if (pa.types.is_floating(field.type) or pa.types.is_integer(field.type))
        and field.name not in ("seconds", "attempts", EXIT_STATUS)
        and not field.name.startswith((VARIED, "settings."))
        and not (field.name.endswith(ends) and field.name.rpartition("_")[0] in table.schema.names)
        and pc.count_distinct(table[field.name]).as_py() > 1
    ]
    return sorted(names, key=lambda name: name + LOW not in table.schema.names)[:PANELS]


def _distributions(table: pa.Table, names: Sequence[str], varied: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    rows = table.select([*varied, *names]).to_pylist()
    drawn: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        group = ", ".join(f"{short} {row[name]}" for name, short in zip(varied, _short(varied), strict=True))
        for name in names:
            if row[name] is not None and np.isfinite(row[name]):
                groups = drawn.setdefault(name, {})
                groups.setdefault(group if group in groups or len(groups) < GROUPS else "others", []).append(row[name])
    return drawn


def _short(names: Iterable[str]) -> list[str]:
    return [name.removeprefix(VARIED) for name in names]


def _source_link(source: str, folder: Path) -> Link:
    return Link(Path(source).name, quote(os.path.relpath(resolve(source), folder)))


def files_in(folder: Path, out: Path, match: str = "") -> list[Path]:
    """The recordings, pair files and videos in a folder and its subfolders (`in_order`)."""
    if not folder.is_dir():
        came, hint = ("a file", "its folder") if folder.exists() else ("nothing there", nearest_file(folder))
        raise InputError("a folder of recordings, pair files or videos, or a catalog.parquet", came, hint, folder)
    inside = (path for path in folder.rglob("*") if path.suffix.lower() in ENDINGS and path.is_file())
    return in_order((path for path in inside if not path.name.startswith(".")), out, match, folder)


def in_order(paths: Iterable[Path], out: Path, match: str, where: Path) -> list[Path]:
    """The sources in natural order, folder by folder, without the files in OUT. match: names like this alone.

    Raises InputError if there are none."""
    own = out.resolve()
    found = [one for one in paths if (not match or one.match(match)) and own not in one.resolve().parents]
    if not found:
        which = f" like {match}" if match else ""
        raise InputError(f"recordings, pair files or videos{which}", "none", where=where)
    return sorted(found, key=lambda path: (str(path.parent), natural_key(path)))


# Functions of a script ------------------------------------------------------------------------------------------------


def vary(settings: Mapping[str, Sequence[object]]) -> list[dict[str, object]]:
    """Every combination of values."""
    return [dict(zip(settings, values, strict=True)) for values in product(*settings.values())]


def function_variations(
    function: Callable[..., Any], settings: Mapping[str, Sequence[object]], options: Mapping[str, object]
) -> list[Variation]:
    """Ways to call a function of a module, by its name. Raises InputError for a function that a worker would not
    find."""
    module, name = function.__module__, function.__qualname__
    if module == "__main__" or getattr(inspect.getmodule(function), name, None) is not function:
        raise InputError("a function of a module", f"{name} of {module}", "put it into a file that can be imported")
    code = contents_of([getattr(inspect.getmodule(function), "__file__", None)])  # the function as it is today
    found = []
    for varied in vary(settings):
        given = {**options, **varied}
        identity = [module, name, plain(given), code, *contents_of(given.values())]
        found.append(Variation(varied, (module, name, given), json.dumps(identity, sort_keys=True)))
    return found


def call_function(task: SweepTask) -> Any:
    """Call a function with the source, in a worker; returns its result as JSON."""
    module, name, given = task.argument
    function = getattr(importlib.import_module(module), name)
    silent = {"progress": False} if "progress" in inspect.signature(function).parameters else {}
    with at_hand(task) as source:
        found = function(source, **silent | given)
    return found.to_dict() if isinstance(found, LibraryResult) else plain(found)


@contextmanager
def at_hand(task: SweepTask) -> Iterator[str]:
    """The path of a task's source: its place, or the place to which it was sent while this context is open."""
    if not task.sent:
        yield task.source
        return
    with TemporaryDirectory(prefix="deformscope-") as folder:
        for name, content in task.sent.items():
            (Path(folder) / name).write_bytes(content)
        yield str(Path(folder) / Path(task.source).name)
