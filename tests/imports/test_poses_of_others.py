"""Poses of an arm's end: trees of transforms of any type, late or in parts, and rotations of tables in every form."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz
from tests.cases import each_once
from tests.imports.test_files_and_folders import imported, refused
from tests.imports.test_import_mistakes import MS, TRANSFORMS, Bag
from tests.imports.test_importing import frames_of, inspected

JOINTS = ["one", "two"]
TREE_TYPES = (TRANSFORMS, "tf/msg/tfMessage", "lab_msgs/msg/Links")


class Tree(Bag):
    """A bag with transforms in messages of a type that is named by its content alone."""

    def __init__(self, kind: str = TRANSFORMS) -> None:
        from rosbags.typesys import get_types_from_msg

        super().__init__()
        self.kind = kind
        if kind not in self.store.types:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))

    def link(
        self, ns: int, parent: str, child: str, place: Any, turn: Any = (0, 0, 0, 1), topic: str = "/tf", at: int = 0
    ) -> None:
        vector = self.make("geometry_msgs/msg/Vector3", *map(float, place))
        transform = self.make(
            "geometry_msgs/msg/Transform", vector, self.make("geometry_msgs/msg/Quaternion", *map(float, turn))
        )
        one = self.make("geometry_msgs/msg/TransformStamped", self.header(ns, parent), child, transform)
        self.messages.append((topic, self.kind, at or ns, self.make(self.kind, [one])))

    def write(self, path: Path) -> Path:
        return super().write(path)


def arm_map(parent: str = "base", child: str = "tool", pose: str = "/tf", more: str = "") -> str:
    frames = f'parent = "{parent}"\nchild = "{child}"\n' if parent else ""
    joints = 'joints = ["one", "two"]\n'
    return f'[[streams]]\ndevice = "arm"\nkind = "arm"\ntopics = ["/js"]\npose = "{pose}"\n{frames}{joints}{more}'


def arms(path: Path) -> list[Any]:
    return frames_of(path)["arm"]


def places(path: Path) -> Any:
    return np.array([one.position_m for one in arms(path)])


@pytest.mark.parametrize("kind", TREE_TYPES)
def test_transforms_are_known_by_their_content(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = Tree(kind)
    for at in range(1, 21):
        bag.link(at * 10 * MS, "base", "tool", (0.5, 0.0, 0.4 - at / 1000))
        bag.add_joints(at * 10 * MS, JOINTS, [0.1, 0.2])
    source = bag.write(tmp_path / "bag")
    text = inspected(source)
    assert 'pose = "/tf"\nparent = "?"\nchild = "?"' in text
    assert "frames base, tool" in text
    error = refused(source, arm_map(parent=""), tmp_path / "r.rrd", capfd)
    assert "expected parent of arm in the map: a frame of the transforms: the arm's base; /tf has base, tool" in error
    assert 'try: parent = "FRAME" in the map' in error
    found = places(imported(source, arm_map(), tmp_path / "r.rrd"))
    np.testing.assert_allclose(found, [[0.5, 0.0, 0.4 - at / 1000] for at in range(1, 21)], atol=1e-15)


def test_frames_that_no_chain_joins_are_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = Tree()
    for at in range(1, 6):
        for parent, child in (("base", "tool"), ("map", "odom"), ("odom", "camera")):
            bag.link(at * 10 * MS, parent, child, (0.1, 0.2, at / 100))
        bag.add_joints(at * 10 * MS, JOINTS, [0.1, 0.2])
    source = bag.write(tmp_path / "bag")
    for parent, child in (("map", "tool"), ("tool", "base"), ("base", "hand"), ("base", "base")):
        error = refused(source, arm_map(parent, child), tmp_path / "r.rrd", capfd)
        assert f"lead from {child} up to {parent}; got 'tool in base, odom in map, camera in odom'" in error
    found = places(imported(source, arm_map("map", "camera"), tmp_path / "r.rrd"))
    np.testing.assert_allclose(found, [[0.2, 0.4, at / 50] for at in range(1, 6)], atol=1e-15)


def test_two_frames_of_one_room_are_joined_by_it(tmp_path: Path) -> None:
    """As of motion capture: the arm's base and its end, each in the room."""
    bag, turn = Tree(), Rotation.from_euler("z", 90, degrees=True)
    for at in range(1, 6):
        bag.link(at * 10 * MS, "room", "base", (1.0, 2.0, 0.0), turn.as_quat())
        bag.link(at * 10 * MS, "room", "tool", (1.0, 2.5, at / 10))
        bag.add_joints(at * 10 * MS, JOINTS, [0.1, 0.2])
    frames = arms(imported(bag.write(tmp_path / "bag"), arm_map(), tmp_path / "r.rrd"))
    np.testing.assert_allclose(
        [one.position_m for one in frames], [[0.5, 0.0, at / 10] for at in range(1, 6)], atol=1e-12
    )
    np.testing.assert_allclose(rotation_from_euler_xyz(*frames[0].rotation_rad), turn.inv().as_matrix(), atol=1e-12)


