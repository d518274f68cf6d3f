"""The thesis's two searches and that of deformscope on the same data: the value of each, and its cost."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from deformscope.stages.fit.model import Model, Observation, distances
from deformscope.stages.fit.search import Search
from studies.reproduce.fixed_step import fixed_step_descent

STEP = 0.01  # of Algorithm 3


@dataclass(frozen=True, slots=True)
class SearchOutcome:
    """search: method of the search; value: found; aee_m: error at that value (eq. 3.18); evaluations: number of
    computed static states; seconds: duration; stopped: why a descent ended"""

    search: str
    value: float
    aee_m: float
    evaluations: int
    seconds: float
    stopped: str = ""


def compare_searches(seen: Observation, model: Model, bounds: tuple[float, float]) -> tuple[SearchOutcome, ...]:
    """Algorithm 3; the descent of `calibrate --method gradient`; Algorithm 2 as printed, from the middle of the
    range."""
    found = []
    steps = round((bounds[1] - bounds[0]) / STEP) + 1
    ours: dict[str, Callable[[Search], str | None]] = {
        "sweep (Algorithm 3)": lambda search: search.sweep(steps, None),
        "gradient": lambda search: search.descend(None),
    }
    for name, seek in ours.items():
        began, search = time.perf_counter(), Search([seen], model, bounds)
        stopped, best, error = seek(search) or "", search.best(), search.error()
        spent = time.perf_counter() - began
        found.append(
            SearchOutcome(name, float(search.tried.parameter[best]), float(error[best]), len(error), spent, stopped)
        )
    began, body, at = time.perf_counter(), model.body(seen), seen.rest

    def error_cm(value: float) -> float:
        nonlocal at
        at = search.relax(body, seen.deformed[seen.held], value, at).position[0]
        return 100.0 * float(distances(at[seen.observed], seen.deformed[seen.observed]).mean())

    ended = fixed_step_descent(error_cm, 0.5 * sum(bounds), bounds)
    spent = time.perf_counter() - began
    printed = ended.value, 0.01 * ended.error, ended.evaluations, spent, ended.stopped
    return (*found, SearchOutcome("Algorithm 2 as printed", *printed))
