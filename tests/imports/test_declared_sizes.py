"""What a foreign file says of itself is compared with the bytes that came, and with what memory may be taken."""

import bz2
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.file_io import check_size, none_larger
from deformscope.images import decode_image
from deformscope.imports.frame_builder import FrameBuilder
from deformscope.imports.import_map import MappedStream
from deformscope.imports.point_files import read_points
from deformscope.imports.readers import Message, Topic, open_reader
from deformscope_drivers.clock import Stamp
from tests.imports.foreign_files import stores
from tests.imports.test_files_and_folders import imported, refused
from tests.imports.test_import_mistakes import AXES, FORCES, csv, map_of
from tests.imports.test_importing import frames_of

CLOUD = '[[streams]]\ndevice = "cam"\nkind = "depth"\ntopics = ["/points"]\ntime = "log"\n'


def write_bag(path: Path, topic: str, kind: str, *values: Any, compress: bool = False) -> Path:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store = stores()[1]
    writer = Writer(path, version=8, storage_plugin=StoragePlugin.MCAP)
    if compress:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(topic, kind, typestore=store)
        for at, value in enumerate(values):
            writer.write(connection, 10**18 + at * 10**7, store.serialize_cdr(value, kind))
    return path


def header() -> Any:
    types = stores()[1].types
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 0), "cam")


def cloud(**changes: Any) -> Any:
    """Two rows of three points of 16 bytes; changes: of what the message says, and of its field z"""
    types = stores()[1].types
    field = {"name": "z", "offset": 8, "datatype": 7, "count": 1}
    field |= {name: value for name, value in changes.items() if name in field}
    fields = [types["sensor_msgs/msg/PointField"](name, 4 * at, 7, 1) for at, name in enumerate("xy")]
    fields.append(types["sensor_msgs/msg/PointField"](*field.values()))
    said = {"height": 2, "width": 3, "is_bigendian": False, "point_step": 16, "row_step": 48}
    said |= {name: value for name, value in changes.items() if name in said}
    data = np.frombuffer(np.full(24, 0.5, "<f4").tobytes(), np.uint8)
    rows = dict(list(said.items())[:2])
    rest = dict(list(said.items())[2:])
    return types["sensor_msgs/msg/PointCloud2"](header(), *rows.values(), fields, *rest.values(), data, True)


def frame_of(kind: str, topic: str, value: Any, **keys: Any) -> Any:
    """The frame of one message."""
    stream = MappedStream(device="cam", kind=kind, topics=("/t",), time="log", **keys)  # type: ignore[arg-type]
    builder = FrameBuilder(stream, {"/t": Topic("/t", topic)})
    return builder.build({"/t": Message("/t", 1, value)}, Stamp(1), 0, np.eye(4))


BAD_CLOUDS = [
    {"offset": 13},
    {"offset": 16},
    {"offset": 2**31 - 4},
    {"offset": 2**32 - 1},
    {"datatype": 8, "offset": 9},
    {"datatype": 0},
    {"datatype": 9},
    {"count": 3},
    {"count": 2**32 - 1},
    {"name": "w"},
    {"point_step": 0},
    {"point_step": 2**32 - 1},
    {"row_step": 0},
    {"row_step": 2**32 - 1},
    {"row_step": 47},
    {"height": 2**32 - 1},
    {"width": 2**32 - 1},
    {"width": 4},
    {"height": 3},
]


@pytest.mark.parametrize("changes", BAD_CLOUDS, ids=str)
def test_points_outside_their_message_are_refused(changes: dict[str, Any]) -> None:
    pytest.importorskip("rosbags")
    with pytest.raises(InputError, match="a depth frame of cam; got in frame 0: expected"):
        frame_of("depth", "sensor_msgs/msg/PointCloud2", cloud(**changes))


def test_points_whose_fields_lie_anywhere_in_them_are_taken() -> None:
    pytest.importorskip("rosbags")
    for changes in ({}, {"offset": 12}, {"count": 0}, {"offset": 8, "datatype": 8}):
        assert frame_of("depth", "sensor_msgs/msg/PointCloud2", cloud(**changes)).depth.shape == (2, 3)
    assert (frame_of("depth", "sensor_msgs/msg/PointCloud2", cloud(offset=12)).depth == 5000).all()
    types = stores()[1].types
    fields = [types["sensor_msgs/msg/PointField"](name, 4 * at, 7, 1) for at, name in enumerate("xyz")]
    empty = types["sensor_msgs/msg/PointCloud2"](header(), 1, 0, fields, False, 12, 0, np.zeros(0, np.uint8), True)
    keys = {"focal_px": (100.0, 100.0), "center_px": (3.0, 2.0), "size_px": (6, 4)}
    assert not frame_of("depth", "sensor_msgs/msg/PointCloud2", empty, **keys).depth.any()
    with pytest.raises(InputError, match="an image of size_px in up to 1074 MB of memory; got 8e"):
        frame_of("depth", "sensor_msgs/msg/PointCloud2", empty, **keys | {"size_px": (10**6, 10**6)})


