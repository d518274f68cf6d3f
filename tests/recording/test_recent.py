"""The last seconds, held in memory: bounded, and what is written of them is a whole recording that counts its own."""

import dataclasses
import json
from pathlib import Path

import numpy as np

from deformscope.frames import HealthReport, Item, Stream, WrenchFrame
from deformscope.log.layout import RIG
from deformscope.recording.recent import RecentItems, end_with_recent
from deformscope.recording.recorder import Recorder
from deformscope.runs.recordings import OpenRecording
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link
from tests.verified import verify_here

TIP = Stream("tip", "wrench", "optoforce")
RATE_HZ = 20


def batches(seconds: int, lost: dict[int, int] | None = None) -> list[list[Item]]:
    """One a second: readings, and a look after them. lost: so many in these seconds"""
    found, index, received, gone = list[list[Item]](), 0, 0, 0
    for second in range(seconds):
        batch: list[Item] = []
        index += (lost or {}).get(second, 0)
        gone += (lost or {}).get(second, 0)
        for at in range(RATE_HZ):
            when = Stamp(second * 10**9 + at * 10**9 // RATE_HZ)
            batch.append(WrenchFrame(when, index, np.array([index, 0, 7]), np.full((1, 3), np.nan), device="tip"))
            index, received = index + 1, received + 1
        look = Health(Link.CONNECTED, received=received, lost=gone, rate_hz=RATE_HZ)
        found.append([*batch, HealthReport((second + 1) * 10**9, (("tip", look),))])
    return found


def test_it_holds_the_seconds_asked_for_and_no_more_memory() -> None:
    recent = RecentItems(5.0)
    most = 0
    for batch in batches(60):
        recent.add(batch)
        assert recent.held_s <= 6.0
        most = max(most, recent.held_bytes)
    assert recent.held_s == 5.0
    small = RecentItems(1e6, most_bytes=most // 2)
    for batch in batches(60):
        small.add(batch)
    assert small.held_bytes <= most // 2
    assert 1.0 < small.held_s < 3.0  # and it says that it holds less


def test_the_last_seconds_are_a_whole_recording(tmp_path: Path) -> None:
    """Of 40 s with losses in the 3rd and in the 38th second: the readings of the last ones, and their losses alone."""
    recent, path = RecentItems(5.0), tmp_path / "kept.rrd"
    given = batches(40, lost={3: 4, 37: 2})
    for batch in given:
        recent.add(batch)
    recorder = Recorder(path, settings={"rig_name": "one"}, application=RIG)
    recorder.__enter__()
    end_with_recent(recorder, recent, [TIP], (), None)
    assert verify_here(path) == 3  # whole, with losses
    found = OpenRecording(path)
    frames = [item for item in found.items() if isinstance(item, WrenchFrame)]
    expected = [item for batch in given[-5:] for item in batch if isinstance(item, WrenchFrame)]
    assert [(frame.index, frame.stamp, frame.counts.tolist()) for frame in frames] == [
        (frame.index, frame.stamp, frame.counts.tolist()) for frame in expected
    ]
    assert json.loads(found.outcome["counts"])["tip/frames"] == len(frames) == 5 * RATE_HZ
    assert json.loads(found.outcome["losses"]) == {"tip": {"readings": 2.0}}
    looks = [dict(item.devices)["tip"] for item in found.items() if isinstance(item, HealthReport)]
    assert [look.received for look in looks] == [RATE_HZ * at for at in range(6)]


def test_what_was_held_when_a_session_failed_is_kept_unfinished(tmp_path: Path) -> None:
    recent, path = RecentItems(5.0), tmp_path / "kept.rrd"
    for batch in batches(3):
        recent.add(batch)
    recorder = Recorder(path, application=RIG)
    recorder.__enter__()
    end_with_recent(recorder, recent, [dataclasses.replace(TIP)], (), RuntimeError)
    assert not path.exists()
    assert recorder.summary().frames == 2 * RATE_HZ
    assert (tmp_path / "kept.part.rrd").stat().st_size > 1000


def test_nothing_was_there_to_be_held(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "kept.rrd", application=RIG)
    recorder.__enter__()
    end_with_recent(recorder, RecentItems(5.0), [TIP], (), None)
    assert verify_here(tmp_path / "kept.rrd") == 0
