"""Engine cases besides those of `deformscope bench`: sweeps."""

from collections.abc import Iterator

import numpy as np

from deformscope.bench.bodies import BenchBody, counted, cube, poked
from deformscope.bench.plan import BETA, CLUSTER, MIDDLE, BenchPlan, Note
from deformscope.bench.report import Stepping, relaxing
from deformscope.bench.timing import OURS, Contestant, TimingRow, compare

SHEET = (7, 15)
SHEET_CLUSTERS = (2, 4, 5)
PUSH = 1.5
"""How far the sheet's particle is pushed [spacings]."""
SWEPT = np.arange(100) * 0.01
"""The betas of the thesis's sweep (Algorithm 3)."""


def sheet() -> BenchBody:
    """7 x 15 particles in the plane; the bottom row is held, the top middle particle is pushed in."""
    rows, columns = SHEET
    rest = np.indices(SHEET, dtype=np.float64).reshape(2, -1).T
    held = np.array([*range(columns), (rows - 1) * columns + columns // 2])
    position = rest[held]
    position[-1, 0] -= PUSH
    return BenchBody(f"{rows} x {columns} sheet", SHEET, rest, held, position)


def sweep(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """Static states of 100 betas in one launch."""
    for small in (sheet(), cube(4)):
        plan.engine(small).relax(small.held_position, BETA)  # loads the kernels
    sizes = SHEET_CLUSTERS[1:2] if plan.quick else SHEET_CLUSTERS
    for body, size in [(poked(MIDDLE), CLUSTER), *((sheet(), size) for size in sizes)]:
        what = f"{len(SWEPT)} betas, {body.named}, clusters of {size}^{body.rest.shape[1]}"
        note(f"sweep: {what}")
        yield from compare("sweep", [relaxing(plan.engine(body, size), body, what, SWEPT)], plan.rounds)


def stepped_at_once(plan: BenchPlan, candidates: int) -> Contestant:
    """Steps of the cube at which most is compared, at as many values of beta."""
    body = cube(MIDDLE)
    stepping = Stepping(plan.engine(body, precision="float32"), body, plan, candidates)
    what = f"{candidates} candidates of {counted(body.particles)} stepped at once"
    return Contestant(what, OURS, stepping, "steps/s", candidates, facts={"bits": 32})
