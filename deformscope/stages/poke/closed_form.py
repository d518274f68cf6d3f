"""A rigid tip on an elastic half-space, in closed form, for comparison with the model.

Boussinesq, Hertz, Sneddon: no thickness, no friction, small strain. force identifies E* = E / (1 - nu^2) alone; nu
enters the sideways motion."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.msm.poke import Tip

SQUARE = 1.012
"""A square punch presses as a round one of the same area, times this (King 1987)."""


@dataclass(frozen=True, slots=True)
class HalfSpace:
    """modulus: E* [Pa]; poisson: Poisson's ratio, for the sideways motion."""

    modulus: float
    poisson: float = 0.3

    def force(self, tip: Tip, depth: float) -> float:
        """Force [N] at a depth [m]: F = 2 a E* d of a flat punch (Sneddon 1965), F = 4/3 E* sqrt(R) d^1.5 of a ball
        (Hertz 1881)."""
        return self.modulus * _response(tip, depth)

    def depth(self, tip: Tip, force: float) -> float:
        """Depth [m] at a force [N]."""
        unit = force / self.force(tip, 1.0)
        return float(unit ** (2.0 / 3.0)) if tip.shape == "sphere" else unit

    def surface(self, tip: Tip, depth: float, aside: FloatArray) -> FloatArray:
        """Displacement (n, 3) of points of the surface at (n, 2) from the tip's axis [m], up is +z.

        Below a flat tip the depth itself; beyond it u_z = 2 d / pi asin(a / r), for a ball Hertz's profile. Inwards
        (1 - 2 nu) / (1 - nu) F(r) / (2 pi r E*), F(r) the load within r: exact for round tips."""
        radius = np.maximum(np.linalg.norm(aside, axis=1), 1e-12)
        if tip.shape == "sphere":
            a = np.sqrt(0.5 * tip.size[0] * depth)
            share = np.minimum(radius / a, 1.0)
            inner = depth * (1.0 - 0.5 * share**2)
            far = np.maximum(radius, a)
            outer = depth / np.pi * ((2.0 - (far / a) ** 2) * np.arcsin(a / far) + np.sqrt((far / a) ** 2 - 1.0))
            within = 1.0 - (1.0 - share**2) ** 1.5
        else:
            a = _equivalent_radius(tip)
            share = np.minimum(radius / a, 1.0)
            inner = np.full(len(radius), depth)
            outer = 2.0 * depth / np.pi * np.arcsin(a / np.maximum(radius, a))
            within = 1.0 - np.sqrt(1.0 - share**2)
        down = np.where(radius < a, inner, outer)
        if tip.shape == "flat":
            down = np.where((np.abs(aside) <= tip.half * (1.0 + 1e-6)).all(axis=1), depth, down)
        # Boussinesq: -(1 - 2 nu) P / (4 pi G r) with G = E* (1 - nu) / 2
        ratio = (1.0 - 2.0 * self.poisson) / (1.0 - self.poisson)
        inward = ratio * within * _response(tip, depth) / (2.0 * np.pi * radius)
        return np.column_stack([-aside * (inward / radius)[:, None], -down])


def half_space(tip: Tip, depth: float, force: float, poisson: float = 0.3) -> HalfSpace:
    """The half-space that one poke's force and depth make."""
    return HalfSpace(force / _response(tip, depth), poisson)


def _response(tip: Tip, depth: float) -> float:
    """Force over E* [m^2]."""
    if tip.shape == "sphere":
        return float(4.0 / 3.0 * np.sqrt(0.5 * tip.size[0]) * depth**1.5)
    return 2.0 * _equivalent_radius(tip) * depth


def _equivalent_radius(tip: Tip) -> float:
    """Radius of the round punch that presses as a flat tip does [m]."""
    radius = float(np.sqrt(tip.area / np.pi))
    return SQUARE * radius if tip.shape == "flat" else radius
