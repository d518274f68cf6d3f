"""Random partitions of a surface into regions: a prior over maps, as curves that can be moved a little.

A map consists of curves. A curve is a line (parallel to a side or in any direction, straight, wavy or a zigzag), a blob
(disc, ellipse, rectangle), or a ring of blobs. A curve may also be a level set of a random field, smooth or of finer
shapes. One curve, or two that bound the same material (two patches, a strip), make two regions. Two curves, the second
within the first one's rest, make three: stripes, a T, a patch in a half, two patches. With more regions, each further
curve divides any of those before it: quadrants, too.

Every curve is a family and a vector of standard normal numbers. Therefore a small change that preserves the prior is
one line of code (preconditioned Crank-Nicolson, Cotter et al. 2013, 4.2), whatever the shape."""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import lru_cache
from typing import cast

import numpy as np
from scipy.special import ndtr

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.regions.touches import MapGrid

LATENTS = 60
"""Number of normal random numbers for a curve; most families need few of them."""

LEAST_AREA_M2 = 0.003
"""Smaller areas are no region: a patch about as wide as three contacts."""

COARSE_M = 0.04
"""Cells in which areas are counted."""

LINE_TILT = np.radians(12.0)
WAVE_M = 0.025
ZIGZAG_M, ZIGZAG_LENGTH_M = (0.02, 0.06), (0.12, 0.4)
BLOB_RADIUS_M = (0.03, 0.16)
RING_SHARES = (0.25, 0.75)
"""Width of a ring, as a share of the way from a blob's border to its middle."""
LEVEL_SET_LENGTH_M, FREE_LENGTH_M = 0.13, 0.075
LEAST_STRENGTH = 0.1
"""Cosines that are weaker than this, of 1 for the longest, are left out."""
OVERHANG = 0.2
"""The level sets' cosines extend beyond the surface by this share, so that its border has no effect."""


class Family(IntEnum):
    """Kind of a curve."""

    SQUARE_LINE = 0
    LINE = 1
    BLOB = 2
    LEVEL_SET = 3
    ZIGZAG = 4
    RING = 5
    FREE = 6


FAMILY_SHARES = (0.32, 0.10, 0.20, 0.10, 0.08, 0.12, 0.08)
"""Shares of curves, in the families' order; of three sets the best for rings and straight borders (`studies.seeds`)."""
DOUBLE_SHARE = 0.15
"""Share of the maps of two regions in which two curves bound the same material."""


