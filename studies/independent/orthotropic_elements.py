"""Plates in plane stress, clamped at both ends and stretched or sheared. Their material may be stiffer along a
direction, and their stiffness may differ from place to place: bilinear elements on their own mesh, and their own
errors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from deformscope.arrays import FloatArray, IntArray

SPACING_M, FINE = 0.01, 3
"""Spacing of particles; elements along a side of one of their cells."""
NOISE_SHARES, NOISE_REACH = (0.005, 0.02), (0.5, 2.0)
"""Deviation of a coordinate, and of the Gaussian filter behind it [spacings]; even in their logarithms."""

PlateWay = Literal["stretch", "shear"]


@dataclass(frozen=True, slots=True)
class OrthotropicLaw:
    """stiff, soft: Young's moduli along the two axes; nu: nu of a pull along the stiff one; shear: modulus; angle:
    angle of the stiff axis from x [rad]"""

    stiff: float
    soft: float
    nu: float
    shear: float
    angle: float

    def matrix(self) -> FloatArray:
        """(3, 3) stresses of strains, engineering shear last, in x and y."""
        compliance = np.array(
            [
                [1.0 / self.stiff, -self.nu / self.stiff, 0.0],
                [-self.nu / self.stiff, 1.0 / self.soft, 0.0],
                [0.0, 0.0, 1.0 / self.shear],
            ]
        )
        c, s = np.cos(self.angle), np.sin(self.angle)
        strain = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])
        return np.asarray(strain.T @ np.linalg.inv(compliance) @ strain)

    def modulus(self, along: FloatArray) -> float:
        """Young's modulus along a direction (2,) of unit length."""
        stress = np.array([along[0] ** 2, along[1] ** 2, along[0] * along[1]])
        return float(1.0 / (stress @ np.linalg.inv(self.matrix()) @ stress))


@dataclass(frozen=True, slots=True)
class Plate:
    """Observation of one deformation. rest, deformed: (K, 2) [m], last axis fastest; held: (n,); shape: shape of the
    lattice"""

    rest: FloatArray
    deformed: FloatArray
    held: IntArray
    shape: tuple[int, int]


def deformed_plate(
    shape: tuple[int, int],
    law: OrthotropicLaw,
    factor: Callable[[FloatArray], FloatArray],
    way: PlateWay,
    strain: float,
) -> tuple[FloatArray, FloatArray]:
    """Particles (K, 2) at rest and moved [m]. factor: factor of the law's stiffness at places (n, 2) [m]"""
    nx, ny = (FINE * (n - 1) + 1 for n in shape)
    h = SPACING_M / FINE
    index = np.arange(nx * ny).reshape(nx, ny)
    corner = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    x, y = np.meshgrid(h * np.arange(nx), h * np.arange(ny), indexing="ij")
    node = np.column_stack([x.ravel(), y.ravel()])
    each = _element(law.matrix(), h)
    weight = factor(node[corner].mean(axis=1))
    dof = np.stack([2 * corner, 2 * corner + 1], axis=-1).reshape(-1, 8)
    values = weight[:, None, None] * each
    rows, columns = np.repeat(dof, 8, axis=1), np.tile(dof, (1, 8))
    whole = coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=(2 * nx * ny, 2 * nx * ny)).tocsr()
    u = np.zeros(2 * nx * ny)
    ends = np.concatenate([index[0], index[-1]])
    fixed = np.concatenate([2 * ends, 2 * ends + 1])
    u[2 * index[-1] + (way == "shear")] = strain * node[:, 0].max()
    free = np.setdiff1d(np.arange(len(u)), fixed)
    u[free] = spsolve(whole[free][:, free].tocsc(), -(whole[free] @ u))
    seen = index[::FINE, ::FINE].ravel()
    return node[seen], node[seen] + u.reshape(-1, 2)[seen]


def _element(law: FloatArray, h: float) -> FloatArray:
    """(8, 8) of a square of side h, corners counted round."""
    found = np.zeros((8, 8))
    side = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for s in side / np.sqrt(3.0):
        slope = np.column_stack([side[:, 0] * (1 + side[:, 1] * s[1]), side[:, 1] * (1 + side[:, 0] * s[0])]) / (
            2.0 * h
        )
        strain = np.zeros((3, 8))
        strain[0, 0::2], strain[1, 1::2] = slope.T
        strain[2, 0::2], strain[2, 1::2] = slope[:, 1], slope[:, 0]
        found += strain.T @ law @ strain * h * h / 4.0
    return found


def plate_noise(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """(K, 2) errors [m]: white noise on a fine grid under a Gaussian filter, and a twentieth of each particle's own."""
    reach, size = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (NOISE_REACH, NOISE_SHARES))
    pad = 8
    found = []
    for _ in range(2):
        wide = rng.standard_normal((4 * (shape[0] + 2 * pad), 4 * (shape[1] + 2 * pad)))
        smooth = gaussian_filter(wide, 4.0 * reach)
        smooth = (smooth / smooth.std())[4 * pad : -4 * pad : 4, 4 * pad : -4 * pad : 4].ravel()
        found.append(smooth + 0.05 * rng.standard_normal(smooth.size))
    return np.asarray(SPACING_M * size * np.stack(found, axis=-1))


def camera_error(rest: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(K, 2) [m] error of a camera between the two states: a scale along each axis and a slant, up to a mm at the ends,
    and a lens's change, up to a third of one."""
    x = (rest - rest.mean(axis=0)) / np.ptp(rest, axis=0).max() * 2.0
    linear = rng.uniform(-1e-3, 1e-3, (2, 2))
    return np.asarray(x @ linear + (x**2).sum(axis=1, keepdims=True) * x * rng.uniform(-3e-4, 3e-4))


def plate(
    shape: tuple[int, int],
    law: OrthotropicLaw,
    factor: Callable[[FloatArray], FloatArray],
    *,
    way: PlateWay,
    camera: bool,
    rng: np.random.Generator,
    strain: float = 0.06,
) -> Plate:
    """Observation of a plate. factor: factor of the law's stiffness at places (n, 2) [m]; camera: has an error of its
    own"""
    rest, deformed = deformed_plate(shape, law, factor, way, strain)
    deformed = deformed + plate_noise(shape, rng)
    if camera:
        deformed = deformed + camera_error(rest, rng)
    ends = np.flatnonzero((rest[:, 0] < 1e-9) | (rest[:, 0] > rest[:, 0].max() - 1e-9))
    return Plate(rest, deformed, ends, shape)


def orthotropic(rng: np.random.Generator, ratio: float) -> OrthotropicLaw:
    """A material `ratio` times stiffer along one axis, as often along x, along y, or any direction."""
    nu = float(rng.uniform(0.1, 0.4))
    angle = float(rng.choice([0.0, 0.5 * np.pi, rng.uniform(0.0, np.pi)]))
    between = np.sqrt(ratio) / (2.0 * (1.0 + nu)) * float(rng.uniform(0.7, 1.3))
    return OrthotropicLaw(stiff=ratio, soft=1.0, nu=nu, shear=float(between), angle=angle)


def isotropic(nu: float) -> OrthotropicLaw:
    return OrthotropicLaw(stiff=1.0, soft=1.0, nu=nu, shear=0.5 / (1.0 + nu), angle=0.0)
