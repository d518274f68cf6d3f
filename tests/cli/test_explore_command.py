"""`explore` as a user calls it, through the real drivers on doubles."""

import dataclasses
import io
import json
import re
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.experiments.explore.recorded_touches import recorded_inputs
from deformscope.experiments.explore.touching_robot import TouchingRobot
from deformscope.frames import ArmFrame, DepthFrame, Item, WrenchFrame
from deformscope.lab.faults import CAMERA, Injected
from deformscope.lab.touch_lab import TouchLab
from deformscope.recording.items import read_items, read_results
from deformscope.recording.ledger import check_recording
from deformscope.recording.reader import Row
from deformscope.recording.rrd_file import RecordingFile
from deformscope.rig.source import RigSource
from deformscope.robot.robot import Robot
from deformscope.robot.supervisor import SafetyDecision, Supervisor
from deformscope.robot.touch import Phase
from deformscope.stages.map.exploration import ExplorationStop, PhaseStart
from deformscope.stages.map.measured import LookFrames, TouchFrames
from deformscope_drivers.clock import Stamp
from studies.fault_study import ALLOWED_S, AS_IT_MOVES, turned_aside_deg
from tests.cases import Capture, Patch, one_line
from tests.cli.quick_scene import use_quick_scene
from tests.cli.recorded import Explored
from tests.patience import PATIENCE_S
from tests.verified import verify_here


def test_a_simulated_table_is_explored(explored: Explored) -> None:
    found = explored.found
    assert found["scenario"] == "lab:two-60-150"
    assert len(found["touches"]) == explored.touches
    assert found["region_count"] == explored.touches
    assert found["stop_reason"] == "budget"
    missed = found["missed"]
    assert 0.1 < missed["untouched_m"] < 0.2  # the surface is 0.4 m wide
    assert [one["radius_m"] for one in missed["inclusions"]] == [0.03, 0.045, 0.06, 0.085, 0.12]
    chances = [one["probability"] for one in missed["inclusions"]]
    assert missed["prior"] > chances[0] > chances[-1] > 0.0
    assert "inclusions unseen" in explored.out
    assert found["truth"]["region_count"] == 2
    assert 2.9 < found["max_force_n"] < 8.0
    assert (found["set_force_n"], found["more_force_n"]) == (3.0, 5.0)
    assert (
        max(one["peak_force_n"] for one in found["touches"])
        <= found["measured_max_force_n"]
        < 1.1 * found["max_force_n"]
    )
    assert f"measured {found['measured_max_force_n']:.2f} N, true {found['max_force_n']:.2f} N" in explored.out
    assert [f"touch {number + 1} of at most {explored.touches}, at" in explored.err for number in range(2)] == [
        True,
        explored.touches > 1,
    ]
    assert "no further touch: the allowed number of touches is reached" in explored.err
    assert found["seconds"]["session"] > 10.0
    if explored.touches == 2:
        assert 0.5 < found["truth"]["iou"] <= 1.0
        stiff, soft = (one["apparent_stiffness_n_per_mm"] for one in found["touches"])
        assert stiff > 1.5 * soft
    assert "ok  force sensor: tare" in explored.err
    assert f"{explored.touches} region" in explored.out
    assert explored.record.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    with np.load(explored.record.with_suffix(".npz"), allow_pickle=False) as file:
        assert file["stiffness_n_per_mm"].shape == file["labels"].shape == file["truth_labels"].shape == (80, 120)
        assert file["cell_m"] == 0.005
        assert set(np.unique(file["labels"])) == set(range(explored.touches))


