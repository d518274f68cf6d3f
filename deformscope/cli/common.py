"""Common output of the commands: text, tables, JSON and files."""

import json
import multiprocessing
import os
import shlex
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from deformscope.errors import InputError, printable
from deformscope.file_io import make_folder as make_folder
from deformscope.file_io import read_file as read_file
from deformscope.file_io import replacing as replacing
from deformscope.pictures.report import Table, table_text
from deformscope.plain import plain
from deformscope.runs.result import open_recorder
from deformscope.runs.result import settings_of as settings_of
from deformscope.stages.msm import quiet
from deformscope.terminal import fit_progress as fit_progress
from deformscope.terminal import is_watched
from deformscope.terminal import say as say
from deformscope.terminal import status_line as status_line

if TYPE_CHECKING:
    from rich.console import Console

    from deformscope.config import RecordedOptions
    from deformscope.config.options import Flags
    from deformscope.log.layout import Application
    from deformscope.recording.recorder import Recorder

EXIT_LOSSES = 3
"""The exit status of a command whose result is complete, but with losses; it names them."""
PAGE_LOOK_S = 0.2
"""Seconds between checks whether a page's server still runs."""

_json_stream: ContextVar[TextIO | None] = ContextVar("json_stream", default=None)
_written: ContextVar[list[tuple[str, Path]] | None] = ContextVar("written", default=None)

CALLED = {"--record": "recording", "--save": "model", "--json": "JSON", "--out": "written"}
"""Name in messages of a flag's file, if that is not the flag's name."""


# Words and tables ----------------------------------------------------------------------------------------------------


def console() -> "Console":
    """The console for progress and remarks: stderr."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def quiet_warp() -> None:
    """Start warp without its greeting; before the first compilation of kernels, print why this start is slow."""
    import warp as wp

    quiet.quiet_warp()
    compiled = any(Path(str(wp.config.kernel_cache_dir)).glob("wp_deformscope_*"))
    if not compiled and is_watched() and multiprocessing.parent_process() is None:
        say("compiling kernels once; later starts use the stored ones")


def begin_worker() -> None:
    """First call in a worker: one thread, and no output."""
    from deformscope.executor.local import one_thread

    quiet_warp()
    one_thread()


def show(*found: object) -> None:
    """Print results as their tables, on stdout; on stderr if `--json -` uses stdout."""
    for one in found:
        print(printable(str(one)), flush=True)


def show_table(title: str, rows: Sequence[tuple[str, str]]) -> None:
    """Print a short table of names and values, as `show` does."""
    show(table_text(Table(rows, caption=title)))


@contextmanager
def recorder_of(
    config: "RecordedOptions", application: "Application | None" = None, *, real_time: bool = False
) -> "Iterator[Recorder]":
    """The recorder and the view of a command, by its flags; remarks on the recording's place.

    The flags are the recording's settings. application: None = that for findings, with views for each command"""
    from deformscope.log.layout import FINDINGS

    settings = settings_of(config)
    of = application or FINDINGS.variant(str(settings["command"]))
    with open_recorder(config.output, settings, of, real_time=real_time) as recorder:
        yield recorder


