"""The model at a chosen value of its parameter, compared with the best one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.distance import distances
from deformscope.stages.fit.estimate import Comparison
from deformscope.stages.fit.model import Model, Observation


@dataclass(frozen=True, slots=True)
class AtValue:
    """The model's error at a value of its parameter.

    value: value of the parameter; aee: average Euclidean error over the particles seen (Thesis eq. 3.18, 3.19);
    aee_free: error over particles that are not held [unit of the observations]; converged: it came to rest"""

    value: float
    aee: float
    aee_free: float
    converged: bool


def simulate(seen: Observation, model: Model, values: FloatArray) -> list[Comparison]:
    """The model at each value (g,) of its parameter, each simulated from rest; one that does not come to rest is
    NaN."""
    other = np.ones(len(values))
    beta, theta = (values, model.theta * other) if model.parameter == "beta" else (model.beta * other, values)
    held = seen.deformed[seen.held]
    state = model.body(seen).relax(held, beta, theta, volume=model.volume)
    return [Comparison(seen.rest, seen.deformed, one, seen.observed, seen.held, seen.unit) for one in state.settled]


def at_value(seen: Sequence[Observation], model: Model, value: float) -> AtValue:
    """The error of the model at one value, over all particles of all observations. Raises InputError if its simulation
    does not come to rest."""
    found = [simulate(one, model, np.array([value]))[0] for one in seen]
    each = [distances(one.simulated, one.observed) for one in found]
    every = np.concatenate([one[obs.observed] for one, obs in zip(each, seen, strict=True)])
    free = np.concatenate([one[obs.free_observed] for one, obs in zip(each, seen, strict=True)])
    if not np.isfinite(every).all():
        raise InputError(f"a {model.parameter} at which the simulation comes to rest", f"{value:g}", "another --at")
    return AtValue(value, float(every.mean()), float(free.mean()), converged=True)
