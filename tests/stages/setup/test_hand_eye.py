"""Where a camera stands, found again from views of a board on the arm, and from touches alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.hand_eye import TOUCHED, camera_from_touches, hand_eye, next_pose, turned_about
from deformscope.stages.setup.transform import moved, rigid
from tests.stages.setup.region import region_holds

DRAWS = 200
AT_LEAST, AT_MOST = (int(binom.ppf(share, DRAWS, 0.9)) for share in (1e-4, 1.0 - 1e-4))


def camera(random: np.random.Generator) -> FloatArray:
    turn = Rotation.from_euler("xz", [180 + random.uniform(-60, 60), random.uniform(-180, 180)], degrees=True)
    return rigid(turn.as_matrix(), np.array([0.1, -0.8, 0.7]) + random.uniform(-0.1, 0.1, 3))


def board(random: np.random.Generator) -> FloatArray:
    turn = Rotation.from_euler("xyz", random.uniform(-180, 180, 3), degrees=True)
    return rigid(turn.as_matrix(), random.uniform(-0.1, 0.1, 3))


def poses(count: int, random: np.random.Generator, turn_deg: float = 30.0) -> FloatArray:
    turns = Rotation.from_rotvec(np.radians(turn_deg) * random.standard_normal((count, 3)))
    return rigid(turns.as_matrix(), np.array([0.0, -0.4, 0.3]) + 0.08 * random.standard_normal((count, 3)))


def seen(A: FloatArray, X: FloatArray, Y: FloatArray, random: np.random.Generator, share: float = 1.0) -> FloatArray:
    """The board as the camera sees it: the arm is off by 0.5 mm and 2 mrad, the camera by more along its axis."""
    arm = share * np.repeat([5e-4, 2e-3], 3)
    eye = share * np.array([3e-4, 3e-4, 1e-3, 3e-3, 3e-3, 1e-3])
    views = []
    for pose in A:
        truly = pose @ moved(np.eye(4), arm * random.standard_normal(6))
        view = np.linalg.inv(X) @ truly @ Y
        views.append(moved(view, eye * random.standard_normal(6)))
    return np.array(views)


def test_exact_views_give_camera_and_board() -> None:
    random = np.random.default_rng(0)
    A, X, Y = poses(8, random), camera(random), board(random)
    found = hand_eye(A, seen(A, X, Y, random, 0.0))
    assert pytest.approx(X, abs=1e-7) == found.T_arm_camera.T
    assert pytest.approx(Y, abs=1e-7) == found.T_ee_board.T


def test_it_is_near_that_of_park_and_martin() -> None:
    """Independent of ours: AX = XB of motions between views, the rotation from logarithms (Park and Martin 1994)."""
    random = np.random.default_rng(1)
    A, X, Y = poses(14, random), camera(random), board(random)
    B = seen(A, X, Y, random)
    pairs = [(i, j) for i in range(len(A)) for j in range(i)]
    moves = np.array([A[i] @ np.linalg.inv(A[j]) for i, j in pairs])
    views = np.array([B[i] @ np.linalg.inv(B[j]) for i, j in pairs])
    alpha, beta = (Rotation.from_matrix(T[:, :3, :3]).as_rotvec() for T in (moves, views))
    turn = np.linalg.svd(alpha.T @ beta)[0] @ np.linalg.svd(alpha.T @ beta)[2]
    design = np.vstack([move[:3, :3] - np.eye(3) for move in moves])
    wanted = np.concatenate([turn @ view[:3, 3] - move[:3, 3] for move, view in zip(moves, views, strict=True)])
    theirs = rigid(turn, np.linalg.lstsq(design, wanted, rcond=None)[0])
    found = hand_eye(A, B).T_arm_camera
    assert (np.abs(found.deviation(theirs)) < 2.0 * found.half()).all()
    assert (np.abs(found.deviation(X)) < 2.0 * found.half()).all()


def test_the_intervals_of_a_camera_hold_it_in_about_nine_of_ten() -> None:
    random = np.random.default_rng(2)
    hits = np.zeros(12)
    for _ in range(DRAWS // 2):
        A, X, Y = poses(12, random), camera(random), board(random)
        found = hand_eye(A, seen(A, X, Y, random))
        hits[:6] += np.abs(found.T_arm_camera.deviation(X)) <= found.T_arm_camera.half()
        hits[6:] += np.abs(found.T_ee_board.deviation(Y)) <= found.T_ee_board.half()
    assert (hits >= binom.ppf(1e-4, DRAWS // 2, 0.9)).all(), hits
    assert hits.mean() <= 0.97 * DRAWS // 2


def test_views_that_do_not_say_where_it_stands_are_refused() -> None:
    random = np.random.default_rng(3)
    A, X, Y = poses(10, random), camera(random), board(random)
    about_one = A.copy()
    about_one[:, :3, :3] = Rotation.from_rotvec(np.linspace(-0.7, 0.7, 10)[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    slipped = seen(A, X, Y, random)
    slipped[4] = moved(slipped[4], [0.1, 0.0, 0.0, 0.0, 0.0, 0.3])
    with pytest.raises(InputError, match=r"second axis.*try: from the middle.*by .30 degrees about its own [xz] axis"):
        hand_eye(about_one, seen(about_one, X, Y, random))
    with pytest.raises(InputError, match="6 views"):
        hand_eye(A[:5], seen(A[:5], X, Y, random))
    with pytest.raises(InputError, match=r"belong together.*view 5"):
        hand_eye(A, slipped)


INVERTED = [(False, False), (True, False), (False, True), (True, True)]


@pytest.mark.parametrize(("arm", "eye"), INVERTED)
@pytest.mark.parametrize("reach_m", [0.02, 0.15, 0.25])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_inverted_poses_are_named(arm: bool, eye: bool, reach_m: float, noise: float) -> None:
    """The inverses of both agree as well as the poses: the camera is then the board on the arm's end, seen from it."""
    for seed in range(6):
        random = np.random.default_rng(seed)
        A = poses(12, random)
        down = Rotation.from_euler("xz", [180 + random.uniform(-15, 15), random.uniform(-180, 180)], degrees=True)
        X = rigid(down.as_matrix(), np.array([0.0, -0.4, 1.1]) + random.uniform(-0.1, 0.1, 3))
        off = random.standard_normal(3)
        Y = rigid(board(random)[:3, :3], reach_m * off / np.linalg.norm(off))
        B = seen(A, X, Y, random, noise)
        given = np.linalg.inv(A) if arm else A, np.linalg.inv(B) if eye else B
        if not (arm or eye):
            assert np.linalg.norm(hand_eye(*given).T_arm_camera.T[:3, 3] - X[:3, 3]) < 0.02
            continue
        names = [name for name, wrong in (("T_base_ee", arm), ("T_camera_board", eye)) if wrong]
        with pytest.raises(InputError) as refused:
            hand_eye(*given)
        assert f"with {' and '.join(names)} inverted they agree" in str(refused.value)
        assert ", ".join(f"np.linalg.inv({name})" for name in names) in str(refused.value)


