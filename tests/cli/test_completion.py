"""What a shell completes, and what is suggested for names with a mistake."""

import os
import shlex
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope.cli.completion import next_words
from tests.patience import PATIENCE_S


@pytest.mark.parametrize(
    ("line", "some", "not_these"),
    [
        ("deformscope ex", ["explore", "export"], ["record"]),
        ("deformscope calibrate ", ["beta", "viscous"], ["verify"]),
        ("deformscope catalog com", ["compare"], []),
        ("deformscope calibrate beta sample:t", ["sample:table", "sample:tension"], ["sample:pair"]),
        ("deformscope calibrate beta sample:pair --pic", ["--picture"], []),
        ("deformscope calibrate beta sample:pair --method ", ["gradient", "sweep"], ["sample:pair"]),
        ("deformscope explore lab:two-60", ["lab:two-60-150"], []),
        ("deformscope record lab:b", ["lab:bench"], []),
        ("deformscope completion ", ["bash", "fish", "zsh"], []),
        ("deformscope calibrate beta 'a ", [], ["beta"]),
    ],
)
def test_words_that_may_follow(line: str, some: list[str], not_these: list[str]) -> None:
    found = next_words(line)
    assert set(some) <= set(found)
    assert not set(not_these) & set(found)


# How each shell starts without a user's files, and what loads its script there.
SHELLS = {
    "bash": (["--norc"], 'eval "$(deformscope completion bash)"'),
    "zsh": (["-f"], 'eval "$(deformscope completion zsh)"'),
    "fish": (["--no-config"], "deformscope completion fish | source"),
}


@pytest.mark.parametrize("shell", SHELLS)
def test_the_key_completes_in_the_shell(shell: str, tmp_path: Path) -> None:
    """In a terminal: a subcommand, a flag, a source with a colon, and a file where no word fits."""
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    command = tmp_path / "deformscope"
    command.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m deformscope "$@"\n')
    command.chmod(0o755)
    (tmp_path / "bench.rrd").touch()
    options, load = SHELLS[shell]
    paths = os.pathsep.join(os.path.abspath(one or ".") for one in sys.path)  # noqa: PTH100
    given = os.environ | {
        "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": paths,
        "HOME": str(tmp_path),
        "TERM": "dumb",
    }
    in_a_terminal = [sys.executable, "-c", "import pty, sys; pty.spawn(sys.argv[1:])", shell, *options, "-i"]
    with subprocess.Popen(
        in_a_terminal, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=given, cwd=tmp_path
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        too_long = threading.Timer(PATIENCE_S, process.kill)
        too_long.start()
        shown = ""

        def type_until(typed: str, wanted: str) -> None:
            nonlocal shown
            process.stdin.write(typed.encode())
            process.stdin.flush()
            shown = ""
            while wanted not in shown:
                read = os.read(process.stdout.fileno(), 4096).decode(errors="replace")
                assert read, shown
                shown += read

        try:
            type_until(f"{load}; echo load''ed\n", "loaded")
            assert "not found" not in shown
            type_until("deformscope calibrate visc\t", "viscous ")
            type_until("\x15deformscope calibrate beta sample:pair --pic\t", "--picture ")
            type_until("\x15deformscope explore lab:two-60\t", "lab:two-60-150 ")
            type_until("\x15deformscope verify ben\t", "bench.rrd ")
        finally:
            too_long.cancel()
            process.kill()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["explore", "two-60-150"], "try: lab:two-60-150"),
        (["explore", "two-60-l50"], "try: lab:two-60-150"),
        (["explore", "lab:two-6o-150"], "try: two-60-150"),
        (["calibrate", "beta", "tension"], "try: sample:tension"),
        (["calibrate", "beta", "sample:tensio"], "try: sample:tension"),
        (["calibrate", "both", "pairs"], "try: sample:pair"),
        (["record", "bensh"], "try: lab:bench"),
        (["explor"], "try: deformscope explore"),
    ],
)
def test_near_misses_are_suggested(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert says in capsys.readouterr().err
