"""Fit a volume lattice to pokes of a surface: cluster size, beta, theta, and where force was measured the stiffness.

The static state under each poke is compared with the surface around it, between the lattice's columns. Beta and theta
follow the exact sensitivities of the static state to the least squared error (`scipy.optimize.least_squares`); the
cluster size is the one whose errors are smallest on pokes left out, or, with a single poke, on its own surface.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.optimize import least_squares
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, QhullError

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.layers import Layers, Surface, below
from deformscope.stages.msm import clusters
from deformscope.stages.msm.clusters import spacing as median_spacing
from deformscope.stages.msm.solver import Msm, Precision
from deformscope.stages.observation import Observation
from deformscope.stages.poke import Law, Scene, Tip

CLUSTER_SIZES = (2, 3, 4, 5)
"""Tried, where none is asked for."""

CELLS_ACROSS_TIP = 4
"""Lattice cells across the tip by default: with fewer, the force of a wider or narrower tip is off (2 cm to 4 cm on a
layer of 5 cm: 11 % with two cells, 3 % with four)."""

REACH_SHARE, REACH_TIPS = 1.4, 1.0
"""The lattice goes this many thicknesses, and tip widths, beyond the tip on each side: there the surface is quiet."""

NEAR_SHARE = 0.6
"""The surface within this many thicknesses of the tip is compared: beyond, it hardly moves."""

MOST_SHAPES = 4
"""Pokes that beta and theta are fitted to, spread over the surface; the stiffness is found at all."""

SLIPPED = 0.02
"""A tip slips if the particles under it moved sideways among each other by more than this share of the depth."""

DOWN = np.array([0.0, 0.0, -1.0])
BETA_MOST = 0.99


@dataclass(frozen=True, slots=True)
class SeenPoke:
    """One poke of a surface as it was measured.

    at: (3,) the middle of what was touched, at rest [m]; depth: mean displacement of what was touched, downwards [m]
    touched, touched_by: (m, 3) rest and displacement of the touched points; points, moved: (n, 3) of the others seen
    noise: (n,) [m] or None; force: [N] or None
    """

    at: FloatArray
    tip: Tip
    depth: float
    touched: FloatArray
    touched_by: FloatArray
    points: FloatArray
    moved: FloatArray
    noise: FloatArray | None
    force: float | None


def seen_poke(seen: Observation) -> SeenPoke:
    """The poke in an observation of a surface: its contact, or the held particles that moved, is what was touched.

    Raises InputError for a flat (2D) observation, and where nothing was pressed down.
    """
    if seen.rest.shape[1] != 3:
        raise InputError("a surface in space, rest (K, 3), for a body with layers", "2D positions")
    if seen.metres_per_unit != 1.0:
        raise InputError("positions in metres", f"in {seen.unit}")
    move = seen.deformed - seen.rest
    touched = seen.contact
    if touched is None:
        size = np.linalg.norm(move[seen.held], axis=1)
        touched = seen.held[size > 0.5 * size.max(initial=0.0)]
    if not len(touched):
        raise InputError("held particles that were pressed", "none that moved")
    depth = float(-move[touched, 2].mean())
    if depth <= 0.0:
        raise InputError("a poke that presses the surface down (-z)", f"one that moves it by {-depth:g} m along z")
    rest = seen.rest[touched]
    free = seen.free_observed
    sideways = move[touched, :2] - move[touched, :2].mean(axis=0)
    slips = bool(np.abs(sideways).max() > SLIPPED * depth)
    low, high = rest[:, :2].min(axis=0), rest[:, :2].max(axis=0)
    size = np.maximum(high - low, 1e-3 * median_spacing(seen.rest))
    if (high - low).min() <= 0.0:
        size = np.maximum(high - low, median_spacing(seen.rest))
    tip = seen.tip or Tip("flat", (float(size[0]), float(size[1])), slips)
    return SeenPoke(
        at=np.array([*(0.5 * (low + high)), rest[:, 2].mean()]),
        tip=dataclasses.replace(tip, slips=slips),
        depth=depth,
        touched=rest,
        touched_by=move[touched],
        points=seen.rest[free],
        moved=move[free],
        noise=None if seen.noise is None else seen.noise[free],
        force=seen.force_n,
    )


def scene_below(surface: Surface, at: FloatArray, tip: Tip, spacing: float, cluster_size: int) -> tuple[Scene, Layers]:
    """The layers around a place (2,) or (3,), so spaced that the tip spans a whole number of cells, ready to be poked.

    spacing: wished for [m]
    """
    cells = max(1, round(tip.width / spacing))
    fine = tip.width / cells
    centre = np.asarray(at)[:2] + (0.5 * fine if cells % 2 else 0.0)
    reach = 0.5 * max(tip.size) + REACH_SHARE * surface.thickness + REACH_TIPS * tip.width
    layers = below(surface, spacing=fine, centre=centre, reach=reach)
    grouped = clusters.lattice(layers.rest, layers.shape, layers.cell, cluster_size)
    return Scene(layers.rest, grouped, layers.bottom, layers.top, DOWN, fine), layers


def default_spacing(surface: Surface, tip: Tip) -> float:
    """A lattice spacing that resolves the tip without more than some 30 layers [m]."""
    return max(tip.width / CELLS_ACROSS_TIP, surface.thickness / 30.0)


@dataclass(frozen=True, slots=True)
class Shape:
    """How well a law follows the surface.

    law; spacing: of the lattice [m]; error: root mean square distance over the surface near each poke, as a share of
    the depth, (p,); held_out: the same with beta and theta fitted to the other pokes, nan with one poke
    covariance: (2, 2) of (-log(1 - beta), theta) by the residuals' own correlation; converged
    """

    law: Law
    spacing: float
    error: FloatArray
    held_out: FloatArray
    covariance: FloatArray
    converged: bool


class PosedPoke:
    """A measured poke on its lattice: what is held where, and where the surface was seen."""

    def __init__(self, surface: Surface, poke: SeenPoke, spacing: float, size: int, precision: Precision, device: str):
        self.poke = poke
        self.scene, layers = scene_below(surface, poke.at, poke.tip, spacing, size)
        here = self.scene.open[_covered(poke.touched[:, :2], layers.rest[layers.top][:, :2], self.scene.spacing)]
        held = np.concatenate([layers.bottom, here])
        self.body = Msm(layers.rest, self.scene.clusters, held, precision=precision, device=device)
        self.touched = here
        self.target = layers.rest[held].copy()
        self.target[len(layers.bottom) :] += _between(poke.touched[:, :2], poke.touched_by, layers.rest[here, :2])
        weights, inside = layers.interpolation(poke.points[:, :2])
        away = np.abs(poke.points[:, :2] - poke.at[:2]).max(axis=1) - 0.5 * max(poke.tip.size)
        self.near = np.flatnonzero(inside & (away <= NEAR_SHARE * surface.thickness))
        self.weights: csr_array = weights[self.near]
        self.position: FloatArray | None = None

    def settle(self, beta: float, theta: float) -> bool:
        """Relax to the static state; whether it converged."""
        state = self.body.relax(self.target, beta, theta, volume="project", start=self.position)
        if not bool(state.diverged[0]):
            self.position = state.position[0]
        return bool(state.converged[0])

    def residual(self) -> FloatArray:
        """Simulated less seen displacement near the poke, in units of its depth, (n, 3)."""
        assert self.position is not None
        moved = self.weights @ (self.position - self.scene.rest)
        return (moved - self.poke.moved[self.near]) / self.poke.depth

    def slopes(self, beta: float, theta: float) -> FloatArray:
        """Derivatives of `residual` by beta and theta, (2, n, 3)."""
        assert self.position is not None
        by = self.body.sensitivity(self.position, beta, theta, volume="project")
        return np.stack([self.weights @ by.beta[0], self.weights @ by.theta[0]]) / self.poke.depth

    def reaction(self, beta: float, theta: float) -> float:
        """Net force on the tip along its direction per unit of stiffness k [m]."""
        assert self.position is not None
        return float((self.body.reaction(self.position, beta, theta)[0, self.touched] @ DOWN).sum())


def fit_shape(
    posed: Sequence[PosedPoke], *, theta: float | None = None, start: tuple[float, float] = (0.3, 0.5)
) -> tuple[float, float, bool]:
    """Beta and theta of least squared error over pokes; theta: kept where given. Whether all states converged."""
    good = True
    at: list[tuple[float, float]] = [(np.nan, np.nan)]

    def parameters(x: FloatArray) -> tuple[float, float]:
        return float(-np.expm1(-x[0])), float(x[1]) if theta is None else theta

    def settle(x: FloatArray) -> tuple[float, float]:
        nonlocal good
        here = parameters(x)
        if here != at[0]:
            good = all([one.settle(*here) for one in posed])
            at[0] = here
        return here

    def residual(x: FloatArray) -> FloatArray:
        settle(x)
        return np.concatenate([one.residual().ravel() / np.sqrt(max(len(one.near), 1)) for one in posed])

    def slope(x: FloatArray) -> FloatArray:
        beta, known = settle(x)
        by = [one.slopes(beta, known).reshape(2, -1) / np.sqrt(max(len(one.near), 1)) for one in posed]
        every = np.concatenate(by, axis=1).T * np.array([1.0 - beta, 1.0])
        return every if theta is None else every[:, :1]

    first = np.array([-np.log1p(-start[0]), start[1]])
    high = np.array([-np.log1p(-BETA_MOST), 1.0])
    keep = slice(None) if theta is None else slice(1)
    found = least_squares(
        residual,
        first[keep],
        slope,
        bounds=(np.zeros(2)[keep], high[keep]),
        xtol=1e-4,
        ftol=1e-4,
        gtol=1e-8,
        max_nfev=20,
    )
    beta, known = settle(found.x)
    return (0.0 if beta < 1e-3 else beta), known, good and found.status > 0


def _covered(touched: FloatArray, places: FloatArray, spacing: float) -> IntArray:
    """Which of the places (m, 2) lie within what was touched (n, 2); the nearest one at least."""
    grace = 1e-3 * spacing
    try:
        hull = ConvexHull(touched)
        inside = (places @ hull.equations[:, :2].T + hull.equations[:, 2] <= grace).all(axis=1)
    except (QhullError, ValueError):
        inside = np.zeros(len(places), dtype=bool)
    if not inside.any():
        middle = 0.5 * (touched.min(axis=0) + touched.max(axis=0))
        half = np.maximum(0.5 * np.ptp(touched, axis=0), 0.5 * spacing) + grace
        inside = (np.abs(places - middle) <= half).all(axis=1)
    if not inside.any():
        inside[np.argmin(np.linalg.norm(places - touched.mean(axis=0), axis=1))] = True
    return np.flatnonzero(inside)


def _between(place: FloatArray, value: FloatArray, wanted: FloatArray) -> FloatArray:
    """Values (n, 3) at places (n, 2), between them and beyond, at wanted places (m, 2)."""
    nearest = NearestNDInterpolator(place, value)(wanted)
    try:
        inner = LinearNDInterpolator(place, value)(wanted)
    except (QhullError, ValueError):
        return np.asarray(nearest)
    return np.where(np.isnan(inner), nearest, inner)
