"""Regions of a map matched with those of another."""

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.optimize import linear_sum_assignment

from deformscope.arrays import BoolArray, IntArray
from deformscope.stages.regions.posterior import RegionMap


def called_labels(shown: RegionMap) -> IntArray:
    """(rows, columns) labels for matching with others: a map without regions has a single one."""
    return np.maximum(shown.labels, 0)


def match_regions(found: IntArray, truth: IntArray) -> tuple[float, list[tuple[int, int]]]:
    """Mean intersection over union of the best matching of labels, over the larger number of regions; and the pairs
    (found, true) that match."""
    one, other = int(found.max()) + 1, int(truth.max()) + 1
    both = np.zeros((one, other))
    np.add.at(both, (found.ravel(), truth.ravel()), 1.0)
    union = both.sum(axis=1, keepdims=True) + both.sum(axis=0) - both
    shares = both / np.maximum(union, 1.0)
    rows, columns = linear_sum_assignment(-shares)
    return float(shares[rows, columns].sum() / max(one, other)), list(zip(rows.tolist(), columns.tolist(), strict=True))


def boundary_distance(found: IntArray, truth: IntArray, cell_m: float) -> float | None:
    """Mean distance between the boundaries of two label maps (rows, columns), in both directions [m]; None if either
    has none."""

    def boundary(labels: IntArray) -> BoolArray:
        """(rows, columns) cells whose label differs from the cell above or left of it."""
        edge = np.zeros(labels.shape, dtype=bool)
        edge[1:] |= labels[1:] != labels[:-1]
        edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
        return edge

    edges = [boundary(labels) for labels in (found, truth)]
    if not all(edge.any() for edge in edges):
        return None
    away = [distance_transform_edt(~edge) for edge in edges]
    return float(cell_m * 0.5 * (away[0][edges[1]].mean() + away[1][edges[0]].mean()))