def test_its_recording_is_whole_and_replays(explored: Explored, capsys: Capture) -> None:
    assert check_recording(explored.record).problems == []
    assert verify_here(explored.record) == 0, capsys.readouterr().err
    assert "tip/frames" in capsys.readouterr().out
    assert main(["replay", str(explored.record)]) == 0
    replayed = " ".join(capsys.readouterr().err.split())
    results = 3 + 4 * explored.touches  # plans among them, and what lies between frames and estimates
    assert f"{results} results from depth images, forces and states of the arm, identical" in replayed


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "words"), [(DepthFrame, "of SurfaceEstimate"), (WrenchFrame, "of TouchEstimate")])
def test_a_replay_notices_one_altered_frame(
    kind: type, words: str, explored: Explored, capsys: Capture, monkeypatch: Patch
) -> None:
    alter_one(monkeypatch, kind, explored.record)
    assert main(["replay", str(explored.record)]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow
def test_a_replay_with_another_setting_is_compared(explored: Explored, capsys: Capture) -> None:
    assert main(["replay", str(explored.record), "--set", "set_force_n=2", "--json", "-"]) == 0
    beside = json.loads(capsys.readouterr().out)
    assert (beside["identical"], beside["set"]) == (None, {"set_force_n": 2.0})
    touches = {f"touch {number + 1}" for number in range(explored.touches)}
    assert beside["recorded"].keys() == beside["computed"].keys() == touches | {"map"}
    assert beside["recorded"]["touch 1"] != beside["computed"]["touch 1"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("force=2", "KEY one of budget, goal, threshold"),
        ("budget=many", "a value of budget"),
        ("budget=0", "1 or more"),
    ],
)
def test_a_setting_that_is_none_is_refused(words: str, expected: str, explored: Explored, capsys: Capture) -> None:
    assert main(["replay", str(explored.record), "--set", words]) == 2
    assert expected in capsys.readouterr().err


def alter_one(monkeypatch: Patch, kind: type, record: Path) -> None:
    """From now on one frame that an exploration used is read as another: the first depth image, or a force before it
    pressed."""
    used = [one.item for one in read_results(record, (LookFrames, TouchFrames), trust=True)]
    look, touch = (next(one for one in used if isinstance(one, wanted)) for wanted in (LookFrames, TouchFrames))
    whole, down_ns = read_items, touch.wrench_ns[np.searchsorted(touch.wrench_ns, touch.arm_ns[len(touch.arm_ns) // 3])]

    def altered(*arguments: Any, **options: Any) -> Iterator[Item]:
        for item in whole(*arguments, **options):
            if kind is DepthFrame and isinstance(item, DepthFrame) and item.stamp.host_ns == look.depth_ns[0]:
                yield dataclasses.replace(item, depth=item.depth + (item.depth > 0).astype(item.depth.dtype))
            elif kind is WrenchFrame and isinstance(item, WrenchFrame) and item.stamp.host_ns == down_ns:
                yield dataclasses.replace(item, force_n=item.force_n + 1e-9)
            else:
                yield item

    monkeypatch.setattr("deformscope.experiments.explore.recorded_touches.read_items", altered)


def test_a_recording_without_a_frame_that_was_used_is_refused(tmp_path: Path, monkeypatch: Patch) -> None:
    state = ArmFrame(Stamp(7), 0, *(np.zeros(6),) * 3, *(np.zeros(3),) * 5)
    one = Row(0, 0, LookFrames("camera", np.array([5]), "arm", 7, "j2n6s300", (1.0, 1.0), (0.0, 0.0)))
    monkeypatch.setattr(
        "deformscope.experiments.explore.recorded_touches.read_results", lambda *_, **options: iter([one])
    )
    monkeypatch.setattr(
        "deformscope.experiments.explore.recorded_touches.read_items", lambda *_, **options: iter([state])
    )
    with pytest.raises(InputError, match="without 1 depth images, 0 forces and 0 states"):
        recorded_inputs(tmp_path / "e.rrd")


def test_scenes_are_listed_without_a_rig(capsys: Capture) -> None:
    assert main(["explore", "--list-scenarios"]) == 0
    shown = capsys.readouterr().out
    assert "lab:two-60-150" in shown
    assert "lab:gradient" in shown
    assert all(f"  {injected.word} " in shown for injected in Injected)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["explore"], "--list-scenarios"),
        (["explore", "lab:nowhere"], "a scene"),
        (["explore", "lab:disc", "--set-force", "9"], "up to 5 N"),
        (["explore", "lab:disc", "--touches", "0"], "1 or more"),
        (["explore", "rig.toml"], "a rig file (TOML), or lab:NAME"),
        (["explore", "two-60-150"], "try: lab:two-60-150"),
        (["calibrate", "arm", "homogeneous-rigid"], "try: lab:homogeneous-rigid"),
        (["explore", "lab:disc", "--fault", "storms@1"], "try: storm@1"),
        (["explore", "lab:disc", "--fault", "storm@9"], "from 1 to 8"),
        (["explore", "rig.toml", "--camera", "primesense"], "--camera with a simulated scene alone"),
        (["explore", "rig.toml", "--robot", "gripper"], "--robot with a simulated scene alone"),
        (["explore", "lab:two-60-150", "--removal", "hull"], "--removal with --robot gripper"),
    ],
)
def test_what_cannot_be_explored_is_said_in_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) != 0
    assert words in one_line(capsys)


