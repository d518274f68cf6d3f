"""Surfaces of one to five materials, or of a gradual change, and the stiffness of contacts on them.

Borders are straight or wavy stripes, Voronoi cells, crossed lines or patches of any smooth outline. A contact averages
stiffness over a disc; foam scatters as a sum of random waves."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray

SIZE_M = (0.6, 0.4)
LEAST_SHARE = 0.08
"""Least share of the surface that each material covers."""
LEVEL_N_PER_MM, LEAST_FACTOR = (0.25, 2.5), 1.25
"""Stiffness of materials, even in its logarithm; the least ratio of two."""
CONTACT_M = (0.010, 0.016)
"""Radius of a contact's disc."""
SCATTER, SCATTER_LENGTH_M = (0.02, 0.06), (0.03, 0.08)
WAVES = 60
RINGS = ((0.0, 1), (0.5, 6), (0.9, 12))
"""Places within a contact: radius as a share of its own, and how many."""

Labels = Callable[[FloatArray], IntArray]


@dataclass(frozen=True, slots=True)
class RandomSurface:
    """count: number of materials, 0 where stiffness changes gradually; labels: (n,) labels of places (n, 2) [m]; level:
    (count,) log stiffness [N/mm]; log_stiffness: (n,) log stiffness of places, without scatter; scatter: (n,) scatter
    of places; contact_m: radius of a contact's disc"""

    count: int
    kind: str
    labels: Labels
    level: FloatArray
    log_stiffness: Callable[[FloatArray], FloatArray]
    scatter: Callable[[FloatArray], FloatArray]
    contact_m: float
    scatter_sd: float

    def felt(self, xy_m: FloatArray) -> FloatArray:
        """(n,) log stiffness of contacts at places (n, 2): forces add over a disc."""
        total, number = np.zeros(len(xy_m)), 0
        for share, around in RINGS:
            for angle in 2.0 * np.pi * np.arange(around) / around:
                at = xy_m + share * self.contact_m * np.array([np.cos(angle), np.sin(angle)])
                total += np.exp(self.log_stiffness(at))
                number += 1
        return np.asarray(np.log(total / number) + self.scatter(xy_m))


def random_surface(count: int, seed: int) -> RandomSurface:
    """A surface with a number of materials, 0 = a gradual change."""
    rng = np.random.default_rng([seed, count, 0x3A9])
    labels, kind = _random_labels(rng, count) if count else (_nowhere, "gradual")
    level = _random_levels(rng, max(count, 1))

    def materials(xy_m: FloatArray) -> FloatArray:
        return np.asarray(level[labels(xy_m)])

    plain, scatter_sd = materials, float(np.exp(rng.uniform(*np.log(SCATTER))))
    if count == 0:
        across = np.exp(rng.uniform(np.log(0.6), np.log(3.0))) * _direction(rng)
        bend = _waves(rng, 0.15, 0.35)

        def gradual(xy_m: FloatArray) -> FloatArray:
            return np.asarray(level[0] + (xy_m - 0.5 * np.array(SIZE_M)) @ across + bend(xy_m))

        plain = gradual
    scatter = _waves(rng, scatter_sd, float(rng.uniform(*SCATTER_LENGTH_M)))
    contact_m = float(rng.uniform(*CONTACT_M))
    return RandomSurface(
        count=count,
        kind=kind,
        labels=labels,
        level=level,
        log_stiffness=plain,
        scatter=scatter,
        contact_m=contact_m,
        scatter_sd=scatter_sd,
    )


def _nowhere(xy_m: FloatArray) -> IntArray:
    return np.zeros(len(xy_m), dtype=np.int64)


def _direction(rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _random_levels(rng: np.random.Generator, count: int) -> FloatArray:
    low, high = np.log(LEVEL_N_PER_MM)
    while True:
        level = rng.uniform(low, high, count)
        if count == 1 or np.diff(np.sort(level)).min() > np.log(LEAST_FACTOR):
            return np.asarray(level)


def _waves(rng: np.random.Generator, sd: float, length_m: float) -> Callable[[FloatArray], FloatArray]:
    """A random field of deviation `sd` that changes over `length_m`: plane waves of random direction and phase."""
    wave = rng.standard_normal((WAVES, 2)) / length_m
    phase = rng.uniform(0.0, 2.0 * np.pi, WAVES)
    return lambda xy_m: np.asarray(sd * np.sqrt(2.0 / WAVES) * np.cos(xy_m @ wave.T + phase).sum(axis=1))


def _random_labels(rng: np.random.Generator, count: int) -> tuple[Labels, str]:
    """Labels of `count` materials, each of which covers enough, and what kind of borders they have."""
    x, y = np.meshgrid((np.arange(60) + 0.5) * SIZE_M[0] / 60, (np.arange(40) + 0.5) * SIZE_M[1] / 40)
    cells = np.column_stack([x.ravel(), y.ravel()])
    if count == 1:
        return _nowhere, "one"
    kinds = {"stripes": _stripes, "cells": _cells, "patches": _patches} | ({"crossed": _crossed} if count == 4 else {})
    kind = str(rng.choice(list(kinds)))
    while True:
        labels = kinds[kind](rng, count)
        if np.bincount(labels(cells), minlength=count).min() >= LEAST_SHARE * len(cells):
            return labels, kind


def _stripes(rng: np.random.Generator, count: int) -> Labels:
    normal = _direction(rng)
    wave = float(rng.choice([0.0, 0.015])) * _unit(rng)
    number, phase = 2.0 * np.pi / rng.uniform(0.15, 0.4), rng.uniform(0.0, 2.0 * np.pi)
    corners = np.array([[0.0, 0.0], [SIZE_M[0], 0.0], [0.0, SIZE_M[1]], list(SIZE_M)]) @ normal
    ends = np.sort(rng.uniform(corners.min(), corners.max(), count - 1))
    along = np.array([-normal[1], normal[0]])
    return lambda xy_m: np.searchsorted(ends, xy_m @ normal + wave * np.sin(number * (xy_m @ along) + phase))


def _unit(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.5, 1.0))


def _cells(rng: np.random.Generator, count: int) -> Labels:
    sites = rng.uniform(0.0, 1.0, (count, 2)) * SIZE_M
    return lambda xy_m: ((xy_m[:, None] - sites) ** 2).sum(axis=2).argmin(axis=1)


def _crossed(rng: np.random.Generator, count: int) -> Labels:
    middle, normal = rng.uniform(0.3, 0.7, 2) * SIZE_M, _direction(rng)
    other = np.array([-normal[1], normal[0]])
    return lambda xy_m: (((xy_m - middle) @ normal > 0.0) * 2 + ((xy_m - middle) @ other > 0.0)).astype(np.int64)


def _patches(rng: np.random.Generator, count: int) -> Labels:
    middles = rng.uniform(0.15, 0.85, (count - 1, 2)) * SIZE_M
    radii, harmonic = rng.uniform(0.07, 0.12, count - 1), rng.normal(0.0, 0.1, (count - 1, 3, 2))

    def labels(xy_m: FloatArray) -> IntArray:
        found = np.zeros(len(xy_m), dtype=np.int64)
        for number, (middle, radius, shape) in enumerate(zip(middles, radii, harmonic, strict=True), start=1):
            away = xy_m - middle
            angle = np.arctan2(away[:, 1], away[:, 0])
            edge = radius * (
                1.0 + sum(a * np.cos(m * angle) + b * np.sin(m * angle) for m, (a, b) in enumerate(shape, 2))
            )
            found[np.hypot(*away.T) < edge] = number
        return found

    return labels
