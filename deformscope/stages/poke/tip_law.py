"""Force over depth of a rigid tip on an elastic half-space or layer, for the modulus E* = E / (1 - nu^2).

Small strain, no friction between tip and surface. A layer lies on rigid ground, bonded to it or sliding on it. Its
surface sinks by u(r) = integral of 2 P(k) L(k h) J0(k r) / E* dk under a pressure with the Hankel transform P; for L
see `compliance_left`. Under a round tip this is a Fredholm equation of the second kind (Lebedev and Ufliand 1958; Hayes
et al. 1972, J. Biomech. 5, 541), which Gauss's quadrature solves to more digits than any table has. Under a rectangle,
panels of constant pressure (Love 1929) with the layer's part of L on top."""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.poke.contact import EXPONENT, TipKind

Ground = Literal["half-space", "bonded", "sliding"]

NODES, LAGS, LAST = 40, 400, 25.0
"""Nodes of an equation; of the integral over k h; its end, beyond which a layer is a half-space within 1e-18."""
RADII, LEAST_RADIUS = 40, 0.02
"""Contact radii at which a curve is solved, and the smallest, as a share of the largest."""
WIDEST = 2.26
"""Largest contact radius on a layer over that on a half-space: where a sphere crosses the surface, times 1.6."""
PANELS, NEAREST = 10, 1e-9
"""Panels along each side of a quarter of a rectangle; smallest part of it that distances are taken from."""
MOST_RATIO = 10.0
"""Largest contact radius over thickness."""


@dataclass(frozen=True, slots=True)
class Indenter:
    """A rigid tip. size: the diameter of a sphere or a disc, the two sides of a flat one [m], a cone's half angle
    [deg]"""

    kind: TipKind
    size: tuple[float, ...]

    def __str__(self) -> str:
        unit = "deg half angle" if self.kind == "cone" else "mm"
        scale = 1.0 if self.kind == "cone" else 1e3
        return f"{self.kind} of {' x '.join(f'{scale * one:.4g}' for one in self.size)} {unit}"

    @property
    def radius_m(self) -> float:
        """Radius of a sphere or disc, or of the disc with a rectangle's area [m]; infinite for a cone."""
        if self.kind == "cone":
            return float("inf")
        return float(np.sqrt(np.prod(self.size) / np.pi)) if self.kind == "flat" else 0.5 * self.size[0]

    def scaled(self, factor: float) -> "Indenter":
        """The tip with all its lengths, or the tangent of its half angle, times a factor."""
        if self.kind == "cone":
            return Indenter("cone", (float(np.degrees(np.arctan(factor * np.tan(np.radians(self.size[0]))))),))
        return Indenter(self.kind, tuple(factor * one for one in self.size))

    def contact_radius_m(self, depth_m: float) -> float:
        """Radius of the contact on a half-space at a depth [m]."""
        if self.kind == "sphere":
            return float(np.sqrt(self.radius_m * depth_m))
        return self.radius_m if self.kind != "cone" else float(2.0 / np.pi * self._tangent * depth_m)

    def sunk(self, place: FloatArray, radius_m: float) -> FloatArray:
        """Part of the equation's right side that follows from the tip's shape f: s times the integral of f'(r) /
        sqrt(s^2 - r^2) up to s, for s = place times a radius; a sphere is a paraboloid, as in Hertz's theory."""
        s = place * radius_m
        return s**2 / self.radius_m if self.kind == "sphere" else 0.5 * np.pi / self._tangent * s

    @property
    def _tangent(self) -> float:
        return float(np.tan(np.radians(self.size[0])))


