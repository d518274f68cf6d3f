"""Every pixel of a depth image has one label, by the rule that took it out, and runs of labels give it back."""

import numpy as np

from deformscope.solid import Capsule
from deformscope.stages.see.cloud import Box, Intrinsics, back_project, not_alone, perceive, within
from deformscope.stages.see.pixel_labels import PixelLabel, SeenPixels
from deformscope.stages.see.robot import PosedRobot, measured, outside_capsules

CAMERA = Intrinsics((100.0, 100.0), (39.5, 29.5))
BOX = Box((-0.2, -0.2, 0.0), (0.2, 0.2, 0.2))
STICK = Capsule(np.array([0.05, 0.0, 0.05]), np.array([0.05, 0.0, 0.3]), 0.02)


def picture(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Depths [m] of a surface with noise, holes and what is lone, seen from 0.8 m above; and the camera's pose."""
    rng = np.random.default_rng(seed)
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 0.8
    depth = 0.75 + 1e-3 * rng.normal(size=(60, 80))
    depth[rng.random(depth.shape) < 0.03] = 0.0
    depth[20:30, 44:48] = 0.6
    depth[10, 10], depth[50, 33] = 0.62, np.nan
    return depth, T


def test_each_pixel_has_the_label_of_the_rule_that_took_it_out() -> None:
    depth, T = picture(0)
    found = perceive(depth, CAMERA, T, BOX, robot=PosedRobot([STICK], margin_m=0.005))
    seen = measured(depth)
    points = back_project(depth, CAMERA, T)
    label = found.label[seen]
    np.testing.assert_array_equal(found.label == PixelLabel.NOTHING_SEEN, ~seen)
    np.testing.assert_array_equal(label == PixelLabel.OUTSIDE_THE_BOX, ~within(points, BOX))
    taken = within(points, BOX) & ~outside_capsules(points, [STICK], margin_m=0.005)
    np.testing.assert_array_equal(label == PixelLabel.ROBOT_CAPSULE, taken)
    left = np.flatnonzero(within(points, BOX) & ~taken)
    np.testing.assert_array_equal(np.flatnonzero(label == PixelLabel.LONE), left[~not_alone(points[left])])
    np.testing.assert_array_equal(points[label == PixelLabel.USED], found.points_m)
    counts = [np.count_nonzero(label == one) for one in PixelLabel]
    assert sum(counts) == np.count_nonzero(seen) == len(points)
    assert min(counts[PixelLabel.USED : PixelLabel.ROBOT_CAPSULE + 1]) > 0
    assert counts[PixelLabel.LONE] > 0


def test_runs_give_the_labels_back_with_the_points_that_did_not_fit() -> None:
    found = [perceive(*(depth, CAMERA, T, BOX), cell_m=0.02) for depth, T in map(picture, (1, 2))]
    first = len(found[0].points_m)
    point = np.concatenate([found[0].point, found[1].point + first])
    label = np.array([one.label for one in found])
    pixels = SeenPixels(camera="camera", depth_ns=np.array([5, 7]), label=label, point=point)
    masks = pixels.masks()
    assert masks.shape == (60, 80)
    for image in (0, 1):
        np.testing.assert_array_equal(masks.decode(image), found[image].label)
    fits = np.ones(first + len(found[1].points_m), dtype=bool)
    fits[[3, first + 4]] = False
    masks = pixels.masks(fits)
    for image, lost in enumerate((3, 4)):
        again, used = masks.decode(image), found[image].label == PixelLabel.USED
        expected = np.zeros(used.shape, dtype=bool)
        expected[used] = found[image].point == lost
        np.testing.assert_array_equal(again == PixelLabel.MISFIT, expected)
        assert expected.any()
        np.testing.assert_array_equal(again[~expected], found[image].label[~expected])
    np.testing.assert_array_equal(pixels.label, label)  # what was handed over is as it was
