"""A printed board is found in images, and gives the lens and its own pose."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.board import CharucoSpec, SeenBoard, board_image, board_pose, find_board, lens
from deformscope.stages.setup.hand_eye import camera_from_views, doubt_at
from deformscope.stages.setup.transform import moved, rigid

BOARD = CharucoSpec(7, 5, 0.03)
FOCAL_PX, CENTER_PX, SIZE_PX = (520.0, 525.0), (322.0, 236.0), (640, 480)
CAMERA = np.array([[FOCAL_PX[0], 0.0, CENTER_PX[0]], [0.0, FOCAL_PX[1], CENTER_PX[1]], [0.0, 0.0, 1.0]])
BENT = np.array([0.08, -0.15, 0.0, 0.0, 0.0])


def held(random: np.random.Generator, tilt_deg: float = 25.0, number: int = 0) -> FloatArray:
    """A pose of the board before the camera; of several, each is tilted another way."""
    way = np.radians(60.0 * number) + random.uniform(-0.4, 0.4)
    tilt = tilt_deg * random.uniform(0.5, 1.0)
    turn = Rotation.from_rotvec(np.radians([tilt * np.cos(way), tilt * np.sin(way), random.uniform(-20, 20)]))
    middle = np.array([0.105, 0.075, 0.0])
    return rigid(turn.as_matrix(), [*random.uniform(-0.05, 0.05, 2), random.uniform(0.4, 0.5)] - turn.apply(middle))


def projected(T: FloatArray, sd_px: float, random: np.random.Generator) -> SeenBoard:
    points = BOARD.corners_m
    px = cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], CAMERA, BENT)[0].reshape(-1, 2)
    return SeenBoard(np.arange(len(points)), px + sd_px * random.standard_normal(px.shape))


def test_a_picture_of_the_board_gives_its_corners_and_pose() -> None:
    T = held(np.random.default_rng(0))
    flat = cv2.resize(board_image(BOARD), None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA)
    px_per_m = 40 / BOARD.square_m
    onto_board = np.array([[1 / px_per_m, 0, -20 / px_per_m], [0, 1 / px_per_m, -20 / px_per_m], [0, 0, 1]])
    image = cv2.warpPerspective(flat, CAMERA @ np.column_stack([T[:3, :2], T[:3, 3]]) @ onto_board, SIZE_PX)
    seen = find_board(image, BOARD)
    assert len(seen.number) == 24
    assert board_pose(seen, FOCAL_PX, CENTER_PX, (), BOARD) == pytest.approx(T, abs=2e-3)
    assert find_board(np.full((480, 640, 3), 90, np.uint8), BOARD) is None


def test_the_intervals_of_the_lens_hold_it_in_about_nine_of_ten() -> None:
    random = np.random.default_rng(1)
    hits = np.zeros(4)
    for _ in range(40):
        found = lens([projected(held(random, number=number), 0.2, random) for number in range(8)], SIZE_PX, BOARD)
        truth = np.array([*FOCAL_PX, *CENTER_PX])
        hits += np.abs([*found.focal_px, *found.center_px] - truth) <= found.half_px
    assert found.left_over_px == pytest.approx(0.2 * np.sqrt(2), rel=0.15)
    assert (hits >= 29).all(), hits


@pytest.mark.parametrize("seed", range(2, 10))
def test_a_board_that_is_not_tilted_is_refused(seed: int) -> None:
    random = np.random.default_rng(seed)
    with pytest.raises(InputError, match=r"tilted by 20 degrees.*tilt it each way"):
        lens([projected(held(random, 1.0), 0.2, random) for _ in range(8)], SIZE_PX, BOARD)
    with pytest.raises(InputError, match="6 views"):
        lens([projected(held(random), 0.2, random)], SIZE_PX, BOARD)


@pytest.mark.parametrize("draws", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_camera_and_lens_together_are_inside_their_intervals(draws: int) -> None:
    """The lens is not given: what it leaves unknown is in where the camera stands."""
    random = np.random.default_rng(3)
    hits = np.zeros(6)
    for _ in range(draws):
        X = rigid(Rotation.from_euler("x", 160, degrees=True).as_matrix(), [0.1, -0.8, 0.6])
        Y = rigid(Rotation.from_euler("xz", [170, 20], degrees=True).as_matrix(), [0.02, 0.01, 0.03])
        views = [held(random, number=number) for number in range(12)]
        arm = [X @ view @ np.linalg.inv(Y) for view in views]
        arm = [moved(one, np.repeat([3e-4, 1e-3], 3) * random.standard_normal(6)) for one in arm]
        seen = [projected(view, 0.15, random) for view in views]
        found = camera_from_views(np.array(arm), seen, SIZE_PX, BOARD)
        hits += np.abs(found.mount.T_arm_camera.deviation(X)) <= found.mount.T_arm_camera.half()
        assert doubt_at(found.mount.T_arm_camera, (X @ views[0])[:3, 3]) < 0.015
    assert hits.mean() >= 0.75 * draws, hits
