"""`materials` in float64 NumPy, boring: the specification of what the engine makes of them, cluster by cluster.

Plasticity is taken literally: a cluster that has yielded is a new cluster, whose rest vectors are S^p q."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from deformscope.arrays import FloatArray
from deformscope.stages.msm import reference
from deformscope.stages.msm.materials import LEAST_FACTOR, AxisBeta
from deformscope.stages.msm.reference import Basis, Rest, RestCluster, Volume
from tests.stages import reference_states

Beta = float | AxisBeta
"""One for all directions, or along each axis (of one candidate)."""


@dataclass(frozen=True, slots=True)
class Yielding:
    """One candidate's numbers of `materials.Plasticity`."""

    yield_strain: float
    creep: float = np.inf
    maximum: float = np.inf


def axis_weight(cluster: RestCluster, beta: AxisBeta, plastic: FloatArray | None = None) -> FloatArray:
    """W of a cluster (d, d), by its definition: the stiffness of two compliances in series, within the cluster's span.

    plastic: (d, d) S^p of a cluster whose rest vectors have yielded; the material's axes yield with them."""
    back = np.eye(cluster.q.shape[1]) if plastic is None else np.linalg.inv(plastic)
    q = cluster.q @ back.T
    gram = np.einsum("n,ni,nj->ij", cluster.mass, q, q)
    u = cluster.span
    compliance = np.linalg.inv(u.T @ gram @ u)
    share, spread = np.linalg.eigh(u.T @ beta.axes @ np.diag(np.asarray(beta.value)[0]) @ beta.axes.T @ u)
    share = np.maximum(share, 0.0)  # rounding
    n = spread @ np.diag(np.sqrt(share / (1.0 - share))) @ spread.T
    w = u @ np.linalg.inv(compliance + n @ compliance @ n) @ u.T
    return np.asarray(w if plastic is None else plastic @ w @ plastic.T)


