"""What a map or a source gets wrong is refused by name, and never becomes another number in silence."""

import contextlib
import dataclasses
import json
import sqlite3
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from deformscope.frames import ArmFrame, DepthFrame
from deformscope.imports.readers import open_reader
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording.recorder import Recorder
from tests.cases import Capture, Patch
from tests.imports.test_files_and_folders import imported, refused
from tests.imports.test_importing import brought_back, differences, frames_of, inspected
from tests.log import synthetic_rig as rig

AXES = {"force_z_n": "Fz", "force_x_n": "Fx", "force_y_n": "Fy"}
FORCES = "t,Fx,Fy,Fz\n0,1,20,300\n0.01,2,21,301\n"


def map_of(columns: dict[str, str], more: str = "", unit: str = "N", topics: str = '["t.csv"]') -> str:
    """Of a sensor `tip`, whose table has its times in `t`."""
    named = ", ".join(f'{name} = "{field}"' for name, field in columns.items())
    units = ", ".join(f'"{field}" = "{unit}"' for field in dict.fromkeys(columns.values()))
    text = (
        f'[[streams]]\ndevice = "tip"\nkind = "wrench"\ntopics = {topics}\ncolumns = {{{named}}}\nunits = {{{units}}}\n'
    )
    return f'{text}time = "t"\ntime_unit = "s"\n{more}'


def csv(path: Path, text: str = FORCES) -> Path:
    path.write_text(text)
    return path


def test_axes_are_those_of_their_names_whatever_their_order(tmp_path: Path) -> None:
    frames: list[Any] = frames_of(imported(csv(tmp_path / "t.csv"), map_of(AXES), tmp_path / "r.rrd"))["tip"]
    assert [frame.force_n.tolist() for frame in frames] == [[[1, 20, 300]], [[2, 21, 301]]]
    many = {f"force_{at}_{axis}_n": f"{axis}{at}" for at in (10, 9, 2, 1, 0, 3, 8, 4, 7, 5, 6) for axis in "zyx"}
    place = {name: 100 * int(name[1:]) + "xyz".index(name[0]) for name in many.values()}
    text = f"t,{','.join(place)}\n0,{','.join(map(str, place.values()))}\n"
    (frame,) = frames_of(imported(csv(tmp_path / "t.csv", text), map_of(many), tmp_path / "s.rrd"))["tip"]
    assert frame.force_n.tolist() == [[100 * at, 100 * at + 1, 100 * at + 2] for at in range(11)]  # type: ignore[union-attr]


BAD_COLUMNS = {
    "a letter": (
        AXES | {"torqe_x_nm": "Fx"},
        "columns.torqe_x_nm of tip in the map: of a wrench frame: counts, force_n",
    ),
    "a time": (AXES | {"time_s": "t"}, "columns.time_s of tip"),
    "an axis": ({"force_x_n": "Fx", "force_z_n": "Fz"}, "got 'force_x_n, force_z_n'"),
    "a channel": ({f"force_{at}_{axis}_n": "Fx" for at in (0, 2) for axis in "xyz"}, "columns of force_n of tip"),
}


@pytest.mark.parametrize("name", BAD_COLUMNS)
def test_columns_that_no_frame_has_are_refused(name: str, tmp_path: Path, capfd: Capture) -> None:
    columns, words = BAD_COLUMNS[name]
    assert words in refused(csv(tmp_path / "t.csv"), map_of(columns), tmp_path / "r.rrd", capfd)


@pytest.mark.parametrize("cell", ['"1,5"', '"[1, 2"', "1.5 N"])
def test_a_cell_that_is_no_number_is_one_line(cell: str, tmp_path: Path, capfd: Capture) -> None:
    source = csv(tmp_path / "t.csv", f"{FORCES}0.02,{cell},1,1\n")
    error = refused(source, map_of(AXES, unit="mN"), tmp_path / "r.rrd", capfd)
    assert "a wrench frame of tip; got in frame 2" in error


