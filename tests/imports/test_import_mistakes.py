"""What a map or a source gets wrong is refused by name, and never becomes another number in silence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.frames import ArmFrame, DepthFrame
from tests.imports.test_captures_and_files import imported, refused
from tests.imports.test_importing import frames_of, inspected

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
def test_columns_that_no_frame_has_are_refused(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    columns, words = BAD_COLUMNS[name]
    assert words in refused(csv(tmp_path / "t.csv"), map_of(columns), tmp_path / "r.rrd", capfd)


@pytest.mark.parametrize("cell", ['"1,5"', '"[1, 2"', "1.5 N"])
def test_a_cell_that_is_no_number_is_one_line(cell: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = csv(tmp_path / "t.csv", f"{FORCES}0.02,{cell},1,1\n")
    error = refused(source, map_of(AXES, unit="mN"), tmp_path / "r.rrd", capfd)
    assert "a wrench frame of tip; got in frame 2" in error


def test_counts_of_any_width_are_distances_and_colours_are_none(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
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


def test_joints_are_those_of_their_names(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
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
