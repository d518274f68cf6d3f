"""Bags with what is not of ROS beside their topics, and logs of a bus that others share: unknown is not damaged."""

import random
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.cli import main
from tests.cases import each_once, slow
from tests.imports.test_files_and_folders import imported, refused
from tests.imports.test_import_mistakes import Bag
from tests.imports.test_importing import frames_of, inspected

WRENCH = "geometry_msgs/msg/WrenchStamped"
MAP = '[[streams]]\ndevice = "ft"\nkind = "wrench"\ntopics = ["/ft"]\n'
COUNT = 50
Beside = tuple[str, str, bytes, str, bytes]
"""Name, encoding and data of a schema; encoding and data of a message."""
OTHERS: dict[str, Beside] = {
    "json": ("Note", "jsonschema", b'{"type": "object"}', "json", b"{}"),
    "protobuf": ("foxglove.Pose", "protobuf", b"\n\x95\xff\xfe\x01", "protobuf", b"\x08\x96\x01"),
    "flatbuffer": ("foxglove.Log", "flatbuffer", bytes(range(128, 200)), "flatbuffer", b"\x00\xff"),
    "no schema encoding": ("", "", b"", "cbor", b"\xa0"),
    "a service": ("hand_msgs/srv/Zero_Event", "ros2msg", b"bool on\n---\nbool done\n", "cdr", b"\0\1\0\0\1"),
    "an action": ("hand_msgs/action/Grasp_Feedback", "ros2idl", b"module what {", "cdr", b"\0\1\0\0\1"),
    "a definition that lacks a type": ("a_msgs/msg/A", "ros2msg", b"b_msgs/B part\n", "cdr", b"\0\1\0\0\1"),
    "ROS 1": ("std_msgs/Header", "ros1msg", b"uint32 seq\ntime stamp\nstring frame_id\n", "ros1", bytes(16)),
}


