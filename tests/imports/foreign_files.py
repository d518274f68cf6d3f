"""Well-formed files of other programs, with whatever sizes, counts and values their formats let them declare.

`case(seed, folder)` writes one, and returns the command lines that read it. All are small: what they declare may be
large, and `--largest-mb` is lowered where they are compressed."""

import itertools
import json
import random
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

Commands = list[list[str]]
SIZES = (0, 1, 2, 3, 4, 7, 8, 12, 16, 64, 255, 4096, 65535, 65536, 4_000_000, 2**31 - 1, 2**31, 2**32 - 1)
REALS = (0.0, -0.0, 1.0, -1.0, 0.5, 1e-300, 1e-9, 1e9, 1e10, 1.8e19, 1e300, -1e300, float("nan"), float("inf"))
WORDS = ("", "x", "nan", "1e400", "0x10", "²", "1,5", "[1, 2]", "[" * 3000, "9" * 400, "\x1b[31m", "ä\u202e", "a" * 300)
COUNT = 3


class Draw(random.Random):
    """A source of odd values."""

    def odd(self, usual: Any, *others: Any, chance: float = 0.03) -> Any:
        """The usual value, or sometimes one of the others."""
        return self.choice(others) if self.random() < chance else usual

    def size(self, usual: int, most: int = 2**32 - 1) -> int:
        return int(self.odd(usual, *(one for one in SIZES if one <= most)))

    def real(self, usual: float) -> float:
        return float(self.odd(usual, *REALS))

    def word(self, usual: str, *more: str) -> str:
        return str(self.odd(usual, *WORDS, *more))


def stream(draw: Draw, kind: str, topics: list[str], **keys: Any) -> str:
    """A stream of a map, some of whose keys are odd."""
    said = {"device": "dev", "kind": draw.odd(kind, "wrench", "tactile", "arm", "hand", "color", "depth", chance=0.1)}
    said |= {"topics": topics} | keys
    odd = {
        "offset_s": draw.choice((0.0, 1e10, -1e10, 5e9, 1.0)),
        "nan": "keep",
        "unit_m": draw.choice((0.001, 1e-300, 1e3)),
        "time": draw.choice(("log", "header", "t", "nothing")),
        "rate_hz": draw.choice((1e-300, 1.0, 1e9)),
        "size_px": draw.choice(([6, 4], [0, 4], [-1, 4], [10**9, 10**9], [70_000, 2])),
        "pads": draw.choice(([], [pad(draw)], [pad(draw), pad(draw)])),
        "joints": draw.choice((["a"], ["a", "b"], ["a", "a"], ["none"])),
    }
    said |= {name: odd[name] for name in odd if draw.random() < 0.04}
    return "[[streams]]\n" + "".join(f"{name} = {toml(value)}\n" for name, value in said.items())


def pad(draw: Draw) -> dict[str, Any]:
    about = {"name": "a", "rows": draw.size(1), "columns": draw.size(3), "texel_m": [draw.real(0.003), 0.003]}
    return about | {"index": draw.size(0), "finger": draw.size(0), "part": draw.size(0)}


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(name)} = {toml(one)}" for name, one in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")


def asked(folder: Path, source: Path, text: str, *flags: str) -> Commands:
    """Inspect a source, and import it with a map."""
    (folder / "map.toml").write_text(text, encoding="utf-8")
    command = ["import", str(source), "--map", str(folder / "map.toml"), "--record", str(folder / "r.rrd"), *flags]
    return [["import", "--inspect", str(source), *flags], command]