@dataclass(frozen=True, slots=True)
class Partitions:
    """n maps of `regions` regions on a surface of `size_m`.

    family: (n, c) `Family` of each curve; the number of curves is two, or one less than that of regions; latent: (n, c,
    LATENTS) standard normal; double: (n,) the second curve counts too in a map of two regions; parent: (n, c) region
    that each curve divides: the area outside is the next region; family_shares: shares of curves in each family, before
    any touch"""

    regions: int
    size_m: tuple[float, float]
    family: IntArray
    latent: FloatArray
    double: BoolArray
    parent: IntArray
    family_shares: tuple[float, ...] = FAMILY_SHARES

    def __len__(self) -> int:
        return len(self.family)

    def take(self, index: IntArray | BoolArray) -> "Partitions":
        """The maps at these indices (n,), or where a mask (B,) is true."""
        return replace(
            self,
            family=self.family[index],
            latent=self.latent[index],
            double=self.double[index],
            parent=self.parent[index],
        )

    def join(self, other: "Partitions") -> "Partitions":
        """These maps followed by those."""
        return replace(
            self,
            family=np.concatenate([self.family, other.family]),
            latent=np.concatenate([self.latent, other.latent]),
            double=np.concatenate([self.double, other.double]),
            parent=np.concatenate([self.parent, other.parent]),
        )

    def instead(self, changed: BoolArray, by: "Partitions") -> "Partitions":
        """Maps of `by` where `changed` (n,), else these."""
        return replace(
            self,
            family=np.where(changed[:, None], by.family, self.family),
            latent=np.where(changed[:, None, None], by.latent, self.latent),
            double=np.where(changed, by.double, self.double),
            parent=np.where(changed[:, None], by.parent, self.parent),
        )

    def labels(self, xy_m: FloatArray) -> IntArray:
        """(n, p) region, from 0 on, at places (p, 2) [m]."""
        first = self._inside(0, xy_m)
        if self.regions == 2 and self.double.any():
            first[self.double] |= self.take(self.double)._inside(1, xy_m)
        label = np.where(first, 0, 1).astype(np.int8)
        for curve in range(1, self.regions - 1):
            label[(label == self.parent[:, curve, None]) & ~self._inside(curve, xy_m)] = curve + 1
        return label

    def shares(self, xy_m: FloatArray, blur_m: float) -> FloatArray:
        """(n, p, regions) share of each region in a contact at places (p, 2): Gaussian of `blur_m` [m]. Each curve
        counts as straight within the blur: a share is normal in the distance."""
        first = ndtr(self._distance(0, xy_m) / blur_m)
        if self.regions == 2 and self.double.any():
            second = ndtr(self.take(self.double)._distance(1, xy_m) / blur_m)
            first[self.double] = 1.0 - (1.0 - first[self.double]) * (1.0 - second)
        found, every = np.empty((*first.shape, self.regions)), np.arange(len(self))
        found[..., 0], found[..., 1] = first, 1.0 - first
        for curve in range(1, self.regions - 1):
            inside, parent = ndtr(self._distance(curve, xy_m) / blur_m), self.parent[:, curve]
            whole = found[every, :, parent]
            found[every, :, parent], found[..., curve + 1] = whole * inside, whole * (1.0 - inside)
        return found

    def admissible(self) -> BoolArray:
        """(n,) maps whose every region is large enough to be one."""
        labels = self.labels(MapGrid(self.size_m, COARSE_M).centres_m)
        least = LEAST_AREA_M2 / COARSE_M**2
        enough = [(labels == region).sum(axis=1) >= least for region in range(self.regions)]
        return np.asarray(np.all(enough, axis=0))

    def _inside(self, curve: int, xy_m: FloatArray) -> BoolArray:
        return self._distance(curve, xy_m, exact=False) > 0.0

    def _distance(self, curve: int, xy_m: FloatArray, exact: bool = True) -> FloatArray:
        """(n, p) signed distance to a curve [m], above 0 inside; not `exact`: its sign alone is right."""
        family, latent = self.family[:, curve], self.latent[:, curve]
        distance = np.empty((len(self), len(xy_m)))
        for kind in Family:
            here = family == kind
            if not here.any():
                continue
            if kind in (Family.SQUARE_LINE, Family.LINE, Family.ZIGZAG):
                distance[here] = _line(latent[here], kind, xy_m, self.size_m, exact)
            elif kind in (Family.BLOB, Family.RING):
                distance[here] = _blob(latent[here], kind, xy_m, self.size_m, exact)
            else:
                distance[here] = _level_set(latent[here], kind, xy_m, self.size_m, exact)
        return distance


