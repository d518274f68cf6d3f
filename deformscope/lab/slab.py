"""A foam slab glued to the ground and pressed from above by a rigid tip, in finite elements: truth for pokes.

Linear elastic, any field of Young's modulus. The mesh covers the slab around the tip and is finest at its edge, where
the pressure of a flat tip is infinite; the surface farther away hardly moves."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.lab.elasticity import ElasticBox, Solved

REACH = 2.4
"""Extent of the mesh beyond the tip, in thicknesses; a free side there changes force and dent by less than 0.3 %."""

GROWTH = 1.6
"""Ratio of the sizes of neighbouring elements, away from the tip."""

MOST_CONTACT_ROUNDS = 30


@dataclass(frozen=True, slots=True)
class Slab:
    """A slab with its corner at the origin, up is +z.

    size: (x, y, thickness) [m]; young: Young's modulus [Pa], a number or a function of places (n, 3); poisson:
    Poisson's ratio"""

    size: tuple[float, float, float]
    young: float | Callable[[FloatArray], FloatArray]
    poisson: float

    def grid(self, spacing: float) -> FloatArray:
        """(n, 3) points of its upper face, `spacing` apart [m], last axis fastest."""
        axes = [np.arange(round(side / spacing) + 1) * spacing for side in self.size[:2]]
        across = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        return np.column_stack([across, np.full(len(across), self.size[2])])


@dataclass(frozen=True, slots=True)
class RigidTip:
    """half: half the sides (x, y) of a flat tip [m], or None for a ball of `radius` [m]; bonded: the tip sticks to the
    foam."""

    half: tuple[float, float] | None = None
    radius: float | None = None
    bonded: bool = False

    def __post_init__(self) -> None:
        if (self.half is None) == (self.radius is None):
            raise InputError("a flat tip or a ball", "both" if self.half is not None else "neither")


@dataclass(frozen=True, slots=True)
class Dent:
    """A slab under a tip. displaced: (n, 3) displacements of the requested points (n, 3) [m]; depth: depth of the tip
    [m]; force: force on the tip [N]; touched: (n,) points under the tip"""

    displaced: FloatArray
    depth: float
    force: float
    touched: BoolArray


def press(
    slab: Slab,
    at: tuple[float, float],
    tip: RigidTip,
    points: FloatArray,
    *,
    depth: float | None = None,
    force: float | None = None,
    finest: float | None = None,
) -> Dent:
    """Press a tip into a slab at a place (x, y) [m], to a depth [m] or with a force [N].

    points: (n, 3) points of the upper face at rest; those beyond the mesh do not move
    finest: size of the elements at the tip [m], default a third of its half width"""
    if (depth is None) == (force is None):
        raise InputError("a depth or a force", "both or neither")
    half = tip.half or (float(tip.radius or 0.0),) * 2
    fine = min(half) / 3.0 if finest is None else finest
    axes = [
        _graded(at[i], half[i], fine, REACH * slab.size[2], slab.size[i], even=tip.radius is not None) for i in range(2)
    ]
    box = ElasticBox(
        axes[0], axes[1], downward(slab.size[2], 0.7 * fine, GROWTH), young=slab.young, poisson=slab.poisson
    )
    aside = box.nodes[:, :2] - at
    upper = box.plane(2, slab.size[2])
    if tip.half is not None:
        under = upper & (np.abs(aside) <= np.asarray(half) + box.tolerance).all(axis=1)
        found = _hold(box, under, np.zeros(len(under)), 1.0, bonded=tip.bonded)
        unit = float(-found.force[under, 2].sum())
        scale = depth if depth is not None else float(force or 0.0) / unit
        moved, depth, load = found.displacement * scale, scale, unit * scale
    else:
        moved, depth, load = _ball(box, upper, aside, float(tip.radius or 0.0), depth, force, bonded=tip.bonded)
    inside = np.ones(len(points), dtype=bool)
    for i in range(2):
        inside &= (points[:, i] >= axes[i][0]) & (points[:, i] <= axes[i][-1])
    displaced = np.zeros(points.shape)
    displaced[inside] = box.sample(moved, points[inside])
    offset = np.abs(points[:, :2] - at)
    if tip.half is not None:
        touched = (offset <= np.asarray(half) + 1e-9).all(axis=1)
    else:
        radius = float(tip.radius or 0.0)
        away = np.linalg.norm(offset, axis=1)
        sunk = depth - radius + np.sqrt(np.maximum(radius**2 - away**2, 0.0))
        touched = (away < radius) & (sunk > 0.0) & (-displaced[:, 2] <= sunk * (1.0 + 1e-3) + 1e-9)
    return Dent(displaced, float(depth), float(load), touched)


