"""Rest clusters of the MSM in float64 NumPy, with the choices that its equations leave open.

Where the equations are incomplete, this module decides, for degenerate clusters:

- Flat in space or on a line at rest: the fit uses the directions that the cluster spans (pseudo-inverse, chosen once
  at rest), and eq. 3.17 conserves its area or length instead of its volume.
- Too few particles for the quadratic terms (2x2, 3x3x2...): the same pseudo-inverse; undetermined terms turn with R.
- Crushed or inverted (det A <= 0): the cube root keeps its sign and the denominator of eq. 3.17 is held at or above
  `MIN_DENOMINATOR`; the rotation is a proper one (det R = +1) always.
- Where several rotations fit equally well (a line, a mirror image, a point): one of the best ones. It is the rest
  orientation, R = I, for a point, and in the plane.
- All particles held: nothing to solve; their positions are the result.

Volume is conserved by one of two rules. Without conservation (theta = 0) they are the same, and both give A_theta the
rest volume at theta = 1:

- "scale" is eq. 3.17, faithful to the thesis: A is divided by a number. Eq. 3.17 derives from no energy. In a
compressed cluster it amplifies every displacement, so that overlapping clusters at high beta and theta diverge.
- "project" goes the share theta of the distance from the fit to the nearest fit of the rest volume. Its goals are the
  gradient of an energy that no step to them raises, so it cannot diverge; theta weights the pull to the rest volume.
  Choose it for overlapping clusters, and where stability counts more than the thesis's numbers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

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
    """Constants of one cluster.

    index: (n,) its particles; mass: (n,); q: (n, d) positions relative to the mass centre, in units of the cluster's
    radius (eq. 3.8); q_basis: (n, r) q or q~ of eq. 3.14, mean-centred; inverse: (r, r) pseudo-inverse of sum m q~ q~^T
    span: (d, k) orthonormal directions that it spans; radius: root mean square distance from its centre
    root: (d, d) with A root = B, in which the cost of changing A is a plain distance, |dB|^2 up to a factor, and the
    measures of A and B are equal; only its first k columns are not 0
    lift: (d, r) effect of a change of B on the whole fit, dA~ = dB lift; 0 where changing A costs nothing"""

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
    """A cluster of particles at q (n, d), from the mass centre, in units of `radius`. m: (n,)."""
    moments, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", m, q, q))
    span = axes[:, moments > FLAT_MOMENT_RATIO * max(moments[-1], np.finfo(float).tiny)]
    q_basis = q if basis == "linear" else quadratic_basis(q, m)
    gram = np.einsum("n,ni,nj->ij", m, q_basis, q_basis)
    inverse = np.linalg.pinv(gram, rcond=FLAT_MOMENT_RATIO, hermitian=True)
    root, lift = _measure_metric(gram @ inverse @ gram, span, moments[-1])
    return RestCluster(index, m, q, q_basis, inverse, span, radius, root, lift)


def _measure_metric(gram: FloatArray, span: FloatArray, largest: float) -> tuple[FloatArray, FloatArray]:
    """`root` and `lift` of a cluster. gram: (r, r) sum m q~ q~^T, without the fit's residual.

    A change dA~ = [dA, dQ] of the best fit costs tr(dA~ gram dA~^T). For a given dA that is least with dQ = -dA C, C =
    G_AQ G_QQ^+. It is then tr(dA S dA^T) with the Schur complement S = G_AA - C G_QA: the quadratic terms adapt. If
    they alone fit every displacement in a direction (too few particles), the measure can have any value at no cost, and
    nothing is projected."""
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
