"""What a rig file says of the robot's looks: URDFs of others, grippers, cables, and what is refused."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import open3d as o3d
import pytest

from deformscope.errors import InputError
from deformscope.lab.scene_lab import FOLDER, described_robot
from deformscope.rig.rig_file import Tool, load_rig
from deformscope.rig.sections import CableSection, ShapeSection
from deformscope.robot.description import AS_CAPSULES, DescribedCable, RobotDescription, arm_shape, describe, read_urdf
from deformscope.robot.placement import Placement
from deformscope.robot.preflight import _hand
from deformscope.robot.setup import RigParts
from deformscope.robot.touch import TouchPlan
from deformscope_drivers.arm.kinematics import rotation_from_rpy, transform
from deformscope_drivers.arms import chains
from deformscope_drivers.jaco import urdf_path
from deformscope_drivers.jaco.chains import J2N6S300

CHAINS = chains()

PLACEMENT = Placement(transform(rotation_from_rpy(0.1, -0.2, 2.0), (0.3, -0.5, 0.04)), Tool())
POSE_DEG = np.add(J2N6S300.home_deg, (10.0, -5.0, 8.0, 30.0, -20.0, 40.0))
GRIPPER = """<robot name="gripper">
  <link name="palm"><visual><origin xyz="0 0 -0.02"/><geometry><box size="0.08 0.06 0.04"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><parent link="palm"/><child link="jaw"/><origin xyz="0 0 0.01"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.02" effort="1" velocity="1"/></joint>
  <link name="jaw"><visual><geometry><mesh filename="jaw.stl" scale="0.001 0.001 0.001"/></geometry></visual></link>
</robot>"""

RIG = """
[devices.arm]
driver = "jaco"
double = true
{model}
[devices.tip]
driver = "optoforce"
double = true
[devices.depth]
driver = "depth_camera"
double = true
[surface]
scene = "two-60-150"
[shape]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With a gripper whose jaw is a cube of 10 mm, in mm."""
    jaw = o3d.geometry.TriangleMesh.create_box(10.0, 10.0, 10.0).compute_triangle_normals()
    assert o3d.io.write_triangle_mesh(tmp_path / "jaw.stl", jaw)
    (tmp_path / "gripper.urdf").write_text(GRIPPER, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("model", sorted(CHAINS))
def test_the_shipped_descriptions_are_those_of_their_chains(model: str) -> None:
    chain = CHAINS[model]
    family = "jaco" if model.startswith("j2") else "kuka"
    path = urdf_path("j2n6s300").parents[1] / family / f"{model}.urdf"
    found = describe(ShapeSection(urdf=str(path)), chain, Path())
    assert found.removal == "mesh"
    assert found.whole
    assert {part.frame for part in found.parts} >= set(range(chain.joint_count + 1))


def test_another_arms_description_is_refused() -> None:
    section = ShapeSection(urdf=str(urdf_path("j2s6s300")))
    with pytest.raises(InputError, match="joints are those of j2n6s300"):
        describe(section, J2N6S300, Path())
    with pytest.raises(InputError, match="joints are those of j2s7s300"):
        describe(ShapeSection(urdf=str(urdf_path("j2n6s300"))), CHAINS["j2s7s300"], FOLDER / "nowhere")


def test_parts_move_with_their_joints() -> None:
    """A URDF's own kinematics, joint by joint, is the reference."""
    urdf = read_urdf(FOLDER / "j2n6s300-stick.urdf")
    names = [joint.name for joint in urdf.movable[:6]]
    poses = urdf.poses(dict(zip(names, np.radians(POSE_DEG), strict=True)))
    expected = [
        PLACEMENT.T_surface_base @ poses[link] @ np.append(solid.vertices_m.mean(axis=0), 1.0)
        for link in urdf.solids
        for solid in urdf.solids[link]
    ]
    described = describe(ShapeSection(urdf="j2n6s300-stick.urdf"), J2N6S300, FOLDER)
    found = np.array([one.vertices_m.mean(axis=0) for one in described.solids(PLACEMENT, J2N6S300.forward(POSE_DEG))])
    away = np.linalg.norm(found[:, None] - np.array(expected)[None, :, :3], axis=2)
    assert away.min(axis=1).max() < 1e-4
    assert away.min(axis=0).max() < 1e-4


