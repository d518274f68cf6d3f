"""Large deformations of a rectangular sheet in plane stress: two elastic laws, quadratic elements, SciPy alone.

Energy per volume at rest, of the stretches (a, b, c) with J = a b c, and of Green's strain G:
neo-hooke: mu / 2 (a^2 + b^2 + c^2 - 3 - 2 ln J) + lambda / 2 (ln J)^2 (Bonet and Wood, Nonlinear Continuum Mechanics,
6.4.3), which stiffens under pressure; saint-venant: mu G:G + lambda / 2 (tr G)^2, which softens as foams do.
The stretch c across the sheet makes the stress there zero. At small strains mu and lambda are Lame's constants:
Young's modulus E and Poisson's ratio nu are those of Hooke's law."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Law = Literal["neo-hooke", "saint-venant"]

_AT = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
_WEIGHT = np.array([5.0, 8.0, 5.0]) / 9.0
BALANCED = 1e-12
"""Largest force out of balance at the end of a step, as a share of the modulus times the largest extent."""
MOST_STEPS = 40


@dataclass(frozen=True, slots=True)
class Motion:
    """A displacement field of the sheet: (2 nx + 1, 2 ny + 1, 2) [m] at the corners, the edges' middles and the centres
    of cells between lines xs (nx + 1,) and ys (ny + 1,) [m]."""

    xs: Floats
    ys: Floats
    moved: Floats

    def at(self, place: Floats) -> tuple[Floats, Floats]:
        """Displacements (k, 2) [m] and their slopes (k, 2, 2), `[i, j]` of component i along j, at points (k, 2) at
        rest. Somewhat outside the sheet the nearest cell's quadratic function continues."""
        cell, local, half = [], [], []
        for lines, along in zip((self.xs, self.ys), place.T, strict=True):
            index = np.clip(np.searchsorted(lines, along, side="right") - 1, 0, len(lines) - 2)
            size = 0.5 * (lines[index + 1] - lines[index])
            cell.append(index)
            half.append(size)
            local.append(np.clip((along - lines[index]) / size - 1.0, -1.4, 1.4))
        (fx, gx), (fy, gy) = _line(local[0]), _line(local[1])
        gx, gy = gx / half[0], gy / half[1]
        found, slope = np.zeros((len(place), 2)), np.zeros((len(place), 2, 2))
        for a in range(3):
            for b in range(3):
                node = self.moved[2 * cell[0] + a, 2 * cell[1] + b]
                found += (fx[a] * fy[b])[:, None] * node
                slope[:, :, 0] += (gx[a] * fy[b])[:, None] * node
                slope[:, :, 1] += (fx[a] * gy[b])[:, None] * node
        return found, slope

    def rest_of(self, seen: Floats, start: Floats, within: float) -> Floats:
        """Points at rest (k, 2) that are displaced to `seen` (k, 2), by Newton's method from a guess. within: error
        that is small enough [m]"""
        rest = start.copy()
        left = np.arange(len(rest))
        for _ in range(25):
            moved, slope = self.at(rest[left])
            off = seen[left] - rest[left] - moved
            a, b, c, d = 1.0 + slope[:, 0, 0], slope[:, 0, 1], slope[:, 1, 0], 1.0 + slope[:, 1, 1]
            step = np.column_stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - c * off[:, 0]])
            rest[left] += step / np.maximum(a * d - b * c, 0.1)[:, None]
            left = left[np.abs(off).max(axis=1) > within]
            if left.size == 0:
                break
        return rest


