"""A robot with gripper, stick and cable is taken out of its picture, and the foam stays."""

import numpy as np
import pytest

from deformscope.lab.ray_camera import FOAM, ROBOT
from deformscope.robot.description import Removal
from studies.removal import DOUBT_M, RemovalCount, RemovalScene, RobotPicture, Where, known_as, removal_rows, removed

SEED = 1900


@pytest.fixture(scope="module")
def scene() -> RemovalScene:
    return RemovalScene(SEED)


@pytest.fixture(scope="module")
def picture(scene: RemovalScene) -> RobotPicture:
    return scene.picture("realsense", pressing=True)


def test_the_picture_shows_a_robot_before_foam(picture: RobotPicture) -> None:
    seen = picture.exact.seen
    assert np.count_nonzero(seen == FOAM) > 50_000
    assert np.count_nonzero(seen == ROBOT) > 5_000
    assert not (picture.foam & picture.robot).any()
    assert (seen[picture.foam] == FOAM).all()
    # depths that are mixed at edges are the robot's points, on whatever the pixel fell
    assert np.count_nonzero(seen[picture.robot] == FOAM) > 50


@pytest.mark.parametrize(("where", "removals"), [("sample", ("hull", "mesh", "capsules")), ("all above", ("mesh",))])
def test_foam_stays_and_the_robot_goes(
    scene: RemovalScene, picture: RobotPicture, where: Where, removals: tuple[Removal, ...]
) -> None:
    T, box = scene.T_surface_camera("surface"), scene.box(where, picture.center_m)
    for removal in removals:
        found = removed(picture, scene.geometry(T, DOUBT_M["surface"], known_as(removal)), box)
        left = np.count_nonzero(found.kept & found.robot) / np.count_nonzero(found.robot)
        assert found.beside[found.foam].mean() >= 0.99
        # of what nobody described, the cable above all, capsules leave much
        assert left > 0.01 if removal == "capsules" else left <= 0.001


def test_rows_pool_pictures() -> None:
    some = [
        RemovalCount("plain", "nothing", "sample", "mesh", 100, 99, 4, 10, 1, 0.1),
        RemovalCount("plain", "nothing", "sample", "mesh", 300, 300, 8, 10, 0, 0.3),
    ]
    (row,) = removal_rows(some)
    assert (row["pictures"], row["robot_points"], row["seconds"]) == (2, 20, 0.2)
    assert (row["foam_kept"], row["foam_kept_worst"]) == (399 / 400, 0.99)
    assert row["foam_outliers"] == 0.03
    assert (row["robot_left"], row["robot_left_worst"]) == (1 / 20, 0.1)