def write_mcap(
    path: Path, profile: str = "ros2", ros: int = 2, beside: Beside | None = None, chunk: int = 1 << 20
) -> Path:
    """COUNT wrenches: forces (1, 2, 3 + at) N, torques (0.1, 0.2, 0.3) N m."""
    writers = pytest.importorskip("mcap.writer")
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    of: Any = {one.rpartition("/")[2]: kind for one, kind in store.types.items() if one != "std_msgs/msg/Time"}
    with path.open("wb") as file:
        out = writers.Writer(file, chunk_size=chunk)
        out.start(profile=profile, library="x" * 300)
        text = store.generate_msgdef(WRENCH, ros_version=ros)[0].encode()
        name = WRENCH if ros == 2 else WRENCH.replace("/msg", "")
        schema = out.register_schema(name=name, encoding=f"ros{ros}msg", data=text)
        link = out.register_channel(topic="/ft", message_encoding="cdr" if ros == 2 else "ros1", schema_id=schema)
        if beside:
            schema = out.register_schema(*beside[:3]) if beside[0] else 0
            other = out.register_channel(topic="/other", message_encoding=beside[3], schema_id=schema)
            out.add_message(other, 17 * 10**17, beside[4], 17 * 10**17)
        for at in range(COUNT):
            ns = 17 * 10**17 + at * 10**7
            stamp = of["Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = of["Header"](stamp=stamp, frame_id="ft", **({"seq": at} if ros == 1 else {}))
            force, torque = of["Vector3"](x=1.0, y=2.0, z=3.0 + at), of["Vector3"](x=0.1, y=0.2, z=0.3)
            message = of["WrenchStamped"](header=header, wrench=of["Wrench"](force=force, torque=torque))
            raw = store.serialize_ros1(message, WRENCH) if ros == 1 else store.serialize_cdr(message, WRENCH)
            out.add_message(link, ns, bytes(raw), ns)
        out.finish()
    return path


def check(source: Path, out: Path, asked: str = "") -> None:
    frames: list[Any] = frames_of(imported(source, asked or inspected(source), out))["ft"]
    np.testing.assert_array_equal([one.force_n[0] for one in frames], [[1, 2, 3 + at] for at in range(COUNT)])
    np.testing.assert_array_equal([one.torque_nm[0] for one in frames], [[0.1, 0.2, 0.3]] * COUNT)
    assert [one.stamp.host_ns - frames[0].stamp.host_ns for one in frames] == [at * 10**7 for at in range(COUNT)]


@pytest.mark.parametrize("profile", ["ros2", "", "ros1", "x-foxglove", "ros2 with more than that" * 9])
@pytest.mark.parametrize("chunk", [1 << 20, 500])
def test_an_mcap_of_any_profile_is_read(profile: str, chunk: int, tmp_path: Path) -> None:
    check(write_mcap(tmp_path / "bag.mcap", profile, chunk=chunk), tmp_path / "r.rrd")


def test_messages_of_ros_1_in_an_mcap_are_read(tmp_path: Path) -> None:
    check(write_mcap(tmp_path / "bag.mcap", "ros1", ros=1), tmp_path / "r.rrd")


@pytest.mark.parametrize(("name", "profile"), each_once([*OTHERS], ["ros2", ""]))
def test_a_topic_that_is_not_of_ros_keeps_no_other_from_being_read(
    name: str, profile: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = write_mcap(tmp_path / "bag.mcap", profile, beside=OTHERS[name])
    text = inspected(source)
    (line,) = [one for one in text.splitlines() if one.startswith("# /other: ")]
    assert ", 1 messages" in line
    if name != "ROS 1":
        assert "not read: expected messages of" in line
    assert "damaged" not in text
    check(source, tmp_path / "r.rrd", MAP)
    error = refused(source, MAP.replace("/ft", "/other"), tmp_path / "s.rrd", capfd)
    assert "damaged" not in error


def test_a_damaged_mcap_is_still_said_to_be_that(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / "bag.mcap", "", beside=OTHERS["protobuf"])
    source.write_bytes(source.read_bytes()[:-200])
    assert "truncated or damaged" in refused(source, MAP, tmp_path / "r.rrd", capfd)


@pytest.mark.parametrize("parts", [1, 3])
def test_a_folder_of_bags_without_metadata_is_read(parts: int, tmp_path: Path) -> None:
    """In their natural order; `ros2 bag` writes metadata.yaml when it ends, not when it is killed."""
    folder = tmp_path / "take"
    folder.mkdir()
    numbers = np.array_split(np.arange(30), parts)
    for part, of in enumerate(numbers):
        bag = Bag()
        for at in of:
            vectors = [bag.make("geometry_msgs/msg/Vector3", *values) for values in ((at, 0.0, 0.0), (0.0, 0.0, 0.0))]
            wrench = bag.make("geometry_msgs/msg/Wrench", *vectors)
            bag.add("/ft", "geometry_msgs/WrenchStamped", int(at + 1) * 10**7, wrench)
        written = bag.write(tmp_path / f"part{part}")
        shutil.copy(next(written.glob("*.db3")), folder / f"take_{part + 9}.db3")
    frames: list[Any] = frames_of(imported(folder, inspected(folder), tmp_path / "r.rrd"))["ft"]
    assert [one.force_n[0, 0] for one in frames] == list(range(30))


@pytest.mark.parametrize("seed", [*range(6), *(slow(seed) for seed in range(6, 60))])
def test_no_change_of_the_map_of_a_bag_gives_other_numbers_in_silence(seed: int, tmp_path: Path) -> None:
    """A unit that contradicts the message's, another kind and a missing field are refused; columns are the fields that
    the map names."""
    draw = random.Random(seed)
    source, asked = write_mcap(tmp_path / "bag.mcap"), MAP
    fields = {"x": "x", "y": "y", "z": "z"}
    kind = draw.choice(["kind", "unit", "axis", "field", "time"])
    if kind == "kind":
        asked = MAP.replace("wrench", draw.choice(["arm", "hand", "tactile", "color", "depth"]))
    elif kind == "unit":
        asked += f'units = {{"wrench.force.{draw.choice("xyz")}" = "{draw.choice(["mN", "kN", "gf", "m", "N m"])}"}}\n'
    elif kind == "field":
        asked += f'columns = {{"force_x_n" = "{draw.choice(["wrench.force", "wrench.force.w", "x", "header"])}"}}\n'
    elif kind == "time":
        asked += 'time = "log"\n'
    else:
        shuffled = draw.sample("xyz", 3)
        fields = dict(zip("xyz", shuffled, strict=True))
        columns = ", ".join(f'"force_{axis}_n" = "wrench.force.{of}"' for axis, of in fields.items())
        units = ", ".join(f'"wrench.force.{axis}" = "N"' for axis in "xyz")
        asked += f"columns = {{{columns}}}\nunits = {{{units}}}\n"
    (tmp_path / "map.toml").write_text(asked)
    status = main(["import", str(source), "--map", str(tmp_path / "map.toml"), "--record", str(tmp_path / "r.rrd")])
    assert status == (0 if kind in ("axis", "time") else 2)
    if status == 0:
        truth = {"x": 1.0, "y": 2.0}
        expected = [[truth.get(fields[axis], 3.0 + at) for axis in "xyz"] for at in range(COUNT)]
        found: list[Any] = frames_of(tmp_path / "r.rrd")["ft"]
        np.testing.assert_array_equal([one.force_n[0] for one in found], expected)


def test_a_folder_whose_metadata_lists_other_topics_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "take"
    folder.mkdir()
    write_mcap(folder / "take_0.mcap", beside=OTHERS["json"])
    topics = "".join(
        f"    - topic_metadata: {{name: {name}, type: {kind}, serialization_format: {form}, offered_qos_profiles: ''}}"
        f"\n      message_count: {count}\n"
        for name, kind, form, count in (("/ft", WRENCH, "cdr", COUNT), ("/other", "Note", "json", 1))
    )
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration: {nanoseconds: 490000000}\n"
        "  starting_time: {nanoseconds_since_epoch: 1700000000000000000}\n  message_count: 51\n"
        f"  topics_with_message_count:\n{topics}  compression_format: ''\n  compression_mode: ''\n"
        "  relative_file_paths: [take_0.mcap]\n"
    )
    check(folder, tmp_path / "r.rrd")