def draw(
    rng: np.random.Generator,
    regions: int,
    size_m: tuple[float, float],
    count: int,
    family_shares: tuple[float, ...] = FAMILY_SHARES,
) -> Partitions:
    """`count` admissible maps from the prior. family_shares: family shares of curves in each family"""
    kept: Partitions | None = None
    while kept is None or len(kept) < count:
        wanted = count if kept is None else count - len(kept)
        fresh = _draw(rng, regions, size_m, wanted + wanted // 2 + 8, family_shares)
        fresh = fresh.take(fresh.admissible())
        kept = fresh if kept is None else kept.join(fresh)
    return kept.take(np.arange(count))


def propose(rng: np.random.Generator, maps: Partitions) -> Partitions:
    """A change of every map that is reversible under the prior without its least area. It is a small change of one or
    all numbers of its curves, sometimes a new curve, or another family with the same numbers: a ring has its blob's
    middle and border, a zigzag its line's place and direction."""
    count = len(maps)
    fresh = _draw(rng, maps.regions, maps.size_m, count, maps.family_shares)
    step = np.exp(rng.uniform(np.log(0.04), np.log(1.0), count))[:, None, None]
    moved = np.sqrt(1.0 - step**2) * maps.latent + step * fresh.latent
    # one curve, or both; of maps that one curve makes, that one
    which = np.where((maps.regions == 2) & ~maps.double, 0.0, rng.random(count))
    touched = np.stack([which < 0.65, which >= 0.35], axis=1)[..., None]
    if maps.regions > 3:  # one curve, and each other as often as not
        curves = maps.regions - 1
        sure = np.arange(curves) == rng.integers(curves, size=count)[:, None]
        touched = (sure | (rng.random((count, curves)) < 0.3))[..., None]
    some = rng.random((count, 1, 1)) < 0.5  # some of its numbers, or all
    touched = touched & (~some | (rng.random(maps.latent.shape) < 0.25))
    latent = np.where(touched, moved, maps.latent)
    chance = rng.random(maps.family.shape)
    renewed, other_kind = chance < 0.06, chance < 0.12
    return replace(
        maps,
        family=np.where(other_kind, fresh.family, maps.family),
        latent=np.where(renewed[:, :, None], fresh.latent, latent),
        double=np.where(renewed.any(axis=1), fresh.double, maps.double),
        parent=np.where(renewed, fresh.parent, maps.parent),
    )


def _draw(
    rng: np.random.Generator, regions: int, size_m: tuple[float, float], count: int, family_shares: tuple[float, ...]
) -> Partitions:
    curves = max(2, regions - 1)
    family = rng.choice(len(FAMILY_SHARES), (count, curves), p=family_shares)
    latent, double = rng.standard_normal((count, curves, LATENTS)), rng.random(count) < DOUBLE_SHARE
    last = np.tile(np.arange(curves), (count, 1))
    parent = last if regions <= 3 else rng.integers(last + 1)
    return Partitions(regions, size_m, family, latent, double, parent, family_shares)


def _line(latent: FloatArray, kind: Family, xy_m: FloatArray, size_m: tuple[float, float], exact: bool) -> FloatArray:
    """(n, p) distance to lines through a place anywhere on the surface, on which a sine or a zigzag may ride."""
    free = np.arctan2(latent[:, 0], latent[:, 1])
    square = np.round(free / (np.pi / 2)) * (np.pi / 2) + LINE_TILT * latent[:, 2]
    angle = free if kind == Family.LINE else square
    through = ndtr(latent[:, 3:5]) * np.asarray(size_m)
    pointed = kind == Family.ZIGZAG
    if pointed:
        amplitude = _between(ZIGZAG_M, latent[:, 5])
        number = 2.0 * np.pi / _between(ZIGZAG_LENGTH_M, latent[:, 6])[:, None]
    else:
        amplitude = WAVE_M * np.maximum(latent[:, 5], 0.0)  # half of the lines are straight
        number = 2.0 * np.pi / (0.12 * 4.0 ** ndtr(latent[:, 6]))[:, None]
    phase = 2.0 * np.pi * ndtr(latent[:, 7])[:, None]

    normal = np.stack([np.cos(angle), np.sin(angle)])
    distance = (xy_m @ normal - (through * normal.T).sum(axis=1)).T.copy()
    wavy = amplitude > 0.0
    amplitude, number = amplitude[wavy, None], number[wavy]
    turn = number * (xy_m @ np.stack([-normal[1], normal[0]])[:, wavy]).T + phase[wavy]
    sine = np.sin(turn)
    distance[wavy] -= amplitude * (2.0 / np.pi * np.arcsin(sine) if pointed else sine)
    if exact:
        slope = 2.0 / np.pi if pointed else np.cos(turn)
        distance[wavy] /= np.sqrt(1.0 + (amplitude * number * slope) ** 2)
    return cast(FloatArray, distance)


def _between(limits: tuple[float, float], latent: FloatArray) -> FloatArray:
    """Values of any shape, evenly between the limits in the logarithm, of standard normal numbers (...,)."""
    low, high = np.log(limits)
    return cast(FloatArray, np.exp(low + (high - low) * ndtr(latent)))


def _blob(latent: FloatArray, kind: Family, xy_m: FloatArray, size_m: tuple[float, float], exact: bool) -> FloatArray:
    """(n, p) distance, along the ray from the middle, to discs, ellipses and rectangles with round corners; or to the
    rest outside a hole of the same shape."""
    centre = ndtr(latent[:, :2]) * np.asarray(size_m)
    radius = _between(BLOB_RADIUS_M, latent[:, 2])
    stretch = np.exp(0.5 * np.maximum(np.abs(latent[:, 3]) - 0.5, 0.0) * np.sign(latent[:, 3]))
    power = 2.0 + 6.0 * np.clip(latent[:, 4] - 0.3, 0.0, 1.0)[:, None]
    angle = LINE_TILT * latent[:, 5] + np.where(np.abs(latent[:, 6]) < 1.0, 0.0, np.pi / 4 * latent[:, 6])

    from_centre = xy_m[None] - centre[:, None]
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u = np.abs(cos * from_centre[..., 0] + sin * from_centre[..., 1]) / (radius * stretch)[:, None]
    v = np.abs(-sin * from_centre[..., 0] + cos * from_centre[..., 1]) / (radius / stretch)[:, None]
    low, high = RING_SHARES
    hole = 1.0 - (low + (high - low) * ndtr(latent[:, 7:8])) if kind == Family.RING else np.zeros((len(latent), 1))
    cornered = power[:, 0] > 2.0
    rho = u**2 + v**2  # to the power, as yet
    rho[cornered] = u[cornered] ** power[cornered] + v[cornered] ** power[cornered]
    if not exact:
        return cast(FloatArray, np.where(rho > hole**power, 1.0 - rho, -1.0))
    # a place at 1 is on the border; the ray's length in these units turns the rest into metres
    rho = np.sqrt(rho)
    rho[cornered] **= 2.0 / power[cornered]
    rho = np.maximum(rho, 1e-9)
    away = np.maximum(np.hypot(from_centre[..., 0], from_centre[..., 1]), 1e-9 * radius[:, None])
    inside = 1.0 - rho if kind == Family.BLOB else np.minimum(1.0 - rho, rho - hole)
    return cast(FloatArray, away / rho * inside)


def _level_set(
    latent: FloatArray, kind: Family, xy_m: FloatArray, size_m: tuple[float, float], exact: bool
) -> FloatArray:
    """(n, p) a smooth random field over its slope: the distance to its level set, to first order."""
    length = FREE_LENGTH_M if kind == Family.FREE else LEVEL_SET_LENGTH_M
    wave, weight = _cosines(size_m, length)
    shift = 0.5 * OVERHANG * np.asarray(size_m)
    x, y = (xy_m[:, 0] + shift[0])[:, None] * wave[:, 0], (xy_m[:, 1] + shift[1])[:, None] * wave[:, 1]
    loads = latent[:, : len(weight)] * weight
    value = loads @ (np.cos(x) * np.cos(y)).T
    if not exact:
        return cast(FloatArray, value)
    slope = np.hypot(loads @ (-wave[:, 0] * np.sin(x) * np.cos(y)).T, loads @ (-wave[:, 1] * np.cos(x) * np.sin(y)).T)
    return cast(FloatArray, value / np.maximum(slope, 0.3 / length))


@lru_cache(maxsize=8)
def _cosines(size_m: tuple[float, float], length_m: float) -> tuple[FloatArray, FloatArray]:
    """Wave numbers (c, 2) [1/m] of products of cosines and their weights: a squared exponential's spectrum, as far as
    it matters and there are numbers for it."""
    wide = (1.0 + OVERHANG) * np.asarray(size_m)
    number = np.stack(np.meshgrid(np.arange(24), np.arange(24)), axis=-1).reshape(-1, 2) * np.pi / wide
    strength = np.exp(-0.25 * (number**2).sum(axis=1) * length_m**2)
    order = np.argsort(-strength, kind="stable")[:LATENTS]
    best = order[strength[order] > LEAST_STRENGTH]
    return number[best], strength[best] / np.sqrt((strength[best] ** 2).sum() / 4.0)
