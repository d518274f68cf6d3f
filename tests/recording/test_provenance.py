"""What made a result."""

import sys

import pytest

import deformscope
from deformscope.recording import provenance


def test_what_made_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["deformscope", "calibrate", "beta", "a b.npz"])
    assert provenance.command() == ["deformscope", "calibrate", "beta", "a b.npz"]
    assert provenance.versions()["python"].startswith("3.")
    assert set(provenance.VERSIONED) < set(provenance.versions())
    assert provenance.machine()
    state = provenance.git_state()
    assert state == {} or len(str(state["commit"])) == 40
    monkeypatch.setattr(provenance, "VERSIONED", ("no-such-package",))
    assert provenance.versions()["no-such-package"] == "not installed"
    assert deformscope.__version__


def test_a_command_names_no_folder_that_was_not_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["record", "/dev/rig.toml"]
    for program, named in (
        ("/home/ann/.venv/bin/deformscope", "deformscope"),
        ("/home/ann/deformscope/__main__.py", "deformscope"),
        ("/home/ann/mine.py", "mine.py"),
        ("scripts/mine.py", "scripts/mine.py"),
        ("-c", "-c"),
    ):
        monkeypatch.setattr(sys, "argv", [program, *given])
        assert provenance.command() == [named, *given]