def table(draw: Draw, folder: Path) -> Commands:
    """CSV or Parquet."""
    rows = draw.size(COUNT, 64)
    stamps = [draw.odd(at / 100, *REALS, chance=0.02) for at in range(rows)]
    columns: dict[str, Any] = {draw.word("t"): pa.array(stamps, pa.float64())}
    for name in ("Fx", "Fy", "Fz"):
        values = [draw.real(1.0) for _ in range(rows)]
        kinds: dict[str, Callable[[], Any]] = {
            "reals": lambda values=values: pa.array(values, pa.float64()),
            "texts": lambda: pa.array([draw.choice(WORDS) for _ in range(rows)]),
            "lists": lambda: pa.array([[1.0] * draw.size(3, 16) for _ in range(rows)], pa.list_(pa.float64())),
            "bytes": lambda: pa.array([image(draw, ".png") for _ in range(rows)], pa.binary()),
            "whole": lambda: pa.array([draw.choice((0, 2**63 - 1, -(2**63))) for _ in range(rows)], pa.int64()),
            "stamps": lambda: pa.array([draw.choice((0, 2**52, -1)) for _ in range(rows)], pa.timestamp("s")),
            "empty": lambda: pa.nulls(rows),
            "rows": lambda: pa.array([{"a": 1}] * rows, pa.struct([("a", pa.int64())])),
            "shares": lambda: pa.array(["one"] * rows).dictionary_encode(),
        }
        columns[name] = kinds[draw.odd("reals", *kinds, chance=0.2)]()
    columns |= {f"more{at}": pa.array([1.0] * rows) for at in range(draw.odd(0, 50, 200, chance=0.1))}
    made = pa.table(columns)
    is_flat = not any(pa.types.is_nested(one) or pa.types.is_binary(one) for one in made.schema.types)
    source = folder / ("t.csv" if is_flat and draw.random() < 0.5 else "t.parquet")
    if source.suffix == ".csv":
        pa_csv.write_csv(made, source)
    else:
        pq.write_table(
            made, source, compression=draw.choice(("none", "snappy", "zstd")), row_group_size=draw.size(2, 64) or 1
        )
    fields = {f"force_{axis}_n": f"F{axis}" for axis in "xyz"}
    kind = draw.odd("wrench", "hand", "tactile", "color", chance=0.15)
    fields = {"hand": {"position_deg": "Fx", "state": "Fy"}, "tactile": {"pressure_pa": "Fx", "counts": "Fy"}}.get(
        kind, fields
    )
    fields = {"image": "Fx"} if kind == "color" else fields
    units = {"Fx": draw.odd({"hand": "deg", "tactile": "Pa"}.get(kind, "N"), "mN", "?"), "Fy": "N", "Fz": "N"}
    keys = {"columns": fields, "units": units, "time": "t", "time_unit": draw.odd("s", "ns", "us", "")}
    few = draw.odd([], ["--largest-mb", "1"], chance=0.3)
    return asked(folder, source, stream(draw, kind, [source.name], **keys), *few)


def export(draw: Draw, folder: Path) -> Commands:
    """A folder with the description of an export of ours, by somebody else."""
    about: Any = {"schema_version": draw.odd(1, -1, 10**30, "1", None, 1.5, chance=0.1)}
    about["session_starts_ns"] = draw.odd(0, 2**63, -(2**70), 10**30, None)
    columns = [{"name": name, "type": draw.odd("double", "int64", "x"), "unit": draw.word("N")} for name in ("t", "Fx")]
    columns.append({"name": "host_ns", "type": "int64", "unit": "ns"})
    kind = draw.odd("WrenchFrame", "TactileFrame", "ArmFrame", "HandFrame", "ColorFrame", "X")
    about["streams"] = [{"entity": draw.word("devices/dev"), "kind": kind, "files": ["t.csv"], "columns": columns}]
    device = {"kind": "wrench", "channels": draw.size(1), "torques": True, "pads": [pad(draw)]}
    about["devices"] = draw.odd({}, {"dev": device}, {"dev": {}}, {"dev": {"kind": 3}}, chance=0.5)
    text = json.dumps(about)
    if draw.random() < 0.1:
        text = "[" * 100_000 + "]" * 100_000
    (folder / "e").mkdir()
    (folder / "e" / "export.json").write_text(text)
    names = ["host_ns", "index", "force_0_x_n", "force_0_y_n", "force_0_z_n", "counts_0"]
    rows = [[at * 10**7, at, *(draw.real(1.0) for _ in range(3)), draw.size(1)] for at in range(COUNT)]
    (folder / "e" / "t.csv").write_text("\n".join([",".join(names), *(",".join(map(str, one)) for one in rows)]) + "\n")
    return asked(folder, folder / "e", stream(draw, "wrench", ["t.csv"]))


