"""What is recorded of a rig comes back equal, and what is shown of it is what was measured."""

import dataclasses
import itertools
import logging
import random
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader

from deformscope.errors import InputError
from deformscope.frames import (
    ColorFrame,
    DepthFrame,
    HealthReport,
    Item,
    LinkChange,
    PadLayout,
    RawBytes,
    Stream,
    TactileFrame,
)
from deformscope.images import decode_image, encode_jpeg, encode_png
from deformscope.log.rig import Shown, log_items, log_streams, prepare_items, rig_blueprint
from deformscope.log.rig.blueprint import rig_views
from deformscope.log.rig.health import table, word
from deformscope.log.rig.tactile import Hand
from deformscope.pictures.exploration import text_png
from deformscope.pictures.palette import BACKGROUND, colors
from deformscope.recording.facts import run_rrd
from deformscope.recording.items import read_items, read_streams
from deformscope.rows import FORMAT
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link, LinkEvent
from tests.log import synthetic_rig as rig

SMALL = (24, 32)


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def record(
    path: Path, batches: Sequence[Sequence[Item]], streams: Sequence[Stream] = (), lossless: Collection[str] = ()
) -> None:
    rec = rr.RecordingStream("deformscope-rig", recording_id="rig")
    rec.set_sinks(rr.FileSink(path))
    rec.send_property("session", rr.AnyValues(True, format=FORMAT))
    rec.send_blueprint(rig_blueprint(streams))
    log_streams(rec, streams)
    for batch in batches:
        log_items(rec, batch, rig.START_NS, streams, lossless)
    rec.flush(timeout_sec=10)
    rec.disconnect()


def back(path: Path) -> list[Item]:
    return list(read_items(path, trust=True))


