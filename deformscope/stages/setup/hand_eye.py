"""Pose of a fixed camera that sees a board which the arm carries, and pose of the board on the arm; or from touches.

Each view gives A Y = X B. A, the arm's end in its base frame, and B, the board in the camera's, are known; X, the
camera in the base frame, and Y, the board on the arm's end, are sought."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup import transform
from deformscope.stages.setup.board import CharucoSpec, LensEstimate, SeenBoard, board_pose, lens

FEWEST_VIEWS = 6
LEAST_SPREAD_RAD = np.radians(7.0)
"""Smallest rotation of the arm about the second of its axes of rotation."""
FAR_M, FAR_RAD = 0.02, np.radians(4.0)
"""A view that is off by more does not belong to the others."""
NEAR_BASE_M = 0.3
"""A camera that is nearer to the arm's base, and nearer than the board to the arm's end, is the board, seen from it."""
LEVER_M = 0.2
"""Distance from the board at which a rotation counts as much as a translation."""
TOUCHED = transform.ErrorPrior(0.002)
"""Deviation between a place as it was touched and as the camera sees it [m]."""
TURNS_DEG = (-30.0, 30.0)
WEIGHT = np.repeat([1.0, LEVER_M], 3)
STEPS = 6
"""Number of Gauss-Newton steps, from a closed form that is near the solution."""


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """T_arm_camera: camera to base frame; T_ee_board: board to the arm's end
    off: (n, 6) offset of each view, in the board's frame [m, rad]"""

    T_arm_camera: transform.TransformEstimate
    T_ee_board: transform.TransformEstimate
    off: FloatArray


def hand_eye(T_base_ee: FloatArray, T_camera_board: FloatArray) -> HandEye:
    """Pose of the camera and of the board on the arm, from n views: (n, 4, 4) each.

    Their uncertainty is found by leaving out each view in turn (jackknife): neither the errors of arm and camera nor
    their ratio need be known. Raises InputError for too few views, turns about one axis alone, views that contradict
    each other, and poses that belong together, or are where a camera can be, once they are inverted."""
    A, B = np.asarray(T_base_ee, np.float64), np.asarray(T_camera_board, np.float64)
    if len(A) < FEWEST_VIEWS:
        raise InputError(f"{FEWEST_VIEWS} views of the board or more", str(len(A)), "12, turned each by 30 degrees")
    check_turns(A)
    X, Y, left_over = _solved(A, B)
    if (far := _far(left_over)).any() or not _possible(X, Y, B):
        _check_inverted(A, B, agree=not far.any())
    if far.any():
        off_mm = 1e3 * np.linalg.norm(left_over[:, :3], axis=1)
        worst = int(np.argmax(np.linalg.norm(left_over * WEIGHT, axis=1)))
        came = f"view {worst + 1} off by {off_mm[worst]:.0f} mm"
        hint = "the board fixed to the arm's end; leave that view out"
        if len(A) <= FEWEST_VIEWS or _far(_solved(np.delete(A, worst, 0), np.delete(B, worst, 0))[2]).any():
            came = f"{far.sum()} of {len(A)} views off, by {off_mm[far].min():.0f} to {off_mm.max():.0f} mm"
            hint = "poses in m, of arm and board at the same moment, the board fixed to the arm's end"
        raise InputError("views that belong together", came, hint)
    J, r = _jacobian(A, B, X, Y) * WEIGHT[:, None], left_over * WEIGHT
    normal = np.einsum("nij,nik->njk", J, J)
    whole, pull = normal.sum(axis=0), np.einsum("nij,ni->nj", J, r)
    # each view left out of the linear fit around the solution
    without = [-np.linalg.solve(whole - one, pull.sum(axis=0) - by) for one, by in zip(normal, pull, strict=True)]
    return jackknifed(X, Y, np.array(without), left_over)


def jackknifed(T_arm_camera: FloatArray, T_ee_board: FloatArray, without: FloatArray, off: FloatArray) -> HandEye:
    """Both poses (4, 4), with the covariance of their deviations (n, 12) when each of n views is left out (Efron 1982).
    off: as in HandEye"""
    apart = without - without.mean(axis=0)
    covariance = (len(apart) - 1.0) / len(apart) * apart.T @ apart
    camera = transform.TransformEstimate(T_arm_camera, covariance[:6, :6], len(apart) - 2.0)
    return HandEye(camera, transform.TransformEstimate(T_ee_board, covariance[6:, 6:], len(apart) - 2.0), off)


