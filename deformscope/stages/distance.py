"""How far simulated particles are from observed ones."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import BoolArray, FloatArray


def distances(simulated: FloatArray, observed: FloatArray) -> FloatArray:
    """Euclidean distance of each particle from where it was observed: (..., K, d) and (K, d) give (..., K).

    Their mean is the average Euclidean error (AEE) of Thesis eq. 3.18 and 3.19.
    """
    return np.asarray(np.sqrt(np.sum((simulated - observed) ** 2, axis=-1)))


def nearest_error(simulated: FloatArray, observed: FloatArray) -> float:
    """Mean distance from each simulated point (n, d) to the nearest observed one (m, d) (Thesis eq. 4.6).

    One-sided: observed points that no simulated point comes near do not count.
    """
    distance, _ = cKDTree(observed).query(simulated)
    return float(np.mean(distance))


def rigid_positions(rest: FloatArray, deformed: FloatArray, fitted: BoolArray) -> FloatArray:
    """Where the best rigid motion takes all of rest (K, d): it fits deformed (K, d) where `fitted` (K,) is True, in
    least squares (Kabsch 1976)."""
    a, b = rest[fitted], deformed[fitted]
    u, _, vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
    sign = np.ones(rest.shape[1])
    sign[-1] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((rest - a.mean(axis=0)) @ (u * sign @ vt).T + b.mean(axis=0))