@dataclass(frozen=True, slots=True)
class Sheet:
    """A rectangle of cells between lines xs and ys [m]; modulus E [Pa] and Poisson's ratio below 0.5."""

    xs: Floats
    ys: Floats
    modulus_pa: float
    poisson: float
    law: Law = "neo-hooke"

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of nodes along x and y."""
        return 2 * len(self.xs) - 1, 2 * len(self.ys) - 1

    def nodes(self) -> Floats:
        """(2 nx + 1, 2 ny + 1, 2) places of the nodes at rest [m]."""
        lines = [np.interp(np.arange(2 * len(one) - 1), 2 * np.arange(len(one)), one) for one in (self.xs, self.ys)]
        return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)

    def deform(self, fixed: Bools, targets: Sequence[Floats]) -> tuple[list[Motion], list[Floats]]:
        """The sheet at rest under each of the prescribed displacements, one after the other.

        fixed: (nodes along x, nodes along y, 2) True where a component is prescribed; targets: its values [m], of the
        same shape. Returns the motions, and the forces of the support on the nodes (.., 2) per thickness [N/m]. Raises
        ArithmeticError where no state of balance was found"""
        assembled = _Assembly(self)
        tight = fixed.ravel()
        now = np.zeros(tight.size)
        motions, forces = [], []
        for target in targets:
            now, force = assembled.balance(now, target.ravel(), tight)
            motions.append(Motion(self.xs, self.ys, now.reshape(fixed.shape)))
            forces.append(np.where(tight, force, 0.0).reshape(fixed.shape))
        return motions, forces


class _Assembly:
    """Elements of a sheet, and their balance."""

    def __init__(self, sheet: Sheet) -> None:
        self.mu = sheet.modulus_pa / (2.0 * (1.0 + sheet.poisson))
        self.law = sheet.law
        self.lam = sheet.modulus_pa * sheet.poisson / ((1.0 + sheet.poisson) * (1.0 - 2.0 * sheet.poisson))
        nx, ny = sheet.shape
        number = np.arange(nx * ny).reshape(nx, ny)
        corners = [number[i : i + 3, j : j + 3].ravel() for i in range(0, nx - 2, 2) for j in range(0, ny - 2, 2)]
        self.dofs = (2 * np.array(corners)[:, :, None] + np.arange(2)).reshape(len(corners), 18)
        self.rows, self.columns = np.repeat(self.dofs, 18, axis=1).ravel(), np.tile(self.dofs, (1, 18)).ravel()
        self.size = 2 * nx * ny
        half = np.stack(np.meshgrid(0.5 * np.diff(sheet.xs), 0.5 * np.diff(sheet.ys), indexing="ij"), axis=-1)
        half = half.reshape(-1, 2)
        (f, g) = _line(_AT)
        by_x, by_y = np.einsum("ap,bq->pqab", g, f).reshape(9, 9), np.einsum("ap,bq->pqab", f, g).reshape(9, 9)
        self.slopes = np.stack([by_x, by_y], axis=-1)[None] / half[:, None, None]  # (element, place, node, axis)
        self.weight = np.outer(_WEIGHT, _WEIGHT).ravel() * (half[:, 0] * half[:, 1])[:, None]
        self.enough = BALANCED * sheet.modulus_pa * float(max(np.ptp(sheet.xs), np.ptp(sheet.ys)))

    def balance(self, now: Floats, target: Floats, tight: Bools) -> tuple[Floats, Floats]:
        """Displacement and nodal forces where no free node is pushed and the tight ones are at their targets, from the
        state of balance before, by Newton's method; a step that would turn a cell inside out is taken in part."""
        for _ in range(MOST_STEPS):
            force, matrix = self.assemble(now)
            step = np.where(tight, target - now, 0.0)
            if not step.any() and np.abs(force[~tight]).max(initial=0.0) < self.enough:
                return now, force
            free = matrix[~tight]
            step[~tight] = splu(free[:, ~tight].tocsc()).solve(-force[~tight] - free[:, tight] @ step[tight])
            share = 1.0
            while self.smallest(now + share * step) <= 0.02 and share > 1e-3:
                share *= 0.5
            now = np.where(tight & (share == 1.0), target, now + share * step)
        raise ArithmeticError("no state of balance was found: press less deeply, or in more steps")

    def smallest(self, moved: Floats) -> float:
        """The smallest area of a place in the plane, as a share of that at rest."""
        return float(np.linalg.det(self.gradient(moved)).min())

    def gradient(self, moved: Floats) -> Floats:
        """(element, place, 2, 2) deformation gradient in the plane."""
        node = moved[self.dofs].reshape(-1, 9, 2)
        return np.asarray(np.eye(2) + np.einsum("eni,eqnj->eqij", node, self.slopes))

    def assemble(self, moved: Floats) -> tuple[Floats, Any]:
        """Forces on the nodes (n,), and their slopes, a sparse matrix."""
        grad = self.gradient(moved)
        stress, tangent = self.neo_hooke(grad) if self.law == "neo-hooke" else self.saint_venant(grad)
        force = np.einsum("eq,eqij,eqnj->eni", self.weight, stress, self.slopes, optimize=True)
        half = np.einsum("eq,eqijkl,eqml->eqijkm", self.weight, tangent, self.slopes, optimize=True)
        block = np.einsum("eqijkm,eqnj->enimk", half, self.slopes, optimize=True)
        total = np.bincount(self.dofs.ravel(), force.ravel(), self.size)
        return np.asarray(total, dtype=np.float64), coo_matrix(
            (block.ravel(), (self.rows, self.columns)), shape=(self.size, self.size)
        ).tocsr()

    def neo_hooke(self, grad: Floats) -> tuple[Floats, Floats]:
        """First Piola-Kirchhoff stress (element, place, 2, 2) and its slopes (.., 2, 2, 2, 2)."""
        area = np.linalg.det(grad)
        turned = np.swapaxes(np.linalg.inv(grad), -1, -2)  # inverse transposed
        across = self.across(np.log(area))
        volume = np.log(area * across)[..., None, None]
        stress = self.mu * grad + (self.lam * volume - self.mu) * turned
        eased = 2.0 * self.mu * across**2
        eased = self.lam * eased / (eased + self.lam)
        tangent = self.mu * np.einsum("ik,jl->ijkl", np.eye(2), np.eye(2))
        tangent = tangent + (self.mu - self.lam * volume)[..., None, None] * np.einsum(
            "eqil,eqkj->eqijkl", turned, turned
        )
        tangent = tangent + eased[..., None, None, None, None] * np.einsum("eqij,eqkl->eqijkl", turned, turned)
        return stress, tangent

    def saint_venant(self, grad: Floats) -> tuple[Floats, Floats]:
        """Stress and its slopes as in `neo_hooke`."""
        one = np.eye(2)
        eased = 2.0 * self.mu * self.lam / (2.0 * self.mu + self.lam)
        green = 0.5 * (np.einsum("eqki,eqkj->eqij", grad, grad) - one)
        second = 2.0 * self.mu * green + eased * np.einsum("eqkk,ij->eqij", green, one)
        stress = grad @ second
        left = np.einsum("eqim,eqkm->eqik", grad, grad)
        tangent = np.einsum("ik,eqjl->eqijkl", one, second) + self.mu * np.einsum("eqik,jl->eqijkl", left, one)
        tangent = tangent + self.mu * np.einsum("eqil,eqkj->eqijkl", grad, grad)
        return stress, tangent + eased * np.einsum("eqij,eqkl->eqijkl", grad, grad)

    def across(self, log_area: Floats) -> Floats:
        """The stretch across the sheet at which the stress there is zero: mu (c^2 - 1) + lambda ln(area c) = 0."""
        log = -self.lam / (2.0 * self.mu + self.lam) * log_area
        for _ in range(30):
            square = self.mu * np.exp(2.0 * log)
            step = (square - self.mu + self.lam * (log_area + log)) / (2.0 * square + self.lam)
            log = log - step
            if np.abs(step).max() < 1e-13:
                break
        return np.exp(log)


def _line(at: Floats) -> tuple[Floats, Floats]:
    """(3, ...) quadratic functions on [-1, 1], and their slopes."""
    return np.stack([at * (at - 1.0) / 2.0, 1.0 - at**2, at * (at + 1.0) / 2.0]), np.stack(
        [at - 0.5, -2.0 * at, at + 0.5]
    )