LAB_STARTS_NS = 1_000_000_000
STOPPED = ["--touches", "2", "--viewer", "none", "--beta-model", "none"]


@pytest.fixture
def quick_scene(monkeypatch: Patch) -> None:
    use_quick_scene(monkeypatch)


class Terminal(io.StringIO):
    """A stderr that is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.usefixtures("quick_scene")
@pytest.mark.parametrize(
    ("fault", "kind", "within_s", "words"),
    [
        pytest.param("force-silent@1", "force sensor silent", 0.05, "deformscope doctor RIG", marks=pytest.mark.slow),
        pytest.param("arm-cable@1", "link lost", 0.1, "THE ARM COULD NOT BE STOPPED", marks=pytest.mark.slow),
        pytest.param("push@1", "force above the soft stop", 0.05, "the tip has backed away", marks=pytest.mark.slow),
    ],
)
def test_a_fault_stops_it_and_the_recording_is_whole(
    fault: str, kind: str, within_s: float, words: str, tmp_path: Path, capsys: Capture
) -> None:
    record, told = tmp_path / "e.rrd", tmp_path / "e.json"
    arguments = ["explore", "lab:two-60-150", *STOPPED, "--fault", fault]

    assert main([*arguments, "--record", str(record), "--json", str(told)]) == 2
    shown = capsys.readouterr()
    last = shown.err.strip().splitlines()[-1]
    assert last.startswith("deformscope: error: ")
    assert kind in last
    assert words in last
    assert str(record) in last
    assert "Traceback" not in shown.err
    assert "\r" not in shown.err
    found = json.loads(told.read_text())
    assert found["stop_reason"] == f"stopped: {kind}"
    assert found["fault"]["kind"] == kind
    assert 0.0 <= found["fault"]["noticed_after_s"] <= within_s
    assert len(found["touches"]) == int(fault[-1]) - 1
    assert found["max_force_n"] < 15.0

    results = list(read_results(record, (PhaseStart, ExplorationStop)))
    ((stop, at_ns),) = [(one.item, one.session_ns) for one in results if isinstance(one.item, ExplorationStop)]
    assert (stop.kind, stop.reason) == (kind, found["fault"]["reason"])
    assert at_ns / 1e9 == pytest.approx(found["fault"]["time_s"])
    names = [one.item.name for one in results if isinstance(one.item, PhaseStart)]
    assert f"stopped: {kind}" in names
    assert names[:2] == ["look", "travel"]
    assert found["seconds"]["session"] > found["fault"]["time_s"] + 0.49
    frames = [one for one in read_items(record, kinds=(DepthFrame,), trust=True) if isinstance(one, DepthFrame)]
    assert frames[-1].stamp.host_ns - LAB_STARTS_NS > at_ns + 300_000_000

    # the file is whole; what a device that fell silent did not give is a loss, and named
    lost = fault.partition("@")[0].split("-")[0]
    assert verify_here(record) == (0 if lost == "push" else 3)
    verified = capsys.readouterr()
    assert kind in verified.out
    assert (lost == "push") == ("losses: " not in verified.err)
    assert main(["replay", str(record)]) == 0, capsys.readouterr().err
    assert not list(tmp_path.glob("*.part*"))


@pytest.mark.slow
@pytest.mark.parametrize("injected", Injected)
def test_every_fault_is_noticed_and_its_recording_whole(injected: Injected, tmp_path: Path, capsys: Capture) -> None:
    record, told = tmp_path / "e.rrd", tmp_path / "e.json"
    arguments = ["explore", "lab:disc", *STOPPED, "--seed", "4", "--fault", f"{injected.word}@1"]
    # the laboratory's camera gives 10 pictures a second; an arm that hardly moves is noticed later (`fault_study`)
    within_s = 0.2 if injected in CAMERA else 0.4 if injected in AS_IT_MOVES else ALLOWED_S[injected]
    assert main([*arguments, "--record", str(record), "--json", str(told)]) == 2
    assert capsys.readouterr().err.count("Traceback") == 0
    assert 0.0 <= json.loads(told.read_text())["fault"]["noticed_after_s"] <= within_s
    assert verify_here(record) in (0, 3)  # whole; 3 where the fault cost readings
    assert main(["replay", str(record)]) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("quick_scene")
def test_over_the_slowest_link_that_is_let_it_explores_with_the_stick_as_commanded(
    tmp_path: Path, monkeypatch: Patch
) -> None:
    """A call over USB takes 2.8 ms and more (kinova-ros issues 281, 372)."""
    told, labs, aside_deg = tmp_path / "e.json", list[TouchLab](), list[float]()
    opened, reported = TouchLab.open, Robot._report_to_watch

    def open_slow(lab: TouchLab) -> None:
        opened(lab)
        lab.call_s = 0.004
        labs.append(lab)

    def report(robot: Robot, verdict: SafetyDecision) -> None:
        aside_deg.append(turned_aside_deg(robot, labs[-1]))
        reported(robot, verdict)

    monkeypatch.setattr(TouchLab, "open", open_slow)
    monkeypatch.setattr(Robot, "_report_to_watch", report)
    assert main(["explore", "lab:two-60-150", *STOPPED, "--json", str(told)]) == 0
    found = json.loads(told.read_text())
    assert (found["stop_reason"], len(found["touches"])) == ("budget", 2)
    assert found["max_force_n"] < 8.0
    assert len(aside_deg) > 1000
    assert np.nanmax(aside_deg) <= 1.0


def interrupted_at(phase: Phase, *numbers: int) -> Callable[..., None]:
    """In place of what follows the phases: signals as such a phase begins."""
    followed = TouchingRobot._begin

    def phase_began(self: TouchingRobot, began: Phase, time_ns: int) -> None:
        followed(self, began, time_ns)
        if began is phase:
            for number in numbers:
                signal.raise_signal(number)

    return phase_began


@pytest.mark.usefixtures("quick_scene")
@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_ctrl_c_stops_the_arm_and_keeps_all(number: int, status: int, tmp_path: Path, monkeypatch: Patch) -> None:
    record, told, terminal = tmp_path / "e.rrd", tmp_path / "e.json", Terminal()
    monkeypatch.setattr(TouchingRobot, "_begin", interrupted_at(Phase.DWELL, number))
    monkeypatch.setattr(sys, "stderr", terminal)
    assert main(["explore", "lab:two-60-150", *STOPPED, "--record", str(record), "--json", str(told)]) == status
    said = terminal.getvalue()
    assert "Ctrl-C again to leave immediately" in said
    assert "the arm is stopped" in said
    assert "Traceback" not in said
    assert re.search(r"\r\x1b\[Ktouch 1: press \d\.\d N \d+\.\d mm", said)
    assert "\x1b[Ktouch 1: approach\r" in said
    found = json.loads(told.read_text())
    assert found["stop_reason"] == "stopped: a person asked"
    assert found["touches"] == []
    assert found["verdict"] is None
    assert check_recording(record).problems == []
    assert [one.item.action for one in read_results(record, (ExplorationStop,))] == ["stop"]  # type: ignore[union-attr]


@pytest.mark.slow
@pytest.mark.usefixtures("quick_scene")
def test_a_full_disk_halts_the_arm_first(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    began: list[Phase] = []
    stopped: list[str] = []
    free = shutil.disk_usage
    noticed = threading.Event()

    def filling(path: Path) -> Any:
        usage = free(path)
        if Phase.APPROACH not in began:
            return usage
        noticed.set()
        return usage._replace(free=0)

    def phase_began(self: TouchingRobot, phase: Phase, time_ns: int) -> None:
        began.append(phase)
        if phase is Phase.APPROACH:
            assert noticed.wait(PATIENCE_S)  # a simulated arm is faster than any look at a disk

    def leave(self: RigSource, *error: object) -> None:
        """As the devices are closed: how the arm stands."""
        arm = cast("Any", next(member.device for member in self._members if member.name == "arm"))
        stopped.append(arm.stopped_because)
        self.close()

    monkeypatch.setattr(shutil, "disk_usage", filling)
    monkeypatch.setattr(TouchingRobot, "_begin", phase_began)
    monkeypatch.setattr(RigSource, "__exit__", leave)
    monkeypatch.setattr("deformscope.recording.rrd_file.BEAT_S", 0.0)
    record = tmp_path / "e.rrd"

    assert main(["explore", "lab:two-60-150", *STOPPED, "--record", str(record)]) == 2
    shown = capsys.readouterr()
    assert "MiB free on the disk" in shown.err.strip().splitlines()[-1]
    assert Phase.PRESS not in began
    assert stopped == ["its monitor failed: RecordingError"]
    assert re.search(r"^  touches +0, ", shown.out, re.MULTILINE)  # what is known, and that the arm is at rest
    assert re.search(r"^  arm +at rest$", shown.out, re.MULTILINE)
    assert list(tmp_path.glob("*.part.rrd"))


@pytest.mark.slow
@pytest.mark.usefixtures("quick_scene")
def test_the_robot_is_watched_while_the_disk_blocks(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """From one phase to another no flush comes back: what looks at the force goes on as before."""
    blocks, free, given_up = threading.Event(), threading.Event(), list[bool]()
    looks = 0
    flush, judge, followed = RecordingFile.flush, Supervisor.judge, TouchingRobot._begin

    def slow(self: RecordingFile) -> None:
        if Phase.APPROACH in begun and not free.is_set():
            blocks.set()
            given_up.append(not free.wait(PATIENCE_S))
        flush(self)

    def looked(self: Supervisor, *given: Any, **named: Any) -> Any:
        nonlocal looks
        looks += blocks.is_set() and not free.is_set()
        return judge(self, *given, **named)

    begun: list[Phase] = []

    def phase_began(self: TouchingRobot, phase: Phase, time_ns: int) -> None:
        begun.append(phase)
        if phase is Phase.APPROACH:
            assert blocks.wait(PATIENCE_S)
        if phase is Phase.RETREAT:
            free.set()
        followed(self, phase, time_ns)

    monkeypatch.setattr(RecordingFile, "flush", slow)
    monkeypatch.setattr(Supervisor, "judge", looked)
    monkeypatch.setattr(TouchingRobot, "_begin", phase_began)
    monkeypatch.setattr("deformscope.recording.rrd_file.BEAT_S", 0.0)
    monkeypatch.setattr("deformscope.recording.recorder.AHEAD_JOBS", 1000)  # as of devices that go on by themselves
    record = tmp_path / "e.rrd"
    once = ["--touches", "1", *STOPPED[2:]]

    assert main(["explore", "lab:two-60-150", *once, "--record", str(record)]) == 0, capsys.readouterr().err
    assert given_up == [False]
    assert looks > 300  # of the approach, the press and the dwell, a hundred a second
    assert check_recording(record).problems == []
    assert verify_here(record) == 0


@pytest.mark.slow
def test_beneath_a_gripper_it_finds_what_it_finds_beneath_capsules(tmp_path: Path) -> None:
    record, told = tmp_path / "e.rrd", tmp_path / "e.json"
    arguments = ["explore", "lab:two-60-150", "--touches", "3", "--viewer", "none", "--json", str(told)]
    iou = []
    for more in ([], ["--robot", "gripper", "--record", str(record)]):
        assert main([*arguments, *more]) == 0
        iou.append(json.loads(told.read_text())["truth"]["iou"])
    assert iou[1] == pytest.approx(iou[0], abs=0.02)
    assert main(["replay", str(record), "--json", str(told)]) == 0
    assert json.loads(told.read_text())["identical"]
