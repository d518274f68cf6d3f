"""Natural groupings of the features, and how normal they are (Thesis 2.4.3.1, 2.4.3.4, 2.5.2).

They describe the table as a whole; no result of a classifier depends on them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.squeeze.components import fit_scaling, kept_of, loadings
from deformscope.stages.squeeze.scores import lilliefors
from deformscope.stages.squeeze.table import LabelledTable
from deformscope.stages.squeeze.trial_run import joined_name

RUNS = 10
"""Runs of k-means, each from other starting points (Thesis 2.5.2)."""
ALPHA = 0.05
"""Significance level of the test for a normal distribution (Thesis 2.4.3.4)."""


@dataclass(frozen=True, slots=True)
class Grouping:
    """k-means in the components that hold 80 % of the variance, with as many clusters as classes.

    rand: (RUNS,) adjusted Rand index of each run; plane: (n, 2) trials on the two largest components; rows: (n,)
    indices of the trials; cluster: (n,) clusters of the tightest run; centroid: (k, 2) its centroids; explained: share
    of the variance that the two components explain"""

    rand: FloatArray
    plane: FloatArray
    rows: IntArray
    cluster: IntArray
    centroid: FloatArray
    explained: FloatArray


@dataclass(frozen=True, slots=True)
class Normality:
    """Lilliefors' test of each component, at `ALPHA`.

    pooled: p-values over all trials; within: (C, d) within each class, which is what QDA assumes, NaN where a class has
    fewer than four trials"""

    pooled: FloatArray
    within: FloatArray

    @property
    def normal_pooled(self) -> tuple[int, int]:
        """Components that pass, and components tested."""
        return int((self.pooled > ALPHA).sum()), int(np.isfinite(self.pooled).sum())

    @property
    def normal_within(self) -> tuple[int, int]:
        """Components of classes that pass, and those tested."""
        return int((self.within > ALPHA).sum()), int(np.isfinite(self.within).sum())


def described(table: LabelledTable) -> dict[str, tuple[IntArray, FloatArray, FloatArray]]:
    """For each modality, and for all joined: trials that have it, their components (n, d) with 80 % of the variance,
    and the variances of all components."""
    found: dict[str, tuple[IntArray, FloatArray]] = {}
    for name, values in table.modalities.items():
        rows = np.flatnonzero(~table.missing(name))
        found[name] = rows, fit_scaling(values[rows]).apply(values[rows])
    names = table.fused[0]
    shared: IntArray = np.flatnonzero(~np.any([table.missing(name) for name in names], axis=0))
    if len(names) > 1 and len(shared) > 1:
        joined = [fit_scaling(table.modalities[one][shared]).apply(table.modalities[one][shared]) for one in names]
        found[joined_name(names)] = shared, np.concatenate(joined, axis=1)
    made: dict[str, tuple[IntArray, FloatArray, FloatArray]] = {}
    for name, (of_rows, scaled) in found.items():
        directions, variance = loadings(scaled)
        kept = max(kept_of(variance), min(2, directions.shape[1]))
        made[name] = of_rows, (scaled - scaled.mean(axis=0)) @ directions[:, :kept], variance
    return made


def clusters(table: LabelledTable, seed: int) -> Mapping[str, Grouping]:
    """Clusters found in each modality, and in all joined."""
    from sklearn.cluster import KMeans
    from sklearn.metrics import adjusted_rand_score

    found = {}
    for name, (rows, points, variance) in described(table).items():
        wanted = len(np.unique(table.label[rows]))
        if not points.shape[1] or len(np.unique(points, axis=0)) < wanted:
            continue
        runs = [KMeans(wanted, n_init=1, random_state=seed * RUNS + run).fit(points) for run in range(RUNS)]
        rand = np.array([adjusted_rand_score(table.target[rows], run.labels_) for run in runs])
        tightest = min(runs, key=lambda run: float(run.inertia_))
        # a column of zeros where there is one alone
        pad = ((0, 0), (0, max(0, 2 - points.shape[1])))
        plane, centre = (np.pad(one, pad)[:, :2] for one in (points, tightest.cluster_centers_))
        found[name] = Grouping(rand, plane, rows, tightest.labels_, centre, variance[:2] / variance.sum())
    return found


def normality(table: LabelledTable) -> Mapping[str, Normality]:
    """Tests of normality of each modality, and of all joined."""
    found = {}
    for name, (rows, points, _) in described(table).items():
        target = table.target[rows]
        pooled = np.array([lilliefors(column)[1] for column in points.T])
        every = range(len(table.classes))
        within = np.array([[lilliefors(column[target == one])[1] for column in points.T] for one in every])
        found[name] = Normality(pooled, within)
    return found


# Trials that are nearly the same: they do not say how new ones are named

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
