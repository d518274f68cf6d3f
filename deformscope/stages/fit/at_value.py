"""The model at a chosen value of its parameter, compared with the best one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.distance import distances
from deformscope.stages.fit.estimate import Comparison
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.msm.solver import Msm


@dataclass(frozen=True, slots=True)
class AtValue:
    """The model's error at a value of its parameter.

    value: value of the parameter; aee: average Euclidean error over the particles seen (Thesis eq. 3.18, 3.19);
    aee_free: error over particles that are not held [unit of the observations]; converged: it came to rest"""

    value: float
    aee: float
    aee_free: float
    converged: bool


def simulate(seen: Observation, model: Model, values: FloatArray, body: Msm | None = None) -> list[Comparison]:
    """The model at each value (g,) of its parameter; a simulation that does not come to rest is NaN. body:
    `model.body(seen)`, if it exists already. Each simulation begins at rest, whatever was simulated before."""
    other = np.ones(len(values))
    beta, theta = (values, model.theta * other) if model.parameter == "beta" else (model.beta * other, values)
    held = seen.deformed[seen.held]
    state = (body or model.body(seen)).relax(held, beta, theta, volume=model.volume)
    return [Comparison(seen.rest, seen.deformed, one, seen.observed, seen.held, seen.unit) for one in state.settled]


def errors_of(seen: Sequence[Observation], value: float, found: Sequence[Comparison]) -> AtValue:
    """Errors over all particles of all observations. found: states of each observation"""
    each = [distances(one.simulated, one.observed) for one in found]
    every = np.concatenate([one[obs.observed] for one, obs in zip(each, seen, strict=True)])
    free = np.concatenate([one[obs.free_observed] for one, obs in zip(each, seen, strict=True)])
    return AtValue(value, float(every.mean()), float(free.mean()), bool(np.isfinite(every).all()))


def at_value(seen: Sequence[Observation], model: Model, value: float) -> AtValue:
    """The error of the model at one value. Raises InputError if its simulation does not come to rest."""
    found = errors_of(seen, value, [simulate(one, model, np.array([value]))[0] for one in seen])
    if not found.converged:
        raise InputError(f"a {model.parameter} at which the simulation comes to rest", f"{value:g}", "another --at")
    return found