@pytest.mark.parametrize(
    ("height", "width", "step"), [(0, 0, 0), (0, 6, 12), (1, 4_000_000, 8_000_000), (4, 6, 11), (5, 6, 12)]
)
def test_an_image_that_none_is_ends_in_a_line(height: int, width: int, step: int, tmp_path: Path, capfd: Any) -> None:
    pytest.importorskip("rosbags")
    data = np.zeros(min(height, 4) * step, np.uint8)
    image = stores()[1].types["sensor_msgs/msg/Image"](header(), height, width, "16UC1", 0, step, data)
    bag = write_bag(tmp_path / "bag", "/points", "sensor_msgs/msg/Image", image)
    error = refused(bag, CLOUD, tmp_path / "r.rrd", capfd)
    assert "expected a depth frame of cam; got in frame 0: expected" in error
    assert "px" in error or "bytes" in error


def test_a_compressed_part_is_unpacked_up_to_the_bound(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """5 MB of one value; the bound of 128 MB is for files that may be as hostile."""
    pytest.importorskip("rosbags")
    image = stores()[1].types["sensor_msgs/msg/Image"](
        header(), 1000, 2500, "16UC1", 0, 5000, np.full(5_000_000, 1, np.uint8)
    )
    bag = write_bag(tmp_path / "bag", "/points", "sensor_msgs/msg/Image", image, compress=True)
    assert sum(one.stat().st_size for one in bag.iterdir()) < 5_000
    (tmp_path / "map.toml").write_text(CLOUD)
    asked = ["import", str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]
    assert main([*asked, "--largest-mb", "4"]) == 2
    error = capfd.readouterr().err
    assert "in up to 4 MB of memory; got 5.001 MB | try: a smaller one, or a higher --largest-mb of import" in error
    assert not (tmp_path / "r.rrd").exists()
    assert main(["import", "--inspect", str(bag), "--largest-mb", "4"]) == 2
    assert main([*asked, "--largest-mb", "20"]) == 0


def frames(kind: str) -> Callable[[bytes], bytes]:
    from backports import zstd
    from lz4 import frame  # type: ignore[import-untyped]

    return {"bz2": bz2.compress, "lz4": frame.compress, "zstd": zstd.compress}[kind]


@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd"])
def test_a_part_larger_than_it_declares_is_not_unpacked(kind: str) -> None:
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap as mcap

    from deformscope.imports.readers import bounded

    def function() -> Callable[[bytes], bytes]:
        if kind in ros1.decompressors:
            return ros1.decompressors[kind]
        return vars(ros2)["zstd"].decompress  # type: ignore[no-any-return]

    plain, made = function(), frames(kind)(bytes(3_000_000))
    with bounded(), none_larger(2_000_000):
        with pytest.raises(InputError, match="a compressed part in up to 2 MB of memory; got more"):
            function()(made)
        if kind != "bz2":
            with pytest.raises(InputError, match="got 3 MB"):
                mcap.DECOMPRESSORS[kind](made, 3_000_000)
        half = bytes(900_000)
        assert function()(frames(kind)(half) + frames(kind)(half)) == 2 * half
        with pytest.raises(ValueError, match="ends early"):
            function()(frames(kind)(half)[:-3])
    assert function() == plain


def test_chunks_of_one_time_are_bounded_together() -> None:
    from deformscope.imports.readers import check_chunks

    def storage(*spans: tuple[int, int, int]) -> Any:
        names = ("message_start_time", "message_end_time", "uncompressed_size", "channel_count")
        return SimpleNamespace(
            chunks=[SimpleNamespace(**dict(zip(names, (*one, {1: 1}), strict=True))) for one in spans]
        )

    with none_larger(10):
        check_chunks(storage(*((at, at + 1, 5) for at in range(0, 20, 2))), "bag")
        check_chunks(storage((0, 5, 5), (5, 9, 5)), "bag")
        for one in (storage((0, 5, 5), (5, 9, 5), (5, 5, 1)), SimpleNamespace(storages=[storage((0, 5, 11))])):
            with pytest.raises(InputError, match="chunks of one time, together"):
                check_chunks(one, "bag")
        check_chunks(None, "bag of ROS 1")


@pytest.mark.parametrize("index", ["MESSAGE", "CHUNK", "NONE"])
def test_an_mcap_without_an_index_of_its_messages_is_read(index: str, tmp_path: Path) -> None:
    """The index is optional; rosbags 0.11.9 takes none for no messages."""
    pytest.importorskip("rosbags")
    writers = pytest.importorskip("mcap.writer")
    left_out = writers.IndexType.ALL & ~writers.IndexType[index] if index != "NONE" else writers.IndexType.NONE
    kind, store = "geometry_msgs/msg/PointStamped", stores()[1]
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = writers.Writer(file, index_types=left_out)
        writer.start(profile="ros2", library="another")
        schema = writer.register_schema(kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0].encode())
        channel = writer.register_channel("/x", "cdr", schema)
        for at in range(5):
            point = store.types["geometry_msgs/msg/Point"](at, 0.0, 0.0)
            raw = bytes(store.serialize_cdr(store.types[kind](header(), point), kind))
            writer.add_message(channel, log_time=10**18 + at, publish_time=0, data=raw)
        writer.finish()
    with open_reader(tmp_path / "bag.mcap") as reader:
        assert [message.get("point.x") for message in reader.messages(["/x"])] == [0, 1, 2, 3, 4]


