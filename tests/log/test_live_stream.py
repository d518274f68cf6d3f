"""A viewer gets what can be seen, in few and small portions, and the recording beside it keeps everything."""

import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deformscope.frames import (
    ArmFrame,
    ColorFrame,
    DepthFrame,
    HealthReport,
    InputFile,
    Item,
    LinkChange,
    RawBytes,
    TactileFrame,
    WrenchFrame,
)
from deformscope.log.layout import EXPLORATION, RIG, ExplorationLayout, RigLayout
from deformscope.log.live_stream import (
    COLOR_WIDTH,
    DEPTH_WIDTH,
    MOST,
    POSE_HZ,
    TACTILE_HZ,
    WRENCH_HZ,
    LiveStream,
    extremes,
    thinned,
)
from deformscope.log.rig import Place
from deformscope.recording import recorder
from deformscope.recording.live import Viewer
from deformscope.recording.recorder import Recorder
from deformscope.session import Moment, Step
from deformscope_drivers.clock import Stamp
from tests.log import synthetic_exploration
from tests.log import synthetic_rig as rig

FLUSHES_A_SECOND = 5
MOST_CHUNKS, MOST_BYTES = 80, 600_000
"""Of a second of six devices: what a page drawn by a slow processor keeps up with."""


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def second() -> list[Item]:
    """A second of a rig at its full rates and sizes."""
    return rig.items(1.0, (480, 640))


def of(items: list[Item], kind: type) -> list[Any]:
    return [item for item in items if isinstance(item, kind)]


def test_what_can_be_seen_is_bounded_however_much_there_was(second: list[Item]) -> None:
    counts = Counter(type(item) for item in thinned(second))
    assert len(of(second, WrenchFrame)) == 1000
    assert counts[WrenchFrame] <= WRENCH_HZ
    assert counts[TactileFrame] <= TACTILE_HZ
    assert counts[ArmFrame] <= POSE_HZ
    assert of(thinned(second), ArmFrame)[-1] is of(second, ArmFrame)[-1]
    assert counts[ColorFrame] == counts[DepthFrame] == 1
    assert counts[RawBytes] == 0
    assert len(of(second, RawBytes)) > 0
    hour = [replace(frame, stamp=Stamp(frame.stamp.host_ns * 3600)) for frame in of(second, WrenchFrame)]
    assert len(thinned(hour)) == MOST
    for kind in (HealthReport, LinkChange):  # rare, and each says something
        assert counts[kind] == len(of(second, kind))


def test_pictures_are_the_newest_and_small(second: list[Item]) -> None:
    shown = thinned(second)
    (color,), (depth,) = of(shown, ColorFrame), of(shown, DepthFrame)
    newest = of(second, DepthFrame)[-1]
    assert color.index == of(second, ColorFrame)[-1].index
    assert depth.index == newest.index
    assert color.image.shape == (360, COLOR_WIDTH, 3)
    assert depth.depth.shape == (240, DEPTH_WIDTH)
    np.testing.assert_array_equal(depth.depth, newest.depth[::2, ::2])  # distances are never mixed
    small = rig.color(3, size=(40, 60))
    (whole,) = thinned([small])
    assert (whole.index, whole.stamp) == (small.index, small.stamp)
    assert whole.image is small.image


def test_no_peak_is_left_out_and_order_is_kept() -> None:
    rng = np.random.default_rng(4)
    frames = [replace(rig.wrench(index), force_n=rng.normal(0, 0.01, (1, 3))) for index in range(997)]
    for index in (0, 413, 414, 996):
        frames[index] = replace(frames[index], force_n=np.array([[0.0, 0.0, -5.0 - index]]))
    frames[500] = replace(frames[500], force_n=np.full((1, 3), np.nan))
    shown = of(thinned(list(frames)), WrenchFrame)
    assert {0, 996, 414} <= {frame.index for frame in shown}
    assert [frame.index for frame in shown] == sorted(frame.index for frame in shown)
    assert extremes([3, 1, 2], 4, float) == [3, 1, 2]
    assert extremes(list(range(100)), 4, float) == [0, 49, 50, 99]
    assert extremes([7] * 100, 4, float) == [7, 7]


def contents(path: Path) -> tuple[int, int, dict[str, int]]:
    """(chunks, bytes, rows by entity) of what is not static."""
    chunks = size = 0
    rows: Counter[str] = Counter()
    for chunk in RrdReader(path).stream():
        if not chunk.is_static and not chunk.entity_path.startswith("/__"):
            batch = chunk.to_record_batch()
            chunks, size = chunks + 1, size + batch.nbytes
            rows[chunk.entity_path] += batch.num_rows
    return chunks, size, rows


def to_file(path: Path) -> rr.RecordingStream:
    rec = rr.RecordingStream("deformscope-rig", recording_id="rig")
    rec.set_sinks(rr.FileSink(path))
    return rec


