"""What an exploration found is recorded without loss, and what is shown of it is what was found."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deformscope.arrays import FloatArray
from deformscope.frames import ColorFrame, DepthFrame, Item, Stream
from deformscope.images import encode_png
from deformscope.log.exploration.display import summary
from deformscope.log.exploration.results import exploration_blueprint, log_exploration_start, prepare_results
from deformscope.log.layout import EXPLORATION, ExplorationLayout
from deformscope.log.rig import Place, log_streams, prepare_items
from deformscope.recording.items import read_items, read_results
from deformscope.recording.reader import Row
from deformscope.recording.recorder import Recorder
from deformscope.rows import FORMAT
from deformscope.session import Moment, Step
from deformscope.stages.map.exploration import ExplorationStop, MapEstimate, PhaseStart, StageFailure, TouchEstimate
from tests.log import synthetic_exploration as synthetic
from tests.log import synthetic_rig as rig
from tests.log.test_rig import assert_same, cells, order, same

BASE_FROM_SURFACE = np.array(
    [[0.0, -1.0, 0.0, 0.35], [1.0, 0.0, 0.0, -0.3], [0.0, 0.0, 1.0, -0.02], [0.0, 0.0, 0.0, 1.0]]
)
ARM = dataclasses.replace(rig.STREAMS[2], urdf=rig.URDF)

PICTURES_NS = np.arange(0, 10_000_000_000, 100_000_000)

Told = tuple[int, int, Sequence[object]]


@pytest.fixture(autouse=True)
def strict(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Pictures are a pixel: tests/pictures see to them."""
    pixel = encode_png(np.zeros((1, 1, 3), np.uint8))
    monkeypatch.setattr("deformscope.pictures.exploration._one", lambda *_: pixel)
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def record(path: Path, told: Sequence[Told], items: Sequence[Item] = (), streams: Sequence[Stream] = (ARM,)) -> None:
    """told: (session [ns], touch, results)"""
    rec = rr.RecordingStream("deformscope-explore", recording_id="exploration")
    rec.set_sinks(rr.FileSink(path))
    rec.send_property("session", rr.AnyValues(True, format=FORMAT))
    rec.send_blueprint(exploration_blueprint(streams))
    log_streams(rec, streams)
    log_exploration_start(rec, streams, BASE_FROM_SURFACE)
    for session_ns, touch, results in told:
        prepare_results(results, session_ns, Place(touch, PICTURES_NS)).send(rec)
    if items:
        prepare_items(items, rig.START_NS, streams, {"front"}, place=Place(3, PICTURES_NS)).send(rec)
    rec.flush(timeout_sec=10)
    rec.disconnect()


def back(path: Path) -> list[Row]:
    return list(read_results(path, trust=True))


def assert_equal(found: object, expected: Any) -> None:
    assert type(found) is type(expected)
    for field in dataclasses.fields(expected):
        one, other = getattr(found, field.name), getattr(expected, field.name)
        if dataclasses.is_dataclass(other):
            assert_equal(one, other)
        else:
            same(one, other, f"{field.name} of {type(expected).__name__}")


def test_results_come_back_equal_to_the_last_bit(tmp_path: Path) -> None:
    told: list[Told] = [
        *((round(at * 1e9), touch, [result]) for at, touch, result in synthetic.story() if at < 6.9),
        (7_500_000_001, 2, [synthetic.touch(1), synthetic.maps(2, truth=False), synthetic.lumps(), synthetic.plan(2)]),
        (60_000_000_000, 8, [synthetic.rigid_touch(7), synthetic.lumps((0.2, 0.1, 0.02)), synthetic.plan(8)]),
        (61_000_000_000, 9, [synthetic.gradual(8), StageFailure("beta", 9, "ValueError: x", "Traceback\n...")]),
    ]
    record(tmp_path / "run.rrd", told)
    found = back(tmp_path / "run.rrd")
    expected = [(session_ns, touch, result) for session_ns, touch, results in told for result in results]
    assert [(one.session_ns, one.touch) for one in found] == [one[:2] for one in expected]
    for one, (_, _, result) in zip(found, expected, strict=True):
        assert_equal(one.item, result)


def test_values_that_are_no_numbers_or_not_there_come_back(tmp_path: Path) -> None:
    none = np.zeros((0, 3))
    touch = dataclasses.replace(synthetic.touch(0), observed_m=none, simulated_m=none, approach_n=np.full(120, np.nan))
    maps = synthetic.maps(1)
    holed = maps.stiffness_n_per_mm.copy()
    holed[3, 4:9] = np.nan, np.inf, -0.0, np.nextafter(1.0, 2.0), 5e-324
    maps = dataclasses.replace(maps, stiffness_n_per_mm=holed, contacts_m=np.zeros((0, 2)), touches=0)
    plan = dataclasses.replace(synthetic.plan(0), reason="weil's so ist: |µ| → ∞\n", excluded=np.ones((2, 3), np.bool_))
    record(tmp_path / "run.rrd", [(5, 0, [touch, maps, plan])])
    for one, expected in zip(back(tmp_path / "run.rrd"), (touch, maps, plan), strict=True):
        assert_equal(one.item, expected)
        for field in dataclasses.fields(expected):
            value = getattr(expected, field.name)
            if isinstance(value, np.ndarray):
                assert getattr(one.item, field.name).tobytes() == value.tobytes(), field.name


