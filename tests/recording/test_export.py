"""Exports: read by the libraries that others use, they hold what was recorded, to the last bit."""

import contextlib
import csv
import dataclasses
import itertools
import json
import math
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.frames import ArmFrame, HandFrame, HealthReport, Item, SessionNote, TactileFrame, WrenchFrame
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.export.export import ExportRequest, _draft, export
from deformscope.recording.facts import run_rrd
from deformscope.recording.items import read_items, read_results
from deformscope.recording.ledger import ledger_path
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.recording.streams import RecordingTables
from deformscope.results.render import to_json
from deformscope.stages.map.exploration import MapEstimate, TouchEstimate
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link
from tests.cases import Capture, Patch, slow_but
from tests.log import synthetic_rig as rig

RECORDINGS = Path(__file__).resolve().parents[2] / "recordings"
BENCH, EXPLORED = RECORDINGS / "rig.rrd", RECORDINGS / "explore.rrd"
FORMATS = ("csv", "parquet", "npz", "mcap", "images", "video")


def quiet(what: str, done: int, total: int) -> None:
    """Progress that nobody looks at."""


def exported(path: Path, to: Any, out: Path, **asked: Any) -> Path:
    export(Replay(path), ExportRequest(to=to, folder=out, **asked), quiet)
    return out


def columns_of(item: Any) -> dict[str, Any]:
    """A frame's columns, spelled out here a second time."""
    found: dict[str, Any] = {"host_ns": item.stamp.host_ns, "index": item.index}
    match item:
        case WrenchFrame():
            found |= {f"counts_{at}": count for at, count in enumerate(item.counts)}
            for channel, force in enumerate(item.force_n):
                name = f"{channel}_" if len(item.force_n) > 1 else ""
                found |= {f"force_{name}{axis}_n": value for axis, value in zip("xyz", force, strict=True)}
            found |= {"device_ticks": item.stamp.device_ticks, "overload": item.overload, "usable": item.usable}
        case ArmFrame():
            for name in ("joint_{}_deg", "joint_velocity_{}_deg_s", "joint_torque_{}_nm"):
                found |= {name.format(at): v for at, v in enumerate(getattr(item, name.replace("_{}", "")))}
            for name in ("position_{}_m", "rotation_{}_rad", "force_{}_n", "torque_{}_nm"):
                values = getattr(item, name.replace("_{}", ""))
                found |= {name.format(axis): value for axis, value in zip("xyz", values, strict=True)}
            found |= {"queued": item.queued} | {f"finger_{at}": value for at, value in enumerate(item.finger)}
        case HandFrame():
            for name in ("position_{}_deg", "velocity_{}_deg_s", "temperature_{}_c", "state_{}"):
                found |= {name.format(at): v for at, v in enumerate(getattr(item, name.replace("_{}", "")))}
        case TactileFrame():
            found |= {"counts": item.counts.tolist(), "device_ticks": item.stamp.device_ticks}
            found |= {"pressure_pa": np.concatenate([pad.ravel() for pad in item.pressure_pa]).tolist()}
    return found


def by_entity(path: Path) -> Iterator[tuple[str, list[Any]]]:
    kinds = {WrenchFrame: "wrench", ArmFrame: "arm", HandFrame: "hand", TactileFrame: "tactile"}
    found: dict[str, list[Any]] = {}
    for item in read_items(path, kinds=tuple(kinds)):
        found.setdefault(f"{kinds[type(item)]}/{item.device}", []).append(item)  # type: ignore[union-attr, index]
    yield from found.items()


@pytest.mark.parametrize("path", [BENCH, EXPLORED, RECORDINGS / "squeeze.rrd"], ids=lambda path: path.stem)
def test_a_table_holds_every_frame_to_the_last_bit(path: Path) -> None:
    opened = ds.open_recording(path)
    for entity, items in by_entity(path):
        table = opened.table(entity)
        expected = [columns_of(item) for item in items]
        for name in expected[0]:
            own = table.column(name).to_pylist()
            np.testing.assert_array_equal(own, [row[name] for row in expected], err_msg=f"{entity} {name}")
        assert table.num_rows == len(items)
        times = table.column("session_ns").to_numpy()
        assert np.all(np.diff(times) >= 0)
        assert len(np.unique(table.column("host_ns").to_numpy() - times)) == 1


