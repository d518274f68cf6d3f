"""Particles whose observed position is wrong: tracks that were lost, or that jumped to another place.

They hardly change the value of the lowest average error (a mean of distances resembles a median), but they change a
likelihood of Gaussian errors. Therefore each particle is compared with its neighbours at that value. Residuals of a
fit, noise apart, are smooth, for a model's misfit, a shared error or a beta that has not converged. A particle whose
residual is far from theirs is left out like an unseen one, and the fit is repeated until no particle changes. The more
there are, the nearer are those that are sought, by the share of right ones among them; of clean Gaussian data hardly an
observation loses a particle. Smaller outliers stay in, where they count as noise."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import gammaincc, gammaincinv, logsumexp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.model import Observation

FALSE_ALARMS = 0.05
"""Share of right particles among those left out with white noise, and the probability that clean noise loses one, if
its scale is known. Compared with 0.01 and 0.2 on tuning seeds (`studies.seeds`), 240 bodies. At 0.01, 0.05 and 0.2, 58,
64 and 69 % of lost tracks were found, and 0.01, 0.07 and 0.4 % of the others left out."""

SCALE_MARGIN = 1.25
"""The bound's factor for the scale's uncertainty: it comes from few particles, and neighbours are noisy too."""

NEIGHBOURS = {2: 8, 3: 12}
"""Number of nearest particles with which one is compared, by dimension; half may be wrong, as for a median."""

PARTICLES_LEAST = 12
"""Least number of free particles: fewer do not show which of them is wrong."""

SHARE_MOST = 0.45
"""Largest share of outliers: if more particles look wrong, the model is wrong, and no particle is left out."""

LEAST = 1e-3
"""Least assumed deviation of residuals, in spacings: smaller outliers have no effect."""

ROUNDS = 5

STOPPED = 0.8
"""A track counts as lost, not wrong, if it ends on its expected way, before this share of it."""

BEHIND_GAIN, BEHIND_ROUNDS = 10.0, 50
"""Gain in twice the log likelihood that lost tracks need together if none of them is an outlier alone; rounds to their
share. Compared with 5 and without on tuning seeds, 150 bodies. 68, 69 and 65 % of lost tracks were found; the shares
for wrong tracks and for white or shared noise did not change."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Particles of one observation that were left out. lost: it stayed behind on its expected way; wrong: it is
    anywhere else; held: prescribed particles whose stated position is wrong (`prescribed_offset`). (m,) indices of
    particles"""

    lost: IntArray
    wrong: IntArray
    held: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def count(self) -> int:
        return len(self.lost) + len(self.wrong) + len(self.held)

    def as_json(self) -> dict[str, list[int]]:
        held = {"held": self.held.tolist()} if len(self.held) else {}
        return {"lost": self.lost.tolist(), "wrong": self.wrong.tolist(), **held}


Fitted = Callable[[Sequence[Observation]], Sequence[FloatArray]]
"""Computes positions (K, d) of each given observation at the lowest error."""


def without_outliers(
    every: Sequence[Observation], spacing: Sequence[float], fitted: Fitted
) -> tuple[list[Observation], tuple[LeftOut, ...]]:
    """The observations without their outliers, and the outliers by name. spacing: their particles' [unit]"""
    off = [np.zeros(len(one.rest), dtype=bool) for one in every]
    seen = list(every)
    positions = fitted(seen)
    for _ in range(ROUNDS):
        found = []
        for one, position, bad, scale in zip(every, positions, off, spacing, strict=True):
            use = np.flatnonzero(one.free_observed)
            noise = None if one.noise is None else one.noise[use]
            now = np.zeros(len(one.rest), dtype=bool)
            way = (position - one.rest)[use]
            now[use] = outlying(one.rest[use], (one.deformed - position)[use], noise, LEAST * scale, bad[use], way)
            found.append(now)
        if all(np.array_equal(a, b) for a, b in zip(off, found, strict=True)):
            break
        off = found
        pairs = zip(every, off, strict=True)
        seen = [dataclasses.replace(one, observed=one.observed & ~bad) if bad.any() else one for one, bad in pairs]
        positions = fitted(seen)
    each = zip(every, positions, off, strict=True)
    return seen, tuple(_named(one.rest, one.deformed, position, bad) for one, position, bad in each)