def test_a_gripper_sits_at_the_arms_end(folder: Path) -> None:
    T = transform(np.eye(3), (0.0, 0.0, -0.05))
    section = ShapeSection(gripper="gripper.urdf", T_ee_gripper=tuple(map(tuple, T.tolist())), closed=0.5)
    found = describe(section, None, folder)
    assert not found.whole
    assert [part.frame for part in found.parts] == [-1, -1]
    palm, jaw = (part.solid.vertices_m for part in found.parts)
    np.testing.assert_allclose([palm.min(axis=0), palm.max(axis=0)], [[-0.04, -0.03, -0.09], [0.04, 0.03, -0.05]])
    np.testing.assert_allclose([jaw.min(axis=0), jaw.max(axis=0)], [[0, 0.01, -0.04], [0.01, 0.02, -0.03]], atol=1e-7)


def test_a_hull_is_around_all_that_is_drawn_of_a_link() -> None:
    drawn, hulls = described_robot("mesh"), described_robot("hull")
    assert (
        len(hulls.parts) == len({part.frame for part in hulls.parts}) + 7
    )  # and two links of each finger, and the mount
    for part in drawn.parts:
        inside = np.zeros(len(part.solid.vertices_m), dtype=bool)
        for hull in (one.solid for one in hulls.parts if one.frame == part.frame):
            inside |= hull.near(part.solid.vertices_m, 1e-6)
        assert inside.all()


def test_cables_go_from_joint_to_joint_in_every_removal() -> None:
    cable = CableSection(((0.0, 0.05, 0.0), (0.03, 0.0, 0.02)), 0.007, (3, -1))
    links = J2N6S300.forward(POSE_DEG)
    for removal in ("capsules", "mesh"):
        urdf = "" if removal == "capsules" else "j2n6s300-stick.urdf"
        described = describe(ShapeSection(removal, urdf, cables=(cable,)), J2N6S300, FOLDER)
        shape = arm_shape(PLACEMENT, links, np.zeros(3), description=described, stick_margin_m=0.004)
        assert len(shape) == (10 if removal == "capsules" else 3)
        line = shape[-1]
        start = PLACEMENT.T_surface_base @ links[2] @ (0.0, 0.05, 0.0, 1.0)
        end = PLACEMENT.T_surface_base @ links[-1] @ (0.03, 0.0, 0.02, 1.0)
        np.testing.assert_allclose([line.start_m, line.end_m], [start[:3], end[:3]])
        assert line.radius_m == pytest.approx(0.011)
    with pytest.raises(InputError, match="to 6, or -1"):
        describe(ShapeSection(cables=(CableSection(cable.points_m, 0.007, (3, 7)),)), J2N6S300, FOLDER)


def test_a_description_survives_its_recording() -> None:
    made = described_robot()
    back = RobotDescription.from_json(json.loads(json.dumps(made.as_json())))
    assert (back.removal, back.whole, back.margin_m) == (made.removal, made.whole, made.margin_m)
    for one, other in zip(back.parts, made.parts, strict=True):
        assert one.frame == other.frame
        np.testing.assert_array_equal(one.solid.vertices_m, other.solid.vertices_m)
        np.testing.assert_array_equal(one.solid.triangles, other.solid.triangles)
    np.testing.assert_array_equal(back.cables[0].points_m, made.cables[0].points_m)


def one_shape(geometry: str) -> str:
    return f"<robot name='x'><link name='a'><visual><geometry>{geometry}</geometry></visual></link></robot>"


def joined(limit: str) -> str:
    joint = f"<joint name='j' type='revolute'><parent link='a'/><child link='b'/>{limit}</joint>"
    return f"<robot name='x'><link name='a'/><link name='b'/>{joint}</robot>"


