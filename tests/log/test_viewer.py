"""The viewer itself shows what is recorded, without a complaint."""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun as rr
from rerun.experimental import ViewerClient

from deformscope.files.sources import open_source
from deformscope.frames import ArmFrame, HealthReport
from deformscope.log.exploration.results import exploration_blueprint, log_exploration_start, prepare_results
from deformscope.log.layout import PAIR, PAIR_3D
from deformscope.log.rig import Place, log_items, log_streams, prepare_items, rig_blueprint
from deformscope.recording import live, recorder, rrd_file
from deformscope.recording.recorder import Recorder
from deformscope.session import Step, run
from deformscope.stages.map.exploration import MapEstimate
from tests.log import synthetic, synthetic_exploration, synthetic_rig
from tests.patience import PATIENCE_S
from tests.pictures.test_closeup import poked
from tools import screenshot
from tools.screenshot import LAVAPIPE, headless_viewer, make_light, shoot

pytestmark = pytest.mark.viewer


NO_PICTURES = np.zeros(0, np.int64)


@pytest.fixture(autouse=True)
def strict(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    rr.set_strict_mode(True)
    monkeypatch.setattr(screenshot, "NOTICES_S", 0.5)
    yield
    rr.set_strict_mode(False)


@pytest.fixture
def viewer() -> Iterator[ViewerClient]:
    """A fresh one for each test: a viewer keeps the views of the first recording for all that follow."""
    if not Path("/usr/share/vulkan/icd.d").is_dir() and "VK_ICD_FILENAMES" not in os.environ:
        pytest.skip("no Vulkan driver; apt-get install mesa-vulkan-drivers libvulkan1")
    try:
        with headless_viewer("900x600") as client:
            client.get_state()
            yield client
    except (RuntimeError, ConnectionError) as error:
        pytest.skip(f"no headless viewer: {error}")


@pytest.mark.slow
def test_calibration_of_images(tmp_path: Path, viewer: ViewerClient) -> None:
    path = tmp_path / "run.rrd"
    with open_source(["sample:tension"]) as source, Recorder(path) as made:
        run(source, synthetic.calibration(), made)
    assert shoot(viewer, path, tmp_path) == []
    pictures = {shot.stem: cv2.imread(str(shot)) for shot in tmp_path.glob("*.png")}
    assert len(pictures) == 8
    particles = pictures["Particles"].astype(int)
    blue, green, red = (
        (np.abs(particles - color).max(axis=2) < 40).sum() for color in ((255, 110, 40), (80, 190, 30), (45, 45, 235))
    )
    assert min(blue, green, red) > 30
    # No view is left empty.
    for name, picture in pictures.items():
        assert picture.std() > 10, name


@pytest.mark.slow
def test_labels_on_light(tmp_path: Path, viewer: ViewerClient) -> None:
    with Recorder(tmp_path / "run.rrd") as made:
        run(synthetic.frames(3), synthetic.calibration((8.0, 8.0, 48.0, 32.0), (5, 7)), made)
    make_light(viewer)
    assert shoot(viewer, tmp_path / "run.rrd", tmp_path) == []
    picture = cv2.imread(str(tmp_path / "Particles.png")).astype(int)
    legend = picture[round(0.8 * len(picture)) :]
    assert np.median(legend) > 200
    assert (legend < 90).all(axis=2).sum() > 100


def test_two_recordings_in_one_viewer(tmp_path: Path, viewer: ViewerClient) -> None:
    for name, count in (("a", 3), ("b", 4)):
        with Recorder(tmp_path / f"{name}.rrd") as made:
            run(synthetic.frames(count), synthetic.calibration((8.0, 8.0, 48.0, 32.0), (5, 7)), made)
        assert viewer.open(str(tmp_path / f"{name}.rrd")).store_ids, viewer.get_logs()
    assert len(viewer.get_state().recordings) == 2


@pytest.mark.slow  # pokes are pairs in space, too
@pytest.mark.parametrize("dimensions", [2, 3])
def test_calibration_of_a_pair(tmp_path: Path, viewer: ViewerClient, dimensions: int) -> None:
    path = tmp_path / "run.rrd"
    pair = synthetic.pair_in_plane() if dimensions == 2 else synthetic.pair_in_space()
    with Recorder(path, application=PAIR) as made:
        made.write(Step((pair, synthetic.estimate(unit="m")), frame=0))
    assert shoot(viewer, path, tmp_path) == []
    for shot in tmp_path.glob("*.png"):
        assert cv2.imread(str(shot)).std() > 8, shot.name


def test_pokes_of_a_surface(tmp_path: Path, viewer: ViewerClient) -> None:
    path = tmp_path / "run.rrd"
    with Recorder(path, application=PAIR_3D) as made:
        for frame, pair in enumerate((poked(), poked(at=(0.4, 0.25)))):
            made.write(Step((pair,), frame=frame))
        made.write(Step((synthetic.estimate(unit="m"),), frame=1))
    assert shoot(viewer, path, tmp_path) == []
    for shot in tmp_path.glob("*.png"):
        assert cv2.imread(str(shot)).std() > 8, shot.name


@pytest.mark.parametrize(
    "kinds",
    [
        ("wrench", "tactile", "arm", "hand", "color", "depth"),
        *(pytest.param((kind,), marks=pytest.mark.slow) for kind in ("tactile", "wrench")),
    ],
)
def test_a_rig(tmp_path: Path, viewer: ViewerClient, kinds: tuple[str, ...]) -> None:
    """A double's views say so, every view shows something, and none is about a device that is not there."""
    path = tmp_path / "run.rrd"
    streams = [replace(stream, urdf=synthetic_rig.URDF) for stream in synthetic_rig.STREAMS if stream.kind in kinds]
    names = {stream.device for stream in streams}
    items = [
        replace(item, joint_deg=item.joint_deg[:2] - 100, finger=item.finger[:1])
        if isinstance(item, ArmFrame)
        else item
        for item in synthetic_rig.items(3.0, (48, 64))
        if isinstance(item, HealthReport) or item.device in names
    ]
    rec = rr.RecordingStream("deformscope-rig", recording_id="rig")
    rec.set_sinks(rr.FileSink(path))
    rec.send_blueprint(rig_blueprint(streams))
    log_streams(rec, streams)
    for batch in synthetic_rig.batches(items):
        log_items(rec, batch, synthetic_rig.START_NS, streams)
    rec.flush(timeout_sec=10)
    rec.disconnect()
    assert shoot(viewer, path, tmp_path, session_s=2.9) == []
    views = {view.name for view in viewer.get_state().views}
    plotted = sum(stream.kind in ("wrench", "hand", "arm") for stream in streams)
    pictures = sum(stream.kind in ("tactile", "arm", "color", "depth") for stream in streams)
    assert len(views) == plotted + pictures + 2
    told = {f"{stream.device}:": stream.simulated for stream in streams}
    assert all(("(SIMULATED)" in name) == told[name.split()[0]] for name in views - {"Devices", "State over time"})
    for shot in tmp_path.glob("*.png"):
        assert cv2.imread(str(shot)).std() > 8, shot.name
    if "arm" in kinds:
        arm = cv2.imread(str(tmp_path / "jaco__pose__SIMULATED_.png"))
        assert (arm.min(axis=2) > 110).mean() > 0.005  # its links, lighter than the floor


def _headless(monkeypatch: pytest.MonkeyPatch) -> list[live.Viewer]:
    """Windows are not seen; those that are started from here on are listed."""
    started = list[live.Viewer]()

    def start() -> live.Viewer:
        started.append(live.start_viewer())
        return started[-1]

    monkeypatch.setattr(live, "window_options", lambda: ["--headless"])
    monkeypatch.setenv("VK_ICD_FILENAMES", str(LAVAPIPE))
    monkeypatch.setattr(recorder, "start_viewer", start)
    return started


def test_a_native_viewer_gets_the_run_and_outlives_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not LAVAPIPE.exists():
        pytest.skip("no software Vulkan driver")
    started = _headless(monkeypatch)
    with Recorder(tmp_path / "run.rrd", "native", {}) as made:
        (viewer,) = started
        try:
            with open_source(["sample:tension"]) as source:
                run(source, synthetic.calibration(), made)
        except BaseException:
            os.kill(viewer.pid, signal.SIGKILL)
            raise
    try:
        assert made.summary().dropped == 0
        client = ViewerClient.connect(viewer.url)
        deadline = time.monotonic() + PATIENCE_S
        while len(client.get_state().views) < 6 and time.monotonic() < deadline:
            time.sleep(0.2)
        assert {view.name for view in client.get_state().views} >= {"Particles", "Estimate"}
        assert [report for view in client.get_state().views for report in view.reports] == []
    finally:
        os.kill(viewer.pid, signal.SIGKILL)


def test_a_stopped_window_costs_the_picture_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not LAVAPIPE.exists():
        pytest.skip("no software Vulkan driver")
    started = _headless(monkeypatch)
    monkeypatch.setattr(rrd_file, "leave_streams_alone", lambda: None)  # other tests' streams end as usual
    with Recorder(tmp_path / "run.rrd", "native", {}) as made:
        (viewer,) = started
        try:
            os.kill(viewer.pid, signal.SIGSTOP)
            for frame in synthetic.frames(100, (200, 300)):
                made.write(frame)
        except BaseException:
            os.kill(viewer.pid, signal.SIGKILL)
            raise
    os.kill(viewer.pid, signal.SIGKILL)
    assert made.summary().frames == 100
    assert made.summary().dropped >= 100


@pytest.mark.slow  # six views of everything
@pytest.mark.parametrize(("touch", "truth"), [(0, True), (2, True), (2, False)])
def test_an_exploration(tmp_path: Path, viewer: ViewerClient, touch: int, truth: bool) -> None:
    """Every view shows something, before the first touch too, and arm and surface stand in one scene."""
    path = tmp_path / "run.rrd"
    kinds = ("wrench", "arm", "depth")
    streams = [replace(stream, urdf=synthetic_rig.URDF) for stream in synthetic_rig.STREAMS if stream.kind in kinds]
    rec = rr.RecordingStream("deformscope-explore-test", recording_id="viewer")
    rec.set_sinks(rr.FileSink(path))
    rec.send_blueprint(exploration_blueprint(streams, truth=truth))
    log_streams(rec, streams)
    log_exploration_start(rec, streams)
    devices = {stream.device for stream in streams}
    items = [one for one in synthetic_rig.items(0.5, (48, 64)) if getattr(one, "device", "") in devices]
    items = [one for one in items if not isinstance(one, ArmFrame)]
    prepare_items(items, synthetic_rig.START_NS, streams, place=Place(0, NO_PICTURES)).send(rec)
    for at, number, result in synthetic_exploration.story():
        if number <= touch:
            shown = replace(result, truth_labels=None) if isinstance(result, MapEstimate) and not truth else result
            prepare_results([shown], round(at * 1e9), Place(number, NO_PICTURES)).send(rec)
    rec.flush(timeout_sec=10)
    rec.disconnect()
    assert shoot(viewer, path, tmp_path, touch=touch) == []
    shots = {shot.stem: cv2.imread(str(shot)) for shot in tmp_path.glob("*.png")}
    assert "Truth" in shots if truth else "Surface" in shots
    for name, shot in shots.items():
        assert shot.std() > 3, name
