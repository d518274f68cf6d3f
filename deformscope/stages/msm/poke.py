"""A poke: its place, tip, and depth or force; its touched particles; and the static state under it.

A rigid tip presses the particles under it. They follow it along its direction; sideways they stick to it or slip. A
flat tip touches its whole footprint, a round one as much as it has sunk in. Force is that of the model's energy:
stiffness times the reaction at the touched particles."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.msm.clusters import Clusters
from deformscope.stages.msm.reference import Basis, Volume
from deformscope.stages.msm.solver import Msm, Precision

TipShape = Literal["flat", "disc", "sphere"]
TIP_SHAPES: tuple[TipShape, ...] = ("flat", "disc", "sphere")

SETTLED = 1e-3
"""Accuracy of contact, as a share of the depth, or of the requested force."""

MOST_ROUNDS, MOST_SLIDES = 40, 60

SLIDE = 1.6
"""Slip of a touched particle per distance from its goals: over-relaxation."""


@dataclass(frozen=True, slots=True)
class Tip:
    """A tip: "flat" (a rectangle of size (x, y), in the plane a width), "disc" or "sphere" (a diameter) [m].

    slips: particles under the tip move freely sideways; otherwise they stick to it"""

    shape: TipShape
    size: tuple[float, ...]
    slips: bool = True

    def __post_init__(self) -> None:
        if not self.size or not all(np.isfinite(s) and s > 0.0 for s in self.size):
            raise InputError("a tip size above 0 [m]", ", ".join(f"{s:g}" for s in self.size) or "none")
        if self.shape != "flat" and len(self.size) != 1:
            raise InputError(f"one size, the diameter, of a {self.shape}", f"{len(self.size)}")

    @property
    def width(self) -> float:
        """The tip's smallest side or its diameter [m]."""
        return min(self.size)

    @property
    def half(self) -> FloatArray:
        """(2,) half of its sides, or its radius twice [m]."""
        return np.asarray(0.5 * np.asarray(self.size if len(self.size) == 2 else self.size * 2))

    @property
    def area(self) -> float:
        """Area of the tip's footprint [m^2]; of a sphere its largest section."""
        if self.shape == "flat":
            return self.size[0] * self.size[-1]
        return float(np.pi / 4.0 * self.size[0] ** 2)

    def rise(self, lateral_offsets: FloatArray, spacing: float = 0.0) -> FloatArray:
        """Distance of its surface behind its foremost point, away from its axis (n, d - 1) [m]; inf beyond it.

        spacing: spacing of the particles at these places: a disc then includes those just outside its rim, so that the
        touched area is about that of the disc"""
        grace = 1.0 + 1e-6
        if self.shape == "flat":
            half = self.half if lateral_offsets.shape[1] == 2 else self.half[:1]
            return np.where((np.abs(lateral_offsets) <= half * grace).all(axis=1), 0.0, np.inf)
        radius, away = 0.5 * self.size[0], np.linalg.norm(lateral_offsets, axis=1)
        if self.shape == "disc":
            return np.where(away <= radius * grace + 0.25 * spacing, 0.0, np.inf)
        inside = away < radius
        return np.where(inside, radius - np.sqrt(np.where(inside, radius**2 - away**2, 0.0)), np.inf)


@dataclass(frozen=True, slots=True)
class Poke:
    """One poke at a place (d,) or, on a surface seen from above, (2,) [m], to a depth [m] or with a force [N]."""

    at: FloatArray
    tip: Tip
    depth: float | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        if (self.depth is None) == (self.force is None):
            raise InputError("a depth or a force of the poke", "both" if self.depth is not None else "neither")
        given = self.depth if self.depth is not None else self.force
        if given is None or not (np.isfinite(given) and given > 0.0):
            raise InputError("a depth or force above 0", f"{given}")
        if not np.isfinite(self.at).all():
            raise InputError("a finite place of the poke", "NaN or infinity")


@dataclass(frozen=True, slots=True)
class Law:
    """The simulation's parameters. cluster_size: particles along a side; None = one cluster of all; volume: how theta
    conserves it; eq. 3.17 ("scale") has no energy, so that its forces are those of the projection."""

    beta: float
    theta: float = 0.0
    cluster_size: int | None = 3
    basis: Basis = "linear"
    volume: Volume = "project"


@dataclass(frozen=True, slots=True)
class PokeSetup:
    """A body that is prepared for pokes.

    rest: (K, d); clusters; fixed: (n,) particles that do not move; open: (m,) particles that a tip can touch;
    toward: (d,) unit vector along which a tip moves; spacing: spacing of the particles"""

    rest: FloatArray
    clusters: Clusters
    fixed: IntArray
    open: IntArray
    toward: FloatArray
    spacing: float


