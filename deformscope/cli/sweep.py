"""`deformscope sweep`: a command on every file of a folder, by many processes or on a Ray cluster, resumable."""

import dataclasses
import importlib
import io
import json
from collections.abc import Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from deformscope import cli, config
from deformscope.cli.common import EXIT_LOSSES, begin_worker, fit_progress, make_folder, show, write_json
from deformscope.config import CommandOptions, SweepConfig
from deformscope.config.flags import Reads
from deformscope.config.options import marks_of
from deformscope.errors import InputError
from deformscope.plain import plain
from deformscope.runs import sweep

KEY = "{key}"


@dataclass(frozen=True, slots=True)
class SweptCommand:
    """A command that a worker runs. options: its flags, read once; None if they contain {key}

    name: name of the command; words: its flags as typed; source: the field of the file
    folder: folder to which relative paths refer"""

    name: str
    words: tuple[str, ...]
    source: str
    options: CommandOptions | None
    folder: str


def run(options: SweepConfig) -> int:
    """Compute missing results, and report the outcome. Returns the exit status."""
    sources = find_sources(options)
    values: dict[str, Sequence[str]] = {}
    for one in options.vary:
        flag, _, listed = one.partition("=")
        values[flag.removeprefix("--")] = listed.split("|" if "|" in listed else ",")
    variations = [_variation(options.command, varied, sources[0]) for varied in sweep.vary(values)]
    if any(one.argument.options is None for one in variations):
        make_folder(options.out / sweep.FILES)
    how = sweep.SweepOptions(options.on, options.workers, options.send, options.limit_s)
    with fit_progress() as progress:
        found = sweep.sweep_on(run_swept, sources, variations, options.out, how, begin=begin_worker, progress=progress)
    show(found)
    write_json(found.to_dict(), options.json)
    return EXIT_LOSSES if found.failed else 0


def find_sources(options: SweepConfig) -> list[Path]:
    """The files to compute. Raises InputError where there are none."""
    if options.source.suffix == ".parquet" or options.where:
        from deformscope.runs.catalog import catalogued_paths

        paths = catalogued_paths(options.source, options.where)
        return sweep.in_order(paths, options.out, options.match, options.source)
    return sweep.files_in(options.source, options.out, options.match)


def _variation(typed: Sequence[str], varied: dict[str, Any], example: Path) -> sweep.Variation:
    """The command with some values. Raises InputError for settings that no file supports."""
    name, words = cli.find_command(list(typed))
    kind = getattr(config, cli.COMMANDS[name].config)
    prog = f"deformscope {name}"
    marks = marks_of(kind)
    fields = [one for one, some in marks.items() if Positional in some and any(isinstance(m, Reads) for m in some)]
    if len(fields) != 1 or name in ("sweep", "catalog"):
        raise InputError("a command with one SOURCE that gives JSON", prog, "calibrate beta, replay, verify...")
    words = [*words, *(word for flag, value in varied.items() for word in (f"--{flag}", value))]
    given = {word.partition("=")[0] for word in words}
    if "--json" in given:
        raise InputError("a command without --json", "one with it", "leave it out: sweep adds it")
    words += ["--json", "-"]
    if "viewer" in kind.__dataclass_fields__ or "output" in kind.__dataclass_fields__:
        words += [] if "--viewer" in given else ["--viewer", "none"]
    options: CommandOptions = cli.parse(kind, [str(example), *words], prog)
    if written := [one for one in options.writes() if not one.path.name.startswith(KEY) or len(one.path.parts) > 1]:
        raise InputError(f"a file for each task after {written[0].flag}", str(written[0].path), f"'{KEY}.rrd'")
    read = [one for one in options.reads() if one != str(example)]
    identity = [name, plain(_with(options, fields[0], "")), *sweep.contents_of(read)]
    ready = None if options.writes() else options
    settings = {flag.replace("-", "_"): _number(value) for flag, value in varied.items()}
    return sweep.Variation(
        settings,
        SweptCommand(name=name, words=tuple(words), source=fields[0], options=ready, folder=str(Path.cwd())),
        json.dumps(identity),
    )


def _number(text: str) -> object:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _with(options: Any, name: str, source: str) -> Any:
    """The options with this file in the field that takes it."""
    before = getattr(options, name)
    return dataclasses.replace(options, **{name: (source,) if isinstance(before, tuple) else type(before)(source)})


def run_swept(task: sweep.SweepTask) -> Any:
    """Run the command on its file, in a worker; returns its JSON."""
    swept: SweptCommand = task.argument
    command = cli.COMMANDS[swept.name]
    out, folder = io.StringIO(), swept.folder if Path(swept.folder).is_dir() else "."
    with chdir(folder), redirect_stdout(out), redirect_stderr(io.StringIO()), sweep.at_hand(task) as source:
        cli.quiet_libraries()
        if swept.options is None:
            for left in Path(task.files).parent.glob(f"{task.key}*"):  # by a worker that was killed
                left.unlink()
            words = [word.replace(KEY, task.files) for word in swept.words]
            options = cli.parse(getattr(config, command.config), [source, *words])
        else:
            options = _with(swept.options, swept.source, source)
        status = cli.run_options(options, getattr(importlib.import_module(command.module), command.function))
    found = json.loads(out.getvalue())
    return {**found, sweep.EXIT_STATUS: status} if status and isinstance(found, dict) else found
