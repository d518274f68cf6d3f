"""Nothing recorded is lost, nothing waits for a viewer, and no older recording is destroyed."""

# ruff: noqa: PT012 (what raises is the recording's end, not one statement in it)
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.frames import ColorFrame, DepthFrame, HandFrame, InputFile, Item, RawBytes, host_ns
from deformscope.images import encode_png
from deformscope.log.layout import RIG, RigLayout
from deformscope.page.server.page_server import end_pages
from deformscope.page.server.viewer_files import viewer_environment, viewer_executable
from deformscope.recording import facts, lateness, recorder, rrd_file
from deformscope.recording import rrd_file as recording_file
from deformscope.recording.items import read_items
from deformscope.recording.lateness import RecordingError
from deformscope.recording.ledger import check_recording, ledger_path
from deformscope.recording.live import LiveFeed, Viewer
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.recording.rrd_file import RecordingFile
from deformscope.rows import FORMAT
from deformscope.runs.recovery import recover_recording
from deformscope.session import Step, run
from tests.cases import Patch
from tests.log import synthetic
from tests.log import synthetic_rig as rig
from tests.log.test_rig import assert_same
from tests.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]
ROI, SHAPE = (8.0, 8.0, 48.0, 32.0), (5, 7)


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def rrd(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [str(viewer_executable()), "rrd", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=viewer_environment()
    )


def record(path: Path, count: int = 4, **options: object) -> recorder.RecordingSummary:
    with Recorder(path, "none", {"seed": 3, "roi": ROI, "spacing_px": None}, **options) as made:  # type: ignore[arg-type]
        run(synthetic.frames(count), synthetic.calibration(ROI, SHAPE), made)
    return made.summary()


def run_python(code: str, path: Path, *, kill: Callable[[str], bool] | None = None) -> tuple[int, str]:
    """Run a script that records to `path`; `kill` says at which line of its output it is killed outright."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "drivers")])}
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), str(path)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    watchdog = threading.Timer(PATIENCE_S, process.kill)
    watchdog.start()
    said = []
    for line in process.stdout:
        said.append(line)
        if kill is not None and kill(line):
            process.send_signal(signal.SIGKILL)
    status = process.wait()
    watchdog.cancel()
    process.stdout.close()
    return status, "".join(said)


def test_what_a_recording_holds(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    summary = record(path)
    assert (summary.path, summary.frames, summary.dropped) == (path, 4, 0)
    assert summary.bytes == path.stat().st_size
    assert sorted(left.name for left in tmp_path.iterdir()) == ["run.rrd", "run.rrd.ledger"]
    assert rrd("verify", path).returncode == 0
    assert check_recording(path).problems == []
    moving: dict[str, set[int]] = {}
    static = set()
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.is_static:
            static.add(chunk.entity_path)
            continue
        assert {"frame", "session"} <= set(chunk.timeline_names), chunk.entity_path
        moving.setdefault(chunk.entity_path, set()).update(batch.column("frame").to_pylist())
        for frame, session in zip(batch.column("frame"), batch.column("session"), strict=True):
            assert session.value == frame.as_py() * 33_333_333
    assert moving["/color/camera"] == {0, 1, 2, 3}
    assert moving["/particles/rest"] == {0}
    assert moving["/particles/observed"] == {0, 1, 2, 3}
    assert moving["/flow/arrows"] == {1, 2, 3}
    assert moving["/particles/simulated"] == moving["/error/aee"] == moving["/residual/lines"] == {0, 1, 2, 3}
    assert {"/calibration/chart", "/calibration/curve", "/calibration/summary", "/calibration/estimate"} <= static


def test_provenance(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", 2)
    replay = Replay(tmp_path / "run.rrd")
    assert replay.settings == {"seed": 3, "roi": list(ROI), "spacing_px": None}
    assert replay.outcome == {"frames": 2, "steps": 5, "live_dropped": 0, "complete": True}
    found = replay.properties
    assert found["format"] == FORMAT
    assert json.loads(found["versions"])["rerun-sdk"] == "0.41.0"
    assert {"python", "numpy", "deformscope"} <= json.loads(found["versions"]).keys()
    program, *given = json.loads(found["command"])
    assert given == sys.argv[1:]
    assert not Path(program).is_absolute()
    assert found["seed"] == 3
    assert isinstance(json.loads(found["git"]), dict)


def test_the_views_are_in_the_file(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", 2)
    assert len(RrdReader(tmp_path / "run.rrd").blueprints()) == 1


def contents(path: Path) -> list[tuple[str, bytes]]:
    """Every chunk, without its row numbers. `rerun rrd compare` finds a NaN different from itself."""
    found = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if "rowid" not in name.lower().replace("_", "")]
        columns = pa.RecordBatch.from_arrays([batch.column(name) for name in names], names=names)
        found.append((str(chunk.entity_path), columns.serialize().to_pybytes()))
    return sorted(found)


def test_two_deterministic_runs_compare_equal(tmp_path: Path) -> None:
    for name in ("a", "b"):
        record(tmp_path / f"{name}.rrd", 8, deterministic=True)
    assert contents(tmp_path / "a.rrd") == contents(tmp_path / "b.rrd")
    with Recorder(tmp_path / "c.rrd", "none", {"seed": 3, "roi": ROI, "spacing_px": None}, deterministic=True) as made:
        run(synthetic.frames(8, seed=1), synthetic.calibration(ROI, SHAPE), made)
    assert contents(tmp_path / "a.rrd") != contents(tmp_path / "c.rrd")


def test_a_step_about_an_unknown_frame_is_a_mistake(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="frame 7"), Recorder(tmp_path / "run.rrd") as made:
        made.write(next(synthetic.frames(1)))
        made.write(Step((synthetic.estimate(),), frame=7))


def test_a_result_without_a_twin_is_a_mistake(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="no twin"), Recorder(tmp_path / "run.rrd") as made:
        made.write(next(synthetic.frames(1)))
        made.write(Step(("a string",)))


def test_without_file_and_viewer_rerun_is_not_imported(tmp_path: Path) -> None:
    code = """
        import sys
        from deformscope.recording.recorder import Recorder
        from deformscope.session import Step
        from deformscope.files.sources import open_source
        with open_source(["sample:tension"]) as source, Recorder(None) as made:
            for frame in source:
                made.write(frame)
                made.write(Step((object(),)))
        assert made.summary().frames == 7
        assert made.summary().path is None
        assert not [name for name in sys.modules if name.split(".")[0] == "rerun"]
    """
    assert run_python(code, tmp_path) == (0, "")


def test_refuses_before_any_work(tmp_path: Path) -> None:
    taken = tmp_path / "run.rrd"
    taken.write_bytes(b"precious")
    (tmp_path / "folder.rrd").mkdir()
    for path, expected in (
        (taken, "--overwrite"),
        (tmp_path / "gone" / "run.rrd", "mkdir"),
        (tmp_path / "run.txt", "ends in .rrd"),
        (tmp_path / "folder.rrd", "a folder"),
        (Path("/proc/run.rrd"), "can be written"),
    ):
        with pytest.raises(InputError, match=expected), Recorder(path):
            pytest.fail("opened")
    assert taken.read_bytes() == b"precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.rrd", "run.rrd"]


def test_overwrites_only_at_a_good_end(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "run.rrd"
    record(path, 2)
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt), Recorder(path, overwrite=True) as made:
        made.write(next(synthetic.frames(1)))
        raise KeyboardInterrupt
    assert path.read_bytes() == before
    assert check_recording(path).problems == []
    unfinished = tmp_path / "run.part.rrd"
    assert made.summary().path == unfinished
    assert str(unfinished) in caplog.text
    assert rrd("verify", unfinished).returncode == 0
    assert Replay(unfinished).outcome["complete"] is False
    kept = unfinished.read_bytes()
    record(path, 3, overwrite=True)
    assert Replay(path).frame_count == 3
    assert unfinished.read_bytes() == kept


def test_an_error_before_anything_was_recorded_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyError), Recorder(tmp_path / "run.rrd"):
        raise KeyError
    assert not list(tmp_path.iterdir())


def test_a_name_taken_during_the_run_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with pytest.raises(RecordingError, match="made during the run"), Recorder(path) as made:
        made.write(next(synthetic.frames(1)))
        path.write_bytes(b"of another run")
    assert path.read_bytes() == b"of another run"
    assert Replay(tmp_path / "run.part.rrd").frame_count == 1


def test_killed_outright(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """All that was written is on the disk with the next look at it, a second later."""
    code = """
        import sys
        from pathlib import Path
        from deformscope.recording.recorder import Recorder
        from tests.log import synthetic
        from tests.recording.test_recorder import wait_for_looks
        with Recorder(Path(sys.argv[1]), "none", {"seed": 1}) as made:
            for frame in synthetic.frames(1000):
                made.write(frame)
                if frame.index == 29:
                    wait_for_looks(made)
                print(frame.index, flush=True)
    """
    status, _ = run_python(code, tmp_path / "run.rrd", kill=lambda line: line.strip() == "50")
    assert status == -signal.SIGKILL
    assert not (tmp_path / "run.rrd").exists()
    part, out = tmp_path / "run.part.rrd", tmp_path / "out.rrd"
    try:
        replay = Replay(part)
    except InputError:  # killed within a write
        recover_recording(part, out)
        replay = Replay(out)
    assert "of an interrupted run" in caplog.text  # its ledger answers for what was there at the last look
    frames = list(replay.frames())
    assert len(frames) >= 30
    for frame, original in zip(frames, synthetic.frames(len(frames)), strict=True):
        np.testing.assert_array_equal(frame.image, original.image)
    assert replay.settings == {"seed": 1}
    assert not replay.outcome.get("complete")


def test_full_disk_ends_the_run(tmp_path: Path) -> None:
    """The limit on a file's size makes writes fail as a full disk does; rerun itself says nothing."""
    code = """
        import resource, sys, time
        from pathlib import Path
        from deformscope.recording import rrd_file, target
        from deformscope.recording.recorder import Recorder, RecordingError
        from tests.log import synthetic
        from tests.patience import PATIENCE_S
        rrd_file.FLUSH_TIMEOUT_S = PATIENCE_S  # a busy machine is another error than a full disk
        def lifted(path):
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            return looked(path)
        looked, target.is_recoverable = target.is_recoverable, lifted  # else the look's copy has the limit as well
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, resource.RLIM_INFINITY))
        try:
            with Recorder(Path(sys.argv[1]), "none", {}) as made:
                for frame in synthetic.frames(10_000, (200, 300)):
                    made.write(frame)
        except RecordingError as error:
            print(error)
            print("kept", made.summary().path.name, frame.index < 9_000)
            sys.exit(3)
    """
    status, said = run_python(code, tmp_path / "run.rrd")
    assert status == 3, said
    assert "its quota is full" in said
    assert "kept run.part.rrd True" in said
    assert f"are stored: deformscope recover {tmp_path / 'run.part.rrd'}" in said
    assert main(["recover", str(tmp_path / "run.part.rrd")]) == 0
    assert not (tmp_path / "run.rrd").exists()


@pytest.mark.slow
def test_what_was_ended_is_called_kept_however_long_it_is(
    tmp_path: Path, monkeypatch: Patch, caplog: pytest.LogCaptureFixture
) -> None:
    """The file of large portions has its format at its end: 37 MB were called lost, which `recover` read."""
    monkeypatch.setattr(facts, "BEGIN_BYTES", 1 << 12)
    with pytest.raises(RecordingError, match="MiB free"), Recorder(tmp_path / "run.rrd") as made:
        for frame in synthetic.frames(3):
            made.write(frame)
        wait_for_looks(made)
        monkeypatch.setattr(lateness, "FREE_BYTES", 1 << 60)
        monkeypatch.setattr(recording_file, "BEAT_S", 0.0)
        for frame in synthetic.frames(3):
            made.write(frame)
    assert f"are stored: deformscope recover {tmp_path / 'run.part.rrd'}" in caplog.text
    assert main(["recover", str(tmp_path / "run.part.rrd")]) == 0


def test_little_free_space_ends_the_run(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setattr(recording_file, "BEAT_S", 0.0)
    with pytest.raises(RecordingError, match="MiB free"), Recorder(tmp_path / "run.rrd") as made:
        made.write(next(synthetic.frames(1)))
        wait_for_looks(made)
        monkeypatch.setattr(lateness, "FREE_BYTES", 1 << 60)
        for _ in range(3):
            made.write(next(synthetic.frames(1)))
    assert Replay(tmp_path / "run.part.rrd").frame_count == 1
    assert rrd("verify", tmp_path / "run.part.rrd").returncode == 0  # the room that was left was enough to end it
    assert "MiB free on the disk" in str(Replay(tmp_path / "run.part.rrd").outcome["stopped"])
    assert check_recording(tmp_path / "run.part.rrd").problems == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.part.rrd", "run.part.rrd.ledger"]


class SlowDisk:
    """Every flush waits until it may go on; one that had to give up waiting is counted."""

    def __init__(self) -> None:
        self.asked, self.free = threading.Event(), threading.Event()
        self.given_up = 0

    def block(self, monkeypatch: Patch) -> None:
        flush = RecordingFile.flush

        def slow(file: RecordingFile) -> None:
            self.asked.set()
            self.given_up += not self.free.wait(PATIENCE_S)
            flush(file)

        monkeypatch.setattr(RecordingFile, "flush", slow)


def wait_for_looks(made: Recorder) -> None:
    """Return once what was written up to now is on the disk."""
    done = threading.Event()

    def flush() -> None:
        made._write_last()
        done.set()

    made._put(flush, 0)
    assert done.wait(PATIENCE_S)


def without_images(seconds: float) -> list[Item]:
    """In order of time; of one moment by kind, and so on."""
    found = [one for one in rig.items(seconds, (24, 32)) if not isinstance(one, ColorFrame | DepthFrame)]
    return sorted(found, key=order)


def order(item: Item) -> tuple[int, str, bool]:
    return host_ns(item), type(item).__name__, isinstance(item, RawBytes) and item.sent


def read_in_order(path: Path) -> list[Item]:
    return sorted(read_items(path), key=order)


def test_nobody_who_writes_waits_for_the_disk(tmp_path: Path, monkeypatch: Patch) -> None:
    disk, items = SlowDisk(), without_images(0.3)
    with Recorder(tmp_path / "run.rrd", "none", {}, application=RIG, real_time=True) as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        disk.block(monkeypatch)
        assert disk.asked.wait(PATIENCE_S)
        for batch in rig.batches(items):
            made.write(batch)
        disk.free.set()  # till now it was blocked by the first flush
    assert disk.given_up == 0
    assert_same(read_in_order(tmp_path / "run.rrd"), items)


def test_nobody_who_writes_images_and_results_waits_for_the_disk(tmp_path: Path, monkeypatch: Patch) -> None:
    disk = SlowDisk()
    with Recorder(tmp_path / "run.rrd", "none", {}) as made:
        disk.block(monkeypatch)
        assert disk.asked.wait(PATIENCE_S)
        for frame in synthetic.frames(3):
            made.write(frame)
            made.write(Step((synthetic.estimate(),)))
        made.write(InputFile("mask", encode_png(np.zeros((4, 4), np.uint8))))
        disk.free.set()
    assert disk.given_up == 0
    assert Replay(tmp_path / "run.rrd").frame_count == 3


def test_what_can_wait_for_its_recording_does_and_loses_nothing(tmp_path: Path, monkeypatch: Patch) -> None:
    disk = SlowDisk()
    monkeypatch.setattr(recorder, "AHEAD_JOBS", 5)
    with Recorder(tmp_path / "run.rrd", "none", {}) as made:
        disk.block(monkeypatch)
        assert disk.asked.wait(PATIENCE_S)
        threading.Timer(0.2, disk.free.set).start()
        for frame in synthetic.frames(20):
            made.write(frame)
        assert disk.free.is_set()  # six of them had no room before
    assert Replay(tmp_path / "run.rrd").frame_count == 20


def test_a_list_that_goes_on_being_used_is_recorded_as_it_was(tmp_path: Path) -> None:
    items = without_images(0.3)
    with Recorder(tmp_path / "run.rrd", "none", {}, application=RIG) as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        given: list[Item] = []
        for batch in rig.batches(items):
            given += batch
            made.write(given)
            given.clear()
    assert_same(read_in_order(tmp_path / "run.rrd"), items)


def test_devices_killed_outright(tmp_path: Path) -> None:
    """What was gathered for less than a second is written while nothing more comes."""
    code = """
        import os, signal, sys, time
        from pathlib import Path
        from deformscope.log.layout import RIG, RigLayout
        from deformscope.recording.recorder import Recorder
        from tests.log import synthetic_rig as rig
        from tests.recording.test_recorder import without_images
        with Recorder(Path(sys.argv[1]), "none", {}, application=RIG, real_time=True) as made:
            made.start(RigLayout(rig.STREAMS), rig.START_NS)
            for batch in rig.batches(without_images(0.5)):
                made.write(batch)
            while made._writer.waiting_bytes or len(made._encoder):
                time.sleep(0.01)
            beats = made._outputs.file._beats
            while made._outputs.file._beats == beats:  # the next look at the disk
                time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGKILL)
    """
    status, said = run_python(code, tmp_path / "run.rrd")
    assert status == -signal.SIGKILL, said
    assert_same(read_in_order(tmp_path / "run.part.rrd"), without_images(0.5))


def test_a_recording_of_devices_has_few_portions(tmp_path: Path) -> None:
    """Each costs memory until the end, and a viewer time: from ten a second and entity to three a minute."""
    seconds = 70
    items: list[Item] = sorted([*map(rig.hand, range(10 * seconds)), *map(rig.health, range(seconds))], key=order)
    with Recorder(tmp_path / "run.rrd", "none", {}, application=RIG) as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        for batch in rig.batches(items):
            made.write(batch)
    assert rrd("verify", tmp_path / "run.rrd").returncode == 0
    portions: dict[str, int] = {}
    for chunk in RrdReader(tmp_path / "run.rrd").stream():
        if not chunk.is_static:
            portions[chunk.entity_path] = portions.get(chunk.entity_path, 0) + 1
    assert len(portions) == 11  # the hand's numbers, and how the devices do
    assert max(portions.values()) <= 4  # a third of a minute each
    assert_same(read_in_order(tmp_path / "run.rrd"), items)


def test_of_a_recording_that_was_cut_off_the_rest_is_recovered(tmp_path: Path) -> None:
    """Its properties lie at its begin: without them nothing that is left can be read."""
    whole, cut = tmp_path / "run.rrd", tmp_path / "cut.rrd"
    items: list[Item] = sorted([*map(rig.hand, range(600)), *map(rig.health, range(60))], key=order)
    with Recorder(whole, "none", {}, application=RIG) as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        for batch in rig.batches(items):
            made.write(batch)
    cut.write_bytes(whole.read_bytes()[: int(0.4 * whole.stat().st_size)])
    recover_recording(cut)
    assert 0 < len(read_in_order(tmp_path / "cut.recovered.rrd")) < len(items)


def test_two_deterministic_runs_of_devices_compare_equal(tmp_path: Path) -> None:
    numbers = without_images(1.5)[1:]
    numbers = [one for one in numbers if not isinstance(one, HandFrame) or one.index >= 3]  # NaN equals nothing
    for name in ("a", "b"):
        with Recorder(tmp_path / f"{name}.rrd", "none", {}, application=RIG, deterministic=True) as made:
            made.start(RigLayout(rig.STREAMS), rig.START_NS)
            for batch in rig.batches(numbers):
                made.write(batch)
    assert contents(tmp_path / "a.rrd") == contents(tmp_path / "b.rrd")


def failing(*, timeout_sec: float) -> None:
    raise OSError("no room")


@pytest.mark.parametrize("trouble", ["little room", "does not end", "cannot be flushed"])
def test_without_the_file_of_large_portions_the_recording_is_the_other(
    trouble: str, tmp_path: Path, monkeypatch: Patch, caplog: pytest.LogCaptureFixture
) -> None:
    items, merged = without_images(0.3), tmp_path / "run.part.rrd.merged"
    if trouble == "little room":
        monkeypatch.setattr(lateness, "FREE_BYTES", 1000)
        usage = shutil.disk_usage(tmp_path)
        full = merged.exists  # until the other file has gone
        monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=999 if full() else 1001))
    elif trouble == "does not end":
        monkeypatch.setattr(recording_file, "has_footer", lambda path: False)
    else:
        monkeypatch.setattr(recording_file, "BEATS_MERGED", 1)
    with Recorder(tmp_path / "run.rrd", "none", {"seed": 3}, application=RIG) as made:
        assert merged.exists() == (trouble != "little room")
        if trouble == "cannot be flushed":
            assert made._outputs.file._merged_stream is not None
            monkeypatch.setattr(made._outputs.file._merged_stream, "flush", failing)
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        for batch in rig.batches(items):
            made.write(batch)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.rrd", "run.rrd.ledger"]
    assert "many small portions" in caplog.text
    assert check_recording(tmp_path / "run.rrd").problems == []
    assert rrd("verify", "--check-footers=false", tmp_path / "run.rrd").returncode == 0
    assert Replay(tmp_path / "run.rrd").outcome["complete"] is True
    assert_same(read_in_order(tmp_path / "run.rrd"), items)


