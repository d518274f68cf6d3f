"""Sources that cannot be opened, hold things of several kinds, or come from another version or clock."""

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.ledger import ledger_path
from deformscope.recording.recorder import Recorder
from tests.imports.test_bad_bags import MAP, OTHER, steady, write_bag
from tests.imports.test_files_and_folders import imported, refused
from tests.imports.test_import_mistakes import AXES, FORCES, csv, map_of
from tests.imports.test_importing import frames_of, inspected
from tests.log import synthetic_rig as rig

NOBODY = 65534


@contextlib.contextmanager
def as_nobody() -> Iterator[Path]:
    """Without the rights of root; a folder that anybody may use. What is imported by then is at hand, whoever may
    read the interpreter's files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o777)
        is_root = os.geteuid() == 0
        if is_root:
            os.seteuid(NOBODY)
        try:
            yield folder
        finally:
            if is_root:
                os.seteuid(0)
            for path in folder.rglob("*"):
                path.chmod(0o700)


@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.mcap", "folder"])
def test_what_may_not_be_read_is_said_to_be_that(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    refused(tmp_path / "none", map_of(AXES), tmp_path / "r.rrd", capfd)
    with as_nobody() as folder:
        source = folder / name
        source.mkdir() if name == "folder" else source.write_bytes(b"t,Fx\n0,1\n")
        source.chmod(0)
        error = refused(source, map_of(AXES), folder / "r.rrd", capfd)
        assert main(["import", "--inspect", str(source)]) == 2
    assert f"expected a readable source; got permission denied | {source}" in error


@pytest.mark.parametrize("command", ["export", "verify", "discard", "replay"])
def test_a_recording_or_ledger_that_may_not_be_read(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    more = {"export": ["--to", "csv", "--out", str(tmp_path / "out")], "discard": ["--reason", "x"]}.get(command, [])
    assert main([command, str(recorded(tmp_path / "r.rrd")), *more]) == 0
    whole = {one.name: one.read_bytes() for one in tmp_path.glob("r.rrd*")}
    with as_nobody() as folder:
        for name, content in whole.items():
            (folder / name).write_bytes(content)
        path = folder / "r.rrd"
        asked = [command, str(path), *more]
        for one in (path, ledger_path(path)):
            one.chmod(0)
            assert main(asked) == 2
            assert f"the system refused: Permission denied | {one}" in capfd.readouterr().err.strip().splitlines()[-1]
            one.chmod(0o600)


def recorded(path: Path, **asked: Any) -> Path:
    with Recorder(path, "none", {"rig": ""}, application=RIG, **asked) as made:
        made.start(RigLayout((rig.frames.Stream("tip", "wrench", "imported"),)), rig.START_NS)
        made.write([rig.wrench(at, "tip") for at in range(5)])
    return path


@pytest.mark.parametrize("cell", ["", "inf", "nan"])
def test_what_a_force_is_in_place_of_a_number_is_told(
    cell: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = csv(tmp_path / "t.csv", f"{FORCES}0.02,1,{cell},1\n")
    came = "inf" if cell == "inf" else "nothing, or NaN,"  # Arrow reads both as null
    assert f"got {came} in frame 2" in refused(source, map_of(AXES), tmp_path / "r.rrd", capfd)
    csv(source, f"{FORCES}0.02,,,\n")
    frames: list[Any] = frames_of(imported(source, map_of(AXES, 'nan = "keep"'), tmp_path / "s.rrd"))["tip"]
    assert np.isnan(frames[2].force_n).all()


def test_a_table_whose_time_goes_back_gets_a_hint_that_it_can_take(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = csv(tmp_path / "t.csv", f"{FORCES}0.001,1,1,1\n")
    assert "try: rate_hz in place of time" in refused(source, map_of(AXES), tmp_path / "r.rrd", capfd)


def test_clocks_that_differ_by_seconds_are_asked_for(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """At 100 Hz for 4 s: the spans of both overlap."""
    imported(write_bag(tmp_path / "near.mcap", steady, other_s=-0.5), OTHER, tmp_path / "near.rrd")
    bag = write_bag(tmp_path / "bag.mcap", steady, other_s=-2.0, nan=0)  # whose first force is refused, when it is read
    error = refused(bag, OTHER, tmp_path / "r.rrd", capfd)
    assert "expected offset_s of other in the map: how its clock differs; got 'stamps 2 s from those of ft'" in error
    bag = write_bag(tmp_path / "bag.mcap", steady, other_s=-2.0)
    at: dict[float, int] = {}
    for offset_s in (0.0, 2.0):
        frames = frames_of(imported(bag, f"{OTHER}offset_s = {offset_s}\n", tmp_path / f"{offset_s}.rrd"))
        at[offset_s] = frames["other"][0].stamp.host_ns - frames["ft"][0].stamp.host_ns
    assert at == {0.0: -2 * 10**9, 2.0: 0}


def test_images_beside_tables_are_both_there(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "mix"
    (source / "depth").mkdir(parents=True)
    for at in range(3):
        cv2.imwrite(str(source / "depth" / f"{at}.png"), np.full((4, 4), 500 + at, np.uint16))
    csv(source / "t.csv")
    (source / "notes.csv").write_text("Notes of 3 May\nsubject, foam, 2 cm\n")  # no table
    (source / "empty.csv").touch()
    text = inspected(source)
    assert "notes" not in text
    assert "empty" not in text
    assert {"depth/*.png: files", "t.csv: csv"} <= {line[2:].split(",")[0] for line in text.splitlines()}
    depth = '[[streams]]\ndevice = "cam"\nkind = "depth"\ntopics = ["depth/*.png"]\nrate_hz = 100\nunit_m = 0.001\n'
    frames: dict[str, list[Any]] = frames_of(imported(source, map_of(AXES) + depth, tmp_path / "r.rrd"))  # type: ignore[assignment]
    assert [frame.force_n[0, 0] for frame in frames["tip"]] == [1, 2]
    assert [frame.depth[0, 0] for frame in frames["cam"]] == [500, 501, 502]
    both = map_of(AXES, topics='["t.csv", "depth/*.png"]')
    assert "topics of tip in the map: of one kind" in refused(source, both, tmp_path / "s.rrd", capfd)


@pytest.mark.parametrize("ending", ["csv", "parquet", "png"])
def test_names_that_are_not_utf_8(ending: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / os.fsdecode(b"take\xff")
    folder.mkdir()
    name = os.fsdecode(b"t\xfe.") + ending
    if ending == "png":
        (folder / os.fsdecode(b"d\xfd")).mkdir()
        encoded = cv2.imencode(".png", np.full((4, 4), 500, np.uint16))[1].tobytes()
        (folder / os.fsdecode(b"d\xfd") / name).write_bytes(encoded)
        topic, more = "d\\\\udcfd/*.png", 'kind = "depth"\nrate_hz = 10\nunit_m = 0.001\n'
        text = f'[[streams]]\ndevice = "tip"\ntopics = ["{topic}"]\n{more}'
    else:
        source = csv(folder / "t.csv")
        if ending == "parquet":
            import pyarrow.csv
            import pyarrow.parquet as pq

            source = source.rename(tmp_path / "t.csv")
            pq.write_table(pyarrow.csv.read_csv(source), tmp_path / "t.parquet")
            (tmp_path / "t.parquet").rename(folder / "t.parquet")
        (folder / f"t.{ending}").rename(folder / name)
        topic = f"t\\\\udcfe.{ending}"
        text = map_of(AXES, topics=f'["{topic}"]')
    assert f'topics = ["{topic}"]' in inspected(folder)
    assert main(["import", "--inspect", str(folder)]) == 0
    assert frames_of(imported(folder, text, tmp_path / "r.rrd"))["tip"]


MANIFESTS: dict[str, tuple[dict[str, Any], str]] = {
    "newer": ({"schema_version": 99}, "expected an export of schema version 1; got one of version 99 | try: a newer"),
    "no number": ({"schema_version": "x"}, "an export of schema version 1; got one of version x"),
    "streams": ({"schema_version": 1, "streams": [3]}, "an export as deformscope writes it; got Expected `object`"),
    "pads": (
        {"schema_version": 1, "devices": {"tip": {"kind": "foo"}}},
        "tip as deformscope describes devices; got Invalid enum value 'foo'",
    ),
}


@pytest.mark.parametrize("name", MANIFESTS)
def test_an_export_of_a_newer_version_is_refused(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said, words = MANIFESTS[name]
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "export.json").write_text(json.dumps(said))
    csv(folder / "t.csv")
    assert words in refused(folder, map_of(AXES), tmp_path / "r.rrd", capfd)


def test_an_mcap_of_a_newer_version_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    writer = pytest.importorskip("mcap.writer")
    path = tmp_path / "r.mcap"
    with path.open("wb") as file:
        made = writer.Writer(file)
        made.start(profile="ros2")
        made.add_metadata("deformscope", {"schema_version": "2"})
        made.finish()
    pytest.importorskip("rosbags")
    assert "schema version 1; got one of version 2" in refused(path, MAP, tmp_path / "r.rrd", capfd)


@pytest.mark.parametrize("start_ns", [2**61, 90_000 * 10**9, -90_000 * 10**9])
def test_a_session_that_begins_on_another_day_is_refused(
    start_ns: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = f"start_ns = {start_ns}\n{map_of(AXES)}"
    error = refused(csv(tmp_path / "t.csv"), text, tmp_path / "r.rrd", capfd)
    assert f"expected start_ns within a day of the first stamp; got {start_ns}" in error
