"""What is shown of stages on live devices, read back from a recording."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deformscope.frames import PadLayout, StageResult, Stream, UsedFrames
from deformscope.log.rig.tactile import Hand
from deformscope.log.stages import log_stage_streams, prepare_stage_results, summary
from deformscope.log.stages.over_image import stage_blueprint
from deformscope.recording.items import read_stage_results
from deformscope.rows import FORMAT
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import StageFailure, SurfaceEstimate, TouchEstimate
from deformscope.stages.poke.tip_wrench import TipWrench
from deformscope.stages.see.arrows import FlowArrows
from deformscope.stages.see.tactile import TactileContact, tactile_contact
from tests.log.synthetic_exploration import bare_touch

START_NS = 1_000
PADS = tuple(
    PadLayout(f"{name}_distal", 4, 3, (3.4e-3, 2.0e-3), at, at, 1) for at, name in enumerate(("thumb", "finger_0"))
)
STREAMS = (
    Stream("camera", "color", "webcam"),
    Stream("depth", "depth", "depth_camera", simulated=True),
    Stream("pads", "tactile", "dsa", pads=PADS, full_scale_pa=3000.0),
    Stream("tip", "wrench", "netft", torques=True),
)
STAGES = (
    *((name, "camera") for name in ("flow", "beta")),
    *(("surface", "depth"), ("tactile", "pads"), ("contact", "tip"), ("wrench", "tip")),
)


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def results() -> list[StageResult]:
    """Two of each kind, the second one later, and a failure."""
    at = np.stack(np.meshgrid(np.arange(10.0, 60.0, 10.0), np.arange(10.0, 40.0, 10.0)), axis=-1).reshape(-1, 2)
    felt = np.zeros((4, 3))
    felt[2, 1] = 1000.0
    seen = np.arange(len(at)) != 3
    nan = np.full_like(at, np.nan)
    made: list[Any] = [
        ("flow", "camera", FlowArrows(at, np.tile([3.0, -1.0], (len(at), 1)), np.zeros(len(at)))),
        ("beta", "camera", MomentFit(at, at + 1.0, at + 2.0, seen, np.array([0, 1]), np.ones(len(at)), "beta", 0.9,
                                     (0.8, 0.95), "identified", "identified: beta is 0.8 to 0.95", 0.2, 0.9)),
        ("beta", "camera", MomentFit(at, at + 1.0, nan, seen, np.zeros(0, np.int64), np.ones(len(at)), "beta", np.nan,
                                     (np.nan, np.nan), "unidentified", "unidentified: why", np.nan, np.nan)),
        ("surface", "depth", SurfaceEstimate(np.ones((5, 3)), np.full((4, 6), 0.05), np.full((4, 6), 1e-3), 0.01)),
        ("tactile", "pads", tactile_contact([felt, 0 * felt], [pad.texel_m for pad in PADS])),
        ("tactile", "pads", tactile_contact([0 * felt, 0 * felt], [pad.texel_m for pad in PADS])),
        ("contact", "tip", touch()),
        ("flow", "camera", StageFailure("flow", 0, "too dark", "trace")),
        ("wrench", "tip", TipWrench(np.array([0.0, 3.0, 4.0]), np.array([0.0, 0.0, 0.25]), np.zeros(3))),
        ("wrench", "tip", TipWrench(np.array([0.0, 0.0, 2.0]), None, np.zeros(3))),
    ]  # fmt: skip
    return [
        StageResult(
            stage, (UsedFrames(device, 0, 0), UsedFrames(device, 2 * n, 2 * n)), START_NS + 10**8 * n, n, 0.1 * n, one
        )
        for n, (stage, device, one) in enumerate(made)
    ]


def used(device: str, newest: int) -> tuple[UsedFrames, ...]:
    return UsedFrames(device, 0, 0), UsedFrames(device, newest, newest)


def fields(result: Any) -> dict[str, Any]:
    return {field.name: getattr(result, field.name) for field in dataclasses.fields(result)}


def touch() -> TouchEstimate:
    way = np.linspace(0.0, 0.01, 9)
    return dataclasses.replace(
        bare_touch(),
        approach_m=way,
        approach_n=way * 200,
        fitted_n=way * 200,
        contact_m=0.001,
        stiffness_n_per_mm=0.4,
        stiffness_interval=(0.3, 0.5),
        depth_m=0.009,
        peak_force_n=2.0,
        beta_verdict="not asked for",
    )


def written(path: Path, given: list[StageResult], **options: Any) -> dict[str, list[Any]]:
    """Rows by entity."""
    rec = rr.RecordingStream("deformscope-rig", recording_id="stages")
    rec.set_sinks(rr.FileSink(path))
    rec.send_property("session", rr.AnyValues(True, format=FORMAT))
    rec.send_blueprint(stage_blueprint(STAGES, STREAMS))
    log_stage_streams(rec, STAGES, STREAMS)
    prepare_stage_results(given, START_NS, STREAMS, **options).send(rec)
    rec.flush(timeout_sec=10)
    rec.disconnect()
    found: dict[str, list[Any]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            found.setdefault(chunk.entity_path, []).extend(chunk.to_record_batch().to_pylist())
    return found


def test_every_result_comes_back_at_its_frame(tmp_path: Path) -> None:
    given = results()
    rows = written(tmp_path / "r.rrd", given)
    found = read_stage_results(tmp_path / "r.rrd", trust=True)
    assert [(one.stage, one.used, one.host_ns, one.skipped, one.late_s) for one in found] == [
        (one.stage, one.used, one.host_ns, one.skipped, one.late_s) for one in given
    ]
    for one, other in zip(found, given, strict=True):
        assert type(one.result) is type(other.result)
        np.testing.assert_equal(fields(one.result), fields(other.result))
    place = {row["frame"]: row["session"] for row in rows["/stage/tactile/pads"]}
    assert {frame: time.total_seconds() for frame, time in place.items()} == {8: 0.4, 10: 0.5}


def test_the_center_of_pressure_is_drawn_on_its_texel(tmp_path: Path) -> None:
    rows = written(tmp_path / "r.rrd", results())["/display/tactile/pads/contact"]
    top, left = Hand.of(PADS).corners[0]
    assert rows[0]["Points2D:positions"] == [pytest.approx([(left + 1.5) * 3.4, (top + 2.5) * 2.0])]
    assert rows[0]["Points2D:labels"] == ["0.01 N, 0.1 cm2"]
    assert rows[1]["Points2D:positions"] == []  # nothing is touched: the mark goes


def test_numbers_over_time_have_every_result_and_marks_may_be_the_newest_alone(tmp_path: Path) -> None:
    every = written(tmp_path / "file.rrd", results())
    newest = written(tmp_path / "live.rrd", results(), newest_pictures=True)
    for rows in (every, newest):
        assert [row["Scalars:scalars"] for row in rows["/display/stage/plot/lag/tactile"]] == [[400.0], [500.0]]
        assert rows["/display/stage/plot/beta"][0]["Scalars:scalars"] == [0.8, 0.9, 0.95]
        assert len(rows["/display/stage/plot/force/pads"]) == 2
    assert len(every["/display/stage/beta/camera/observed"]) == 2
    assert len(newest["/display/stage/beta/camera/observed"]) == 1
    assert len(every["/display/stage/surface"]) == len(every["/display/stage/contact"]) == 1
    assert [len(row["Points2D:positions"]) for row in every["/display/stage/beta/camera/held"]] == [2, 0]


def test_force_and_torque_at_the_tip_are_over_time_and_a_torque_is_absent_from_three_axes(tmp_path: Path) -> None:
    rows = written(tmp_path / "r.rrd", results())
    plotted = {
        quantity: [row["Scalars:scalars"] for row in rows[f"/display/stage/plot/{quantity}/tip"]]
        for quantity in ("force", "torque")
    }
    assert plotted == {"force": [[0, 3, 4], [0, 0, 2]], "torque": [[0, 0, 0.25]]}
    (first,), (last,) = (row["TextDocument:text"] for row in rows["/display/stage/summary"][-2:])
    assert "| wrench | **5 N**, **0.25 N m** about the tip | tip 16 |" in first
    assert "| wrench | **2 N**, no torque: three axes | tip 18 |" in last


def test_the_table_keeps_the_newest_of_every_stage(tmp_path: Path) -> None:
    given, latest = results(), dict[str, StageResult]()
    written(tmp_path / "one.rrd", given[:4], latest=latest)
    rows = written(tmp_path / "two.rrd", given[4:], latest=latest)
    (first,), (text,) = (rows["/display/stage/summary"][at]["TextDocument:text"] for at in (0, -1))
    assert text == summary(list(latest.values()))
    assert "| tactile | **0.0068 N** on 0.068 cm2, 1 of 2 pads | pads 8 |" in first
    assert "| flow | median motion 3.2 px, largest 3.2 px | camera 0 |" in first
    assert "| beta | unidentified: why; 14 of 15 particles seen | camera 4 | 2 | **200 ms** |" in text
    assert "| flow | **FAILED**: too dark | camera 14 | 7 | **700 ms** |" in text
    assert "| surface | median height 50 mm, deviation 1 mm, 5 points | depth 6 | 3 | **300 ms** |" in text
    assert "| contact | 0.4 N/mm | tip 12 | 6 | **600 ms** |" in text
    assert "| tactile | **0 N** on 0 cm2, 0 of 2 pads | pads 10 | 5 | **500 ms** |" in text


def test_a_moment_without_motion_has_no_arrows(tmp_path: Path) -> None:
    still = results()[:1]
    flow = still[0].result
    assert isinstance(flow, FlowArrows)
    still = [
        StageResult("flow", still[0].used, START_NS, 0, 0.0, FlowArrows(flow.at_px, 0 * flow.flow_px, flow.noise_px))
    ]
    assert written(tmp_path / "r.rrd", still)["/display/stage/flow/camera/arrows"][0]["Arrows2D:vectors"] == []


def test_a_result_of_an_unknown_kind_is_a_fault() -> None:
    with pytest.raises(TypeError):
        summary([StageResult("tactile", (UsedFrames("pads", 0, 0),), 0, 0, 0.0, TactileContact)])