def test_rows_that_stand_in_several_portions_are_joined(tmp_path: Path, monkeypatch: Patch) -> None:
    split = tmp_path / "split.rrd"  # images apart from their stamps, as rerun's own tool lays them out
    assert run_rrd("optimize", BENCH, "-o", split) == ""
    monkeypatch.setattr(Replay, "_check_format", lambda replay: None)
    first, second = (RecordingTables(Replay(path, trust=True)) for path in (BENCH, split))
    assert sum(one.rows for one in second.streams.values()) > sum(one.rows for one in first.streams.values())
    assert list(first.streams) == list(second.streams)
    for entity in first.streams:
        names = first.streams[entity].schema.names
        one, other = first.table(entity), second.table(entity)
        assert repr(one.to_pydict()) == repr(other.select(names).to_pydict()), entity


def test_a_quantity_of_a_device_is_a_table_with_units() -> None:
    table = ds.open_recording(BENCH).table("tip/force")
    names = ["session_ns", "host_ns", "device_ticks", "index", "force_x_n", "force_y_n", "force_z_n"]
    assert table.schema.names == names
    assert [table.schema.field(name).metadata[b"unit"] for name in ("host_ns", "force_z_n")] == [b"ns", b"N"]
    with pytest.raises(ds.InputError, match=r"got 'tip/temperature', which the recording lacks \| try: .*wrench/tip"):
        ds.open_recording(BENCH).table("tip/temperature")


def test_results_are_named_as_in_the_json() -> None:
    opened = ds.open_recording(EXPLORED)
    rows = opened.table("exploration/touch").to_pylist()
    touches = [row.item for row in read_results(EXPLORED, (TouchEstimate,))]
    assert len(rows) == len(touches) == 2
    for row, touch in zip(rows, touches, strict=True):
        for key, value in to_json(touch).items():
            if key.endswith("interval") or "interval_" in key:
                base, _, unit = key.partition("interval")
                ends = [f"{base}interval_{end}{unit}" for end in ("low", "high")]
                assert [row[end] for end in ends] == (value or [None, None]), key
            elif not isinstance(value, dict):
                assert row[key] == value, key
        np.testing.assert_array_equal(row["approach_n"], touch.approach_n)
    (*_, last) = opened.table("exploration/maps").to_pylist()
    (*_, found) = (row.item for row in read_results(EXPLORED, (MapEstimate,)))
    assert json.loads(last["regions"]) == [to_json(region) for region in found.regions]
    np.testing.assert_array_equal(np.reshape(last["labels"], last["labels_shape"]), found.labels)
    assert opened.table("exploration/touch").schema.field("apparent_stiffness_n_per_mm").metadata[b"unit"] == b"N/mm"


def test_parquet_csv_and_npz_hold_the_tables(tmp_path: Path) -> None:
    out = {to: exported(BENCH, to, tmp_path / to) for to in ("parquet", "csv", "npz")}
    tables = RecordingTables(Replay(BENCH))
    manifest = json.loads((out["parquet"] / "export.json").read_text())
    assert (manifest["schema_version"], manifest["format"]) == (1, "parquet")
    assert {one["entity"]: one["rows"] for one in manifest["files"]} == {k: v.rows for k, v in tables.streams.items()}
    for entity in tables.streams:
        table = tables.table(entity)
        read = pq.read_table(out["parquet"] / f"{entity}.parquet")
        assert [(one, one.metadata) for one in read.schema] == [(one, one.metadata) for one in table.schema]
        assert repr(read.to_pydict()) == repr(table.to_pydict()), entity  # NaN is no other number than itself
        assert read.schema.metadata[b"deformscope.schema_version"] == b"1"
        _check_csv(out["csv"] / f"{entity}.csv", table)
        _check_npz(out["npz"] / f"{entity}.npz", table)


def _check_csv(path: Path, table: pa.Table) -> None:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == table.num_rows
    for name in rows[0] if rows else ():
        for text, value in zip([row[name] for row in rows], table.column(name).to_pylist(), strict=True):
            match value:
                case None:
                    assert text == ""
                case bool():
                    assert text == str(value).lower()
                case bytes():
                    assert bytes.fromhex(text) == value
                case list():
                    assert_equal(json.loads(text), value, name)
                case float():
                    assert_equal(float(text), value, name)
                case _:
                    assert text == str(value)


