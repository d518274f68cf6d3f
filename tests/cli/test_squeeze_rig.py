"""`squeeze RIG` on doubles around a simulated container, commanded by the code that commands a real hand: on a
simulated clock, and with threads of their own on the host's."""

import json
import os
import re
import signal
from pathlib import Path
from typing import Any

import pytest

from deformscope.cli import main
from deformscope.cli.common import EXIT_LOSSES
from deformscope.experiments.squeeze.squeezing_hand import SqueezingHand
from deformscope.files.squeeze_dataset import SqueezeDataset
from deformscope.recording.items import read_items
from tests.cases import Capture, Patch, one_line
from tests.cli.squeeze_rig_on_a_simulated_clock import SimulatedSqueezeRig, use_simulated_squeeze_rigs
from tests.experiments.toy_squeeze import spoil_arrays
from tests.verified import verify_here

RIG = """
[devices.hand]
driver = "sdh"
double = true
bus = "socketcan:can0"
rate_hz = 50
[devices.pads]
driver = "dsa"
double = true
port = "/dev/no-such-port"
[devices.depth]
driver = "depth_camera"
double = true
fps = 5
[container]
kind = "cardboard box"
[squeeze]
hold_s = 0.3
# doubles share a busy machine with what reads them
hand_silent_s = 0.8
tactile_silent_s = 1.0
"""
BEFORE_A = (1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)
"""Limits of the currents as the hand has them when it is switched on."""
MS = 1_000_000


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def squeeze(rig: Path, *more: str) -> tuple[int, dict[str, Any]]:
    """Exit status and JSON."""
    target = rig.parent / "found.json"
    given = ["squeeze", str(rig), "--content", "rice", "--container", "box-07", "--session", "s"]
    status = main([*given, "--viewer", "none", "--json", str(target), *more])
    return status, json.loads(target.read_text()) if target.exists() else {}


def squeezed_recorded_and_replayed(rig: Path, capsys: Capture, *allowed: int) -> None:
    """allowed: exit statuses beside 0, as a busy machine loses frames"""
    status, found = squeeze(rig, "--dataset", "d")
    assert status in (0, *allowed), capsys.readouterr().err
    assert found["discarded"] is None
    assert found["hand_stands"]
    assert found["limits_restored"]
    assert found["features"] == {"tactile": 72, "physical": 13, "vision": 3721, "vision_small": 121}
    assert found["physical"]["force_n"] == pytest.approx(4.1, abs=0.6)
    low_s, high_s = found["events"]["first_interval_s"]
    assert low_s <= found["truth"]["first_s"] <= high_s
    (entry,) = SqueezeDataset(Path("d")).entries()
    assert (entry.content, entry.container, entry.container_type) == ("rice", "box-07", "cardboard box")
    recording = SqueezeDataset(Path("d")).recording_path(entry.trial)
    assert {item.device for item in read_items(recording) if hasattr(item, "device")} == {"hand", "pads", "depth"}
    assert verify_here(recording) in (0, *allowed), capsys.readouterr().err
    assert main(["replay", str(recording)]) == 0, capsys.readouterr().err


def test_a_rig_of_doubles_squeezes_records_and_replays(rig: Path, capsys: Capture, monkeypatch: Patch) -> None:
    made = use_simulated_squeeze_rigs(monkeypatch)
    squeezed_recorded_and_replayed(rig, capsys)
    assert made[0].limits_a() == BEFORE_A


@pytest.mark.realtime
def test_a_rig_of_doubles_squeezes_on_the_hosts_clock(rig: Path, capsys: Capture) -> None:
    squeezed_recorded_and_replayed(rig, capsys, EXIT_LOSSES)


def kept_as_discarded(made: SimulatedSqueezeRig, found: dict[str, Any], reason: str, verified: int = 0) -> None:
    """The hand stands, its limits are as they were, and the trial is left out with its reason."""
    (entry,) = SqueezeDataset(Path("d")).entries()
    assert entry.discarded.startswith(reason)
    assert found["hand_stands"]
    assert found["limits_restored"]
    assert made.closing_deg_s() <= 0.0
    assert made.limits_a() == BEFORE_A
    assert verify_here(SqueezeDataset(Path("d")).recording_path(entry.trial)) == verified


def interrupt() -> None:
    """As Ctrl-C does."""
    os.kill(os.getpid(), signal.SIGINT)