def at_terminal() -> bool:
    """Whether a person reads stdout and types there."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stdout.isatty()


def keep_page(*, served: bool = False) -> None:
    """A page stays open until Ctrl-C if a command serves it or a person is at a terminal; then its server ends."""
    from deformscope.page.server.page_server import end_pages, running_pages

    if (served or at_terminal()) and (pages := running_pages()):
        with suppress(KeyboardInterrupt):
            say(f"the page stays open until Ctrl-C: {', '.join(page.address for page in pages)}")
            while running_pages():
                time.sleep(PAGE_LOOK_S)
    end_pages()


@contextmanager
def list_written(options: "Flags") -> Iterator[None]:
    """At the end of a command without an error, list the files and folders of its flags, and those reported by `wrote`,
    with the commands that open them."""
    token = _written.set([])
    try:
        yield
        named = [(CALLED.get(flag, flag.removeprefix("--")), path) for flag, path in options.made()]
        own = _written.get() or []
        for what, path in [*((what, path) for what, path in named if path not in [one for _, one in own]), *own]:
            opened = open_command(path)
            say(f"{what}: {path}" + (f"; open it with: {opened}" if opened else ""))
    finally:
        _written.reset(token)


def wrote(what: str, path: Path | str) -> None:
    """Report a file or folder that no flag names, for the list at the end of the command."""
    if (own := _written.get()) is not None:
        own.append((what, Path(path)))


def open_command(path: Path) -> str:
    """The command that shows a file or folder on this user's desktop, empty if there is none. Rerun's viewer is named
    by its path in this Python's folder, unless its name is on the PATH."""
    if path.is_dir():
        path /= "index.html"
    bundled = Path(sys.executable).with_name("rerun")
    viewer = str(bundled) if shutil.which("rerun") is None and bundled.exists() else "rerun"
    if viewer != "rerun" and bundled.is_relative_to(Path.cwd()):
        viewer = str(bundled.relative_to(Path.cwd()))
    browser = "python -m webbrowser"
    known = {".rrd": f"{viewer} --bind 127.0.0.1", ".html": browser, ".png": browser, ".json": "python -m json.tool"}
    return f"{known[path.suffix]} {shlex.quote(str(path))}" if path.suffix in known and path.is_file() else ""


# JSON ----------------------------------------------------------------------------------------------------------------


def write_json(value: object, target: str | None) -> None:
    """Write `value` to a file, or to stdout where `target` is `-`; None writes nothing.

    Frozen dataclasses, arrays, paths, tuples and mappings may be anywhere inside; nan and infinities become null."""
    if target is None:
        return
    text = json.dumps(plain(value), indent=2, allow_nan=False) + "\n"
    if target == "-":
        stream = _json_stream.get() or sys.stdout
        stream.write(text)
        stream.flush()
        return
    write_file(Path(target), text.encode())


@contextmanager
def json_alone(target: str | None) -> Iterator[None]:
    """With `--json -`, stdout carries the JSON and nothing else: all other output goes to stderr, also libraries'."""
    if target != "-":
        yield
        return
    python_stdout = sys.stdout
    try:
        descriptor = python_stdout.fileno()
    except (OSError, AttributeError):  # stdout is no file, as under a test or in a notebook
        with _redirected(python_stdout):
            yield
        return
    python_stdout.flush()
    copy = os.dup(descriptor)
    with os.fdopen(copy, "w", encoding="utf-8") as stream:
        os.dup2(sys.__stderr__.fileno() if sys.__stderr__ is not None else 2, descriptor)
        try:
            with _redirected(stream):
                yield
        finally:
            python_stdout.flush()
            os.dup2(copy, descriptor)


@contextmanager
def _redirected(stream: TextIO) -> Iterator[None]:
    python_stdout, token = sys.stdout, _json_stream.set(stream)
    sys.stdout = sys.stderr
    try:
        yield
    finally:
        sys.stdout = python_stdout
        _json_stream.reset(token)


# Files ---------------------------------------------------------------------------------------------------------------


def write_file(path: Path | None, content: bytes) -> None:
    """Write a file in one go; None writes nothing."""
    if path is not None:
        with replacing(path) as file:
            file.write(content)


def check_writable(path: Path, flag: str, *, replace: bool = True) -> None:
    """Find out before the work whether its result can be written, without touching existing files."""
    if path.is_dir():
        raise InputError(f"a file after {flag}", "a folder", where=path)
    if path.exists() and not path.is_file():  # a device or a pipe: opening it could wait for a reader
        if not os.access(path, os.W_OK):
            raise InputError(f"a writable file after {flag}", "one that cannot", where=path)
        return
    if path.exists() and not replace:
        raise InputError(f"a new file after {flag}", "one that exists", "another name, or --overwrite", path)
    path = Path(os.path.realpath(path))
    if not path.parent.is_dir():
        came = "something else" if path.parent.exists() else "none"
        raise InputError(f"a folder for the file of {flag}", came, f"mkdir -p {path.parent}", path)
    probe = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.exists():
            path.open("r+b").close()
        probe.open("xb").close()
        probe.unlink()
    except OSError as error:
        raise InputError(f"a writable file after {flag}", str(error.strerror), where=path) from error