def _check_npz(path: Path, table: pa.Table) -> None:
    read = np.load(path)
    for name in table.schema.names:
        values = table.column(name).to_pylist()
        if f"{name}_offsets" in read:
            own = [read[name][first:last] for first, last in itertools.pairwise(read[f"{name}_offsets"])]
            for one, value in zip(own, values, strict=True):
                if isinstance(value, str | bytes):
                    assert one.tobytes() == (value.encode() if isinstance(value, str) else value)
                elif value and isinstance(value[0], str):
                    assert json.loads(one.tobytes()) == value
                elif value:
                    assert_equal(one.tolist(), value, name)
        elif any(value is None for value in values) and read[name].dtype.kind != "f":
            assert read[f"{name}_valid"].tolist() == [value is not None for value in values]
        else:
            expected = [np.nan if value is None else value for value in values]
            np.testing.assert_array_equal(read[name], expected)


def assert_equal(own: Any, value: Any, name: str) -> None:
    """Of numbers or lists of them; by numpy, which is slow for single numbers, only where NaN may be among them."""
    if own != value:
        np.testing.assert_array_equal(own, value, err_msg=name)


def read_mcap(path: Path) -> Iterator[tuple[str, int, Any]]:
    """(topic, log time [ns], message) as mcap-ros2-support decodes them, in order of time."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            yield channel.topic, message.log_time, decoded


@pytest.mark.parametrize("path", slow_but([BENCH], [BENCH, EXPLORED]), ids=lambda path: path.stem)
def test_an_mcap_is_read_alike_by_two_readers_of_others(path: Path, tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(RECORDINGS.parent)  # where the arm's URDF is, as these recordings have it
    pytest.importorskip("mcap_ros2")
    rosbags = pytest.importorskip("rosbags.highlevel")
    (file,) = exported(path, "mcap", tmp_path / "bag").glob("*.mcap")
    tables = RecordingTables(Replay(path))
    first = list(read_mcap(file))
    with rosbags.AnyReader([file]) as bag:
        second = [
            (connection.topic, ns, bag.deserialize(raw, connection.msgtype)) for connection, ns, raw in bag.messages()
        ]
    by_topic: dict[str, list[tuple[int, Any]]] = {}
    for messages in (first, second):
        by_topic = {}
        for topic, ns, message in messages:
            by_topic.setdefault(topic, []).append((ns, message))
        for entity in tables.streams:
            _check_topic(by_topic[f"/{entity}"], tables.table(entity), tables.start_ns or 0)
        _check_standard(path, by_topic)
    manifest = json.loads((tmp_path / "bag" / "export.json").read_text())
    assert {one["entity"]: one["rows"] for one in manifest["files"]} == {k: len(v) for k, v in by_topic.items()}


def _check_topic(messages: list[tuple[int, Any]], table: pa.Table, start_ns: int) -> None:
    assert len(messages) == table.num_rows
    names = [name for name in table.schema.names if name not in ("image", "depth", "color")]
    rows = table.select(names).to_pylist()
    rows.sort(key=lambda row: start_ns if row["host_ns"] is None else row["host_ns"])
    if "child_frame" in names:  # several of one moment, in any order
        messages = sorted(messages, key=lambda one: (one[0], one[1].child_frame, one[1].qx, one[1].x_m))
        rows.sort(key=lambda row: (row["host_ns"] or start_ns, row["child_frame"], row["qx"], row["x_m"]))
    for (ns, message), row in zip(messages, rows, strict=True):
        stamp = message.header.stamp
        assert ns == stamp.sec * 10**9 + stamp.nanosec == (start_ns if row["host_ns"] is None else row["host_ns"])
        for name in names:
            own, value = getattr(message, name.lower()), row[name]
            own = own.tolist() if isinstance(own, np.ndarray) else list(own) if isinstance(own, bytes) else own
            if isinstance(own, list) and isinstance(value, bool | int):
                own = own[0]
            if value is None:
                assert own in ([], "", 0) or np.isnan(own), name
            else:
                assert_equal(own, list(value) if isinstance(value, bytes) else value, name)


def _check_standard(path: Path, by_topic: dict[str, list[tuple[int, Any]]]) -> None:
    """What the standard messages say is what was recorded."""
    for entity, items in by_entity(path):
        kind, device = entity.split("/")
        if kind == "wrench":
            own = by_topic[f"/{device}/wrench"]
            assert [ns for ns, _ in own] == [item.stamp.host_ns for item in items]
            forces = [[one.wrench.force.x, one.wrench.force.y, one.wrench.force.z] for _, one in own]
            np.testing.assert_array_equal(forces, [item.force_n[0] for item in items])
            assert {one.header.frame_id for _, one in own} == {device}
        if kind == "arm":
            angles = [np.asarray(one.position) for _, one in by_topic[f"/{device}/joint_states"]]
            names = list(by_topic[f"/{device}/joint_states"][0][1].name)
            assert names[0].endswith("_joint_1")
            ((_, urdf),) = by_topic[f"/{device}/robot_description"]
            assert all(f'"{name}"' in urdf.data for name in names)
            np.testing.assert_allclose(angles, np.deg2rad([item.joint_deg for item in items]), rtol=1e-15)
    depth = next(stream for stream in RecordingTables(Replay(path)).streams if stream.startswith("depth/"))
    device = depth.partition("/")[2]
    frames = [item for item in read_items(path) if type(item).__name__ == "DepthFrame"]
    images = by_topic[f"/{device}/depth/image"]
    for (ns, image), frame in zip(images, frames, strict=True):
        assert (ns, image.encoding) == (frame.stamp.host_ns, "16UC1")  # type: ignore[union-attr]
        seen = np.frombuffer(bytes(image.data), "<u2").reshape(image.height, image.width)
        np.testing.assert_array_equal(seen, frame.depth)  # type: ignore[union-attr]
    lens = by_topic[f"/{device}/depth/camera_info"]
    assert len(lens) == len(images)
    assert lens[0][1].k[0] > 100
    ((_, still),) = by_topic["/tf_static"]
    moving = {one.child_frame_id for _, message in by_topic["/tf"] for one in message.transforms}
    fixed = {one.child_frame_id: one for one in still.transforms}
    assert not moving & set(fixed)
    turns = [[getattr(one.transform.rotation, axis) for axis in "xyzw"] for one in fixed.values()]
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1.0, atol=1e-6)
    parents = {one.header.frame_id for _, message in by_topic["/tf"] for one in message.transforms}
    assert not any("#" in name for name in parents)


def test_nothing_of_a_person_or_a_machine_is_in_an_anonymous_export(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2")

    secret = "Mallory"
    streams = tuple(
        rig.frames.Stream(one.device, one.kind, one.driver, serial=secret, firmware=secret, pads=one.pads)
        for one in rig.STREAMS
    )
    path = tmp_path / f"{secret}.rrd"
    settings = {"rig": f'port = "/home/{secret}"', "label": secret, "seconds": 2.0, "nested": {"who": secret, "n": 3}}
    with Recorder(path, "none", settings, application=RIG) as made:
        made.start(RigLayout(streams), rig.START_NS)
        items: list[Item] = [*rig.items(0.3, (24, 32)), SessionNote(rig.ns(0.2), "note", f"{secret} was here")]
        made.write(items)
    for to in FORMATS:
        out = exported(path, to, tmp_path / to, anonymous=True)
        for file in out.rglob("*"):
            assert secret not in str(file.relative_to(tmp_path))
            assert file.is_dir() or secret.encode() not in file.read_bytes(), file
            assert file.is_dir() or os.uname().release.encode() not in file.read_bytes()
        if to == "parquet":
            for file in out.rglob("*.parquet"):
                assert secret not in str(pq.read_table(file).to_pylist())
        if to == "mcap":
            (bag,) = out.glob("*.mcap")
            assert not any(secret in str(message) for _, _, message in read_mcap(bag))
    manifest = json.loads((tmp_path / "csv" / "export.json").read_text())
    assert manifest["provenance"]["settings"] == {"seconds": 2.0, "nested": {"n": 3}}
    assert "versions" in manifest["provenance"]
    assert not [one for one in manifest["streams"] if one["entity"].startswith("raw/")]
    assert main(["verify", str(path), "--privacy", "--json", str(tmp_path / "told.json")]) in (0, 3)
    said = json.loads((tmp_path / "told.json").read_text())["privacy"]  # all of it is listed, with its place
    assert {one for one in said if one.startswith("settings")} == {
        "settings.rig",
        "settings.label",
        "settings.nested.who",
    }
    assert [said[f"{kind} serial"] for kind in ("wrench/fingertip", "tactile/skin")] == [secret] * 2
    assert {"note text", "raw/fingertip", "platform", "command"} <= set(said)
    plain = exported(path, "csv", tmp_path / "plain")
    assert secret in (plain / "note.csv").read_text() + (plain / "export.json").read_text()


@pytest.mark.parametrize("to", ["csv", "mcap"])
@pytest.mark.parametrize("anonymous", [False, True])
def test_what_a_recording_lost_and_whether_it_is_to_be_used_goes_along(
    to: str, anonymous: bool, tmp_path: Path, capfd: Capture, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "r.rrd"
    health = Health(Link.CLOSED, "", 5, lost=7)
    with Recorder(path, "none", {"rig": "", "first_s": math.nan}, application=RIG) as made:
        made.start(RigLayout((rig.frames.Stream("tip", "wrench", "imported"),)), rig.START_NS)
        made.write([rig.wrench(at, "tip") for at in range(5)])
        made.write([HealthReport(rig.ns(1), (("tip", health),))])
        made.stopped_because("alice pressed Ctrl-C")
    assert main(["discard", str(path), "--reason", "alice slipped"]) == 0

    def about(out: Path, status: int) -> dict[str, Any]:
        asked = ["export", str(path), "--to", to, "--out", str(out), *(["--anonymous"] if anonymous else [])]
        assert main(asked) == status
        if to == "csv":
            return cast("dict[str, Any]", json.loads((out / "export.json").read_text(), parse_constant=pytest.fail))
        reader = pytest.importorskip("mcap.reader")
        with next(out.glob("*.mcap")).open("rb") as file:
            (said,) = reader.make_reader(file).iter_metadata()
        return {name: json.loads(value, parse_constant=pytest.fail) for name, value in said.metadata.items()}

    found = about(tmp_path / "first", 3)
    assert "losses: tip: 7 readings lost" in capfd.readouterr().err
    assert found["losses"] == {"tip": {"readings": 7}}
    reason = "" if anonymous else "alice slipped"
    assert found["discarded"] == [{"reason": reason, "episode": 0, "label": ""}]
    assert (found["complete"], found["recovered"], found["checked"]) == (True, False, True)
    assert ("alice" in json.dumps(found)) != anonymous
    ledger_path(path).unlink()
    assert about(tmp_path / "second", 3)["checked"] is False
    caplog.clear()
    assert main(["replay", str(path)]) == 3
    assert "has no ledger" in caplog.text


def test_licence_and_authors_go_along(tmp_path: Path, capfd: Capture) -> None:
    own = ["--license", "CC-BY-4.0", "--author", "A. Writer", "B. Writer", "--citation", "Poking", "--only", "tip"]
    assert main(["export", str(BENCH), "--to", "parquet", "--out", str(tmp_path / "out"), *own, "--json", "-"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["schema_version"] == 1
    assert {one["entity"] for one in found["files"]} == {"wrench/tip", "raw/tip", "link/tip", "health/tip"}
    manifest = json.loads((tmp_path / "out" / "export.json").read_text())
    expected = ["CC-BY-4.0", ["A. Writer", "B. Writer"], "Poking"]
    assert [manifest[name] for name in ("license", "authors", "citation")] == expected
    about = pq.read_schema(tmp_path / "out" / "wrench" / "tip.parquet").metadata
    assert about[b"deformscope.license"] == b"CC-BY-4.0"
    assert json.loads(about[b"deformscope.authors"]) == ["A. Writer", "B. Writer"]


def test_a_video_has_every_image_and_a_table_of_their_times(tmp_path: Path) -> None:
    out = exported(EXPLORED, "video", tmp_path / "out")
    film = cv2.VideoCapture(str(out / "camera.mp4"))
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1])
    table = RecordingTables(Replay(EXPLORED)).table("depth/camera")
    with (out / "depth" / "camera.csv").open() as file:
        times = [int(row["host_ns"]) for row in csv.DictReader(file)]
    assert len(frames) == table.num_rows == len(times) == 16
    assert times == table.column("host_ns").to_pylist()
    first = cv2.imdecode(np.frombuffer(table.column("depth")[0].as_py(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert frames[0].shape[:2] == first.shape
    shown = cv2.applyColorMap((255.0 * (first / first.max())).astype(np.uint8), cv2.COLORMAP_TURBO)
    assert np.abs(frames[0].astype(float) - shown).mean() < 12.0


@pytest.mark.parametrize("to", FORMATS)
def test_an_export_that_fails_leaves_nothing(to: str, tmp_path: Path, capfd: Capture) -> None:
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(BENCH.read_bytes()[: BENCH.stat().st_size * 2 // 3])
    assert main(["export", str(cut), "--to", to, "--out", str(tmp_path / "out")]) == 2
    assert "got one that is truncated or damaged | try: deformscope recover cut.rrd" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["cut.rrd"]


def test_refusals_are_one_line(tmp_path: Path, capfd: Capture) -> None:
    out = tmp_path / "out"
    cases = [
        (["--to", "csv", "--out", str(out), "--only", "wrench/toe"], "got 'wrench/toe', which the recording lacks"),
        (["--to", "csv"], "expected a format and a folder"),
        (["--to", "csv", "--out", str(out), "--images", str(out)], "expected a format and a folder"),
        (["--to", "csv", "--out", str(out), "--camera", "camera"], "expected --camera with images or video; got csv"),
        (["--to", "csv", "--out", str(BENCH)], "expected a folder that can be written to; got not a directory"),
        (["--to", "video", "--out", str(out), "--only", "tip"], "expected images in the recording; got none of 'tip'"),
    ]
    for flags, words in cases:
        assert main(["export", str(BENCH), *flags]) == 2
        error = capfd.readouterr().err
        assert words in error, error
        assert len(error.strip().splitlines()) == 1
    assert not out.exists()


def test_an_earlier_export_is_replaced_and_other_files_stay(tmp_path: Path, capfd: Capture) -> None:
    out = tmp_path / "out"
    asked = ["export", str(BENCH), "--out", str(out), "--to"]
    assert main([*asked, "csv", "--only", "wrench"]) == 0
    (out / "notes.txt").write_text("mine")
    assert main([*asked, "parquet", "--only", "tip"]) == 2
    assert "got one that holds files | try: another one, or --overwrite" in capfd.readouterr().err
    assert main([*asked, "parquet", "--only", "wrench/tip", "--overwrite"]) == 0
    left = sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
    assert left == ["export.json", "notes.txt", "wrench/tip.parquet"]


def test_devices_of_any_name_have_files_of_their_own_within_the_folder(tmp_path: Path) -> None:
    names = ("..", "a b", "a_b", "über/x", "a.b")
    streams = tuple(rig.frames.Stream(name, "wrench", "optoforce") for name in names)
    path = tmp_path / "r.rrd"
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        made.start(RigLayout(streams), rig.START_NS)
        made.write([rig.wrench(at, name) for at in range(30) for name in names[: 1 + at % 5]])
    found = export(Replay(path), ExportRequest(to="parquet", folder=tmp_path / "out"), quiet)
    rows = {one.entity: pq.read_table(tmp_path / "out" / one.file).num_rows for one in found.files}
    assert rows == {f"wrench/{name}": 30 - 6 * at for at, name in enumerate(names)}
    files = list((tmp_path / "out").rglob("*.parquet"))
    assert len(files) == 5
    assert {path.parent for path in files} == {tmp_path / "out" / "wrench"}
    assert ds.open_recording(path).table("über/x/force").num_rows == 12


def test_of_two_exports_at_once_one_is_there_whole(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def write(name: str, meanwhile: Callable[[], None]) -> None:
        with _draft(out, overwrite=False) as draft:
            (draft / name).touch()
            meanwhile()

    with pytest.raises(ds.InputError, match="got one that something has just been put into"):
        write("late", lambda: write("early", lambda: None))
    assert [path.name for path in out.iterdir()] == ["early"]
    (out / "early").unlink()
    with pytest.raises(ds.InputError, match="got one that something has just been put into"):
        write("late", lambda: write("early", lambda: None))
    assert [path.name for path in out.iterdir()] == ["early"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_folder_one_is_in_and_a_link_to_an_empty_one_are_folders(tmp_path: Path, monkeypatch: Patch) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there")
    monkeypatch.chdir(tmp_path / "here")
    for out in (".", str(tmp_path / "link")):
        assert main(["export", str(BENCH), "--to", "npz", "--only", "wrench/tip", "--out", out]) == 0
        assert sorted(path.name for path in Path(out).iterdir()) == ["export.json", "wrench"]
    assert main(["export", str(BENCH), "--to", "csv", "--out", "/"]) == 2
    assert (tmp_path / "link").is_symlink()


def test_times_that_ros_has_not_are_one_line(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2")
    path = tmp_path / "r.rrd"
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        made.start(RigLayout((rig.frames.Stream("tip", "wrench", "optoforce"),)), 2**31 * 10**9)
        made.write([dataclasses.replace(rig.wrench(at, "tip"), stamp=Stamp(2**31 * 10**9 + at)) for at in range(3)])
    with pytest.raises(ds.InputError, match=r"times from 0 to 2038, as ROS has them; got 2\.147e\+09 s"):
        exported(path, "mcap", tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_devices_of_any_name_have_topics_of_their_own(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2")
    names = ("左", "右", "a b", "a_b")
    streams = tuple(rig.frames.Stream(name, "wrench", "optoforce") for name in names)
    path = tmp_path / "r.rrd"
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        made.start(
            RigLayout((*streams, rig.frames.Stream("x-1", "color", "uvc"), rig.frames.Stream("x_1", "color", "uvc"))),
            rig.START_NS,
        )
        made.write([rig.wrench(at, name) for at in range(20) for name in names[: 1 + at % 4]])
        made.write([rig.color(at, name, (24, 32)) for at in range(3) for name in ("x-1", "x_1")[: 1 + at % 2]])
    (bag,) = exported(path, "mcap", tmp_path / "bag").glob("*.mcap")
    counts = Counter(topic for topic, _, _ in read_mcap(bag))
    own = ("/_", "/_2", "/a_b", "/a_b_2")
    assert (
        [counts[f"{topic}/wrench"] for topic in own] == [counts[f"/wrench{topic}"] for topic in own] == [15, 20, 10, 5]
    )
    assert [counts[f"/{topic}/color/compressed"] for topic in ("x_1", "x_1_2")] == [3, 1]
    pytest.importorskip("rosbags")
    inspected = tmp_path / "map.toml"
    with inspected.open("w") as file, contextlib.redirect_stdout(file):
        assert main(["import", "--inspect", str(bag)]) == 0
    assert main(["import", str(bag), "--map", str(inspected), "--record", str(tmp_path / "again.rrd")]) == 0
    before, now = ({name: table.num_rows for name, table in tables(one)} for one in (path, tmp_path / "again.rrd"))
    assert {name: rows for name, rows in before.items() if name in now} == now
    assert {*(f"wrench/{name}" for name in names), "color/x-1", "color/x_1"} <= set(now)


def tables(path: Path) -> Iterator[tuple[str, pa.Table]]:
    for entity in ("wrench/左", "wrench/右", "wrench/a b", "wrench/a_b", "color/x-1", "color/x_1"):
        yield entity, ds.open_recording(path).table(entity)


@pytest.mark.parametrize("content", slow_but(["<robot"], ["<robot", "", "\xff"]))
def test_a_robot_description_that_is_none_is_left_out_and_none_is_anonymous(
    content: str, tmp_path: Path, monkeypatch: Patch
) -> None:
    pytest.importorskip("mcap_ros2")
    monkeypatch.chdir(tmp_path)
    urdf = Path("drivers/deformscope_drivers/jaco/j2n6s300.urdf")  # as the recording has it
    urdf.parent.mkdir(parents=True)
    whole = '<robot name="r"><!-- from /home/Mallory/r.xacro --></robot>'
    for text, anonymous in ((content, False), (whole, True), (whole, False)):
        urdf.write_bytes(text.encode("latin-1"))
        asked: dict[str, Any] = {"only": ["arm"], "anonymous": anonymous, "overwrite": True}
        (bag,) = exported(EXPLORED, "mcap", tmp_path / "bag", **asked).glob("*.mcap")
        found = [message.data for topic, _, message in read_mcap(bag) if topic.endswith("/robot_description")]
        assert found == ([whole] if text == whole and not anonymous else [])


@pytest.mark.parametrize("to", ["images", "video"])
def test_cameras_of_any_name_have_images_of_their_own_within_the_folder(to: str, tmp_path: Path) -> None:
    cameras = ("..", "x y", "x_y", "x y-color", "color")
    streams = tuple(rig.frames.Stream(name, "color", "uvc") for name in cameras)
    path = tmp_path / "r.rrd"
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        made.start(RigLayout(streams), rig.START_NS)
        made.write([rig.color(at, name, (24, 32)) for at in range(2) for name in cameras])
    before = {path, Path(f"{path}.ledger")}
    out = exported(path, to, tmp_path / "deep" / "out")
    files = [one for one in tmp_path.rglob("*") if one.suffix in (".png", ".jpg", ".mp4")]
    assert len(files) == (10 if to == "images" else 5)
    assert {one.relative_to(out).parts[0] for one in files} == {
        f"{name}{'' if to == 'images' else '.mp4'}" for name in ("_", "x_y", "x_y-2", "x_y-color", "color")
    }
    assert set(tmp_path.iterdir()) == {*before, tmp_path / "deep"}


LIMITED = """
import resource, sys
sys.dont_write_bytecode = True  # else what is compiled now would stay cut short
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
from deformscope.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("to", slow_but(["csv"], FORMATS))
def test_a_file_that_cannot_grow_ends_in_one_line(to: str, tmp_path: Path) -> None:
    asked = ["export", str(BENCH), "--to", to, "--out", str(tmp_path / "out")]
    done = subprocess.run([sys.executable, "-B", "-c", LIMITED, *asked], capture_output=True, text=True, timeout=300)
    assert done.returncode == 2, done.stderr
    assert "got file too large" in done.stderr.lower() or "disk full" in done.stderr, done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_without_its_packages_mcap_is_refused_in_one_line(tmp_path: Path, monkeypatch: Patch, capfd: Capture) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    assert main(["export", str(BENCH), "--to", "mcap", "--out", str(tmp_path / "out")]) == 2
    assert capfd.readouterr().err.strip().endswith("got none | try: pip install 'deformscope[mcap]'")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("library", ["pandas", "polars", "duckdb"])
