"""`squeeze`, `dataset` and `replay` of a squeeze, on a simulated clock."""

import contextlib
import dataclasses
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.experiments.squeeze import placing
from deformscope.experiments.squeeze.tracking import REST_IMAGES
from deformscope.files.classifier_file import save_classifier
from deformscope.files.squeeze_dataset import SqueezeDataset
from deformscope.frames import ArmFrame, DepthFrame, HandFrame, TactileFrame
from deformscope.recording import items
from deformscope.recording.items import read_items, read_results
from deformscope.recording.reader import Replay, read_rows
from deformscope.rig.source import RigSource
from deformscope.robot.squeeze_plan import draw_grasp
from deformscope.robot.squeeze_setup import SqueezeSetup
from deformscope.runs import replay_squeeze
from deformscope.runs.opened_devices import SqueezeOpening
from deformscope.runs.replay_squeeze import sighted_again, squeeze_again
from deformscope.stages.squeeze import trial
from deformscope.stages.squeeze.model import ContentModel, fit_model
from deformscope.stages.squeeze.placement import ContainerSighting
from deformscope.stages.squeeze.table import LabelledTable
from deformscope_drivers.clock import Stamp
from tests.cases import Capture, Patch
from tests.experiments.toy_squeeze import ToySqueeze, limits
from tests.verified import verify_here

LABS: list[ToySqueeze] = []


@pytest.fixture(autouse=True)
def toy(monkeypatch: Patch) -> dict[str, Any]:
    """The command squeezes toy containers: a content is a stiffness."""
    changes: dict[str, Any] = {"setup": {}, "lab": {"camera": False}}

    def opening(
        name: str, content: str, container: str, session: str, seed: int, *, trusted: bool, place: str
    ) -> SqueezeOpening:
        stiffness = {"rice": 400.0, "empty": 100.0}.get(content, 250.0)
        lab = ToySqueeze(stiffness_pa_deg=stiffness, gives_deg=2.0 + 0.1 * (seed % 7), **changes["lab"])
        LABS.append(lab)
        grasp = draw_grasp(lab.container, lab.squeeze, seed)
        setup: SqueezeSetup = dataclasses.replace(lab.setup, **changes["setup"])
        if not lab.camera:
            setup = dataclasses.replace(setup, grasp=grasp)
        return SqueezeOpening(setup, {"lab": "toy"}, content or "rice", container or "box-01")

    monkeypatch.setattr("deformscope.runs.squeeze_run.squeeze_setup_of", opening)
    return changes


def squeeze(tmp_path: Path, *more: str) -> tuple[int, dict[str, Any]]:
    """Exit status and JSON of one."""
    target = tmp_path / "found.json"
    target.unlink(missing_ok=True)
    status = main(["squeeze", "lab:containers", "--viewer", "none", "--json", str(target), *more])
    return status, json.loads(target.read_text()) if target.exists() else {}


@pytest.mark.slow
def test_tactile_frames_have_their_results_where_devices_fail_to_close(
    tmp_path: Path, toy: dict[str, Any], monkeypatch: Patch
) -> None:
    close = RigSource.close

    def closes_late(source: RigSource) -> None:
        """Frames come until the end, as from devices that run by themselves."""
        setup = LABS[-1].setup
        setup.wait_until(setup.clock() + 200_000_000)
        close(source)

    @contextlib.contextmanager
    def fails_as_it_ends() -> Iterator[RigSource]:
        with LABS[-1].setup.open_source() as source:
            yield source
        raise InputError("devices that close", "one that does not")

    monkeypatch.setattr(RigSource, "close", closes_late)
    toy["setup"] = {"open_source": fails_as_it_ends}
    file = tmp_path / "r.rrd"
    assert squeeze(tmp_path, "--content", "rice", "--record", str(file))[0] != 0
    (recording,) = (path for path in tmp_path.glob("r*.rrd*") if not path.name.endswith(".ledger"))
    pressures = list(read_results(recording, (trial.FingertipPressure,), trust=True))
    frames = [item for item in read_items(recording, trust=True) if isinstance(item, TactileFrame)]
    assert len(pressures) == len(frames) > 100


