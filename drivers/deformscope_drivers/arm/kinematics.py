"""Poses of an arm's links for given joint angles, and joint angles for a given pose of its end.

Joints are in degrees, as vendors' interfaces give and take them; lengths are in metres, rotations in radians. Every
joint turns about the z axis of its own frame, so a child's pose in its parent is `origin @ rotation_z(angle)`."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
GRAVITY_M_S2 = 9.81
LEVER_M = 0.2
"""Lever with which a rotation is compared with a velocity: length of hand, stick and tip."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A revolute joint and the link that it carries.

    xyz_m, rpy_rad: the joint's frame in its parent's at angle 0, as in a URDF (fixed-axis roll, pitch, yaw)
    lower_deg, upper_deg: the range, both None where the joint turns without end
    velocity_deg_s, effort_nm: the greatest speed and torque; mass_kg: mass of the link that the joint carries"""

    xyz_m: tuple[float, float, float]
    rpy_rad: tuple[float, float, float]
    lower_deg: float | None
    upper_deg: float | None
    velocity_deg_s: float
    effort_nm: float
    mass_kg: float


@dataclass(frozen=True, slots=True)
class InverseResult:
    """Result of inverse kinematics. joints_deg: (n,) the best joint angles found, within the limits, whether or not
    they reach the target [deg]; converged: both errors are within the requested tolerances; position_error_m,
    rotation_error_rad: residuals at joints_deg"""

    joints_deg: FloatArray
    converged: bool
    position_error_m: float
    rotation_error_rad: float


class Chain:
    """A serial arm: its joints from base to hand, and the end effector behind the last one."""

    def __init__(
        self,
        name: str,
        joints: tuple[Joint, ...],
        end_effector_xyz_m: tuple[float, float, float],
        end_effector_rpy_rad: tuple[float, float, float],
        home_deg: tuple[float, ...],
    ) -> None:
        self.name = name
        self.joints = joints
        self.joint_count = len(joints)
        self.home_deg: FloatArray = np.array(home_deg)
        self.lower_deg: FloatArray = np.array([-np.inf if j.lower_deg is None else j.lower_deg for j in joints])
        self.upper_deg: FloatArray = np.array([np.inf if j.upper_deg is None else j.upper_deg for j in joints])
        self.velocity_deg_s: FloatArray = np.array([j.velocity_deg_s for j in joints])
        self.effort_nm: FloatArray = np.array([j.effort_nm for j in joints])
        self._identity = np.eye(self.joint_count)
        self.end_effector_rpy_rad = end_effector_rpy_rad
        self._T_parent_joint = np.array([transform(rotation_from_rpy(*j.rpy_rad), j.xyz_m) for j in joints])
        self.T_last_end_effector: FloatArray = transform(rotation_from_rpy(*end_effector_rpy_rad), end_effector_xyz_m)
        self._latest: tuple[bytes, FloatArray] = (b"", np.empty(0))
        weights_n = -GRAVITY_M_S2 * np.array([joint.mass_kg for joint in joints])
        self._weights_n = weights_n[:, None]
        # each joint carries all links behind it
        self._carried_n = np.cumsum(weights_n[::-1])[::-1, None]

    def forward(self, joints_deg: npt.ArrayLike) -> FloatArray:
        """`T_base_link` of every joint's link and, last, of the end effector: (..., n + 1, 4, 4) [m], not to be written
        to; joints_deg (..., n)."""
        joints = self._joints(joints_deg)
        if joints.ndim > 1:
            return self._forward(joints)
        # in one control period several ask for the same pose
        asked, (known, latest) = joints.tobytes(), self._latest
        if asked != known:
            latest = self._forward(joints)
            latest.flags.writeable = False
            self._latest = asked, latest
        return latest

    def _forward(self, joints_deg: FloatArray) -> FloatArray:
        angles_rad = np.radians(joints_deg)[..., None]
        cosines, sines = np.cos(angles_rad), np.sin(angles_rad)
        x, y = self._T_parent_joint[:, :, 0], self._T_parent_joint[:, :, 1]
        T_base_links = np.empty((*angles_rad.shape[:-2], self.joint_count + 1, 4, 4))
        turned = np.empty_like(T_base_links[..., 1:, :, :])
        turned[...] = self._T_parent_joint
        # a turn about z mixes the first two columns and leaves the others
        turned[..., 0] = cosines * x + sines * y
        turned[..., 1] = cosines * y - sines * x
        T_base_link: FloatArray = np.eye(4)
        for index in range(self.joint_count):
            T_base_link = np.matmul(T_base_link, turned[..., index, :, :], out=T_base_links[..., index, :, :])
        np.matmul(T_base_link, self.T_last_end_effector, out=T_base_links[..., -1, :, :])
        return T_base_links

    def end_effector(self, joints_deg: npt.ArrayLike) -> FloatArray:
        """`T_base_end_effector` (4, 4) [m] for joints_deg (n,)."""
        pose: FloatArray = self.forward(joints_deg)[-1].copy()
        return pose

    def jacobian(self, joints_deg: npt.ArrayLike) -> FloatArray:
        """Geometric Jacobian of the end effector in the base frame, (6, n), per radian.

        Rows are linear velocity [m/rad], then angular velocity [rad/rad]: `twist = jacobian @ radians(rate_deg_s)`."""
        return jacobian_of(self.forward(joints_deg))

    def gravity_torque_nm(self, T_base_links: FloatArray) -> FloatArray:
        """Torque (n,) [Nm] that holds the links up, base standing upright; T_base_links as from `forward`.

        Each link's mass is assumed midway to the next joint: the published data have no more."""
        axes, origins_m = T_base_links[:-1, :3, 2], T_base_links[:-1, :3, 3]
        centres_m = 0.5 * (origins_m + T_base_links[1:, :3, 3])
        # of all links behind each joint: the moment of their weight about the base's origin
        moment_nm = np.cumsum((self._weights_n * centres_m)[::-1], axis=0)[::-1] - self._carried_n * origins_m
        return axes[:, 1] * moment_nm[:, 0] - axes[:, 0] * moment_nm[:, 1]

    def clip(self, joints_deg: npt.ArrayLike, margin_deg: float = 0.0) -> FloatArray:
        """joints_deg (n,) brought within the joints' ranges, or margin_deg inside them."""
        return np.clip(self._joints(joints_deg), self.lower_deg + margin_deg, self.upper_deg - margin_deg)

    def to_limits_deg(self, joints_deg: npt.ArrayLike) -> FloatArray:
        """(n,) from each joint of joints_deg (n,) to the nearer end of its range [deg]; inf where it has no end."""
        joints = self._joints(joints_deg)
        return np.minimum(joints - self.lower_deg, self.upper_deg - joints)

    def within_limits(self, joints_deg: npt.ArrayLike, slack_deg: float = 1e-9) -> bool:
        """Whether every joint of joints_deg (n,) is within its range."""
        joints = self._joints(joints_deg)
        return bool(np.all(joints >= self.lower_deg - slack_deg) and np.all(joints <= self.upper_deg + slack_deg))

    def inverse(
        self,
        T_base_end_effector: FloatArray,
        start_deg: npt.ArrayLike | None = None,
        *,
        position_tolerance_m: float = 1e-5,
        rotation_tolerance_rad: float = 1e-4,
        starts: int = 20,
        iterations: int = 100,
        seed: int = 0,
        margin_deg: float = 0.0,
    ) -> InverseResult:
        """Joint angles that bring the end effector to a pose, by damped least squares from several starts.

        T_base_end_effector: (4, 4) the requested pose [m]; start_deg: (n,) first start (default: the home pose);
        further starts are drawn with the seed; margin_deg: distance of the joints from the ends of their ranges. The
        first start that converges ends the search. Out of reach is no error: `converged` is then False."""
        target = np.asarray(T_base_end_effector, dtype=float)
        if target.shape != (4, 4) or not np.all(np.isfinite(target)):
            raise ValueError(f"expected a finite 4 x 4 pose of the end effector; came {target.shape} {target.tolist()}")
        rng = np.random.default_rng(seed)
        lower = np.where(np.isfinite(self.lower_deg), self.lower_deg + margin_deg, 0.0)
        upper = np.where(np.isfinite(self.upper_deg), self.upper_deg - margin_deg, 360.0)
        joints = self.clip(self.home_deg if start_deg is None else start_deg, margin_deg)
        best: tuple[float, FloatArray, FloatArray] | None = None
        for _ in range(max(starts, 1)):
            (found,), (error,) = self._descend(
                target[None], joints[None], margin_deg, position_tolerance_m, rotation_tolerance_rad, iterations
            )
            cost = float(error @ error)
            if best is None or cost < best[0]:
                best = cost, found, error
            if _within(error, position_tolerance_m, rotation_tolerance_rad).all():
                break
            joints = rng.uniform(lower, upper)
        assert best is not None
        _, found, error = best
        return InverseResult(
            joints_deg=found,
            converged=bool(_within(error, position_tolerance_m, rotation_tolerance_rad)),
            position_error_m=float(np.linalg.norm(error[:3])),
            rotation_error_rad=float(np.linalg.norm(error[3:])),
        )

    def inverse_near(
        self,
        T_base_end_effectors: FloatArray,
        start_deg: npt.ArrayLike,
        *,
        position_tolerance_m: float = 1e-5,
        rotation_tolerance_rad: float = 1e-4,
        margin_deg: float = 0.0,
    ) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        """Like `inverse`, with one start each for many poses (k, 4, 4) at once: joint angles (k, n), and whether they
        converged (k,). start_deg: (n,), or (k, n) for each its own"""
        tolerances = position_tolerance_m, rotation_tolerance_rad
        start = np.broadcast_to(self.clip(start_deg, margin_deg), (len(T_base_end_effectors), self.joint_count))
        found, error = self._descend(T_base_end_effectors, start, margin_deg, *tolerances, 100)
        return found, _within(error, *tolerances)

    def _descend(
        self,
        target: FloatArray,
        start_deg: FloatArray,
        margin_deg: float,
        position_m: float,
        rotation_rad: float,
        iterations: int,
    ) -> tuple[FloatArray, FloatArray]:
        """Levenberg-Marquardt from one start (k, n) for each target (k, 4, 4), joints at a limit held there; returns
        joints (k, n) and error twists (k, 6)."""
        lower, upper = self.lower_deg + margin_deg, self.upper_deg - margin_deg
        ended_deg, ended_error = np.empty(start_deg.shape), np.empty((len(target), 6))
        going, joints_deg, links = np.arange(len(target)), start_deg, self.forward(start_deg)
        error, damping = pose_error(links[:, -1], target), np.full(len(target), 1e-2)
        for _ in range(iterations):
            ended = _within(error, position_m, rotation_rad) | (damping > 1e6)
            if ended.any():
                ended_deg[going[ended]], ended_error[going[ended]] = joints_deg[ended], error[ended]
                on = ~ended
                going, target, joints_deg, links = going[on], target[on], joints_deg[on], links[on]
                error, damping = error[on], damping[on]
            if not len(going):
                break
            jacobian = jacobian_of(links)
            gradient = (jacobian.swapaxes(1, 2) @ error[..., None])[..., 0]
            # a joint at its limit that the gradient would push further is no freedom in this step
            held = ((joints_deg <= lower) & (gradient < 0)) | ((joints_deg >= upper) & (gradient > 0))
            free = np.where(held, 0.0, 1.0)
            jacobian = jacobian * free[:, None]
            normal = jacobian.swapaxes(1, 2) @ jacobian + damping[:, None, None] * self._identity
            change_deg = np.degrees(np.linalg.solve(normal, (gradient * free)[..., None])[..., 0])
            longest = np.abs(change_deg).max(axis=1)
            change_deg *= (45.0 / np.maximum(longest, 45.0))[:, None]
            tried = self.clip(joints_deg + change_deg, margin_deg)
            tried_links = self.forward(tried)
            tried_error = pose_error(tried_links[:, -1], target)
            better = squared(tried_error) < squared(error)
            joints_deg = np.where(better[:, None], tried, joints_deg)
            links = np.where(better[:, None, None, None], tried_links, links)
            error = np.where(better[:, None], tried_error, error)
            damping = np.where(better, np.maximum(damping / 5.0, 1e-9), damping * 4.0)
        ended_deg[going], ended_error[going] = joints_deg, error
        return ended_deg, ended_error

    def _joints(self, joints_deg: npt.ArrayLike) -> FloatArray:
        """(..., n) joint angles [deg], checked."""
        joints = np.asarray(joints_deg, dtype=float)
        if joints.shape[-1:] != (self.joint_count,):
            raise ValueError(f"{self.name} has {self.joint_count} joints; got an array of shape {joints.shape}")
        return joints


