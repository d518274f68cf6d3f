"""Stiffness from force, since position alone does not identify it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.fit.estimate import Posterior
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.residuals import Explanation
from deformscope.stages.msm.solver import Msm

ONWARD_SHARE = 0.35
"""Standard deviation of a motion that is continued to a body's face, as a share of the difference."""

FLOW_WINDOW_PX = 60.0
"""Distance over which neighbouring flows share their errors: shorter motion waves are flattened (`stages.flow`)."""

CERTAIN = 1e-6
"""Least relative deviation of a stiffness: the resolution of the arithmetic."""


@dataclass(frozen=True, slots=True)
class Stiffness:
    """The energy's stiffness k [N/m] at each value of the parameter, (g,), and its standard deviation there."""

    value: FloatArray
    deviation: FloatArray


def contact_stiffness(seen: Sequence[Observation], level: float) -> tuple[float, tuple[float, float]] | None:
    """Secant stiffness at the contact [N/mm], of all observations with a force; None without one. It is the force over
    the displacement of the contact, with the noise of both."""
    rows = []
    for s in seen:
        if s.force_n is None or s.metres_per_unit is None or (push := pushed_along(s)) is None:
            continue
        _, moved, noise = push
        noise = np.hypot(noise, s.scale_sd * moved)
        rows.append((s.force_n, moved * s.metres_per_unit, s.force_sd_n, noise * s.metres_per_unit))
    applied, moved_m, applied_sd, moved_sd = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    return secant(applied, moved_m, applied_sd, moved_sd, level)


def pushed_along(seen: Observation) -> tuple[FloatArray, float, float] | None:
    """Direction (d,) of the contact's motion, its length and the standard deviation of that [unit]; None without a
    contact that moved.

    In images, whose particles lie in the middle of their cells, it is the motion of the contact's outer face relative
    to that of the still held parts' outer faces: a camera that moves moves both, and one that turns carries them apart.
    Motions are continued by half a spacing along the motion's slope at the face."""
    part = seen.touched
    if not len(part):
        return None
    move = seen.deformed - seen.rest
    still = np.setdiff1d(seen.held, part)
    is_seen = seen.unit == "px" and seen.shape is not None
    relative = move[part].mean(axis=0) - (move[still].mean(axis=0) if is_seen and len(still) else 0.0)
    length = float(np.linalg.norm(relative))
    if length <= 0.0:
        return None
    toward = relative / length
    noise = _mean_noise(seen, part)
    if not is_seen:
        return toward, length, noise
    (at, at_sd), (ground, ground_sd) = _faces(seen, toward)
    noise = float(np.sqrt(noise**2 + (_mean_noise(seen, still) if len(still) else 0.0) ** 2 + at_sd**2 + ground_sd**2))
    return toward, at - ground, noise


def depth_along(seen: Observation, toward: FloatArray) -> float:
    """The contact's depth of `pushed_along` along a direction (2,) [unit]."""
    (at, _), (ground, _) = _faces(seen, toward)
    return at - ground