@dataclass(frozen=True, slots=True)
class Pressed:
    """A static state under a tip.

    position: (K, d); touched: (m,) particles; depth: depth of the tip below where it first touches; reaction: net force
    along the tip's direction, per unit of stiffness k [m]; converged: state, and sets of touching, sticking and
    slipping particles"""

    position: FloatArray
    touched: IntArray
    depth: float
    reaction: float
    converged: bool


def lateral_offsets(rest: FloatArray, at: FloatArray, toward: FloatArray) -> FloatArray:
    """Places (K, d - 1) of particles across a tip's direction, measured from its axis."""
    across = np.delete(np.eye(len(toward)), int(np.abs(toward).argmax()), axis=0)
    across = across - np.outer(across @ toward, toward)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    if len(across) == 2:
        across[1] -= (across[1] @ across[0]) * across[0]
        across[1] /= np.linalg.norm(across[1])
    return np.asarray((rest - at) @ across.T)


def press(
    scene: PokeSetup,
    law: Law,
    poke: Poke,
    *,
    stiffness: float | None = None,
    deepest: float = np.inf,
    start: FloatArray | None = None,
    precision: Precision = "float64",
    device: str = "cpu",
) -> Pressed:
    """The static state under a poke. With a force, `stiffness` k [N/m] determines its depth.

    poke.at: (d,) a point on the tip's axis; deepest: depth [m] at which the search for that of a force is given up
    start: (K, d) another law's solution of the same poke, near which the state is sought. Each round relaxes the body
    with the touched particles held, and lets slipping ones move until no lateral force remains. It releases from a
    round tip the particles that it would pull, adds those that it reaches, and corrects the depth until the force is as
    requested."""
    if poke.force is not None and not stiffness:
        raise InputError("a depth, or a model with a stiffness", "a force", "fit the model with force_n")
    rise = poke.tip.rise(lateral_offsets(scene.rest[scene.open], poke.at, scene.toward), scene.spacing)
    level = (scene.rest[scene.open] - poke.at) @ scene.toward
    reached = np.isfinite(rise)
    if not reached.any():
        aside = np.linalg.norm(lateral_offsets(scene.rest[scene.open], poke.at, scene.toward), axis=1)
        if aside.min() > scene.spacing + 0.5 * poke.tip.width:
            raise InputError("a poke on the body", f"one {aside.min() - 0.5 * poke.tip.width:.3g} m outside it")
        reached = aside == aside.min()
        rise = np.where(reached, 0.0, rise)
    gap = np.where(reached, rise + level, np.inf)
    gap -= gap.min()
    depth = poke.depth if poke.depth is not None else 0.02 * scene.spacing
    solve = _TipContact(scene, law, poke, gap, stiffness, deepest, precision, device)
    return solve.run(depth, start)


@dataclass(frozen=True, slots=True)
class PokedBody:
    """A body whose touched particles are held, under B laws: position (B, K, d); pull: (B, m, d) reaction at each of
    them per unit of k; hold: (B, m, d) final places of the held particles; converged: (B,)"""

    position: FloatArray
    pull: FloatArray
    hold: FloatArray
    converged: BoolArray


def hold(
    scene: PokeSetup, touched: IntArray, law: Law, precision: Precision, device: str, *, slips: bool = False
) -> Msm:
    """The scene's body with the fixed and the touched particles held, in this order. touched: (n,) indices; slips: they
    are held only along the tip's direction, if that is an axis and the body has several clusters"""
    axis = int(np.abs(scene.toward).argmax())
    slipping = (touched, axis) if slips and abs(scene.toward[axis]) == 1.0 and scene.clusters.count > 1 else None
    held, basis = np.concatenate([scene.fixed, touched]), law.basis
    return Msm(scene.rest, scene.clusters, held, basis=basis, slipping=slipping, precision=precision, device=device)


