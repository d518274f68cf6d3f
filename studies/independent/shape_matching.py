"""Static states of overlapping shape matching clusters, by NumPy and SciPy alone (Thesis eq. 3.4 to 3.13).

Given the rotation of each cluster, the fixed point of the goal positions is linear in the particles and the same in
each coordinate. So rotations and positions are found in turn, with one factorisation."""

from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

TURNS, SETTLED = 20_000, 1e-10
"""Most rounds, and change of a particle in one, as a share of the body's size, that is the last."""


def windows(shape: tuple[int, ...], size: int) -> Ints:
    """(C, n) particles of every window of `size` particles a side in a full lattice, last axis fastest."""
    sides = [min(size, n) for n in shape]
    index = np.arange(int(np.prod(shape))).reshape(shape)
    corners = product(*(range(n - side + 1) for n, side in zip(shape, sides, strict=True)))
    rows = [
        index[tuple(slice(first, first + side) for first, side in zip(corner, sides, strict=True))].ravel()
        for corner in corners
    ]
    return np.array(rows)


def static_state(rest: Floats, rows: Ints, beta: float, held: Ints, place: Floats) -> Floats:
    """(K, d) where the particles rest while held ones (n,) are at `place` (n, d). rows: (C, n) clusters."""
    count, dim = rest.shape
    local = rest[rows] - rest[rows].mean(axis=1, keepdims=True)
    inverse = np.linalg.pinv(np.einsum("cni,cnj->cij", local, local), rcond=1e-6, hermitian=True)
    share = beta * np.einsum("cni,cij,cmj->cnm", local, inverse, local) + 1.0 / rows.shape[1]
    matrix = np.diag(np.bincount(rows.ravel(), minlength=count).astype(float))
    for row, part in zip(rows, share, strict=True):
        matrix[np.ix_(row, row)] -= part
    free = np.setdiff1d(np.arange(count), held)
    factor = cho_factor(matrix[np.ix_(free, free)])
    state = rest.copy()
    state[held] = place
    change = np.inf
    small = SETTLED * float(np.ptp(rest, axis=0).max())
    for _ in range(TURNS):
        u, _, vt = np.linalg.svd(np.einsum("cni,cnj->cij", state[rows], local))
        u[:, :, -1] *= np.sign(np.linalg.det(u @ vt))[:, None]
        pull = np.zeros((count, dim))
        np.add.at(pull, rows, (1.0 - beta) * np.einsum("cij,cnj->cni", u @ vt, local))
        moved = cho_solve(factor, (pull - matrix[:, held] @ place)[free])
        change = float(np.abs(moved - state[free]).max())
        state[free] = moved
        if change < small:
            return state
    raise RuntimeError(f"no static state within {TURNS} rounds: the last change was {change:g}")
