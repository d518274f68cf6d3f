"""How far simulated particles are from observed ones."""

from collections.abc import Iterable

import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import BoolArray, FloatArray


def distances(simulated: FloatArray, observed: FloatArray) -> FloatArray:
    """Euclidean distance of each particle from its observed place: (..., K, d) and (K, d) give (..., K). Their mean is
    the average Euclidean error (AEE) of Thesis eq. 3.18 and 3.19."""
    return np.asarray(np.sqrt(np.sum((simulated - observed) ** 2, axis=-1)))


def nearest_error(simulated: FloatArray, observed: FloatArray) -> float:
    """Mean distance from each simulated point (n, d) to the nearest observed one (m, d) (Thesis eq. 4.6). One-sided:
    observed points that no simulated point comes near do not count."""
    distance, _ = cKDTree(observed).query(simulated)
    return float(np.mean(distance))


def unexplained(
    rest: FloatArray, deformed: FloatArray, simulated: FloatArray, judged: BoolArray, known: BoolArray
) -> tuple[float, float]:
    """Residuals of a simulation of a motion, and of the best rigid motion: sums of squares over the judged particles
    [unit^2]. rest, deformed, simulated: (K, d); judged: (K,) free and seen; known: (K,) deformed position is known"""
    rigid = rigid_positions(rest, deformed, known)
    return float(np.sum((simulated - deformed)[judged] ** 2)), float(np.sum((rigid - deformed)[judged] ** 2))


def explained_share(left: Iterable[tuple[float, float]], size: float) -> float:
    """Share of a motion beyond a rigid one that a simulation explains, from its parts (`unexplained`). The share is 0
    or less if the model explains nothing, and 0 without deformation. size: size of the body [unit]"""
    by_model, by_rigid = np.sum(list(left), axis=0)
    return float(1.0 - by_model / by_rigid) if by_rigid > (1e-9 * size) ** 2 else 0.0


def rigid_positions(rest: FloatArray, deformed: FloatArray, fitted: BoolArray) -> FloatArray:
    """Positions of rest (K, d) after the best rigid motion: that which fits deformed (K, d) where `fitted` (K,) is
    True, in least squares (Kabsch 1976)."""
    a, b = rest[fitted], deformed[fitted]
    u, _, vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
    sign = np.ones(rest.shape[1])
    sign[-1] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((rest - a.mean(axis=0)) @ (u * sign @ vt).T + b.mean(axis=0))
