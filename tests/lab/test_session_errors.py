"""What the laboratory keeps from the estimator: as often and as large as its settings say, and in what is measured."""

import numpy as np
import pytest

from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors
from studies.reproduce.surface_robot import LabRobot

UP = np.array([0.0, 0.0, 1.0])


def test_sessions_differ_by_what_the_settings_say() -> None:
    drawn = [LabErrors().draw(seed) for seed in range(400)]
    compliance = ARM_STIFFNESS_N_M / np.array([one.arm_n_per_m for one in drawn])
    assert compliance.mean() == pytest.approx(1.0, abs=0.02)
    assert compliance.std() == pytest.approx(ARM_DOUBT, rel=0.1)
    assert np.std([one.gain for one in drawn]) == pytest.approx(0.03, rel=0.1)
    assert np.std([one.gain_at(100.0) - one.gain for one in drawn]) == pytest.approx(0.01, rel=0.1)
    scatter = np.array([one.scatter_sd for one in drawn])
    assert 0.02 < scatter.min() < 0.025
    assert 0.09 < scatter.max() < 0.10


def test_scatter_has_its_deviation_and_its_length() -> None:
    """Over many sessions, at two places that are a length apart: correlation exp(-1/2)."""
    settings = LabErrors(scatter=(0.05, 0.05), scatter_length_m=0.04)
    values = np.array([settings.draw(seed).scatter(np.array([[0.3, 0.2], [0.34, 0.2]])) for seed in range(1500)])
    assert values.std() == pytest.approx(0.05, rel=0.05)
    assert np.corrcoef(values.T)[0, 1] == pytest.approx(np.exp(-0.5), abs=0.06)


def test_the_clean_laboratory_keeps_nothing() -> None:
    clean = LabErrors.none().draw(3)
    force = np.array([0.1, -0.2, 3.0])
    np.testing.assert_array_equal(clean.sensed(force, 50.0), force)
    assert clean.arm_n_per_m == ARM_STIFFNESS_N_M
    scene = built_in("two-60-150", 3)
    assert clean.foam(scene).modulus_pa(np.array([0.1, 0.1])) == scene.modulus_pa(np.array([0.1, 0.1]))
    assert clean.foam(scene).thickness_m == scene.thickness_m


def test_the_sensor_has_the_session_s_gain_and_the_tip_rubs() -> None:
    drawn = LabErrors(friction=0.5).draw(1)
    felt = drawn.sensed(np.array([0.0, 0.0, 2.0]), 0.0)
    assert felt[2] == pytest.approx(2.0 * drawn.gain)
    assert np.hypot(*felt[:2]) == pytest.approx(2.0 * drawn.gain * drawn.friction)


def test_a_touch_is_felt_through_all_of_them() -> None:
    """Where a soft foam is pressed: what was measured over what was true, and where it stopped."""
    scene, options = built_in("homogeneous-60", 1), ExploreOptions(beta_model="none", seed=1)
    errors = LabErrors(gain=0.2, drift=0.0, scatter=(0.1, 0.1))
    robot = LabRobot(scene, options, sees=False, errors=errors)
    drawn = errors.draw([1, 1])
    place = np.array([0.3, 0.2])
    made = robot.touch(Touch(place, scene.thickness_m, UP))
    assert made.reached
    # stopped by what the sensor said, a little late
    assert 3.0 < made.force_n[-1, 2] < 3.5
    assert robot.most_force_n == pytest.approx(made.force_n[-3:, 2].max() / drawn.gain, rel=0.05)
    assert np.hypot(*made.force_n[-1, :2]) == pytest.approx(drawn.friction * made.force_n[-1, 2], abs=0.1)
    assert robot.scene.thickness_m == pytest.approx(scene.thickness_m * drawn.thickness)
    clean = LabRobot(robot.scene, options, sees=False)
    clean.touch(Touch(place, scene.thickness_m, UP))
    expected = drawn.scatter(place[None])[0]
    # the contact feels the field around it, a little less than at its middle
    assert abs(expected) > 0.02
    assert (robot.felt[0] - clean.felt[0]) / expected == pytest.approx(0.9, abs=0.35)