def _solved(A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """X and Y (4, 4), and what is left over (n, 6)."""
    X, Y = _start(A, B)
    for _ in range(STEPS):
        J = _jacobian(A, B, X, Y) * WEIGHT[:, None]
        step = -np.linalg.lstsq(J.reshape(-1, 12), (_off(A, B, X, Y) * WEIGHT).ravel(), rcond=None)[0]
        X, Y = transform.moved(X, step[:6]), transform.moved(Y, step[6:])
    return X, Y, _off(A, B, X, Y)


def _far(off: FloatArray) -> BoolArray:
    """(n,) views that are off by too much (n, 6)."""
    return np.asarray((np.linalg.norm(off[:, :3], axis=1) > FAR_M) | (np.linalg.norm(off[:, 3:], axis=1) > FAR_RAD))


def _possible(X: FloatArray, Y: FloatArray, B: FloatArray) -> bool:
    """Whether the camera has the board before it, and does not stand where the arm does."""
    camera_m, board_m = (float(np.linalg.norm(one[:3, 3])) for one in (X, Y))
    return bool((B[:, 2, 3] > 0.0).all()) and camera_m > min(board_m, NEAR_BASE_M)


def _check_inverted(A: FloatArray, B: FloatArray, *, agree: bool) -> None:
    """Raises InputError if the poses belong together once some are inverted: A Y = X B holds as well for the inverses
    of both, with X and Y exchanged. agree: the poses belong together as they are"""
    back_A, back_B = np.linalg.inv(A), np.linalg.inv(B)
    tried = {"T_base_ee": (back_A, B), "T_camera_board": (A, back_B)}
    if agree:
        tried = {"T_base_ee and T_camera_board": (back_A, back_B)}
    likely = []
    for name, (a, b) in tried.items():
        X, Y, off = _solved(a, b)
        if not _far(off).any():
            nearer = float(np.linalg.norm(Y[:3, 3])) < float(np.linalg.norm(X[:3, 3]))
            likely.append((_possible(X, Y, b), nearer, name))
    if likely and (best := max(likely))[0] >= agree:
        name, what = best[2], "a camera at the arm's base, or views of a board behind it"
        what = what if agree else "views that contradict each other, as of a camera on the arm"
        raise InputError(
            "T_base_ee (the arm's end in its base) and T_camera_board (the board before a fixed camera)",
            f"{what}; with {name} inverted they agree",
            f"np.linalg.inv({name.replace(' and ', '), np.linalg.inv(')})",
        )


def turned_about(T: FloatArray) -> float:
    """Rotation of poses (n, 4, 4): root mean square of their turns about the second of the axes that they are about
    [rad]."""
    between = Rotation.from_matrix(T[:, :3, :3])
    mean = between.mean()
    turns = (mean.inv() * between).as_rotvec()
    return float(np.sqrt(np.linalg.eigvalsh(turns.T @ turns / len(T))[1]))


def check_turns(T_base_ee: FloatArray) -> None:
    """Raises InputError, with the next pose to take, unless poses (n, 4, 4) are turned about two axes."""
    if (reached := turned_about(T_base_ee)) < LEAST_SPREAD_RAD:
        raise InputError(
            f"views turned by {np.degrees(LEAST_SPREAD_RAD):.0f} degrees or more about two axes",
            f"turns by {np.degrees(reached):.0f} degrees about the second axis",
            f"{next_pose(T_base_ee)[1]}, and take more views",
        )


def _off(A: FloatArray, B: FloatArray, X: FloatArray, Y: FloatArray) -> FloatArray:
    """(n, 6) from the board's pose by the arm to its pose by the camera, in the board's frame."""
    return transform.deviation(np.broadcast_to(np.eye(4), A.shape), np.linalg.inv(A @ Y) @ (X @ B))


def _start(A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """X and Y (4, 4) in closed form, of A and B (n, 4, 4): rotations from the null space of R_A R_Y = R_X R_B, then
    translations (Li 2010)."""
    rows = []
    for a, b in zip(A[:, :3, :3], B[:, :3, :3], strict=True):
        rows.append(np.hstack([np.kron(np.eye(3), b.T), -np.kron(a, np.eye(3))]))  # vec(R_X) then vec(R_Y), by rows
    null = np.linalg.svd(np.vstack(rows), full_matrices=False)[2][-1]
    x, y = null[:9].reshape(3, 3), null[9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(x))
    turn_x, turn_y = (_nearest(sign * one) for one in (x, y))
    design = np.concatenate([np.broadcast_to(np.eye(3), (len(A), 3, 3)), -A[:, :3, :3]], axis=2).reshape(-1, 6)
    wanted = (A[:, :3, 3] - B[:, :3, 3] @ turn_x.T).ravel()
    ways = np.linalg.lstsq(design, wanted, rcond=None)[0]
    return transform.rigid(turn_x, ways[:3]), transform.rigid(turn_y, ways[3:])


def _nearest(matrix: FloatArray) -> FloatArray:
    """(3, 3) rotation nearest to a matrix."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _jacobian(A: FloatArray, B: FloatArray, X: FloatArray, Y: FloatArray) -> FloatArray:
    """(n, 6, 12) of `_off` by deviations of X and Y, for small turns that are left over."""
    turn = np.swapaxes(A[:, :3, :3] @ Y[:3, :3], -1, -2)
    back = np.broadcast_to(Y[:3, :3].T, turn.shape)
    J = np.zeros((len(A), 6, 12))
    J[:, :3, :3], J[:, 3:, 3:6] = turn, turn
    J[:, :3, 3:6] = -turn @ _cross(B[:, :3, 3] @ X[:3, :3].T)
    J[:, :3, 6:9], J[:, 3:, 9:] = -back, -back
    J[:, :3, 9:] = back @ _cross((np.linalg.inv(A) @ X @ B)[:, :3, 3] - Y[:3, 3])
    return J


def _cross(vectors: FloatArray) -> FloatArray:
    """(n, 3, 3) by which others are multiplied for the cross product of vectors (n, 3) with them."""
    made = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    made[:, 0, 1], made[:, 0, 2], made[:, 1, 2] = -z, y, -x
    return made - np.swapaxes(made, -1, -2)


def next_pose(T_base_ee: FloatArray) -> tuple[FloatArray, str]:
    """A pose (4, 4) of the arm's end whose turn adds most information to the poses (n, 4, 4) so far, and how to reach
    it.

    It is the mean of the poses, turned about the axis of the end, and in the direction, that maximize the turns' least
    eigenvalues."""
    poses = np.asarray(T_base_ee, np.float64)
    turned = Rotation.from_matrix(poses[:, :3, :3])
    mean = turned.mean()
    turns = (mean.inv() * turned).as_rotvec()
    most, way, turned_by = 0.0, np.zeros(3), ""
    for axis in range(3):
        for angle_deg in TURNS_DEG:
            more = np.radians(angle_deg) * np.eye(3)[axis]
            with_it = np.vstack([turns, more])
            centred = with_it - with_it.mean(axis=0)
            gained = float(np.prod(np.linalg.eigvalsh(centred.T @ centred) + np.radians(3.0) ** 2))
            if gained > most * (1.0 + 1e-9):
                most, way, turned_by = gained, more, f"{angle_deg:+.0f} degrees about its own {'xyz'[axis]} axis"
    T = transform.rigid((mean * Rotation.from_rotvec(way)).as_matrix(), poses[:, :3, 3].mean(axis=0))
    return T, f"from the middle of the poses turn the arm's end by {turned_by}, the board in view"


@dataclass(frozen=True, slots=True, eq=False)
class CameraFromTouches:
    """T_arm_camera: camera to base frame; off_m: (n,) offset of each place; sd_m: deviation of a place [m]"""

    T_arm_camera: transform.TransformEstimate
    off_m: FloatArray
    sd_m: float


def camera_from_touches(touched_m: FloatArray, seen_m: FloatArray) -> CameraFromTouches:
    """Pose of the fixed camera that sees places (n, 3) [camera frame] which the tip touched (n, 3) [base frame]. Raises
    InputError for fewer than four, or places in one line."""
    touched, seen = np.asarray(touched_m, np.float64), np.asarray(seen_m, np.float64)
    if len(touched) < 4:
        raise InputError("4 places or more", str(len(touched)), "six, spread over the camera's image")
    wide_m = np.linalg.svd(touched - touched.mean(axis=0), compute_uv=False) / np.sqrt(len(touched))
    if wide_m[1] < 0.02:
        raise InputError("places that are not in one line", f"{1e3 * wide_m[1]:.0f} mm off one", "touch off that line")
    start = transform.superposed(seen, touched)

    def off_m(values: FloatArray) -> FloatArray:
        T = transform.moved(start, values)
        return seen @ T[:3, :3].T + T[:3, 3] - touched

    found = transform.fitted(lambda values: off_m(values).ravel(), np.zeros(6), TOUCHED)
    far_m = np.linalg.norm(off_m(found.value), axis=1)
    if found.scatter > 10.0 * TOUCHED.sd:
        came = f"place {int(np.argmax(far_m)) + 1} off by {1e3 * far_m.max():.0f} mm"
        raise InputError("places that belong together", came, "touch the marked places, in the same order")
    return CameraFromTouches(transform.transform_of(found, start), far_m, found.sd)


@dataclass(frozen=True, slots=True, eq=False)
class CameraEstimate:
    """mount: where camera and board are; lens: the fitted lens, None if it was given"""

    mount: HandEye
    lens: LensEstimate | None


@dataclass(frozen=True, slots=True)
class KnownLens:
    """Projection of a camera. focal_px, center_px: (x, y); distortion: OpenCV's k1, k2, p1, p2, k3"""

    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    distortion: tuple[float, ...] = ()


def camera_from_views(
    T_base_ee: FloatArray,
    views: Sequence[SeenBoard],
    size_px: tuple[int, int],
    board: CharucoSpec,
    known: KnownLens | None = None,
) -> CameraEstimate:
    """Camera, board and, unless it is known, the lens, from views with the arm's end (n, 4, 4) in each.

    If the lens is fitted too, the fit is repeated without each view, so that the camera's intervals include the lens's
    uncertainty. Raises InputError as `lens` and `hand_eye` do."""
    if len(T_base_ee) != len(views):
        raise InputError("a view for each pose", f"{len(views)} views, {len(T_base_ee)} poses")
    if known is not None:
        return CameraEstimate(hand_eye(T_base_ee, _poses(views, known, board)), None)
    whole, found = _all(T_base_ee, views, size_px, board)
    X, Y = whole.T_arm_camera, whole.T_ee_board
    off = []
    for index in range(len(views)):
        others = [*views[:index], *views[index + 1 :]]
        without, _ = _all(np.delete(T_base_ee, index, axis=0), others, size_px, board)
        off.append([*X.deviation(without.T_arm_camera.T), *Y.deviation(without.T_ee_board.T)])
    return CameraEstimate(jackknifed(X.T, Y.T, np.array(off), whole.off), found)


def _all(
    T_base_ee: FloatArray, views: Sequence[SeenBoard], size_px: tuple[int, int], board: CharucoSpec
) -> tuple[HandEye, LensEstimate]:
    found = lens(views, size_px, board)
    focal, center = found.focal_px.tolist(), found.center_px.tolist()
    used = KnownLens((focal[0], focal[1]), (center[0], center[1]), tuple(found.distortion.tolist()))
    return hand_eye(T_base_ee, _poses(views, used, board)), found


def _poses(views: Sequence[SeenBoard], known: KnownLens, board: CharucoSpec) -> FloatArray:
    """(n, 4, 4) pose of the board in the camera's frame in each view [m]."""
    return np.array([board_pose(view, known.focal_px, known.center_px, known.distortion, board) for view in views])


def doubt_at(T_arm_camera: transform.TransformEstimate, place_m: FloatArray) -> float:
    """How far off a place (3,) [m, base frame] may be seen: half its interval, along the direction of the widest."""
    arm_m = np.asarray(place_m, np.float64) - T_arm_camera.T[:3, 3]
    turned = -np.array([[0.0, -arm_m[2], arm_m[1]], [arm_m[2], 0.0, -arm_m[0]], [-arm_m[1], arm_m[0], 0.0]])
    J = np.hstack([np.eye(3), turned])
    spread = np.linalg.eigvalsh(J @ T_arm_camera.covariance @ J.T)[-1]
    whole = np.diag(T_arm_camera.covariance)
    return float(np.sqrt(max(spread, 0.0) / whole[0]) * T_arm_camera.half()[0]) if whole[0] > 0.0 else 0.0
