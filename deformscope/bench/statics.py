"""Cases of static states: one of ever larger cubes."""

from collections.abc import Iterator

from deformscope.arrays import FloatArray
from deformscope.bench.bodies import BenchBody, cube, poked
from deformscope.bench.plan import BETA, CLUSTER, BenchPlan, Note, side_of
from deformscope.bench.timing import OURS, Contestant, TimingRow, clock, compare
from deformscope.stages.msm.solver import Msm, Relaxed


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
            (row,) = compare("relax", [relaxing(plan.engine(body), body, what, BETA)], plan.rounds)
            last_s, before = min(row.samples) / 1e3, particles
            yield row


def relaxing(engine: Msm, body: BenchBody, what: str, beta: FloatArray | float) -> Contestant:
    """The static states of a body at one or several values of beta, in one call."""
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