def png(height: int, width: int) -> bytes:
    """Its head; the rest is of 4 x 6."""
    encoded = bytearray(cv2.imencode(".png", np.zeros((4, 6), np.uint8))[1].tobytes())
    struct.pack_into(">II", encoded, 16, width, height)
    struct.pack_into(">I", encoded, 29, zlib.crc32(encoded[12:29]))
    return bytes(encoded)


def jpeg(height: int, width: int) -> bytes:
    encoded = bytearray(cv2.imencode(".jpg", np.zeros((4, 6), np.uint8))[1].tobytes())
    struct.pack_into(">HH", encoded, encoded.index(b"\xff\xc0") + 5, height, width)
    return bytes(encoded)


def tiff(height: int, width: int) -> bytes:
    encoded = bytearray(cv2.imencode(".tiff", np.zeros((4, 6), np.uint8))[1].tobytes())
    (place,) = struct.unpack_from("<I", encoded, 4)
    for at in range(struct.unpack_from("<H", encoded, place)[0]):
        if (tag := struct.unpack_from("<H", encoded, place + 2 + 12 * at)[0]) in (256, 257):
            struct.pack_into("<HII", encoded, place + 4 + 12 * at, 4, 1, {256: width, 257: height}[tag])
    return bytes(encoded)


@pytest.mark.parametrize("make", [png, jpeg, tiff])
def test_an_image_is_not_decoded_beyond_the_bound(make: Callable[[int, int], bytes]) -> None:
    assert decode_image(make(4, 6), "one").shape == (4, 6)
    with none_larger(3_000_000):
        with pytest.raises(
            InputError, match=re.escape("an image in up to 3 MB of memory; got 3.003 MB | try: a smaller one")
        ):
            decode_image(make(1000, 1001), "one")
        assert decode_image(cv2.imencode(f".{make.__name__}", np.zeros((1000, 1000), np.uint8))[1].tobytes(), "").size
    with pytest.raises(InputError, match="an image in up to 1074 MB"):
        decode_image(make(65_000, 65_000), "one")


def test_an_image_whose_size_is_not_read_is_taken_where_any_would_be() -> None:
    encoded = cv2.imencode(".webp", np.zeros((4, 6, 3), np.uint8))[1].tobytes()
    assert decode_image(encoded, "one").shape == (4, 6, 3)
    with none_larger(10**8), pytest.raises(InputError, match="an image in up to 100 MB of memory; got 805"):
        decode_image(encoded, "one")


