"""Files that a user named: they are read whole, and replaced only by complete files."""

import difflib
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import datetime
from functools import cache
from importlib import resources
from pathlib import Path
from typing import BinaryIO

from deformscope.errors import InputError

SAMPLE_SCHEME = "sample:"
_largest = ContextVar("largest", default=1 << 30)
"""Most bytes that one thing in a file may take in memory."""


def resolve(path: str | Path) -> Path:
    """`sample:NAME` becomes the sample's file, or the folder of its images; `sample:NAME/FILE` becomes one of these
    images; any other text is unchanged."""
    text = str(path)
    if not text.startswith(SAMPLE_SCHEME):
        return Path(path).expanduser()
    name, _, file = text.removeprefix(SAMPLE_SCHEME).partition("/")
    folder = sample_path(name)
    return folder / file if file else next(folder.glob(f"{folder.name}.*"), folder)


def ending_of(path: str | Path) -> str:
    """The suffix of a file that a user named, in small letters."""
    return resolve(path).suffix.lower()


def sample_names() -> list[str]:
    """The samples that came with the installation."""
    root = resources.files("deformscope") / "samples"
    return sorted(entry.name for entry in root.iterdir() if entry.is_dir() and not entry.name.startswith("_"))


def sample_path(name: str) -> Path:
    """The folder of the sample `name`."""
    names = sample_names()
    if name not in names:
        near = nearest(name, names)
        raise InputError("a sample's name", f"{name!r}", f"{SAMPLE_SCHEME}{near}" if near else ", ".join(names))
    return Path(str(resources.files("deformscope") / "samples" / name))


def refusal(error: OSError) -> str:
    """The operating system's reason for an error, in lower case for a message."""
    return (error.strerror or str(error)).lower()


def nearest(name: str | Path, known: Iterable[str], scheme: str = "", like: float = 0.75) -> str:
    """What was perhaps meant by a name that there is not: the known name most like it, with its scheme; empty = none.
    like: least similarity, from 0 to 1"""
    return next((scheme + one for one in difflib.get_close_matches(str(name), known, n=1, cutoff=like)), "")


def nearest_file(path: str | Path) -> str:
    """What was perhaps meant by a path without a file: a file of its folder, or a sample; otherwise what to look at."""
    given = Path(path).expanduser()
    known = {name: SAMPLE_SCHEME + name for name in sample_names()}
    try:
        known |= {one.name: str(one) for one in given.parent.iterdir()}
    except OSError as error:
        return known.get(given.name, f"another folder; {given.parent}: {refusal(error)}")
    return known.get(nearest(given.name, known), f"another name; none in {given.parent.resolve()} is like it")


def read_file(path: str | Path, what: str, hint: str = "") -> bytes:
    """The bytes of a file that a user named. what: what it should be; hint: where it comes from. Raises InputError if
    it cannot be read."""
    try:
        return resolve(path).read_bytes()
    except OSError as error:
        raise InputError(what, refusal(error), hint or nearest_file(path), path) from error


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A file that replaces `path` when it is complete; an error leaves `path` unchanged. Raises OSError with its
    name."""
    if path.exists() and not path.is_file():  # a device or a pipe cannot be replaced, only written to
        with path.open("wb") as stream:
            yield stream
        return
    path = Path(os.path.realpath(path))  # a link stays a link, to the new file
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with draft.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:  # of a full disk, which names no file
        error.filename = error.filename or str(path)
        raise
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def none_larger(size_bytes: int) -> Iterator[None]:
    """Within it `check_size` refuses anything larger."""
    before = _largest.set(size_bytes)
    try:
        yield
    finally:
        _largest.reset(before)


def check_size(what: str, size_bytes: float, where: object = "") -> int:
    """The most bytes that one thing in a file may take in memory. Raises InputError for a larger size, declared or
    found: a few bytes can stand for any number."""
    if size_bytes > (most_bytes := _largest.get()):
        most_mb, came_mb = (f"{size / 1e6:.4g} MB" for size in (most_bytes, size_bytes))
        came, hint = "more" if came_mb == most_mb else came_mb, "a smaller one, or a higher --largest-mb of import"
        raise InputError(f"{what} in up to {most_mb} of memory", came, hint, where)
    return most_bytes


def make_folder(path: Path) -> None:
    """Make the folder of --out if it does not exist, and check before the work that it can be written to."""
    probe = path / f".{os.getpid()}.part"
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe.open("xb").close()
        probe.unlink()
    except OSError as error:
        raise InputError("a folder that can be written to", refusal(error), where=path) from error


_named: set[Path] = set()
"""Paths of `new_recording`: the file may come later."""


def new_recording(folder: Path, name: str) -> Path:
    """An unused path in the folder, which is made if missing: no earlier, simultaneous or immediately preceding
    recording has it. NAME-<stamp>.rrd"""
    make_folder(folder)
    first = folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S}.rrd"
    for number in range(1, 100):
        path = first if number == 1 else first.with_stem(f"{first.stem}-{number}")
        if not (path in _named or path.exists() or path.with_name(f"{path.stem}.part.rrd").exists()):
            _named.add(path)
            return path
    raise InputError("fewer recordings in one second", "100", where=first)


# Paths for rerun of files whose names are not UTF-8, which rerun cannot open


def utf8_path(path: Path) -> Path:
    """The path, or, if it is not UTF-8, a link to it, which exists until this process ends."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        absolute = Path.cwd() / path
        link = Path(_links().name) / (hashlib.sha256(os.fsencode(absolute)).hexdigest() + path.suffix)
        if not link.is_symlink():
            link.symlink_to(absolute)
        return link
    return path


@cache
def _links() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="deformscope-")
