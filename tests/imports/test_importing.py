"""Imports: what was exported comes back to the last bit; what others wrote becomes frames; what is wrong is a line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope.cli import main
from deformscope.frames import ColorFrame, DepthFrame, Frame, WrenchFrame
from deformscope.log.rig_layout import RIG, RigLayout
from deformscope.recording.export.export import ExportRequest, export
from deformscope.recording.items import read_items, read_streams
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.recording.streams import RecordingTables
from deformscope.rows import differing
from deformscope_drivers.clock import Stamp
from tests.log import synthetic_rig as rig

RECORDINGS = Path(__file__).resolve().parents[2] / "recordings"
BENCH, EXPLORED = RECORDINGS / "rig.rrd", RECORDINGS / "explore.rrd"


def frames_of(path: Path) -> dict[str, list[Frame]]:
    found: dict[str, list[Frame]] = {}
    for item in read_items(path):
        if isinstance(item, Frame):
            found.setdefault(item.device, []).append(item)
    return found


def brought_back(path: Path, to: Any, folder: Path) -> Path:
    """Exported, inspected, imported with the map that was proposed."""
    folder.mkdir(exist_ok=True)
    out, again = folder / to, folder / f"{to}.rrd"
    export(Replay(path), ExportRequest(to=to, folder=out), lambda *_: None)
    source = next(out.glob("*.mcap")) if to == "mcap" else out
    (folder / "map.toml").write_text(inspected(source))
    assert main(["import", str(source), "--map", str(folder / "map.toml"), "--record", str(again)]) == 0
    return again


def inspected(source: Path) -> str:
    from deformscope.config import ImportConfig
    from deformscope.runs.importing import inspect_source

    return inspect_source(ImportConfig(source=source, inspect=True)).toml


def differences(before: list[Frame], now: list[Frame]) -> set[str]:
    assert len(before) == len(now)
    found = {differing(one, other) for one, other in zip(before, now, strict=True)}
    return {name for name in found if name is not None}


@pytest.mark.parametrize("path", [BENCH, EXPLORED], ids=lambda path: path.stem)
@pytest.mark.parametrize("to", ["parquet", "mcap", "csv"])
def test_what_was_exported_comes_back_to_the_last_bit(path: Path, to: str, tmp_path: Path) -> None:
    if to == "mcap":
        pytest.importorskip("mcap_ros2")
        pytest.importorskip("rosbags")
    again = brought_back(path, to, tmp_path)
    before, now = frames_of(path), frames_of(again)
    if to == "csv":  # has no images
        before = {name: frames for name, frames in before.items() if not isinstance(frames[0], ColorFrame | DepthFrame)}
    assert before.keys() == now.keys()
    for name, frames in before.items():
        assert not differences(frames, now[name]), name
    assert RecordingTables(Replay(path)).start_ns == RecordingTables(Replay(again)).start_ns
    pads = {one.device: one.pads for one in read_streams(path)}
    assert {one.device: one.pads for one in read_streams(again)} == {name: pads[name] for name in now}
    assert main(["replay", str(again)]) == 0
    assert main(["verify", str(again)]) == 0


numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=12, deadline=None)
@given(forces=st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=6), late=st.booleans())
def test_any_force_comes_back(forces: list[tuple[float, float, float]], late: bool, tmp_path_factory: Any) -> None:
    folder = tmp_path_factory.mktemp("any")
    frames = [
        WrenchFrame(
            Stamp(rig.ns(at / 100), 3 * at, 1000 if late else None),
            at,
            np.array([at, -at, 2**40 + at]),
            np.array([force]),
            device="tip",
        )
        for at, force in enumerate(forces)
    ]
    path = folder / "r.rrd"
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        made.start(RigLayout((rig.Stream("tip", "wrench", "optoforce"),)), rig.START_NS)
        made.write(frames)
    for to in ("parquet", "csv", "mcap"):
        assert not differences(list(frames), frames_of(brought_back(path, to, folder))["tip"]), to
