"""What a model leaves beside a tip: known residuals come back, and are added where another tip presses."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.msm.poke import Tip
from deformscope.stages.poke.poke_fit import DISTANCES, DentResidual, SurfaceLeft, residual_of

THICKNESS, DEPTH = 0.05, 0.004
TRUE = DentResidual(0.05 * np.exp(-DISTANCES), -0.03 * DISTANCES, THICKNESS)


def left(tip: Tip, seed: int, count: int = 400, noise: float = 0.0) -> SurfaceLeft:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0.1, 0.2, 2)
    points = np.column_stack([middle + rng.uniform(-0.05, 0.05, (count, 2)), np.full(count, THICKNESS)])
    off: FloatArray = TRUE.at(points, middle, tip, DEPTH) + noise * rng.normal(size=points.shape)
    return SurfaceLeft(middle, tip, DEPTH, points, off)


def test_a_residual_that_pokes_have_in_common_comes_back_under_another_tip() -> None:
    tip = Tip("flat", (0.02, 0.02))
    found = residual_of([left(tip, seed, noise=2e-5) for seed in range(4)], THICKNESS)
    other = left(Tip("flat", (0.04, 0.02)), 9)
    again = found.at(other.points, other.middle, other.tip, DEPTH)
    assert np.sqrt(np.mean((again - other.left) ** 2)) < 0.05 * np.sqrt(np.mean(other.left**2))
    np.testing.assert_allclose(found.at(other.points, other.middle, other.tip, 2.0 * DEPTH), 2.0 * again)


def test_it_points_away_from_the_tip_and_ends_where_nothing_was_seen() -> None:
    tip = Tip("disc", (0.02,))
    points = np.array([[0.02, 0.0, 0.0], [0.0, -0.02, 0.0], [0.01 + 0.91 * THICKNESS, 0.0, 0.0]])
    moved = TRUE.at(points, np.zeros(2), tip, DEPTH)
    assert moved[0, 0] > 0.0
    assert moved[1, 1] == pytest.approx(-moved[0, 0])
    np.testing.assert_array_equal(moved[2], 0.0)


def test_few_points_say_little_and_a_ball_nothing() -> None:
    tip = Tip("flat", (0.02, 0.02))
    one = left(tip, 1, count=1, noise=1e-3)
    said = np.linalg.norm(residual_of([one], THICKNESS).at(one.points, one.middle, tip, DEPTH))
    assert said < 0.5 * np.linalg.norm(one.left)
    assert residual_of([dataclasses.replace(one, tip=Tip("sphere", (0.02,)))], THICKNESS) is None
