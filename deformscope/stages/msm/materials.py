"""Materials beyond one beta: a beta along each axis of the material, and plastic deformation.

**Anisotropy.** beta is a compliance. A cluster stores 1/2 |p - A q|^2 + 1/2 min_R tr((A - R) W (A - R)^T), with A its
best fit. For one beta, W = (1 - beta) A_qq: the stiffness of a unit spring A_qq^-1 in series with a compliance of beta
/ (1 - beta) A_qq^-1. With betas b_i along axes e_i that compliance is N A_qq^-1 N, N = sum_i sqrt(b_i / (1 - b_i)) e_i
e_i^T:

    W = (A_qq^-1 + N A_qq^-1 N)^-1,    goal = [R + (A - R) C] q + t,    C = I - W A_qq^-1,    R = polar(A W)

So there is an energy, whose gradient the goals are (static states are minima, the reaction force is exact), it turns
with the body, equal betas give Thesis eq. 3.13, beta = 0 and 1 along an axis are the rigid and the free limit, and
0 <= W <= A_qq, so a step to the goals is never too long. A shear has the harmonic mean of its two axes.
Linear fit, theta = 0.

**Plasticity.** Müller et al. 2005, section 4.5: each cluster has a plastic deformation S^p, I at first. With the polar
decomposition A = R S of its fit, S^p <- [I + dt creep (S - I)] S^p where |S - I|_2 > yield; then det S^p is made 1
again (area in the plane; a flat cluster keeps the measure of what it spans), and |S^p - I|_2 is at most
`maximum`. The rest vectors are S^p q. Where the paper is incomplete, this module does as follows:

- S is the stretch sqrt(A^T A), turned inside out: its smallest value negative; the flow stops short of turning S^p.
- S^p is brought to the bound along I + s (S^p - I) with its determinant set to 1, so that both conditions hold: the
paper's scaling alone violates det = 1."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray

LEAST_FACTOR = 0.1
"""The least by which one flow multiplies a stretch of S^p: it can never turn it inside out."""


@dataclass(frozen=True, slots=True)
class AxisBeta:
    """A beta along each axis of the material, in place of one beta.

    value: (d,) or (B, d), each 0 to 1; axes: (d, d) orthonormal columns, the axes in the rest shape; None: x, y, z"""

    value: FloatArray
    axes: FloatArray | None = None

    def __post_init__(self) -> None:
        value = np.atleast_2d(np.asarray(self.value, dtype=np.float64))
        if value.ndim != 2 or value.shape[1] not in (2, 3) or not ((value >= 0.0) & (value <= 1.0)).all():
            raise ValueError(f"expected betas of shape (d,) or (B, d) between 0 and 1; got {self.value!r}")
        d = value.shape[1]
        axes = np.eye(d) if self.axes is None else np.asarray(self.axes, dtype=np.float64)
        if axes.shape != (d, d) or np.abs(axes.T @ axes - np.eye(d)).max() > 1e-9:
            raise ValueError(f"expected {d} orthonormal axes as columns; got {self.axes!r}")
        object.__setattr__(self, "value", value)
        object.__setattr__(self, "axes", axes)


@dataclass(frozen=True, slots=True)
class Plasticity:
    """When and how a cluster yields; each value is a number, or (B,) one for each candidate.

    yield_strain: |S - I|_2 above which it flows; creep: [1/s] share of S - I that becomes permanent in a second
    maximum: largest |S^p - I|_2"""

    yield_strain: FloatArray | float
    creep: FloatArray | float = np.inf
    maximum: FloatArray | float = np.inf

    def __post_init__(self) -> None:
        for name in ("yield_strain", "creep", "maximum"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.ndim > 1 or not (value >= 0.0).all():
                raise ValueError(f"expected {name} of 0 or more, a number or (B,); got {getattr(self, name)!r}")


def axis_weights(
    gram: FloatArray, span: FloatArray, beta: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """W and C (see above) of clusters for candidates, (B, n, d, d) each. gram: (n, d, d) second moments A_qq; span: (n,
    d, k) orthonormal, the span of all n clusters; beta: (B, d)"""
    if span.shape[2] == len(axes):  # as they are, without the rounding of 1 - beta
        span = np.broadcast_to(np.eye(len(axes)), gram.shape)
        share, spread = beta[:, None], np.broadcast_to(axes, (len(beta), 1, *axes.shape))
    else:
        diagonal = np.einsum("ia,ba,ja->bij", axes, beta, axes)
        share, spread = np.linalg.eigh(np.einsum("nik,bij,njl->bnkl", span, diagonal, span))
        share = np.clip(share, 0.0, 1.0)
    compliance = np.linalg.inv(np.einsum("nik,nij,njl->nkl", span, gram, span))

    def function(of: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("bnki,bni,bnli->bnkl", spread, np.sqrt(of), spread))

    # N = soft stiff^-1: W without what becomes infinite at beta = 1
    stiff, soft = function(1.0 - share), function(share)
    middle = stiff @ compliance @ stiff + soft @ compliance @ soft
    w = stiff @ np.linalg.solve(middle, stiff)
    w = 0.5 * (w + w.swapaxes(-1, -2))
    c = np.eye(w.shape[-1]) - w @ compliance
    wide = np.einsum("nik,bnkl,njl->bnij", span, w, span)
    return wide, np.einsum("nik,bnkl,njl->bnij", span, c, span)
