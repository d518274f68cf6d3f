"""Sequences that tests fit: a body of known parameters, moved in steps, with noise that frames share or not."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.fit.model import Observation
from deformscope.stages.msm import clusters
from deformscope.stages.msm.solver import Msm
from tests.stages.bodies import SPACING_M, lattice

Sharing = Literal["own", "shared", "walking"]
"""Noise of each frame by itself, the same in all, or a walk from frame to frame as advected particles have it."""


@dataclass(frozen=True)
class Sequence:
    """seen: one observation a frame; beta: the truth"""

    seen: list[Observation]
    beta: float


def noise(rng: np.random.Generator, shape: tuple[int, int, int], sharing: Sharing) -> FloatArray:
    """(F, K, d) of unit variance, that of a walk in the last frame."""
    if sharing == "own":
        return rng.standard_normal(shape)
    if sharing == "shared":
        return np.repeat(rng.standard_normal((1, *shape[1:])), shape[0], axis=0)
    return np.cumsum(rng.standard_normal(shape), axis=0) / np.sqrt(shape[0])


def pulled(
    rng: np.random.Generator,
    sharing: Sharing,
    *,
    frames: int = 6,
    sigma: float | None = None,
    beta: float | None = None,
    shape: tuple[int, int] | None = None,
) -> Sequence:
    """A sheet whose first row stands while two particles of its last are pulled, a little further in each frame."""
    rows, columns = shape or (int(rng.integers(8, 12)), int(rng.integers(8, 12)))
    rest = lattice((rows, columns))
    near = np.flatnonzero(rest[:, 0] <= 0.0)
    far = np.flatnonzero(rest[:, 0] >= rest[:, 0].max() - 1e-9)
    held: IntArray = np.concatenate([near, rng.choice(far, 2, replace=False)])
    pull = np.zeros((len(held), 2))
    pull[len(near) :] = rng.normal(0.0, SPACING_M, 2)
    cell = np.arange(len(rest))
    beta = float(rng.uniform(0.0, 0.97)) if beta is None else beta
    sigma = float(rng.choice([1e-4, 3e-4])) if sigma is None else sigma
    share = np.arange(1, frames + 1) / frames
    body = Msm(rest, clusters.lattice(rest, (rows, columns), cell, 3), held)
    moved = body.relax(rest[held] + share[:, None, None] * pull, np.full(frames, beta)).position
    moved = moved + sigma * noise(rng, moved.shape, sharing)
    deviation = sigma * (np.sqrt(share) if sharing == "walking" else np.ones(frames))
    every = np.ones(len(rest), dtype=bool)
    seen = [
        Observation(
            rest,
            position,
            held,
            every,
            noise=np.full(len(rest), own),
            shape=(rows, columns),
            cell=cell,
            held_measured=True,
        )
        for position, own in zip(moved, deviation, strict=True)
    ]
    return Sequence(seen, beta)
