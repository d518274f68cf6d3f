"""However an exploration ends, the arm is told to stand, and what is known is reported."""

import errno
import json
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.recording.items import read_results
from deformscope.recording.lateness import RecordingError
from deformscope.stages.map.exploration import MapEstimate, StageFailure
from tests.cases import Capture, Patch, slow_but
from tests.cli.fake_bench import FakeBench, FakeRobot, use_fake_bench
from tests.verified import verify_here

EXPLORE = ["explore", "lab:two-60-150", "--touches", "4", "--viewer", "none"]
TWICE = ["2" if word == "4" else word for word in EXPLORE]
"""Where it is not what is found that counts."""
EXPLORER = "deformscope.experiments.explore.explorer"
STAGES = {
    "contact": "deformscope.experiments.explore.explorer.fit_approach",
    "regions": "deformscope.stages.regions.posterior.RegionPosterior.with_touch",
    "maps": "deformscope.stages.regions.posterior.RegionPosterior.region_map",
    "surface": "deformscope.stages.map.surface.HeightProcess.at",
    "beta": f"{EXPLORER}.fit_beta",
    "beta field": f"{EXPLORER}.Explorer._beta_field",
    "display": "deformscope.log.exploration.display.log_maps",
}
ERRORS = [
    ValueError("x must be strictly increasing"),
    np.linalg.LinAlgError("Singular matrix"),
    FloatingPointError("overflow"),
    InputError("points near the touch", "none"),
    MemoryError(),
]
QUICK = ("contact", 0)
"""The stage and the number of the error that are not slow together."""


@pytest.fixture
def bench(monkeypatch: Patch) -> FakeBench:
    return use_fake_bench(monkeypatch)


def fail_on(monkeypatch: Patch, target: str, touch: int | None, error: Exception) -> None:
    """A function fails once while this touch is estimated or shown (0: what comes before), or always at every one."""
    where, _, name = target.rpartition(".")
    made: list[object] = []
    failed: list[int] = []
    touch_of = FakeRobot.touch

    def counted(robot: FakeRobot, *arguments: Any) -> Any:
        made.append(robot)
        return touch_of(robot, *arguments)

    monkeypatch.setattr(FakeRobot, "touch", counted)
    owner = _owner(where)
    whole = getattr(owner, name)

    def failing(*arguments: Any, **options: Any) -> Any:
        maps = [each for each in arguments if isinstance(each, MapEstimate)]
        number = len(maps[0].contacts_m) if maps else len(made)  # a picture may be drawn while later touches are made
        if touch == number and not failed:
            failed.append(touch)
            raise error
        if touch is None and made:
            raise error
        return whole(*arguments, **options)

    monkeypatch.setattr(owner, name, failing)


def _owner(path: str) -> Any:
    import importlib

    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        module, _, name = path.rpartition(".")
        return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize(
    ("stage", "error"),
    [
        pytest.param(stage, error, marks=() if (stage, number) == QUICK else pytest.mark.slow)
        for stage in STAGES
        for number, error in enumerate(ERRORS)
    ],
)
def test_a_stage_that_fails_on_one_touch_does_not_end_it(
    stage: str, error: Exception, bench: FakeBench, tmp_path: Path, capsys: Capture
) -> None:
    files = {name: tmp_path / f"e.{name}" for name in ("rrd", "json", "npz", "png")}
    arguments = ["--record", str(files["rrd"]), "--json", str(files["json"]), "--map", str(files["npz"])]
    with pytest.MonkeyPatch.context() as monkeypatch:
        fail_on(monkeypatch, STAGES[stage], 2, error)
        assert main([*EXPLORE, *arguments, "--picture", str(files["png"])]) == 0, capsys.readouterr().err
    shown = capsys.readouterr()
    found = json.loads(files["json"].read_text())
    assert [len(touch["failed"]) > 0 for touch in found["touches"]] == [False, True, False, False]
    (failed,) = found["touches"][1]["failed"]
    assert failed.startswith(f"{stage}: ")
    assert found["stop_reason"] == "budget"
    assert found["region_count"] == 2
    assert f"touch 2: {stage} failed: " in shown.out
    assert (found["touches"][1]["apparent_stiffness_n_per_mm"] is None) == (stage == "contact")
    assert not bench.robots[-1].moving
    assert files["png"].read_bytes().startswith(b"\x89PNG")
    assert files["npz"].exists()
    (recorded,) = (one.item for one in read_results(files["rrd"], (StageFailure,)))
    assert isinstance(recorded, StageFailure)
    assert (recorded.stage, recorded.touch) == (stage, 2)
    assert "in failing" in recorded.trace
    assert main(["replay", str(files["rrd"])]) == 0, capsys.readouterr().err
    assert f"touch 2: {stage} failed: " in capsys.readouterr().err.replace("\n", " ")