BAD_VALUES = {
    "no number of a rate": ("rate_hz = nan", "Expected `float` >= 0.0"),
    "an endless rate": ("rate_hz = inf", "Expected `float` <= 1000000000.0"),
    "a rate below 0": ("rate_hz = -1", "Expected `float` >= 0.0"),
    "an offset": ("offset_s = 1e300", "Expected `float` <= 10000000000.0"),
    "a table in place of a list": ("[streams]\ndevice = 'a'", "Expected `array`, got `object` - at `$.streams`"),
    "a number in place of a list": ("streams = 3", "Expected `array`, got `int` - at `$.streams`"),
    "a beginning": ("start_ns = 4611686018427387905", "Expected `int` <= 4611686018427387904"),
    "a time": ("", "expected times of tip below 4611686018427387904 ns; got inf"),
}


@pytest.mark.parametrize("name", BAD_VALUES)
def test_values_that_none_can_mean_are_one_line(name: str, tmp_path: Path, capfd: Capture) -> None:
    line, words = BAD_VALUES[name]
    text = line if "streams" in line else f"{line}\n{map_of(AXES)}" if "start" in line else map_of(AXES, line)
    rows = f"{FORCES}{'' if line else '1e300,1,1,1'}"
    assert words in refused(csv(tmp_path / "t.csv", rows), text, tmp_path / "r.rrd", capfd)


@pytest.mark.parametrize("key", ["urdf", "gripper"])
def test_a_map_names_no_file_of_this_machine(key: str, tmp_path: Path, capfd: Capture) -> None:
    """It may be another's; where the file is a URDF, nothing reads it either."""
    (tmp_path / "own.urdf").write_text("<robot name='x'><link name='a'/></robot>")
    for name in ("/etc/passwd", str(tmp_path / "own.urdf"), "file:///etc/passwd"):
        text = f"{map_of(AXES)}[shape]\n{key} = '{name}'\n"
        error = refused(csv(tmp_path / "t.csv"), text, tmp_path / "r.rrd", capfd)
        assert f"expected [shape] in the map without {key}; got '{name}' | try: the map without it" in error


@pytest.mark.parametrize("timed", [True, False])
def test_a_frame_of_two_long_tables(timed: bool, tmp_path: Path) -> None:
    source = tmp_path / "two"
    source.mkdir()
    for name, axes in (("f", "Fx,Fy,Fz"), ("m", "Tx,Ty,Tz")):
        csv(source / f"{name}.csv", f"t,{axes}\n" + "".join(f"{at / 100},{at},1,2\n" for at in range(200)))
    text = map_of(AXES, topics='["f.csv", "m.csv"]')
    torques = ", ".join(f'torque_{axis}_nm = "T{axis}"' for axis in "xyz")
    text = text.replace("columns = {", f"columns = {{{torques}, ")
    text = text.replace("units = {", 'units = {Tx = "N m", Ty = "N m", Tz = "N m", ')
    text = text if timed else text.replace('time = "t"\ntime_unit = "s"', "rate_hz = 100")
    frames: list[Any] = frames_of(imported(source, text, tmp_path / "r.rrd"))["tip"]
    assert [frame.stamp.host_ns for frame in frames] == [at * 10**7 for at in range(200)]
    assert [(frame.force_n[0, 0], frame.torque_nm[0, 0]) for frame in frames] == [(at, at) for at in range(200)]


def test_a_clock_that_jumps_forward_is_told(tmp_path: Path, capfd: Capture) -> None:
    for jump, told in ((0, False), (3600, True)):
        rows = "".join(f"{at / 100 + (jump if at > 50 else 0)},1,1,1\n" for at in range(200))
        imported(csv(tmp_path / "t.csv", f"t,Fx,Fy,Fz\n{rows}"), map_of(AXES), tmp_path / f"{jump}.rrd")
        assert ("longest gap 3600 s" in "".join(capfd.readouterr())) == told


