"""Trials of contents in containers: each container has an offset of its own, as foil and filling have."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Case = Literal["told", "untold", "untold-random", "copies"]
"""Groups given; not given; not given, and labels independent of the features; every trial copied with noise of 1e-6
into another group, groups given."""
CASES: tuple[Case, ...] = ("told", "untold", "untold-random", "copies")
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
