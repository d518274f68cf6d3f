"""Force and torque at the tip: numbers typed from the laws of a rigid body."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.poke.tip_wrench import CarriedTool, SensorWindow, tip_wrench, tool_load

DOWN = np.diag([1.0, -1.0, -1.0])
LEVEL = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # the stick along the base's x axis
TIMES = np.arange(-7, 8) * 8e-3


def stick(length_m: float = 0.2) -> FloatArray:
    T = np.eye(4)
    T[2, 3] = length_m
    return T


TOOL = CarriedTool(
    stick(), np.array([0, 0, 0.05]), np.eye(3), weight_n=np.array([0, 0, -9.80665]), center_m=np.array([0, 0, 0.1])
)
WEIGHT_N = 9.80665


def at_rest(R: FloatArray, force_n: list[float], torque_nm: list[float] | None) -> SensorWindow:
    still = np.tile([0.4, 0.1, 0.3], (len(TIMES), 1))
    torque = None if torque_nm is None else np.array(torque_nm)
    return SensorWindow(TIMES, still, np.tile(R, (len(TIMES), 1, 1)), np.array(force_n), torque)


FREE = at_rest(DOWN, [0.3, -0.2, 0.1 - WEIGHT_N], [0.01, 0.02, 0.03])  # biases, and a tool that hangs and so pulls


def test_a_push_across_a_level_stick_is_the_force_and_its_torque_is_moved_to_the_tip() -> None:
    # weight along the sensor's +x: load -W x, torque 0.1 z x -W x = -0.1 W y; push 3 N along y: 0.15 z x 3 y = -0.45 x
    force_n = [0.3 - WEIGHT_N, -0.2 + 3.0, 0.1]
    now = at_rest(LEVEL, force_n, [0.01 - 0.45, 0.02 - 0.1 * WEIGHT_N, 0.03 + 0.2])
    found = tip_wrench(FREE, now, TOOL)
    np.testing.assert_allclose(found.force_n, [0.0, 3.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.torque_nm, [0.0, 0.0, 0.2], atol=1e-9)
    np.testing.assert_allclose(found.load_n, [-WEIGHT_N, 0.0, 0.0], atol=1e-9)


def test_a_sensor_of_three_axes_has_a_force_and_no_torque() -> None:
    free, now = (dataclasses.replace(one, torque_nm=None) for one in (FREE, at_rest(DOWN, [0.3, 0.8, 0.1], [0, 0, 0])))
    found = tip_wrench(free, now, TOOL)
    np.testing.assert_allclose(found.force_n, [0.0, 1.0, WEIGHT_N], atol=1e-9)
    assert found.torque_nm is None


def test_a_turned_sensor_that_reports_the_reaction_gives_the_same() -> None:
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    tool = dataclasses.replace(TOOL, R_tip_force=-turn, center_m=np.array([0, 0, 0.1]))

    def reported(window: SensorWindow) -> SensorWindow:
        assert window.torque_nm is not None
        return dataclasses.replace(window, force_n=-turn.T @ window.force_n, torque_nm=-turn.T @ window.torque_nm)

    now = at_rest(LEVEL, [0.3 - WEIGHT_N, 2.8, 0.1], [-0.44, 0.02 - 0.1 * WEIGHT_N, 0.23])
    found = tip_wrench(reported(FREE), reported(now), tool)
    np.testing.assert_allclose(found.force_n, [0.0, 3.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.torque_nm, [0.0, 0.0, 0.2], atol=1e-9)


def test_a_gain_is_in_forces_and_torques_alike() -> None:
    now = at_rest(DOWN, [0.3, -0.2 + 3.0, 0.1 - WEIGHT_N], [0.01 - 0.45, 0.02, 0.03])
    found = tip_wrench(FREE, now, TOOL, gain=1.5)
    np.testing.assert_allclose(found.force_n, [0.0, 2.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.torque_nm, [0.0, 0.0, 0.0], atol=1e-9)


def test_on_a_circle_the_tool_is_pulled_inwards() -> None:
    # 2 rad/s at 0.3 m: 1.2 m/s^2 towards the middle, for 1 kg that hangs 0.1 m below the sensor
    turns = Rotation.from_rotvec(np.outer(2.0 * TIMES, [0.0, 0.0, 1.0])).as_matrix()
    places = 0.3 * np.stack([np.cos(2.0 * TIMES), np.sin(2.0 * TIMES), 0.0 * TIMES], axis=1)
    window = SensorWindow(TIMES, places, turns @ DOWN, np.zeros(3), np.zeros(3))
    force_n, torque_nm = tool_load(window, TOOL)
    np.testing.assert_allclose(force_n, [-1.2, 0.0, -WEIGHT_N], atol=3e-3)
    np.testing.assert_allclose(torque_nm, [0.0, -0.12, 0.0], atol=3e-4)


def test_an_arm_that_begins_to_turn_accelerates_the_tool_at_its_distance() -> None:
    # 5 rad/s^2 about x through the arm's end, 1 kg at 0.15 m above it: 0.75 m/s^2 along -y
    turns = Rotation.from_rotvec(np.outer(2.5 * TIMES**2, [1.0, 0.0, 0.0])).as_matrix()
    force_n, torque_nm = tool_load(SensorWindow(TIMES, np.zeros((15, 3)), turns, np.zeros(3), np.zeros(3)), TOOL)
    np.testing.assert_allclose(force_n, [0.0, -0.75, WEIGHT_N], atol=1e-6)
    np.testing.assert_allclose(torque_nm, [0.075, 0.0, 0.0], atol=1e-7)


def test_too_few_states_of_the_arm_are_refused() -> None:
    window = SensorWindow(TIMES[:4], np.zeros((4, 3)), np.tile(np.eye(3), (4, 1, 1)), np.zeros(3), None)
    with pytest.raises(InputError, match="5 states of the arm"):
        tool_load(window, TOOL)