def arrays(draw: Draw, folder: Path) -> Commands:
    """`.npz` of a table of trials, and of a pair."""
    count = draw.size(6, 64)
    kinds: Any = [np.float64, np.float32, np.int64, np.uint8, np.bool_, "U3", "S3", np.complex128]
    made = {"label": np.array(["a", "b"] * count)[:count], "group": np.arange(count) % 3}
    for name in draw.sample(
        ["rest", "deformed", "held", "shape", "cell", "step_s", "series.a", "tactile", "force_n"], 5
    ):
        shape = draw.choice(([count, 3], [count], [], [count, 2, 2], [0], [count, 0]))
        made[name] = np.full(shape, draw.odd(1, 0, 2, 100)).astype(draw.odd(np.float64, *kinds))
    (np.savez_compressed if draw.random() < 0.5 else np.savez)(folder / "t.npz", **made)
    return [["classify", str(folder / "t.npz"), "--folds", "2"], ["calibrate", "beta", str(folder / "t.npz")]]


def image(draw: Draw, ending: str) -> bytes:
    """A PNG, JPEG or TIFF; what it declares may be other than what follows."""
    shape = [draw.size(4, 64) or 1, draw.size(6, 64) or 1, *draw.choice(([], [3], [4]))]
    wide = ending != ".jpg" and draw.random() < 0.5
    pixels = np.full(shape, draw.randrange(256), np.uint16 if wide else np.uint8)
    encoded = bytearray(cv2.imencode(ending, pixels)[1].tobytes())
    if ending == ".png" and draw.random() < 0.3:
        import zlib

        struct.pack_into(">II", encoded, 16, draw.size(4), draw.size(6))
        struct.pack_into(">I", encoded, 29, zlib.crc32(encoded[12:29]))
    if ending == ".jpg" and draw.random() < 0.3:
        place = encoded.index(b"\xff\xc0")
        struct.pack_into(">HH", encoded, place + 5, draw.size(4, 65535), draw.size(6, 65535))
    if ending == ".tiff" and draw.random() < 0.3:
        (place,) = struct.unpack_from("<I", encoded, 4)
        struct.pack_into("<I", encoded, place + 10 + 12 * draw.randrange(2), draw.size(4))
    return bytes(encoded)


def images(draw: Draw, folder: Path) -> Commands:
    """A folder of images with their times."""
    ending = draw.choice((".png", ".jpg", ".tiff"))
    (folder / "c").mkdir()
    for at in range(COUNT):
        (folder / "c" / f"{at}{ending}").write_bytes(image(draw, ending))
    (folder / "t.txt").write_text("".join(f"{draw.word(str(at / 10))}\n" for at in range(COUNT)), encoding="utf-8")
    keys = {"time": "t.txt", "time_unit": draw.odd("s", "ns"), "unit_m": 0.001}
    text = stream(draw, draw.choice(("color", "depth")), [f"c/*{ending}"], **keys)
    return asked(folder, folder, text, *draw.odd([], ["--largest-mb", "1"], chance=0.5))


def points(draw: Draw, folder: Path) -> Commands:
    """A folder of PCD or PLY."""
    (folder / "p").mkdir()
    ending = draw.choice((".pcd", ".ply"))
    for at in range(2):
        (folder / "p" / f"{at}{ending}").write_bytes((pcd if ending == ".pcd" else ply)(draw))
    keys = {"units": {"points": draw.odd("m", "mm", "?", chance=0.1)}, "rate_hz": 1.0}
    keys |= {"focal_px": [draw.real(100.0), 100.0], "center_px": [3.0, draw.real(2.0)], "size_px": [6, 4]}
    return asked(folder, folder, stream(draw, "depth", [f"p/*{ending}"], **keys))