@dataclass(frozen=True)
class TipLaw:
    """Force over depth for E* = 1 Pa, of a tip on a sample.

    tip; thickness_m: thickness of the layer, None = a half-space; ground: what is under it; poisson: Poisson's ratio,
    on which a bonded layer depends even for a given E*; deepest_m: depth up to which it is solved"""

    tip: Indenter
    deepest_m: float
    thickness_m: float | None = None
    ground: Ground = "half-space"
    poisson: float = 0.3

    @property
    def exponent(self) -> float:
        """Exponent of the law of a half-space."""
        return EXPONENT[self.tip.kind]

    def response(self, depth_m: FloatArray | float) -> FloatArray:
        """Force over E* [m^2] at depths (n,) [m]."""
        return self._along(0, depth_m, self.exponent)

    def depth(self, response: FloatArray | float) -> FloatArray:
        """Depth [m] at forces over E* (n,) [m^2]."""
        return self._along(1, response, 1.0 / self.exponent)

    def _along(self, way: int, at: FloatArray | float, first: float) -> FloatArray:
        """The curve through logs (n,), and its powers beyond them: `first`, and the slope of its end. way: 0 from depth
        to force, 1 back"""
        known, values = self._curves[way].x, self._curves[1 - way].x
        log = np.log(np.maximum(at, 1e-60))
        last = (values[-1] - values[-2]) / (known[-1] - known[-2])
        beyond = first * np.minimum(log - known[0], 0.0) + last * np.maximum(log - known[-1], 0.0)
        inside = self._curves[way](np.clip(log, known[0], known[-1]))
        return np.asarray(np.exp(inside + beyond))

    def steepness(self, depth_m: float) -> float:
        """Slope of log force over log depth."""
        log = np.log(self.response(depth_m * np.array([1.0 / 1.01, 1.01])))
        return float(log[1] - log[0]) / (2.0 * float(np.log(1.01)))

    def dents(self, share: FloatArray, depth: float, exponent: float, scale_m: float = 1.0) -> FloatArray:
        """Dents (n,) at shares of the force that makes a dent `depth`, as `contact.DentLaw`, in units of scale_m [m].
        An exponent other than the half-space's bends the law."""
        response = self.response(max(depth, 1e-12) * scale_m)
        return self.depth(share ** (self.exponent / max(exponent, 0.2)) * response) / scale_m

    @cached_property
    def _curves(self) -> tuple[Any, Any]:
        """Log force over E* by log depth, and back."""
        depth, response = map(np.log, self._solved())
        pchip = scipy.interpolate.PchipInterpolator
        return pchip(depth, response), pchip(response, depth)

    def _solved(self) -> tuple[FloatArray, FloatArray]:
        """Depths (n,) [m] and forces over E* (n,) [m^2] of the tip."""
        if self.tip.kind in ("disc", "flat"):
            depth = np.array([1e-3, 1.0]) * self.deepest_m
            radius = self.tip.radius_m
            if self.tip.kind == "disc":
                slope = 2.0 * radius * self.factor(radius)
            else:
                slope = rectangle_response(self.tip.size, self.thickness_m, self.ground, self.poisson)
            return depth, slope * depth
        most = (WIDEST if self.thickness_m else 1.0) * self.tip.contact_radius_m(self.deepest_m)
        radii = np.geomspace(LEAST_RADIUS, 1.0, RADII) * most
        depths, responses = np.empty(RADII), np.empty(RADII)
        for at, radius in enumerate(radii):
            _, weight, flat, own = self._equations(float(radius), self.tip)
            # pressure is finite at the contact's edge, where the solution is 0
            depths[at] = own[-1] / flat[-1]
            responses[at] = 2.0 * radius * (weight @ (depths[at] * flat - own)[:-1])
        return depths, responses

    def factor(self, radius_m: float) -> float:
        """Stiffness of a disc of this radius over that on a half-space, 2 a E*: also the slope dF/dd of any round tip
        whose contact has this radius, over 2 a E*."""
        _, weight, flat, _ = self._equations(radius_m, None)
        return float(weight @ flat[:-1])

    def _equations(
        self, radius_m: float, tip: Indenter | None
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Nodes and weights (n,) within the contact, and the solutions (n + 1,) at them and at its edge, for a right
        side of 1 and for that of the tip's shape."""
        place, weight = _gauss(NODES)
        at = np.append(place, 1.0)
        right = np.column_stack([np.ones(NODES + 1), np.zeros(NODES + 1) if tip is None else tip.sunk(at, radius_m)])
        if self.thickness_m is None:
            return place, weight, right[:, 0], right[:, 1]
        ratio = radius_m / self.thickness_m
        if ratio > MOST_RATIO:
            hint = "a smaller tip, or a thicker sample"
            raise InputError(f"a contact of less than {MOST_RATIO:g} thicknesses", f"{ratio:.3g}", hint)
        kernel = _kernel(self.ground, 3.0 - 4.0 * self.poisson)
        within = kernel(ratio * np.abs(at[:, None] - place)) + kernel(ratio * (at[:, None] + place))
        step = ratio / np.pi * within * weight
        solved = np.linalg.solve(np.eye(NODES) - step[:-1], right[:-1])
        every = np.vstack([solved, right[-1] + step[-1] @ solved])
        return place, weight, every[:, 0], every[:, 1]


def compliance_left(t: FloatArray, ground: Ground, kappa: float) -> FloatArray:
    """1 - L (n,) for t = k h (n,): the part of a half-space's compliance that a layer lacks; kappa: 3 - 4 nu.

    sliding: L = (cosh 2t - 1) / (sinh 2t + 2t); bonded: L = (2 kappa sinh 2t - 4t) / (2 kappa cosh 2t + 4t^2 + 1 +
    kappa^2) (Hayes et al. 1972)"""
    small = np.exp(-2.0 * t)
    if ground == "sliding":
        return np.asarray(2.0 * small * (2.0 * t + 1.0 - small) / np.maximum(1.0 - small**2 + 4.0 * t * small, 1e-300))
    over = 2.0 * kappa * small + 4.0 * t**2 + 4.0 * t + 1.0 + kappa**2
    return np.asarray(small * over / (kappa * (1.0 + small**2) + small * (4.0 * t**2 + 1.0 + kappa**2)))


@cache
def _gauss(count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss's nodes and weights on 0 to 1."""
    place, weight = np.polynomial.legendre.leggauss(count)
    return 0.5 * (place + 1.0), 0.5 * weight


@cache
def _kernel(ground: Ground, kappa: float) -> scipy.interpolate.CubicSpline:
    """Cosine transform of `compliance_left`, over distances in thicknesses."""
    place, weight = _gauss(LAGS)
    t = LAST * place
    left = LAST * weight * compliance_left(t, ground, kappa)
    away = np.concatenate([np.linspace(0.0, 4.0, 400), np.geomspace(4.02, 2.0 * MOST_RATIO, 300)])
    return scipy.interpolate.CubicSpline(away, np.cos(away[:, None] * t) @ left)


def rectangle_response(
    sides_m: tuple[float, ...], thickness_m: float | None, ground: Ground = "half-space", poisson: float = 0.3
) -> float:
    """Force over E* and depth [m] of a flat rectangle with these sides, pressed straight: collocation on panels.

    Panels are narrow at the edges, where the pressure has no bound. On a half-space it is the capacitance of a plate:
    of a square 1.021 times that of the disc of its area."""
    edges = 1.0 - (1.0 - np.linspace(0.0, 1.0, PANELS + 1)) ** 4
    x, y = (0.5 * side * edges for side in sides_m)
    low = np.stack(np.meshgrid(x[:-1], y[:-1], indexing="ij"), axis=-1).reshape(-1, 2)
    high = np.stack(np.meshgrid(x[1:], y[1:], indexing="ij"), axis=-1).reshape(-1, 2)
    middle, area = 0.5 * (low + high), np.prod(high - low, axis=1)
    sinks = np.zeros((len(middle), len(middle)))
    for turn in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        away = middle[:, None] * turn - low, middle[:, None] * turn - high
        corners = [np.stack([away[i][..., 0], away[j][..., 1]], axis=-1) for i in (0, 1) for j in (0, 1)]
        sinks += _love(corners[0]) - _love(corners[1]) - _love(corners[2]) + _love(corners[3])
        if thickness_m is not None:
            place, weight = _gauss(LAGS // 4)
            t = LAST * place
            left = LAST * weight * compliance_left(t, ground, 3.0 - 4.0 * poisson)
            distance = np.linalg.norm(middle[:, None] * turn - middle, axis=-1) / thickness_m
            known = np.linspace(0.0, float(distance.max()) + 1e-9, 400)
            layer = scipy.special.j0(known[:, None] * t) @ left
            sinks -= np.interp(distance, known, layer) * area / thickness_m
    pressure = np.linalg.solve(sinks / np.pi, np.ones(len(middle)))
    return float(4.0 * area @ pressure)


def _love(at: FloatArray) -> FloatArray:
    """x asinh(y / |x|) + y asinh(x / |y|): integral of 1 / r over a rectangle from 0 to (x, y), in (..., 2)."""
    x, y = at[..., 0], at[..., 1]
    safe = np.maximum(np.abs(at), NEAREST * np.abs(at).max())
    return np.asarray(x * np.arcsinh(y / safe[..., 0]) + y * np.arcsinh(x / safe[..., 1]))
