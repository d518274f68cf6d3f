"""A replay gives back what was recorded, bit for bit, or says why it cannot."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from deformscope.errors import InputError
from deformscope.files.sources import open_source
from deformscope.frames import ColorFrame, InputFile
from deformscope.images import encode_png
from deformscope.log.layout import PAIR
from deformscope.recording.items import read_estimates
from deformscope.recording.ledger import ledger_path, write_ledger
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.rows import FORMAT, differing
from deformscope.session import Step, run
from deformscope_drivers.clock import Stamp
from tests.log import synthetic


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def colour(count: int, depth: type) -> list[ColorFrame]:
    rng = np.random.default_rng(1)
    top = np.iinfo(depth).max
    return [
        ColorFrame(Stamp(7 + index**2, 100 + index), index, rng.integers(0, top, (20, 30, 3), depth, endpoint=True))
        for index in range(count)
    ]


def record(path: Path, frames: list[ColorFrame], **options: object) -> Path:
    with Recorder(path, "none", {"beta": 0.5, "name": "ä"}, **options) as made:  # type: ignore[arg-type]
        for frame in frames:
            made.write(frame)
    return path


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("deterministic", [False, True])
def test_frames_come_back_bit_for_bit(tmp_path: Path, depth: type, deterministic: bool) -> None:
    for name, frames in (("grey", list(synthetic.frames(70, depth=depth))), ("colour", colour(5, depth))):
        replayed = list(Replay(record(tmp_path / f"{name}.rrd", frames, deterministic=deterministic)).frames())
        assert [frame.stamp for frame in replayed] == [frame.stamp for frame in frames]
        assert [frame.index for frame in replayed] == [frame.index for frame in frames]
        for again, frame in zip(replayed, frames, strict=True):
            assert again.image.dtype == depth
            np.testing.assert_array_equal(again.image, frame.image)


def test_frames_recorded_out_of_order_come_in_order(tmp_path: Path) -> None:
    frames = list(synthetic.frames(6))
    path = record(tmp_path / "run.rrd", [frames[index] for index in (0, 3, 1, 2, 5, 4)])
    for again, frame in zip(Replay(path).frames(), frames, strict=True):
        np.testing.assert_array_equal(again.image, frame.image)


def test_settings_and_mask(tmp_path: Path) -> None:
    mask = np.zeros((48, 64), np.uint8)
    mask[10:20, 5:50] = 255
    with Recorder(tmp_path / "run.rrd", "none", {"beta": 0.5, "name": "ä"}) as made:
        for frame in synthetic.frames(2):
            made.write(frame)
        made.write(InputFile("mask", encode_png(mask)))
    replay = Replay(tmp_path / "run.rrd")
    assert replay.settings == {"beta": 0.5, "name": "ä"}
    assert replay.mask is not None
    np.testing.assert_array_equal(replay.mask, mask)
    assert Replay(record(tmp_path / "bare.rrd", list(synthetic.frames(2)))).mask is None


def test_pairs_in_their_order(tmp_path: Path) -> None:
    files = [np.random.default_rng(index).bytes(5000 + index) for index in range(12)]
    with Recorder(tmp_path / "run.rrd", "none", {}, application=PAIR) as made:
        for index, content in enumerate(files):
            made.write(InputFile(f"pair/{index}", content))
    assert Replay(tmp_path / "run.rrd").read_numbered("pair") == files
    with Recorder(tmp_path / "one.rrd", "none", {}, application=PAIR) as made:
        made.write(InputFile("pair", files[0]))
    assert Replay(tmp_path / "one.rrd").read_numbered("pair") == files[:1]


def test_results(tmp_path: Path) -> None:
    verdicts = ["weak", "identified", "at-bound"]
    with Recorder(tmp_path / "run.rrd", "none", {}, application=PAIR) as made:
        for index, verdict in enumerate(verdicts):
            made.write(Step((synthetic.pair_in_plane(), synthetic.estimate(verdict, "m")), frame=index))
    results = read_estimates(Replay(tmp_path / "run.rrd"))
    assert [result.verdict for result in results] == verdicts
    assert differing(results[0], synthetic.estimate("weak", "m")) is None
    assert np.isnan(results[0].settings["noise"])
    assert results[0].curve.parameter[0] == 0.05


def test_a_recording_is_a_source(tmp_path: Path) -> None:
    with open_source(["sample:tension"], fps=2.0) as source, Recorder(tmp_path / "run.rrd") as made:
        run(source, synthetic.calibration(), made)
    with open_source(["sample:tension"], fps=2.0) as first, open_source([tmp_path / "run.rrd"]) as again:
        pairs = list(zip(first, again, strict=True))
        assert len(pairs) == 7
        for frame, replayed in pairs:
            assert frame.stamp == replayed.stamp
            np.testing.assert_array_equal(frame.image, replayed.image)
    with open_source([tmp_path / "run.rrd"], stride=4) as source:
        assert [(frame.index, frame.stamp.host_ns) for frame in source] == [(0, 0), (1, 2 * 10**9)]


def test_recording_a_replay_gives_the_same_results(tmp_path: Path) -> None:
    summaries = []
    with open_source(["sample:tension"]) as source, Recorder(tmp_path / "a.rrd", deterministic=True) as made:
        summaries.append(run(source, synthetic.calibration(), made))
    with open_source([tmp_path / "a.rrd"]) as source, Recorder(tmp_path / "b.rrd", deterministic=True) as made:
        summaries.append(run(source, synthetic.calibration(), made))
    assert summaries[0] == summaries[1]
    for one, two in zip(Replay(tmp_path / "a.rrd").frames(), Replay(tmp_path / "b.rrd").frames(), strict=True):
        assert one.stamp == two.stamp
        np.testing.assert_array_equal(one.image, two.image)


def test_steps_wait(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", list(synthetic.frames(3)))
    waited: list[int] = []
    for frame in Replay(path).frames("step", lambda frame: waited.append(frame.index)):
        assert waited == list(range(frame.index + 1))
    with pytest.raises(ValueError, match="wait"):
        next(Replay(path).frames("step"))


def test_real_pace_takes_the_recorded_time(tmp_path: Path) -> None:
    frames = Replay(record(tmp_path / "run.rrd", list(synthetic.frames(4)))).frames("real")
    started = time.monotonic()  # before the first is given: a busy machine must not take from the others' time
    next(frames)
    assert len(list(frames)) == 3
    assert time.monotonic() - started > 0.08


def test_refuses_a_flipped_bit(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", list(synthetic.frames(3)))
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match="that matches its ledger"):
        Replay(path)


def test_warns_where_there_is_no_ledger(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = record(tmp_path / "run.rrd", list(synthetic.frames(3)))
    ledger_path(path).unlink()
    assert Replay(path).frame_count == 3
    assert "no ledger" in caplog.text


@pytest.mark.parametrize("keep", [0.02, 0.5, 0.9, 0.999])
def test_refuses_a_cut_recording(tmp_path: Path, keep: float) -> None:
    path = record(tmp_path / "run.rrd", list(synthetic.frames(40)))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * keep)])
    with pytest.raises(InputError, match="ledger"):
        list(Replay(path).frames())
    ledger_path(path).unlink()
    with contextlib.suppress(InputError):  # where the cut falls between two messages, what is there is whole
        for again, frame in zip(Replay(path).frames(), synthetic.frames(40), strict=False):
            np.testing.assert_array_equal(again.image, frame.image)


def test_refuses_what_is_no_recording_of_ours(tmp_path: Path) -> None:
    text = tmp_path / "notes.rrd"
    text.write_text("no recording")
    (tmp_path / "empty.rrd").touch()
    (tmp_path / "magic.rrd").write_bytes(b"RRF2" + bytes(500))
    foreign = tmp_path / "foreign.rrd"
    rec = rr.RecordingStream("someone_else")
    rec.set_sinks(rr.FileSink(foreign))
    rec.log("points", rr.Points2D([[1.0, 2.0]]))
    rec.flush(timeout_sec=10)
    rec.disconnect()
    for path in (text, tmp_path / "empty.rrd", tmp_path / "magic.rrd", foreign, tmp_path, tmp_path / "gone.rrd"):
        if path.is_file():
            write_ledger(path)
        with pytest.raises(InputError, match="recording") as refused:
            Replay(path)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("format_number", "came"),
    [
        (99, "one of format 99, written by deformscope 7.8"),
        (2, "one of format 2, written by deformscope 7.8"),
        (None, "one of format None, written by deformscope of unknown version"),
    ],
    ids=["newer", "older", "none"],
)
def test_another_format_is_refused_in_a_line(tmp_path: Path, format_number: int | None, came: str) -> None:
    path = tmp_path / "run.rrd"
    rec = rr.RecordingStream("deformscope-rig", recording_id="rig")
    rec.set_sinks(rr.FileSink(path))
    told = {} if format_number is None else {"format": format_number, "versions": '{"deformscope": "7.8"}'}
    rec.send_property("session", rr.AnyValues(True, settings="{}", **told))
    rec.flush(timeout_sec=10)
    rec.disconnect()
    with pytest.raises(InputError, match=f"expected a recording of format {FORMAT}; got {came}") as refused:
        Replay(path, trust=True)
    assert "\n" not in str(refused.value)
