"""Force and pose at the force's rate: the poses between the arm's states are those of an interpolation of our own."""

import numpy as np
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.stages.map.perception import NAMES, force_pose


def between(one: FloatArray, other: FloatArray, share: float) -> FloatArray:
    """(3, 3) share of the turn from one rotation to another, by the angle and the axis of what is between them."""
    turn = one.T @ other
    angle = np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (2 * np.sin(angle))
    cross = np.cross(np.eye(3), axis)  # cross @ v is the cross product of axis and v
    part = share * angle
    return np.asarray(one @ (np.eye(3) + np.sin(part) * cross + (1.0 - np.cos(part)) * cross @ cross))


def test_poses_are_between_the_arms_states() -> None:
    rng = np.random.default_rng(0)
    state_ns = 8_000_000_000 + np.array([0, 10, 21, 30, 44]) * 1_000_000
    turn = Rotation.from_rotvec([3.1, 0.05, 0.02]) * Rotation.from_rotvec(0.1 * rng.normal(size=(5, 3)))
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = turn.as_matrix(), rng.normal(size=(5, 3))
    host_ns = state_ns[0] + np.sort(rng.integers(-3_000_000, 47_000_000, 60))
    force = rng.normal(size=(60, 3))
    found = force_pose(host_ns, force, state_ns, T)
    assert found.values.shape == (60, len(NAMES))
    np.testing.assert_array_equal(found.host_ns, host_ns)
    np.testing.assert_array_equal(found.values[:, :3], force)
    for row, when in zip(found.values, host_ns, strict=True):
        at = min(max(int(np.searchsorted(state_ns, when, side="right")) - 1, 0), 3)
        share = min(max((when - state_ns[at]) / (state_ns[at + 1] - state_ns[at]), 0.0), 1.0)
        np.testing.assert_allclose(row[3:6], (1 - share) * T[at, :3, 3] + share * T[at + 1, :3, 3], atol=1e-9)
        expected = between(T[at, :3, :3], T[at + 1, :3, :3], share)
        np.testing.assert_allclose(Rotation.from_rotvec(row[6:]).as_matrix(), expected, atol=1e-9)


def test_a_rotation_near_half_a_turn_does_not_jump() -> None:
    state_ns = np.arange(20) * 10_000_000
    T = np.tile(np.eye(4), (20, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(np.pi + 0.01 * (-1.0) ** np.arange(20), [1, 0, 0])).as_matrix()
    found = force_pose(np.arange(0, 190_000_000, 1_000_000), np.zeros((190, 3)), state_ns, T)
    assert np.abs(np.diff(found.values[:, 6:], axis=0)).max() < 0.01
    one = force_pose(np.array([3, 5]), np.zeros((2, 3)), state_ns[:1], T[:1])
    np.testing.assert_allclose(Rotation.from_rotvec(one.values[:, 6:]).as_matrix(), np.tile(T[0, :3, :3], (2, 1, 1)))
