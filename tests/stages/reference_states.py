"""MSM in float64 NumPy, in the order of the thesis's equations: goals, forces, energy, time steps and static states.

The engine's are compared to these."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import brentq

from deformscope.arrays import FloatArray
from deformscope.stages.msm.clusters import held_mask
from deformscope.stages.msm.reference import MIN_DENOMINATOR, NO_ROTATION, Rest, RestCluster, Volume


def rotation(a_pq: FloatArray, rest_size: float) -> FloatArray:
    """R (d, d) of the polar decomposition (eq. 3.9) of A_pq (d, d), always proper: maximises tr(R^T A_pq) over
    rotations.

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


def project_measure(b: FloatArray, span_count: int) -> FloatArray:
    """The matrix of measure 1 that is nearest to b (d, d), in the sum of squares: the "project" mode's answer.

    Only the first k = span_count columns of b may differ from 0. The measure is what they span: det b for k = d, so
    that a cluster turned inside out comes back, and the area or length sqrt(det b^T b) of a flat one."""
    d, k = len(b), span_count
    nearest = np.zeros((d, d))
    if k > 0:
        u, s, vt = np.linalg.svd(b[:, :k], full_matrices=False)
        if k == d and np.linalg.det(u @ vt) < 0.0:
            u[:, -1] *= -1.0
            s[-1] *= -1.0
        nearest[:, :k] = u * _nearest_stretches(s) @ vt
    return nearest


def _nearest_stretches(s: FloatArray) -> FloatArray:
    """The positive numbers (k,) of product 1 nearest to s (k,), which descends and of which only the last may be < 0.

    Lagrange's condition is s'_i - mu / s'_i = s_i with one mu. With the smallest, y = s'_k, chosen, mu = y (y - s_k)
    follows, and so do the others (of their two solutions the larger: at most one of all can be the smaller); what is
    left is one equation for y. Several y solve it only if one is below s_k / 2, and then s has a product above 2."""
    others, smallest = s[:-1], s[-1]
    if not len(others):
        return np.ones(1)

    def stretches(log_y: float) -> FloatArray:
        y = np.exp(log_y)
        # s_i^2 + 4 mu, as a sum of what is never negative
        square = (others - smallest) * (others + smallest) + (smallest - 2.0 * y) ** 2
        return np.append((others + np.sqrt(square)) / 2.0, y)

    def excess(log_y: float) -> float:
        return float(np.sum(np.log(stretches(log_y))))

    # y is at most 1 or s_k / 2, and there the others are at most as large as this
    most = others[0] + np.sqrt(1.0 + abs(smallest))
    low, high = -len(others) * np.log(most) - 1e-3, np.log(max(1.0, smallest / 2.0)) + 1e-3
    ends = np.linspace(low, high, 400 if np.prod(s) > 2.0 else 2)
    signs = np.sign([excess(end) for end in ends])
    roots = [brentq(excess, ends[i], ends[i + 1], xtol=1e-15) for i in np.flatnonzero(signs[:-1] != signs[1:])]
    return min((stretches(root) for root in roots), key=lambda found: float(np.sum((found - s) ** 2)))


def cluster_goals(
    x: FloatArray, cluster: RestCluster, beta: float, theta: float, *, volume: Volume = "scale"
) -> FloatArray:
    """Goal positions (n, d) of one cluster's particles (eq. 3.7 to 3.14; 3.17 or the projection). x: (K, d)."""
    m, d = cluster.mass, x.shape[1]
    t = np.average(x[cluster.index], axis=0, weights=m)
    p = (x[cluster.index] - t) / cluster.radius  # eq. 3.8, in units of the cluster's radius
    a_pq = np.einsum("n,ni,nj->ij", m, p, cluster.q)
    r = rotation(a_pq, float(np.einsum("n,ni,ni->", m, cluster.q, cluster.q)))  # eq. 3.9
    # eq. 3.7, 3.14, as the fit of what the rotation leaves: the same, but undetermined terms follow R
    a_tilde = np.einsum("n,ni,nj->ij", m, p - cluster.q @ r.T, cluster.q_basis) @ cluster.inverse
    a_tilde[:, :d] += r
    if volume == "scale":
        a_tilde[:, :d] = conserve_volume(a_tilde[:, :d], theta, cluster.span)  # eq. 3.17
    elif theta != 0.0:
        b = a_tilde[:, :d] @ cluster.root
        a_tilde += theta * (project_measure(b, cluster.span.shape[1]) - b) @ cluster.lift
    blend = beta * a_tilde
    blend[:, :d] += (1.0 - beta) * r
    goal = cluster.q_basis @ blend.T  # eq. 3.13; with the quadratic basis eq. 3.14
    return np.asarray(goal * cluster.radius + t)


