"""Pokes of a small slab whose truth is known: our own model at a known law, at the lattice that a fit will choose."""

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.fit.model import Observation
from deformscope.stages.msm.poke import Law, Poke, Tip, press
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_fit import flat_edge, scene_below

THICKNESS, SPACING = 0.03, 0.01
LAW = Law(0.45, 0.7, 3)
STIFFNESS = 50.0


def surface() -> MeasuredSurface:
    x, y = np.meshgrid(np.arange(19) * 0.01, np.arange(17) * 0.01, indexing="ij")
    return MeasuredSurface(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, THICKNESS)]), THICKNESS)


def poked(
    at: tuple[float, float],
    *,
    side: float = 0.02,
    depth: float = 0.002,
    law: Law = LAW,
    stiffness: float | None = STIFFNESS,
    noise: float = 0.0,
    slips: bool = True,
    seed: int = 0,
) -> Observation:
    """What is seen of the surface while a flat tip is pressed into the layers."""
    ground = surface()
    tip = Tip("flat", (side, side), slips)
    place = np.array([*at, THICKNESS])
    scene, layers = scene_below(ground, place, tip, SPACING, law.cluster_size or 3)
    found = press(scene, law, Poke(place, tip, depth=depth))
    weights, inside = layers.interpolation(ground.points[:, :2], flat_edge(place, tip))
    moved: FloatArray = np.where(inside[:, None], weights @ (found.position - scene.rest), 0.0)
    touched = np.flatnonzero((np.abs(ground.points[:, :2] - at) <= 0.5 * side + 1e-9).all(axis=1))
    error = np.random.default_rng(seed).normal(0.0, 1.0, moved.shape) * noise
    error[touched] = 0.0
    return Observation(
        ground.points,
        ground.points + moved + error,
        touched,
        np.ones(len(ground.points), dtype=bool),
        force_n=None if stiffness is None else stiffness * found.reaction,
        contact=touched,
    )