def test_no_view_is_blamed_where_all_disagree() -> None:
    random = np.random.default_rng(4)
    A, X, Y = poses(10, random), camera(random), board(random)
    B = seen(A, X, Y, random)
    for wrong in (np.roll(B, 1, axis=0), np.concatenate([B[:5], np.roll(B[5:], 1, axis=0)]), B * [[1, 1, 1, 1000.0]]):
        with pytest.raises(InputError) as refused:
            hand_eye(A, wrong)
        assert " of 10 views off, by " in str(refused.value)
        assert "leave" not in str(refused.value)


def test_the_poses_that_are_suggested_turn_about_all_axes() -> None:
    taken = rigid(np.eye(3)[None], np.zeros((1, 3)))
    for _ in range(7):
        T, words = next_pose(taken)
        assert "degrees about its own" in words
        taken = np.concatenate([taken, T[None]])
    assert turned_about(taken) > np.radians(10.0)
    assert turned_about(taken[:6]) > np.radians(8.0)


def test_the_intervals_from_touches_hold_the_camera_in_nine_of_ten() -> None:
    random = np.random.default_rng(4)
    hits, regions = np.zeros(6), 0
    for _ in range(DRAWS):
        X = camera(random)
        touched_m = np.array([0.0, -0.4, 0.1]) + random.uniform(-0.2, 0.2, (6, 3))
        sd_m = TOUCHED.sd * np.sqrt(TOUCHED.weight / random.chisquare(TOUCHED.weight))
        off_m = touched_m + sd_m * random.standard_normal((6, 3))
        found = camera_from_touches(touched_m, (off_m - X[:3, 3]) @ X[:3, :3]).T_arm_camera
        hits += np.abs(found.deviation(X)) <= found.half()
        regions += region_holds(found, X)
    assert ((hits >= AT_LEAST) & (hits <= AT_MOST)).all(), hits
    assert AT_LEAST <= regions <= AT_MOST


def test_places_in_one_line_are_refused() -> None:
    line_m = np.linspace([0.0, 0.0, 0.0], [0.4, 0.1, 0.0], 6)
    with pytest.raises(InputError, match=r"not in one line.*try: touch off that line"):
        camera_from_touches(line_m, line_m)