def settle(
    scene: PokeSetup,
    body: Msm,
    laws: Sequence[Law],
    touched: IntArray,
    at: FloatArray,
    *,
    slips: bool,
    start: FloatArray | None,
) -> PokedBody:
    """The static states with the touched particles at `at` (m, d) or (B, m, d), one for each law. Slipping ones have no
    lateral force, at the same displacement along the tip's direction: `body` finds these positions in one solve if it
    can (`hold`), else in rounds. start: (K, d) or (B, K, d)"""
    toward = scene.toward
    beta, theta = (np.array([getattr(law, name) for law in laws]) for name in ("beta", "theta"))
    at = np.array(np.broadcast_to(at, (len(laws), *at.shape[-2:])))
    fixed = np.broadcast_to(scene.rest[scene.fixed], (len(laws), len(scene.fixed), len(toward)))
    depth = float(np.abs((at - scene.rest[touched]) @ toward).max()) or scene.spacing
    position = start
    for last in range(MOST_SLIDES):
        held = np.concatenate([fixed, at], axis=1)
        state = body.relax(held, beta, theta, volume=laws[0].volume, start=position)
        position, at = state.position, state.position[:, touched]
        pull = body.reaction(position, beta, theta)[:, touched]
        side = (pull - (pull @ toward)[:, :, None] * toward) / body.counts[touched, None]
        off = np.abs(side).max(axis=(1, 2)) > SETTLED * depth
        if not slips or body.slips or not off.any():
            return PokedBody(position, pull, at, state.converged)
        if last == MOST_SLIDES - 1:
            return PokedBody(position, pull, at, state.converged & ~off)
        at = at - SLIDE * side
    raise AssertionError("MOST_SLIDES is above 0")


class _TipContact:
    """The rounds of `press`. gap: (m,) distance of each open particle from the tip at first touch."""

    def __init__(
        self,
        scene: PokeSetup,
        law: Law,
        poke: Poke,
        gap: FloatArray,
        stiffness: float | None,
        deepest: float,
        precision: Precision,
        device: str,
    ) -> None:
        self.scene, self.law, self.poke, self.gap, self.deepest = scene, law, poke, gap, deepest
        self.stiffness, self.precision, self.device = stiffness, precision, device
        self.round_tip = bool((gap[np.isfinite(gap)] > 1e-6 * scene.spacing).any())

    def run(self, depth: float, start: FloatArray | None) -> Pressed:
        """The body pressed to a depth [m]. start: (K, d) positions from which its static state is sought"""
        scene, k = self.scene, self.stiffness
        slide = np.zeros((len(scene.open), len(scene.toward)))
        touched = self.gap < depth if self.round_tip else np.isfinite(self.gap)
        position = start
        body: Msm | None = None
        if start is not None and self.poke.tip.slips:
            moved = (start - scene.rest)[scene.open]
            slide = moved - (moved @ scene.toward)[:, None] * scene.toward
        found = Pressed(scene.rest, scene.open[touched], depth, 0.0, False)
        for _ in range(MOST_ROUNDS):
            here = scene.open[touched]
            body = body or hold(scene, here, self.law, self.precision, self.device, slips=self.poke.tip.slips)
            pushed = scene.rest[here] + (depth - self.gap[touched])[:, None] * scene.toward
            state = settle(
                scene, body, [self.law], here, pushed + slide[touched], slips=self.poke.tip.slips, start=position
            )
            position = state.position[0]
            slide[touched] = state.hold[0] - pushed
            along = state.pull[0] @ scene.toward
            total = float(along.sum())
            settled = bool(state.converged[0])
            if self._touching(touched, along, position, depth):
                body, settled = None, False
            share = 1.0 if self.poke.force is None or k is None else self.poke.force / max(k * total, 1e-300)
            settled &= abs(share - 1.0) <= SETTLED
            found = Pressed(position, here, depth, total, settled)
            if settled or (share == 1.0 and body is not None):
                break
            if abs(share - 1.0) > SETTLED:
                factor = float(np.clip(share, 0.02, 50.0)) ** (2.0 / 3.0 if self.round_tip else 1.0)
                depth *= factor
                slide *= factor
                if depth >= self.deepest:
                    return dataclasses.replace(found, depth=depth, converged=False)
                position = scene.rest + factor * (position - scene.rest)
        return found

    def _touching(self, touched: BoolArray, along: FloatArray, position: FloatArray, depth: float) -> bool:
        """Update the contact set (n,) of a round tip: particles that it would pull leave, those inside it join. Returns
        whether the set changed. along: (touched,) reactions along the push; position: (K, d)"""
        if not self.round_tip:
            return False
        scene = self.scene
        before = touched.copy()
        pulled = np.flatnonzero(touched)[along < -1e-6 * float(np.abs(along).max())]
        moved = (position[scene.open] - scene.rest[scene.open]) @ scene.toward
        touched |= np.isfinite(self.gap) & (moved < depth - self.gap - SETTLED * depth)
        if len(pulled) < np.count_nonzero(before):
            touched[pulled] = False
        return bool((touched != before).any())
