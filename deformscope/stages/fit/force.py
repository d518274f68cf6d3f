"""Stiffness from force, since position alone does not identify it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from deformscope.arrays import FloatArray
from deformscope.stages.fit.estimate import Posterior
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.residuals import Explanation
from deformscope.stages.msm.solver import Msm

FORCE_SHARE = 0.05
"""Standard deviation of a force without stated noise, as a share of the force."""

CERTAIN = 1e-6
"""Least relative deviation of a stiffness: the resolution of the arithmetic."""


@dataclass(frozen=True, slots=True)
class Stiffness:
    """The energy's stiffness k [N/m] at each value of the parameter, (g,), and its standard deviation there."""

    value: FloatArray
    deviation: FloatArray


def contact_stiffness(seen: Sequence[Observation], level: float) -> tuple[float, tuple[float, float]] | None:
    """Secant stiffness at the contact [N/mm], of all observations with a force; None without one. It is the force over
    the mean displacement of the contact's particles, with the noise of both."""
    rows = []
    for s in seen:
        if s.force_n is None or s.metres_per_unit is None or not len(s.touched):
            continue
        moved = float(np.linalg.norm((s.deformed - s.rest)[s.touched].mean(axis=0))) * s.metres_per_unit
        noise = 0.0 if s.noise is None else float(np.sqrt(np.mean(s.noise[s.touched] ** 2) / len(s.touched)))
        force_sd = FORCE_SHARE * s.force_n if s.force_noise_n is None else s.force_noise_n
        rows.append((s.force_n, moved, force_sd, noise * s.metres_per_unit))
    applied, moved_m, applied_sd, moved_sd = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    return secant(applied, moved_m, applied_sd, moved_sd, level)


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
    given = [seen[row].force_noise_n for row in rows]
    noise = np.array([FORCE_SHARE * f if n is None else n for n, f in zip(given, measured, strict=True)])
    missed = np.zeros(len(rows)) if misfit is None else np.array([misfit[row] ** 2 for row in rows])
    deviation = np.maximum(np.hypot(noise, missed * measured), CERTAIN * measured.max(initial=0.0))
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
