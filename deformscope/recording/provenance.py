"""Provenance of a result: format, settings, versions, git state, command line, machine."""

import functools
import importlib.metadata
import json
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

VERSIONED = ("deformscope", "rerun-sdk", "numpy", "opencv-python-headless", "warp-lang")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    return {"python": platform.python_version()} | {name: _version(name) for name in VERSIONED}


@functools.cache
def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def git_state() -> dict[str, object]:
    """Commit of the checkout from which the package runs, and whether it is clean; empty if it is installed
    elsewhere."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return {}

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()

    try:
        return {"commit": git("rev-parse", "HEAD"), "dirty": bool(git("status", "--porcelain", "-uno"))}
    except (OSError, subprocess.SubprocessError):
        return {}


def command() -> list[str]:
    """The command line of this process as typed, without the program's folder."""
    program = Path(sys.argv[0])
    name = program.parent.name if program.name == "__main__.py" else program.name
    return [name if program.is_absolute() else sys.argv[0], *sys.argv[1:]]


def machine() -> str:
    """The operating system and processor."""
    return platform.platform()


def properties(settings: Mapping[str, object], *, brief: bool) -> dict[str, object]:
    """The whole provenance, as text that any tool can read. brief: leave out what differs between two runs of one
    input"""
    from deformscope.rows import FORMAT  # slow to import

    found: dict[str, object] = {"format": FORMAT, "settings": json.dumps(settings, sort_keys=True, default=str)}
    seed = settings.get("seed")
    if isinstance(seed, int):
        found["seed"] = seed
    if not brief:
        found |= {"versions": json.dumps(versions()), "git": json.dumps(git_state())}
        found |= {"command": json.dumps(command()), "platform": machine()}
    return found


def exported(properties: Mapping[str, object], *, anonymous: bool) -> dict[str, object]:
    """Provenance of the recording in an export. anonymous: only versions and the numbers of the settings: commands,
    machines, commits and words may name a person, a machine or a path"""
    found = {name: _parsed(value) for name, value in properties.items()}
    if not anonymous:
        return found
    public = {name: value for name, value in found.items() if name in ("format", "seed", "versions")}
    return public | {"settings": _numbers(found.get("settings"))}


def left_out(properties: Mapping[str, object]) -> dict[str, str]:
    """Provenance that an anonymous export leaves out, by its place (`settings.rig`)."""
    return dict(_differing("", exported(properties, anonymous=False), exported(properties, anonymous=True)))


def _differing(place: str, whole: object, public: object) -> Iterator[tuple[str, str]]:
    if isinstance(whole, Mapping):
        for name, value in whole.items():
            inner = public.get(name) if isinstance(public, Mapping) else None
            yield from _differing(f"{place}.{name}".lstrip("."), value, inner)
    elif whole != public and whole not in (None, "", []):
        yield place, whole if isinstance(whole, str) else json.dumps(whole)


def _parsed(value: object) -> object:
    try:
        return json.loads(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _numbers(value: object) -> object:
    if isinstance(value, Mapping):
        inner = {name: _numbers(one) for name, one in value.items()}
        return {name: one for name, one in inner.items() if one not in (None, {}, [])}
    if isinstance(value, list):
        return [one for one in map(_numbers, value) if one is not None]
    return value if isinstance(value, bool | int | float) else None
