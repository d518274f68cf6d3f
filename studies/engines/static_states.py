"""Engine cases besides those of `deformscope bench`: sweeps, gradients, and fits of beta to the thesis's sheet."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from deformscope.arrays import FloatArray
from deformscope.bench.bodies import BenchBody, counted, cube, poked
from deformscope.bench.plan import BETA, CLUSTER, MIDDLE, BenchPlan, Note
from deformscope.bench.statics import relaxing
from deformscope.bench.steps import Stepping
from deformscope.bench.timing import OURS, Contestant, TimingRow, clock, compare
from deformscope.stages.msm.fit import fit_beta
from deformscope.stages.msm.solver import Msm

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


# Fitting beta to the thesis's sheet: by following the gradient, and by the thesis's sweep of time stepping

TRUE_BETA, NOISE = 0.637, 0.02
"""True beta and noise of the fitted sheet; noise in spacings."""
SETTLED = 1e-6
"""The thesis's time stepping ends below this: rms of goal - position, as a share of the extent."""
STEPS_MOST = 1_000_000
TIGHT = 1e-11
"""Tolerance of the static states that the answers are judged by."""

Error = Callable[[FloatArray, FloatArray], float]


def fit(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """Fit beta by two methods, and compare each result with the error's minimum."""
    body = sheet()
    for size in SHEET_CLUSTERS[1:2] if plan.quick else SHEET_CLUSTERS:
        what = f"beta of the {body.named}, clusters of {size}^2"
        note(f"fit: {what}, counting the steps of the thesis's sweep")
        engine = plan.engine(body, size)
        truth = engine.relax(body.held_position, TRUE_BETA, tolerance=TIGHT).position[0]
        observed = truth + NOISE * np.random.default_rng(0).standard_normal(truth.shape)
        judged = _Judged(engine, body.held_position, observed)
        steps = [_steps_needed(engine, body.held_position, float(beta)) for beta in SWEPT]

        note(f"fit: {what}")
        turn = plan.turn(judged.follow)
        ours = Contestant(what, f"{OURS}, by gradient", turn, found=partial(judged.answer, "gradient"))
        thesis = Contestant(
            *(what, f"{OURS}, the thesis's sweep", partial(clock, partial(judged.sweep, steps))),
            beside=ours,
            facts={"steps": sum(steps), "settled": SETTLED},
            found=partial(judged.answer, "sweep"),
            note="100 betas in turn, time stepping until settled (steps counted before)",
        )
        yield from compare("fit", [ours, thesis], plan.rounds)


class _Judged:
    """One problem, and the answers given to it. minimum: the beta of least error, to 1e-8, by two measures of error."""

    def __init__(self, engine: Msm, held_position: FloatArray, observed: FloatArray) -> None:
        self.engine, self.held_position, self.observed = engine, held_position, observed
        self.answers: dict[str, float] = {}
        self.minimum = {"mean_distance": self._least(mean_distance), "squares": self._least(squares)}

    def _least(self, error: Error) -> float:
        """The best of the sweep, refined by Brent's method."""

        def at(beta: float) -> float:
            position = self.engine.relax(self.held_position, beta, tolerance=TIGHT).position[0]
            return error(position, self.observed)

        every = self.engine.relax(self.held_position, SWEPT, tolerance=TIGHT).position
        best = float(SWEPT[np.argmin([error(position, self.observed) for position in every])])
        bounds = (max(best - 0.01, 0.0), best + 0.01)
        found: Any = minimize_scalar(at, bounds=bounds, method="bounded", options={"xatol": 1e-8})
        return float(found.x)

    def follow(self) -> None:
        """Answer by following the gradient."""
        self.answers["gradient"] = float(fit_beta(self.engine, self.held_position, self.observed).value)

    def sweep(self, steps: list[int]) -> None:
        """Algorithm 3: every beta from rest by time stepping, and the one of least error."""
        errors = []
        for beta, count in zip(SWEPT, steps, strict=True):
            position = self.engine.step(self.engine.start(), self.held_position, float(beta), steps=count)
            errors.append(mean_distance(position[0], self.observed))
        self.answers["sweep"] = float(SWEPT[np.argmin(errors)])

    def answer(self, name: str) -> dict[str, object]:
        """Result of one of them, and its distance from the minimum."""
        away = {f"from_minimum_of_{error}": self.answers[name] - beta for error, beta in self.minimum.items()}
        return {"beta": self.answers[name], "truth": TRUE_BETA, **away}


def mean_distance(position: FloatArray, observed: FloatArray) -> float:
    """Average Euclidean error of positions (..., d), in their unit (Thesis eq. 3.18)."""
    return float(np.linalg.norm(position - observed, axis=-1).mean())


def squares(position: FloatArray, observed: FloatArray) -> float:
    """Sum of squared distances of positions (..., d), in the square of their unit."""
    return float(np.sum((position - observed) ** 2))


def _steps_needed(engine: Msm, held_position: FloatArray, beta: float) -> int:
    """Time steps from rest until settled, searched in strides of a quarter and interpolated between two checks by the
    rate at which the residual falls."""
    state, done, last = engine.start(), 0, np.inf
    while done < STEPS_MOST:
        stride = max(20, done // 4)
        position = engine.step(state, held_position, beta, steps=stride)
        now = float(np.sqrt(np.mean(engine.residual(position, beta) ** 2))) / engine.extent
        if now <= SETTLED:
            share = np.log(SETTLED / last) / np.log(now / last) if np.isfinite(last) and now < last else 1.0
            return done + max(1, round(float(share) * stride))
        done, last = done + stride, now
    return done