def assert_same(found: Sequence[Item], expected: Sequence[Item]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert type(one) is type(other)
        for field in dataclasses.fields(other):
            same(getattr(one, field.name), getattr(other, field.name), f"{field.name} of {other}")


def same(found: Any, expected: Any, what: str) -> None:
    if isinstance(expected, np.ndarray):
        assert found.shape == expected.shape, what
        assert found.dtype == expected.dtype, what
        np.testing.assert_array_equal(found, expected, what)
    elif isinstance(expected, tuple):
        assert len(found) == len(expected), what
        for one, other in zip(found, expected, strict=True):
            same(one, other, what)
    else:
        assert found == expected, what
        assert type(found) is type(expected), what


def cells(path: Path, entity: str, component: str) -> list[Any]:
    """One component of an entity, row by row, as it lies in the file."""
    found = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names:
            found += [cell for cell in batch.column(component).to_pylist() if cell is not None]
    assert found, f"no {component} of {entity}"
    return found


def test_a_whole_rig_comes_back_equal(tmp_path: Path) -> None:
    expected = rig.items(0.7, SMALL)
    streams = [dataclasses.replace(s, urdf=rig.URDF) if s.kind == "arm" else s for s in rig.STREAMS]
    record(tmp_path / "run.rrd", list(rig.batches(expected)), streams, lossless={"front"})
    found = back(tmp_path / "run.rrd")
    assert {type(item).__name__ for item in found} == {type(item).__name__ for item in expected}
    assert len({type(item) for item in found}) == 9
    assert_same(sorted(found, key=order), sorted(expected, key=order))
    times = [rig.host_ns(item) for item in found]
    assert times == sorted(times)
    assert sorted(read_streams(tmp_path / "run.rrd", trust=True), key=str) == sorted(streams, key=str)


def order(item: Item) -> tuple[int, str, str, int, bytes]:
    """In time; of one moment by kind, device and number."""
    named = (getattr(item, name, other) for name, other in (("device", ""), ("index", -1), ("data", b"")))
    return (rig.host_ns(item), type(item).__name__, *named)


ALONE: dict[str, list[Item]] = {
    "four channels": [rig.wrench(index, channels=4) for index in range(5)],
    "torques": [rig.wrench(index, torque=True) for index in range(5)],
    "torques at times": [rig.wrench(index, torque=index % 2 == 0) for index in range(4)],
    "no sensitivity report": [
        dataclasses.replace(rig.wrench(index), force_n=np.full((1, 3), np.nan)) for index in range(3)
    ],
    "gaps": [rig.wrench(index) for index in (3, 4, 9, 10, 400, 10**12)],
    "one": [rig.arm(0)],
    "two of a kind": [frame for index in range(4) for frame in (rig.wrench(index, "left"), rig.wrench(index, "right"))],
    "odd names": [
        rig.tactile(0, "left hand/1"),
        rig.tactile(1, "größe.a-b_c"),
        rig.tactile(2, 'tab\t"quote" \\ [0]'),
        *rig.raw(7, "left hand/1"),
    ],
    "all pressed": [dataclasses.replace(rig.tactile(0), counts=np.full(486, 65535, np.uint16))],
    "no pads": [TactileFrame(Stamp(rig.START_NS), 0, np.zeros(0, np.uint16), ())],
    "no fingers": [dataclasses.replace(rig.arm(0), finger=np.zeros(0))],
    "ticks": [dataclasses.replace(rig.arm(index), stamp=Stamp(rig.ns(index), ticks)) for index, ticks in
              enumerate((None, 0, -1, 2**62 + 1))],
    "before the start": [dataclasses.replace(rig.arm(0), stamp=Stamp(rig.START_NS - 12_345))],
    "depth with color": [rig.depth(index, size=SMALL, colored=index != 1) for index in range(3)],
    "nothing seen": [dataclasses.replace(rig.depth(0, size=SMALL), depth=np.zeros(SMALL, np.uint16), unit_m=1e-4 / 3)],
    "16 bits": [ColorFrame(Stamp(rig.START_NS), 0, rig.depth(0, size=SMALL).depth, "x")],
    "grey": [ColorFrame(Stamp(rig.START_NS), 0, rig.color(0, size=SMALL).image[..., 0].copy(), "front")],
    "empty bytes": [RawBytes(rig.START_NS, b"", False, "x"), RawBytes(rig.START_NS + 1, b"\0", True, "x")],
    "pieces of one moment": [RawBytes(rig.START_NS, bytes([piece]), False, "x") for piece in range(200)],
    "links": [*rig.links(), LinkChange(LinkEvent(rig.ns(6.0), Link.FAILED, ""), "hand")],
    "health": [rig.health(0.0), rig.health(5.0), HealthReport(rig.ns(5.5), ())],
}  # fmt: skip


@pytest.mark.parametrize("name", ALONE)
@pytest.mark.parametrize("known", [True, False])
def test_every_kind_comes_back_equal(tmp_path: Path, name: str, known: bool) -> None:
    expected = ALONE[name]
    record(tmp_path / "run.rrd", [expected], rig.STREAMS if known else (), {"front", "above"})
    assert_same(back(tmp_path / "run.rrd"), sorted(expected, key=rig.host_ns))


@pytest.mark.slow  # rerun compacts as many streams as a rig has
def test_a_compacted_recording_is_the_same(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """rerun's own tool cuts an entity's rows into portions by size, and puts small ones together."""
    pieces: list[Item] = [RawBytes(rig.ns(0.2), bytes([piece]), False, "fingertip") for piece in range(50)]
    expected = rig.items(1.2, SMALL) + pieces
    record(tmp_path / "run.rrd", list(rig.batches(expected)), rig.STREAMS, {"front"})
    assert run_rrd("optimize", tmp_path / "run.rrd", "-o", tmp_path / "small.rrd") == ""
    assert (tmp_path / "small.rrd").stat().st_size < 0.8 * (tmp_path / "run.rrd").stat().st_size
    with caplog.at_level(logging.WARNING):
        assert_same(back(tmp_path / "small.rrd"), back(tmp_path / "run.rrd"))
    assert "in part" not in caplog.text


def test_a_batch_may_have_any_order(tmp_path: Path) -> None:
    expected = [*map(rig.wrench, range(20)), *map(rig.arm, range(2))]
    mixed = random.Random(1).sample(expected, len(expected))
    record(tmp_path / "run.rrd", [mixed[:7], [], mixed[7:8], mixed[8:]], rig.STREAMS)
    assert_same(back(tmp_path / "run.rrd"), sorted(expected, key=rig.host_ns))


def test_a_batch_goes_to_two_streams(tmp_path: Path) -> None:
    expected = rig.items(0.3, SMALL)
    batch = prepare_items(expected, rig.START_NS, rig.STREAMS, {"front"})
    for name in ("file.rrd", "live.rrd"):
        rec = rr.RecordingStream("deformscope-rig", recording_id="rig")
        rec.set_sinks(rr.FileSink(tmp_path / name))
        rec.send_property("session", rr.AnyValues(True, format=FORMAT))
        batch.send(rec)
        rec.flush(timeout_sec=10)
        rec.disconnect()
        assert_same(sorted(back(tmp_path / name), key=order), sorted(expected, key=order))


def test_items_come_before_the_whole_is_read(tmp_path: Path) -> None:
    expected = [rig.wrench(index) for index in range(2000)]
    record(tmp_path / "run.rrd", [expected[at : at + 100] for at in range(0, 2000, 100)])
    assert_same(list(itertools.islice(read_items(tmp_path / "run.rrd", trust=True), 30)), expected[:30])


def test_float32_comes_back_to_the_bit(tmp_path: Path) -> None:
    single = dataclasses.replace(rig.arm(0), joint_deg=np.array([0.1, 1 / 3, 3e38, 1e-45, -0.0, 7], np.float32))
    record(tmp_path / "run.rrd", [[single]])
    (found,) = back(tmp_path / "run.rrd")
    assert found.joint_deg.astype(np.float32).tobytes() == single.joint_deg.tobytes()  # type: ignore[union-attr]


def test_a_color_image_is_small_unless_it_must_be_exact(tmp_path: Path) -> None:
    frame = rig.color(3, size=(48, 64))
    record(tmp_path / "small.rrd", [[frame]])
    record(tmp_path / "exact.rrd", [[frame]], lossless={"front"})
    (small,), (exact,) = back(tmp_path / "small.rrd"), back(tmp_path / "exact.rrd")
    assert isinstance(small, ColorFrame)
    expected = cv2.imdecode(np.frombuffer(encode_jpeg(frame.image), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(small.image, expected)
    assert np.abs(small.image.astype(int) - frame.image).mean() < 4
    assert (small.stamp, small.index, small.device) == (frame.stamp, frame.index, frame.device)
    assert_same([exact], [frame])


def test_a_noisy_image_is_still_one_without_loss() -> None:
    rng = np.random.default_rng(5)
    for image in (rng.integers(0, 65536, SMALL, np.uint16), rng.integers(0, 256, (*SMALL, 3), np.uint8)):
        decoded = cv2.imdecode(np.frombuffer(encode_png(image, noisy=True), np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(decoded if image.ndim == 2 else decoded[..., ::-1], image)


def test_a_drawn_image_is_small_and_without_loss() -> None:
    drawn = decode_image(text_png("stiffness [N/mm]\nof the touches"), "memory")
    encoded = encode_png(drawn)
    np.testing.assert_array_equal(decode_image(encoded, "memory"), drawn)
    usual = cv2.imencode(".png", drawn[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    assert len(encoded) < min(len(usual), len(encode_png(drawn, noisy=True)))


def test_a_frame_that_was_cut_off_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    record(tmp_path / "run.rrd", [list(map(rig.arm, range(5)))])
    path = tmp_path / "cut.rrd"
    rec = rr.RecordingStream("deformscope-rig", recording_id="rig", send_properties=False)
    rec.set_sinks(rr.FileSink(path))
    for chunk in RrdReader(tmp_path / "run.rrd").stream():
        batch = chunk.to_record_batch()
        kept = [name for name in batch.schema.names if name != "ArmFrame:force_n"]
        rec.send_chunks(Chunk.from_record_batch(batch.select(kept)))
    rec.flush(timeout_sec=10)
    rec.disconnect()
    with caplog.at_level(logging.WARNING):
        assert back(path) == []
    assert "5 ArmFrame of jaco were recorded in part, and are left out" in caplog.text


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a recording \(\.rrd\); got nothing there"):
        next(read_items(tmp_path / "none.rrd"))


def test_scalars_can_be_read_by_any_tool(tmp_path: Path) -> None:
    expected = [rig.wrench(index) for index in range(3)]
    record(tmp_path / "run.rrd", [expected, [rig.health(5.0), rig.tactile(20)]], rig.STREAMS)
    path = tmp_path / "run.rrd"
    force = np.array(cells(path, "/wrench/fingertip/force_n/0", "Scalars:scalars"))
    np.testing.assert_array_equal(force, np.concatenate([frame.force_n for frame in expected]))
    assert cells(path, "/wrench/fingertip/force_n/0", "SeriesLines:names") == [["Fx [N]", "Fy [N]", "Fz [N]"]]
    assert cells(path, "/wrench/fingertip", "WrenchFrame:stamp.host_ns") == [
        [frame.stamp.host_ns] for frame in expected
    ]
    assert cells(path, "/health/fingertip", "Health:lost") == [[3]]
    assert cells(path, "/health/fingertip", "Health:rate_hz") == [[999.7]]
    peaks = [pad.max() * 1e-3 for pad in rig.tactile(20).pressure_pa]
    assert cells(path, "/tactile/skin/peak_kpa", "Scalars:scalars") == [peaks]


def test_times(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", [[rig.arm(17)]])
    (chunk,) = [c for c in RrdReader(tmp_path / "run.rrd").stream() if c.entity_path == "/arm/jaco"]
    batch = chunk.to_record_batch()
    assert batch.column("frame").to_pylist() == [17]
    assert batch.column("session").cast("int64").to_pylist() == [170_000_000]


def test_a_plot_breaks_off_where_the_link_was_lost(tmp_path: Path) -> None:
    frames = [rig.hand(index) for index in (38, 39, 60, 61)]
    record(tmp_path / "run.rrd", [[*frames, *rig.links()]], rig.STREAMS)
    rows = []
    for chunk in RrdReader(tmp_path / "run.rrd").stream().filter(content=["/hand/hand/position_deg"]):
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            times = batch.column("session").cast("int64").to_pylist()
            rows += zip(times, map(len, batch.column("Scalars:scalars").to_pylist()), strict=True)
    expected = [(3_800_000_000, 7), (3_900_000_000, 7), (4_000_000_000, 0), (6_000_000_000, 7), (6_100_000_000, 7)]
    assert sorted(rows) == expected
    assert_same([item for item in back(tmp_path / "run.rrd") if not isinstance(item, LinkChange)], frames)


def test_a_hand_is_drawn_as_it_is_held() -> None:
    hand = Hand.of(rig.PADS)
    corners = dict(zip((pad.name for pad in hand.pads), hand.corners, strict=True))
    for finger in ("finger_0", "thumb", "finger_2"):
        assert corners[f"{finger}_distal"][0] + 13 < corners[f"{finger}_proximal"][0]
        assert corners[f"{finger}_distal"][1] == corners[f"{finger}_proximal"][1]
    assert corners["finger_0_distal"][1] + 6 + 8 <= corners["thumb_distal"][1]  # room for a pad's pressure or its name
    assert corners["thumb_distal"][1] + 6 + 8 <= corners["finger_2_distal"][1]
    names = {name: (x, y) for x, y, name in hand.names()}
    assert set(names) == {"finger_0", "thumb", "finger_2", "distal", "proximal"}
    assert names["distal"][1] < names["proximal"][1]
    assert names["finger_0"][0] < names["thumb"][0] < names["finger_2"][0]
    places = hand.places()
    assert len(places) == len(set(places.tolist())) == 486
    assert places.max() < hand.rows * hand.columns


@pytest.mark.parametrize("known", [True, False])
def test_the_picture_shows_the_pressures(tmp_path: Path, known: bool) -> None:
    frame = rig.tactile(40)
    record(tmp_path / "run.rrd", [[frame]], rig.STREAMS if known else ())
    hand = Hand.of(rig.PADS) if known else Hand.of_shapes([pad.shape for pad in frame.pressure_pa])
    display = "/display/tactile/skin"
    (buffer,) = cells(tmp_path / "run.rrd", f"{display}/picture", "Image:buffer")
    picture = np.frombuffer(bytes(buffer[0]), np.uint8).reshape(hand.rows, hand.columns, 3)
    ticks = cells(tmp_path / "run.rrd", f"{display}/scale", "Points2D:labels")[0]
    end_kpa = 3.2712 if known else 5.0
    assert ticks == (["0", "0.818", "3.27"] if known else ["0", "1.25", "5"])
    covered = np.zeros((hand.rows, hand.columns), bool)
    for pressure_pa, (top, left) in zip(frame.pressure_pa, hand.corners, strict=True):
        place = slice(top, top + len(pressure_pa)), slice(left, left + 6)
        expected = colors(np.sqrt(pressure_pa / (end_kpa * 1e3)).ravel()).reshape(*pressure_pa.shape, 3)
        assert np.abs(picture[place].astype(int) - expected).max() <= 3  # a rounding apart
        covered[place] = True
    assert (picture[~covered] == BACKGROUND).all()
    peaks = cells(tmp_path / "run.rrd", f"{display}/peak", "Points2D:labels")[0]
    assert peaks == [f"{pad.max() / 1e3:.2f}" for pad in frame.pressure_pa]


def test_the_arm_moves_as_its_joints_do(tmp_path: Path) -> None:
    stream = Stream("left arm", "arm", "little", urdf=rig.URDF)
    frame = dataclasses.replace(
        rig.arm(0, "left arm"), joint_deg=np.array([370.0, -90.0]), finger=np.array([0.5]), queued=2
    )
    record(tmp_path / "run.rrd", [[frame]], [stream])
    joints = r"/display/arm/left\ arm/joints"
    children = [cell[0] for cell in cells(tmp_path / "run.rrd", joints, "Transform3D:child_frame")]
    assert children == ["left arm/upper", "left arm/lower", "left arm/finger"]
    turned = np.array(cells(tmp_path / "run.rrd", joints, "Transform3D:quaternion"))[:, 0]
    for found, axis, angle in zip(
        turned, ((0, 0, 1), (0, 1, 0), (0, 1, 0)), (370.0, -90.0, np.rad2deg(0.6)), strict=True
    ):
        half = np.deg2rad(angle) / 2
        assert abs(abs(found @ np.array([*np.sin(half) * np.array(axis), np.cos(half)])) - 1) < 1e-6


def test_an_arm_that_is_not_the_one_described_is_recorded(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", [[rig.arm(0)]], [Stream("jaco", "arm", "jaco", urdf=rig.URDF)])
    assert_same(back(tmp_path / "run.rrd"), [rig.arm(0)])


def test_depth_is_shown_in_metres(tmp_path: Path) -> None:
    frame = rig.depth(0, size=SMALL)
    record(tmp_path / "run.rrd", [[frame]])
    assert cells(tmp_path / "run.rrd", "/depth/above", "EncodedDepthImage:meter") == [[1000.0]]
    ((low, high),) = cells(tmp_path / "run.rrd", "/depth/above", "EncodedDepthImage:depth_range")[0]
    seen = frame.depth[frame.depth > 0]
    assert low <= np.quantile(seen, 0.05)
    assert np.quantile(seen, 0.95) <= high
    assert low % 50 == pytest.approx(0, abs=1e-3)


STATES = [
    (Health(Link.CONNECTED, age_s=0.01), "ok"),
    (Health(Link.CONNECTED, age_s=3.0), "stale"),
    (Health(Link.CONNECTED, age_s=0.01, stuck=True), "stuck"),
    (Health(Link.CONNECTED, age_s=0.01, alarms=("saturated: fz at the end of its range",)), "saturated"),
    (Health(Link.CONNECTED, age_s=0.01, alarms=("saturated: fz", "stuck at the same count: fx")), "stuck"),
    (Health(Link.CONNECTED), "waiting"),
    (Health(Link.LOST, "gone", age_s=0.01), "LOST"),
    (Health(Link.FAILED), "FAILED"),
    (Health(Link.CLOSED), "closed"),
]


@pytest.mark.parametrize(("health", "expected"), STATES)
def test_states_in_a_word(health: Health, expected: str) -> None:
    assert word(health, None) == expected
    assert word(health, Stream("x", "hand", "sdh", fastest_hz=1.0)) == ("ok" if expected == "stale" else expected)


def test_the_table_tells_what_is_wrong() -> None:
    lines = table(rig.health(5.0), {stream.device: stream for stream in rig.STREAMS}).splitlines()
    assert lines[2] == "| fingertip (SIMULATED) | ok | 999.7 | 0 | 5 000 | 3 | 0 | 2 (checksum 2) | 12 | 0 |  |"
    assert lines[5] == "| hand | **LOST** | 0 | 0 | 40 | 20 | 0 | 0 | 0 | 0 | cable pulled out |"
    assert len(lines) == 8


@pytest.mark.parametrize("count", range(len(rig.STREAMS) + 1))
def test_views_of_any_devices(count: int) -> None:
    for streams in itertools.combinations(rig.STREAMS, count):
        rig_blueprint(streams)
        rig_blueprint(streams, health=False)
    rig_blueprint([dataclasses.replace(stream, device=f"{stream.device} {n}") for stream in rig.STREAMS for n in "ab"])


@pytest.mark.parametrize(("count", "most"), [(3, 2), (6, 2), (7, 3)])
def test_views_on_a_page_are_high_enough_for_a_label_at_their_axes(count: int, most: int) -> None:
    """Three rows at most, of two views each as long as these are enough: of lower plots the axis has nothing but 0."""
    (rows,) = rig_views([Stream(f"camera {n}", "color", "webcam") for n in range(count)], with_health=False).contents
    assert isinstance(rows, rrb.Container)
    shown = [len(row.contents) if isinstance(row, rrb.Container) else 1 for row in rows.contents]
    assert (sum(shown), max(shown)) == (count, most)
    assert len(shown) <= 3


def test_names_of_a_hand_are_apart_in_a_narrow_view() -> None:
    """270 px, as a view of eight has on the page; a letter is 7 px wide, and a name has 5 px around it."""
    hand = Hand.of(rig.PADS)
    (left, right), _ = hand.bounds_mm
    boxes: dict[float, list[tuple[float, float]]] = {}
    for x, y, name in hand.names():
        middle, half = (x - left) / (right - left) * 270.0, 3.5 * len(name) + 5.0
        boxes.setdefault(y, []).append((middle - half, middle + half))
        assert middle - half >= 0.0
    for line in boxes.values():
        assert all(one[1] < other[0] for one, other in itertools.pairwise(sorted(line)))
    first = min(left for _, left in hand.corners) * hand.texel_mm[0]
    pads_px = (first - left) / (right - left) * 270.0
    assert all(end <= pads_px + 1.0 for y, line in boxes.items() for _, end in line if len(line) == 1)


def test_pads_of_other_hands() -> None:
    alone = Hand.of([PadLayout("palm", 3, 5, (0.002, 0.004), 0, 0, 0)])
    assert (alone.rows, alone.columns, alone.corners, alone.texel_mm) == (3, 5, ((0, 0),), (2.0, 4.0))
    beside = Hand.of([PadLayout(str(at), 3, 5, (0.002, 0.004), at, 0, 0) for at in range(2)])
    assert beside.corners[1][1] > 5
    assert [name for _, _, name in beside.names()] == ["0", "1"]
    assert len(set(beside.places().tolist())) == 30


def test_a_depth_scale_is_sent_when_it_changes_and_now_and_then(tmp_path: Path) -> None:
    """Its numbers would be a fifth of what small depth images take."""
    stream = Stream("above", "depth", "little")
    near, far = np.full((24, 32), 800, np.uint16), np.full((24, 32), 1900, np.uint16)
    shown: Shown = {}
    rec = rr.RecordingStream("deformscope-rig-test", recording_id="rig")
    rec.set_sinks(rr.FileSink(tmp_path / "run.rrd"))
    for at, depth in ((0, near), (1, near), (2, near), (3, far), (4, far), (13, far), (14, far)):
        frame = DepthFrame(Stamp(rig.START_NS + at * 1_000_000_000), at, depth, 0.001, None, "above")
        prepare_items([frame], rig.START_NS, [stream], shown=shown).send(rec)
    rec.flush(timeout_sec=10)
    rec.disconnect()
    sent = [
        round(time / 1e9)
        for chunk in RrdReader(tmp_path / "run.rrd").stream()
        if chunk.entity_path == "/display/depth/above"
        for time in chunk.to_record_batch().column("session").cast("int64").to_pylist()
    ]
    assert sorted(sent) == [0, 3, 13]


def test_an_arms_shape_moves_25_times_a_second(tmp_path: Path) -> None:
    stream = Stream("left arm", "arm", "little", urdf=rig.URDF)
    frames = [
        dataclasses.replace(
            rig.arm(index, "left arm"),
            stamp=Stamp(rig.START_NS + index * 10_000_000),
            joint_deg=np.array([float(index), 0.0]),
            finger=np.array([0.5]),
        )
        for index in range(100)
    ]
    record(tmp_path / "run.rrd", [frames], [stream])
    assert len(cells(tmp_path / "run.rrd", r"/display/arm/left\ arm/joints", "Transform3D:child_frame")) == 3 * 25
    assert len(cells(tmp_path / "run.rrd", r"/arm/left\ arm/joint_deg", "Scalars:scalars")) == 100
