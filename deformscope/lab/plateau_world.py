"""A slab whose foam yields: a `SlabWorld` with the forces of Ogden's foam at large strain.

Foam with a plateau resists a light touch with its modulus, and a deep one with far less, as its cells' walls buckle.
The reduction is computed once for a foam, a ball and a thickness, around the ball's axis (`axisymmetric_contact`),
relative to the same ball on linear foam. At each depth a touch's force is the linear force times that share. On foam of
one kind, far from its edges, force over depth is therefore that of the large-strain solution.

Not modelled: near a border or an edge, the share is that of the foam below the tip's middle on a level layer of the
same thickness. The dent around the tip is that of linear foam at the same depth, while on a plateau it is narrower.

Equilibrium of foam at large strain by finite elements: Newton's method with a line search on the energy, and load
steps that are halved if it fails."""

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.sparse import csr_matrix
from skfem import Basis, ElementQuad2, ElementVector, FacetBasis, MeshQuad, condense, solve

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.lab.scenes import Piece, Scene
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import Contact, SlabWorld

# Ogden's law of compressible solids (1972), in a form for flexible foam.
#
# In Seth and Hill's strains e_i(x) = (x^a_i - 1) / a_i of the principal stretches l and of the volume J = l_1 l_2 l_3,
# the principal Kirchhoff stresses are those of linear elasticity:
#
# tau_k = sum_i 2 mu_i [ e_i(l_k) + b e_i(J) ],   b = nu / (1 - 2 nu)
# W = sum_i 2 mu_i / a_i^2 [ sum_k (l_k^a_i - 1 - a_i ln l_k) + b (J^a_i - 1 - a_i ln J) ]
#
# - A term with a > 0 yields: pressed to l, its nominal stress tends to -2 mu (1 + b) / (a l), a plateau that rises as
#   it thins.
# - A term with a < 0 stiffens: densification, where cell walls touch.
# - nu is Poisson's ratio of small strains. With a > 0 it falls towards 0 as the foam is pressed, as in real foam
#   (Gibson and Ashby 1997, chapter 5). The law of Ogden and Hill as commonly used for foam (Storåkers 1986) has the
#   same ratio at all strains, which with nu > 0 would remove the plateau; with nu = 0 both laws are one


@dataclass(frozen=True, slots=True)
class OgdenFoam:
    """One foam.

    shear: mu_i [Pa], > 0; exponent: a_i, not 0, one for each; poisson: nu of small strains, 0 to below 1/2"""

    shear: tuple[float, ...]
    exponent: tuple[float, ...]
    poisson: float

    def __post_init__(self) -> None:
        if len(self.shear) != len(self.exponent) or not self.shear:
            raise InputError("an exponent for each shear modulus", f"{len(self.exponent)} for {len(self.shear)}")
        if min(self.shear) <= 0.0 or 0.0 in self.exponent:
            raise InputError("shear moduli above 0 and exponents other than 0", f"{self.shear}, {self.exponent}")
        if not 0.0 <= self.poisson < 0.5:
            raise InputError("a Poisson's ratio from 0 to below 0.5", f"{self.poisson:g}")

    @property
    def volume_share(self) -> float:
        """b of the energy."""
        return self.poisson / (1.0 - 2.0 * self.poisson)

    @property
    def young(self) -> float:
        """Young's modulus of small strains [Pa]."""
        return 2.0 * sum(self.shear) * (1.0 + self.poisson)

    def energy(self, stretch: FloatArray) -> FloatArray:
        """Energy per rest volume [J/m3] at principal stretches (d, ...); with d = 2 the third is 1 (plane strain)."""
        log = np.log(stretch)
        log_j = log.sum(axis=0)
        total = np.zeros_like(log_j)
        for mu, a in zip(self.shear, self.exponent, strict=True):
            shape = (np.expm1(a * log) - a * log).sum(axis=0)
            volume = np.expm1(a * log_j) - a * log_j
            total = total + 2.0 * mu / a**2 * (shape + self.volume_share * volume)
        return np.asarray(total)

    def derivatives(self, stretch: FloatArray) -> tuple[FloatArray, FloatArray]:
        """First and second derivatives of the energy by the principal stretches (d, ...): (d, ...) and (d, d, ...).

        The first are the principal nominal stresses [Pa]."""
        log = np.log(stretch)
        log_j = log.sum(axis=0)
        b, d = self.volume_share, len(stretch)
        kirchhoff = np.zeros_like(stretch)
        second = np.zeros((d, *stretch.shape))
        for mu, a in zip(self.shear, self.exponent, strict=True):
            kirchhoff += 2.0 * mu / a * (np.expm1(a * log) + b * np.expm1(a * log_j))
            second += 2.0 * mu * b * np.exp(a * log_j)
            for axis in range(d):
                second[axis, axis] += 2.0 * mu * np.exp(a * log[axis])
        for axis in range(d):
            second[axis, axis] -= kirchhoff[axis]
        return kirchhoff / stretch, second / (stretch[:, None] * stretch[None, :])


