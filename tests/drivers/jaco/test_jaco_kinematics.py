"""The arm's geometry against an independent table (Denavit and Hartenberg), finite differences and scipy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.jaco.chains import CHAINS, J2N6S300, J2S6S300, J2S7S300

# Classic DH of the six-joint arm, as Kinova publishes it (protocol reference, section 3, geometry)
DH_A_M = [0.0, 0.41, 0.0, 0.0, 0.0, 0.0]
DH_D_M = [0.2755, 0.0, -0.0098, -0.250082, -0.085563, -0.202782]
DH_ALPHA_DEG = [90.0, 180.0, 90.0, 60.0, 60.0, 180.0]
DH_SIGN = [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
DH_OFFSET_DEG = [0.0, -90.0, 90.0, 0.0, -180.0, 90.0]


def dh_end_effector(joints_deg: FloatArray) -> FloatArray:
    """T_base_end_effector (4, 4) by the DH table alone."""
    pose = np.eye(4)
    for joint, angle in enumerate(joints_deg):
        theta = np.radians(DH_SIGN[joint] * angle + DH_OFFSET_DEG[joint])
        alpha = np.radians(DH_ALPHA_DEG[joint])
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        a, d = DH_A_M[joint], DH_D_M[joint]
        pose = pose @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return pose


def random_joints(chain: Chain, count: int, seed: int = 1) -> FloatArray:
    """Joint angles (count, n) [deg] within the limits."""
    lower = np.where(np.isfinite(chain.lower_deg), chain.lower_deg, -360.0)
    upper = np.where(np.isfinite(chain.upper_deg), chain.upper_deg, 360.0)
    return np.random.default_rng(seed).uniform(lower, upper, (count, chain.joint_count))


@pytest.fixture(params=sorted(CHAINS))
def chain(request: pytest.FixtureRequest) -> Chain:
    return CHAINS[request.param]


def test_six_joints_agree_with_the_dh_table() -> None:
    for joints_deg in random_joints(J2N6S300, 500):
        ours, theirs = J2N6S300.end_effector(joints_deg), dh_end_effector(joints_deg)
        assert np.linalg.norm(ours[:3, 3] - theirs[:3, 3]) < 1e-4  # the two published tables differ by 0.08 mm
        assert np.degrees(Rotation.from_matrix(ours[:3, :3].T @ theirs[:3, :3]).magnitude()) < 1e-3


def test_home_of_six_joints_is_where_the_reference_says() -> None:
    home = J2N6S300.end_effector((275.0, 167.4, 57.4, 240.0, 82.7, 75.5))
    np.testing.assert_allclose(home[:3, 3], (0.2145, -0.2563, 0.5107), atol=1e-4)
    # what a real arm says of its home pose, typed from kinova_driver's demo: its home differs by a degree or so
    np.testing.assert_allclose(home[:3, 3], (0.2123, -0.2572, 0.5096), atol=3e-3)
    theta_rad = kinematics.euler_xyz_from_rotation(home[:3, :3])
    np.testing.assert_allclose(theta_rad, (1.6377, 1.1132, 0.1341), atol=np.radians(2.0))


def test_home_of_seven_joints_is_near_that_of_six() -> None:
    """The base, the reach and the hand are the same, and the vendor brings both to the same place."""
    np.testing.assert_allclose(
        J2S7S300.end_effector(J2S7S300.home_deg), J2N6S300.end_effector(J2N6S300.home_deg), atol=0.04
    )


def test_six_joints_with_the_spherical_wrist_are_the_seven_with_the_third_at_0() -> None:
    """The same arm otherwise, by two of Kinova's robot descriptions (j2s6s300.xacro, j2s7s300.xacro)."""
    for joints_deg in random_joints(J2S6S300, 50):
        seven_deg = np.insert(joints_deg, 2, 0.0)
        np.testing.assert_allclose(J2S6S300.end_effector(joints_deg), J2S7S300.end_effector(seven_deg), atol=1e-9)


def test_the_candle_pose_is_as_high_as_its_links() -> None:
    """All joints at 180 deg: everything stands over the base (the six-joint arm's wrist bends over)."""
    forearm_m = 0.2755 + 0.41 + 0.2073
    spherical = J2S7S300.forward([180.0] * 7)
    np.testing.assert_allclose(spherical[-1, :3, 3], (0.0, 0.0, forearm_m + 2 * 0.10375 + 0.16), atol=0.015)
    assert spherical[-1, 2, 3] == pytest.approx(forearm_m + 2 * 0.10375 + 0.16, abs=1e-4)
    assert J2N6S300.forward([180.0] * 6)[3, 2, 3] == pytest.approx(forearm_m, abs=1e-4)


def test_links_are_rigid_and_the_last_is_the_end_effector(chain: Chain) -> None:
    for joints_deg in random_joints(chain, 20):
        links = chain.forward(joints_deg)
        assert links.shape == (chain.joint_count + 1, 4, 4)
        rotations = links[:, :3, :3]
        np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), [np.eye(3)] * len(links), atol=1e-12)
        np.testing.assert_array_equal(links[-1], chain.end_effector(joints_deg))


def test_jacobian_agrees_with_finite_differences(chain: Chain) -> None:
    step_deg = 1e-4
    for joints_deg in random_joints(chain, 20):
        numeric = np.empty((6, chain.joint_count))
        for joint in range(chain.joint_count):
            change = np.zeros(chain.joint_count)
            change[joint] = step_deg
            before, after = chain.end_effector(joints_deg - change), chain.end_effector(joints_deg + change)
            turned = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
            numeric[:, joint] = np.concatenate([after[:3, 3] - before[:3, 3], turned]) / np.radians(2 * step_deg)
        np.testing.assert_allclose(chain.jacobian(joints_deg), numeric, atol=1e-6)


