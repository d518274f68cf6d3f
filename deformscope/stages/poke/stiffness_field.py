"""Stiffness over a surface, from what a few pokes met: one value, a few materials with borders, or a gradual field.

Which of the three it is says the posterior over regions (`deformscope.stages.regions`), as in an exploration. The
gradual field, which follows all pokes, stands for materials too where these are as wrong at one of the pokes as noise
cannot be, or where the pokes are too few to say where a border is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import softmax

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.regions.posterior import SurfaceKind, surface_kind

MATERIALS_APART = float(np.log(1.22))
"""Materials differ by at least 22 % in stiffness: nearer ones are not separable from noise of 8 % a touch."""

EXCLUDED = 0.3
"""A field whose log stiffness differs from that of one of its pokes by more than this is excluded by it: nearly four
times the noise of 8 % a touch."""

FEWEST_WITH_BORDER = 4
"""Of fewer pokes none has two others near it, on either side of a border."""

POKE_NOISE = 0.05
"""Scatter of log stiffness from poke to poke that a gradual field need not follow."""

LENGTHS = (0.12, 0.25, 0.5, 1.0, 2.0)
"""Over which a gradual field may change, as shares of the extent of the pokes."""


@dataclass(frozen=True)
class StiffnessField:
    """Stiffness [N/m] over places (n, 2) [m].

    places: (p, 2); stiffness: (p,) [N/m], above 0, of the pokes; kind: how it goes on between them
    left_out: (p,) relative error of each poke's stiffness predicted from the others; nan with one poke
    """

    places: FloatArray
    stiffness: FloatArray
    kind: SurfaceKind
    left_out: FloatArray

    def at(self, place: FloatArray) -> FloatArray:
        """Stiffness (n,) [N/m] at places (n, 2)."""
        return np.exp(FITS[self.kind](self.places, np.log(self.stiffness))(np.atleast_2d(place)))

    def deviation(self, place: FloatArray) -> FloatArray:
        """Standard deviation of the logarithm of the stiffness (n,) at places (n, 2).

        The pokes around a place say how far off the field is that does not know them; that error was made as far away
        as their nearest neighbours are, and nearer to a poke it is smaller in proportion, down to what the field misses
        the pokes by that it knows. One poke alone says nothing.
        """
        away = cdist(np.atleast_2d(place), self.places)
        if len(self.places) == 1:
            return np.full(len(away), POKE_NOISE)
        between = float(np.median(np.sort(cdist(self.places, self.places), axis=1)[:, 1]))
        if between <= 0.0:
            between = float(np.ptp(self.places, axis=0).max()) or 1.0
        weight = softmax(-0.5 * (away / between) ** 2, axis=1)
        around, here = (
            weight @ np.log1p(self.left_out) ** 2,
            weight @ np.log(self.at(self.places) / self.stiffness) ** 2,
        )
        share = np.minimum(away.min(axis=1) / between, 1.0)
        return np.asarray(np.sqrt(np.maximum(POKE_NOISE**2, here) + share**2 * around))


def fit_field(places: FloatArray, stiffness: FloatArray) -> StiffnessField:
    """The field of the kind that the pokes say. Raises InputError for stiffness that is not above 0."""
    if not (np.isfinite(stiffness).all() and (stiffness > 0.0).all()):
        raise InputError("stiffness above 0 at every poke", f"{float(np.min(stiffness)):g} N/m")
    value = np.log(stiffness)
    if len(stiffness) == 1:
        return StiffnessField(places, stiffness, "uniform", np.full(1, np.nan))
    kind = surface_kind(places, value, POKE_NOISE)
    if kind == "materials" and len(stiffness) < FEWEST_WITH_BORDER:
        kind = "gradual"
    if np.abs(FITS[kind](places, value)(places) - value).max() > EXCLUDED:
        kind = "gradual"
    return StiffnessField(places, stiffness, kind, np.expm1(_left_out(FITS[kind], places, value)))


Fitted = Callable[[FloatArray], FloatArray]


def _left_out(fit: Callable[[FloatArray, FloatArray], Fitted], places: FloatArray, value: FloatArray) -> FloatArray:
    """Error of each value predicted from the others, (p,)."""
    error = np.empty(len(value))
    for one in range(len(value)):
        others = np.arange(len(value)) != one
        error[one] = fit(places[others], value[others])(places[one : one + 1])[0] - value[one]
    return error


def _uniform(places: FloatArray, value: FloatArray) -> Fitted:
    middle = float(np.median(value))
    return lambda place: np.full(len(place), middle)


def _materials(places: FloatArray, value: FloatArray) -> Fitted:
    """One value for each material, their borders as far from the pokes as can be."""
    label = _levels(value)
    levels = np.array([np.median(value[label == one]) for one in range(label.max() + 1)])
    if len(levels) == 1:
        return _uniform(places, value)
    from sklearn.svm import SVC

    middle, size = places.mean(axis=0), float(np.ptp(places, axis=0).max()) or 1.0
    classifier: Any = SVC(kernel="linear", C=1e4)
    scaled = (places - middle) / size
    if (classifier.fit(scaled, label).predict(scaled) != label).any():
        classifier = SVC(kernel="rbf", gamma=4.0, C=1e4).fit(scaled, label)
    return lambda place: levels[np.asarray(classifier.predict((place - middle) / size))]


def _levels(value: FloatArray) -> IntArray:
    """Which material each value belongs to (p,), numbered upwards: values are parted where the gap is wide enough."""
    order = np.argsort(value)
    label = np.empty(len(value), dtype=np.int64)
    label[order] = np.concatenate([[0], np.cumsum(np.diff(value[order]) > MATERIALS_APART)])
    return label


def _gradual(places: FloatArray, value: FloatArray) -> Fitted:
    """A Gaussian process (Matern 3/2) whose length explains the pokes best."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern

    size = float(np.ptp(places, axis=0).max()) or 1.0
    spread = max(float(np.var(value)), POKE_NOISE**2)
    found: list[tuple[float, Any]] = []
    for share in LENGTHS:
        kernel = ConstantKernel(spread) * Matern(share * size, nu=1.5)
        process = GaussianProcessRegressor(kernel, alpha=POKE_NOISE**2, optimizer=None)
        process.fit(places, value - value.mean())
        found.append((float(process.log_marginal_likelihood_value_), process))
    best = max(found, key=lambda one: one[0])[1]
    mean = float(value.mean())
    return lambda place: np.asarray(best.predict(place)) + mean


FITS: dict[SurfaceKind, Callable[[FloatArray, FloatArray], Fitted]] = {
    "uniform": _uniform,
    "materials": _materials,
    "gradual": _gradual,
}
