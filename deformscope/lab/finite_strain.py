"""Equilibrium of foam at large strain by finite elements: Newton's method with a line search on the energy, and load
steps that are halved if it fails."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from skfem import condense, solve

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError

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