@pytest.mark.parametrize(
    ("stage", "touches"),
    [
        ("contact", 3),
        ("look", 0),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in (("regions", 3), ("maps", 3), ("plan", 1))),
    ],
)
def test_failures_without_end_end_it_in_order(
    stage: str, touches: int, bench: FakeBench, tmp_path: Path, capsys: Capture
) -> None:
    plan, look = (
        "deformscope.experiments.explore.search.plan_touch",
        "deformscope.experiments.explore.seen_surface.fit_surface",
    )
    targets = STAGES | {"plan": plan, "look": look}
    record, told = tmp_path / "e.rrd", tmp_path / "e.json"
    with pytest.MonkeyPatch.context() as monkeypatch:
        fail_on(monkeypatch, targets[stage], touches and None, ZeroDivisionError("division by zero"))
        assert main([*EXPLORE, "--record", str(record), "--json", str(told)]) == 2
    shown = capsys.readouterr()
    found = json.loads(told.read_text())
    assert len(found["touches"]) == touches
    assert found["stop_reason"] == "stopped: estimates failed"
    assert "division by zero" in found["fault"]["reason"]
    assert "the arm is stopped" in shown.err.splitlines()[-1]
    assert len({tuple(touch["xy_m"]) for touch in found["touches"]}) == touches  # none is made twice
    assert verify_here(record) == 0
    assert main(["replay", str(record)]) == 0, capsys.readouterr().err


ROBOT = [f"tests.cli.fake_bench.FakeRobot.{name}" for name in ("look", "touch", "let_move", "carry_out", "reports")]
RECORDER = [f"deformscope.recording.recorder.Recorder.{name}" for name in ("_take_step", "_take_items")]
WATCH = ["deformscope.runs.skeleton.Watch.__call__"]
COMMAND = [
    "deformscope.runs.exploration_run._remarks",
    "deformscope.experiments.explore.explore.Exploration.add",
    f"{EXPLORER}.ExplorationStages.touch",
]
ENDS: list[BaseException] = [
    RuntimeError("a bug"),
    KeyboardInterrupt(),
    RecordingError("64 MiB free on the disk", "0 MiB free"),
    OSError(errno.ENOSPC, "No space left on device"),
]


def fail_once(monkeypatch: Patch, target: str, at: int, error: BaseException) -> list[int]:
    """The call with this number raises; the calls that were made."""
    where, _, name = target.rpartition(".")
    owner = _owner(where)
    whole, calls = getattr(owner, name), [0]

    def failing(*arguments: Any, **options: Any) -> Any:
        calls[0] += 1
        if calls[0] == at:
            raise error
        return whole(*arguments, **options)

    monkeypatch.setattr(owner, name, failing)
    return calls


def ends_well(target: str, at: int, error: BaseException, bench: FakeBench, tmp_path: Path, monkeypatch: Patch) -> bool:
    """Explore with a call that fails; whether it was reached."""
    calls = fail_once(monkeypatch, target, at, error)
    told = tmp_path / "e.json"
    status = main([*TWICE, "--json", str(told), "--picture", str(tmp_path / "e.png")])
    if calls[0] < at:
        assert status == 0
        return False
    (robot,) = bench.robots
    refused = isinstance(error, InputError | OSError)
    assert status == (130 if isinstance(error, KeyboardInterrupt) else 2 if refused else 1)
    assert robot.halts
    assert not robot.moving
    if told.exists():  # it could move, so that it is told what came of it
        found = json.loads(told.read_text())
        assert found["arm_stands"]
        assert found["stop_reason"].startswith("error: ")
        assert (tmp_path / "e.png").exists() == (found["verdict"] is not None)
    else:
        assert target.endswith("let_move") or at == 1
    return True


