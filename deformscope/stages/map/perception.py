"""Results between the frames of an exploration and its estimates (Thesis chapter 4): the pixels used, the error over
beta, and the training data of the fields."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.fit.estimate import Curve
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.regions.touches import StiffnessSample
from deformscope.stages.see.pixel_labels import PixelMasks


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """kernel; noise_scale: factor of the free points' noise; log_likelihood: marginal log likelihood of all points
    trials: how often the likelihood was computed"""

    kernel: Kernel
    noise_scale: float
    log_likelihood: float
    trials: int


@dataclass(frozen=True, slots=True)
class TrainedField:
    """Training data of a field of beta.

    kernel: the likeliest one, if several are averaged; noise: standard deviation of a value in addition to its own
    place_m: (n, 2) [m]; value: (n,) beta at these places; weight: (n,) 1 / variance of each"""

    kernel: Kernel
    noise: float
    place_m: FloatArray
    value: FloatArray
    weight: FloatArray


@dataclass(frozen=True, slots=True)
class LookPerception:
    """Input of the surface before any touch. masks: None for a robot that gives points, not images
    learned: hyper-parameters of its process, from this number of points without outliers"""

    masks: PixelMasks | None
    learned: Hyperparameters
    points: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPerception:
    """Input of a touch's estimate, and its training data; each None if missing.

    number: its number, from 1; masks: masks of its depth images, without those that did not show the surface; error:
    error over beta [m], the mean distance of particles from the points that they represent, while the estimate weighs
    these by their noise; estimate: estimated beta, one of the tried values
    stiffness: value that the map uses, with a weight of 1 / log_sd squared; beta: training data of the field of beta"""

    number: int
    masks: PixelMasks | None
    error: Curve | None
    estimate: float | None
    stiffness: StiffnessSample | None
    beta: TrainedField | None

    @property
    def error_m(self) -> float:
        """Error at the estimate."""
        assert self.error is not None
        assert self.estimate is not None
        return float(self.error.aee[np.argmin(np.abs(self.error.parameter - self.estimate))])


# Force and pose of the tip as one vector of nine numbers, at the force sensor's rate (Thesis 4.4)

NAMES = (*(f"F{axis} [N]" for axis in "xyz"), *(f"{axis} [m]" for axis in "xyz"), *(f"r{axis} [rad]" for axis in "xyz"))


@dataclass(frozen=True, slots=True)
class ForcePose:
    """Readings of force sensor and arm of a touch.

    host_ns: (n,) when each force arrived, on the host's clock; values: (n, 9) force on the tip [N], position of its
    middle [m], rotation vector of its frame [rad], all in the surface frame. Position and rotation are interpolated
    between the arm's states before and after: the force comes more often. Before the first state and after the last one
    they are those of that state."""

    host_ns: IntArray
    values: FloatArray


def force_pose(host_ns: IntArray, force_n: FloatArray, state_ns: IntArray, T_surface_tip: FloatArray) -> ForcePose:
    """Forces (n, 3) [N] with the pose at their times: positions linearly, rotations along the shortest turn (slerp).

    state_ns: (m,) rising, of poses T_surface_tip (m, 4, 4). A rotation is given by several rotation vectors, which
    differ by whole turns. The vector nearest to the first is returned, so that rows do not jump."""
    from scipy.spatial.transform import Rotation, Slerp

    turn = Rotation.from_matrix(T_surface_tip[:, :3, :3])
    at = np.clip(host_ns, state_ns[0], state_ns[-1]) - state_ns[0]
    if len(state_ns) > 1:
        turn = Slerp(state_ns - state_ns[0], turn)(at)
    position = np.column_stack([np.interp(at, state_ns - state_ns[0], T_surface_tip[:, axis, 3]) for axis in range(3)])
    vector = np.broadcast_to(turn.as_rotvec(), (len(host_ns), 3))
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    other = vector * (1.0 - 2.0 * np.pi / np.maximum(angle, 1e-12))
    nearer = np.linalg.norm(other - vector[:1], axis=1) < np.linalg.norm(vector - vector[:1], axis=1)
    vector = np.where(nearer[:, None], other, vector)
    return ForcePose(host_ns, np.column_stack([force_n, position, vector]))


Perception = LookPerception | TouchPerception | ForcePose
"""What an exploration records between frames and estimates."""
