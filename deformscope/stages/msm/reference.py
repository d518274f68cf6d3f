"""MSM in float64 NumPy, boring, in the order of the thesis's equations: the specification of the warp engine.

What the equations leave open is decided here, for degenerate clusters:

- Flat in space or on a line at rest: the fit uses the directions that the cluster spans (pseudo-inverse, chosen once
  at rest), and eq. 3.17 conserves its area or length instead of its volume.
- Too few particles for the quadratic terms (2x2, 3x3x2...): the same pseudo-inverse; untold terms turn with R.
- Crushed or inverted (det A <= 0): the cube root keeps its sign and the denominator of eq. 3.17 is held at or above
  `MIN_DENOMINATOR`; the rotation is a proper one (det R = +1) always.
- Where several rotations fit equally well (a line, a mirror image, a point): one of the best ones. It is the rest
  orientation, R = I, for a point, and in the plane.
- All particles held: nothing to solve; their positions stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm.clusters import FLAT_MOMENT_RATIO, Clusters, held_mask

Basis = Literal["linear", "quadratic"]

MIN_DENOMINATOR = 0.1
"""Smallest denominator of eq. 3.17: at theta = 1 it stands for a cluster crushed to a thousandth of its volume."""

NO_ROTATION = 1e-6
"""Rotations that differ by less than this share of a cluster's rest moments in how well they fit are equally good."""


@dataclass(frozen=True, slots=True)
class RestCluster:
    """What stays the same about one cluster.

    index: (n,) its particles; mass: (n,); q: (n, d) from the mass centre, in units of the cluster's radius (eq. 3.8)
    q_basis: (n, r) q or q~ of eq. 3.14, mean-centred; inverse: (r, r) pseudo-inverse of sum m q~ q~^T
    span: (d, k) orthonormal directions that it spans; radius: root mean square distance from its centre
    """

    index: IntArray
    mass: FloatArray
    q: FloatArray
    q_basis: FloatArray
    inverse: FloatArray
    span: FloatArray
    radius: float


@dataclass(frozen=True, slots=True)
class Rest:
    """A body at rest: positions (K, d), indices of the held particles (n,), and its clusters."""

    position: FloatArray
    held: IntArray
    clusters: tuple[RestCluster, ...]


def build_rest(
    position: FloatArray, clusters: Clusters, held: IntArray, mass: FloatArray | None = None, basis: Basis = "linear"
) -> Rest:
    """Everything about the rest shape that the equations need. position (K, d) [m], mass (K,) [kg], default 1."""
    position = np.asarray(position, dtype=np.float64)
    mass = np.ones(len(position)) if mass is None else np.asarray(mass, dtype=np.float64)
    return Rest(position, np.asarray(held), tuple(_rest_cluster(position, mass, index, basis) for index in clusters))


def _rest_cluster(position: FloatArray, mass: FloatArray, index: IntArray, basis: Basis) -> RestCluster:
    m = mass[index]
    t0 = np.average(position[index], axis=0, weights=m)
    q = position[index] - t0
    radius = float(np.sqrt(np.average(np.sum(q**2, axis=1), weights=m))) or 1.0
    q = q / radius
    moments, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", m, q, q))
    span = axes[:, moments > FLAT_MOMENT_RATIO * max(moments[-1], np.finfo(float).tiny)]
    q_basis = q if basis == "linear" else quadratic_basis(q, m)
    gram = np.einsum("n,ni,nj->ij", m, q_basis, q_basis)
    inverse = np.linalg.pinv(gram, rcond=FLAT_MOMENT_RATIO, hermitian=True)
    return RestCluster(index, m, q, q_basis, inverse, span, radius)


def quadratic_basis(q: FloatArray, mass: FloatArray) -> FloatArray:
    """q~ of eq. 3.14, (n, 5) in the plane and (n, 9) in space, less its mean: an uncentred basis has a ghost drift."""
    d = q.shape[1]
    squares = [q[:, i] ** 2 for i in range(d)]
    pairs = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    terms = np.column_stack([q, *squares, *[q[:, i] * q[:, j] for i, j in pairs]])
    return np.asarray(terms - np.average(terms, axis=0, weights=mass))


def rotation(a_pq: FloatArray, rest_size: float) -> FloatArray:
    """R of the polar decomposition (eq. 3.9), always proper: maximises tr(R^T A_pq) over rotations.

    rest_size: trace of the rest moments; in the plane, below `NO_ROTATION` of it every rotation is as good, and R = I.
    """
    u, s, vt = np.linalg.svd(a_pq)
    sign = np.ones(len(s))
    sign[-1] = np.sign(np.linalg.det(u @ vt))
    if len(s) == 2 and s[0] + sign[1] * s[1] <= NO_ROTATION * rest_size:
        return np.eye(2)
    return np.asarray(u * sign @ vt)


def conserve_volume(a: FloatArray, theta: float, span: FloatArray) -> FloatArray:
    """A_theta of eq. 3.17 for a (d, d): volume in space, area in the plane, or the measure of the spanned part."""
    k = span.shape[1]
    if theta == 0.0 or k == 0:
        return a
    if k == len(a):
        measure = float(np.linalg.det(a))
    else:
        inside = a @ span
        measure = float(np.sqrt(max(np.linalg.det(inside.T @ inside), 0.0)))
    root = np.sign(measure) * abs(measure) ** (1.0 / k)
    return np.asarray(a / max(theta * root + (1.0 - theta), MIN_DENOMINATOR))


