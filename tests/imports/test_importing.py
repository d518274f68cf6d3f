"""Imports: what was exported comes back to the last bit; what others wrote becomes frames; what is wrong is a line."""

import itertools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope.cli import main
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, Frame, WrenchFrame
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.export.export import ExportRequest, export
from deformscope.recording.items import read_items, read_streams
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.recording.streams import RecordingTables
from deformscope.rows import differing
from deformscope_drivers.clock import Stamp
from tests.cases import slow_but
from tests.log import synthetic_rig as rig
from tests.verified import verify_here

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


ROUNDS = [(path, to) for path in (BENCH, EXPLORED) for to in ("parquet", "mcap", "csv")]


@pytest.mark.parametrize(("path", "to"), slow_but([ROUNDS[1]], ROUNDS))
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
    assert verify_here(again) == 0


numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=4, deadline=None)
@given(forces=st.lists(st.tuples(numbers, numbers, numbers), min_size=6, max_size=18), late=st.booleans())
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
        made.start(RigLayout((rig.frames.Stream("tip", "wrench", "optoforce"),)), rig.START_NS)
        made.write(frames)
    for to in ("parquet", "csv", "mcap"):
        assert not differences(list(frames), frames_of(brought_back(path, to, folder))["tip"]), to


def rotation_z(angle: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, float(np.sin(angle / 2)), float(np.cos(angle / 2))


def write_bag(path: Path, *, ros1: bool = False, offset_s: float = 0.0, count: int = 20) -> Path:
    """Wrench, joint states, transforms, depth, colour and points of another robot, by rosbags' own writer."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    types: Any = store.types
    kinds: dict[str, str] = {
        "/ft/wrench": "geometry_msgs/msg/WrenchStamped",
        "/joint_states": "sensor_msgs/msg/JointState",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/cam/depth": "sensor_msgs/msg/Image",
        "/cam/far": "sensor_msgs/msg/Image",
        "/cam/color": "sensor_msgs/msg/Image",
        "/cam/points": "sensor_msgs/msg/PointCloud2",
        "/chatter": "std_msgs/msg/String",
    }
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    sequence = itertools.count()

    def header(ns: int, frame: str) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        more = {"seq": next(sequence)} if ros1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **more)

    def link(ns: int, parent: str, child: str, at: tuple[float, float, float], turn: tuple[float, ...]) -> Any:
        transform = types["geometry_msgs/msg/Transform"](vector(*at), quaternion(*turn))
        one = types["geometry_msgs/msg/TransformStamped"](header(ns, parent), child, transform)
        return types["tf2_msgs/msg/TFMessage"]([one])

    def image(ns: int, data: Any, encoding: str) -> Any:
        rows = data.reshape(len(data), -1).view(np.uint8)
        return types[kinds["/cam/depth"]](
            header(ns, "cam"), len(data), data.shape[1], encoding, 0, rows.shape[1], rows.ravel()
        )

    def points(ns: int) -> Any:
        field = types["sensor_msgs/msg/PointField"]
        fields = [field(axis, 4 * at, 7, 1) for at, axis in enumerate("xyz")]
        data = cloud().astype("<f4")
        shape = 1, len(data), fields, False, 12, 12 * len(data)
        return types[kinds["/cam/points"]](header(ns, "cam"), *shape, data.view(np.uint8).ravel(), True)

    def messages(at: int) -> Any:
        ns = round((1e9 + offset_s) * 1e9) + at * 10**7
        torque, force = vector(0.1, 0.0, at / 3), vector(*forces(at))
        wrench = types["geometry_msgs/msg/Wrench"](force, torque)
        yield "/tf_static", link(ns, "base", "shoulder", (0.0, 0.0, 0.5), rotation_z(np.pi / 2))
        yield "/tf", link(ns, "shoulder", "tool", (0.1 + at / 1000, 0.0, 0.0), rotation_z(0.0))
        yield "/ft/wrench", types[kinds["/ft/wrench"]](header(ns, "ft"), wrench)
        angles = np.array([at / 10, -at / 7])
        yield "/joint_states", types[kinds["/joint_states"]](header(ns, ""), ["b", "a"], angles, angles, angles)
        yield "/joint_states", types[kinds["/joint_states"]](header(ns + 1, ""), ["gripper"], *([np.ones(1)] * 3))
        yield "/cam/depth", image(ns, near(at), "16UC1")
        yield "/cam/far", image(ns, (near(at) / 1000).astype(np.float32), "32FC1")
        yield "/cam/color", image(ns, np.full((4, 6, 3), (10, 20, at), np.uint8), "bgr8")
        yield "/cam/points", points(ns)
        yield "/chatter", types[kinds["/chatter"]]("hello")

    more = {} if ros1 else {"version": 8, "storage_plugin": StoragePlugin.SQLITE3}
    with Writer1(path) if ros1 else Writer2(path, **more) as bag:  # type: ignore[arg-type]
        topics = {
            topic: bag.add_connection(topic, kind, typestore=store)  # type: ignore[arg-type]
            for topic, kind in kinds.items()
        }
        for at in range(count):
            for place, (topic, message) in enumerate(messages(at)):
                kind = kinds[topic]
                raw = store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind)
                bag.write(topics[topic], 10**18 + at * 10**7 + place, raw)  # type: ignore[arg-type]
    return path


def forces(at: int) -> tuple[float, float, float]:
    return 0.1 * at, -1.0 / (at + 1), 1e-3 * at


def near(at: int) -> Any:
    return (500 + at + np.arange(24, dtype=np.uint16)).reshape(4, 6)


def cloud() -> Any:
    """Points of pixels 2, 1 and 3, 2 of a camera of 100 px focal length with its axis at 3, 2, and a farther one."""
    return np.array([[-0.005, -0.005, 0.5], [0.0, 0.0, 0.7], [0.0, 0.0, 0.9], [np.nan, 0.0, 0.4]])


ANSWERS = (
    ('parent = "?"', 'parent = "base"'),
    ('child = "?"\njoints = ["b", "a"]', 'child = "tool"\njoints = ["a", "b"]'),
    (
        'topics = ["/cam/points"]',
        'topics = ["/cam/points"]\nfocal_px = [100, 100]\ncenter_px = [3, 2]\nsize_px = [6, 4]',
    ),
)


def answered(text: str, *answers: tuple[str, str]) -> str:
    for question, answer in answers:
        assert question in text, (question, text)
        text = text.replace(question, answer)
    return text


@pytest.mark.parametrize("ros1", [False, True], ids=["ros2", "ros1"])
def test_a_bag_of_another_robot_becomes_frames(ros1: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / ("other.bag" if ros1 else "other"), ros1=ros1)
    assert main(["import", "--inspect", str(bag), "--json", str(tmp_path / "found.json")]) == 0
    text = capfd.readouterr().out
    assert "/ft/wrench: geometry_msgs/msg/WrenchStamped, 20 messages, 100/s, longest gap 0.01 s" in text
    assert "frames base, shoulder" in text
    found = {one["topic"]: one for one in json.loads((tmp_path / "found.json").read_text())["topics"]}
    assert found["/chatter"]["type"] == "std_msgs/msg/String"
    (tmp_path / "map.toml").write_text(answered(text, *ANSWERS))
    assert main(["import", str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]) == 0
    assert "joint_states  20 frames (arm), 20 messages of others left out" in capfd.readouterr().out  # of the gripper
    own = frames_of(tmp_path / "r.rrd")
    assert {name: len(frames) for name, frames in own.items()} == dict.fromkeys(
        ("ft_wrench", "joint_states", "cam_depth", "cam_far", "cam_color", "cam_points"), 20
    )
    for at in range(20):
        felt, arm, depth, far, color, points = (own[name][at] for name in own_order(own))
        assert isinstance(felt, WrenchFrame)
        assert felt.stamp.host_ns == 10**18 + at * 10**7
        assert felt.force_n.tolist() == [list(forces(at))]
        assert felt.torque_nm.tolist() == [[0.1, 0.0, at / 3]]
        assert isinstance(arm, ArmFrame)
        np.testing.assert_allclose(arm.joint_deg, np.rad2deg([-at / 7, at / 10]), rtol=4e-16, atol=0)
        np.testing.assert_allclose(arm.position_m, [0.0, 0.1 + at / 1000, 0.5], atol=1e-15)
        np.testing.assert_allclose(arm.rotation_rad, [0.0, 0.0, np.pi / 2], atol=1e-12)
        assert isinstance(depth, DepthFrame)
        assert depth.unit_m == 1e-3
        np.testing.assert_array_equal(depth.depth, near(at))
        assert isinstance(far, DepthFrame)
        np.testing.assert_array_equal(far.depth, 10 * near(at))
        assert isinstance(color, ColorFrame)
        assert color.image[0, 0].tolist() == [at, 20, 10]
        assert isinstance(points, DepthFrame)
        expected = np.zeros((4, 6))
        expected[1, 2], expected[2, 3] = 5000, 7000
        np.testing.assert_array_equal(points.depth, expected)


def own_order(own: dict[str, Any]) -> list[str]:
    return ["ft_wrench", "joint_states", "cam_depth", "cam_far", "cam_color", "cam_points"]


def test_an_mcap_of_the_usual_writer_becomes_frames(tmp_path: Path) -> None:
    writers = pytest.importorskip("mcap_ros2.writer")
    pytest.importorskip("rosbags")
    from deformscope.recording.export.mcap import definition

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = writers.Writer(file)
        schema = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", definition("geometry_msgs/WrenchStamped"))
        for at in range(30):
            header = {"stamp": {"sec": 5, "nanosec": at * 10**7}, "frame_id": "ft"}
            wrench = {"force": dict(zip("xyz", forces(at), strict=True)), "torque": {"x": 0.0, "y": 0.0, "z": 1.0}}
            writer.write_message("/ft", schema, {"header": header, "wrench": wrench}, at, at, at)
        writer.finish()
    (tmp_path / "map.toml").write_text(inspected(path))
    assert main(["import", str(path), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]) == 0
    frames = frames_of(tmp_path / "r.rrd")["ft"]
    assert [frame.force_n.tolist() for frame in frames] == [[list(forces(at))] for at in range(30)]  # type: ignore[union-attr]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-300])
    for flags in (["--inspect"], ["--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "s.rrd")]):
        assert main(["import", str(cut), *flags]) == 2
    assert not list(tmp_path.glob("s*"))


def table(path: Path, **columns: Any) -> Path:
    pq.write_table(pa.table(columns), path)
    return path


MAP = """
[[streams]]
device = "tip"
kind = "wrench"
topics = ["t.parquet"]
columns = {"force_x_n" = "a", "force_y_n" = "b", "force_z_n" = "c"}
units = {a = "mN", b = "N", c = "kgf"}
time = "t"
time_unit = "ms"
"""
TIMES = [0.0, 10.0, 20.0, 30.0]
FORCES = {"a": [1.0, 2.0, 3.0, 4.0], "b": [1.0, 1.0, 1.0, 1.0], "c": [0.0, 0.0, 1.0, 1.0]}


def test_a_table_of_others_is_read_in_its_units(tmp_path: Path) -> None:
    for name in ("t.parquet", "t.csv"):
        source = table(tmp_path / "t.parquet", t=TIMES, **FORCES)
        if name == "t.csv":
            rows = zip(TIMES, *FORCES.values(), strict=True)
            source = tmp_path / name
            source.write_text("made by hand\nt,a,b,c\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
        text = MAP.replace("t.parquet", name)
        (tmp_path / "map.toml").write_text(f"skip_rows = 1\n{text}" if name == "t.csv" else text)
        out = tmp_path / f"{name}.rrd"
        assert main(["import", str(source), "--map", str(tmp_path / "map.toml"), "--record", str(out)]) == 0
        frames: list[Any] = frames_of(out)["tip"]
        assert [frame.stamp.host_ns for frame in frames] == [0, 10**7, 2 * 10**7, 3 * 10**7]
        np.testing.assert_allclose(frames[2].force_n, [[3e-3, 1.0, 9.80665]], rtol=1e-15)
        assert frames[0].torque_nm is None


Case = tuple[Callable[[Path], Path], Callable[[str], str], str]


def with_unit(path: Path, unit: str) -> Path:
    fields = [pa.field("t", pa.float64()), *(pa.field(name, pa.float64(), metadata={"unit": unit}) for name in FORCES)]
    pq.write_table(pa.table({"t": TIMES, **FORCES}, schema=pa.schema(fields)), path)
    return path


def usual(path: Path) -> Path:
    return table(path, t=TIMES, **FORCES)


CASES: dict[str, Case] = {
    "no unit": (usual, lambda m: m.replace('a = "mN", ', ""), 'units."a" of tip'),
    "asked": (usual, lambda m: m.replace('"mN"', '"?"'), 'units."a" of tip'),
    "not a force": (usual, lambda m: m.replace('"mN"', '"mm"'), 'units."a" of tip'),
    "another unit": (lambda p: with_unit(p, "lbf"), lambda m: m, "lbf, as the source says"),
    "no time unit": (
        lambda p: table(p, t=TIMES, **FORCES),
        lambda m: m.replace('time_unit = "ms"', ""),
        "time_unit of tip",
    ),
    "no time": (usual, lambda m: m.replace('"t"', '"u"'), "time of tip"),
    "clock": (
        lambda p: table(p, t=[0.0, 10.0, 3.0, 30.0], **FORCES),
        lambda m: m,
        "stamps of tip that only rise; got one 0.007 s before the last, in frame 2",
    ),
    "nan": (
        lambda p: table(p, t=TIMES, **(FORCES | {"b": [1.0, float("nan"), 1.0, 1.0]})),
        lambda m: m,
        "forces of tip that are numbers; got NaN in frame 1",
    ),
    "no column": (lambda p: table(p, t=TIMES, a=FORCES["a"], b=FORCES["b"]), lambda m: m, "columns.force_z_n of tip"),
    "offset": (usual, lambda m: f'{m}offset_s = "?"\n', "offset_s of tip"),
    "key": (usual, lambda m: f"{m}unit = 3\n", "unknown field `unit` - at `$.streams[0]`"),
    "topic": (usual, lambda m: m.replace("t.parquet", "s.parquet"), "got 's.parquet'"),
    "damaged": (lambda p: Path(p.write_bytes(b"PAR1 nothing") and p), lambda m: m, "a readable table"),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_wrong_is_one_line_and_leaves_nothing(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    make, change, words = CASES[name]
    source = make(tmp_path / "t.parquet")
    (tmp_path / "map.toml").write_text(change(MAP))
    assert main(["import", str(source), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]) == 2
    error = capfd.readouterr().err
    assert words in error
    assert len(error.strip().splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.toml", "t.parquet"]


def test_a_pose_and_another_clock_are_asked_for_by_name(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "other", offset_s=3600.0)
    text = inspected(bag)
    assert "stamped -3600 s before it was recorded" in text
    for done in range(2):
        (tmp_path / "map.toml").write_text(answered(text, *ANSWERS[:done]))
        assert main(["import", str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]) == 2
        assert f"expected {('parent', 'child')[done]} of joint_states in the map" in capfd.readouterr().err
    forces_alone = '[[streams]]\ndevice = "ft"\nkind = "wrench"\ntopics = ["/ft/wrench"]\n'
    depth = '[[streams]]\ndevice = "cam"\nkind = "depth"\ntopics = ["/cam/depth"]\ntime = "log"\n'
    (tmp_path / "map.toml").write_text(forces_alone + depth)
    assert main(["import", str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]) == 2
    assert (
        "expected offset_s of ft in the map: how its clock differs; got 'stamps 3600 s from those of cam'"
        in capfd.readouterr().err
    )
    (tmp_path / "map.toml").write_text(f"{forces_alone}offset_s = -3600\n{depth}")
    assert main(["import", str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")]) == 0
    (tmp_path / "map.toml").write_text(forces_alone.replace("/ft/wrench", "/chatter"))
    assert main(["import", str(bag), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "s.rrd")]) == 2
    assert "of ft in the map" in capfd.readouterr().err


MEMORY = """
import sys
from deformscope.cli import main
from tests.peak_memory import peak_mib
assert main(["import", *sys.argv[1:]]) == 0
print(peak_mib())
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_source(tmp_path: Path) -> None:
    used = []
    for count in (20_000, 800_000):
        times = np.arange(count) * 1.0
        source = table(tmp_path / "t.parquet", t=times, **dict.fromkeys("abc", np.sin(times)))
        (tmp_path / "map.toml").write_text(MAP)
        asked = [str(source), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / f"{count}.rrd")]
        done = subprocess.run([sys.executable, "-c", MEMORY, *asked], capture_output=True, text=True, check=True)
        used.append(float(done.stdout.split()[-1]))
    assert used[1] < used[0] + 100.0, used