def test_the_plots_in_the_docs_are_drawn(library: str, tmp_path: Path, monkeypatch: Patch) -> None:
    pytest.importorskip(library)
    page = (RECORDINGS.parent / "docs" / "howto" / "tables-from-recordings.md").read_text(encoding="utf-8")
    (script,) = (one for one in re.findall(r"```python[^\n]*\n(.*?)```", page, re.DOTALL) if f'"{library}.png"' in one)
    assert len([line for line in script.splitlines() if line]) <= 10
    exported(EXPLORED, "parquet", tmp_path / "tables", only=("exploration/touch",))
    monkeypatch.chdir(tmp_path)
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("agg")
    exec(compile(script, "docs/howto/tables-from-recordings.md", "exec"), {})
    (drawn, *_) = plt.gcf().axes
    shown = [line.get_xydata() for line in drawn.lines] or [one.get_offsets() for one in drawn.collections]
    plt.close("all")
    points = np.concatenate([np.asarray(one) for one in shown])
    touches = [row.item for row in read_results(EXPLORED, (TouchEstimate,))]
    depth_mm = np.concatenate([1e3 * (touch.approach_m - touch.contact_m) for touch in touches])
    np.testing.assert_allclose(points, np.column_stack([depth_mm, np.concatenate([one.approach_n for one in touches])]))


LONG = """
import sys
from pathlib import Path
from deformscope.recording.export.export import ExportRequest, export
from deformscope.recording.reader import Replay
from tests.peak_memory import peak_of_own_mib
path, to, out = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
print(peak_of_own_mib(lambda: export(Replay(path, trust=True), ExportRequest(to=to, folder=out), lambda *_: None)))
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    paths = [_long(tmp_path / f"{seconds}.rrd", seconds) for seconds in (30, 240)]
    for to in ("csv", "parquet", "npz", "mcap"):
        used = []
        for path in paths:
            command = [sys.executable, "-c", LONG, str(path), to, str(tmp_path / f"{to}-{path.stem}")]
            used.append(float(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
        assert used[1] < used[0] + 60.0, (to, used)


def _long(path: Path, seconds: int) -> Path:
    """Forces at 1 kHz and pressures at 30 Hz, so many that they would not fit into the difference."""
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        made.start(RigLayout(rig.STREAMS[:2]), rig.START_NS)
        for second in range(seconds):
            made.write([rig.wrench(1000 * second + at) for at in range(1000)])
            made.write([rig.tactile(30 * second + at, rate_hz=30.0) for at in range(30)])
    return path