def cluster_goals(x: FloatArray, cluster: RestCluster, beta: float, theta: float) -> FloatArray:
    """Goal positions (n, d) of one cluster's particles (eq. 3.7 to 3.14, 3.17). x: (K, d)."""
    m, d = cluster.mass, x.shape[1]
    t = np.average(x[cluster.index], axis=0, weights=m)
    p = (x[cluster.index] - t) / cluster.radius  # eq. 3.8, in units of the cluster's radius
    a_pq = np.einsum("n,ni,nj->ij", m, p, cluster.q)
    r = rotation(a_pq, float(np.einsum("n,ni,ni->", m, cluster.q, cluster.q)))  # eq. 3.9
    # eq. 3.7, 3.14, as the fit of what the rotation leaves: the same, but terms that the cluster cannot tell follow R
    a_tilde = np.einsum("n,ni,nj->ij", m, p - cluster.q @ r.T, cluster.q_basis) @ cluster.inverse
    a_tilde[:, :d] += r
    a_tilde[:, :d] = conserve_volume(a_tilde[:, :d], theta, cluster.span)  # eq. 3.17
    blend = beta * a_tilde
    blend[:, :d] += (1.0 - beta) * r
    goal = cluster.q_basis @ blend.T  # eq. 3.13; with the quadratic basis eq. 3.14
    return np.asarray(goal * cluster.radius + t)


def goals(x: FloatArray, rest: Rest, beta: float, theta: float = 0.0) -> FloatArray:
    """Mean goal of each particle over its clusters, (K, d) (eq. 3.15). Held particles: their own position."""
    total = np.zeros_like(x)
    count = np.zeros(len(x))
    for cluster in rest.clusters:
        total[cluster.index] += cluster_goals(x, cluster, beta, theta)
        count[cluster.index] += 1
    goal = total / count[:, None]
    goal[rest.held] = x[rest.held]
    return goal


def reaction(x: FloatArray, rest: Rest, beta: float) -> FloatArray:
    """Force on each particle by the body's energy, per unit of its stiffness k, (K, d) (theta = 0).

    F_i = k sum over its clusters of m_i (x_i - goal_i): the gradient of k/2 sum_c (1 - beta) min_R |p - R q|^2 +
    beta min_A |p - A q|^2. At a static state it is 0 at free particles, and what holds the held ones.
    """
    force = np.zeros_like(x)
    for cluster in rest.clusters:
        pull = x[cluster.index] - cluster_goals(x, cluster, beta, 0.0)
        force[cluster.index] += cluster.mass[:, None] * pull
    return force


def step(
    x: FloatArray,
    v: FloatArray,
    rest: Rest,
    held_position: FloatArray,
    *,
    beta: float,
    theta: float = 0.0,
    alpha: float = 1.0,
    dt: float = 2e-3,
    acceleration: Sequence[float] | FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """One time step (Algorithm 1 with eq. 3.11). x, v: (K, d); held_position: (n, d); acceleration: f_ext / m."""
    push = np.zeros(x.shape[1]) if acceleration is None else np.asarray(acceleration, dtype=np.float64)
    x_star = x + (v + push * dt) * dt  # eq. 3.1, 3.2
    x_star[rest.held] = held_position
    goal = goals(x_star, rest, beta, theta)
    x_new = x_star + alpha * (goal - x_star)  # eq. 3.11
    return x_new, (x_new - x) / dt  # eq. 3.12


def relax(
    rest: Rest,
    held_position: FloatArray,
    *,
    beta: float,
    theta: float = 0.0,
    start: FloatArray | None = None,
    tolerance: float = 1e-11,
    max_iterations: int = 3000,
    memory: int = 10,
) -> tuple[FloatArray, float]:
    """The static state x = goals(x), by Anderson's acceleration of that map. Returns (K, d) and the residual.

    Stops when no particle's goal is further from it than `tolerance` times the body's extent; the residual returned
    is that largest distance over the extent. It does not depend on dt, alpha or the start (for theta = 0).
    """
    x = (rest.position if start is None else start).astype(np.float64).copy()
    x[rest.held] = held_position
    free = ~held_mask(len(x), rest.held)
    extent = float(np.ptp(rest.position, axis=0).max()) or 1.0
    states: list[FloatArray] = []
    residuals: list[FloatArray] = []
    worst = 0.0
    for _ in range(max_iterations):
        f = (goals(x, rest, beta, theta) - x)[free].ravel()
        worst = float(np.abs(f).max(initial=0.0)) / extent
        if worst <= tolerance or not np.isfinite(worst):
            break
        states.append(x[free].ravel())
        residuals.append(f)
        del states[: -memory - 1], residuals[: -memory - 1]
        new = states[-1] + f
        if len(states) > 1:
            dx, df = np.diff(states, axis=0).T, np.diff(residuals, axis=0).T
            gamma = np.linalg.lstsq(df, f, rcond=1e-12)[0]
            new = new - (dx + df) @ gamma
        x[free] = new.reshape(-1, x.shape[1])
    return x, worst