@pytest.mark.parametrize(
    ("target", "at", "error"),
    [
        (ROBOT[1], 2, ENDS[0]),
        (RECORDER[0], 5, ENDS[2]),
        (WATCH[0], 12, ENDS[1]),
        (WATCH[0], 12, ENDS[3]),
        (COMMAND[2], 1, ENDS[0]),
    ],
)
def test_an_error_leaves_the_arm_standing_and_what_is_known(
    target: str, at: int, error: BaseException, bench: FakeBench, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    assert ends_well(target, at, error, bench, tmp_path, monkeypatch)
    shown = capsys.readouterr()
    assert re.search(r"^  arm +at rest$", shown.out, re.MULTILINE)
    assert "  touches " in shown.out
    assert "Traceback" not in shown.err


@pytest.mark.slow
@pytest.mark.parametrize("error", ENDS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("target", [*ROBOT, *RECORDER, *WATCH, *COMMAND])
def test_every_call_may_fail(target: str, error: BaseException, tmp_path: Path, capsys: Capture) -> None:
    for at in range(1, 200):
        with pytest.MonkeyPatch.context() as monkeypatch:
            (tmp_path / "e.json").unlink(missing_ok=True)
            (tmp_path / "e.png").unlink(missing_ok=True)
            if not ends_well(target, at, error, use_fake_bench(monkeypatch), tmp_path, monkeypatch):
                break
    assert 1 < at < 199


def test_an_interrupted_halt_is_tried_again(bench: FakeBench, capsys: Capture, monkeypatch: Patch) -> None:
    fail_once(monkeypatch, "tests.cli.fake_bench.FakeRobot.halt", 1, KeyboardInterrupt())
    fail_once(monkeypatch, "tests.cli.fake_bench.FakeRobot.touch", 2, RuntimeError("a bug"))
    assert main(TWICE) == 1
    assert len(bench.robots[0].halts) == 1
    assert re.search(r"^  arm +at rest$", capsys.readouterr().out, re.MULTILINE)


def test_an_arm_that_was_not_reached_is_told_loudly(bench: FakeBench, capsys: Capture, monkeypatch: Patch) -> None:
    monkeypatch.setattr(FakeRobot, "halt", lambda robot, reason: False)
    fail_once(monkeypatch, "tests.cli.fake_bench.FakeRobot.touch", 2, RuntimeError("a bug"))
    assert main(TWICE) == 1
    assert "COULD NOT BE STOPPED" in capsys.readouterr().out


@pytest.mark.parametrize(("flag", "name"), [("--picture", "e.png"), ("--map", "e.npz"), ("--json", "e.json")])
def test_an_output_that_cannot_be_written_does_not_keep_the_others(
    flag: str, name: str, bench: FakeBench, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    outputs = {"--picture": tmp_path / "e.png", "--map": tmp_path / "e.npz", "--json": tmp_path / "e.json"}
    arguments = [word for pair in outputs.items() for word in map(str, pair)]
    replaced = Path.replace

    def replace(path: Path, target: Path) -> Path:
        if target.name == name:
            raise OSError(errno.ENOSPC, "No space left on device")
        return replaced(path, target)

    monkeypatch.setattr(Path, "replace", replace)
    assert main([*TWICE, *arguments]) == 2
    shown = capsys.readouterr()
    assert "no space left on device" in shown.err.splitlines()[-1]
    assert name in shown.err.splitlines()[-1]
    assert [path.exists() for path in outputs.values()] == [one != flag for one in outputs]
    assert "  verdict " in shown.out


@pytest.mark.parametrize("number", slow_but([signal.SIGTERM], [signal.SIGTERM, signal.SIGHUP]))
def test_a_signal_while_it_computes_is_no_loss(
    number: int, bench: FakeBench, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    """It comes with the last touch, when no control period follows that could notice it."""
    touch_of: Callable[..., Any] = FakeRobot.touch
    made: list[int] = []

    def touch(robot: FakeRobot, *arguments: Any) -> Any:
        touched = touch_of(robot, *arguments)
        made.append(len(made) + 1)
        if made[-1] == 2:
            signal.raise_signal(number)
        return touched

    monkeypatch.setattr(FakeRobot, "touch", touch)
    told = tmp_path / "e.json"
    assert main([*TWICE, "--json", str(told)]) == 128 + number
    assert len(json.loads(told.read_text())["touches"]) == 2
    assert "the arm is stopped" in capsys.readouterr().err


def test_a_second_ctrl_c_leaves_at_once(bench: FakeBench, tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    def interrupted(robot: FakeRobot, *arguments: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(FakeRobot, "touch", interrupted)
    record = tmp_path / "e.rrd"
    assert main([*TWICE, "--record", str(record)]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert bench.robots[0].halts
    assert not record.exists()
    assert list(tmp_path.glob("*.part.rrd"))


def test_terminal_json_panel_and_map_file_give_the_same_numbers(
    bench: FakeBench, tmp_path: Path, capsys: Capture
) -> None:
    from deformscope.log.exploration.display import summary
    from deformscope.stages.map.exploration import MapEstimate

    record, told, arrays = tmp_path / "e.rrd", tmp_path / "e.json", tmp_path / "e.npz"
    assert main([*EXPLORE, "--record", str(record), "--json", str(told), "--map", str(arrays), "--seed", "5"]) == 0
    shown, found = capsys.readouterr().out, json.loads(told.read_text())
    *_, last = (one.item for one in read_results(record, (MapEstimate,)))
    assert isinstance(last, MapEstimate)
    panel = summary(last)

    travel = f"{found['travel_m']:.2f} m over the surface"
    assert travel in shown
    assert travel in panel
    way = np.linalg.norm(np.diff([(0.0, 0.0), *(touch["xy_m"] for touch in found["touches"])], axis=0), axis=1)
    assert found["travel_m"] == pytest.approx(way.sum())
    assert found["region_count"] == len(found["regions"]) == last.region_count == 2
    for number, region in enumerate(found["regions"], start=1):
        level = f"{np.exp(region['log_stiffness']):.3g}"
        assert re.search(rf"^  region {number} +{level} N/mm \(", shown, re.MULTILINE)
        modulus = f"about {region['modulus_pa'] / 1e3:.3g} kPa"
        assert f"; modulus {modulus} if linear" in shown
        assert f"| {number} | {level} ({modulus}) |" in panel
    probability = f"(probability {found['verdict_probability']:.2f})"
    assert f"2 regions {probability[:-1]}" in shown  # a rival may follow
    assert probability in panel
    with np.load(arrays, allow_pickle=False) as file:
        assert set(np.unique(file["labels"])) == {0, 1}
        assert (file["seed"], str(file["version"])) == (5, found["version"])
        assert str(file["scenario"]) == found["scenario"] == "lab:two-60-150"
        assert set(json.loads(str(file["units"]))) >= {"stiffness_n_per_mm", "cell_m", "labels"}
    assert found["seed"] == 5
    assert found["units"]["travel_m"] == "m"


@pytest.mark.slow
def test_a_gradual_surface_has_no_regions_anywhere(
    bench: FakeBench, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    from deformscope.stages.regions.posterior import RegionPosterior

    sure = {"1": 0.0, "2": 0.02, "3": 0.03, "4": 0.0, "5": 0.0, "gradual": 0.95}
    monkeypatch.setattr(RegionPosterior, "probability", sure)
    told, arrays = tmp_path / "e.json", tmp_path / "e.npz"
    assert main([*EXPLORE, "--json", str(told), "--map", str(arrays), "--picture", str(tmp_path / "e.png")]) == 0
    shown, found = capsys.readouterr(), json.loads(told.read_text())
    assert (found["verdict"], found["regions"], found["region_count"]) == ("gradual", [], 0)
    assert "gradual: no regions, the stiffness changes smoothly (probability 0.95)" in shown.out
    assert "region 1" not in shown.out
    assert "  map so far: gradual: no regions (probability 0." in shown.err
    with np.load(arrays) as file:
        assert (file["labels"] == -1).all()


@pytest.mark.parametrize("recorded", [True, False])
def test_what_devices_lost_is_named_and_a_whole_recording_with_losses_ends_with_3(
    recorded: bool, bench: FakeBench, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    lost = {"tip": {"readings": 12, "reconnects": 1}}
    monkeypatch.setattr("deformscope.recording.losses.losses_of", lambda report: lost)
    record = ["--record", str(tmp_path / "e.rrd")] if recorded else []
    assert main([*TWICE, *record, "--json", str(tmp_path / "e.json")]) == (3 if recorded else 0)
    shown = capsys.readouterr()
    assert "lost" in shown.out
    assert "tip: 12 readings lost, 1 reconnects" in shown.out
    assert ("the recording is complete, with losses: tip: 12 readings lost" in shown.err) == recorded
    assert json.loads((tmp_path / "e.json").read_text())["losses"] == lost