def test_counts_of_any_width_are_distances_and_colours_are_none(tmp_path: Path, capfd: Capture) -> None:
    source = tmp_path / "take"
    for kind, image in (("narrow", np.uint8([[50, 200]])), ("wide", np.uint16([[500, 2000]])), ("color", None)):
        (source / kind).mkdir(parents=True)
        cv2.imwrite(str(source / kind / "1.png"), np.full((2, 3, 3), 50, np.uint8) if image is None else image)
    kinds = {one.split('"')[1]: one.split('"')[3] for one in inspected(source).split("[[streams]]")[1:]}
    assert kinds == {"narrow": "color", "wide": "depth", "color": "color"}

    def asked(name: str) -> str:
        return f'[[streams]]\ndevice = "cam"\nkind = "depth"\ntopics = ["{name}/*.png"]\nrate_hz = 10\nunit_m = 0.001\n'

    for name, expected in (("narrow", [[50, 200]]), ("wide", [[500, 2000]])):
        (frame,) = frames_of(imported(source, asked(name), tmp_path / f"{name}.rrd"))["cam"]
        assert isinstance(frame, DepthFrame)
        assert (frame.unit_m, frame.depth.tolist()) == (1e-3, expected)
    error = refused(source, asked("color"), tmp_path / "r.rrd", capfd)
    assert "expected distances of cam of one channel; got an image of shape (2, 3, 3)" in error


class Bag:
    """Messages of ROS 2 for a bag. Times in ns"""

    def __init__(self) -> None:
        pytest.importorskip("rosbags")
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.messages: list[tuple[str, str, int, Any]] = []

    def make(self, name: str, *values: Any) -> Any:
        return self.store.types[name](*values)

    def header(self, ns: int, frame: str = "base") -> Any:
        return self.make("std_msgs/msg/Header", self.make("builtin_interfaces/msg/Time", *divmod(ns, 10**9)), frame)

    def add(self, topic: str, kind: str, ns: int, *values: Any) -> None:
        kind = kind.replace("/", "/msg/")
        self.messages.append((topic, kind, ns, self.make(kind, self.header(ns), *values)))

    def add_joints(self, ns: int, names: list[str], angles: list[float], effort: list[float] | None = None) -> None:
        values = np.array(angles), np.array([]), np.array(effort or [])
        self.add("/js", "sensor_msgs/JointState", ns, names, *values)

    def pose(self, at: tuple[float, float, float] = (1.0, 2.0, 3.0), turn: Any = (0.0, 0.0, 0.0, 1.0)) -> Any:
        point, quaternion = self.make("geometry_msgs/msg/Point", *at), self.make("geometry_msgs/msg/Quaternion", *turn)
        return self.make("geometry_msgs/msg/Pose", point, quaternion)

    def add_pose(self, ns: int, **where: Any) -> None:
        self.add("/pose", "geometry_msgs/PoseStamped", ns, self.pose(**where))

    def write(self, path: Path) -> Path:
        from rosbags.rosbag2 import StoragePlugin, Writer

        with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
            kinds = {topic: kind for topic, kind, _, _ in self.messages}
            topics = {topic: bag.add_connection(topic, kind, typestore=self.store) for topic, kind in kinds.items()}
            for topic, kind, ns, message in self.messages:
                bag.write(topics[topic], ns, self.store.serialize_cdr(message, kind))
        return path


ARM = '[[streams]]\ndevice = "arm"\nkind = "arm"\ntopics = ["/js"]\npose = "/pose"\n'
MS = 10**6
NAMES = ["base", "elbow"]
TRANSFORMS = "tf2_msgs/msg/TFMessage"


