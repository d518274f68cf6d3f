"""Branches of a creep compliance: strengths and retardation times, and the relaxation that follows from them."""

from __future__ import annotations

import numpy as np

from deformscope.arrays import FloatArray


def relaxing(strength: FloatArray, retarded_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(d, b) shares of the modulus that relax, and (d, b) their times [s], of strengths and retardation times (d, b):
    the eigenvectors and eigenvalues of the rates below."""
    if strength.shape[1] == 0:
        return strength, retarded_s
    rates = (np.eye(strength.shape[1]) + strength[:, None, :]) / retarded_s[:, :, None]
    rate, mode = np.linalg.eig(rates)
    into = np.linalg.solve(mode, (1.0 / retarded_s)[..., None])[..., 0]
    share = (strength[:, None, :] @ mode)[:, 0] * into / rate
    return np.asarray(share.real), np.asarray(1.0 / rate.real)


def mean_relaxation_s(strength: FloatArray, retarded_s: FloatArray) -> FloatArray:
    """(d,) mean relaxation time of strengths and retardation times (d, b), each branch weighed by its share.

    Held still, the branches relax by dE_i/dt = (F - E_i) / l_i with F = y - sum_k j_k E_k: the area under the
    relaxing force over what relaxes is that mean. With A the matrix of these rates, it is found without its
    eigenvalues: the force goes from y to y / (1 + sum j), and the area is j . A^-1 (E_inf) .
    """
    count, branches = strength.shape
    if branches == 0:
        return np.zeros(count)
    rates = (np.eye(branches) + strength[:, None, :]) / retarded_s[:, :, None]
    settled = np.broadcast_to((1.0 / (1.0 + strength.sum(axis=1)))[:, None], (count, branches))
    # F(t) - F(inf) = sum_k j_k (E_inf - E_k(t)), whose integral is j . A^-1 E_inf
    area = (strength * np.linalg.solve(rates, settled[..., None])[..., 0]).sum(axis=1)
    relaxes = strength.sum(axis=1) * settled[:, 0]
    return np.asarray(area / np.maximum(relaxes, 1e-12))