class Stream:
    """A live stream that gets stuck, as one does whose viewer was stopped."""

    def __init__(self, stuck: bool = True) -> None:
        self.free = threading.Event()
        self.jobs = 0
        if not stuck:
            self.free.set()

    def flush(self, *, timeout_sec: float) -> None: ...

    def disconnect(self) -> None: ...

    def take(self) -> None:
        self.free.wait(PATIENCE_S)
        self.jobs += 1


def test_feed_shows_everything_when_the_viewer_follows() -> None:
    stream = Stream(stuck=False)
    feed = LiveFeed(lambda closing: stream)
    feed.start()
    for _ in range(100):
        feed.put(Stream.take, 10)
    assert feed.close(10)
    assert (stream.jobs, feed.dropped) == (100, 0)


@pytest.mark.parametrize(("capacity", "size"), [((8, 1 << 30), 1), ((1000, 80), 10)], ids=["by count", "by bytes"])
def test_feed_drops_the_oldest_and_counts(capacity: tuple[int, int], size: int) -> None:
    stream = Stream()
    order: list[int] = []
    feed = LiveFeed(lambda closing: stream, *capacity)
    feed.start()
    feed.put(Stream.take, 0)
    while feed._jobs:
        time.sleep(0.001)
    for number in range(100):
        feed.put(lambda stream, number=number: order.append(number), size)  # type: ignore[misc]
    assert feed.dropped == 92
    stream.free.set()
    assert feed.close(10)
    assert order == list(range(92, 100))
    assert feed.dropped == 92