def test_joints_are_those_of_their_names(tmp_path: Path, capfd: Capture) -> None:
    bag = Bag()
    for at in range(1, 5):
        bag.add_pose(at * MS)
        bag.add_joints(at * MS + 1, NAMES[:: 1 if at % 2 else -1], [at / 10, 2.0][:: 1 if at % 2 else -1])
    turned = bag.write(tmp_path / "turned")
    text = inspected(turned)
    assert 'joints = ["base", "elbow"]' in text
    for at, asked in enumerate((text, ARM)):
        frames: list[Any] = frames_of(imported(turned, asked, tmp_path / f"{at}.rrd"))["js" if asked == text else "arm"]
        np.testing.assert_allclose(
            [frame.joint_deg for frame in frames], np.rad2deg([[0.1 * at, 2.0] for at in range(1, 5)])
        )
        assert isinstance(frames[0], ArmFrame)
    bag.add_joints(6 * MS, ["finger"], [0.5])
    error = refused(bag.write(tmp_path / "hand"), ARM, tmp_path / "r.rrd", capfd)
    assert "joints of arm in the map: names of the arm's, in their order; got 'base, elbow, then finger'" in error
    short = Bag()
    short.add_pose(MS)
    short.add_joints(MS, ["a", "b", "c"], [1.0, 2.0, 3.0], [1.0, 2.0])
    error = refused(short.write(tmp_path / "short"), f'{ARM}joints = ["c", "a", "b"]\n', tmp_path / "r.rrd", capfd)
    assert "arm frame of arm; got in frame 0: index 2 is out of bounds" in error