def test_entities_are_refused_whatever_the_file_is_written_in(folder: Path) -> None:
    kind = "<?xml version='1.0' encoding='UTF-16'?><!DOCTYPE x [<!ENTITY a 'b'>]>"
    (folder / "gripper.urdf").write_text(f"{kind}<robot name='&a;'><link name='l'/></robot>", encoding="utf-16")
    with pytest.raises(InputError, match="document type"):
        describe(ShapeSection(gripper="gripper.urdf"), None, folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><robot name='x'/>", "document type"),
        ("<robot", "XML"),
        ("<scene/>", "<robot>"),
        ("<robot name='x'><link name='a'/><link name='b'/></robot>", "one tree"),
        ("<robot name='x'><link name='a'><visual/></link></robot>", "without geometry"),
        (GRIPPER.replace("jaw.stl", "../../etc/passwd.stl"), "meshes below"),
        (GRIPPER.replace("jaw.stl", "/etc/passwd.stl"), "meshes below"),
        (GRIPPER.replace("jaw.stl", "package://mine/../../jaw.stl"), "meshes below"),
        (GRIPPER.replace("jaw.stl", "package://mine//etc/passwd"), "meshes below"),
        (GRIPPER.replace("jaw.stl", "file:///etc/passwd"), "meshes below"),
        (GRIPPER.replace("jaw.stl", "file:///etc/../etc/passwd.stl"), "meshes below"),
        (GRIPPER.replace("jaw.stl", "other.stl"), "no file"),
        (GRIPPER.replace("jaw.stl", "jaw.dae"), "a mesh file"),
        (GRIPPER.replace("0.08 0.06 0.04", "0.08 nan 0.04"), "3 numbers"),
        (GRIPPER.replace("0.08 0.06 0.04", "0.08 0 0.04"), "lengths above 0"),
        (GRIPPER.replace("0.08 0.06 0.04", "80000 60000 40000"), "lengths above 0"),
        (one_shape("<sphere radius='nan'/>"), "1 numbers"),
        (one_shape("<sphere radius='-1'/>"), "lengths above 0"),
        (one_shape("<cylinder radius='inf' length='0.1'/>"), "2 numbers"),
        (one_shape("<cylinder radius='0.1' length='0'/>"), "lengths above 0"),
        (one_shape("<mesh filename='jaw.stl' scale='1 0 1'/>"), "lengths above 0"),
        (joined("<limit lower='nan' upper='1'/>"), "2 numbers"),
    ],
)
def test_descriptions_that_are_none_are_refused(folder: Path, text: str, message: str) -> None:
    (folder / "gripper.urdf").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        describe(ShapeSection(gripper="gripper.urdf"), None, folder)


def test_a_mesh_is_found_in_its_package(folder: Path) -> None:
    (folder / "package.xml").write_text("<package/>", encoding="utf-8")
    (folder / "urdf").mkdir()
    text = GRIPPER.replace("jaw.stl", "package://mine/jaw.stl")
    (folder / "urdf" / "gripper.urdf").write_text(text, encoding="utf-8")
    (folder / "urdf" / "beside.urdf").write_text(GRIPPER.replace("jaw.stl", "../jaw.stl"), encoding="utf-8")
    for name in ("gripper", "beside"):
        assert len(describe(ShapeSection(gripper=f"urdf/{name}.urdf"), None, folder).parts) == 2


def test_what_cannot_be_is_said() -> None:
    with pytest.raises(InputError, match="with urdf or gripper"):
        describe(ShapeSection("hull"), J2N6S300, Path())
    with pytest.raises(InputError, match="without a chain"):
        describe(ShapeSection(urdf="a.urdf"), None, Path())
    with pytest.raises(InputError, match="no such file"):
        describe(ShapeSection(urdf="a.urdf"), J2N6S300, Path())
    with pytest.raises(InputError, match=r"a URDF that can be read.*home directory"):
        describe(ShapeSection(gripper="~nobody-of-this-name/a.urdf"), None, Path())