def _hold(box: ElasticBox, under: BoolArray, rise: FloatArray, depth: float, *, bonded: bool) -> Solved:
    """Static state with the ground glued, and the nodes under the tip (n,) pressed down by depth - rise [m]."""
    held = np.zeros(box.nodes.shape, dtype=bool)
    held[box.plane(2, 0.0)] = True
    held[under] |= np.array([bonded, bonded, True])
    moved = np.zeros(held.shape)
    moved[under, 2] = rise[under] - depth
    return box.hold(held).solve(moved)


def _ball(
    box: ElasticBox,
    upper: BoolArray,
    aside: FloatArray,
    radius: float,
    depth: float | None,
    force: float | None,
    *,
    bonded: bool,
) -> tuple[FloatArray, float, float]:
    """A ball touches the nodes that it would overlap, and pulls at none: rounds until that is so. upper: (n,) mask of
    the nodes that it may touch; aside: (n, 2) horizontal distance of every node from the ball's middle [m]"""
    away = np.linalg.norm(aside, axis=1)
    rise = np.where(away < radius, radius - np.sqrt(np.maximum(radius**2 - away**2, 0.0)), np.inf)
    candidate = upper & np.isfinite(rise)
    at = depth if depth is not None else 0.1 * radius
    under = candidate & (rise < 0.5 * at)
    for _ in range(MOST_CONTACT_ROUNDS):
        found = _hold(box, under, np.where(candidate, rise, 0.0), at, bonded=bonded)
        press_down = -np.where(under, found.force[:, 2], 0.0)
        load = float(press_down.sum())
        now = under & (press_down > -1e-6 * load)
        now |= candidate & (-found.displacement[:, 2] < at - rise - 1e-6 * at)
        share = 1.0 if force is None else force / max(load, 1e-12)
        if (now == under).all() and abs(share - 1.0) < 1e-3:
            return found.displacement, at, load
        under = now
        if force is not None:
            at *= float(np.clip(share, 0.3, 3.0)) ** (2.0 / 3.0)
    raise InputError("a contact that settles", f"none after {MOST_CONTACT_ROUNDS} rounds", "a finer mesh")


def _graded(middle: float, half: float, fine: float, reach: float, side: float, *, even: bool) -> FloatArray:
    """(n,) element borders along one axis of the slab [m]: even under the tip, growing beyond its edge."""
    count = max(2, round(half / fine))
    inner = np.linspace(-half, half, 2 * count + 1)
    if not even:
        inner = half * np.sin(0.5 * np.pi * inner / half)  # closer at the edges
    step = float(inner[-1] - inner[-2])
    outer = [half]
    while outer[-1] < half + reach:
        outer.append(outer[-1] + step)
        step *= GROWTH
    every = np.concatenate([-np.array(outer[:0:-1]), inner, outer[1:]]) + middle
    low, high = max(0.0, every[0]), min(side, every[-1])
    inner = every[(every > low + 0.3 * fine) & (every < high - 0.3 * fine)]
    return np.concatenate([[low], inner, [high]])


def downward(thickness: float, step: float, growth: float) -> FloatArray:
    """(n,) element borders along z [m], rising: closest below the surface, each step larger by `growth`."""
    depths = [0.0]
    while depths[-1] < thickness:
        depths.append(depths[-1] + step)
        step *= growth
    return thickness * (1.0 - np.array(depths[::-1]) / depths[-1])
