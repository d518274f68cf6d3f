"""`deformscope.replay` gives what the command prints and writes, and raises where the numbers differ."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.recording.items import read_estimates
from deformscope.recording.reader import Replay
from deformscope.runs.replay_result import compare
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.msm import reference
from tests.cases import Capture, Patch
from tests.log.synthetic import estimate
from tests.stages import reference_states
from tests.stages.bodies import pushed


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the fit of a pair."""
    body, path = pushed((4, 5), np.random.default_rng(1)), tmp_path_factory.mktemp("fit") / "run.rrd"
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    deformed, _ = reference_states.relax(spec, body.held_position, beta=0.6)
    ds.calibrate_beta({"rest": body.rest, "deformed": deformed, "held": body.held}, candidates=12, record=path)
    return path


def test_it_gives_the_json_and_the_words_of_the_command(recorded: Path, tmp_path: Path, capsys: Capture) -> None:
    found = ds.replay(recorded)
    assert main(["replay", str(recorded), "--viewer", "none", "--json", str(tmp_path / "r.json")]) == 0
    shown = capsys.readouterr()
    assert found.to_dict() == json.loads((tmp_path / "r.json").read_text())
    assert found.verdict == "replay: identical to the recorded numbers"
    assert found.verdict in shown.err
    assert found.verdict in str(found)
    assert found.shown
    assert all(str(one) in str(found) for one in found.tables()[0].rows[0])


def test_numbers_that_differ_are_an_error(recorded: Path, monkeypatch: Patch) -> None:
    (one,) = read_estimates(Replay(recorded))
    other = dataclasses.replace(one, value=one.value + 0.1)
    monkeypatch.setattr("deformscope.runs.replay.read_estimates", lambda _: [other])
    with pytest.raises(ds.InputError, match="numbers that differ by"):
        ds.replay(recorded)


def test_a_reason_in_other_words_is_the_same_reason() -> None:
    before = dataclasses.replace(estimate(), reasons=(Doubt("two-materials", "two foams", "weak"),))
    now = dataclasses.replace(before, reasons=(Doubt("two-materials", "two materials", "weak"),))
    other = dataclasses.replace(before, reasons=(Doubt("held-off", "two foams", "weak"),))
    assert compare([before], [now], Path("run.rrd")) is None
    with pytest.raises(ds.InputError, match="another reasons of Estimate"):
        compare([before], [other], Path("run.rrd"))


def test_other_settings_belong_to_an_exploration(recorded: Path) -> None:
    with pytest.raises(ds.InputError, match="a recorded exploration"):
        ds.replay(recorded, settings={"threshold": 0.1})
