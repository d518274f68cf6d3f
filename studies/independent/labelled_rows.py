"""Trials of contents in containers: each container has an offset of its own, as foil and filling have; and measured
tables of scikit-learn whose rows come in groups."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from sklearn.cluster import KMeans
from sklearn.datasets import load_breast_cancer, load_digits

Case = Literal["told", "untold", "untold-random", "copies", "digits", "cancer"]
"""Groups given; not given; not given, and labels independent of the features; every trial copied with noise of 1e-6
into another group, groups given; four handwritten digits, 5 of 13 blocks of rows (writers); cells, 5 of 12 clusters of
each class."""
CASES: tuple[Case, ...] = ("told", "untold", "untold-random", "copies", "digits", "cancer")
CLASSES, CONTAINERS, EACH, COLUMNS = 4, 6, 5, 5
"""Contents, containers of each, trials of each of these, features."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rows:
    """label, container: (n,) numbers; features: (n, COLUMNS); new: makes as many trials of containers never seen"""

    label: npt.NDArray[np.int64]
    container: npt.NDArray[np.int64]
    features: Array
    new: Callable[[], tuple[npt.NDArray[np.int64], Array]]


def rows_of(case: Case, seed: int) -> Rows:
    """The trials of a seed; contents are 0 to 4 deviations of a trial apart, containers 0.5 to 2."""
    rng = np.random.default_rng([seed, CASES.index(case)])
    if case in ("digits", "cancer"):
        return _measured(case, rng)
    apart = 0.0 if case == "untold-random" else rng.uniform(0.0, 4.0)
    between = rng.uniform(0.5, 2.0) if case != "untold-random" else 3.0
    means = apart * rng.standard_normal((CLASSES, COLUMNS)) / np.sqrt(COLUMNS)

    def draw(containers: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Array]:
        container = np.repeat(np.arange(CLASSES * containers), EACH)
        label = container // containers
        offset = between * rng.standard_normal((CLASSES * containers, COLUMNS))
        return label, container, means[label] + offset[container] + rng.standard_normal((len(label), COLUMNS))

    label, container, features = draw(CONTAINERS)
    if case == "copies":  # into the next container of the same content
        onto = (container // CONTAINERS) * CONTAINERS + (container + 1) % CONTAINERS
        label, container = np.concatenate([label, label]), np.concatenate([container, onto])
        features = np.concatenate([features, features + 1e-6 * rng.standard_normal(features.shape)])

    def new() -> tuple[npt.NDArray[np.int64], Array]:
        made = draw(40)
        return made[0], made[2]

    return Rows(label, container, features, new)


def _measured(case: Case, rng: np.random.Generator) -> Rows:
    """40 to 80 rows of some groups; the new ones are all rows of the others."""
    label, group, features = _digits() if case == "digits" else _cancer()
    if case == "digits":
        classes = rng.choice(10, 4, replace=False)
        some = np.isin(label, classes)
        label, group, features = np.unique(label[some], return_inverse=True)[1], group[some], features[some]
        own = rng.choice(13, 5, replace=False)
    else:
        own = np.concatenate([12 * one + rng.choice(12, 5, replace=False) for one in (0, 1)])
    known = np.isin(group, own)
    rows = rng.permutation(np.flatnonzero(known))[: rng.integers(40, 81)]
    return Rows(label[rows], group[rows], features[rows], lambda: (label[~known], features[~known]))


@cache
def _digits() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Array]:
    """Labels, groups and the means (n, 16) of four pixels each."""
    images, label = load_digits(return_X_y=True)
    features = images.reshape(-1, 4, 2, 4, 2).mean(axis=(2, 4)).reshape(-1, 16)
    return label, np.arange(len(label)) * 13 // len(label), features


@cache
def _cancer() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Array]:
    """Labels, clusters of each and features (n, 30)."""
    features, label = load_breast_cancer(return_X_y=True)
    scaled = (features - features.mean(axis=0)) / features.std(axis=0)
    group = np.zeros_like(label)
    for one in (0, 1):
        group[label == one] = 12 * one + KMeans(12, n_init=4, random_state=0).fit_predict(scaled[label == one])
    return label, group, features