def test_feed_leaves_a_stuck_viewer_behind() -> None:
    stream = Stream()
    feed = LiveFeed(lambda closing: stream, 8)
    feed.start()
    for _ in range(20):
        feed.put(Stream.take, 1)
    assert not feed.close(0.2)
    assert feed.dropped == 20
    feed.put(Stream.take, 1)
    assert feed.dropped == 21
    stream.free.set()


def test_feed_survives_a_viewer_that_never_comes(caplog: pytest.LogCaptureFixture) -> None:
    def connect(closing: threading.Event) -> Stream:
        raise ConnectionError("nobody there")

    feed = LiveFeed(connect)
    feed.start()
    for _ in range(5):
        feed.put(Stream.take, 1)
    assert feed.close(5)
    assert feed.dropped == 5
    assert "nobody there" in caplog.text


def test_the_file_never_waits_for_the_viewer(
    tmp_path: Path, monkeypatch: Patch, caplog: pytest.LogCaptureFixture
) -> None:
    stuck = threading.Event()
    unregistered, unblocked = list[bool](), list[bool]()
    monkeypatch.setattr(recorder, "start_viewer", lambda: Viewer(0, 0))
    monkeypatch.setattr(recorder, "live_stream", lambda *given: unblocked.append(stuck.wait(PATIENCE_S)))
    monkeypatch.setattr(recorder, "LIVE_TIMEOUT_S", 0.3)
    monkeypatch.setattr(rrd_file, "leave_streams_alone", lambda: unregistered.append(True))
    path = tmp_path / "run.rrd"
    with Recorder(path, "native", {}) as made:
        for frame in synthetic.frames(400):
            made.write(frame)
    assert unblocked == []  # the viewer never answered
    stuck.set()
    assert made.summary().frames == 400
    assert made.summary().dropped >= 400
    replay = Replay(path)
    assert replay.frame_count == 400
    assert replay.outcome["live_dropped"] == made.summary().dropped
    assert unregistered == [True]
    assert "does not answer" in caplog.text