def test_a_recorded_squeeze_replays_to_the_last_bit(
    tmp_path: Path, toy: dict[str, Any], capsys: Capture, monkeypatch: Patch
) -> None:
    toy["lab"] = {"camera": True}
    file = tmp_path / "r.rrd"
    status, found = squeeze(tmp_path, "--content", "rice", "--container", "box-07", "--record", str(file))
    assert status == 0
    assert found["discarded"] is None
    assert found["hand_stands"]
    assert found["limits_restored"]
    assert found["features"] == {"tactile": 72, "physical": 13, "vision": 3721, "vision_small": 121}
    assert found["vision_reason"] == ""
    assert 0.2 < found["vision_missing"] < 0.8
    assert 0.001 < found["vision_noise_m"] < 0.004
    low, high = found["events"]["first_interval_s"]
    assert low <= found["truth"]["first_s"] <= high
    assert verify_here(file) == 0
    assert main(["replay", str(file)]) == 0
    assert "identical to the recorded numbers" in " ".join(capsys.readouterr().err.split())
    assert main(["report", str(file), "--out", str(tmp_path / "r.html")]) == 0  # of a squeeze that no model named
    from deformscope.experiments.squeeze import features as squeeze_features
    from deformscope.stages.squeeze.physical import tactile_feature

    monkeypatch.setattr(squeeze_features, "tactile_feature", lambda pads, end: tactile_feature(pads, end) + 1.0)
    assert main(["replay", str(file)]) == 2
    assert "another" in capsys.readouterr().err


