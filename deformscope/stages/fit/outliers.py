"""Particles whose observed position is no measurement of them: tracks that were lost, or that jumped to another place.

The value of the lowest average error is little moved by them (a mean of distances is a median's kin), but a likelihood
of Gaussian errors is. So each particle is compared with its neighbours at that value: what a fit leaves there, noise
apart, is smooth, whether it be a model's misfit, a shared error or a beta that is still off. A particle whose residual
lies far outside theirs is left out as if it had not been seen, the fit closes in anew, and so on until none changes.
The bound is set so that of clean Gaussian data some hundredth of all observations loses a particle; what outliers are
smaller stay in, where they count as noise.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import chi

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.search import Search

FALSE_ALARMS = 0.01
"""Chance that clean white noise of one observation is taken for an outlier somewhere, were its scale known."""

SCALE_MARGIN = 1.25
"""The bound's factor for what is not known of the scale: it comes from few particles, and neighbours are noisy too."""

NEIGHBOURS = {2: 8, 3: 12}
"""Nearest particles that one is compared with, by dimension; their median bears up to half of them wrong."""

PARTICLES_LEAST = 12
"""Fewer free particles than this do not show which of them is wrong."""

SHARE_MOST = 0.45
"""Where more than this share looks wrong, it is the model that is: none is left out."""

LEAST = 1e-3
"""Deviation in spacings that residuals are taken to have at least: smaller outliers are not worth leaving out."""

ROUNDS = 5

STOPPED = 0.8
"""A track counts as lost, not wrong, if its end lies on the way that the model expects, short of this share of it."""

Kind = Literal["lost", "wrong"]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Particles of one observation that were left out. lost: stayed behind on the way that the model expects; wrong:
    anywhere else. (m,) indices of the observation's particles"""

    lost: IntArray
    wrong: IntArray

    @property
    def count(self) -> int:
        return len(self.lost) + len(self.wrong)

    def as_json(self) -> dict[str, list[int]]:
        return {"lost": self.lost.tolist(), "wrong": self.wrong.tolist()}


def without_outliers(search: Search) -> tuple[LeftOut, ...]:
    """Leave the outliers of a search's observations out of them, close in on the lowest error of the rest, and name
    them."""
    every = list(search.seen)
    off = [np.zeros(len(one.rest), dtype=bool) for one in every]
    for _ in range(ROUNDS):
        best = search.best()
        found = []
        for row, one in enumerate(every):
            noise = None if one.noise is None else one.noise[one.free_observed]
            bad = np.zeros(len(one.rest), dtype=bool)
            position = search.tried.positions[row][best]
            use = np.flatnonzero(one.free_observed)
            bad[use] = outlying(one.rest[use], (one.deformed - position)[use], noise, LEAST * search.bodies[row].scale)
            found.append(bad)
        if all(np.array_equal(a, b) for a, b in zip(off, found, strict=True)):
            break
        off = found
        search.seen = [
            dataclasses.replace(one, observed=one.observed & ~bad) if bad.any() else one
            for one, bad in zip(every, off, strict=True)
        ]
        search.refine()
    best = search.best()
    return tuple(
        _named(one.rest, one.deformed, search.tried.positions[row][best], bad)
        for row, (one, bad) in enumerate(zip(every, off, strict=True))
    )


def outlying(rest: FloatArray, residual: FloatArray, noise: FloatArray | None, floor: float) -> BoolArray:
    """(n,) which residuals (n, d) of particles at rest (n, d) lie far outside those of their neighbours.

    noise: (n,) stated deviation of a coordinate, None if unknown; floor: least deviation
    """
    n, d = rest.shape
    none = np.zeros(n, dtype=bool)
    if n < PARTICLES_LEAST:
        return none
    _, near = cKDTree(rest).query(rest, k=min(NEIGHBOURS[d], n - 1) + 1)
    around = residual[near[:, 1:]]
    middle = np.median(around, axis=1)
    apart = np.linalg.norm(residual - middle, axis=1)
    typical = float(chi.median(d))
    here = np.median(np.linalg.norm(around - middle[:, None], axis=2), axis=1) / typical
    scale = np.maximum(np.maximum(here, np.median(apart) / typical), floor)
    if noise is not None:
        scale = np.maximum(scale, noise)
    found = apart > SCALE_MARGIN * float(chi.isf(FALSE_ALARMS / n, d)) * scale
    return none if found.mean() > SHARE_MOST else np.asarray(found)


def _named(rest: FloatArray, deformed: FloatArray, expected: FloatArray, off: BoolArray) -> LeftOut:
    """Of particles (K,) that are off: whether each stayed on its expected way, or left it."""
    rows = np.flatnonzero(off)
    way, came = (expected - rest)[rows], (deformed - rest)[rows]
    length = np.sum(way**2, axis=1)
    share = np.sum(way * came, axis=1) / np.maximum(length, 1e-300)
    aside = np.linalg.norm(came - np.clip(share, 0.0, 1.0)[:, None] * way, axis=1)
    missing = np.linalg.norm(way - came, axis=1)
    behind = (share < STOPPED) & (aside < 0.3 * missing)
    return LeftOut(rows[behind], rows[~behind])