def goals(x: FloatArray, rest: Rest, beta: float, theta: float = 0.0, *, volume: Volume = "scale") -> FloatArray:
    """Mean goal of each particle over its clusters, (K, d) (eq. 3.15). Held particles: their own position."""
    total = np.zeros_like(x)
    count = np.zeros(len(x))
    for cluster in rest.clusters:
        total[cluster.index] += cluster_goals(x, cluster, beta, theta, volume=volume)
        count[cluster.index] += 1
    goal = total / count[:, None]
    goal[rest.held] = x[rest.held]
    return goal


def reaction(x: FloatArray, rest: Rest, beta: float, theta: float = 0.0) -> FloatArray:
    """Force on each particle by the body's `energy`, per unit of its stiffness k, (K, d).

    F_i = k sum over its clusters of m_i (x_i - goal_i), with volume conserved by projection: the gradient of the energy
    (eq. 3.17 has none). At a static state it is 0 at free particles, and what holds the held ones.
    """
    force = np.zeros_like(x)
    for cluster in rest.clusters:
        pull = x[cluster.index] - cluster_goals(x, cluster, beta, theta, volume="project")
        force[cluster.index] += cluster.mass[:, None] * pull
    return force


def energy(x: FloatArray, rest: Rest, beta: float, theta: float = 0.0) -> float:
    """What the body stores, per unit of its stiffness k, with volume conserved by projection. x: (K, d).

    1/2 sum_c { (1 - beta) min_R |p - R q|^2 + beta [ (1 - theta) min_A~ |p - A~ q~|^2 + theta min_{A~: measure of A is
    that at rest} |p - A~ q~|^2 ] }, each |.|^2 weighted with the masses. A goal is the mean of the three best fits with
    these same weights, so a step to the goals never raises the energy."""
    total = 0.0
    for cluster in rest.clusters:
        for weight, b, th in ((1.0 - beta, 0.0, 0.0), (beta * (1.0 - theta), 1.0, 0.0), (beta * theta, 1.0, 1.0)):
            left = x[cluster.index] - cluster_goals(x, cluster, b, th, volume="project")
            total += 0.5 * weight * float(np.einsum("n,ni,ni->", cluster.mass, left, left))
    return total


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
    volume: Volume = "scale",
) -> tuple[FloatArray, FloatArray]:
    """One time step (Algorithm 1 with eq. 3.11). x, v: (K, d); held_position: (n, d); acceleration: f_ext / m."""
    push = np.zeros(x.shape[1]) if acceleration is None else np.asarray(acceleration, dtype=np.float64)
    x_star = x + (v + push * dt) * dt  # eq. 3.1, 3.2
    x_star[rest.held] = held_position
    x_new = x_star + alpha * (goals(x_star, rest, beta, theta, volume=volume) - x_star)  # eq. 3.11
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
    volume: Volume = "scale",
) -> tuple[FloatArray, float]:
    """The static state x = goals(x), by Anderson's acceleration of that map. Returns (K, d) and the residual.

    Stops when no particle's goal is further from it than `tolerance` times the body's extent; the residual returned
    is that largest distance over the extent. It does not depend on dt, alpha or the start (for theta = 0)."""
    x = (rest.position if start is None else start).astype(np.float64).copy()
    x[rest.held] = held_position
    return fixed_point(
        lambda at: goals(at, rest, beta, theta, volume=volume), x, rest, tolerance, max_iterations, memory
    )


def fixed_point(
    goals_at: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    rest: Rest,
    tolerance: float = 1e-11,
    max_iterations: int = 3000,
    memory: int = 10,
) -> tuple[FloatArray, float]:
    """x = goals_at(x) from `start` (K, d), whose held particles stay: see `relax`."""
    x = start.copy()
    free = ~held_mask(len(x), rest.held)
    extent = float(np.ptp(rest.position, axis=0).max()) or 1.0
    states: list[FloatArray] = []
    residuals: list[FloatArray] = []
    worst = 0.0
    for _ in range(max_iterations):
        f = (goals_at(x) - x)[free].ravel()
        worst = float(np.abs(f).max(initial=0.0)) / extent
        if worst <= tolerance or not np.isfinite(worst):
            break
        states.append(x[free].ravel())
        residuals.append(f)
        del states[: -memory - 1], residuals[: -memory - 1]
        new = states[-1] + f
        if len(states) > 1:
            dx, df = np.diff(states, axis=0).T, np.diff(residuals, axis=0).T
            new = new - (dx + df) @ np.linalg.lstsq(df, f, rcond=1e-12)[0]
        x[free] = new.reshape(-1, x.shape[1])
    return x, worst
