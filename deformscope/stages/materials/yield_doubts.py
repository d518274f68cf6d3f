"""Reasons to doubt a yield strain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.fit.calibrate import BETA_LIMIT, TURNED, Observation, shape_doubts
from deformscope.stages.fit.doubts import (
    LIKE_NOISE,
    bulging,
    little_explained,
    noise_contradicted,
    not_converged,
    ordered,
    residual_ratio,
    swapped_axes,
    value_at_end,
)
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.least_squares import Minimum
from deformscope.stages.fit.residuals import Residuals
from deformscope.stages.fit.two_materials import FittedBody, two_materials
from deformscope.stages.materials.yield_history import YieldHistories
from deformscope.stages.msm.solver import Relaxed


def yield_doubts(
    histories: YieldHistories,
    best: Minimum,
    simulated: FloatArray,
    value: float,
    ends: tuple[float, float | None],
    explained: float,
    *,
    converged: bool,
) -> tuple[Doubt, ...]:
    """Reasons to doubt the yield strain. simulated: (T, K, d) at the best; ends: ends of its interval"""
    high = np.inf if ends[1] is None else ends[1]
    rows = np.flatnonzero(histories.judged.any(axis=1))
    frames = [histories.frame(row) for row in rows]
    ratio = residual_ratio(frames, list(simulated[rows]), histories.resolved)
    found = [
        *not_converged(converged),
        *little_explained(explained, left_is_noise=ratio is not None and ratio < LIKE_NOISE, seen=frames),
        *value_at_end("yield strain", value, (ends[0], high), (0.0, np.inf)),
        *noise_contradicted(ratio, histories.motion.noise_source),
        *shape_doubts(frames),
    ]
    if converged:
        found += _in_residuals(histories, best, rows, frames, simulated)
    return ordered(found)


def _in_residuals(
    histories: YieldHistories, best: Minimum, rows: IntArray, frames: Sequence[Observation], simulated: FloatArray
) -> Iterator[Doubt]:
    """Doubts that histories with other axes, and with two betas, show in the residuals of the best. rows: (n,)
    frames"""
    strain, beta, creep = histories.numbers(best.at[None])
    tried = np.append(histories.shrink(np.linspace(0.1, 3.0, TURNED)), beta)
    betas, count = np.tile(tried, 2), 2 * len(tried)
    strains = np.repeat([float(strain[0]), np.inf], len(tried))

    def simulate(shapes: Sequence[FloatArray]) -> list[FloatArray]:
        held = histories.prescribed()
        for at, shape in zip(rows, shapes, strict=True):
            held[at] = shape[histories.frames[at]]
        states = histories.run(strains, betas, np.repeat(creep, count), held)[0]
        return [states[:, at] for at in rows]

    bodies = [histories.body.holding(one.held) for one in frames]
    yield from swapped_axes(frames, simulate, bulging(frames, bodies, tried))
    if histories.body.cluster_count < 2:
        return
    # at the frame with the largest motion: errors of all frames are much the same
    moved = np.where(histories.judged[:, :, None], histories.motion.position - histories.motion.rest, 0.0)
    row = int(np.sum(moved**2, axis=(1, 2)).argmax())
    one = histories.frame(row)
    part = Residuals(one, histories.body.holding(one.held), np.random.default_rng(histories.options.seed))

    def history(betas: FloatArray, held: FloatArray | None = None) -> FloatArray:
        size, every = len(betas), histories.prescribed()
        if held is not None:
            every[row] = held
        return histories.run(np.repeat(strain, size), betas, np.repeat(creep, size), every)[0]

    def relax(held: FloatArray, base: FloatArray, tolerance: float) -> Relaxed:
        position = history(np.repeat(beta, len(held)), held)[:, row]
        zero, settled = np.zeros(len(held)), np.isfinite(position[:, 0, 0])
        count, no = zero.astype(np.int64), np.zeros(len(held), dtype=bool)
        return Relaxed(position, zero, zero, count, settled, ~settled, smoothed=count, unaided=no, out_of_time=no)

    response = part.response(tuple(best.at), simulated[row], relax)
    part.choose(simulated[row][None], response)
    part.kept = part.chosen
    first, count = (int(some.sum()) * one.rest.shape[1] for some in (histories.judged[:row], histories.judged[row]))
    others = best.jacobian[first : first + count].T.reshape(len(best.at), -1, one.rest.shape[1])
    some = np.searchsorted(np.flatnonzero(histories.judged[row]), part.judged)

    def states(stretched: FloatArray) -> FloatArray:
        return history(histories.shrink(stretched))

    body = FittedBody(
        part,
        histories.model.grouping(one),
        simulated[row],
        response,
        others[:, some],
        states=lambda stretched: states(stretched)[:, row],
        whole=(histories.observed, lambda stretched: histories.compared(states(stretched))),
    )
    yield from two_materials([body], float(beta[0]), BETA_LIMIT)
