"""Borders of materials: levels of a field of stiffness, and the cells at borders put where the data want them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.materials.field_fit import StiffnessPrior, smooth_mean

BORDER, SHARPEN_ROUNDS = 4.0, 4
"""What a border costs for each pair of cells that it parts, in units of chi2; rounds of sharpening it."""


def neighbours(place: FloatArray, spacing: float) -> IntArray:
    """(e, 2) pairs of cells that share a side. place: (C, d) middles"""
    return np.asarray(cKDTree(place).query_pairs(1.2 * spacing, output_type="ndarray"), dtype=np.int64)


def sharpened(
    label: IntArray, prior_of: Callable[[IntArray], StiffnessPrior], edges: IntArray, y: FloatArray, w: FloatArray
) -> IntArray:
    """(C,) labels after cells at borders changed to a neighbour's wherever that lowers chi2, and `BORDER` for each pair
    of neighbours (edges (e, 2)) that differ.

    prior_of: gives the levels of labels; y: (n,) wanted and w: (n, C + 1) derivatives, in units of the noise
    """
    label = label.copy()
    beside: list[list[int]] = [[] for _ in label]
    for one, other in edges:
        beside[one].append(other)
        beside[other].append(one)
    size = np.einsum("nc,nc->c", w, w)
    for _ in range(SHARPEN_ROUNDS):
        at = smooth_mean(prior_of(label), y, w)
        middle = np.array([at[:-1][label == k][0] if (label == k).any() else np.nan for k in range(label.max() + 1)])
        left = y - w @ at
        changed = False
        for _ in range(2 * len(label)):
            slope = left @ w
            best, move = -1e-9, None
            for cell in np.unique(edges[label[edges[:, 0]] != label[edges[:, 1]]]):
                around = label[beside[cell]]
                for k in np.unique(around[around != label[cell]]):
                    step = middle[k] - middle[label[cell]]
                    gain = -2.0 * step * slope[cell] + step**2 * size[cell]
                    gain += BORDER * ((around != k).sum() - (around != label[cell]).sum())
                    if gain < best:
                        best, move = gain, (cell, k, step)
            if move is None:
                break
            cell, k, step = move
            left = left - step * w[:, cell]
            label[cell] = k
            changed = True
        if not changed:
            break
    return np.asarray(np.unique(label, return_inverse=True)[1])


def levels_of(value: FloatArray, weight: FloatArray, count: int) -> IntArray:
    """(C,) which of `count` levels a log stiffness is nearest to: those of least weighted squares (k-means in one
    dimension, from quantiles)."""
    middle = np.quantile(value, (np.arange(count) + 0.5) / count)
    label = np.zeros(len(value), dtype=np.int64)
    for _ in range(100):
        label = np.abs(value[:, None] - middle).argmin(axis=1)
        new = np.array(
            [
                np.average(value[label == k], weights=weight[label == k]) if (label == k).any() else middle[k]
                for k in range(count)
            ]
        )
        if np.allclose(new, middle):
            break
        middle = new
    return np.asarray(np.unique(label, return_inverse=True)[1])
