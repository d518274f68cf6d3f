"""Equilibrium of foam at large strain by finite elements: Newton's method with a line search on the energy, and load
steps that are halved if it fails."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from skfem import condense, solve

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError

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

    def uniaxial(self, stretch: float) -> tuple[float, float]:
        """Nominal stress [Pa] at a stretch along one axis, and the stretch across it that leaves no stress there."""
        from scipy.optimize import brentq

        def across(log_across: float) -> float:
            return float(self.derivatives(np.array([stretch, *[np.exp(log_across)] * 2]))[0][1])

        far = abs(float(np.log(stretch))) + 1e-3  # half of it would keep the volume
        lateral = float(np.exp(brentq(across, -far, far, xtol=1e-14)))
        return float(self.derivatives(np.array([stretch, lateral, lateral]))[0][0]), lateral


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
