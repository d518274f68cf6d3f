"""The narrowest right interval of beta: of a fit that is given the noise's covariance, by NumPy and SciPy alone.

A prior of beta that is flat over its range, and the static states of `shape_matching` through the seen held positions.
What is left of the free particles is then Gaussian, with the noise of the held ones carried over by their effect."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from studies.independent import shape_matching
from studies.independent.observed import BETA_MOST, CELL, Errors, Pushed, covariance

Floats = npt.NDArray[np.float64]

STEP = 1e-3
"""Step of a held coordinate by which its effect is found [spacings]."""

KNOTS, ZOOMS, DROP = 21, 5, 14.0
"""Values of beta that are simulated at once, how often closer together, and the log density that no longer counts."""


def widths(body: Pushed, errors: Errors, tools: tuple[float, ...], level: float) -> tuple[float, ...]:
    """Width of the shortest interval at a level, of fits that allow for a shift of the tool along each axis of such
    deviations [spacings]; 0 = the tool is right."""
    count, dim = body.rest.shape
    rows = shape_matching.windows(body.shape, body.clusters)
    free = np.setdiff1d(np.arange(count), body.held)
    place = body.seen[body.held]

    def state(beta: float, held: Floats) -> Floats:
        return shape_matching.static_state(body.rest, rows, beta, body.held, held)[free].ravel()

    base, steps = state(body.beta, place), STEP * CELL * np.eye(place.size).reshape(-1, *place.shape)
    act = np.stack([(state(body.beta, place + step) - base) / (STEP * CELL) for step in steps], axis=1)
    onto = np.zeros((len(base), count, dim))
    onto[np.arange(len(base)), np.repeat(free, dim), np.tile(np.arange(dim), len(free))] = 1.0
    if errors.held:
        onto[:, body.held] = -act.reshape(len(base), -1, dim)
    noise = body.sigma**2 * np.einsum(
        "acd,ce,bed->ab", onto, covariance(body.rest, errors.cells, errors.smooth), onto, optimize=True
    )
    moved = np.isin(body.held, body.tool)
    shifts = act.reshape(len(base), -1, dim)[:, moved].sum(axis=1)
    whitens = [np.linalg.cholesky(noise + (tool * CELL) ** 2 * shifts @ shifts.T) for tool in tools]

    def left(beta: float) -> Floats:
        return np.asarray(body.seen[free].ravel() - state(beta, place))

    return tuple(_shortest(left, whiten, level) for whiten in whitens)


def _shortest(left: Callable[[float], Floats], whiten: Floats, level: float) -> float:
    low, high = 0.0, float(-np.log1p(-BETA_MOST))
    value = fine = np.zeros(0)
    for _ in range(ZOOMS):
        knots, fine = np.linspace(low, high, KNOTS), np.linspace(low, high, 40 * (KNOTS - 1) + 1)
        each = np.linalg.solve(whiten, np.stack([left(float(beta)) for beta in -np.expm1(-knots)], axis=1))
        value = -0.5 * np.sum(CubicSpline(knots, each, axis=1)(fine) ** 2, axis=0)
        alive = np.flatnonzero(value > value.max() - DROP)
        low, high = fine[max(alive[0] - 1, 0)], fine[min(alive[-1] + 1, len(fine) - 1)]
        if len(alive) > 0.3 * len(fine):
            break
    grid, density = -np.expm1(-fine), np.exp(value - value.max())
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
    start = np.linspace(0.0, 1.0 - level, 201)
    ends = (np.interp(one * mass[-1], mass, grid) for one in (start, start + level))
    return float(np.min(-np.subtract(*ends)))
