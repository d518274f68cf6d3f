"""Cases of static states: one state, a sweep of a hundred, and gradients."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.bench.bodies import SHEET_CLUSTERS, BenchBody, cube, poked, sheet
from deformscope.bench.plan import BETA, CLUSTER, MIDDLE, BenchPlan, Note, side_of
from deformscope.bench.timing import OURS, Contestant, TimingRow, clock, compare
from deformscope.stages.msm.solver import Msm, Relaxed

SWEPT = np.arange(100) * 0.01
"""The betas of the thesis's sweep (Algorithm 3)."""


def relax(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """The static state of ever larger cubes, from rest."""
    plan.engine(cube(4)).relax(cube(4).held_position, BETA)  # loads the kernels
    for make in (cube, poked):
        last_s, before = 0.0, 1
        for particles in plan.sizes:
            body = make(side_of(particles))
            what = f"{body.named}, clusters of {CLUSTER}^3"
            note(f"relax: {what}")
            # Iterations grow with the side.
            if (expected_s := last_s * (particles / before) ** (4 / 3)) > plan.longest_s:
                yield TimingRow("relax", what, OURS, "ms", (), note=f"left out: it would take some {expected_s:.0f} s")
                continue
            (row,) = compare("relax", [_relaxing(plan.engine(body), body, what, BETA)], plan.rounds)
            last_s, before = min(row.samples) / 1e3, particles
            yield row


def sweep(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """Static states of 100 betas in one launch."""
    for small in (sheet(), cube(4)):
        plan.engine(small).relax(small.held_position, BETA)  # loads the kernels
    sizes = SHEET_CLUSTERS[1:2] if plan.quick else SHEET_CLUSTERS
    for body, size in [(poked(MIDDLE), CLUSTER), *((sheet(), size) for size in sizes)]:
        what = f"{len(SWEPT)} betas, {body.named}, clusters of {size}^{body.rest.shape[1]}"
        note(f"sweep: {what}")
        yield from compare("sweep", [_relaxing(plan.engine(body, size), body, what, SWEPT)], plan.rounds)


def _relaxing(engine: Msm, body: BenchBody, what: str, beta: FloatArray | float) -> Contestant:
    last: list[Relaxed] = []

    def run() -> None:
        last[:] = [engine.relax(body.held_position, beta)]

    def facts() -> dict[str, object]:
        (result,) = last
        numbers: dict[str, object] = {"particles": body.particles, "iterations_most": int(result.iterations.max())}
        if result.smoothed.any():
            numbers["smoothed_most"] = int(result.smoothed.max())
        return numbers | {"converged": int(result.converged.sum()), "candidates": len(result.converged)}

    return Contestant(what, OURS, lambda: clock(run), found=facts)


def gradient(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """The gradient of an error over every cluster's beta, compared with one static state."""
    for body, size in ((poked(MIDDLE), CLUSTER), (sheet(), 4)):
        what = f"{body.named}, clusters of {size}^{body.rest.shape[1]}"
        note(f"gradient: {what}")
        engine: Any = plan.engine(body, size)
        position = engine.relax(body.held_position, BETA).position
        cotangent = np.random.default_rng(0).standard_normal(position.shape)
        settle = plan.turn(partial(engine.relax, body.held_position, BETA))
        descend = plan.turn(partial(engine.gradient, position, BETA, 0.0, cotangent=cotangent))
        facts = {"clusters": engine.cluster_count}
        state = Contestant(f"static state, {what}", OURS, settle)
        slope = Contestant(f"gradient by every cluster's beta, {what}", OURS, descend, beside=state, facts=facts)
        yield from compare("gradient", [state, slope], plan.rounds_of_steps)
