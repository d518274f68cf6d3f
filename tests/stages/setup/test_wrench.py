"""What an arm's own force is worth, against a generator of its own: reports of known bias, friction and noise."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import binom

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.wrench import WrenchWorth, wrench_worth

HZ = 50.0
NOISE_N = 0.3
SHARE = 0.2
"""Of a low pass."""


@dataclass(frozen=True)
class Motion:
    """A way of two joints, down and up again over one place after the other, without contact."""

    time_s: FloatArray
    joints: FloatArray
    force_n: FloatArray

    @property
    def terms(self) -> FloatArray:
        x, y = self.joints.T
        return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])

    @property
    def way(self) -> FloatArray:
        return np.sign(np.gradient(self.joints, axis=0).round(9))


def motion(random: np.random.Generator, *, cubic_n: float = 0.0, friction_n: float = 0.5, touches: int = 12) -> Motion:
    """cubic_n: size of a bias of third order, which the terms do not have"""
    step = np.linspace(0.0, 1.0, round(3 * HZ))
    joints = np.zeros((0, 2))
    for x, y in random.uniform(-1.0, 1.0, (touches, 2)):
        depth = 0.3 * np.concatenate([0.0 * step, step, 1.0 + 0.0 * step, 1.0 - step])
        joints = np.concatenate([joints, np.column_stack([np.full(len(depth), x), y + depth])])
    x, y = joints.T
    way = np.sign(np.gradient(joints, axis=0).round(9))
    bias = np.column_stack([1.0 + 2.0 * x, -3.0 * y + x * y, 4.0 + 1.5 * y**2 + cubic_n * np.sin(3.0 * y)])
    force_n = bias + friction_n * way[:, 1:] * np.array([0.2, 0.5, 1.0])
    return Motion(np.arange(len(x)) / HZ, joints, force_n + random.normal(0.0, NOISE_N, (len(x), 3)))


def worth(made: Motion, **changed: FloatArray) -> WrenchWorth:
    singular = np.full(len(made.time_s), 0.2)
    given = {"force_n": made.force_n, "singular": singular} | changed
    return wrench_worth(made.time_s, given["force_n"], made.terms, made.way, given["singular"], SHARE)


def test_bias_friction_and_noise_are_found_again() -> None:
    found = worth(motion(np.random.default_rng(1)))
    expected = np.array([[1.0, 0.0, 4.0], [2.0, 0, 0], [0, -3.0, 0], [0, 0, 0], [0, 1.0, 0], [0, 0, 1.5]])
    np.testing.assert_allclose(found.bias_n, expected, atol=0.12)
    np.testing.assert_allclose(found.friction_n[1], [0.1, 0.25, 0.5], atol=0.03)
    assert found.noise_n == pytest.approx(NOISE_N, rel=0.05)
    assert found.smooth_n == pytest.approx(NOISE_N * np.sqrt(SHARE / (2.0 - SHARE)), rel=0.1)
    assert found.off_n < 0.06, "nothing but noise is left"
    assert found.raw_off_n > 0.6
    assert found.least_singular == pytest.approx(0.18)
    assert found.zeros == 0


@pytest.mark.parametrize("cubic_n", [0.0, 0.6, 2.0])
def test_the_change_that_is_left_holds_that_of_other_motions(cubic_n: float) -> None:
    """In nine of ten: the force is compared with its zero, a touch's time before, at places that were not learned."""
    held = count = 0
    for seed in range(30):
        random = np.random.default_rng([seed, 7])
        learned, other = motion(random, cubic_n=cubic_n), motion(random, cubic_n=cubic_n, touches=6)
        found = worth(learned)
        left = other.force_n - other.terms @ found.bias_n - other.way @ found.friction_n
        every = round(12 * HZ)
        for begin in range(0, len(left), every):
            zero, pressed = left[begin : begin + round(3 * HZ)], left[begin + round(6 * HZ) : begin + round(9 * HZ)]
            sd = np.hypot(found.off_n, NOISE_N * np.sqrt(2.0 / len(zero)))
            held += abs(pressed[:, 2].mean() - zero[:, 2].mean()) < 1.645 * sd
            count += 1
    assert held >= binom.ppf(1e-3, count, 0.9), f"{held} of {count}"


def test_forces_that_are_zero_near_a_singularity_are_left_out_and_limit_the_poses() -> None:
    made = motion(np.random.default_rng(2))
    singular = 0.1 + 0.05 * made.joints[:, 0]
    force_n = np.where(singular[:, None] < 0.07, 0.0, made.force_n)
    found = worth(made, force_n=force_n, singular=singular)
    assert found.zeros == np.count_nonzero(singular < 0.07) > 0
    assert 0.07 * 0.9 < singular[singular < 0.07].max() < found.least_singular < 0.08
    assert found.noise_n == pytest.approx(NOISE_N, rel=0.05), "the zeros are no force"


def test_what_says_nothing_is_refused() -> None:
    made = motion(np.random.default_rng(3))
    with pytest.raises(InputError, match="of motion without contact; got 0 s"):
        worth(made, force_n=0.0 * made.force_n)
    with pytest.raises(InputError, match="forces that change"):
        worth(made, force_n=np.ones_like(made.force_n))
    with pytest.raises(InputError, match="20 s of motion"):
        worth(motion(np.random.default_rng(3), touches=1))