def test_ctrl_c_while_it_squeezes(rig: Path, capsys: Capture, monkeypatch: Patch) -> None:
    made = use_simulated_squeeze_rigs(monkeypatch, lambda lab: setattr(lab, "at_contact", interrupt))
    status, found = squeeze(rig, "--dataset", "d")
    assert status == 128 + signal.SIGINT
    assert "ended by Ctrl-C; the hand stands" in capsys.readouterr().err
    kept_as_discarded(made[0], found, "a person asked: Ctrl-C")


@pytest.mark.slow
def test_a_hand_that_is_lost_while_it_squeezes(rig: Path, capsys: Capture, monkeypatch: Patch) -> None:
    def lose(lab: SimulatedSqueezeRig) -> None:
        hand = lab.lab.simulated.hand

        def cable_out() -> None:
            hand.silent = True
            lab.later.append((lab.clock() + 900 * MS, lambda: setattr(hand, "silent", False)))

        lab.at_contact = cable_out

    made = use_simulated_squeeze_rigs(monkeypatch, lose)
    status, found = squeeze(rig, "--dataset", "d")
    assert status == 2
    assert "hand lost" in capsys.readouterr().err
    kept_as_discarded(made[0], found, "hand lost", EXIT_LOSSES)


@pytest.mark.slow  # quick at `tests/experiments/squeeze/test_squeeze.py`
def test_arrays_that_read_nothing_while_something_holds_the_fingers(
    rig: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    def spoil(lab: SimulatedSqueezeRig) -> None:
        lab.at_contact = lambda: spoil_arrays(lab.lab.simulated.pads, "dead")

    made = use_simulated_squeeze_rigs(monkeypatch, spoil)
    status, found = squeeze(rig, "--dataset", "d")
    assert status == 2
    said = capsys.readouterr().err
    assert re.search(r"finger [02] is driven, but stays at -?\d+\.\d deg; its array reads 0 counts", said)
    kept_as_discarded(made[0], found, "tactile arrays contradict the fingers: finger ")


@pytest.mark.slow
def test_a_ctrl_c_that_comes_later_is_not_the_reason(rig: Path, capsys: Capture, monkeypatch: Patch) -> None:
    rig.write_text(rig.read_text() + "saturation_counts = 60\n")

    def soon(lab: SimulatedSqueezeRig) -> None:
        lab.at_contact = lambda: lab.later.append((lab.clock() + 600 * MS, interrupt))

    made = use_simulated_squeeze_rigs(monkeypatch, soon)
    status, found = squeeze(rig, "--dataset", "d")
    assert status == 2
    said = capsys.readouterr().err
    assert "ending; Ctrl-C again" in said
    assert "tactile array saturated" in said
    kept_as_discarded(made[0], found, "tactile array saturated: a texel at ")


@pytest.mark.realtime
def test_ctrl_c_on_the_hosts_clock(rig: Path, capsys: Capture, monkeypatch: Patch) -> None:
    begin = SqueezingHand.begin

    def began(hand: SqueezingHand, phase: str) -> None:
        begin(hand, phase)
        if phase == "squeeze":
            interrupt()

    monkeypatch.setattr(SqueezingHand, "begin", began)
    status, found = squeeze(rig, "--dataset", "d")
    assert status == 128 + signal.SIGINT
    assert found["hand_stands"]
    assert found["limits_restored"]
    (entry,) = SqueezeDataset(Path("d")).entries()
    assert entry.discarded == "a person asked: Ctrl-C"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("double = true\nport", "port", "hand, pads, depth all real or all doubled"),
        ("double = true\n", "", "expected a CAN bus"),
        ('driver = "sdh"\ndouble = true\nbus = "socketcan:can0"\nrate_hz = 50', 'driver = "webcam"', 'driver = "sdh"'),
        ("[container]\n", "[container]\nsize_m = [0.05, 0.05, 0.1]\n", "that are simulated: box of [0.06, 0.09, 0.16]"),
        ("[container]\n", '[container]\nshape = "cylinder"\nsize_m = [0.07, 0.07, 0.16]\n', "as cylinder-07"),
    ],
)
def test_a_rig_that_cannot_squeeze_is_refused_in_one_line(
    old: str, new: str, words: str, rig: Path, capsys: Capture
) -> None:
    assert old in RIG
    rig.write_text(RIG.replace(old, new))
    assert squeeze(rig, "--yes")[0] == 2
    assert words in one_line(capsys)


def test_a_content_that_nobody_simulates_is_refused_in_one_line(rig: Path, capsys: Capture) -> None:
    assert main(["squeeze", str(rig), "--content", "sand", "--viewer", "none"]) == 2
    assert "empty, water, yogurt, flour, rice; got 'sand'" in one_line(capsys)
