"""The process of a simulator after it has ended, or no longer answers: each request gets its error."""

import shlex
import sys
import threading
from pathlib import Path

import pytest

from deformscope.simulators.target_process import TargetFailed, TargetProcess, target_process
from tests.cases import Patch
from tests.cli.test_simulate_command import STAND_IN

PRESS: dict[str, object] = {"do": "press", "asset": "slab.xml", "parameters": {"young": 1e4}, "pokes": [{}, {}]}
HANGS_S = 60.0
"""A request that is not answered by then waits for ever."""


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """An interpreter that runs the stand-in."""
    script = tmp_path / "python"
    script.write_text(f"#!/bin/sh\nexec {shlex.quote(sys.executable)} {shlex.quote(str(STAND_IN))}\n")
    script.chmod(0o755)
    return script


def error_of(target: TargetProcess) -> str:
    """The error of a request, with the default `keep_on`."""
    found: list[str] = []

    def asks() -> None:
        try:
            list(target.ask(PRESS))
        except TargetFailed as error:
            found.append(str(error))

    asking = threading.Thread(target=asks, daemon=True)
    asking.start()
    asking.join(HANGS_S)
    assert not asking.is_alive(), "the request waits for ever"
    return found[0]


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("crash", "mujoco 0.0.1: ended with status 7: it ran out of memory"),
        ("deaf", "mujoco 0.0.1: ended with status -9: its output was closed"),
    ],
)
def test_each_request_to_a_process_that_ended_gets_its_last_output(
    how: str, said: str, python: Path, monkeypatch: Patch
) -> None:
    monkeypatch.setenv("FAKE_TARGET", how)
    with target_process("mujoco", python) as target:
        errors = [error_of(target) for _ in range(3)]
    assert len(set(errors)) == 1
    assert f"got {said} | try: a shorter --timestep-s" in errors[0]


def test_a_process_that_was_stopped_answers_no_request(python: Path, monkeypatch: Patch) -> None:
    monkeypatch.setenv("FAKE_TARGET", "hang")
    with target_process("mujoco", python) as target:
        with pytest.raises(TargetFailed, match=r"got mujoco 0\.0\.1: stopped \| try"):
            list(target.ask(PRESS, lambda: False))
        assert "got mujoco 0.0.1: stopped |" in error_of(target)