def jacobian_of(T_base_links: FloatArray) -> FloatArray:
    """Geometric Jacobian (..., 6, n) [m/rad; rad/rad] in the base frame from the poses that `Chain.forward` gives."""
    axes, origins_m = T_base_links[..., :-1, :3, 2], T_base_links[..., :-1, :3, 3]
    jacobian = np.empty((*axes.shape[:-2], 6, axes.shape[-2]))
    jacobian[..., :3, :] = cross(axes, T_base_links[..., -1:, :3, 3] - origins_m).swapaxes(-1, -2)
    jacobian[..., 3:, :] = axes.swapaxes(-1, -2)
    return jacobian


def pose_error(T_base_from: FloatArray, T_base_to: FloatArray) -> FloatArray:
    """Twist (..., 6) [m, rad] in the base frame that carries one pose (..., 4, 4) to another within unit time."""
    error = np.empty((*T_base_from.shape[:-2], 6))
    error[..., :3] = T_base_to[..., :3, 3] - T_base_from[..., :3, 3]
    error[..., 3:] = rotation_vector(T_base_to[..., :3, :3] @ T_base_from[..., :3, :3].swapaxes(-1, -2))
    return error


def damped_joint_rates(
    jacobian: FloatArray, twist: FloatArray, damping: float = 0.02, wish_rad_s: FloatArray | None = None
) -> FloatArray:
    """Joint rates (..., n) [rad/s] for a twist (..., 6) [m/s, rad/s]: the pseudo-inverse, damped only near
    singularities.

    damping: smallest singular value that is still inverted in full. Below it the rates are bounded, and the twist is
    then not reached (Nakamura and Hanafusa 1986; Maciejewski and Klein 1988).
    wish_rad_s: (n,) desired rates in the null space of the end's motion, for more than six joints (Liegeois 1977)"""
    left, values, right = np.linalg.svd(jacobian, full_matrices=wish_rad_s is not None)
    least = values[..., -1:]
    extra = np.where(least >= damping, 0.0, (1.0 - (least / damping) ** 2) * damping**2)
    along = values / (values**2 + extra) * (left.swapaxes(-1, -2) @ twist[..., None])[..., 0]
    rates: FloatArray = (right[..., : values.shape[-1], :].swapaxes(-1, -2) @ along[..., None])[..., 0]
    if wish_rad_s is not None:
        free = right[..., values.shape[-1] :, :]
        rates = rates + (free.swapaxes(-1, -2) @ (free @ wish_rad_s)[..., None])[..., 0]
    return rates


