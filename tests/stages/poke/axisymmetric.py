"""An elastic cylinder under a rigid tip by finite elements of its own: quadrilaterals about an axis, small strain.

Shares nothing with the product. Dilatation is averaged over each element (Hughes 1980), so that nu = 0.49 does not
lock; contact is without friction, by the compliance of the surface's nodes, which only push."""

import numpy as np
import scipy

from deformscope.arrays import FloatArray


def graded(fine: float, upto: float, end: float, ratio: float = 1.15) -> FloatArray:
    """Steps of `fine` up to `upto`, then growing ones to `end`."""
    steps = [fine] * round(upto / fine)
    while sum(steps) < end:
        steps.append(min(ratio * steps[-1], end / 8.0))
    places = np.append(0.0, np.cumsum(steps))
    near = places <= upto * (1 + 1e-9)
    far = upto + (places[~near] - upto) * (end - upto) / (places[-1] - upto)
    return np.append(places[near], far)


def surface_compliance(r: FloatArray, z: FloatArray, poisson: float, *, bonded: bool) -> FloatArray:
    """(m, m) downward displacement of the surface's nodes at r (m,) per unit of force on each, for E = 1; z: (k,) from
    0, the ground, up to the surface; the outer side is free."""
    m, k = len(r), len(z)
    index = np.arange(m * k).reshape(m, k)
    corners = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    place = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)[corners]  # (e, 4, 2)
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    terms = []
    for point in signs / np.sqrt(3.0):
        shape = 0.25 * (1 + signs[:, 0] * point[0]) * (1 + signs[:, 1] * point[1])
        local = 0.25 * np.stack(
            [signs[:, 0] * (1 + signs[:, 1] * point[1]), signs[:, 1] * (1 + signs[:, 0] * point[0])], axis=-1
        )
        jacobian = np.einsum("na,enb->eab", local, place)
        slope = np.einsum("eab,nb->ena", np.linalg.inv(jacobian), local)
        radius = place[:, :, 0] @ shape
        b = np.zeros((len(corners), 4, 4, 2))  # strain rr, zz, tt, rz of node, axis
        b[:, 0, :, 0], b[:, 1, :, 1] = slope[..., 0], slope[..., 1]
        b[:, 2, :, 0] = shape / radius[:, None]
        b[:, 3, :, 0], b[:, 3, :, 1] = slope[..., 1], slope[..., 0]
        terms.append((b.reshape(len(corners), 4, 8), 2 * np.pi * radius * np.linalg.det(jacobian)))
    volume = sum(weight for _, weight in terms)
    mean = sum(b[:, :3].sum(axis=1) * weight[:, None] for b, weight in terms) / volume[:, None]
    bulk, shear = 1 / (3 * (1 - 2 * poisson)), 1 / (2 * (1 + poisson))
    stiffness = bulk * volume[:, None, None] * mean[:, :, None] * mean[:, None, :]
    for b, weight in terms:
        away = b.copy()
        away[:, :3] -= b[:, :3].sum(axis=1, keepdims=True) / 3.0
        doubled = away * np.array([2.0, 2.0, 2.0, 1.0])[:, None]
        stiffness += shear * weight[:, None, None] * np.einsum("esa,esb->eab", away, doubled)
    dof = (2 * corners[:, :, None] + np.arange(2)).reshape(-1, 8)
    rows, columns = np.repeat(dof, 8, axis=1).ravel(), np.tile(dof, (1, 8)).ravel()
    whole = scipy.sparse.csc_matrix((stiffness.ravel(), (rows, columns)), shape=(2 * m * k, 2 * m * k))
    fixed = {*(2 * index[0]), *(2 * index[:, 0] + 1), *(2 * index[:, 0] if bonded else ())}
    free = np.setdiff1d(np.arange(2 * m * k), sorted(fixed))
    top = np.searchsorted(free, 2 * index[:, -1] + 1)
    loads = np.zeros((len(free), m))
    loads[top, np.arange(m)] = 1.0
    return np.asarray(scipy.sparse.linalg.splu(whole[free][:, free].tocsc()).solve(loads)[top])


def press(compliance: FloatArray, gap: FloatArray, depths: FloatArray) -> FloatArray:
    """(n,) forces for E = 1 at depths (n,) of a rigid tip that is `gap` (m,) above the surface's nodes."""
    forces = []
    touching = gap <= gap.min()
    for depth in depths:
        for _ in range(60):
            at = np.flatnonzero(touching)
            push = np.zeros(len(gap))
            push[at] = np.linalg.solve(compliance[np.ix_(at, at)], depth - gap[at])
            into = depth - gap - compliance @ push
            now = (touching & (push > 0)) | (~touching & (into > 1e-12 * depth))
            if (now == touching).all():
                break
            touching = now
        forces.append(push.sum())
    return np.array(forces)
