"""Trials that are nearly the same, and trials that a classifier was trained on: neither says how new ones are named."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np
import scipy

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.squeeze.components import fit_scaling
from deformscope.stages.squeeze.table import LabelledTable, absent

NEIGHBOUR = 10
"""Its distance is the scale of a trial's surroundings: up to nine copies of a trial do not change it."""
FALSE_PAIRS = 0.01
"""Pairs that chance brings as near, in a table without copies."""
NEAREST_SHARE = 0.1
"""Share of that distance. Trials farther apart are no copies, however unlikely they are by chance."""


def near_copies(table: LabelledTable) -> list[tuple[int, ...]]:
    """Sets of rows that lie nearer to one another than chance brings trials; of different groups where there are some.

    Distances are between standardised features, each modality weighing as much. If points are spread evenly around a
    trial, the nearest is within the share s of the distance of the k-th with probability (k - 1) s^d. The dimension d
    is that of the distances of the k-th and 2 k-th neighbours (Facco et al. 2017)."""
    from sklearn.neighbors import NearestNeighbors

    count = len(table)
    k = min(NEIGHBOUR, (count - 1) // 2)
    scaled = [fit_scaling(values).apply(values) for values in table.modalities.values()]
    points = np.concatenate([one / np.sqrt(max(one.shape[1], 1)) for one in scaled], axis=1)
    if k < 2 or not points.shape[1]:
        return []
    far, near = NearestNeighbors(n_neighbors=2 * k + 1).fit(points).kneighbors(points)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.log(far[:, 2 * k] / far[:, k])
    apart = apart[np.isfinite(apart) & (apart > 0.0)]
    if not apart.size:
        return []
    dimension = float(np.log(2.0) / np.median(apart))
    share = min(float((FALSE_PAIRS / (count * (k - 1))) ** (1.0 / dimension)), NEAREST_SHARE)
    group = np.arange(count) if table.group is None else np.unique(table.group, return_inverse=True)[1].reshape(-1)
    row, place = np.nonzero((far[:, 1:k] <= share * far[:, [k]]) & (group[near[:, 1:k]] != group[:, None]))
    found = near[row, place + 1]
    linked = scipy.sparse.coo_matrix((np.ones(len(row)), (row, found)), shape=(count, count))
    sets = scipy.sparse.csgraph.connected_components(linked, directed=False)[1]
    members: dict[int, list[int]] = {}
    for one, which in enumerate(sets.tolist()):
        members.setdefault(which, []).append(one)
    return [tuple(rows) for rows in members.values() if len(rows) > 1]


def without_near_copies(table: LabelledTable, sets: list[tuple[int, ...]]) -> LabelledTable:
    """The first of each set of rows, and all others."""
    kept = np.ones(len(table), dtype=bool)
    kept[[row for rows in sets for row in rows[1:]]] = False
    return table.rows(kept)


def fingerprints(features: FloatArray) -> IntArray:
    """(n,) int64 hashes of the rows of features (n, p) in single precision; 0 where nothing was measured."""
    rows = np.ascontiguousarray(features, dtype=np.float32) + np.float32(0.0)
    digests = (hashlib.blake2b(one.tobytes(), digest_size=8).digest() for one in rows)
    found = [int.from_bytes(digest, "little", signed=True) for digest in digests]
    return np.where(absent(features), 0, np.array(found, dtype=np.int64))


def trained_on(table: LabelledTable, seen: Mapping[str, IntArray]) -> BoolArray:
    """(n,) trials in which a modality has the fingerprint of a trial that trained the model. seen: (N,) fingerprints of
    the trials that trained, by modality"""
    again = np.zeros(len(table), dtype=bool)
    for name, prints in seen.items():
        if name in table.modalities:
            own = fingerprints(table.modalities[name])
            again |= (own != 0) & np.isin(own, prints)
    return again
