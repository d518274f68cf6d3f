"""The URDFs stand for the same arm as the kinematics, and look like one."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.jaco.chains import CHAINS, J2N6S300, urdf_path

MODELS = sorted(CHAINS)


def numbers(text: str | None) -> FloatArray:
    return np.array([float(word) for word in text.split()])


def pose(element: ET.Element | None) -> FloatArray:
    """An <origin> as (4, 4), by scipy: fixed-axis roll, pitch, yaw."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", numbers(element.get("rpy"))).as_matrix()
    matrix[:3, 3] = numbers(element.get("xyz"))
    return matrix


def child(element: ET.Element, path: str) -> ET.Element:
    found = element.find(path)
    assert found is not None, path
    return found


def link_poses(robot: ET.Element, angles_deg: dict[str, float]) -> dict[str, FloatArray]:
    """T_base_link of every link, by walking the tree; joints not named stand at 0."""
    poses = {f"{robot.get('name')}_link_base": np.eye(4)}
    for joint in robot.iter("joint"):  # the file lists parents before children
        turn = np.eye(4)
        axis = child(joint, "axis").get("xyz") if joint.get("type") != "fixed" else "0 0 1"
        angle_rad = np.radians(angles_deg.get(str(joint.get("name")), 0.0))
        turn[:3, :3] = Rotation.from_rotvec(angle_rad * numbers(axis)).as_matrix()
        parent = poses[str(child(joint, "parent").get("link"))]
        poses[str(child(joint, "child").get("link"))] = parent @ pose(joint.find("origin")) @ turn
    return poses


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def robot(model: str) -> ET.Element:
    return ET.parse(urdf_path(model)).getroot()


@pytest.fixture
def chain(model: str) -> Chain:
    return CHAINS[model]


def test_the_tree_stands_where_the_kinematics_say(robot: ET.Element, chain: Chain) -> None:
    for joints_deg in np.random.default_rng(5).uniform(50.0, 300.0, (50, chain.joint_count)):
        angles = {f"{chain.name}_joint_{i}": float(a) for i, a in enumerate(joints_deg, 1)}
        poses = link_poses(robot, angles)
        links = chain.forward(joints_deg)
        for index in range(chain.joint_count):
            np.testing.assert_allclose(poses[f"{chain.name}_link_{index + 1}"], links[index], atol=1e-9)
        np.testing.assert_allclose(poses[f"{chain.name}_end_effector"], links[-1], atol=1e-9)


def test_the_origins_are_those_typed_from_the_reference() -> None:
    """Six joints, protocol reference section 3 (geometry), in metres and parts of pi."""
    robot = ET.parse(urdf_path("j2n6s300")).getroot()
    typed = [
        ((0, 0, 0.15675), (0, 1, 0)),
        ((0, 0.0016, -0.11875), (-1 / 2, 0, 1)),
        ((0, -0.410, 0), (0, 1, 0)),
        ((0, 0.2073, -0.0114), (-1 / 2, 0, 1)),
        ((0, -0.03703, -0.06414), (1 / 3, 0, 1)),
        ((0, -0.03703, -0.06414), (1 / 3, 0, 1)),
    ]
    for index, (xyz, rpy) in enumerate(typed, 1):
        origin = child(robot, f"joint[@name='j2n6s300_joint_{index}']/origin")
        np.testing.assert_allclose(numbers(origin.get("xyz")), xyz, atol=1e-12)
        np.testing.assert_allclose(numbers(origin.get("rpy")), np.pi * np.array(rpy), atol=1e-12)


def test_limits_and_masses_are_those_of_the_kinematics(robot: ET.Element, chain: Chain) -> None:
    for index, joint in enumerate(chain.joints, 1):
        element = child(robot, f"joint[@name='{chain.name}_joint_{index}']")
        limit = child(element, "limit")
        assert element.get("type") == ("continuous" if joint.lower_deg is None else "revolute")
        if joint.lower_deg is not None and joint.upper_deg is not None:
            assert float(limit.get("lower", "")) == pytest.approx(np.radians(joint.lower_deg))
            assert float(limit.get("upper", "")) == pytest.approx(np.radians(joint.upper_deg))
        assert float(limit.get("velocity", "")) == pytest.approx(np.radians(joint.velocity_deg_s))
        assert float(limit.get("effort", "")) == joint.effort_nm
        mass = child(robot, f"link[@name='{chain.name}_link_{index}']/inertial/mass")
        assert float(mass.get("value", "")) == joint.mass_kg


def test_every_link_spans_from_its_joint_to_the_next(robot: ET.Element, chain: Chain) -> None:
    """The first shape of a link is a cylinder whose ends are the joint's origin and the next joint's."""
    spans = [f"{chain.name}_link_base"] + [f"{chain.name}_link_{i}" for i in range(1, chain.joint_count)]
    spans += [f"{chain.name}_link_finger_{i}" for i in (1, 2, 3)]
    for name in spans:
        to_child = child(next(j for j in robot.iter("joint") if child(j, "parent").get("link") == name), "origin")
        visual = child(robot, f"link[@name='{name}']/visual")
        half_m = 0.5 * float(child(visual, "geometry/cylinder").get("length", ""))
        centre = pose(visual.find("origin"))
        ends_m = [centre[:3, 3] + side * half_m * centre[:3, 2] for side in (-1, 1)]
        np.testing.assert_allclose(ends_m[0], 0.0, atol=1e-6)
        np.testing.assert_allclose(ends_m[1], numbers(to_child.get("xyz")), atol=1e-6)


def test_closing_fingers_move_their_tips_towards_each_other(robot: ET.Element, model: str) -> None:
    def spread_m(angle_deg: float) -> float:
        poses = link_poses(robot, {f"{model}_joint_finger_{i}": angle_deg for i in (1, 2, 3)})
        tips_m = np.array([(poses[f"{model}_link_finger_tip_{i}"] @ [0.04, 0, 0, 1])[:3] for i in (1, 2, 3)])
        return float(np.linalg.norm(tips_m - tips_m.mean(axis=0), axis=1).mean())

    assert spread_m(0.0) > spread_m(30.0) > spread_m(60.0)


def test_inertias_are_those_a_body_can_have(robot: ET.Element) -> None:
    for inertia in robot.iter("inertia"):
        moments = sorted(float(inertia.get(name, "")) for name in ("ixx", "iyy", "izz"))
        assert moments[0] > 0
        assert moments[2] <= moments[0] + moments[1]


def test_rerun_loads_it_and_moves_its_joints(model: str, chain: Chain) -> None:
    tree = pytest.importorskip("rerun").urdf.UrdfTree.from_file_path(urdf_path(model))
    names = [joint.name for joint in tree.joints()]
    assert names[: chain.joint_count] == [f"{model}_joint_{i}" for i in range(1, chain.joint_count + 1)]
    assert tree.root_link().name == f"{model}_link_base"
    for joint, angle_deg in zip(tree.joints(), chain.home_deg, strict=False):
        joint.compute_transform(float(np.radians(angle_deg)))


def test_an_unknown_model_is_refused() -> None:
    with pytest.raises(ValueError, match="j2n6s300"):
        urdf_path("panda")
    assert urdf_path(J2N6S300.name).is_file()
