"""Common errors of all positions due to a tool or a camera: a few displacements, in any proportion.

- Of the tool: all held positions have a common displacement. The particles that something moved, and those held still,
  are each shifted and turned (the registration of a robot or a fixture).
- Of the camera: all measured positions have a displacement that is linear in the place: a wrong scale along some
  direction, or a drift. Bent displacements, such as those by a lens, are left to the smooth fields of
`deformscope.stages.fit.noise`.

Each displacement has a Gaussian prior, so that together they add a covariance of low rank to that of the noise. A shift
of the tool is always possible: its effect on the residuals resembles that of a parameter, so that evidence would decide
against an existing one (`python -m studies beta`, docs/results/coverage.md). The evidence decides whether there are
others, which it shows."""

from itertools import combinations

import numpy as np
from scipy.linalg import null_space

from deformscope.arrays import BoolArray, FloatArray

TOOL_SHIFT = 0.04
"""Standard deviation of a shift along each axis, and of a turn's effect on the farthest particle [spacings]. Deviation
of the tool's displacement; like that of the camera it was chosen on tuning seeds (`studies.seeds`), on bodies of
`studies.independent`."""

CAMERA_SLOPE = 0.005
"""Deviation of each part of a linear displacement, as a share of the distance."""


def tool_modes(held: FloatArray, touched: BoolArray) -> FloatArray:
    """(k, d, q) shifts and turns of held particles (k, d), touched where (k,) is true, by 1 at the farthest."""
    d = held.shape[1]
    found = []
    for group in (touched, ~touched):
        if not group.any():
            continue
        found += [np.outer(group, axis) for axis in np.eye(d)]
        away = np.where(group[:, None], held - held[group].mean(axis=0), 0.0)
        for i, j in combinations(range(d), 2):
            turned = np.zeros_like(held)
            turned[:, i], turned[:, j] = -away[:, j], away[:, i]
            farthest = float(np.linalg.norm(turned, axis=1).max())
            if farthest > 0.0:
                found.append(turned / farthest)
    return np.stack(found, axis=-1)


def camera_modes(places: FloatArray) -> FloatArray:
    """(n, d, d^2) displacements of particles at places (n, d) [unit], one deviation each: a scale, then the others."""
    d = places.shape[1]
    half = 0.5 * float(np.ptp(places, axis=0).max())
    along = (places - 0.5 * (places.min(axis=0) + places.max(axis=0))) / half
    each = [np.outer(along[:, i], axis) for i in range(d) for axis in np.eye(d)]
    scale = np.eye(d).reshape(-1, 1) / np.sqrt(d)
    return np.asarray(CAMERA_SLOPE * half * np.stack(each, axis=-1) @ np.hstack([scale, null_space(scale.T)]))