def axis_parts(
    x: FloatArray, cluster: RestCluster, beta: AxisBeta, plastic: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Mass centre (d,), best fit A, rotation R and W of a cluster at x (K, d). A has only what is determined."""
    m = cluster.mass
    t = np.average(x[cluster.index], axis=0, weights=m)
    p = (x[cluster.index] - t) / cluster.radius
    w = axis_weight(cluster, beta, plastic)
    a = np.einsum("n,ni,nj->ij", m, p, cluster.q) @ cluster.inverse
    return t, a, reference_states.rotation(a @ w, float(np.trace(w))), w


def axis_goals(x: FloatArray, cluster: RestCluster, beta: AxisBeta, plastic: FloatArray | None = None) -> FloatArray:
    """Goal positions (n, d) of one cluster's particles with a beta along each axis."""
    t, a, r, w = axis_parts(x, cluster, beta, plastic)
    determined = cluster.span @ cluster.span.T
    blend = r + (a - r @ determined) @ (np.eye(len(r)) - w @ cluster.inverse)
    return np.asarray(cluster.q @ blend.T * cluster.radius + t)


def axis_energy(x: FloatArray, rest: Rest, beta: AxisBeta) -> float:
    """1/2 sum_c { |p - A q|^2 + min_R tr((A - R) W (A - R)^T) }, in the unit of `reference_states.energy`."""
    total = 0.0
    for cluster in rest.clusters:
        t, a, r, w = axis_parts(x, cluster, beta)
        p = x[cluster.index] - t
        left = p - cluster.q @ a.T * cluster.radius
        strain = a - r @ cluster.span @ cluster.span.T
        total += 0.5 * float(np.einsum("n,ni,ni->", cluster.mass, left, left))
        total += 0.5 * cluster.radius**2 * float(np.trace(strain @ w @ strain.T))
    return total


def axis_reaction(x: FloatArray, rest: Rest, beta: AxisBeta) -> FloatArray:
    """Force on each particle, per unit of stiffness, (K, d): the gradient of `axis_energy`."""
    force = np.zeros_like(x)
    for cluster in rest.clusters:
        force[cluster.index] += cluster.mass[:, None] * (x[cluster.index] - axis_goals(x, cluster, beta))
    return force


def yielded(rest: Rest, plastic: Sequence[FloatArray], basis: Basis = "linear") -> Rest:
    """The body with rest vectors S^p q in each cluster (Müller 2005, section 4.5). plastic: (C, d, d)."""
    changed = [
        reference.rest_cluster(c.index, c.mass, c.q @ s.T, c.radius, basis)
        for c, s in zip(rest.clusters, plastic, strict=True)
    ]
    return Rest(rest.position, rest.held, tuple(changed))


def goals(
    x: FloatArray,
    rest: Rest,
    beta: Beta,
    theta: float = 0.0,
    *,
    plastic: Sequence[FloatArray] | None = None,
    volume: Volume = "scale",
    basis: Basis = "linear",
) -> FloatArray:
    """Mean goal of each particle over its clusters, (K, d) (eq. 3.15). Held particles: their own position."""
    body = rest if plastic is None else yielded(rest, plastic, basis)
    if not isinstance(beta, AxisBeta):
        return reference_states.goals(x, body, beta, theta, volume=volume)
    total, count = np.zeros_like(x), np.zeros(len(x))
    for number, cluster in enumerate(body.clusters):
        total[cluster.index] += axis_goals(x, cluster, beta, None if plastic is None else plastic[number])
        count[cluster.index] += 1
    goal = total / count[:, None]
    goal[rest.held] = x[rest.held]
    return np.asarray(goal)


def relax(
    rest: Rest,
    held_position: FloatArray,
    beta: Beta,
    theta: float = 0.0,
    *,
    plastic: Sequence[FloatArray] | None = None,
    start: FloatArray | None = None,
    volume: Volume = "scale",
    tolerance: float = 1e-12,
) -> FloatArray:
    """The static state (K, d) with S^p as it is."""
    x = (rest.position if start is None else start).astype(np.float64).copy()
    x[rest.held] = held_position
    found, left = reference_states.fixed_point(
        lambda at: goals(at, rest, beta, theta, plastic=plastic, volume=volume), x, rest, tolerance
    )
    assert left <= 100.0 * tolerance, left
    return found


def stretch(x: FloatArray, cluster: RestCluster, plastic: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal stretches (k,) of what a cluster's fit does to S^p q, and their directions (d, k), within its span."""
    m, u = cluster.mass, cluster.span
    q = cluster.q @ u @ (u.T @ plastic @ u).T
    p = x[cluster.index] - np.average(x[cluster.index], axis=0, weights=m)
    a = np.einsum("n,ni,nj->ij", m, p / cluster.radius, q) @ np.linalg.inv(np.einsum("n,ni,nj->ij", m, q, q))
    _, values, vectors = np.linalg.svd(a, full_matrices=False)
    if a.shape[0] == a.shape[1] and np.linalg.det(a @ u.T) < 0.0:
        values[-1] *= -1.0
    return values, u @ vectors.T


def to_yield(values: FloatArray, yield_strain: float) -> float:
    """The share of S - I that has to flow until |S - I| = yield, with det S^p kept; 1 where that cannot be."""

    def left(share: float) -> float:
        factor = np.maximum(1.0 + share * (values - 1.0), LEAST_FACTOR)
        return float(np.abs(values / factor * np.prod(factor) ** (1.0 / len(values)) - 1.0).max()) - yield_strain

    return 1.0 if left(1.0) >= 0.0 else float(brentq(left, 0.0, 1.0, xtol=1e-14))


def flow(
    x: FloatArray, rest: Rest, plastic: Sequence[FloatArray], law: Yielding, share: float, *, stop: bool
) -> list[FloatArray]:
    """S^p of each cluster after the share of S - I that yields; stop: at the yield strain, else wherever it leads."""
    return [_flowed(x, c, s, law, share, stop=stop) for c, s in zip(rest.clusters, plastic, strict=True)]


def _flowed(
    x: FloatArray, cluster: RestCluster, plastic: FloatArray, law: Yielding, share: float, *, stop: bool
) -> FloatArray:
    if not cluster.span.shape[1]:
        return plastic
    values, vectors = stretch(x, cluster, plastic)
    if np.abs(values - 1.0).max() <= law.yield_strain:
        return plastic
    if stop:
        share = min(share, to_yield(values, law.yield_strain))
    factor = np.maximum(1.0 + share * (values - 1.0), LEAST_FACTOR)
    new = unit_measure((np.eye(len(plastic)) + (vectors * (factor - 1.0)) @ vectors.T) @ plastic, cluster.span)
    return bounded(new, cluster.span, law.maximum)


def unit_measure(plastic: FloatArray, span: FloatArray) -> FloatArray:
    """S^p with its determinant made 1: scaled within what the cluster spans."""
    determined = span @ span.T
    by = np.linalg.det(plastic) ** (-1.0 / span.shape[1])
    return np.asarray(plastic @ (by * determined + np.eye(len(plastic)) - determined))


def bounded(plastic: FloatArray, span: FloatArray, maximum: float) -> FloatArray:
    """S^p with |S^p - I|_2 at most `maximum` and det S^p = 1."""
    identity = np.eye(len(plastic))
    if np.linalg.norm(plastic - identity, 2) <= maximum:
        return plastic

    def toward(share: float) -> FloatArray:
        return unit_measure(identity + share * (plastic - identity), span)

    if maximum == 0.0:
        return identity
    share = brentq(lambda s: float(np.linalg.norm(toward(s) - identity, 2)) - maximum, 0.0, 1.0, xtol=1e-15)
    return toward(float(share))


def load(
    x: FloatArray,
    rest: Rest,
    held_position: FloatArray,
    plastic: Sequence[FloatArray],
    law: Yielding,
    *,
    beta: Beta,
    theta: float = 0.0,
    volume: Volume = "project",
    duration: float | None = None,
    settled: float = 1e-3,
    rounds: int = 200,
) -> tuple[FloatArray, list[FloatArray]]:
    """The static state and S^p under a load that is held, from x (K, d): see `plastic.PlasticMsm.load`."""
    state = list(plastic)
    x = relax(rest, held_position, beta, theta, plastic=state, start=x, volume=volume)
    for _ in range(rounds):
        before = state
        state = flow(x, rest, state, law, 1.0 if duration is None else duration * law.creep, stop=True)
        if all(np.array_equal(a, b) for a, b in zip(before, state, strict=True)):
            break
        x = relax(rest, held_position, beta, theta, plastic=state, start=x, volume=volume)
        moved = max(float(np.abs(a - b).max()) for a, b in zip(before, state, strict=True))
        if duration is not None or moved <= settled * law.yield_strain:
            break
    return x, state