@pytest.mark.parametrize("places", [None, [Place(2, np.arange(30) * 33_000_000), Place(3, np.arange(31) * 33_000_000)]])
def test_a_second_is_few_and_small_chunks(tmp_path: Path, second: list[Item], places: list[Place] | None) -> None:
    path = tmp_path / "live.rrd"
    stream = LiveStream(to_file(path), lambda timeout_s: None)
    batches = list(rig.batches(second))
    for at, batch in enumerate(batches):
        place = None if places is None else places[0 if at < len(batches) // 2 else 1]
        stream.add_items(batch, rig.START_NS, rig.STREAMS, place)
        if (at + 1) * FLUSHES_A_SECOND // len(batches) > at * FLUSHES_A_SECOND // len(batches):
            stream.flush(timeout_sec=10)
    stream.disconnect()
    chunks, size, rows = contents(path)
    assert chunks <= MOST_CHUNKS
    assert size <= MOST_BYTES
    assert 1 <= rows["/color/front"] <= FLUSHES_A_SECOND + 1
    assert 40 <= rows["/wrench/fingertip/force_n/0"] <= 2 * WRENCH_HZ
    assert not any(path.startswith("/raw") for path in rows)
    if places is not None:
        touches = {
            value
            for chunk in RrdReader(path).stream()
            if chunk.entity_path == "/wrench/fingertip/force_n/0" and not chunk.is_static
            for value in chunk.to_record_batch().column("touch").to_pylist()
        }
        assert touches == {2, 3}


def test_a_flush_says_whether_the_viewer_answers(tmp_path: Path) -> None:
    rec = to_file(tmp_path / "live.rrd")
    asked: list[float] = []

    def silent(timeout_s: float) -> None:
        asked.append(timeout_s)
        raise TimeoutError("nothing came")

    stream = LiveStream(rec, silent)
    with pytest.raises(TimeoutError, match="nothing came"):
        stream.flush(timeout_sec=3.0)
    assert asked == [3.0]
    stream.disconnect()


class Frozen:
    """A stream whose viewer takes nothing. waits: until its time is over, else it says at once that it is severed"""

    def __init__(self, waits: bool) -> None:
        self._waits = waits

    def flush(self, *, timeout_sec: float) -> None:
        if self._waits:
            threading.Event().wait(timeout_sec)
        raise RuntimeError("not all messages were sent")


def test_a_severed_stream_is_no_slow_one() -> None:
    with pytest.raises(TimeoutError, match="not all"):
        LiveStream(Frozen(waits=True), lambda timeout_s: None).flush(timeout_sec=0.01)  # type: ignore[arg-type]
    with pytest.raises(RuntimeError, match="not all"):
        LiveStream(Frozen(waits=False), lambda timeout_s: None).flush(timeout_sec=60.0)  # type: ignore[arg-type]


@pytest.fixture
def shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a recorder sends to its viewer goes into this file."""
    path = tmp_path / "shown.rrd"
    monkeypatch.setattr(recorder, "start_viewer", lambda: Viewer(0, 0))
    monkeypatch.setattr(recorder, "live_stream", lambda *given: LiveStream(to_file(path), lambda timeout_s: None))
    return path


def test_the_file_keeps_everything_that_the_viewer_does_not_get(
    tmp_path: Path, second: list[Item], shown: Path
) -> None:
    items = [item for item in second if not isinstance(item, ColorFrame | DepthFrame)]
    items += [rig.color(index, size=(48, 640)) for index in range(30)]
    with Recorder(tmp_path / "run.rrd", "native", {}, application=RIG) as made:
        made.start(RigLayout(rig.STREAMS), rig.START_NS)
        for batch in rig.batches(sorted(items, key=rig.host_ns)):
            made.write(batch)
    assert made.summary().dropped == 0
    kept, live = contents(tmp_path / "run.rrd")[2], contents(shown)[2]
    assert kept["/wrench/fingertip/force_n/0"] == 1000
    assert kept["/color/front"] == 30
    assert kept["/raw/fingertip"] > 0
    assert 0 < live["/wrench/fingertip/force_n/0"] < 400
    assert 0 < live["/color/front"] < 30
    sizes = {
        cv2.imdecode(np.array(blob[0], np.uint8), cv2.IMREAD_UNCHANGED).shape[1]
        for chunk in RrdReader(shown).stream()
        if chunk.entity_path == "/color/front" and not chunk.is_static
        for blob in chunk.to_record_batch().column("EncodedImage:blob").to_pylist()
    }
    assert sizes == {COLOR_WIDTH}


def test_what_no_view_of_an_exploration_shows_is_not_sent(tmp_path: Path, shown: Path) -> None:
    streams = [stream for stream in rig.STREAMS if stream.kind in ("wrench", "depth")]
    with Recorder(tmp_path / "run.rrd", "native", {}, application=EXPLORATION) as made:
        made.start(ExplorationLayout(tuple(streams), (0.6, 0.4), None, truth=True), rig.START_NS)
        made.write(InputFile("explored/looked", b"the whole cloud"))
        for at_s, touch, result in synthetic_exploration.story():
            if touch <= 1:  # with it every kind of result has come
                made.write(Step((result,), moment=Moment(rig.ns(at_s), touch, cell_m=0.01)))
    kept, live = contents(tmp_path / "run.rrd")[2], contents(shown)[2]
    recorded, sent = ({path for path in rows if not path.startswith("/display")} for rows in (kept, live))
    assert recorded > {"/exploration/maps", "/input", "/exploration/phase"}
    assert sent == {"/exploration/phase"}
    assert set(kept) - recorded == set(live) - sent


def test_a_state_is_sent_when_it_changes(tmp_path: Path) -> None:
    """And the table of all devices with every look."""
    stream = LiveStream(to_file(tmp_path / "live.rrd"), lambda timeout_s: None)
    for at_s in np.arange(1.0, 9.0):  # the hand's link is lost at 5 s
        stream.add_items([rig.health(float(at_s))], rig.START_NS, rig.STREAMS, None)
        stream.flush(timeout_sec=10)
    stream.disconnect()
    rows = contents(tmp_path / "live.rrd")[2]
    assert (rows["/health"], rows["/health/fingertip"], rows["/health/hand"]) == (8, 1, 3)
