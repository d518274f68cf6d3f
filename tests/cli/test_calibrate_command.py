"""`calibrate`, `replay` and `demo` as a user calls them: results, files, and one-line errors."""

import dataclasses
import hashlib
import io
import json
import shutil
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.config import BetaConfig
from deformscope.config.images import ImageOptions
from deformscope.experiments.live import replay_stages
from deformscope.frames import StageCost
from deformscope.recording.items import read_estimates
from deformscope.recording.ledger import ledger_path
from deformscope.recording.reader import Replay
from deformscope.runs import replay_result
from deformscope.stages.fit.estimate import Posterior
from deformscope.stages.msm import reference
from tests.cases import Capture, Patch, one_line
from tests.rounding import differing_by_more
from tests.stages import reference_states
from tests.stages.bodies import pushed
from tests.stages.see.scenes import Scene, render

ROOT = Path(__file__).resolve().parents[2]
FAST = ["--candidates", "12", "--viewer", "none"]


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pair of known beta 0.6, without noise."""
    body = pushed((5, 6), np.random.default_rng(1))
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    deformed, _ = reference_states.relax(spec, body.held_position, beta=0.6)
    path = tmp_path_factory.mktemp("pair") / "pair.npz"
    np.savez(path, rest=body.rest, deformed=deformed, held=body.held)
    return path


@pytest.fixture(scope="module")
def recorded(pair: Path) -> Path:
    """A recording of its fit."""
    record = pair.with_name("run.rrd")
    assert main(["calibrate", "beta", str(pair), *FAST, "--record", str(record)]) == 0
    return record


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four images of a speckled block, stretched upwards a little more in each; exact by construction."""
    folder = tmp_path_factory.mktemp("frames")
    speckle = cv2.GaussianBlur(np.random.default_rng(2).normal(128, 60, (160, 120)).astype(np.float32), (0, 0), 1.3)
    speckle = np.clip(128 + 2.5 * (speckle - 128), 0, 255).astype(np.float32)
    y, x = np.mgrid[:160, :120].astype(np.float32)
    for index in range(4):
        strain = 0.01 * index
        moved = cv2.remap(speckle, x, (y + strain * 150) / (1 + strain), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        cv2.imwrite(str(folder / f"img{index + 8}.png"), moved.clip(0, 255).astype(np.uint8))
    return folder


def run_json(arguments: list[str], capsys: Capture) -> Any:
    assert main([*arguments, *FAST, "--json", "-"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def failure(arguments: list[str], capsys: Capture) -> str:
    assert main(arguments) == 2
    said = one_line(capsys)
    assert said.startswith("deformscope: error: ")
    return said


def test_pair_json_is_the_public_contract(pair: Path, capsys: Capture) -> None:
    found = run_json(["calibrate", "beta", str(pair), "--cluster-size", "3"], capsys)
    assert found["parameter"] == "beta"
    assert found["value"] == pytest.approx(0.6, abs=1e-3)
    assert found["interval"][0] <= found["value"] <= found["interval"][1]
    assert found["level"] == 0.9
    assert found["verdict"] == "identified"
    assert found["stiffness_verdict"] == "unidentified"
    assert found["converged"] is True
    assert found["explained"] == found["identifiability"]["explained"]
    assert found["explained"] > 0.99
    assert found["aee_px"] is None
    assert 0 <= found["aee_m"] < found["aee_free_m"] < 1e-6
    assert len(found["curve"]["parameter"]) == len(found["curve"]["aee"]) == 12
    assert found["settings"]["cluster_size"] == 3
    assert found["settings"]["mode"] == "linear"
    assert "stiffness_n_per_m" not in found


def test_several_pairs_give_a_list_and_joint_one(pair: Path, tmp_path: Path, capsys: Capture) -> None:
    other = tmp_path / "other.npz"
    shutil.copy(pair, other)
    assert len(run_json(["calibrate", "beta", str(pair), str(other)], capsys)) == 2
    assert run_json(["calibrate", "beta", str(pair), str(other), "--joint"], capsys)["settings"]["pairs"] == 2


def test_a_page_shows_the_fit_and_waits_for_nobody(pair: Path, tmp_path: Path, capsys: Capture) -> None:
    flags = ["--viewer", "page", "--json", str(tmp_path / "fit.json")]
    assert main(["calibrate", "beta", str(pair), *FAST, *flags]) == 0
    assert "viewer: http://127.0.0.1:" in capsys.readouterr().err
    plain = run_json(["calibrate", "beta", str(pair)], capsys)
    assert json.loads((tmp_path / "fit.json").read_text())["value"] == plain["value"]


def test_force_gives_a_stiffness(pair: Path, tmp_path: Path, capsys: Capture) -> None:
    with np.load(pair) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(tmp_path / "force.npz", **arrays, force_n=2.0)
    found = run_json(["calibrate", "beta", str(tmp_path / "force.npz")], capsys)
    low, high = found["stiffness_n_per_m"]["interval"]
    assert 0 < low <= found["stiffness_n_per_m"]["value"] <= high
    assert found["stiffness_verdict"] == "identified"


def test_images_give_pixels_and_with_a_scale_metres(frames: Path, capsys: Capture) -> None:
    arguments = ["calibrate", "beta", str(frames), "--grid", "6x5", "--held", "top,bottom"]
    found = run_json(arguments, capsys)
    assert found["aee_m"] is None
    assert found["aee_px"] < 0.2
    assert found["settings"]["frames"] == 4
    assert found["settings"]["particles"] == 30
    scaled = run_json([*arguments, "--px-per-cm", "20"], capsys)
    assert scaled["aee_px"] == pytest.approx(found["aee_px"])
    assert scaled["aee_m"] == pytest.approx(found["aee_px"] * 0.01 / 20)


@pytest.mark.slow  # the whole fit of theta
def test_image_files_in_the_order_given_stride_and_theta(frames: Path, capsys: Capture) -> None:
    files = [str(frames / f"img{n}.png") for n in (8, 9, 10, 11)]
    found = run_json(["calibrate", "theta", *files, "--stride", "3", "--grid", "5x5"], capsys)
    assert found["parameter"] == "theta"
    assert found["settings"]["frames"] == 2


@pytest.mark.slow
def test_sample_brings_its_own_particles(capsys: Capture) -> None:
    found = run_json(["calibrate", "beta", "sample:tension", "--stride", "3"], capsys)
    assert found["settings"]["frames"] == 3
    assert found["settings"]["particles"] == 117


def test_the_whole_motion_of_a_sequence_and_what_was_selected(frames: Path, tmp_path: Path, capsys: Capture) -> None:
    record = tmp_path / "motion.rrd"
    asked = ["calibrate", "beta", str(frames), "--grid", "6x5", "--whole-motion", "--select", "held,cluster-size"]
    found = run_json([*asked, "--record", str(record)], capsys)
    settings = found["settings"]
    assert settings["whole_motion"] is True
    assert settings["frames_fitted"] == len(settings["frame_weights"]) == len(settings["frame_values"]) == 3
    assert found["interval"][0] <= found["value"] <= found["interval"][1]
    assert {row["cluster_size"] for row in found["selection"]} == {2, 3, 4, 5}
    assert sum(row["chosen"] for row in found["selection"]) == 1
    used = next(row for row in found["selection"] if row["chosen"])
    assert (used["cluster_size"], used["held"]) == (settings["cluster_size"], settings["held_parts"])
    assert used["held_out_aee"] <= 1.01 * min(row["held_out_aee"] for row in found["selection"])
    assert main(["replay", str(record), "--viewer", "none", "--json", "-"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out) == found
    assert "identical" in shown.err


def test_flags_of_a_whole_motion_that_cannot_be(frames: Path, pair: Path, capsys: Capture) -> None:
    assert "--whole-motion with --select" in failure(["calibrate", "beta", str(frames), "--select", "held"], capsys)
    assert "images with --whole-motion" in failure(["calibrate", "beta", str(pair), "--whole-motion"], capsys)
    moving = ["calibrate", "beta", str(frames), "--whole-motion", "--select", "alpha"]
    assert "--fps" in failure(moving, capsys)
    assert "comma list" in failure([*moving[:-1], "colour"], capsys)


@pytest.mark.parametrize("kind", ["images", "pair"])
def test_replay_gives_the_recorded_numbers(
    kind: str, frames: Path, pair: Path, tmp_path: Path, capsys: Capture
) -> None:
    record = tmp_path / "run.rrd"
    source = [str(frames), "--grid", "6x5"] if kind == "images" else [str(pair)]
    first = run_json(["calibrate", "beta", *source, "--record", str(record)], capsys)
    assert main(["replay", str(record), "--viewer", "none", "--json", "-"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out) == first
    assert "identical" in shown.err
    # a recording is a source, too
    assert run_json(["calibrate", "beta", str(record), *source[1:]], capsys)["value"] == first["value"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            lambda one: {"value": one.value + 0.02 * max(one.interval[1] - one.interval[0], 1e-6)},
            "expected the recorded",
        ),
        (lambda one: {"posterior": Posterior(one.posterior.parameter, 2.0 * one.posterior.density)}, "within 0 "),
        (lambda one: {"settings": one.settings | {"device": "another"}}, "identical to"),
    ],
    ids=["value", "posterior", "settings"],
)
def test_replay_compares_numbers(
    change: Callable[[Any], dict[str, Any]], expected: str, recorded: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    (one,) = read_estimates(Replay(recorded))
    monkeypatch.setattr("deformscope.runs.replay.read_estimates", lambda _: [dataclasses.replace(one, **change(one))])
    main(["replay", str(recorded), "--viewer", "none"])
    assert expected in capsys.readouterr().err


def test_replay_refuses_a_changed_recording(recorded: Path, tmp_path: Path, capsys: Capture) -> None:
    record = Path(shutil.copy(recorded, tmp_path))
    shutil.copy(ledger_path(recorded), tmp_path)
    raw = bytearray(record.read_bytes())
    raw[len(raw) // 2] ^= 1
    record.write_bytes(raw)
    assert "ledger" in failure(["replay", str(record), "--viewer", "none"], capsys)


def test_existing_recording_needs_overwrite(pair: Path, recorded: Path, tmp_path: Path, capsys: Capture) -> None:
    record = Path(shutil.copy(recorded, tmp_path))
    arguments = ["calibrate", "beta", str(pair), *FAST, "--record", str(record)]
    before = record.read_bytes()
    assert "--overwrite" in failure(arguments, capsys)
    assert record.read_bytes() == before
    assert main([*arguments, "--overwrite"]) == 0


def test_demo_leaves_a_recording_each_time(tmp_path: Path, monkeypatch: Patch, capsys: Capture) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.MonkeyPatch.context() as moment:
        moment.setattr("deformscope.cli.demo.calibrate", lambda config: config.output.record.touch())
        assert main(["demo", "--images"]) == 0
    (first,) = (tmp_path / "runs").glob("demo-*.rrd")
    monkeypatch.setattr("deformscope.cli.demo.BetaConfig", partial(BetaConfig, images=ImageOptions(stride=6)))
    assert main(["demo", "--images"]) == 0
    (newest,) = set((tmp_path / "runs").glob("demo-*.rrd")) - {first}
    shown = capsys.readouterr().out
    assert "beta" in shown
    assert "runs/demo-" in shown
    assert Replay(newest).outcome["complete"]
    (estimate,) = read_estimates(Replay(newest))
    assert estimate.verdict in ("identified", "weak", "at-bound", "unidentified")


@pytest.mark.slow
def test_committed_recordings_are_what_their_manifest_says(capsys: Capture, monkeypatch: Patch) -> None:
    """And what is computed of them again is the same: words and verdicts equal, numbers within 1e-6, as other
    processors may round otherwise."""
    monkeypatch.setattr(replay_result, "differing", differing_by_more)
    monkeypatch.setattr(
        replay_stages, "_difference", lambda before, now: 0.0 if not differing_by_more(before, now) else 1
    )
    manifest = tomllib.loads((ROOT / "recordings" / "manifest.toml").read_text(encoding="utf-8"))
    listed = {entry["file"] for entry in manifest["recording"]}
    assert listed == {path.name for path in (ROOT / "recordings").glob("*.rrd")}
    for entry in manifest["recording"]:
        path = ROOT / "recordings" / entry["file"]
        assert hashlib.sha256(path.read_bytes()).hexdigest() == entry["sha256"]
        assert path.stat().st_size < 3_000_000
        assert main(["replay", str(path), "--viewer", "none"]) == 0, capsys.readouterr().err


def test_a_number_that_differs_by_more_is_noticed() -> None:
    whole = StageCost("flow", 2.0, 1.0)
    assert differing_by_more(whole, StageCost("flow", 2.0 + 1e-6, 1.0)) is None
    assert differing_by_more(whole, StageCost("flow", 2.0 + 3e-6, 1.0)) == "wall_ms"
    assert differing_by_more(whole, StageCost("beta", 2.0, 1.0)) == "stage"


def _pair(path: Path, **changed: Any) -> str:
    rest = np.stack(np.meshgrid(np.arange(4), np.arange(4), indexing="ij"), -1).reshape(-1, 2) * 0.01
    np.savez(path, **({"rest": rest, "deformed": rest + 1e-4, "held": np.arange(4)} | changed))
    return str(path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none.mp4"], "nothing there"),
        (["none.npz"], "no such file"),
        (["text.mp4"], "text.mp4"),
        (["one"], "two frames"),
        (["img.png"], "two frames"),
        (["frames", "--roi", "100,100,500,500"], "region inside"),
        (["frames", "--roi", "1,2,3"], "x,y,width,height"),
        (["frames", "--grid", "500x500"], "spacing"),
        (["frames", "--held", "middle"], "middle"),
        (["frames", "--held", "contact"], "--contact"),
        (["frames", "--contact", "100,5,1,1", "--grid", "4x4"], "contact"),
        (["frames", "--grid", "2x2", "--held", "border"], "held"),
        (["frames", "--mask", "none.png"], "none.png"),
        (["frames", "--mask", "small.png"], "size"),
        (["frames", "--noise-m", "0.1"], "--noise-px"),
        (["frames", "--joint"], "pair files"),
        (["frames", "good.npz"], "either"),
        (["good.npz", "--grid", "3x3"], "no flags about images"),
        (["good.npz", "--noise-px", "1"], "--noise-m"),
        (["good.npz", "--beta-range", "0.9,0.1"], "rises"),
        (["good.npz", "--beta-range", "0,1.5"], "within"),
        (["good.npz", "--beta-range", "0,1"], "within"),
        (["good.npz", "--level", "1.5"], "--level"),
        (["good.npz", "--candidates", "1"], "--candidates"),
        (["good.npz", "--json", "no/such/folder.json"], "folder"),
        (["good.npz", "--record", "/proc/none.rrd"], "/proc"),
        (["good.npz", "--record", "out.txt"], ".rrd"),
        (["nan.npz"], "NaN"),
        (["held-none.npz"], "held"),
        (["held-all.npz"], "free"),
        (["twice.npz"], "duplicate"),
        (["text.npz"], "pair file"),
        (["cut.npz"], "pair file"),
        ([], "SOURCE"),
        (["good.npz", "--no-such-flag"], "--no-such-flag"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], words: str, frames: Path, tmp_path: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(frames, tmp_path / "frames")
    (tmp_path / "one").mkdir()
    shutil.copy(frames / "img8.png", tmp_path / "one")
    shutil.copy(frames / "img8.png", tmp_path / "img.png")
    (tmp_path / "text.mp4").write_text("not a video\n")
    (tmp_path / "text.npz").write_text("not an archive\n")
    cv2.imwrite(str(tmp_path / "small.png"), np.full((10, 10), 255, np.uint8))
    rest = np.load(io.BytesIO(Path(_pair(tmp_path / "good.npz")).read_bytes()))["rest"]
    _pair(tmp_path / "nan.npz", deformed=np.where(rest == rest.max(), np.nan, rest))
    _pair(tmp_path / "held-none.npz", held=np.array([], dtype=int))
    _pair(tmp_path / "held-all.npz", held=np.arange(16))
    _pair(tmp_path / "twice.npz", rest=np.concatenate([rest[:1], rest[:-1]]))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:300])
    viewer = [] if not arguments else ["--viewer", "none"]
    assert words in failure(["calibrate", "beta", *arguments, *viewer], capsys)
    assert not list(tmp_path.glob("*.rrd"))


@pytest.mark.parametrize("path", ["none.rrd", "text.rrd"])
def test_replay_of_what_is_no_recording(path: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "text.rrd").write_text("no recording")
    assert path in failure(["replay", str(tmp_path / path), "--viewer", "none"], capsys)


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four images of a block that a tool presses, on a background."""
    folder = tmp_path_factory.mktemp("pressed")
    for index, one in enumerate(render(Scene(frames=4))):
        cv2.imwrite(str(folder / f"{index}.png"), one[:, :, ::-1])
    return folder


KNOWN = ["--scale-from", "60,330,420,330=90mm"]


def assert_setup_is_drawn(drawn: Path, *, contact: bool) -> None:
    """The known length, the outline, and what is in contact where it was found."""
    picture = cv2.imread(str(drawn)).astype(int)
    blue = np.abs(picture - (178, 114, 0)).max(axis=2) < 30  # the known length's
    assert np.ptp(np.nonzero(blue.any(axis=0))[0]) / picture.shape[1] == pytest.approx(360 / 480, abs=0.06)
    green = np.abs(picture - (115, 158, 0)).max(axis=2) < 30  # the outline's colour, as OpenCV orders it
    rows, columns = np.nonzero(green)
    wide = np.ptp(columns[rows > picture.shape[0] // 3])
    assert wide / picture.shape[1] == pytest.approx(240 / 480, abs=0.06)
    assert (np.count_nonzero(np.abs(picture - (167, 121, 204)).max(axis=2) < 30) > 100) == contact


def test_a_body_that_no_flag_names_is_found_and_drawn_and_its_flags_give_the_same(
    pressed: Path, tmp_path: Path, capsys: Capture
) -> None:
    record, drawn = tmp_path / "found.rrd", tmp_path / "setup.png"
    command = ["calibrate", "beta", str(pressed), *FAST, *KNOWN]
    assert main([*command, "--setup-picture", str(drawn), "--record", str(record), "--json", "-"]) == 0
    shown = capsys.readouterr()
    assert_setup_is_drawn(drawn, contact=True)
    found = json.loads(shown.out)
    flags = found["settings"]["found"]["flags"]
    assert flags in shown.err
    assert found["settings"]["held_parts"] == ["bottom", "contact"]
    assert found["settings"]["found"]["sure"] is True
    copied = run_json(["calibrate", "beta", str(pressed), *KNOWN, *flags.split()], capsys)
    assert (copied["value"], copied["interval"]) == (found["value"], found["interval"])
    assert main(["replay", str(record), "--viewer", "none", "--json", "-"]) == 0
    replayed = capsys.readouterr()
    assert json.loads(replayed.out) == found
    assert "identical" in replayed.err


def test_a_body_that_is_not_surely_found_leaves_a_weak_verdict(
    pressed: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    monkeypatch.setattr("deformscope.stages.see.find_body.SURE", 1.01)
    found = run_json(["calibrate", "beta", str(pressed)], capsys)
    assert found["verdict"] != "identified"
    reason = next(one for one in found["reasons"] if one["code"] == "body-unsure")
    assert reason["allows"] == "weak"
    assert "region (--outline or --roi)" in reason["text"]


def test_two_scenes_are_one_line(pressed: Path, tmp_path: Path, capsys: Capture) -> None:
    files = sorted(pressed.glob("*.png"))
    for index, file in enumerate(files):
        image = cv2.imread(str(file))
        cv2.imwrite(str(tmp_path / f"{index}.png"), image if index < 2 else image[:, ::-1])
    assert "expected images of one scene" in failure(["calibrate", "beta", str(tmp_path)], capsys)


def test_the_setup_is_drawn_of_a_body_that_is_named(pressed: Path, tmp_path: Path, capsys: Capture) -> None:
    drawn = tmp_path / "setup.png"
    named = ["--grid", "6x5", "--roi", "110,120,240,170", "--setup-picture", str(drawn)]
    run_json(["calibrate", "beta", str(pressed), *FAST, *KNOWN, *named], capsys)
    assert_setup_is_drawn(drawn, contact=False)