def off_course(jacobian: FloatArray, rates_rad_s: FloatArray, twist: FloatArray) -> FloatArray:
    """The share of a twist (..., 6) that joint rates (..., n) lack because of damping, 0 to 1."""
    made = (jacobian @ rates_rad_s[..., None])[..., 0]
    return np.asarray(twist_size(made - twist) / np.maximum(twist_size(twist), 1e-12))


def twist_size(twist: FloatArray) -> FloatArray:
    """(...,) size of twists (..., 6), the rotation taken LEVER_M from the end effector [m/s]."""
    return np.asarray(np.hypot(np.sqrt(squared(twist[..., :3])), LEVER_M * np.sqrt(squared(twist[..., 3:]))))


def least_singular(jacobian: FloatArray) -> FloatArray:
    """Smallest singular value (...,) of a geometric Jacobian (..., 6, n) [m/rad; rad/rad]: 0 at a singularity.

    Joint rates of size r move the end effector by `least_singular * r` in the weakest direction, else by more."""
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[..., -1])


def transform(rotation: FloatArray, translation_m: npt.ArrayLike) -> FloatArray:
    """Homogeneous transform (4, 4) of a rotation (3, 3) and a translation (3,) [m]."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation_m
    return matrix


def rotation_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """Rotation (3, 3) of a URDF's roll, pitch and yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    return _rotation(2, yaw_rad) @ _rotation(1, pitch_rad) @ _rotation(0, roll_rad)