def test_a_rig_file_describes_its_robot_beside_itself(folder: Path) -> None:
    """Paths count from its folder; what the arm's model is has to stand in it."""
    rig_file = folder / "rig.toml"
    shape = 'gripper = "gripper.urdf"\ncables = [{ points_m = [[0, 0, 0], [0, 0, 0.05]], radius_m = 0.01 }]\n'
    rig_file.write_text(RIG.format(model='model = "j2n6s300"') + shape, encoding="utf-8")
    described = RigParts.of(load_rig(rig_file)).described
    assert (described.removal, len(described.parts), len(described.cables)) == ("mesh", 2, 1)
    rig_file.write_text(RIG.format(model="") + shape, encoding="utf-8")
    with pytest.raises(InputError, match="of the arm, beside"):
        RigParts.of(load_rig(rig_file))
    rig_file.write_text(RIG.format(model=""), encoding="utf-8")
    assert RigParts.of(load_rig(rig_file)).described is AS_CAPSULES
    for line, message in (
        ('removal = "mash"', "mash"),
        ("closed = 1.5", "closed between"),
        ("cables = [{ points_m = [[0, 0, 0]] }]", "points_m of 2 or more"),
        ("cables = [{ points_m = [[0, 0, 0], [0, 0, 1]], joints = [1] }]", "one for each"),
    ):
        rig_file.write_text(RIG.format(model="") + line, encoding="utf-8")
        with pytest.raises(InputError, match=message):
            load_rig(rig_file)


def test_what_is_lowest_of_the_hand_is_known_above_the_tip_in_any_pose() -> None:
    """A cable that hangs 3 cm before the tip's lowest point, and one that moves with the elbow."""
    made = described_robot()
    tip_m = PLACEMENT.T_ee_center[:3, 3] + PLACEMENT.center_offset_m * PLACEMENT.T_ee_center[:3, 2]
    below = DescribedCable((-1, -1), np.array([tip_m, np.add(tip_m, (0.05, 0.0, 0.03))]), 0.002)
    elbow = DescribedCable((3, 3), np.array([[0.0, 0.0, 5.0], [0.0, 0.0, -5.0]]), 0.002)
    for pose_deg in (POSE_DEG, J2N6S300.home_deg):
        links = J2N6S300.forward(pose_deg)
        assert AS_CAPSULES.over_tip_m(PLACEMENT, links) == np.inf
        assert RobotDescription(cables=(elbow,)).over_tip_m(PLACEMENT, links) == np.inf
        assert RobotDescription(cables=(below, elbow)).over_tip_m(PLACEMENT, links) == pytest.approx(-0.032, abs=1e-9)
        assert 0.015 < made.over_tip_m(PLACEMENT, links) < 0.05


def test_a_hand_that_would_meet_the_surface_before_the_tip_is_refused() -> None:
    """A stick's neck 2.4 cm before the tip leaves 9 mm beside a dent of 15 mm, and a cable 1.8 cm before it 3 mm."""
    plan = TouchPlan(np.zeros(3), np.array([0.0, 0.0, 1.0]), max_depth_m=0.015)
    arm = SimpleNamespace(by_hand=False, chain=J2N6S300)
    robot: Any = SimpleNamespace(arm=arm, pose=SimpleNamespace(joints_deg=POSE_DEG), placement=PLACEMENT)
    place_m = PLACEMENT.T_ee_center[:3, 3] + (PLACEMENT.center_offset_m - 0.02) * PLACEMENT.T_ee_center[:3, 2]
    low = RobotDescription(cables=(DescribedCable((-1, -1), np.array([place_m, place_m + 0.01]), 0.002),))
    assert [one.passed for one in _hand(robot, [plan], described_robot())] == [True]
    (found,) = _hand(robot, [plan], low)
    assert (found.passed, found.name) == (False, "hand: above the surface")
    assert found.hint
    assert list(_hand(robot, [plan], AS_CAPSULES)) == list(_hand(robot, [], low)) == []
