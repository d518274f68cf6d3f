"""What README and docs print is what comes: the console blocks compared, and the README typed as it stands there."""

import os
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from deformscope import cli, config
from deformscope.cli.common import EXIT_LOSSES
from deformscope.file_io import ending_of
from tests.patience import PATIENCE_S
from tests.test_site import typed_lines
from tools import printed

ROOT = printed.ROOT
README = ROOT / "README.md"
EVERY = [one for page in printed.PAGES for one in printed.printed(page)]
LONG = ("make demo", "deformscope explore", "deformscope calibrate beta sample:tension")
"""What takes longer than some seconds begins so."""
ILLUSTRATIONS = {"docs/developers/architecture.md": 2, "docs/howto/watch-a-rig.md": 1, "drivers/optoforce.md": 1}
"""Blocks fenced as ```text, which nothing prints: drawings (that of the layers has its own
test), a line of udev's, an address."""
TYPED = [(kind, body) for kind, body in printed.FENCE.findall(README.read_text("utf-8")) if "make " not in body]
"""Blocks of the README, but for `make demo`, whose print is compared, and `make test`, which is this."""
WITHOUT_DEVICES = ("deformscope doctor rig.toml",)
"""Ends with the exit status of a rig that does not work, as none of its devices is plugged in here."""
QUICK = ("deformscope calibrate beta sample:pair", "deformscope rig new")


def fences(page: Path) -> list[tuple[str, str]]:
    return printed.FENCE.findall(page.read_text(encoding="utf-8"))


def commands(page: Path) -> list[str]:
    """The lines that a page wants typed, in their order."""
    return [line for fence in fences(page) for line in lines_of(*fence)]


def lines_of(kind: str, body: str) -> list[str]:
    """The commands of ours in a block."""
    lines = typed_lines(body) if kind in ("", "sh", "console") else []
    return [line.removeprefix(printed.PROMPT) for line in lines if line.startswith(("deformscope ", "make ", "$ "))]


OURS = [(page, line) for page in printed.PAGES for line in commands(page) if line.startswith("deformscope ")]


@pytest.mark.parametrize(
    "one", [pytest.param(one, marks=[pytest.mark.slow] * one.command.startswith(LONG)) for one in EVERY], ids=str
)
def test_a_page_shows_what_is_printed(one: printed.Printed, tmp_path: Path) -> None:
    assert printed.differing(one, printed.typed(one.command, tmp_path)) == [], "python tools/printed.py --write"


@pytest.mark.parametrize("page", printed.PAGES, ids=lambda page: page.name)
def test_every_block_is_code_commands_or_what_a_command_prints(page: Path) -> None:
    illustrations = 0
    for kind, body in fences(page):
        assert kind in ("", "sh", "python", "toml", "console", "text")
        illustrations += kind == "text"
        if kind == "console":
            assert body.startswith(printed.PROMPT), body
        if not kind:
            assert all(line.startswith(("deformscope ", "make ")) for line in typed_lines(body)), body
    assert illustrations == ILLUSTRATIONS.get(str(page.relative_to(ROOT)), 0)


@pytest.mark.parametrize(("page", "line"), OURS, ids=[line[:70] for _, line in OURS])
def test_the_flags_of_a_command_in_a_page_are_known(page: Path, line: str) -> None:
    name, options = understood(line)
    assert type(options).__name__ == cli.COMMANDS[name].config


def understood(line: str) -> tuple[str, Any]:
    """The command of a line, and its options."""
    words = shlex.split(line, comments=True)
    end = next((index for index, one in enumerate(words) if one in (">", "||")), len(words))
    name, rest = cli.find_command(words[1:end])
    return name, cli.parse(getattr(config, cli.COMMANDS[name].config), rest)


def test_the_readme_names_no_file_that_is_not_there() -> None:
    made: set[str] = set()
    for line in commands(README):
        if line.startswith("make"):
            continue
        _, options = understood(line)
        for read in map(str, options.reads()):
            sample = read.startswith("sample:") and ending_of(read)
            assert sample or read in made or read.startswith("lab:"), f"{line}: nothing made {read}"
        made |= {str(one.path) for one in options.writes()}
        made |= {line.rpartition(" > ")[2].split()[0]} if " > " in line else set()


