"""A chain from a URDF: the same arm as the chains that are typed from the vendors' numbers."""

from pathlib import Path

import numpy as np
import pytest

import deformscope_drivers.kuka as kuka
from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.arm.urdf import chain_of_urdf
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.jaco.chains import CHAINS as JACO
from deformscope_drivers.jaco.chains import urdf_path
from deformscope_drivers.kuka.config import CHAINS as KUKA

FILES = {name: urdf_path(name) for name in JACO} | {name: Path(kuka.__file__).parent / f"{name}.urdf" for name in KUKA}

ODD = """<robot name="odd">
  <link name="base"/><link name="one"/><link name="plate"/><link name="tool"/>
  <link name="two"><inertial><mass value="2"/></inertial></link>
  <joint name="a" type="revolute"><origin xyz="0 0 1" rpy="0.3 -0.2 0.1"/><parent link="base"/><child link="one"/>
    <axis xyz="0 -1 0"/><limit lower="0.5" upper="1.5" velocity="2" effort="9"/></joint>
  <joint name="fix" type="fixed"><origin xyz="0.1 0.2 0.3" rpy="0 0 1"/>
    <parent link="one"/><child link="plate"/></joint>
  <joint name="b" type="continuous"><parent link="plate"/><child link="two"/><axis xyz="1 2 2"/></joint>
  <joint name="end" type="fixed"><origin xyz="0 0.5 0" rpy="1 0 0"/><parent link="two"/><child link="tool"/></joint>
</robot>
"""


def drawn(chain: Chain, count: int = 50) -> np.ndarray:
    low = np.maximum(chain.lower_deg, -360.0)
    return np.random.default_rng(3).uniform(low, np.minimum(chain.upper_deg, 360.0), (count, chain.joint_count))


@pytest.mark.parametrize("name", FILES)
def test_it_is_the_arm_that_was_typed_from_the_vendor_s_numbers(name: str) -> None:
    typed = (JACO | KUKA)[name]
    read = chain_of_urdf(FILES[name], f"{name}_end_effector", tuple(typed.home_deg))
    assert read.name == name
    for joints_deg in drawn(typed):
        np.testing.assert_allclose(read.end_effector(joints_deg), typed.end_effector(joints_deg), atol=1e-8)
        np.testing.assert_allclose(read.jacobian(joints_deg), typed.jacobian(joints_deg), atol=1e-8)
    np.testing.assert_allclose(read.lower_deg, typed.lower_deg, atol=1e-6)
    np.testing.assert_allclose(read.upper_deg, typed.upper_deg, atol=1e-6)
    np.testing.assert_allclose(read.velocity_deg_s, typed.velocity_deg_s, rtol=1e-6)
    np.testing.assert_allclose(read.effort_nm, typed.effort_nm)


@pytest.mark.parametrize("name", [*FILES, "odd"])
def test_it_is_right_against_pinocchio(name: str, tmp_path: Path) -> None:
    """Axes of any direction, fixed joints between moving ones."""
    pinocchio = pytest.importorskip("pinocchio")
    path, tip = (tmp_path / "odd.urdf", "tool") if name == "odd" else (FILES[name], f"{name}_end_effector")
    if name == "odd":
        path.write_text(ODD)
    model = pinocchio.buildModelFromUrdf(str(path))
    data, read = model.createData(), chain_of_urdf(path, tip, (0.0,) * 7)
    for joints_deg in drawn(read, 20):
        q = pinocchio.neutral(model)
        for index, angle in enumerate(np.radians(joints_deg), start=1):
            joint = model.joints[index]
            q[joint.idx_q : joint.idx_q + joint.nq] = angle if joint.nq == 1 else (np.cos(angle), np.sin(angle))
        pinocchio.framesForwardKinematics(model, data, q)
        pose = data.oMf[model.getFrameId(tip)].homogeneous
        np.testing.assert_allclose(read.end_effector(joints_deg), pose, atol=1e-9)


def test_axes_of_any_direction_and_fixed_joints_between(tmp_path: Path) -> None:
    """By the rotation vectors of the axes themselves."""
    from scipy.spatial.transform import Rotation

    (tmp_path / "odd.urdf").write_text(ODD)
    read = chain_of_urdf(tmp_path / "odd.urdf", "tool", (60.0, 0.0))
    assert (read.lower_deg[1], read.upper_deg[1]) == (-np.inf, np.inf)

    def step(xyz: tuple[float, ...], rpy: tuple[float, ...], axis: tuple[float, ...], angle: float) -> np.ndarray:
        T = np.eye(4)
        turn = Rotation.from_rotvec(angle * np.array(axis) / max(np.linalg.norm(axis), 1e-9))
        T[:3, :3], T[:3, 3] = (Rotation.from_euler("xyz", rpy) * turn).as_matrix(), xyz
        return T

    for a, b in ((0.0, 0.0), (0.7, -2.0), (1.2, 9.0)):
        pose = step((0, 0, 1), (0.3, -0.2, 0.1), (0, -1, 0), a) @ step((0.1, 0.2, 0.3), (0, 0, 1), (0, 0, 0), 0.0)
        pose = pose @ step((0, 0, 0), (0, 0, 0), (1, 2, 2), b) @ step((0, 0.5, 0), (1, 0, 0), (0, 0, 0), 0.0)
        np.testing.assert_allclose(read.end_effector(np.degrees([a, b])), pose, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "tip", "expected"),
    [
        (("continuous", "prismatic"), "tool", "joints that turn"),
        (('<axis xyz="1 2 2"/>', '<axis xyz="1 2 2"/><mimic joint="a"/>'), "tool", "joints that turn"),
        (("<robot", "<!DOCTYPE x><robot"), "tool", "without a document type"),
        (('xyz="0 0 1"', 'xyz="0 0"'), "tool", "a URDF: XML"),
        (("", ""), "flange", "a link out of base, one, plate, tool, two"),
        (("</robot>", ""), "tool", "a URDF: XML"),
    ],
)
def test_what_is_no_arm_is_refused(change: tuple[str, str], tip: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "odd.urdf").write_text(ODD.replace(*change))
    with pytest.raises(DeviceError, match=expected):
        chain_of_urdf(tmp_path / "odd.urdf", tip, (60.0, 0.0))
    with pytest.raises(DeviceError, match="that can be read"):
        chain_of_urdf(tmp_path / "none.urdf", tip, (60.0, 0.0))