def outlying(
    rest: FloatArray,
    residual: FloatArray,
    noise: FloatArray | None,
    floor: float,
    known: BoolArray | None = None,
    way: FloatArray | None = None,
) -> BoolArray:
    """(n,) which residuals (n, d) of particles at rest (n, d) are far from those of their neighbours.

    noise: (n,) stated deviation of a coordinate, None if unknown; floor: least deviation; known: (n,) outliers that are
    known already, with which no other particle is compared; way: (n, d) displacement that the model expects, on which
    lost tracks stay behind"""
    n, d = rest.shape
    none = np.zeros(n, dtype=bool)
    good = np.arange(n) if known is None else np.flatnonzero(~known)
    if n < PARTICLES_LEAST or len(good) <= NEIGHBOURS[d]:
        return none
    _, near = cKDTree(rest[good]).query(rest, k=NEIGHBOURS[d] + 1)
    itself = good[near] == np.arange(n)[:, None]
    itself[~itself.any(axis=1), -1] = True  # of one that is no good neighbour, the farthest is one too many
    around = residual[good[near[~itself].reshape(n, -1)]]
    middle = np.median(around, axis=1)
    apart = np.linalg.norm(residual - middle, axis=1)
    typical = float(np.sqrt(2.0 * gammaincinv(0.5 * d, 0.5)))  # median of chi; scipy.stats takes a second to import
    here = np.median(np.linalg.norm(around - middle[:, None], axis=2), axis=1) / typical
    scale = np.maximum(np.maximum(here, np.median(apart[good]) / typical), floor)
    if noise is not None:
        scale = np.maximum(scale, noise)
    # the more there are, the nearer are the next ones looked for (Benjamini and Hochberg 1995)
    chance = gammaincc(0.5 * d, 0.5 * (apart / (SCALE_MARGIN * scale)) ** 2)
    order = np.argsort(chance)
    under = np.flatnonzero(chance[order] <= FALSE_ALARMS * np.arange(1, n + 1) / n)
    found = none.copy()
    found[order[: under[-1] + 1 if under.size else 0]] = True
    if way is not None:
        found[~found] = _behind((residual - middle)[~found], way[~found], SCALE_MARGIN * scale[~found])
    return none if found.mean() > SHARE_MOST else found


def _behind(residual: FloatArray, way: FloatArray, scale: FloatArray) -> BoolArray:
    """(n,) which residuals (n, d) are of tracks that stay behind on paths (n, d), too little to be outliers alone. A
    mixture: an unknown share of tracks does, from `STOPPED` of the way down; scale: (n,) deviation of a coordinate"""
    missing = np.linspace(1.0 - STOPPED, 1.0, 9)[:, None]
    along, length = -np.sum(residual * way, axis=1), np.sum(way**2, axis=1)
    log_ratio = logsumexp((missing * along - 0.5 * missing**2 * length) / scale**2, axis=0) - np.log(len(missing))
    ratio = np.exp(np.minimum(log_ratio, 50.0))
    share = 0.1
    weight = np.zeros(len(residual))
    for _ in range(BEHIND_ROUNDS):
        weight = share * ratio / (1.0 - share + share * ratio)
        share = float(np.mean(weight)) if len(weight) else 0.0
    gain = 2.0 * float(np.sum(np.log1p(share * (ratio - 1.0))))
    return np.asarray(weight > 0.5) if gain > BEHIND_GAIN else np.zeros(len(residual), dtype=bool)


def _named(rest: FloatArray, deformed: FloatArray, expected: FloatArray, off: BoolArray) -> LeftOut:
    """Whether each of the particles (K,) that are off stayed on its expected way, or left it."""
    rows = np.flatnonzero(off)
    way, came = (expected - rest)[rows], (deformed - rest)[rows]
    length = np.sum(way**2, axis=1)
    share = np.sum(way * came, axis=1) / np.maximum(length, 1e-300)
    aside = np.linalg.norm(came - np.clip(share, 0.0, 1.0)[:, None] * way, axis=1)
    behind = (share < STOPPED) & (aside < 0.3 * np.linalg.norm(way - came, axis=1))
    return LeftOut(rows[behind], rows[~behind])