def test_very_many_columns_are_refused_by_their_number(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    names = [f"c{at}" for at in range(100)]
    csv(tmp_path / "t.csv", "# a note\n" + ",".join(names) + "\n" + ",".join(["1"] * 100) + "\n")
    pq.write_table(pa.table({name: [1.0] for name in names}), tmp_path / "t.parquet")
    text = map_of({f"force_{axis}_n": f"c{at}" for at, axis in enumerate("xyz")}).replace('"t"', '"c0"')
    for name in ("t.csv", "t.parquet"):
        said = f"skip_rows = 1\n{text}".replace("t.csv", name) if name == "t.csv" else text.replace("t.csv", name)
        (tmp_path / "map.toml").write_text(said)
        asked = [
            "import",
            str(tmp_path / name),
            "--map",
            str(tmp_path / "map.toml"),
            "--record",
            str(tmp_path / f"{name}.rrd"),
        ]
        assert main([*asked, "--largest-mb", "3"]) == 2
        assert (
            "a table, of 100 columns, in up to 3 MB of memory; got 3.277 MB | try: a smaller one"
            in capfd.readouterr().err
        )
        assert main([*asked, "--largest-mb", "4"]) == 0


def test_a_column_that_few_bytes_make_large_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Plain zeros, and lists of one value: some hundred bytes that stand for megabytes."""
    zeros = pa.table({"t": [0.0], "Fx": pa.array([bytes(3_000_000)], pa.binary())})
    lists = pa.table({"t": [0.0], "Fx": pa.array([np.zeros(400_000)], pa.list_(pa.float64()))})
    for at, table in enumerate((zeros, lists)):
        path = tmp_path / f"{at}.parquet"
        pq.write_table(table, path, compression="zstd")
        assert path.stat().st_size < 20_000
        assert main(["import", "--inspect", str(path), "--largest-mb", "2"]) == 2
        assert "expected column Fx" in capfd.readouterr().err
        assert main(["import", "--inspect", str(path), "--largest-mb", "4"]) == 0


def test_the_same_text_in_every_row_is_not_unpacked_at_once(tmp_path: Path) -> None:
    """One text of 1 MB in 500 rows: 500 MB, if they came together."""
    texts = pa.DictionaryArray.from_arrays(pa.array([0] * 500, pa.int32()), pa.array(["a" * 1_000_000]))
    pq.write_table(pa.table({"t": np.arange(500) / 10.0, "note": texts}), tmp_path / "t.parquet", store_schema=False)
    assert (tmp_path / "t.parquet").stat().st_size < 2_000_000
    before = pa.total_allocated_bytes()
    with none_larger(20_000_000), open_reader(tmp_path / "t.parquet") as reader:
        used = [pa.total_allocated_bytes() - before for _ in reader.messages(["t.parquet"])]
    assert len(used) == 500
    assert max(used) < 100_000_000


def joint_states(names: int, count: int = 5) -> Any:
    state, values = stores()[1].types["sensor_msgs/msg/JointState"], np.arange(names) * 0.001
    named = [f"j{at}" for at in range(names)]
    return [state(header(), named[at:] + named[:at], np.roll(values, -at), values, values) for at in range(count)]


def test_joints_are_found_in_time_that_grows_with_their_number() -> None:
    """By counting the comparisons of names: each joint is looked up, not searched for."""
    pytest.importorskip("rosbags")

    class Name(str):
        __slots__ = ()
        compared = 0

        def __eq__(self, other: object) -> bool:
            Name.compared += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    counts = []
    for number in (100, 1000):
        first, second = joint_states(number, 2)
        stream = MappedStream(device="a", kind="arm", topics=("/t",), time="log", pose="/p")
        builder = FrameBuilder(stream, {"/t": Topic("/t", "sensor_msgs/msg/JointState")})
        Name.compared = 0
        for value in (first, second):
            value.name = [Name(one) for one in value.name]
            frame: Any = builder.build({"/t": Message("/t", 1, value)}, Stamp(1), 0, np.eye(4))
            np.testing.assert_allclose(frame.joint_deg, np.rad2deg(np.arange(number) * 0.001), rtol=1e-12)
        counts.append(Name.compared)
    assert counts[1] < 20 * counts[0]


@pytest.mark.parametrize("offset", ["1e10", "-1e10", "4.7e9"])
def test_stamps_that_no_recording_has_are_one_line(
    offset: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = map_of(AXES, f"offset_s = {offset}\n")
    error = refused(csv(tmp_path / "t.csv", FORCES), text, tmp_path / "r.rrd", capfd)
    assert "expected times of tip below 4611686018427387904 ns; got" in error
    assert "try: another time_unit, or offset_s" in error


def test_what_is_nested_too_deeply_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    deep = "[" * 100_000
    folder = tmp_path / "export"
    folder.mkdir()
    csv(folder / "t.csv")
    (folder / "export.json").write_text(deep + "]" * 100_000)
    assert main(["import", "--inspect", str(folder)]) == 2
    error = capfd.readouterr().err
    assert "expected a description of an export; got one nested too deeply | try: the folder without it" in error
    assert len(error.strip().splitlines()) == 1
    error = refused(csv(tmp_path / "t.csv"), f"{map_of(AXES)}x = {deep}", tmp_path / "r.rrd", capfd)
    assert "expected a map (TOML)" in error
    text = map_of(AXES, unit="mN")
    error = refused(csv(tmp_path / "t.csv", f"t,Fx,Fy,Fz\n0,{deep},1,1\n"), text, tmp_path / "r.rrd", capfd)
    assert "a wrench frame of tip; got in frame 0" in error


PCD = (
    "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 2\n"
    "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA binary\n"
)
PLY = "ply\nformat binary_little_endian 1.0\nelement vertex 6\n" + "".join(f"property float {one}\n" for one in "xyz")
BAD_POINTS = [
    ("pcd", "POINTS 6", "POINTS 4000000000"),
    ("pcd", "WIDTH 3", "WIDTH 4000000000"),
    ("pcd", "HEIGHT 2", "HEIGHT -2"),
    ("pcd", "SIZE 4 4 4", "SIZE 4 4 4000000000"),
    ("pcd", "SIZE 4 4 4", "SIZE 4 4"),
    ("pcd", "COUNT 1 1 1", "COUNT 1 1 99999"),
    ("pcd", "FIELDS x y z", "FIELDS x y w"),
    ("pcd", "WIDTH 3\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6", "WIDTH 40000\nHEIGHT 40000\nPOINTS 1600000000"),
    ("pcd", "DATA binary", ""),
    ("pcd", "DATA binary", "DATA binary_compressed"),
    ("pcd", "DATA binary", "DATA BINARY_OF_ANOTHER"),
    ("pcd", "TYPE F F F", "TYPE F F ,"),
    ("ply", "vertex 6", "vertex 7"),
    ("ply", "vertex 6", "vertex 4000000000"),
    ("ply", "vertex 6", "vertex -6"),
    ("ply", "float z", "quad z"),
    ("ply", "property float z", "property list uchar float z"),
    ("ply", "format binary_little_endian 1.0\n", ""),
    ("ply", "end_header", "end"),
]


def write_points(folder: Path, kind: str, before: str, after: str) -> Path:
    head = PCD if kind == "pcd" else f"{PLY}end_header\n"
    assert before in head
    body = np.full((6, 3), 0.5, "<f4").tobytes()
    folder.mkdir(exist_ok=True)
    (folder / f"0.{kind}").write_bytes(head.replace(before, after).encode() + body)
    return folder


def points_map(kind: str) -> str:
    camera = "focal_px = [1, 1]\ncenter_px = [3, 2]\nsize_px = [6, 4]\n"
    text = (
        f'[[streams]]\ndevice = "cam"\nkind = "depth"\ntopics = ["*.{kind}"]\nrate_hz = 1\nunits = {{points = "m"}}\n'
    )
    return text + camera


@pytest.mark.parametrize(("kind", "before", "after"), BAD_POINTS)
def test_a_file_without_the_points_that_it_declares_is_refused(
    kind: str, before: str, after: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = write_points(tmp_path / "points", kind, before, after)
    assert f"0.{kind}" in refused(folder, points_map(kind), tmp_path / "r.rrd", capfd)


@pytest.mark.parametrize("kind", ["pcd", "ply"])
def test_files_of_points_are_taken_as_they_are(kind: str, tmp_path: Path) -> None:
    folder = write_points(tmp_path / "points", kind, "", "")
    (frame,) = frames_of(imported(folder, points_map(kind), tmp_path / "r.rrd"))["cam"]
    depth: Any = frame.depth  # type: ignore[union-attr]
    assert depth.max() == 5000
    assert depth.shape == ((2, 3) if kind == "pcd" else (4, 6))


def pcd_of(form: str, kind: str, values: Any, fields: str = "x y z", counts: str = "1 1 1") -> bytes:
    """Points (n, 3) of one kind, by rows."""
    table = np.asarray(values, f"<{kind.lower()}")
    each = [" ".join([one] * len(fields.split())) for one in (kind[1], kind[0])]
    head = (
        f"VERSION .7\nFIELDS {fields}\nSIZE {each[0]}\nTYPE {each[1]}\nCOUNT {counts}\nWIDTH {len(table)}\nHEIGHT 1\n"
    )
    rows = "\n".join(" ".join(map(str, row)) for row in table.tolist()) + "\n"
    body = table.tobytes() if form == "binary" else rows.encode()
    return f"{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(table)}\nDATA {form}\n".encode() + body


@pytest.mark.parametrize("form", ["binary", "ascii"])
@pytest.mark.parametrize("kind", ["F4", "F8", "I1", "I2", "I4", "I8", "U1", "U8"])
def test_points_of_any_type_are_read(form: str, kind: str, tmp_path: Path) -> None:
    """Open3D 0.20 takes eight bytes in binary as 0."""
    (tmp_path / "a.pcd").write_bytes(pcd_of(form, kind, [[1, 2, 3], [4, 5, 100]]))
    assert read_points(tmp_path / "a.pcd").tolist() == [[[1, 2, 3], [4, 5, 100]]]
    (tmp_path / "a.pcd").write_bytes(pcd_of(form, kind, [[9, 9, 3, 2, 1], [9, 9, 6, 5, 4]], "_ z y x", "2 1 1 1"))
    assert read_points(tmp_path / "a.pcd").tolist() == [[[1, 2, 3], [4, 5, 6]]]


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("axes", ["xyz", "zyx", "yzx"])
def test_vertices_are_read_by_their_names(form: str, axes: str, tmp_path: Path) -> None:
    """Open3D 0.20 takes what its memory held where z is not the last."""
    kinds = dict(zip("xyz", ("double", "float", "short"), strict=True))
    order = "<" if "little" in form else ">"
    body = b""
    for row in ({"x": 1, "y": 2, "z": 3}, {"x": 4, "y": 5, "z": 6}):
        if form == "ascii":
            body += " ".join(str(row[axis]) for axis in axes).encode() + b"\n"
        else:
            numpy = {"double": "f8", "float": "f4", "short": "i2"}
            body += b"".join(np.array([row[axis]], order + numpy[kinds[axis]]).tobytes() for axis in axes)
    head = f"ply\nformat {form} 1.0\ncomment made\nelement vertex 2\n"
    head += "".join(f"property {kinds[axis]} {axis}\n" for axis in axes)
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + body + (b"3 0 1 1\n" if form == "ascii" else bytes(13)))
    assert read_points(tmp_path / "a.ply").tolist() == [[[1, 2, 3], [4, 5, 6]]]


def test_empty_lines_between_points_are_none(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(pcd_of("ascii", "F4", [[1, 2, 3], [4, 5, 6]]).replace(b"3.0\n", b"3.0\r\n\r\n"))
    assert read_points(tmp_path / "a.pcd").tolist() == [[[1, 2, 3], [4, 5, 6]]]


def test_a_file_with_a_line_less_is_refused(tmp_path: Path) -> None:
    """Open3D 0.20 takes what its memory held for the points that are not there."""
    path = tmp_path / "a.pcd"
    whole = pcd_of("ascii", "F4", [[1.123456, 2.123456, 3.123456]] * 5)
    for damaged in (
        whole[: whole.index(b"1.1")],
        whole[: whole.rstrip().rindex(b"\n")],
        whole.replace(b"\n1.", b"\n,", 1),
    ):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="a PCD or PLY file with the points that it declares"):
            read_points(path)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("ending", ["pcd", "ply"])
def test_points_are_those_that_open3d_wrote(ending: str, compressed: bool, tmp_path: Path) -> None:
    import open3d as o3d

    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(size=(300, 3)), np.zeros((300, 3)), np.repeat(rng.normal(size=(3, 3)), 100, 0)])
    made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float32)))
    made.colors = o3d.utility.Vector3dVector(rng.uniform(size=points.shape))
    path = tmp_path / f"a.{ending}"
    for is_ascii in (False, True):
        assert o3d.io.write_point_cloud(str(path), made, write_ascii=is_ascii, compressed=compressed)
        np.testing.assert_allclose(read_points(path)[0], points, rtol=1e-5, atol=1e-6)


def test_the_bound_is_stated_with_what_came() -> None:
    check_size("a thing", 1 << 30)
    with none_larger(1_000_000), pytest.raises(InputError) as caught:
        check_size("a thing", 1_000_001, "here")
    hint = "a smaller one, or a higher --largest-mb of import"
    assert str(caught.value) == f"expected a thing in up to 1 MB of memory; got more | try: {hint} | here"
    check_size("a thing", 1_000_001)
