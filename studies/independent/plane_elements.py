"""Small deformations of an orthotropic rectangle in plane stress or plane strain: quadratic elements, SciPy alone."""

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

GAUSS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]), np.array([5.0, 8.0, 5.0]) / 9.0
"""Places and weights of integration along one axis."""


def stiffness(ratio: float, nu: float, shear: float | None = None, *, strain: bool = False) -> Floats:
    """(3, 3) stress of strain (xx, yy, 2 xy), for modulus 1 along x and 1 / ratio along y.

    nu: contraction along y of a pull along x; shear: modulus, default that of an even material of the mean modulus
    strain: plane strain, with the same modulus and Poisson's ratio across the plane as along y"""
    along, across = 1.0, 1.0 / ratio
    bend = np.array([[1.0 / along, -nu / along], [-nu / along, 1.0 / across]])
    if strain:
        third = np.array([-nu / along, -nu / across])  # of a pull out of the plane on x and y
        bend = bend - np.outer(third, third) * across
    found = np.zeros((3, 3))
    found[:2, :2] = np.linalg.inv(bend)
    found[2, 2] = np.sqrt(along * across) / (2.0 * (1.0 + nu)) if shear is None else shear
    return found


def deform(shape: tuple[int, int], spacing: float, material: Floats, held: Ints, moved: Floats) -> Floats:
    """(K, 2) displacements of the particles of a full lattice (last axis fastest), one element per cell. Held ones (n,)
    are displaced by (n, 2), and the nodes between neighbouring held ones lie on a straight line with them."""
    nx, ny = 2 * shape[0] - 1, 2 * shape[1] - 1
    number = np.arange(nx * ny).reshape(nx, ny)
    particle = number[::2, ::2].ravel()
    block = _element(spacing, material)
    corners = [number[i : i + 3, j : j + 3].ravel() for i in range(0, nx - 2, 2) for j in range(0, ny - 2, 2)]
    dofs = np.array([np.repeat(2 * some, 2) + np.tile([0, 1], 9) for some in corners])
    rows, columns = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
    size = 2 * nx * ny
    matrix = coo_matrix((np.tile(block.ravel(), len(dofs)), (rows, columns)), shape=(size, size)).tocsr()
    known = np.full((nx * ny, 2), np.nan)
    known[particle[held]] = moved
    grid = known.reshape(nx, ny, 2)
    grid[1::2, ::2] = 0.5 * (grid[:-1:2, ::2] + grid[2::2, ::2])
    grid[::2, 1::2] = 0.5 * (grid[::2, :-1:2] + grid[::2, 2::2])
    flat = known.ravel()
    fixed = np.isfinite(flat)
    flat[~fixed] = spsolve(matrix[~fixed][:, ~fixed].tocsc(), -matrix[~fixed][:, fixed] @ flat[fixed])
    return flat.reshape(-1, 2)[particle]


def _element(spacing: float, material: Floats) -> Floats:
    """(18, 18) stiffness of a square of nine nodes."""
    found = np.zeros((18, 18))
    for x, a in zip(*GAUSS, strict=True):
        for y, b in zip(*GAUSS, strict=True):
            (fx, gx), (fy, gy) = _line(x), _line(y)
            dx, dy = (np.outer(gx, fy).ravel() * 2.0 / spacing, np.outer(fx, gy).ravel() * 2.0 / spacing)
            strain = np.zeros((3, 18))
            strain[0, ::2] = strain[2, 1::2] = dx
            strain[1, 1::2] = strain[2, ::2] = dy
            found += a * b * (spacing / 2.0) ** 2 * strain.T @ material @ strain
    return found


def _line(at: float) -> tuple[Floats, Floats]:
    """(3,) quadratic functions on [-1, 1], and their slopes."""
    return np.array([at * (at - 1.0) / 2.0, 1.0 - at**2, at * (at + 1.0) / 2.0]), np.array(
        [at - 0.5, -2.0 * at, at + 0.5]
    )
