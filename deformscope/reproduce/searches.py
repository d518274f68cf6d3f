"""The thesis's two searches and ours on the same data: which value each gives, and what it costs to find it."""

from __future__ import annotations

import time
from dataclasses import dataclass

from deformscope.stages.fit.distance import distances
from deformscope.stages.fit.fixed_step import fixed_step_descent
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.search import Search

STEP = 0.01
"""Of Algorithm 3."""


@dataclass(frozen=True, slots=True)
class SearchOutcome:
    """search: how it was sought; value: found; aee_m: error there (eq. 3.18); evaluations: static states that were
    computed; seconds; stopped: why it ended, "" for a sweep"""

    search: str
    value: float
    aee_m: float
    evaluations: int
    seconds: float
    stopped: str = ""


def compare_searches(seen: Observation, model: Model, bounds: tuple[float, float]) -> tuple[SearchOutcome, ...]:
    """Algorithm 3 by itself, and refined; the descent that `calibrate --method gradient` makes; Algorithm 2 as printed,
    from the middle of the range."""
    found = []
    began = time.perf_counter()
    sweep = Search([seen], model, bounds)
    sweep.sweep(round((bounds[1] - bounds[0]) / STEP) + 1, None)
    found.append(_outcome("sweep (Algorithm 3)", sweep, began))
    sweep.refine()
    found.append(_outcome("sweep, refined", sweep, began))
    began = time.perf_counter()
    gradient = Search([seen], model, bounds)
    stopped = gradient.descend(None)
    found.append(_outcome("gradient", gradient, began, stopped))
    began = time.perf_counter()
    printed = Search([seen], model, bounds)
    at = {"start": seen.rest}

    def error_cm(value: float) -> float:
        state = printed.relax(printed.bodies[0], seen.deformed[seen.held], value, at["start"])
        at["start"] = state.position[0]
        return 100.0 * float(distances(state.position[0, seen.observed], seen.deformed[seen.observed]).mean())

    ended = fixed_step_descent(error_cm, 0.5 * sum(bounds), bounds)
    seconds = time.perf_counter() - began
    found.append(
        SearchOutcome(
            "Algorithm 2 as printed", ended.value, 0.01 * ended.error, ended.evaluations, seconds, ended.stopped
        )
    )
    return tuple(found)


def _outcome(name: str, search: Search, began: float, stopped: str = "") -> SearchOutcome:
    best, error = search.best(), search.error()
    value, aee = float(search.tried.parameter[best]), float(error[best])
    return SearchOutcome(name, value, aee, len(error), time.perf_counter() - began, stopped)