@pytest.fixture
def shell(tmp_path: Path) -> Any:
    """Types a line in a folder where `deformscope` is this one."""
    programs, folder = tmp_path / "bin", tmp_path / "clone"
    programs.mkdir()
    folder.mkdir()
    ours = programs / "deformscope"
    ours.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m deformscope "$@"\n')
    ours.chmod(0o755)
    paths = {"PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": f"{ROOT}:{ROOT / 'drivers'}"}
    env = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")} | paths

    def type_(line: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["bash", "-c", line], cwd=folder, env=env, capture_output=True, text=True, timeout=10 * PATIENCE_S
        )

    return SimpleNamespace(type=type_, folder=folder)


def assert_done(line: str, done: subprocess.CompletedProcess[str]) -> None:
    wanted = (2,) if line.startswith(WITHOUT_DEVICES) else (0, EXIT_LOSSES)
    assert done.returncode in wanted, f"{line}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


@pytest.mark.parametrize("line", [line for line in commands(README) if line.startswith(QUICK)])
def test_a_quick_line_of_the_readme_runs(line: str, shell: Any) -> None:
    assert_done(line, shell.type(line))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "body"), TYPED, ids=[body.split("\n")[0] for _, body in TYPED])
def test_the_readme_typed_block_by_block(kind: str, body: str, shell: Any) -> None:
    """Line by line, each block in a folder of its own."""
    lines = lines_of(kind, body)
    if kind == "python":
        (shell.folder / "script.py").write_text(body)
        lines = [f"{shlex.quote(sys.executable)} script.py"]
    assert lines
    for line in lines:
        done = shell.type(line)
        assert_done(line, done)
        if kind == "python":  # which ends in what it prints in the end
            assert done.stdout.splitlines()[-2:] == [one[2:] for one in body.splitlines() if one.startswith("# ")]


TABLE = ["lab:table", "  verdict    2 regions", "  region 1   0.418 N/mm (0.387 to 0.451)", "  time       152 s"]


@pytest.mark.parametrize(
    ("shown", "same"),
    [
        ("  region 1   0.418 N/mm (0.387 to 0.451)", True),
        ("  region 1   0.419 N/mm (0.386 to 0.451)", True),  # rounded the other way
        ("  region 1   0.42 N/mm (0.387 to 0.451)", True),  # fewer digits
        ("  region 1   0.421 N/mm (0.387 to 0.451)", False),
        ("  region 1   0.418 N/mm (0.387 to 0.551)", False),
        ("  region 1   0.418 kN/mm (0.387 to 0.451)", False),
        ("  region 1   -0.418 N/mm (0.387 to 0.451)", False),
    ],
)
def test_numbers_are_compared_as_they_are_printed(shown: str, same: bool) -> None:
    assert (printed.differing(printed.Printed(README, "deformscope x", ("...", shown, "...")), TABLE) == []) is same


def test_times_and_names_with_a_stamp_are_not_compared() -> None:
    shown = [*TABLE[:-1], "  time       17 s"]
    assert printed.differing(printed.Printed(README, "deformscope x", tuple(shown)), TABLE) == []


def test_a_block_that_leaves_nothing_out_is_the_whole() -> None:
    assert printed.differing(printed.Printed(README, "deformscope x", tuple(TABLE[1:])), TABLE)


def test_a_row_that_came_no_longer_is_an_error() -> None:
    with pytest.raises(LookupError, match="region 3"):
        printed.renewed(["...", "  region 3   1 N/mm"], TABLE)


def test_what_is_written_is_as_shown(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "Text.\n\n```console\n$ deformscope x\n...\n  region 1   5 N/mm\n...\n```\n\n```\ndeformscope x\n```\n"
    )
    (one,) = printed.printed(page)
    printed.write(page, [(one, TABLE)])
    (renewed,) = printed.printed(page)
    assert renewed.shown == ("...", TABLE[2], "...")
    assert page.read_text().endswith("\n```\n\n```\ndeformscope x\n```\n")


def test_the_recording_of_the_docs_is_the_one_that_is_kept() -> None:
    """Its command in docs/results/fits.md makes what recordings/manifest.toml says."""
    import tomllib

    manifest = tomllib.loads((ROOT / "recordings" / "manifest.toml").read_text(encoding="utf-8"))
    of = (entry for entry in manifest["recording"] if entry["file"] == "tension.rrd")
    kept = {entry["command"].replace("recordings/", "") for entry in of}
    assert kept <= {one.command for one in EVERY}
