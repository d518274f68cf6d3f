"""Borders of materials: levels of a field of stiffness, and cells at borders assigned by the data."""

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.materials.field_fit import StiffnessPrior

BORDER = 4.0
"""Cost of a border for each pair of cells that it parts during the search, in units of chi2."""

PATCHES, SWEEPS = (0, 1, 2, 4), 20
"""How far around a cell at a border its material changes with it [cells]; sweeps at most."""


def neighbours(place: FloatArray, spacing: float) -> IntArray:
    """(e, 2) pairs of cells that share a side. place: (C, d) middles"""
    return np.asarray(cKDTree(place).query_pairs(1.2 * spacing, output_type="ndarray"), dtype=np.int64)


def border_cells(label: IntArray, edges: IntArray) -> IntArray:
    """Cells next to one of another material. label: (C,); edges: (e, 2)"""
    return np.unique(edges[label[edges[:, 0]] != label[edges[:, 1]]])


def border_length(label: IntArray, edges: IntArray) -> int:
    """Pairs of neighbours (edges (e, 2)) of different labels (C,)."""
    return int((label[edges[:, 0]] != label[edges[:, 1]]).sum())


def sharpened(
    label: IntArray, prior_of: Callable[[IntArray], StiffnessPrior], edges: IntArray, y: FloatArray, w: FloatArray
) -> IntArray:
    """(C,) labels after cells at borders, alone and with all of their material around them, changed to a neighbour's if
    that lowers chi2, plus `BORDER` for each pair of neighbours (edges (e, 2)) that differ.

    prior_of: gives the levels of labels; y: (n,) targets and w: (n, C + 1) derivatives, in units of the noise"""
    label = label.copy()
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(label), len(label))).tocsr()
    hops = dijkstra(graph, directed=False, unweighted=True, limit=max(PATCHES))
    gram, wanted = w.T @ w, w.T @ y
    for _ in range(SWEEPS):
        prior = prior_of(label)
        inner = prior.root.T @ gram @ prior.root + np.eye(prior.root.shape[1])
        at = prior.mean + prior.root @ np.linalg.solve(inner, prior.root.T @ (wanted - gram @ prior.mean))
        levels = range(len(prior.root[0]) - 1)
        middle = [float(at[:-1][label == k][0]) if (label == k).any() else np.nan for k in levels]
        slope = wanted - gram @ at
        changed = False
        for cell in border_cells(label, edges).tolist():
            own, best, move = int(label[cell]), -1e-9, None
            for k in np.setdiff1d(label[hops[cell] == 1.0], own).tolist():
                step = middle[k] - middle[own]
                for reach in PATCHES:
                    some = np.flatnonzero((hops[cell] <= reach) & (label == own))
                    outside = (hops[some] == 1.0) & ~np.isin(np.arange(len(label)), some)
                    gain = step * (step * gram[np.ix_(some, some)].sum() - 2.0 * slope[some].sum())
                    gain += BORDER * float((outside * ((label == own) * 1.0 - (label == k))).sum())
                    if gain < best:
                        best, move = gain, (some, k, step)
            if move is not None:
                some, k, step = move
                slope -= step * gram[:, some].sum(axis=1)
                label[some] = k
                changed = True
        if not changed:
            break
    return np.asarray(np.unique(label, return_inverse=True)[1])


def split(label: IntArray, value: FloatArray, weight: FloatArray) -> list[IntArray]:
    """For each material that can be divided by its log stiffness, labels (C,) in which it is two materials."""
    found = []
    for k in range(int(label.max()) + 1):
        some = np.flatnonzero(label == k)
        half = levels_of(value[some], weight[some], 2)
        if half.max() > 0:
            new = label.copy()
            new[some[half == 1]] = label.max() + 1
            found.append(new)
    return found


def cuts(label: IntArray, place: FloatArray, spacing: float) -> list[list[IntArray]]:
    """For each axis, labels (C,) with one of the materials cut in two across it, at every possible place. place: (C,
    d)"""
    found: list[list[IntArray]] = []
    for along in place.T:
        rows = np.unique(np.round(along / spacing, 3))
        found.append([])
        for half in (along > at * spacing for at in 0.5 * (rows[1:] + rows[:-1])):
            for k in np.intersect1d(label[half], label[~half]):
                found[-1].append(np.where((label == k) & half, label.max() + 1, label))
    return found


def gain(prior: StiffnessPrior, gram: FloatArray, wanted: FloatArray) -> float:
    """Reduction of chi2 by the parameters of a prior, less the prior's penalty.

    gram, wanted: (C + 1, C + 1), (C + 1,) products of the derivatives with each other and with the targets"""
    inner = prior.root.T @ gram @ prior.root + np.eye(prior.root.shape[1])
    along = prior.root.T @ (wanted - gram @ prior.mean)
    return float(along @ np.linalg.solve(inner, along))


def levels_of(value: FloatArray, weight: FloatArray, count: int) -> IntArray:
    """(C,) which of `count` levels a log stiffness is nearest to: those of least weighted squares (k-means in one
    dimension, from quantiles)."""
    middle = np.quantile(value, (np.arange(count) + 0.5) / count)
    label = np.zeros(len(value), dtype=np.int64)
    for _ in range(100):
        label = np.abs(value[:, None] - middle).argmin(axis=1)
        new = middle.copy()
        for k in np.unique(label):
            new[k] = np.average(value[label == k], weights=weight[label == k])
        if np.allclose(new, middle):
            break
        middle = new
    return np.asarray(np.unique(label, return_inverse=True)[1])