def pcd(draw: Draw) -> bytes:
    width, height = draw.size(4), draw.size(1)
    fields = ["x", "y", "z", *draw.odd([], ["rgb"], ["a", "b"])]
    sizes = [draw.odd(4, 1, 2, 8, 0, 3, chance=0.05) for _ in fields]
    counts = [draw.odd(1, 0, 2, 4_000_000, 2**31, chance=0.03) for _ in fields]
    draw.shuffle(fields)
    kinds = [draw.odd("F", "I", "U", chance=0.1) for _ in fields]
    data = draw.choice(("ascii", "binary", "binary_compressed"))
    points = draw.odd(width * height, *SIZES, chance=0.05)
    head = {"VERSION": [".7"], "FIELDS": fields, "SIZE": sizes, "TYPE": kinds, "COUNT": counts, "WIDTH": [width]}
    head |= {"HEIGHT": [height], "VIEWPOINT": [0, 0, 0, 1, 0, 0, 0], "POINTS": [points], "DATA": [data]}
    text = "".join(f"{name} {' '.join(map(str, words))}\n" for name, words in head.items()).encode()
    number, step = min(points, 12), min(sum(size * one for size, one in zip(sizes, counts, strict=True)), 4096)
    if data == "ascii":
        row = " ".join(str(draw.real(0.5)) for _ in range(min(sum(counts), 50)))
        return text + f"{row}\n".encode() * number
    body = np.full(number * step // 4 + 1, draw.real(0.5), "<f4").tobytes()[: number * step]
    if data == "binary_compressed":  # every byte as it is: a run of 32 at most after its length
        parts = [body[at : at + 32] for at in range(0, len(body), 32)]
        packed = b"".join(bytes([len(one) - 1]) + one for one in parts)
        return text + struct.pack("<II", draw.size(len(packed)), draw.size(len(body))) + packed
    return text + body


def ply(draw: Draw) -> bytes:
    count = draw.size(4)
    form = draw.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    kinds = [draw.odd("float", "double", "int", "uchar", "x", chance=0.1) for _ in "xyz"]
    lines = ["ply", f"format {form} 1.0", f"element vertex {draw.odd(count, -1, 10**20, chance=0.03)}"]
    lines += [f"property {kind} {name}" for kind, name in zip(kinds, "xyz", strict=True)]
    lines += draw.odd(
        [], ["element face 2000000000", "property list uchar int vertex_indices"], ["property list int int l"]
    )
    head = "\n".join([*lines, "end_header\n"]).encode()
    if form == "ascii":
        return head + f"{draw.real(0.1)} 0.2 {draw.real(0.5)}\n".encode() * min(count, 12)
    order = "<" if "little" in form else ">"
    kind = {"float": "f4", "double": "f8", "int": "i4", "uchar": "u1"}
    return head + b"".join(np.array([1], order + kind.get(one, "f4")).tobytes() for one in kinds) * min(count, 12)


@cache
def stores() -> tuple[Any, Any]:
    """Types of ROS 1 and ROS 2."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    tf = get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    for store in (ros1, ros2):
        store.register(get_types_from_msg("std_msgs/Empty[] many\nfloat64 mass", "other_msgs/msg/Thing"))
    ros1.register(tf)
    return ros1, ros2


def messages(draw: Draw, types: Any, ros1: bool) -> dict[str, tuple[str, Callable[[int], Any], str]]:
    """Topics: type, message number n, kind of stream."""
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    sequence = itertools.count()

    def header(at: int) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](draw.size(1000, 2**31 - 1), draw.size(at * 10**7))
        more = {"seq": next(sequence)} if ros1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=draw.word("base"), **more)

    def three(kind: Any = vector) -> Any:
        return kind(*(draw.real(0.1) for _ in range(3)))

    def pose(at: int) -> Any:
        place = three(types["geometry_msgs/msg/Point"])
        turned = turn(draw.real(0.0), 0.0, 0.0, draw.real(1.0))
        return types["geometry_msgs/msg/PoseStamped"](header(at), types["geometry_msgs/msg/Pose"](place, turned))

    def wrench(at: int) -> Any:
        return types["geometry_msgs/msg/WrenchStamped"](header(at), types["geometry_msgs/msg/Wrench"](three(), three()))

    def joints(at: int) -> Any:
        names = draw.odd(["a", "b"], [], ["a", "a"], ["x"] * 500, [str(one) for one in range(500)])
        values = [np.full(draw.size(len(names), 4096), draw.real(0.1)) for _ in range(3)]
        return types["sensor_msgs/msg/JointState"](header(at), names, *values)

    def links(at: int) -> Any:
        link = types["geometry_msgs/msg/TransformStamped"]
        moved = types["geometry_msgs/msg/Transform"](three(), turn(0.0, 0.0, 0.0, draw.real(1.0)))
        return types["tf2_msgs/msg/TFMessage"]([link(header(at), draw.word("tool", "base", "x"), moved)])

    def picture(at: int) -> Any:
        encoding = draw.word("16UC1", "32FC1", "mono16", "rgb8", "bgra8", "mono8", "bayer_rggb8")
        height, width = draw.size(4), draw.size(6)
        each = {"32FC1": 4, "rgb8": 3, "bgra8": 4, "mono8": 1}.get(encoding, 2)
        data = np.full(min(draw.size(height * width * each), 5_000_000), draw.randrange(256), np.uint8)
        about = draw.size(0, 1), min(draw.size(width * each), 2**32 - 1)
        return types["sensor_msgs/msg/Image"](header(at), height, width, encoding, *about, data)

    def packed(at: int) -> Any:
        data = image(draw, draw.choice((".png", ".jpg", ".tiff")))
        data = draw.odd(data, b"", data[: len(data) // 2], bytes(12) + data)
        form = draw.word("png", "jpeg", "16UC1; compressedDepth", "16UC1; png compressed ")
        return types["sensor_msgs/msg/CompressedImage"](header(at), form, np.frombuffer(data, np.uint8))

    def cloud(at: int) -> Any:
        field = types["sensor_msgs/msg/PointField"]
        names = draw.odd(["x", "y", "z"], ["x", "y"], ["x", "y", "z", "rgb"], ["x", "x", "y", "z"], [])
        fields = [
            field(name, draw.size(4 * place), draw.size(7, 255), draw.size(1)) for place, name in enumerate(names)
        ]
        step, width, height = draw.size(4 * max(len(names), 1)), draw.size(4), draw.size(1)
        data = np.frombuffer(np.full(min(draw.size(width * height), 4096) * 4, 0.5, "<f4").tobytes(), np.uint8)
        data = data[: draw.size(len(data))]
        big, row = bool(draw.size(0, 1)), min(draw.size(step * width), 2**32 - 1)
        return types["sensor_msgs/msg/PointCloud2"](header(at), height, width, fields, big, step, row, data, True)

    def thing(at: int) -> Any:
        return types["other_msgs/msg/Thing"]([types["std_msgs/msg/Empty"]()] * draw.size(1, 64), draw.real(1.0))

    return {
        "/ft": ("geometry_msgs/msg/WrenchStamped", wrench, "wrench"),
        "/joints": ("sensor_msgs/msg/JointState", joints, "arm"),
        "/pose": ("geometry_msgs/msg/PoseStamped", pose, "arm"),
        "/tf": ("tf2_msgs/msg/TFMessage", links, ""),
        "/image": ("sensor_msgs/msg/Image", picture, "depth"),
        "/packed": ("sensor_msgs/msg/CompressedImage", packed, "color"),
        "/points": ("sensor_msgs/msg/PointCloud2", cloud, "depth"),
        "/thing": ("other_msgs/msg/Thing", thing, ""),
    }


def bag(draw: Draw, folder: Path) -> Commands:
    """ROS 1, ROS 2 or MCAP, compressed or not."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    ros1 = draw.random() < 0.4
    store = stores()[0 if ros1 else 1]
    made = messages(draw, store.types, ros1)
    topics = draw.sample(list(made), draw.randint(1, 3))
    topics += ["/pose"] if "/joints" in topics and "/pose" not in topics else []
    source = folder / ("b.bag" if ros1 else "b")
    writer: Any
    if ros1:
        writer = Writer1(source)
        if (packed := draw.choice(("", "BZ2", "LZ4"))) != "":
            writer.set_compression(Writer1.CompressionFormat[packed])
    else:
        plugin = draw.choice((StoragePlugin.SQLITE3, StoragePlugin.MCAP))
        writer = Writer2(source, version=draw.choice((8, 9)), storage_plugin=plugin)
        modes = (
            [CompressionMode.STORAGE]
            if plugin == StoragePlugin.MCAP
            else [CompressionMode.MESSAGE, CompressionMode.FILE]
        )
        if (mode := draw.odd(None, *modes, chance=0.5)) is not None:
            writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer as opened:
        known = {name: opened.add_connection(name, made[name][0], typestore=store) for name in topics}
        for at, name in itertools.product(range(COUNT), topics):
            kind, message, _ = made[name]
            value = message(at)
            raw = store.serialize_ros1(value, kind) if ros1 else store.serialize_cdr(value, kind)
            opened.write(known[name], 10**18 + draw.size(at * 10**7), raw)
        if draw.random() < 0.1:  # of zeros, which one chunk holds in few bytes
            store_text = "std_msgs/msg/String"
            value = store.types[store_text]("a" * 3_000_000)
            raw = store.serialize_ros1(value, store_text) if ros1 else store.serialize_cdr(value, store_text)
            opened.write(opened.add_connection("/text", store_text, typestore=store), 10**18, raw)
    text = ""
    for at, name in enumerate(one for one in topics if made[one][2]):
        keys: dict[str, Any] = (
            {"pose": draw.odd("/pose", "/tf"), "parent": "base", "child": "tool"} if name == "/joints" else {}
        )
        if name == "/points":
            keys = {"focal_px": [100.0, draw.real(100.0)], "center_px": [3.0, 2.0], "size_px": [6, 4]}
        keys |= {"time": "log"} if draw.random() < 0.5 else {}
        text += stream(draw, made[name][2], [name], **keys).replace('"dev"', f'"dev{at}"')
    found = source if ros1 or draw.random() < 0.5 else next(one for one in sorted(source.iterdir(), reverse=True))
    found = found if found.suffix in ("", ".bag", ".mcap", ".db3") else source
    return asked(folder, found, text, *draw.odd([], ["--largest-mb", "1"], chance=0.5))


def urdf(draw: Draw, folder: Path) -> Commands:
    """A robot, as a rig file names it."""
    shapes = ("box size='{0} 0.1 0.1'", "sphere radius='{0}'", "cylinder radius='{0}' length='0.1'")
    names = ("/etc/hostname", "file:///etc/hostname", "package://x/../../y.stl", "a" * 300 + ".stl", "~/a.stl", ".", "")
    parts = []
    for at in range(draw.size(3, 64)):
        shape = draw.odd(draw.choice(shapes).format(draw.real(0.1)), *(f"mesh filename='{one}'" for one in names))
        visual = f"<visual><geometry><{shape}/></geometry></visual>"
        parts.append(f"<link name='l{draw.odd(at, 0, chance=0.03)}'>{visual}</link>")
        if at:
            kind = draw.odd("revolute", "fixed", "floating", "x")
            limit = f"<limit lower='{draw.word('0')}' upper='{draw.real(1.0)}'/>" if draw.random() < 0.3 else ""
            limit = limit.replace("\x1b", "")
            parts.append(f"<joint name='j{at}' type='{kind}'><parent link='l{draw.odd(at - 1, at, chance=0.05)}'/>")
            parts[-1] += f"<child link='l{at}'/><axis xyz='0 {draw.real(1.0)} 0'/>{limit}</joint>"
    (folder / "g.urdf").write_text(f"<robot name='x'>{''.join(parts)}</robot>", encoding="utf-8")
    name = draw.odd("g.urdf", "/etc/hostname", "~nobody-of-this-name/g.urdf", "a" * 300, ".", chance=0.2)
    return [["describe", str(folder), name]]


KINDS: dict[str, Callable[[Draw, Path], Commands]] = {
    one.__name__: one for one in (table, export, images, points, bag, urdf, arrays)
}
"""Each kind of file, and what reads it."""


def case(seed: int, folder: Path) -> tuple[str, Commands]:
    """The kind of a case, and its command lines; its files lie in `folder`."""
    draw = Draw(seed)
    name = draw.choices(list(KINDS), [3, 1, 2, 3, 5, 1, 1])[0]
    return name, KINDS[name](draw, folder)