def test_times_of_pandas_are_taken_to_the_nanosecond(tmp_path: Path) -> None:
    ns = [1700000000123456789, 1700000000133456789]
    kinds = {"plain": pa.timestamp("ns"), "zone": pa.timestamp("ns", "Europe/Berlin"), "us": pa.timestamp("us")}
    for name, kind in kinds.items():
        times = pa.array(ns, pa.timestamp("ns")).cast(kind, safe=False)
        rows = {
            "t": times,
            "taken": pa.array(ns, pa.duration("ns")),
            "Fx": [1.0, 2.0],
            "Fy": [1.0, 2.0],
            "Fz": [1.0, 2.0],
        }
        pq.write_table(pa.table(rows), tmp_path / "t.parquet")
        assert 'time = "t"\ntime_unit = "ns"' in inspected(tmp_path / "t.parquet")
        text = map_of(AXES, topics='["t.parquet"]')
        frames = frames_of(imported(tmp_path / "t.parquet", text, tmp_path / f"{name}.rrd"))["tip"]
        assert [one.stamp.host_ns for one in frames] == [one if name != "us" else one // 1000 * 1000 for one in ns]


@pytest.mark.slow
def test_fractions_far_below_whole_numbers_are_read(tmp_path: Path, monkeypatch: Patch) -> None:
    whole = "".join(f"{at},0,0,\n" for at in range(400_000))
    source = csv(tmp_path / "t.csv", f"t,Fx,Fy,Fz\n{whole}400000,0.5,0,0.25\n")
    assert source.stat().st_size > 1 << 22
    with open_reader(source, times=["t"]) as reader:
        *_, last = reader.messages(["t.csv"])
    assert last.value == {"t": 400_000, "Fx": 0.5, "Fy": 0.0, "Fz": 0.25}
    assert isinstance(last.value["t"], int)  # of nanoseconds since 1970 a real number would lose some
    folder = tmp_path / "ours"
    folder.mkdir()
    source.rename(folder / "t.csv")
    names = {"t": "int64", "Fx": "double", "Fy": "double", "Fz": "double"}
    columns = [{"name": name, "type": kind, "unit": ""} for name, kind in names.items()]
    about = {"schema_version": 1, "streams": [{"files": ["t.csv"], "columns": columns}]}
    (folder / "export.json").write_text(json.dumps(about))
    with open_reader(folder) as reader:
        *_, last = reader.messages(["t.csv"])
    assert last.value == {"t": 400_000, "Fx": 0.5, "Fy": 0.0, "Fz": 0.25}


@pytest.mark.parametrize("content", ["{", "[]", '{"streams": [{}]}', "\xff"])
def test_a_manifest_of_others_is_none(content: str, tmp_path: Path) -> None:
    (tmp_path / "export.json").write_bytes(content.encode("latin-1"))
    csv(tmp_path / "t.csv")
    assert 'topics = ["t.csv"]' in inspected(tmp_path)


def test_names_of_columns_write_nothing_into_the_map(tmp_path: Path) -> None:
    text = inspected(
        csv(tmp_path / "t\x7f\u202e.csv", '"a\n[[streams]]\ndevice = ""evil""\n","\x1b[31mred",t\n1,2,3\n')
    )
    assert [one["device"] for one in tomllib.loads(text)["streams"]] == ["t\x7f\u202e"]
    assert all(one.isprintable() for one in text.replace("\n", ""))
    assert "columns a\\n[[streams]]" in text


def test_forces_that_are_not_known_come_back(tmp_path: Path) -> None:
    """Of a sensor without a sensitivity."""
    path = tmp_path / "r.rrd"
    frames = [dataclasses.replace(rig.wrench(at, "tip"), force_n=np.full((1, 3), np.nan)) for at in range(5)]
    with Recorder(path, "none", {"rig": ""}, application=RIG) as made:
        made.start(RigLayout((rig.frames.Stream("tip", "wrench", "optoforce"),)), rig.START_NS)
        made.write(frames)
    for to in ("csv", "parquet"):
        assert not differences(list(frames), frames_of(brought_back(path, to, tmp_path))["tip"])


def test_a_topic_of_an_unknown_type_keeps_no_other_from_being_read(tmp_path: Path, capfd: Capture) -> None:
    bag = Bag()
    for at in range(1, 4):
        bag.add_pose(at * MS)
        bag.messages.append(("/thing", "std_msgs/msg/String", at * MS, bag.make("std_msgs/msg/String", "x")))
    path = bag.write(tmp_path / "bag")
    (database,) = path.glob("*.db3")
    with contextlib.closing(sqlite3.connect(database)) as old:  # of before ROS 2 Iron: without definitions
        old.execute("update topics set type = 'my_msgs/msg/Thing' where name = '/thing'")
        old.execute("delete from message_definitions")
        old.commit()
    about = path / "metadata.yaml"
    about.write_text(about.read_text().replace("std_msgs/msg/String", "my_msgs/msg/Thing"))
    text = inspected(path)
    assert "# /thing: my_msgs/msg/Thing, 3 messages" in text
    assert "expected messages of a known type; got my_msgs/msg/Thing" in text
    assert len(frames_of(imported(path, text, tmp_path / "r.rrd"))["pose"]) == 3
    text = '[[streams]]\ndevice = "tip"\nkind = "wrench"\ntopics = ["/thing"]\n'
    error = refused(path, text, tmp_path / "s.rrd", capfd)
    assert "expected messages of a known type; got my_msgs/msg/Thing | try: leave its topic out of the map" in error


def test_an_arm_does_not_stand_where_a_pose_of_before_was(tmp_path: Path, capfd: Capture) -> None:
    bag = Bag()
    for at in range(1, 101):
        if at <= 10:
            bag.add_pose(at * 10**8, at=(float(at), 0.0, 0.0))
        bag.add_joints(at * 10**8, ["turn"], [float(at)])
    path = bag.write(tmp_path / "bag")
    frames: list[Any] = frames_of(imported(path, ARM, tmp_path / "r.rrd", status=3))["arm"]
    assert "arm: 85 readings lost" in capfd.readouterr().err  # half a second after the last pose
    assert [frame.position_m[0] for frame in frames] == [*range(1, 11), *[10] * 5]
    assert len(frames_of(imported(path, f"{ARM}pose_age_s = 100\n", tmp_path / "s.rrd"))["arm"]) == 100


@pytest.mark.parametrize("fixed", [True, False])
def test_links_that_do_not_move_are_of_any_age(fixed: bool, tmp_path: Path) -> None:
    bag = Bag()

    def link(topic: str, ns: int, parent: str, child: str, x: float) -> None:
        place, turn = bag.make("geometry_msgs/msg/Vector3", x, 0.0, 0.0), bag.pose().orientation
        transform = bag.make("geometry_msgs/msg/Transform", place, turn)
        one = bag.make("geometry_msgs/msg/TransformStamped", bag.header(ns, parent), child, transform)
        bag.messages.append((topic, TRANSFORMS, ns, bag.make(TRANSFORMS, [one])))

    link("/tf_static" if fixed else "/tf", MS, "base", "shoulder", 5.0)
    for at in range(1, 21):
        link("/tf", at * 10**8, "shoulder", "tool", at / 10)
        bag.add_joints(at * 10**8, ["turn"], [float(at)])
    text = f'{ARM.replace("/pose", "/tf")}parent = "base"\nchild = "tool"\n'
    path = imported(bag.write(tmp_path / "bag"), text, tmp_path / "r.rrd", status=0 if fixed else 3)
    frames: list[Any] = frames_of(path)["arm"]
    np.testing.assert_allclose([frame.position_m[0] for frame in frames], 5 + np.arange(1, 21 if fixed else 6) / 10)


def test_poses_of_other_messages_and_what_is_none(tmp_path: Path, capfd: Capture) -> None:
    covariance = np.zeros(36)
    kinds: dict[str, Any] = {
        "geometry_msgs/PoseWithCovarianceStamped": lambda bag: [
            bag.make("geometry_msgs/msg/PoseWithCovariance", bag.pose(), covariance)
        ],
        "nav_msgs/Odometry": lambda bag: [
            "tool",
            bag.make("geometry_msgs/msg/PoseWithCovariance", bag.pose(), covariance),
            bag.make("geometry_msgs/msg/TwistWithCovariance", twist(bag), covariance),
        ],
        "geometry_msgs/TwistStamped": lambda bag: [twist(bag)],
        "geometry_msgs/PoseStamped": lambda bag: [bag.pose(turn=(0.0, 0.0, 0.0, 0.0))],
    }
    words = {"geometry_msgs/TwistStamped": "TwistStamped: ", "geometry_msgs/PoseStamped": "PoseStamped: "}
    for at, (kind, make) in enumerate(kinds.items()):
        bag = Bag()
        bag.add("/pose", kind, MS, *make(bag))
        bag.add_joints(MS, ["turn"], [0.5])
        path = bag.write(tmp_path / str(at))
        if kind in words:
            error = refused(path, ARM, tmp_path / "r.rrd", capfd)
            assert "pose of arm in the map: a topic of poses or transforms" in error
            assert words[kind] in error
            continue
        (frame,) = frames_of(imported(path, ARM, tmp_path / f"{at}.rrd"))["arm"]
        assert frame.position_m.tolist() == [1, 2, 3]  # type: ignore[union-attr]


def twist(bag: Bag) -> Any:
    vector = bag.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    return bag.make("geometry_msgs/msg/Twist", vector, vector)


def test_pictures_of_two_folders_are_one_by_one(tmp_path: Path, capfd: Capture) -> None:
    source = tmp_path / "take"
    for name, kind, suffix in (("depth", np.uint16, "png"), ("rgb", np.uint8, "jpg")):
        (source / name).mkdir(parents=True)
        for at in range(70 if name == "depth" else 69):
            shape = (8, 8) if name == "depth" else (8, 8, 3)
            cv2.imwrite(str(source / name / f"{at}.{suffix}"), np.full(shape, 1 + at, kind))
    text = '[[streams]]\ndevice = "cam"\nkind = "depth"\ntopics = ["depth/*.png", "rgb/*.jpg"]\nrate_hz = 10\n'
    text += "unit_m = 0.001\n"
    frames: list[Any] = frames_of(imported(source, text, tmp_path / "r.rrd", status=3))["cam"]
    assert "cam: 1 readings lost" in capfd.readouterr().err  # the last has no colours
    assert [frame.depth[0, 0] for frame in frames] == [*range(1, 70)]
    np.testing.assert_allclose([frame.color.mean() for frame in frames], range(1, 70), atol=1.5)