def test_a_window_needs_a_display(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match="a display"), Recorder(tmp_path / "run.rrd", "native"):
        pytest.fail("opened")
    assert not list(tmp_path.iterdir())


def test_a_page_is_served_on_loopback_alone(tmp_path: Path) -> None:
    """No port of rerun's is open: its data go over the page's own websocket."""
    before = listening(os.getpid())
    try:
        with Recorder(tmp_path / "run.rrd", "page", {}) as made:
            page = made.page
            assert page is not None
            run(synthetic.frames(3), synthetic.calibration(ROI, SHAPE), made)
        assert made.summary().dropped == 0
        (opened,) = set(listening(os.getpid())) - set(before)
        assert opened == ("0100007F", urlsplit(page.address).port)
        assert (page.session.state.phase, page.session.state.title) == ("stopped", "")
        assert page.pieces.held_bytes > 1000
    finally:
        end_pages()
    assert Replay(tmp_path / "run.rrd").frame_count == 3
    assert ledger_path(tmp_path / "run.rrd").exists()


def listening(pid: int) -> list[tuple[str, int]]:
    """(address as the kernel writes it, port) of every socket a process listens on."""
    if not Path("/proc/net/tcp").exists():
        pytest.skip("needs /proc")
    sockets = set()
    for handle in Path(f"/proc/{pid}/fd").iterdir():
        try:
            sockets.add(str(handle.readlink()))
        except OSError:
            continue
    found = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in sockets:
                address, port = fields[1].split(":")
                found.append((address, int(port, 16)))
    return found