def test_a_data_set_grows_and_is_corrected(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "d"
    for content in ("rice", "empty"):
        where = ["--dataset", str(folder), "--session", "s", "--keep", "features"]
        assert squeeze(tmp_path, "--content", content, "--container", "box-01", *where)[0] == 0
    dataset = SqueezeDataset(folder)
    assert [one.trial for one in dataset.entries()] == ["s-box-01-00000", "s-box-01-00001"]
    assert [one.seed for one in dataset.entries()] == [0, 1]
    assert not list(folder.glob("trials/*.rrd"))
    assert main(["dataset", "relabel", str(folder), "s-box-01-00001", "--content", "water"]) == 0
    assert main(["dataset", "discard", str(folder), "s-box-01-00000", "--reason", "it leaked"]) == 0
    assert "left out  1 (it leaked)" in capsys.readouterr().out
    assert main(["dataset", "merge", str(tmp_path / "all"), str(folder)]) == 0
    merged = SqueezeDataset(tmp_path / "all").entries()
    assert [(one.content, one.discarded) for one in merged] == [("rice", "it leaked"), ("water", None)]


def test_a_recording_that_the_index_lacks_is_taken_in_again(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    given = ["--content", "rice", "--container", "box-01", "--dataset", str(folder), "--session", "s"]
    assert squeeze(tmp_path, *given)[0] == 0
    before = SqueezeDataset(folder).rows()[0]
    assert SqueezeDataset(folder).recording_path("s-box-01-00000").is_file()
    for name in ("index.parquet", "features.parquet"):
        (folder / name).unlink()
    assert main(["dataset", "repair", str(folder)]) == 0
    after = SqueezeDataset(folder).rows()[0]
    for name, values in before.features.items():
        np.testing.assert_array_equal(after.features[name], values)
    assert after.entry.content == "rice"
    assert after.entry.discarded is None


def test_a_stopped_squeeze_is_kept_as_discarded_with_its_reason(
    tmp_path: Path, toy: dict[str, Any], capsys: Capture
) -> None:
    toy["setup"] = {"squeeze": dataclasses.replace(ToySqueeze().squeeze, saturation_counts=200)}
    folder = tmp_path / "d"
    given = ["--content", "rice", "--container", "box-01", "--dataset", str(folder), "--session", "s"]
    status, found = squeeze(tmp_path, *given)
    assert status == 2
    assert "tactile array saturated" in capsys.readouterr().err
    assert found["discarded"]["kind"] == "tactile array saturated"
    assert found["hand_stands"]
    assert limits(LABS[-1])[1] == 0.5
    (entry,) = SqueezeDataset(folder).entries()
    assert entry.discarded.startswith("tactile array saturated: a texel at ")
    recording = SqueezeDataset(folder).recording_path(entry.trial)
    assert verify_here(recording) == 0
    assert main(["replay", str(recording)]) == 0


def small_model() -> ContentModel:
    """Of two contents that differ by how hard the fingertips feel them."""
    random = np.random.default_rng(0)
    mean = np.repeat([[300.0], [1200.0]], 12, axis=0)
    table = LabelledTable(
        np.repeat(["empty", "rice"], 12), None, {"tactile": mean + random.normal(0.0, 100.0, (24, 72))}
    )
    return fit_model(table, by_group=False)


def test_a_model_names_the_content_while_it_is_squeezed(tmp_path: Path) -> None:
    model, file = tmp_path / "m.npz", tmp_path / "r.rrd"
    save_classifier(small_model(), model)
    status, found = squeeze(tmp_path, "--model", str(model), "--record", str(file))
    assert status == 0
    assert sum(found["posterior"].values()) == pytest.approx(1.0)
    assert found["named"] in ("empty", "rice")
    from deformscope.recording.items import read_results

    shown = [one.item for one in read_results(file, (trial.ContentPosterior,))]
    assert len(shown) >= 4
    assert sum(one.index == -1 for one in shown) == 1
    assert main(["replay", str(file)]) == 0


def seeing_model() -> ContentModel:
    """The same where vision has steps too."""
    random = np.random.default_rng(1)
    label, size = np.repeat(["empty", "rice"], 12), {"tactile": 72, "vision_small": 121}
    mean = np.repeat([[300.0], [1200.0]], 12, axis=0)
    drawn = {name: mean + random.normal(0.0, 100.0, (24, columns)) for name, columns in size.items()}
    drawn["vision_small"] *= 1e-6
    named = {"tactile": drawn["tactile"], "vision": np.repeat(drawn["vision_small"], 31, axis=1)[:, :3721]}
    series = {name: np.repeat(values[:, None], 4, axis=1) for name, values in drawn.items()}
    return fit_model(LabelledTable(label, None, named, series=series), by_group=False)


@pytest.mark.slow
def test_the_container_is_tracked_and_seen_while_it_is_squeezed_and_replayed(
    tmp_path: Path, toy: dict[str, Any], monkeypatch: Patch
) -> None:
    toy["lab"] = {"camera": True}
    model, file = tmp_path / "m.npz", tmp_path / "r.rrd"
    save_classifier(seeing_model(), model)
    status, found = squeeze(tmp_path, "--model", str(model), "--record", str(file))

    assert status == 0
    images = rows_of(file, DepthFrame)
    tracked, changes, named = (
        rows_of(file, kind) for kind in (trial.TrackedContainer, trial.ContainerChange, trial.ContentPosterior)
    )
    air_ns, open_ns = (row.session_ns for row in rows_of(file, trial.SqueezePhase) if row.item.name in ("air", "open"))
    between = [row.item.index for row in images if air_ns <= row.session_ns < open_ns]
    live = [row.item.index for row in tracked if row.item.live]
    assert live == between[REST_IMAGES - 1 : REST_IMAGES - 1 + len(live)]  # every one since the first five
    assert len(live) >= len(between) - REST_IMAGES
    assert [row.session_ns for row in tracked if row.item.live] == [
        row.session_ns for row in images if row.item.index in live
    ]
    assert {row.item.index for row in changes} == set(live)
    assert all(row.item.change_m.shape == (61, 61) for row in changes)
    tracking = found["tracking"]
    assert (tracking["live"], tracking["skipped"], tracking["refused"]) == (len(live), 0, {})
    assert 0.0 <= tracking["lag_median_s"] <= tracking["lag_p95_s"] <= 0.2
    assert len(tracking["poses"]) == tracking["images"] == len(live) + 1
    first = tracking["poses"][0]
    assert first["degrees_of_freedom"].startswith(f"{sum(one < 0.001 for one in first['deviation_m'])} of 6 observed")
    assert (first["refused"], first["skipped"], first["since_s"]) == ("", 0, None)
    while_squeezed = [row.item for row in named if row.item.index >= 0]
    assert {one.modality for one in while_squeezed} == {"tactile and vision_small"}
    assert all(one.vision_index in live for one in while_squeezed)
    assert main(["replay", str(file)]) == 0

    ((twice, count),) = Counter(row.item.index for row in changes).most_common(1)
    assert count == 2  # of the image, and of the median from there on

    def one_is_another(recording: Replay) -> replay_squeeze.SqueezeAgain:
        found = squeeze_again(recording)
        of = {
            one.index: (at, one)
            for at, one in reversed([*enumerate(found.results)])
            if isinstance(one, trial.ContainerChange)
        }
        at, one = of[twice]
        found.results[at] = dataclasses.replace(one, noise_m=1.0)
        return found

    monkeypatch.setattr(replay_squeeze, "squeeze_again", one_is_another)
    assert main(["replay", str(file)]) == 2


@pytest.mark.parametrize("order", [1, -1])
def test_the_container_is_sought_again_in_the_images_of_its_camera(order: int, monkeypatch: Patch) -> None:
    nothing = np.zeros(0, np.int64)
    sighting = ContainerSighting(7, np.array([7]), 1, 1, "before", False, None, "none", None, nothing)
    monkeypatch.setattr(items, "read_results", lambda *_, **__: [SimpleNamespace(item=sighting)])
    monkeypatch.setattr(placing, "sight", lambda images, *_: [one.device for one in images])
    seen = [DepthFrame(Stamp(1), 7, np.zeros((2, 2), np.uint16), 1e-3, device=name) for name in ("camera", "other")]
    moved = [
        ArmFrame(Stamp(1), 0, *[np.zeros(6)] * 3, *[np.zeros(3)] * 5),
        HandFrame(Stamp(1), 0, np.zeros(7), np.zeros(7), np.zeros(9), ("idle",) * 7),
    ]
    recording: Any = SimpleNamespace(path=Path("r.rrd"), settings={"squeezed": {"names": {"camera": "camera"}}})
    geometry: Any = None
    assert sighted_again(recording, [*seen[::order], *moved], geometry) == [["camera"]]


def rows_of(file: Path, kind: type) -> list[Any]:
    return list(read_rows(Replay(file, trust=True), (kind,)))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([], "--content NAME, or --model MODEL"),
        (["--content", "rice", "--dataset", "d"], "--content and --container with --dataset"),
        (["--content", "a/b"], "a name of letters, digits"),
        (["--content", "rice", "--grasp", "5,0,0"], "--grasp with the driver of an arm after --place"),
    ],
)
def test_what_makes_no_trial_is_refused_in_one_line(given: list[str], expected: str, capsys: Capture) -> None:
    assert main(["squeeze", "lab:containers", *given]) == 2
    assert expected in capsys.readouterr().err


def test_a_real_hand_waits_for_somebody_who_says_yes(
    tmp_path: Path, toy: dict[str, Any], capsys: Capture, monkeypatch: Patch
) -> None:
    toy["setup"] = {"simulated": False}
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert squeeze(tmp_path, "--content", "rice")[0] == 2
    assert "a person who confirms" in capsys.readouterr().err
    assert LABS[-1].hand_double.motion.axes[0].position_deg == 60.0  # nothing has moved