def _faces(seen: Observation, toward: FloatArray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Displacements of the faces of the contact and of the still parts, with their standard deviations [unit]."""
    still, step, axis = np.setdiff1d(seen.held, seen.touched), lattice_step(seen), int(np.abs(toward).argmax())
    sign = float(np.sign(toward[axis]))
    contact = _face(seen, _outermost(seen, seen.touched, axis, -sign), toward, axis, -sign)
    if not len(still):
        return contact, (0.0, 0.0)
    if np.ptp(seen.rest[still, axis]) < 0.5 * step[axis]:
        return contact, _turned(seen, still, toward, _face(seen, still, toward, axis, sign))
    sides = [(one, side) for side in (-1.0, 1.0) if len(one := _outermost(seen, still, 1 - axis, side)) > 1]
    middle = float(np.median(seen.rest[:, 1 - axis]))
    sides = [(one, side) for one, side in sides if side * (seen.rest[one[0], 1 - axis] - middle) > 0.0]
    if not sides:
        ground = float(((seen.deformed - seen.rest) @ toward)[still].mean()), 0.0
        return contact, _turned(seen, still, toward, ground)
    found = np.array([_turned(seen, one, toward, _face(seen, one, toward, 1 - axis, side)) for one, side in sides])
    return contact, (float(found[:, 0].mean()), float(found[:, 1].max()))


def _turned(seen: Observation, ground: IntArray, toward: FloatArray, moved: tuple[float, float]) -> tuple[float, float]:
    """The motion of a still line of particles (n,), carried to the contact by a camera that turns."""
    x, y = seen.rest[seen.touched].mean(axis=0) - seen.rest[ground].mean(axis=0)
    lever = float(toward @ (-y, x))
    return moved[0] + seen.turn * lever, float(np.hypot(moved[1], seen.turn_sd * lever))


def _outermost(seen: Observation, part: IntArray, axis: int, side: float) -> IntArray:
    """Those of a part (n,) that lie farthest along an axis, within half a spacing. side: -1, 1"""
    height = side * seen.rest[part, axis]
    return np.asarray(part[height > height.max() - 0.5 * lattice_step(seen)[axis]])


def _face(seen: Observation, row: IntArray, toward: FloatArray, axis: int, side: float) -> tuple[float, float]:
    """Displacement along a direction (2,) of the face beyond a line of held particles (n,), and the standard deviation
    of its continuation to there [unit]. axis, side: where the face is, as of `_outermost`"""
    move, step = (seen.deformed - seen.rest) @ toward, lattice_step(seen)
    near = np.abs((seen.rest[:, None] - seen.rest[row]) / step).max(axis=2).min(axis=1) < 1.5
    near &= seen.observed
    near[row] = True
    place = (seen.rest - seen.rest[row].mean(axis=0)) / step
    columns = np.column_stack([np.ones(len(place)), place])[near]
    found = np.linalg.lstsq(columns, move[near], rcond=None)[0]
    onward = 0.5 * side * float(found[1 + axis])
    return float(move[row].mean()) + onward, ONWARD_SHARE * abs(onward)


def lattice_step(seen: Observation) -> FloatArray:
    """(2,) spacing of the particles of an image along x and y [px]."""
    step = []
    for axis in range(2):
        gap = np.diff(np.unique(np.round(seen.rest[:, axis], 6)))
        step.append(float(gap.min()) if len(gap) else np.nan)
    return np.asarray(np.nan_to_num(np.array(step), nan=float(np.nanmin(step))))


def _mean_noise(seen: Observation, part: IntArray) -> float:
    """Standard deviation of the mean motion of particles (n,) [unit]; errors of flow are shared within its window."""
    if seen.noise is None:
        return 0.0
    count = float(len(part))
    if seen.unit == "px":
        count = min(count, 1.0 + float(np.ptp(seen.rest[part], axis=0).max()) / FLOW_WINDOW_PX)
    return float(np.sqrt(np.mean(seen.noise[part] ** 2) / count))


def secant(
    force: FloatArray, depth: FloatArray, force_sd: FloatArray, depth_sd: FloatArray, level: float
) -> tuple[float, tuple[float, float]] | None:
    """Force over depth [N/mm] with its interval at `level`; None without a force and a depth above 0.

    force, force_sd: (n,) [N]; depth, depth_sd: (n,) [m]. The mean is weighted by 1 / variance; if the ratios scatter
    more than their noise, the interval grows by that factor (Birge's ratio)."""
    known = (force > 0.0) & (depth > 0.0)
    if not known.any():
        return None
    each = 1e-3 * force[known] / depth[known]
    relative = np.maximum(np.hypot(force_sd[known] / force[known], depth_sd[known] / depth[known]), CERTAIN)
    weight = (relative * each) ** -2
    value = float(weight @ each / weight.sum())
    birge = float(weight @ (each - value) ** 2) / max(len(each) - 1, 1)
    half = float(ndtri(0.5 + 0.5 * level) * np.sqrt(max(birge, 1.0) / weight.sum()))
    return value, (max(value - half, 0.0), value + half)


def stiffness(
    seen: Sequence[Observation],
    model: Model,
    positions: Sequence[FloatArray],
    beta: FloatArray,
    theta: FloatArray,
    misfit: Sequence[float] | None = None,
) -> Stiffness | None:
    """k at each beta and theta (g,), from the measured forces of all observations; None without a force to compare.

    positions: (g, K, d) for each observation; misfit: misfit of each, as a share of its motion. A static state's energy
    is stationary, so that errors of its positions change its force to the second order: the square of that share adds
    to the force's relative noise. k fits measured = k simulated net force with weights 1 / variance; if several forces
    scatter more than their noise, its deviation grows in proportion (Birge's ratio). Eq. 3.17 has no energy, so with
    theta in that form there is no force to compare."""
    rows = [row for row, s in enumerate(seen) if s.force_n is not None and s.metres_per_unit is not None]
    if not rows or (model.volume == "scale" and theta.any()):
        return None
    simulated = np.zeros((len(beta), len(rows)))
    measured = np.array([float(seen[row].force_n or 0.0) for row in rows])
    for column, row in enumerate(rows):
        s = seen[row]
        body = Msm(s.rest, model.grouping(s), s.held, basis=model.basis, device=model.device)
        contact = s.held if s.contact is None else s.contact
        net = body.reaction(positions[row], beta, theta)[:, contact].sum(axis=1)
        simulated[:, column] = np.linalg.norm(net, axis=1) * float(s.metres_per_unit or 1.0)
    noise = np.array([seen[row].force_sd_n for row in rows])
    missed = np.zeros(len(rows)) if misfit is None else np.array([misfit[row] ** 2 for row in rows])
    scale = np.array([seen[row].scale_sd for row in rows])
    deviation = np.maximum(
        np.sqrt(noise**2 + ((missed**2 + scale**2) * measured**2)), CERTAIN * measured.max(initial=0.0)
    )
    deviation = np.where(deviation > 0.0, deviation, 1.0)
    a, b = simulated / deviation, measured / deviation
    size = np.sum(a**2, axis=1)
    divisor = np.where(size > 0.0, size, 1.0)
    k = np.where(size > 0.0, a @ b / divisor, np.nan)
    scatter = np.sum((b - k[:, None] * a) ** 2, axis=1) / max(len(rows) - 1, 1)
    return Stiffness(k, np.sqrt(np.maximum(scatter, 1.0) / divisor))


def stiffness_interval(
    seen: Sequence[Observation],
    model: Model,
    positions: Sequence[FloatArray],
    beta: FloatArray,
    theta: FloatArray,
    share: FloatArray,
    explanations: Sequence[Explanation],
    level: float,
) -> tuple[float, tuple[float, float]] | None:
    """k at the estimate, the last of some values (g,), and its interval over all of them with weights `share` (g,);
    None without a comparable force. It accounts for the force's noise and the model's misfit."""
    misfit = []
    for s, one in zip(seen, explanations, strict=True):
        motion = float(np.sqrt(np.mean((s.deformed - s.rest)[s.free_observed] ** 2)))
        misfit.append(one.misfit() / motion if motion > 0.0 else 0.0)
    found = stiffness(seen, model, positions, beta, theta, misfit)
    if found is None or not np.isfinite(found.value).all():
        return None
    posterior = stiffness_posterior(found, share)
    k = float(found.value[-1])
    return None if posterior is None else (k, posterior.shortest(level, k))


def stiffness_posterior(found: Stiffness, share: FloatArray) -> Posterior | None:
    """Posterior of k [N/m], with the parameter's probability (g,) at each value; None without a finite force."""
    known = np.isfinite(found.value) & (share > 0.0)
    if not known.any():
        return None
    value, deviation, share = found.value[known], found.deviation[known], share[known]
    grid = np.linspace(max((value - 6.0 * deviation).min(), 0.0), (value + 6.0 * deviation).max(), 2001)
    z = (grid[:, None] - value) / deviation
    density = np.exp(-0.5 * z**2) / deviation @ share
    return Posterior(grid, density / np.trapezoid(density, grid))