def test_one_kind_alone_is_read(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", [(5, 0, [synthetic.plan(0), PhaseStart("plan", 0), PhaseStart("stopped", 0)])])
    found = list(read_results(tmp_path / "run.rrd", (PhaseStart,), trust=True))
    assert [one.item for one in found] == [PhaseStart("plan", 0), PhaseStart("stopped", 0)]


def test_a_reader_can_ask_for_the_numbers_of_a_touch(tmp_path: Path) -> None:
    told = [(k, k, [synthetic.maps(k)]) for k in (1, 2, 5)]
    record(tmp_path / "run.rrd", told)
    found: dict[int, Any] = {}
    for chunk in RrdReader(tmp_path / "run.rrd").stream():
        if chunk.entity_path == "/exploration/maps":
            batch = chunk.to_record_batch()
            names = batch.schema.names
            beta = batch.column("MapEstimate:beta").to_pylist() if "MapEstimate:beta" in names else [None] * len(batch)
            found |= dict(zip(batch.column("touch").to_pylist(), beta, strict=True))
    assert found[1] is None  # before two touches gave one
    for k in (2, 5):
        np.testing.assert_array_equal(found[k], synthetic.maps(k).beta.ravel())


def test_readings_of_devices_stand_at_their_touch_and_come_back_equal(tmp_path: Path) -> None:
    items = rig.items(0.4, (24, 32))
    streams = [ARM if stream.kind == "arm" else stream for stream in rig.STREAMS]
    record(tmp_path / "run.rrd", [(0, 0, [synthetic.maps(1)])], items, streams)
    assert_same(list(read_items(tmp_path / "run.rrd", trust=True)), items)
    places = {
        place
        for chunk in RrdReader(tmp_path / "run.rrd").stream()
        if chunk.entity_path in ("/wrench/fingertip", "/arm/jaco", "/depth/above", "/display/arm/jaco/joints")
        and not chunk.is_static
        for place in chunk.to_record_batch().column("touch").to_pylist()
    }
    assert places <= {3}


def test_everything_stands_at_the_cameras_picture_and_at_its_touch(tmp_path: Path) -> None:
    items = [one for one in rig.items(0.4, (24, 32)) if not isinstance(one, ColorFrame)]
    items = [dataclasses.replace(one, color=None) if isinstance(one, DepthFrame) else one for one in items]  # no JPEG
    streams = [ARM if stream.kind == "arm" else stream for stream in rig.STREAMS]
    pictures_ns = np.array([one.stamp.host_ns for one in items if isinstance(one, DepthFrame)])
    assert len(pictures_ns) > 3
    seen_ns = int(pictures_ns[2]) + 1
    with Recorder(tmp_path / "run.rrd", "none", {}, application=EXPLORATION) as recorder:
        recorder.start(ExplorationLayout(tuple(streams), (0.6, 0.4), BASE_FROM_SURFACE, truth=True), rig.START_NS)
        recorder.write(Step((synthetic.plan(0),), moment=Moment(rig.START_NS, cell_m=0.005)))
        for at in range(0, len(items), 40):
            recorder.write(items[at : at + 40])
        now_ns = int(pictures_ns[-1]) + 5
        recorder.write(Step((synthetic.touch(0),), moment=Moment(now_ns, 1, seen_ns, 0.005)))
    assert_same(sorted(read_items(tmp_path / "run.rrd", trust=True), key=order), sorted(items, key=order))
    where = [
        ("/wrench/fingertip", 1),  # what came after the plan belongs to the touch that was planned
        ("/display/arm/jaco/joints", 1),
        ("/depth/above", 1),
        ("/exploration/touch", 1),
        ("/exploration/plan", 0),
    ]
    found: dict[str, list[tuple[int, int, int]]] = {entity: [] for entity, _ in where}
    for chunk in RrdReader(tmp_path / "run.rrd").stream():
        if chunk.entity_path in found and not chunk.is_static:
            batch = chunk.to_record_batch()
            times = (batch.column("session").cast("int64"), batch.column("frame"), batch.column("touch"))
            found[chunk.entity_path] += zip(*(column.to_pylist() for column in times), strict=True)
    told = found.pop("/exploration/touch")
    assert told == [(now_ns - rig.START_NS, 2, 1)]  # now, but at the picture that saw the dent
    for entity, rows in found.items():
        assert rows, entity
        for session_ns, frame, touch in rows:
            assert frame == max(np.count_nonzero(pictures_ns <= rig.START_NS + session_ns) - 1, 0)
            assert touch == dict(where)[entity]


def test_the_arm_stands_where_the_scene_says(tmp_path: Path) -> None:
    """The base's origin, told in the surface frame, is taken back to zero by the transform that was given."""
    record(tmp_path / "run.rrd", [])
    path = "/display/scene/base/jaco"
    (place,), (turn,) = (
        np.array(cells(tmp_path / "run.rrd", path, f"Transform3D:{name}")[0]) for name in ("translation", "mat3x3")
    )
    surface_from_base = np.eye(4)
    surface_from_base[:3, :3], surface_from_base[:3, 3] = turn.reshape(3, 3).T, place
    np.testing.assert_allclose(BASE_FROM_SURFACE @ surface_from_base, np.eye(4), atol=1e-7)
    assert cells(tmp_path / "run.rrd", path, "Transform3D:child_frame") == [["jaco/base"]]


def test_the_surface_has_the_shape_that_was_seen_and_the_colours_of_its_stiffness(tmp_path: Path) -> None:
    surface, maps = synthetic.surface(2), synthetic.maps(2)
    record(tmp_path / "run.rrd", [(1, 0, [synthetic.surface(0)]), (2, 2, [surface]), (3, 2, [maps])])
    path = "/display/scene/surface"
    vertices = np.array(cells(tmp_path / "run.rrd", path, "Mesh3D:vertex_positions")[1])
    expected = np.stack([synthetic.X, synthetic.Y, surface.height_m], axis=-1).reshape(-1, 3)
    np.testing.assert_allclose(vertices, expected, atol=1e-7)
    corners = vertices[np.array(cells(tmp_path / "run.rrd", path, "Mesh3D:triangle_indices")[1])]
    upwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (upwards > 0).all()
    assert 0.5 * upwards.sum() == pytest.approx(0.595 * 0.395, rel=1e-3)
    by_height, by_stiffness = (np.array(one) for one in cells(tmp_path / "run.rrd", path, "Mesh3D:vertex_colors"))
    soft, firm = (np.unique(by_stiffness[maps.stiffness_n_per_mm.ravel() == end]) for end in _ends(maps))
    assert len(by_height) == len(by_stiffness) == len(vertices)
    assert len(soft) == len(firm) == 1
    assert soft != firm


def _ends(maps: MapEstimate) -> tuple[float, float]:
    return float(maps.stiffness_n_per_mm.min()), float(maps.stiffness_n_per_mm.max())


def test_contacts_stay_and_the_target_goes_where_none_follows(tmp_path: Path) -> None:
    told = [(k, k, [synthetic.touch(k - 1), synthetic.plan(k)]) for k in (1, 8)]
    record(tmp_path / "run.rrd", told)
    for number in (1, 8):
        (at,) = cells(tmp_path / "run.rrd", f"/display/scene/contacts/{number}", "Points3D:positions")[0]
        np.testing.assert_allclose(at, synthetic.touch(number - 1).xyz_m, atol=1e-7)
    target, nothing = cells(tmp_path / "run.rrd", "/display/scene/target", "LineStrips3D:strips")
    np.testing.assert_allclose(target[0][0][:2], synthetic.CONTACTS_M[1], atol=1e-7)
    assert nothing == []


def test_the_close_up_shows_the_top_of_the_model_alone(tmp_path: Path) -> None:
    """Of three layers of 11 x 11 particles those are drawn that no other lies above."""
    touch = synthetic.touch(2)
    record(tmp_path / "run.rrd", [(1, 1, [touch])])
    top = np.array(cells(tmp_path / "run.rrd", "/display/dent/simulated", "Points3D:positions")[0])
    assert len(touch.simulated_m) == 363
    assert len(top) == 121
    observed = np.array(cells(tmp_path / "run.rrd", "/display/dent/observed", "Points3D:positions")[0])
    times = np.unique(np.round(top[:, 2] * 0.05 / _heights(touch, top[:, :2] * 0.05), 3))
    assert len(times) == 1
    beside = touch.observed_m - touch.xyz_m
    inside = beside[(np.abs(beside[:, :2]) <= 0.05).all(axis=1)]
    members: dict[tuple[int, ...], list[FloatArray]] = {}
    for point in inside:
        members.setdefault(tuple(np.floor(point[:2] / 0.0035).astype(int)), []).append(point)
    means = np.array([np.mean(points, axis=0) for _, points in sorted(members.items())])
    assert len(means) < len(inside)
    np.testing.assert_allclose(observed * 0.05 / [1.0, 1.0, times[0]], means, atol=1e-6)
    said = [one for (one,) in cells(tmp_path / "run.rrd", "/display/dent/scale/label", "Points3D:labels")]
    assert said == ["no touch yet", f"5 cm, heights drawn {times[0]:g} times"]


def _heights(touch: TouchEstimate, places: FloatArray) -> FloatArray:
    """Of the model's highest particles at places (n, 2), over the contact."""
    beside = touch.simulated_m - touch.xyz_m
    found = [beside[(np.abs(beside[:, :2] - place) < 1e-6).all(axis=1), 2].max() for place in places]
    return np.array(found)


def test_nothing_that_moves_is_static(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", [(1, 1, synthetic.small_results())])
    static = {
        chunk.entity_path
        for chunk in RrdReader(tmp_path / "run.rrd").stream()
        if chunk.is_static and chunk.entity_path.startswith(("/exploration", "/display/"))
    }
    assert {path for path in static if not path.startswith("/display/arm/")} == {
        "/exploration/phase",
        "/display/scene/base/jaco",
    }


def test_phases_are_states_of_one_lane(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", [(k, 1, [PhaseStart(name, 0)]) for k, name in enumerate(("look", "travel", "press"))])
    assert cells(tmp_path / "run.rrd", "/exploration/phase", "StateChange:state") == [["look"], ["travel"], ["press"]]


def test_why_it_was_stopped_is_data_a_line_of_text_and_a_red_state(tmp_path: Path) -> None:
    stop = ExplorationStop("force sensor silent", "no force for 36 ms", "its cable", "stop", 1)
    record(tmp_path / "run.rrd", [(7, 2, [PhaseStart(f"stopped: {stop.kind}", 1), stop])])
    (found,) = read_results(tmp_path / "run.rrd", (ExplorationStop,), trust=True)
    assert found == Row(7, 2, stop)
    text = cells(tmp_path / "run.rrd", "/exploration/stopped", "TextLog:text")
    assert [one for one in text if one] == [["force sensor silent: no force for 36 ms"]]
    static = [
        chunk.to_record_batch()
        for chunk in RrdReader(tmp_path / "run.rrd").stream()
        if chunk.is_static and chunk.entity_path == "/exploration/phase"
    ]
    named = [batch.column("StateConfiguration:values").to_pylist()[-1] for batch in static]
    assert f"stopped: {stop.kind}" in named[-1]


def test_a_summary_tells_regions_or_that_there_are_none() -> None:
    maps = synthetic.maps(8)
    told = summary(maps)
    assert told.startswith("# 2 regions (probability 0.93)")
    assert f"**IoU {maps.iou:.3f} with the truth**" in told
    assert told.count("\n| ") == 4
    areas = [int(line.split("|")[3]) for line in told.splitlines()[-2:]]
    assert sum(areas) == pytest.approx(60 * 40, abs=1)
    gradual = summary(synthetic.gradual(8))
    assert "# Gradual: no regions" in gradual
    assert "IoU" not in gradual
    assert "| region |" not in gradual


def test_the_sure_cells_of_a_panel_count_the_doubt_about_the_number_of_regions() -> None:
    maps = dataclasses.replace(synthetic.maps(1), label_probability=np.full((80, 120), 0.47))
    assert "0 % of the cells are sure" in summary(maps)


def test_what_cannot_be_shown_is_recorded_with_where_it_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise FloatingPointError("no ink")

    monkeypatch.setattr("deformscope.log.exploration.results.log_dent", broken)
    told, maps = synthetic.touch(1), synthetic.maps(2)
    rec = rr.RecordingStream("deformscope-explore", recording_id="exploration")
    rec.set_sinks(rr.FileSink(tmp_path / "run.rrd"))
    rec.send_property("session", rr.AnyValues(True, format=FORMAT))
    failed: list[StageFailure] = []
    prepare_results([told, maps], 5, Place(2, PICTURES_NS), failed=failed).send(rec)
    rec.flush(timeout_sec=10)
    rec.disconnect()
    (one,) = failed
    assert (one.stage, one.touch, one.reason) == ("display", 2, "FloatingPointError: no ink")
    results = [found.item for found in back(tmp_path / "run.rrd")]
    assert_equal(next(result for result in results if isinstance(result, TouchEstimate)), told)
    assert_equal(next(result for result in results if isinstance(result, MapEstimate)), maps)
    assert one in results
    (text,) = [text for text in cells(tmp_path / "run.rrd", "/exploration/failed", "TextLog:text") if text]
    assert "touch 2: display failed: FloatingPointError: no ink" in text[0]
    assert 'raise FloatingPointError("no ink")' in text[0]
    assert cells(tmp_path / "run.rrd", "/display/summary", "TextDocument:text")  # the rest is shown


def test_what_is_no_result_is_refused() -> None:
    with pytest.raises(TypeError, match="shows a int"):
        prepare_results([3], 0, Place(0, PICTURES_NS))
