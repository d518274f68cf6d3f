"""What an arm's own force is worth, from its reports in a motion without contact: bias by pose, friction by direction,
noise, and the change that is left within a touch."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError

BLOCK_S, CHANGE_S = 0.2, 6.0
"""Reports are averaged over the first. A touch takes its zero at most the second before its force."""
PARTS = 10
"""Parts of the motion, in order of time; each is compared with what the others say."""
BIAS_N, FRICTION_N = 5.0, 1.0
"""Deviations of a coefficient of the pose and of a joint's friction before the motion: arms report some newtons without
contact, and joints that turn together share their friction."""
LEAST_BLOCKS = 100
SINGULAR_MARGIN = 0.1
"""Share by which the limit of the least singular value is away from what was seen. Chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchWorth:
    """bias_n: (f, 3) coefficients of the terms of a pose, friction_n: (n, 3) of the directions [N, base frame]

    noise_n: deviation of a single report; smooth_n: deviation behind the low pass, about the mean of a second; off_n:
    deviation of the mean's change within CHANGE_S, as in a touch after its zero, once bias and friction are taken out;
    raw_off_n: that before; each that of the worst axis [N]
    least_singular: smallest singular value of the Jacobian at which it was found good; zeros: reports of exactly zero
    left_n: (PARTS,) what is left of the force in each part of the motion, as the others predict it"""

    bias_n: FloatArray
    friction_n: FloatArray
    noise_n: float
    smooth_n: float
    off_n: float
    raw_off_n: float
    least_singular: float
    zeros: int
    left_n: FloatArray


def wrench_worth(
    time_s: FloatArray, force_n: FloatArray, pose: FloatArray, way: FloatArray, singular: FloatArray, share: float
) -> WrenchWorth:
    """The worth of forces (n, 3) [N, base frame] at times (n,) [s] with terms of the pose (n, f), which begin with a 1,
    and of the direction (n, k). singular: (n,) least singular value of the Jacobian; share: that of each new report in
    a low pass of first order. The terms are fitted to means of blocks by least squares with a Gaussian prior. Raises
    InputError for a motion that is too short, and for forces that never change."""
    silent = ~np.any(force_n, axis=1)
    good = ~silent & np.isfinite(force_n).all(axis=1)
    least = (1.0 - SINGULAR_MARGIN) * float(singular[good].min(initial=np.inf))
    if silent.any():
        least = max(least, (1.0 + SINGULAR_MARGIN) * float(singular[silent].max()))
        good &= singular >= least
    _, first, block = np.unique((time_s[good] / BLOCK_S).astype(int), return_index=True, return_inverse=True)
    if len(first) < LEAST_BLOCKS:
        came = f"{BLOCK_S * len(first):.0f} s with a force above zero"
        raise InputError(f"{BLOCK_S * LEAST_BLOCKS:g} s of motion without contact", came, "more --places")
    count = np.bincount(block)[:, None]

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values[good], first) / count)

    force, terms = mean(force_n), np.column_stack([mean(pose), mean(way)])
    noise = np.sqrt(((force_n[good] - force[block]) ** 2).sum(axis=0) / max(len(block) - len(first), 1))
    if not noise.all():
        raise InputError("forces that change", "the same force in all reports", "is the arm switched on?")
    when, part = mean(time_s[:, None])[:, 0], np.arange(len(first)) * PARTS // len(first)
    prior = np.concatenate([[np.inf], np.full(pose.shape[1] - 1, BIAS_N), np.full(way.shape[1], FRICTION_N)])
    left = np.zeros_like(force)
    for one in range(PARTS):
        left[part == one] = (force - terms @ _fit(terms, force, prior, part != one))[part == one]
    white = (noise**2 / count).mean(axis=0)
    found = _fit(terms, force, prior, np.ones(len(force), bool))
    rest = (force_n - np.column_stack([pose, way]) @ found)[good]
    smooth = rest.copy()
    for number in range(1, len(rest)):
        smooth[number] = smooth[number - 1] + share * (rest[number] - smooth[number - 1])
    second = (time_s[good] - time_s[good][0]).astype(int)
    means = np.array([np.bincount(second, one) for one in smooth.T]).T / np.maximum(np.bincount(second), 1)[:, None]
    return WrenchWorth(
        bias_n=found[: pose.shape[1]],
        friction_n=found[pose.shape[1] :],
        noise_n=float(noise.max()),
        smooth_n=float((smooth - means[second]).std(axis=0).max()),
        off_n=_change(when, left, part, white),
        raw_off_n=_change(when, force, part, white),
        least_singular=least,
        zeros=int(silent.sum()),
        left_n=np.array([np.sqrt((left[part == one] ** 2).mean()) for one in range(PARTS)]),
    )


def _fit(terms: FloatArray, force_n: FloatArray, prior: FloatArray, used: BoolArray) -> FloatArray:
    """(f, 3) coefficients; their prior deviations (f,) weigh against the scatter about them."""
    x, y, scatter = terms[used], force_n[used], 0.3
    found: FloatArray = np.zeros((x.shape[1], 3))
    for _ in range(3):
        found = np.linalg.solve(x.T @ x + np.diag((scatter / prior) ** 2), x.T @ y)
        scatter = float(np.sqrt(((y - x @ found) ** 2).mean()))
    return found


def _change(time_s: FloatArray, left_n: FloatArray, part: IntArray, white: FloatArray) -> float:
    """Deviation of the difference of two blocks within CHANGE_S, of the worst axis, without their white noise [N]."""
    one, other = np.triu_indices(len(time_s), 1)
    near = (time_s[other] - time_s[one] < CHANGE_S) & (part[one] == part[other])
    square = ((left_n[other[near]] - left_n[one[near]]) ** 2).mean(axis=0)
    return float(np.sqrt(np.maximum(square - 2.0 * white, 0.0).max()))
