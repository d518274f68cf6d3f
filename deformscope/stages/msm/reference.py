"""MSM in float64 NumPy, boring, in the order of the thesis's equations: the specification of the warp engine.

What the equations leave open is decided here, for degenerate clusters:

- Flat in space or on a line at rest: the fit uses the directions that the cluster spans (pseudo-inverse, chosen once
  at rest), and eq. 3.17 conserves its area or length instead of its volume.
- Too few particles for the quadratic terms (2x2, 3x3x2...): the same pseudo-inverse; undetermined terms turn with R.
- Crushed or inverted (det A <= 0): the cube root keeps its sign and the denominator of eq. 3.17 is held at or above
  `MIN_DENOMINATOR`; the rotation is a proper one (det R = +1) always.
- Where several rotations fit equally well (a line, a mirror image, a point): one of the best ones. It is the rest
  orientation, R = I, for a point, and in the plane.
- All particles held: nothing to solve; their positions stand.

Volume is conserved by one of two rules; without conservation (theta = 0) they are the same, and both give A_theta the
rest volume at theta = 1:

- "scale" is eq. 3.17, faithful to the thesis: A is divided by a number. No energy stands behind it: its effect on a
  compressed cluster amplifies every displacement, so overlapping clusters at high beta and theta diverge.
- "project" goes the share theta of the distance from the fit to the nearest fit of the rest volume. Its goals are the
  gradient of an energy that no step to them raises, so it cannot diverge; theta weighs the pull to the
  rest volume.
  Choose it for overlapping clusters, and wherever stability counts more than the thesis's numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm.clusters import FLAT_MOMENT_RATIO, Clusters

Basis = Literal["linear", "quadratic"]
Volume = Literal["scale", "project"]

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
    root: (d, d) with A root = B, in which the cost of changing A is a plain distance, |dB|^2 but for a factor, and the
    measures of A and B are equal; only its first k columns are not 0
    lift: (d, r) what a change of B does to the whole fit, dA~ = dB lift; 0 where changing A costs nothing
    """

    index: IntArray
    mass: FloatArray
    q: FloatArray
    q_basis: FloatArray
    inverse: FloatArray
    span: FloatArray
    radius: float
    root: FloatArray
    lift: FloatArray


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
    """Rest data of the cluster of particles (n,), of positions (K, d) and masses (K,)."""
    m = mass[index]
    t0 = np.average(position[index], axis=0, weights=m)
    q = position[index] - t0
    radius = float(np.sqrt(np.average(np.sum(q**2, axis=1), weights=m))) or 1.0
    return rest_cluster(index, m, q / radius, radius, basis)


def rest_cluster(index: IntArray, m: FloatArray, q: FloatArray, radius: float, basis: Basis) -> RestCluster:
    """A cluster of particles that stand at q (n, d), from the mass centre, in units of `radius`. m: (n,)."""
    moments, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", m, q, q))
    span = axes[:, moments > FLAT_MOMENT_RATIO * max(moments[-1], np.finfo(float).tiny)]
    q_basis = q if basis == "linear" else quadratic_basis(q, m)
    gram = np.einsum("n,ni,nj->ij", m, q_basis, q_basis)
    inverse = np.linalg.pinv(gram, rcond=FLAT_MOMENT_RATIO, hermitian=True)
    root, lift = _measure_metric(gram @ inverse @ gram, span, moments[-1])
    return RestCluster(index, m, q, q_basis, inverse, span, radius, root, lift)


def _measure_metric(gram: FloatArray, span: FloatArray, largest: float) -> tuple[FloatArray, FloatArray]:
    """`root` and `lift` of a cluster. gram: (r, r) sum m q~ q~^T, without what the fit leaves out.

    A change dA~ = [dA, dQ] of the best fit costs tr(dA~ gram dA~^T). For a given dA that is least with dQ = -dA C,
    C = G_AQ G_QQ^+, and then it is tr(dA S dA^T) with the Schur complement S = G_AA - C G_QA: the quadratic terms
    adapt. Where they alone fit every displacement in a direction (too few particles), the measure can have any value
    for nothing, and nothing is to be projected.
    """
    d, k = span.shape
    c = gram[:d, d:] @ np.linalg.pinv(gram[d:, d:], rcond=FLAT_MOMENT_RATIO, hermitian=True)
    schur = gram[:d, :d] - c @ gram[d:, :d]
    axes = np.eye(d) if k == d else span  # a full root must not be a reflection
    values, vectors = np.linalg.eigh(axes.T @ schur @ axes)
    root, lift = np.zeros((d, d)), np.zeros_like(gram[:d])
    if k and values[0] > FLAT_MOMENT_RATIO * largest:
        stretch = np.sqrt(values / np.exp(np.mean(np.log(values))))  # its determinant is 1
        root[:, :k] = axes @ (vectors * stretch) @ vectors.T
        lift[:k, :d] = (vectors / stretch) @ vectors.T @ axes.T
        lift[:, d:] = -lift[:, :d] @ c
    return root, lift


def quadratic_basis(q: FloatArray, mass: FloatArray) -> FloatArray:
    """q~ of eq. 3.14, (n, 5) in the plane and (n, 9) in space, less its mean: an uncentred basis has a ghost drift."""
    d = q.shape[1]
    squares = [q[:, i] ** 2 for i in range(d)]
    pairs = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    terms = np.column_stack([q, *squares, *[q[:, i] * q[:, j] for i, j in pairs]])
    return np.asarray(terms - np.average(terms, axis=0, weights=mass))


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
    that a cluster turned inside out comes back, and the area or length sqrt(det b^T b) of a flat one.
    """
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
    left is one equation for y. Several y solve it only if one is below s_k / 2, and then s has a product above 2.
    """
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