def test_gravity_torque_is_the_slope_of_the_potential_energy(chain: Chain) -> None:
    masses_kg = np.array([joint.mass_kg for joint in chain.joints])

    def energy_j(joints_deg: FloatArray) -> float:
        origins_m = chain.forward(joints_deg)[:, :3, 3]
        heights_m = 0.5 * (origins_m[:-1, 2] + origins_m[1:, 2])
        return float(9.81 * masses_kg @ heights_m)

    for joints_deg in random_joints(chain, 5):
        torque_nm = chain.gravity_torque_nm(chain.forward(joints_deg))
        for joint in range(chain.joint_count):
            change = np.zeros(chain.joint_count)
            change[joint] = 1e-3
            slope = (energy_j(joints_deg + change) - energy_j(joints_deg - change)) / np.radians(2e-3)
            assert torque_nm[joint] == pytest.approx(slope, abs=1e-6)
        assert np.all(np.abs(torque_nm) < chain.effort_nm)


def test_inverse_finds_what_is_in_reach(chain: Chain) -> None:
    for joints_deg in random_joints(chain, 40, seed=7):
        target = chain.end_effector(joints_deg)
        found = chain.inverse(target)
        assert found.converged
        assert chain.within_limits(found.joints_deg)
        reached = chain.end_effector(found.joints_deg)
        np.testing.assert_allclose(reached[:3, 3], target[:3, 3], atol=2e-5)
        assert Rotation.from_matrix(reached[:3, :3].T @ target[:3, :3]).magnitude() < 2e-4


def test_inverse_stays_near_where_it_starts(chain: Chain) -> None:
    start_deg = chain.home_deg
    found = chain.inverse(chain.end_effector(start_deg + 2.0), start_deg)
    assert found.converged
    assert np.max(np.abs(found.joints_deg - start_deg)) < 15.0


def test_inverse_says_honestly_when_the_target_is_out_of_reach(chain: Chain) -> None:
    far = chain.end_effector(chain.home_deg)
    far[:3, 3] = (2.0, 0.0, 0.3)
    found = chain.inverse(far, starts=3)
    assert not found.converged
    reached = chain.end_effector(found.joints_deg)
    assert found.position_error_m == pytest.approx(float(np.linalg.norm(reached[:3, 3] - far[:3, 3])))
    assert found.position_error_m > 0.7
    assert chain.within_limits(found.joints_deg)


def test_many_poses_at_once_give_what_each_gives_alone(chain: Chain) -> None:
    joints_deg = chain.clip(np.random.default_rng(4).uniform(0.0, 360.0, (12, chain.joint_count)))
    targets, starts = chain.forward(joints_deg)[:, -1], joints_deg[::-1]
    found, converged = chain.inverse_near(targets, starts)
    each = [chain.inverse(target, start, starts=1) for target, start in zip(targets, starts, strict=True)]
    assert np.array_equal(found, [one.joints_deg for one in each])
    assert converged.tolist() == [one.converged for one in each]
    assert 0 < np.count_nonzero(converged) < len(targets)


def test_inverse_repeats_under_its_seed() -> None:
    target = J2N6S300.end_effector(random_joints(J2N6S300, 1, seed=3)[0])
    once, again = J2N6S300.inverse(target, seed=5), J2N6S300.inverse(target, seed=5)
    np.testing.assert_array_equal(once.joints_deg, again.joints_deg)


def test_wrong_shapes_and_nan_are_refused(chain: Chain) -> None:
    with pytest.raises(ValueError, match="joints"):
        chain.forward([0.0] * 5)
    with pytest.raises(ValueError, match="4 x 4"):
        chain.inverse(np.full((4, 4), np.nan))


def test_vendor_angles_are_rotations_about_x_then_the_new_y_then_the_new_z() -> None:
    for theta in np.random.default_rng(2).uniform(-np.pi / 2 + 0.01, np.pi / 2 - 0.01, (100, 3)):
        rotation = kinematics.rotation_from_euler_xyz(*theta)
        np.testing.assert_allclose(rotation, Rotation.from_euler("XYZ", theta).as_matrix(), atol=1e-12)
        np.testing.assert_allclose(kinematics.euler_xyz_from_rotation(rotation), theta, atol=1e-9)


@pytest.mark.parametrize("theta_y", [np.pi / 2, -np.pi / 2])
def test_vendor_angles_at_their_singularity_still_give_the_rotation_back(theta_y: float) -> None:
    rotation = kinematics.rotation_from_euler_xyz(0.3, theta_y, 0.8)
    again = kinematics.rotation_from_euler_xyz(*kinematics.euler_xyz_from_rotation(rotation))
    np.testing.assert_allclose(again, rotation, atol=1e-9)


def test_rotation_vectors_agree_with_scipy_from_nothing_to_half_a_turn() -> None:
    rng = np.random.default_rng(4)
    for angle in (0.0, 1e-9, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-7, np.pi):
        axis = rng.normal(size=3)
        rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        found = kinematics.rotation_vector(rotation)
        np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), rotation, atol=1e-7)
        assert np.linalg.norm(found) == pytest.approx(angle, abs=1e-7)


def test_damped_rates_meet_the_twist_away_from_singularities_and_stay_bounded_in_them(chain: Chain) -> None:
    twist = np.array([0.05, 0.0, 0.02, 0.0, 0.1, 0.0])
    jacobian = chain.jacobian(chain.home_deg)
    np.testing.assert_allclose(jacobian @ kinematics.damped_joint_rates(jacobian, twist), twist, atol=1e-9)
    rates = kinematics.damped_joint_rates(chain.jacobian([180.0] * chain.joint_count), twist)
    assert np.all(np.abs(rates) < np.linalg.norm(twist) / 0.02)
