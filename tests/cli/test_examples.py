"""The example in each command's help runs as it is typed."""

import shlex
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest

from deformscope.cli import COMMANDS, main
from deformscope.cli.common import EXIT_LOSSES
from deformscope.cli.examples import EXAMPLES
from tests.test_site import environment

QUICK = ("calibrate beta", "calibrate viscous", "verify", "report", "catalog", "discard", "devices")
"""In seconds, without a file that the shell writes."""
LOSES = "record lab:bench"
"""A busy machine may lose readings of its devices, which the exit status says."""


def test_every_command_has_an_example_of_itself() -> None:
    assert list(EXAMPLES) == list(COMMANDS)
    for name, lines in EXAMPLES.items():
        assert shlex.split(lines.splitlines()[-1])[1 : 1 + len(name.split())] == name.split()


def test_help_ends_with_the_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "axes", "--help"]) == 0
    assert capsys.readouterr().out.endswith(f"\nexample:\n  {EXAMPLES['calibrate axes']}\n")


@pytest.fixture(scope="module")
def typed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str]]:
    """A folder, and the lines that were typed there: several examples begin with the same recording."""
    return tmp_path_factory.mktemp("examples"), set()


@pytest.mark.parametrize("name", [one for one in COMMANDS if one in QUICK])
def test_a_quick_example_runs(name: str, typed: tuple[Path, set[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, done = typed
    monkeypatch.chdir(folder)
    for line in EXAMPLES[name].splitlines():
        if line not in done:
            done.add(line)
            assert main(shlex.split(line)[1:]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_an_example_runs_as_typed(name: str, tmp_path: Path) -> None:
    for line in EXAMPLES[name].splitlines():
        ended = subprocess.run(
            ["sh", "-c", line],
            cwd=tmp_path,
            env=environment(),
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
        )
        if "arm jog" in line:  # keys of a terminal move the arm
            assert "a terminal" in ended.stderr
            continue
        if " simulate " in line and find_spec("mujoco") is None:
            assert "pip install mujoco" in ended.stderr
            continue
        allowed = (0, EXIT_LOSSES) if LOSES in line else (0,)
        assert ended.returncode in allowed, f"{line}: {ended.stderr[-2000:]}"
