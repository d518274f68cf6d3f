"""Plates and slabs whose stiffness differs from place to place, by the laboratory's finite elements: pairs of
what is seen of them, for `calibrate field`."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.spatial.distance import cdist

from deformscope.arrays import FloatArray, IntArray
from deformscope.lab.elasticity import ElasticBox
from deformscope.stages.fit.model import Observation

SPACING_M = 0.01
NOISE_SHARES, NOISE_REACH = (0.005, 0.02), (0.6, 3.0)
"""Sizes and reach of the noise [spacings], even in their logarithms."""
Way = Literal["stretch", "shear"]
Young = Callable[[FloatArray], FloatArray]


def elastic_pair(
    shape: tuple[int, ...],
    young: Young,
    *,
    noise_m: float = 1e-4,
    reach: float = 1.0,
    seed: int = 0,
    way: Way = "stretch",
    poisson: float = 0.3,
    strain: float = 0.06,
) -> Observation:
    """A plate (shape of two numbers) or slab clamped at its two ends in x, which are moved apart or past each other.

    young: modulus of places (n, d) [m]; noise_m: noise of every coordinate, shared by neighbours (Matern 3/2) over
    `reach` spacings, held particles included. The elements are half as wide as the particles' cells, quadratic, in
    space."""
    d = len(shape)
    ends = [(n - 1) * SPACING_M for n in shape]
    fine = [np.linspace(0.0, end, 2 * n - 1) for end, n in zip(ends, shape, strict=True)]
    axes = fine if d == 3 else [*fine, np.array([0.0, 0.2 * SPACING_M])]
    box = ElasticBox(*axes, young=lambda centres: young(centres[:, :d]), poisson=poisson)
    held, moved = np.zeros((len(box.nodes), 3), dtype=bool), np.zeros((len(box.nodes), 3))
    low, high = box.plane(0, 0.0), box.plane(0, ends[0])
    held[low | high, :d] = True
    if d == 2:
        held[low & box.plane(2, 0.0), 2] = True
    moved[high, 0 if way == "stretch" else 1] = strain * ends[0]
    solved = box.hold(held).solve(moved)
    rest = lattice(shape)
    inside = rest if d == 3 else np.column_stack([rest, np.full(len(rest), 0.1 * SPACING_M)])
    u = box.sample(solved.displacement, inside)[:, :d]
    force = float(np.linalg.norm(solved.force[high].sum(axis=0)))
    errors = noise_m * shared_noise(rest, reach) @ np.random.default_rng(seed).standard_normal(rest.shape)
    ends_held: IntArray = np.flatnonzero((rest[:, 0] < 1e-9) | (rest[:, 0] > ends[0] - 1e-9))
    return Observation(
        rest,
        rest + u + errors,
        ends_held,
        np.ones(len(rest), dtype=bool),
        shape=shape,
        cell=np.arange(len(rest)),
        force_n=force,
    )


def lattice(shape: tuple[int, ...]) -> FloatArray:
    """(K, d) places of particles [m]."""
    axes = [np.arange(n) * SPACING_M for n in shape]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(shape))


def shared_noise(rest: FloatArray, reach: float) -> FloatArray:
    """(K, K) root of the covariance of noise of unit variance that neighbours share (Matern 3/2) over this number of
    spacings."""
    gap = np.sqrt(3.0) * cdist(rest, rest) / (reach * SPACING_M)
    return np.linalg.cholesky((1.0 + gap) * np.exp(-gap) + 1e-9 * np.eye(len(rest)))
