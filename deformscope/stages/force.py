"""Stiffness from force: what position alone cannot tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.model import Model, Observation
from deformscope.stages.msm import reference


def stiffness(
    seen: Sequence[Observation], model: Model, positions: Sequence[FloatArray], parameter: FloatArray
) -> FloatArray | None:
    """The energy's stiffness k [N/m] at each parameter (g,), from the measured forces; None where there is none.

    positions: for each observation (g, K, d). k minimises the squared difference of measured and simulated net force
    over the observations. Eq. 3.17 has no energy, so with theta in that form there is no force to compare.
    """
    told = [row for row, s in enumerate(seen) if s.force_n is not None and s.metres_per_unit is not None]
    no_energy = model.volume == "scale" and (model.parameter == "theta" or model.theta != 0.0)
    if not told or no_energy:
        return None
    simulated = np.zeros((len(parameter), len(told)))
    measured = np.array([float(seen[row].force_n or 0.0) for row in told])
    for column, row in enumerate(told):
        s = seen[row]
        rest = reference.build_rest(s.rest, model.grouping(s), s.held, basis=model.basis)
        contact = s.held if s.contact is None else s.contact
        for g, value in enumerate(parameter):
            beta, theta = (value, model.theta) if model.parameter == "beta" else (model.beta, value)
            net = reference.reaction(positions[row][g], rest, float(beta), float(theta))[contact].sum(axis=0)
            simulated[g, column] = float(np.linalg.norm(net)) * float(s.metres_per_unit or 1.0)
    size = np.sum(simulated**2, axis=1)
    return np.asarray(np.where(size > 0.0, simulated @ measured / np.where(size > 0.0, size, 1.0), np.nan))
