"""Pairs of rest and deformed shapes without frames, each fitted alone or all to one value."""

from __future__ import annotations

from collections.abc import Sequence

from deformscope.session import Experiment, Step, measuring
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Observation, Progress, calibrate


def pair_files(
    seen: Sequence[Observation], fit: FitOptions, *, joint: bool = False, progress: Progress | None = None
) -> Experiment[list[Calibration]]:
    """Fit every pair, in order, or with `joint` one value to all. Each pair is one place on the `frame` timeline."""
    yield Step()
    if joint:
        with measuring("estimate"):
            found = calibrate(seen, fit, settings={"pairs": len(seen)}, progress=progress)
        for index, comparison in enumerate(found.comparisons):
            yield Step((comparison,), frame=index)
        yield Step((found.estimate,), frame=len(seen) - 1)
        return [found]
    every = []
    for index, one in enumerate(seen):
        with measuring("estimate"):
            found = calibrate([one], fit, progress=progress)
        every.append(found)
        yield Step((*found.comparisons, found.estimate), frame=index)
    return every