def rotation_from_euler_xyz(theta_x_rad: float, theta_y_rad: float, theta_z_rad: float) -> FloatArray:
    """Rotation (3, 3) of the vendor's ThetaX, ThetaY, ThetaZ: Rx Ry Rz (as kinova_driver states for its poses)."""
    return _rotation(0, theta_x_rad) @ _rotation(1, theta_y_rad) @ _rotation(2, theta_z_rad)


def euler_xyz_from_rotation(rotation: FloatArray) -> FloatArray:
    """The vendor's (ThetaX, ThetaY, ThetaZ) [rad] of a rotation (3, 3); ThetaX is 0 where they are not unique."""
    sine = float(np.clip(rotation[0, 2], -1.0, 1.0))
    theta_y = np.arcsin(sine)
    if abs(sine) > 1.0 - 1e-12:
        return np.array([0.0, theta_y, np.arctan2(rotation[1, 0], rotation[1, 1])])
    theta_x = np.arctan2(-rotation[1, 2], rotation[2, 2])
    theta_z = np.arctan2(-rotation[0, 1], rotation[0, 0])
    return np.array([theta_x, theta_y, theta_z])


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Axis times angle (..., 3) [rad] of a rotation (..., 3, 3), the angle from 0 to pi."""
    twice_sine = np.empty(rotation.shape[:-1])
    twice_sine[..., 0] = rotation[..., 2, 1] - rotation[..., 1, 2]
    twice_sine[..., 1] = rotation[..., 0, 2] - rotation[..., 2, 0]
    twice_sine[..., 2] = rotation[..., 1, 0] - rotation[..., 0, 1]
    sine = 0.5 * np.sqrt(squared(twice_sine))
    cosine = 0.5 * (rotation[..., 0, 0] + rotation[..., 1, 1] + rotation[..., 2, 2] - 1.0)
    small = sine <= 1e-6
    vector: FloatArray = (
        twice_sine * np.where(small, 0.5, 0.5 * np.arctan2(sine, cosine) / np.where(small, 1.0, sine))[..., None]
    )
    if (half := small & (cosine <= 0)).any():
        vector[half] = [_half_turn(*both) for both in zip(rotation[half], twice_sine[half], strict=True)]
    return vector


def _half_turn(rotation: FloatArray, twice_sine: FloatArray) -> FloatArray:
    """`rotation_vector` (3,) of a rotation (3, 3) so near half a turn that its skew part vanishes: the axis is then the
    greatest column of R + 1."""
    angle = np.arctan2(0.5 * np.sqrt(squared(twice_sine)), 0.5 * (np.trace(rotation) - 1.0))
    outer = 0.5 * (rotation + np.eye(3))
    column = outer[:, int(np.argmax(np.diag(outer)))]
    side = -1.0 if column @ twice_sine < 0 else 1.0
    return np.asarray(side * angle * column / np.linalg.norm(column))


def squared(vector: FloatArray) -> FloatArray:
    """(...,) squared lengths of vectors (..., n)."""
    return np.asarray((vector[..., None, :] @ vector[..., None])[..., 0, 0])


def _within(error: FloatArray, position_m: float, rotation_rad: float) -> npt.NDArray[np.bool_]:
    """(...,) whether the residuals of poses (..., 6) are within tolerances."""
    return np.asarray((squared(error[..., :3]) <= position_m**2) & (squared(error[..., 3:]) <= rotation_rad**2))


def _rotation(axis: int, angle_rad: float) -> FloatArray:
    """(3, 3) rotation about x, y or z."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = cosine
    matrix[first, second], matrix[second, first] = -sine, sine
    return matrix


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products of (..., 3) with (..., 3); np.cross costs more than a whole Jacobian at this size."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    product[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    product[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