@pytest.mark.parametrize("topics", [("/tf", "/tf_static"), ("/left/tf", "/left/tf_static"), ("/left/tf", "/tf_static")])
def test_static_transforms_are_of_any_time_wherever_they_were_recorded(
    topics: tuple[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Late, in the middle; with a gripper's joints on the arm's topic, which are not lost readings of the arm."""
    bag = Tree()
    for at in range(1, 101):
        ns = at * 10 * MS
        bag.add_joints(ns, [JOINTS[1], JOINTS[0]], [0.2, 0.1])
        bag.link(ns, "base", "flange", (0.5, 0.0, 0.4 - at / 1000), topic=topics[0])
        if at % 3 == 0:
            bag.add_joints(ns + MS, ["finger"], [0.02])
        if at == 50:
            bag.link(ns, "flange", "tool", (0.0, 0.0, 0.1), topic=topics[1])
    frames = arms(imported(bag.write(tmp_path / "bag"), arm_map(pose=topics[0]), tmp_path / "r.rrd"))
    assert "arm        100 frames (arm), 33 messages of others left out" in capfd.readouterr().out
    expected = [[0.5, 0.0, 0.5 - at / 1000] for at in range(1, 101)]
    np.testing.assert_allclose([one.position_m for one in frames], expected, atol=1e-12)
    np.testing.assert_allclose(frames[0].joint_deg, np.rad2deg([0.1, 0.2]))


def test_states_of_some_of_the_joints_are_losses_and_of_none_are_named(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = Tree()
    for at in range(1, 5):
        bag.link(at * 10 * MS, "base", "tool", (0.5, 0.0, 0.4))
        bag.add_joints(at * 10 * MS, JOINTS[: 1 + at % 2], [0.1, 0.2][: 1 + at % 2])
    source = bag.write(tmp_path / "bag")
    imported(source, arm_map(), tmp_path / "r.rrd", status=3)
    assert "arm: 2 readings lost" in capfd.readouterr().err
    other = arm_map().replace('["one", "two"]', '["a"]')
    assert (
        "expected a source with frames for the map's streams; got none | try: its topics, pose and joints"
        in refused(source, other, tmp_path / "s.rrd", capfd)
    )


def test_a_link_that_is_repeated_rarely_and_does_not_move_is_of_any_time(tmp_path: Path) -> None:
    """As of older publishers of static transforms: once a second, on /tf itself."""
    bag = Tree()
    for at in range(1, 201):
        bag.link(at * 10 * MS, "base", "flange", (0.5, 0.0, 0.4 - at / 1000))
        if at % 100 == 1:
            bag.link(at * 10 * MS, "flange", "tool", (0.0, 0.0, 0.1))
        bag.add_joints(at * 10 * MS, JOINTS, [0.1, 0.2])
    bag.link(2010 * MS, "flange", "tool", (0.0, 0.0, 0.1))
    found = places(imported(bag.write(tmp_path / "bag"), arm_map(), tmp_path / "r.rrd"))
    np.testing.assert_allclose(found[:, 2], [0.5 - at / 1000 for at in range(1, 201)], atol=1e-12)


def test_a_state_between_two_poses_is_between_them(tmp_path: Path) -> None:
    """Poses at 10 Hz, 30 degrees apart, states at 100 Hz that come before them."""
    bag, turn = Tree(), Rotation.from_euler("x", 30, degrees=True)
    for at in range(1, 61):
        bag.add_joints(at * 10 * MS, JOINTS, [0.1, 0.2])
        if at % 10 == 0:
            quaternion = Rotation.from_euler("x", 3 * at, degrees=True).as_quat()
            bag.link(at * 10 * MS, "base", "tool", (0.0, 0.0, at / 100), quaternion, at=at * 10 * MS + 5 * MS)
    frames = arms(imported(bag.write(tmp_path / "bag"), arm_map(), tmp_path / "r.rrd"))
    assert len(frames) == 60
    expected = np.maximum(np.arange(1, 61), 10)
    np.testing.assert_allclose([one.position_m[2] for one in frames], expected / 100, atol=1e-12)
    for at in (25, 30, 59):
        found = rotation_from_euler_xyz(*frames[at - 1].rotation_rad)
        np.testing.assert_allclose(found, Rotation.from_euler("x", 3 * at, degrees=True).as_matrix(), atol=1e-9)
    assert turn.magnitude() > 0.5


@pytest.mark.parametrize("name", ["geometry_msgs/TransformStamped", "nav_msgs/Odometry", "geometry_msgs/PoseStamped"])
def test_messages_of_a_pose_are_states_of_an_arm(name: str, tmp_path: Path) -> None:
    bag, turn = Bag(), Rotation.from_euler("zyx", [40, 30, 20], degrees=True)
    pose = bag.pose(turn=turn.as_quat())
    for at in range(1, 4):
        if name.startswith("nav"):
            covariance = bag.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
            zero = bag.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
            twist = bag.make("geometry_msgs/msg/Twist", zero, zero)
            rest: list[Any] = [
                "tool",
                covariance,
                bag.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
            ]
        elif name.endswith("TransformStamped"):
            vector = bag.make("geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0)
            rest = ["tool", bag.make("geometry_msgs/msg/Transform", vector, pose.orientation)]
        else:
            rest = [pose]
        bag.add("/arm", name, at * MS, *rest)
    source = bag.write(tmp_path / "bag")
    (frame, *_) = arms(imported(source, inspected(source), tmp_path / "r.rrd"))
    assert frame.position_m.tolist() == [1, 2, 3]
    np.testing.assert_allclose(rotation_from_euler_xyz(*frame.rotation_rad), turn.as_matrix(), atol=1e-12)


def test_a_quaternion_that_is_no_rotation_is_refused_where_it_is_used(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for name, child in (("used", "tool"), ("other", "lamp")):
        bag = Tree()
        for at in range(1, 4):
            bag.link(at * 10 * MS, "base", "tool", (0.0, 0.0, 0.1))
            bag.link(at * 10 * MS + 1, "base", child, (0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 0.5))
            bag.add_joints(at * 10 * MS + 1, JOINTS, [0.1, 0.2])
        source = bag.write(tmp_path / name)
        if name == "other":
            assert len(arms(imported(source, arm_map(), tmp_path / "r.rrd"))) == 3
        else:
            error = refused(source, arm_map(), tmp_path / "r.rrd", capfd)
            assert "a quaternion of length 0.5, where a rotation has 1" in error


TURN = Rotation.from_euler("ZYX", [50, -20, 35], degrees=True)
FORMS: dict[str, tuple[str, Any]] = {
    "vector": ("rad", TURN.as_rotvec()),
    "vector in degrees": ("deg", TURN.as_rotvec(degrees=True)),
    **{
        f"{order} in {unit}": (unit, TURN.as_euler(order, degrees=unit == "deg"))
        for order, unit in itertools.product(("xyz", "XYZ", "ZYX", "zyx", "ZYZ"), ("deg", "rad"))
    },
    "xyzw": ("", TURN.as_quat()),
    "wxyz": ("", TURN.as_quat(scalar_first=True)),
}


def pose_table(folder: Path, names: list[str], numbers: Any, unit: str) -> Path:
    path = folder / "t.csv"
    rows = [[at / 100, 0.5, 0.0, 0.4 - at / 100, *numbers] for at in range(3)]
    path.write_text("\n".join([",".join(["t", "px", "py", "pz", *names]), *(",".join(map(str, one)) for one in rows)]))
    return path


def pose_map(columns: dict[str, str], unit: str, more: str = "") -> str:
    columns = {f"position_{axis}_m": f"p{axis}" for axis in "xyz"} | columns
    units = {f"p{axis}": "m" for axis in "xyz"} | dict.fromkeys(
        [one for one in columns.values() if one[0] != "p"], unit
    )
    named, said = (
        ", ".join(f'"{one}" = "{other}"' for one, other in each.items() if other) for each in (columns, units)
    )
    table = f'topics = ["t.csv"]\ncolumns = {{{named}}}\nunits = {{{said}}}\ntime = "t"\ntime_unit = "s"\n'
    return f'[[streams]]\ndevice = "arm"\nkind = "arm"\n{table}{more}'


@pytest.mark.parametrize(("form", "by_axis"), each_once([*FORMS], [False, True]))
def test_a_rotation_of_a_table_is_asked_for_and_read(
    form: str, by_axis: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (unit, numbers), rotation = FORMS[form], form.partition(" ")[0]
    names = [f"c{at}" for at in range(len(numbers))]
    keys = [f"q_{at}" for at in range(4)] if len(numbers) == 4 else [f"rotation_{at}_rad" for at in range(3)]
    if by_axis and len(numbers) == 3 and rotation != "ZYZ":
        order = rotation.lower() if rotation != "vector" else "xyz"
        keys = [f"rotation_{axis}_rad" for axis in order]
    source, columns = pose_table(tmp_path, names, numbers, unit), dict(zip(keys, names, strict=True))
    error = refused(source, pose_map(columns, unit), tmp_path / "r.rrd", capfd)
    assert "expected rotation of arm in the map:" in error
    assert ("xyzw" if len(numbers) == 4 else "vector (axis times angle)") in error
    wrong = "vector" if len(numbers) == 4 else "xyzw"
    assert f"got '{wrong}'" in refused(
        source, pose_map(columns, unit, f'rotation = "{wrong}"\n'), tmp_path / "r.rrd", capfd
    )
    frames = arms(imported(source, pose_map(columns, unit, f'rotation = "{rotation}"\n'), tmp_path / "r.rrd"))
    assert frames[2].position_m.tolist() == [0.5, 0.0, 0.38]
    np.testing.assert_allclose(rotation_from_euler_xyz(*frames[2].rotation_rad), TURN.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("spelling", ["actual_TCP_pose_{}", "target_TCP_pose_{}", "actual_TCP_pose[{}]"])
def test_a_rotation_vector_of_a_vendor_is_recognised(
    spelling: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    names = [spelling.format(at) for at in range(6)]
    rows = [[at / 100, 0.5, 0.0, 0.4, *TURN.as_rotvec()] for at in range(3)]
    source = tmp_path / "t.csv"
    source.write_text("\n".join([",".join(["timestamp", *names]), *(",".join(map(str, one)) for one in rows)]))
    keys = [*(f"position_{axis}_m" for axis in "xyz"), *(f"rotation_{axis}_rad" for axis in "xyz")]
    columns = ", ".join(f'{key} = "{name}"' for key, name in zip(keys, names, strict=True))
    table = f'topics = ["t.csv"]\ncolumns = {{{columns}}}\ntime = "timestamp"\ntime_unit = "s"\n'
    text = f'[[streams]]\ndevice = "arm"\nkind = "arm"\n{table}'
    frames = arms(imported(source, text, tmp_path / "r.rrd"))
    np.testing.assert_allclose(rotation_from_euler_xyz(*frames[0].rotation_rad), TURN.as_matrix(), atol=1e-12)
    error = refused(source, f'{text}rotation = "XYZ"\n', tmp_path / "s.rrd", capfd)
    assert "rotation of arm in the map: vector, as the names of its columns say; got 'XYZ'" in error
    error = refused(source, f'{text}units = {{"{names[0]}" = "mm"}}\n', tmp_path / "s.rrd", capfd)
    assert f"units.\"{names[0]}\" of arm in the map: m, as the source says; got 'mm'" in error


def test_names_of_quaternions_are_those_of_their_numbers(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    names = ["q.w", "q.x", "q.y", "q.z"]
    source = pose_table(tmp_path, names, TURN.as_quat(scalar_first=True), "")
    columns = {f"q_{at}": name for at, name in enumerate(names)}
    frames = arms(imported(source, pose_map(columns, ""), tmp_path / "r.rrd"))
    np.testing.assert_allclose(rotation_from_euler_xyz(*frames[0].rotation_rad), TURN.as_matrix(), atol=1e-12)
    error = refused(source, pose_map(columns, "", 'rotation = "xyzw"\n'), tmp_path / "s.rrd", capfd)
    assert "rotation of arm in the map: wxyz, as the names of its columns say; got 'xyzw'" in error
    named = dict(zip(["qw", "qx", "qy", "qz"], names, strict=True))
    frames = arms(imported(source, pose_map(named, ""), tmp_path / "t.rrd"))
    np.testing.assert_allclose(rotation_from_euler_xyz(*frames[0].rotation_rad), TURN.as_matrix(), atol=1e-12)
    error = refused(source, pose_map(named | {"qx": "q.w", "qw": "q.x"}, ""), tmp_path / "s.rrd", capfd)
    assert "columns.qx of arm in the map: the column of x, as their names say; got 'q.w'" in error


def test_angles_of_more_than_a_turn_are_no_radians(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = pose_table(tmp_path, ["a", "b", "c"], TURN.as_euler("xyz", degrees=True), "")
    columns = {f"rotation_{axis}_rad": name for axis, name in zip("xyz", "abc", strict=True)}
    error = refused(source, pose_map(columns, "rad", 'rotation = "xyz"\n'), tmp_path / "r.rrd", capfd)
    assert "rad, beyond a turn: are its units deg?" in error
    error = refused(source, pose_map(columns, "deg", 'rotation = "ZYZ"\n'), tmp_path / "r.rrd", capfd)
    assert "rotation_0_rad to rotation_2_rad: ZYZ has two angles about Z" in error


ONE, ALL = "hand_msgs/msg/Matrix", "hand_msgs/msg/Matrices"


def matrices(bag: Bag, sizes: list[tuple[int, int]], name: str, sides: tuple[str, str] = ("cells_x", "cells_y")) -> Bag:
    from rosbags.typesys import get_types_from_msg

    bag.store.register(
        get_types_from_msg(f"string name\nuint16 {sides[0]}\nuint16 {sides[1]}\n{name}[] pressure\n", ONE)
    )
    bag.store.register(get_types_from_msg(f"std_msgs/Header header\n{ONE.replace('/msg', '')}[] pads\n", ALL))
    for at in range(1, 5):
        made = [
            bag.make(ONE, f"pad {place}", wide, high, (100 * place + at + np.arange(wide * high)).astype(name))
            for place, (wide, high) in enumerate(sizes)
        ]
        bag.add("/pads", ALL.replace("/msg/", "/"), at * MS, made)
    return bag


def pads_map(sizes: list[tuple[int, int]], unit: str = "Pa") -> str:
    pads = ", ".join(
        f'{{name = "{at}", rows = {high}, columns = {wide}, texel_m = [1, 1], index = {at}, finger = 0, part = 0}}'
        for at, (wide, high) in enumerate(sizes)
    )
    columns = (
        f'columns = {{"pressure_pa" = "pads.pressure"}}\nunits = {{"pads.pressure" = "{unit}"}}\npads = [{pads}]\n'
    )
    return f'[[streams]]\ndevice = "hand"\nkind = "tactile"\ntopics = ["/pads"]\n{columns}'


@pytest.mark.parametrize("sizes", [[(6, 14), (6, 13)], [(6, 14)], [(3, 4), (3, 4)]])
@pytest.mark.parametrize(
    ("name", "unit", "factor"), [("float64", "Pa", 1.0), ("int16", "hPa", 100.0), ("int16", "DSA count", 473 / 592.1)]
)
def test_a_list_of_matrices_is_a_hand(
    sizes: list[tuple[int, int]], name: str, unit: str, factor: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = matrices(Bag(), sizes, name).write(tmp_path / "bag")
    text = inspected(source)
    assert 'kind = "tactile"\ntopics = ["/pads"]\ncolumns = {"pressure_pa" = "pads.pressure"}' in text
    texels = sum(wide * high for wide, high in sizes)
    sides = [(high, wide) for wide, high in sizes]
    expected = f"part of each, {texels} texels in all, rows and columns {sides}; got none"
    assert expected in refused(source, text.replace('"?"', f'"{unit}"'), tmp_path / "s.rrd", capfd)
    frames: list[Any] = frames_of(imported(source, pads_map(sizes, unit), tmp_path / "r.rrd"))["hand"]
    for at, frame in enumerate(frames, 1):
        for place, (wide, high) in enumerate(sizes):
            expected = factor * (100 * place + at + np.arange(wide * high)).reshape(high, wide)
            np.testing.assert_allclose(frame.pressure_pa[place], expected)


def test_matrices_in_another_order_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = matrices(Bag(), [(6, 14), (6, 13)], "float64").write(tmp_path / "bag")
    error = refused(source, pads_map([(6, 13), (6, 14)]), tmp_path / "r.rrd", capfd)
    assert "pads of hand in the map: rows and columns of its matrices, [(14, 6), (13, 6)], in their order" in error
    turned = matrices(Bag(), [(3, 4)], "float64").write(tmp_path / "turned")
    assert "its matrices, [(4, 3)], in their order; got [(3, 4)]" in refused(
        turned, pads_map([(4, 3)]), tmp_path / "r.rrd", capfd
    )
    unsaid = matrices(Bag(), [(6, 14), (6, 13)], "float64", sides=("a", "b")).write(tmp_path / "unsaid")
    error = refused(unsaid, pads_map([(6, 13), (6, 14)]), tmp_path / "r.rrd", capfd)
    assert "pads of hand in the map: in the order of its matrices, of [84, 78] texels; got [78, 84]" in error
    error = refused(
        source, pads_map([(6, 14), (6, 13)]).replace("pads.pressure", "pads.force"), tmp_path / "r.rrd", capfd
    )
    assert "columns.pressure_pa of hand in the map" in error


def test_frames_of_a_pose_that_has_none_are_refused_by_name(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = Bag()
    for at in range(1, 4):
        bag.add_pose(at * MS)
        bag.add_joints(at * MS, JOINTS, [0.1, 0.2])
    source = bag.write(tmp_path / "bag")
    error = refused(source, arm_map(pose="/pose"), tmp_path / "r.rrd", capfd)
    assert "child of arm in the map: none: /pose has poses without frames of their own; got 'tool'" in error
    assert len(arms(imported(source, arm_map(parent="", pose="/pose"), tmp_path / "r.rrd"))) == 3


def test_numbers_of_streams_whose_clocks_are_still_asked_for_are_shown(tmp_path: Path) -> None:
    bag = Bag()
    for at in range(1, 4):
        bag.add_pose(at * MS)
        bag.add_joints((at + 10**7) * MS, JOINTS, [0.1, 0.2])
    for place, (topic, kind, _, message) in enumerate(bag.messages):
        bag.messages[place] = (topic, kind, (place + 1) * MS, message)
    text = inspected(bag.write(tmp_path / "bag"))
    assert text.count('offset_s = "?"') == 1
    assert "# stream js (arm): " in text


@pytest.mark.parametrize("x", [float("inf"), -1e308])
def test_places_beyond_the_earth_are_refused(x: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = Bag()
    for at in range(1, 4):
        bag.add_pose(at * MS, at=(x, 0.0, 0.0))
        bag.add_joints(at * MS, JOINTS, [0.1, 0.2])
    error = refused(bag.write(tmp_path / "bag"), arm_map(parent="", pose="/pose"), tmp_path / "r.rrd", capfd)
    assert f"a position of {abs(x):.4g} m, beyond any arm" in error