def stress_and_tangent(law: OgdenFoam, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First Piola-Kirchhoff stress (n, d, d) and its derivative (n, d, d, d, d) [Pa] at gradients (n, d, d).

    With d = 2 the strain is plane. From principal stretches: a change of the gradient that is symmetric, or skew, in
    the axes of two of them has its own stiffness (Bonet and Wood 2008, section 6.6)."""
    left, stretch, right_t = np.linalg.svd(gradient)
    right = np.swapaxes(right_t, 1, 2)
    first, second = (np.moveaxis(x, -1, 0) for x in law.derivatives(stretch.T))
    stress = np.einsum("nia,na,nja->nij", left, first, right)
    d = stretch.shape[1]
    local = np.zeros((len(stretch), d, d, d, d))
    for a in range(d):
        for b in range(d):
            local[:, a, a, b, b] = second[:, a, b]
            if a == b:
                continue
            gap = stretch[:, a] - stretch[:, b]
            close = np.abs(gap) < 1e-6  # the difference quotient's limit
            limit = 0.5 * (second[:, a, a] + second[:, b, b]) - second[:, a, b]
            symmetric = np.where(close, limit, (first[:, a] - first[:, b]) / np.where(close, 1.0, gap))
            skew = (first[:, a] + first[:, b]) / (stretch[:, a] + stretch[:, b])
            local[:, a, b, a, b] = 0.5 * (symmetric + skew)
            local[:, a, b, b, a] = 0.5 * (symmetric - skew)
    tangent = np.einsum("nia,njb,nabcd,nkc,nld->nijkl", left, right, local, left, right, optimize=True)
    return stress, tangent


RESIDUAL = 1e-9
"""Forces on free nodes, relative to that on the clamp, at which Newton's method ends."""

ITERATIONS = 20
SHORTEST_STEP = 2.0**-6
"""Smallest share of a Newton step, and of a load step, that is tried."""


class LargeStrain(ABC):
    """Equilibrium of a body at large strain while something is pushed into it, by Newton's method.

    prescribed, free: (n,) degrees of freedom that are held, and all others"""

    prescribed: IntArray
    free: IntArray

    def push(self, state: FloatArray, start: float, end: float) -> FloatArray:
        """The state (2 n,) [m] at depth `end`, from that at `start` [m], in one load step or in as many as it takes."""
        reached, step = start, end - start
        while reached < end:
            step = min(step, end - reached)
            following = self._newton(state, reached, reached + step)
            if following is None:
                step *= 0.5
                if step < SHORTEST_STEP * (end - start):
                    raise InputError(
                        "a push that the finite elements can follow",
                        f"no equilibrium found beyond {1e3 * reached:.2f} mm, before {1e3 * end:.2f} mm",
                        "a smaller depth, a wider clamp or tip, or a law without so flat a plateau",
                    )
                continue
            state, reached = following, reached + step
        return state

    def _newton(self, state: FloatArray, reached: float, depth: float) -> FloatArray | None:
        """Equilibrium at `depth`, from that of a depth nearby; None where it is not found."""
        state = self._begin(state, reached, depth)
        if self._smallest_volume(state) <= 0.0:
            return None
        for _ in range(ITERATIONS):
            force, tangent = self._assemble(state)
            if np.linalg.norm(force[self.free]) <= RESIDUAL * np.linalg.norm(force[self.prescribed]):
                return state
            step = solve(*condense(tangent, -force, x=np.zeros_like(state), D=self.prescribed))
            shortened = self._line_search(state, step, float(force @ step))
            if shortened is None:
                return None
            state = shortened
        return None

    def _line_search(self, state: FloatArray, step: FloatArray, slope: float) -> FloatArray | None:
        """The state (n,) after the longest of 1, 1/2, 1/4... of a step (n,) that lowers the energy as its slope
        predicts (Armijo 1966); None if none does."""
        if slope >= 0.0:  # no descent: the tangent is not positive definite here
            return None
        energy = self._energy(state)
        share = 1.0
        while share >= SHORTEST_STEP:
            trial = state + share * step
            if self._smallest_volume(trial) > 0.0:
                slack = 1e-12 * abs(energy)  # rounding of the sum
                if self._energy(trial) <= energy + 1e-4 * share * slope + slack:
                    return trial
            share *= 0.5
        return None

    @abstractmethod
    def _begin(self, state: FloatArray, reached: float, depth: float) -> FloatArray:
        """Start of the search for a depth [m], from the state (N,) of a solved one nearby; held parts are in their
        place."""

    @abstractmethod
    def _smallest_volume(self, state: FloatArray) -> float:
        """The smallest ratio of an element's volume in state (n,) to that at rest; not above 0 where something is
        turned inside out."""

    @abstractmethod
    def _energy(self, state: FloatArray) -> float:
        """Energy of state (n,), which equilibrium makes least."""

    @abstractmethod
    def _assemble(self, state: FloatArray) -> tuple[FloatArray, Any]:
        """The energy's first and second derivatives, (N,) and (N, N)."""


# A rigid ball pressed into a bonded layer of foam at large strain, without friction: finite elements around its axis.
#
# Nine-node quadrilaterals in a half plane (r, z), whose deformation gradient has the ring's stretch 1 + u_r / r as a
# third axis; Ogden's law. The ball's surface pushes out nodes inside it along its normal. The penalty is so stiff that
# they enter by about a five hundredth of the radius at the highest pressure. Newton's method as in
# `deformscope.lab.plateau_world`.
#
# Forces scale with the law's moduli. So the effect of large strain is one number at each depth: the force over that of
# linear foam of the same modulus (`deformscope.lab.plateau_world`)

FINE = 0.1
"""Size of the elements under the ball, as a share of its radius."""
GROWTH = 1.35
"""Ratio of the sizes of neighbouring elements, away from the contact."""
REACH = 1.6
"""Extent of the mesh beyond the ball, in thicknesses."""
PENALTY = 300.0
"""Pressure per depth of the foam inside the ball, in units of modulus over radius."""


@dataclass(frozen=True, slots=True)
class BallPress:
    """Numbers at each depth, all (n,): depth_m [m]; force_n: force with which the ball pushes down [N]; ground_n: force
    with which the table pushes up; contact_m: radius of the contact [m]"""

    depth_m: FloatArray
    force_n: FloatArray
    ground_n: FloatArray
    contact_m: FloatArray


def press_ball(
    law: OgdenFoam, radius_m: float, thickness_m: float, depths_m: Sequence[float], fine: float = FINE
) -> BallPress:
    """Press the ball to each of the rising depths of its lowest point below the rest surface. fine: size of the
    elements below it, as a share of its radius. Raises InputError if no equilibrium is found."""
    if not (radius_m > 0.0 and len(depths_m) and min(np.diff([0.0, *depths_m])) > 0.0 and depths_m[-1] < thickness_m):
        raise InputError(
            "depths that rise from 0 and end above the table", f"{list(depths_m)}, {thickness_m:g} m thick"
        )
    layer = _Layer(law, radius_m, thickness_m, fine)
    state, reached, rows = layer.basis.zeros(), 0.0, []
    for depth in depths_m:
        state, reached = layer.push(state, reached, depth), depth
        rows.append((depth, *layer.result(state)))
    return BallPress(*np.array(rows).T)


class _Layer(LargeStrain):
    """The layer, meshed, and the ball above it."""

    def __init__(self, law: OgdenFoam, radius_m: float, thickness_m: float, fine: float) -> None:
        self.law = law
        self._radius_m, self._thickness_m, self._depth_m = radius_m, thickness_m, 0.0
        self._penalty = PENALTY * law.young / radius_m
        size = fine * radius_m
        along = _graded(1.2 * radius_m, radius_m + REACH * thickness_m, size)
        down = thickness_m - _graded(min(0.6 * radius_m, 0.5 * thickness_m), thickness_m, size)[::-1]
        mesh, element = MeshQuad.init_tensor(along, down), ElementVector(ElementQuad2())
        self.basis: Any = Basis(mesh, element, intorder=4)
        near = 1e-9 * thickness_m
        top = mesh.facets_satisfying(lambda x: x[1] > thickness_m - near, boundaries_only=True)
        self._top: Any = FacetBasis(mesh, element, facets=top, intorder=4)
        place, axis = self.basis.doflocs, np.zeros(self.basis.N, dtype=int)
        axis[1::2] = 1
        bottom = place[1] < near
        self._pushed_up: IntArray = np.flatnonzero(bottom & (axis == 1))
        self.prescribed: IntArray = np.flatnonzero(bottom | ((place[0] < near) & (axis == 0)))
        self.free: IntArray = self.basis.complement_dofs(self.prescribed)
        self._ring: FloatArray = self.basis.global_coordinates()[0]
        self._top_ring: FloatArray = self._top.global_coordinates()[0]
        self._change, self._move = _changes(self.basis)[0], _changes(self._top)[1]

    def _begin(self, state: FloatArray, reached: float, depth: float) -> FloatArray:
        """A start for depth [m]: the displacements (n,) at depth `reached`, scaled in proportion."""
        self._depth_m = depth
        return state * (depth / reached) if reached > 0.0 else state

    def _gradient(self, state: FloatArray) -> FloatArray:
        """Deformation gradients (elements, points, 3, 3) along r, z and the ring."""
        moved = self.basis.interpolate(state)
        f = np.zeros((*self._ring.shape, 3, 3))
        f[..., :2, :2] = np.moveaxis(np.asarray(moved.grad), (0, 1), (2, 3))
        f[..., 2, 2] = np.asarray(moved)[0] / self._ring
        return f + np.eye(3)

    def _smallest_volume(self, state: FloatArray) -> float:
        f = self._gradient(state)
        return float(min(np.linalg.det(f[..., :2, :2]).min(), f[..., 2, 2].min()))

    def _entered(self, state: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """How far each of the surface's points (facets, points) is inside the ball [m], 0 outside; its direction (2,
        ...) from the ball's middle; its distance from there."""
        place = np.asarray(self._top.global_coordinates()) + np.asarray(self._top.interpolate(state))
        middle = np.array([0.0, self._thickness_m + self._radius_m - self._depth_m])
        away = place - middle[:, None, None]
        distance = np.linalg.norm(away, axis=0)
        return np.maximum(self._radius_m - distance, 0.0), away / distance, distance

    def _energy(self, state: FloatArray) -> float:
        """Energy of state (n,) stored in the foam and in the contact's penalty [J]."""
        stretch = np.linalg.svd(self._gradient(state), compute_uv=False)
        stored = (self.law.energy(np.moveaxis(stretch, -1, 0)) * self._ring * self.basis.dx).sum()
        entered, _, _ = self._entered(state)
        pushed = 0.5 * self._penalty * (entered**2 * self._top_ring * self._top.dx).sum()
        return float(2.0 * np.pi * (stored + pushed))

    def _assemble(self, state: FloatArray) -> tuple[FloatArray, Any]:
        """Forces (n,) [N] and tangent (n, n) [N/m] of state (n,) [m]."""
        f = self._gradient(state)
        stress, tangent = stress_and_tangent(self.law, f.reshape(-1, 3, 3))
        stress, tangent = stress.reshape(*f.shape[:2], 9, 1), tangent.reshape(*f.shape[:2], 9, 9)
        inner = _sums(self.basis, self._change, stress, tangent, self._ring)
        entered, out, distance = self._entered(state)
        out = np.moveaxis(out, 0, -1)[..., None]
        both = out @ np.swapaxes(out, -1, -2)
        aside = (entered / distance)[..., None, None] * (np.eye(2) - both)
        pushed = self._penalty * ((entered > 0.0)[..., None, None] * both - aside)
        push = -self._penalty * entered[..., None, None] * out
        outer = _sums(self._top, self._move, push, pushed, self._top_ring)
        return inner[0] + outer[0], inner[1] + outer[1]

    def result(self, state: FloatArray) -> tuple[float, float, float]:
        """Forces of ball and table [N], radius of the contact [m]."""
        entered, out, _ = self._entered(state)
        force = 2.0 * np.pi * self._penalty * (entered * -out[1] * self._top_ring * self._top.dx).sum()
        moved = self._top_ring + np.asarray(self._top.interpolate(state))[0]
        internal, _ = self._assemble(state)
        return float(force), float(internal[self._pushed_up].sum()), float(moved[entered > 0.0].max(initial=0.0))


def _changes(basis: Basis) -> tuple[FloatArray, FloatArray]:
    """(elements, points, functions, 9) change of the deformation gradient with each function's share, and (..., 2) of
    the place."""
    ring = basis.global_coordinates()[0]
    move = np.stack([np.moveaxis(np.asarray(one[0]), 0, -1) for one in basis.basis], axis=2)
    change = np.zeros((*move.shape[:3], 3, 3))
    change[..., :2, :2] = np.stack(
        [np.moveaxis(np.asarray(one[0].grad), (0, 1), (-2, -1)) for one in basis.basis], axis=2
    )
    change[..., 2, 2] = move[..., 0] / ring[..., None]
    return change.reshape(*move.shape[:3], 9), move


def _sums(basis: Basis, shares: FloatArray, first: FloatArray, second: FloatArray, ring: FloatArray) -> tuple[Any, Any]:
    """(N,) and (N, N): the derivatives first (elements, points, k, 1) and second (..., k, k) by what `shares`
    (elements, points, functions, k) give for each degree of freedom, summed over the rings [N, N/m]."""
    weight = (2.0 * np.pi * ring * basis.dx)[..., None, None]
    vector = (weight * (shares @ first)).sum(axis=1)[..., 0]
    matrix = (weight * (shares @ second @ np.swapaxes(shares, -1, -2))).sum(axis=1)
    place = basis.element_dofs.T
    row, column = (np.broadcast_to(x, matrix.shape).ravel() for x in (place[:, :, None], place[:, None, :]))
    size = (basis.N, basis.N)
    return np.bincount(place.ravel(), vector.ravel(), basis.N), csr_matrix((matrix.ravel(), (row, column)), size)


def _graded(even: float, end: float, size: float) -> FloatArray:
    """(n,) element borders from 0 to `end` [m]: `size` apart as far as `even`, then farther and farther."""
    borders = list(np.linspace(0.0, even, max(2, round(even / size)) + 1))
    step = size
    while borders[-1] + 1.5 * GROWTH * step < end:
        step *= GROWTH
        borders.append(borders[-1] + step)
    return np.array([*borders[:-1], end] if end - borders[-1] < 0.5 * step else [*borders, end])


DEPTHS_M = (0.25e-3, 0.5e-3, 1e-3, 1.5e-3, 2e-3, 3e-3, 4e-3, 6e-3, 8e-3, 10e-3, 12e-3, 15e-3)
"""Depths at which the share is computed, below half the layer's thickness; beyond the last it is constant."""
THICKNESS_STEP_M = 0.005
MODULUS_PA = 1e5
"""Any value would do: forces of both laws are in proportion to it."""


class PlateauWorld(SlabWorld):
    """A scene in which some foams yield (`Piece.plateau_exponent`)."""

    def press(self, tip: RigidTip, center_m: FloatArray) -> Contact:
        """Like `SlabWorld.press`, for a ball with its middle at (3,) [m]."""
        contact = super().press(tip, center_m)
        label = int(self.scene.label(contact.center_m[:2]))
        plateau_exponent = self.scene.pieces[label].plateau_exponent if label >= 0 else 0
        if not plateau_exponent or not len(contact.node) or tip.radius is None:
            return contact
        height_m = float(self.scene.foam_height_m(contact.center_m[:2]))
        steps = max(1, round(height_m / THICKNESS_STEP_M))
        share = _shares(plateau_exponent, self.scene.poisson, tip.radius, steps)(contact.depth_m)
        lost_n = (1.0 - float(share)) * float(contact.node_force_n.sum())
        return replace(contact, force_n=contact.force_n - lost_n * contact.normal)


def force_share(
    plateau_exponent: int, poisson: float, radius_m: float, thickness_m: float, depth_m: FloatArray
) -> FloatArray:
    """(n,) force of foam that yields over that of linear foam of the same modulus, at depths (n,) [m] of a ball.
    plateau_exponent: Ogden's exponent: the plateau is near the modulus over this"""
    linear = SlabWorld(Scene("level", 0, (Piece("", MODULUS_PA),), {}, thickness_m=thickness_m, poisson=poisson))
    middle, tip = 0.5 * np.asarray(linear.scene.size_m), RigidTip(radius=radius_m)
    stays_n = [
        linear.press(tip, np.array([*middle, thickness_m + radius_m - depth])).normal_force_n for depth in depth_m
    ]
    law = OgdenFoam((0.5 * MODULUS_PA / (1.0 + poisson),), (float(plateau_exponent),), poisson)
    return np.asarray(press_ball(law, radius_m, thickness_m, list(depth_m)).force_n / np.array(stays_n))


@functools.lru_cache(maxsize=64)
def _shares(plateau_exponent: int, poisson: float, radius_m: float, steps: int) -> Callable[[float], FloatArray]:
    """The share of the elastic force that is left, as a function of depth [m]; 1 at none."""
    thickness_m = steps * THICKNESS_STEP_M
    depth_m = np.array([depth for depth in DEPTHS_M if depth < 0.5 * thickness_m])
    share = force_share(plateau_exponent, poisson, radius_m, thickness_m, depth_m)
    over = PchipInterpolator([0.0, *depth_m], [1.0, *share])
    return lambda depth: over(np.clip(depth, 0.0, depth_m[-1]))
