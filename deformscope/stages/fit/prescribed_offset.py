"""Prescribed particles whose stated position is wrong.

A simulation follows its held particles, so that a wrong one has no residual, but displaces the free particles around
it. Therefore each held particle gets a displacement as an unknown, in addition to the parameter and the other
explanations of the residuals (`deformscope.stages.fit.noise`). If twice the log likelihood gains far more than noise
explains, the particle counts as wrong. Its position is then estimated, and the remaining error is a part of the
interval, like the noise of the other held particles."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import logsumexp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.inference import Inference
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.noise import CORRELATIONS, OFFS
from deformscope.stages.fit.residuals import Residuals
from deformscope.stages.fit.search import Search

HELD_GAIN = 20.0
"""Twice the log likelihood that a held particle's displacement must gain. Compared with 15 and 30 on tuning seeds
(`studies.seeds`), 240 bodies per kind of error. Intervals held 0.92, 0.90 and 0.87 at 15, 20 and 30 if one of them was
off by 0.3 spacings (0.84 without), and none was moved for noise, white or shared over 2 or 6 spacings."""

LEAST = 0.05
"""Displacement below which a held particle counts as right [spacings]."""

SHARE_MOST = 0.34
"""Largest share of held particles that counts as off: if more seem wrong, another cause is assumed."""

ROUNDS = 4

SETTLED = 0.02
"""A last change of the estimated positions below this ends the rounds [spacings]."""

FIELDS_TRIED, SIZES = (("matern", (1.0, 3.0, 8.0)), ("gaussian", (1.4, 2.8, 4.0))), 3
"""Roughnesses and lengths of the smooth fields that represent all, and the step between sizes."""

OFF = OFFS[5][0]
"""Errors of tool and camera that are allowed for: a tool that is off as a whole is no reason to blame its particles."""

EFFECT = 0.02
"""Share of the (stretched) range by which the parameter is changed for a derivative."""


def correct_held(search: Search, candidates: int, seed: int) -> tuple[IntArray, ...]:
    """Find the wrong held particles, place them where the free particles show them to be, and search again. Gives their
    indices (n,) by observation; their positions in `search.seen` are the estimated ones, not observed."""
    off = [np.zeros(len(one.held), dtype=bool) for one in search.seen]
    for _ in range(ROUNDS):
        inference = Inference(search, seed)
        best = search.best()
        # candidates below and above the best one
        low, high = (search.stretch(bound) for bound in search.bounds)
        away = EFFECT * (high - low)
        place = min(max(search.stretch(float(search.tried.parameter[best])), low + away), high - away)
        ends = search.rows_of(search.shrink(np.array([place - away, place + away])))
        steps: dict[int, FloatArray] = {}
        for row, part in enumerate(inference.parts):
            if part.measured.held_rest is None or not len(part.judged):
                continue
            before, after = (search.tried.positions[row][end] for end in ends)
            residual = part.left(search.tried.positions[row][best])
            response = inference.response(row, best, exact=False)
            step = _steps(part, residual, (after - before)[part.judged], response, off[row])
            if step is not None:
                steps[row] = step
        if not any(np.abs(step).max() > SETTLED * search.bodies[row].scale for row, step in steps.items()):
            break
        for row, step in steps.items():
            one = search.seen[row]
            deformed, observed = one.deformed.copy(), one.observed.copy()
            deformed[one.held] += step
            observed[one.held[off[row]]] = False
            search.seen[row] = dataclasses.replace(one, deformed=deformed, observed=observed, loose=one.held[off[row]])
        search.again(candidates)
    return tuple(one.held[bad] for one, bad in zip(search.seen, off, strict=True))


def _steps(
    part: Residuals, residual: FloatArray, effect: FloatArray, response: FloatArray, off: BoolArray
) -> FloatArray | None:
    """By how much held particles are off, (k, d); None where none is. Those found are marked in off (k,), one a call.
    residual, effect of the parameter: (n, d); response: (n, d, m)"""
    k, d = len(off), residual.shape[1]
    columns = np.concatenate([effect[None], np.moveaxis(response, -1, 0)])
    size = np.maximum(np.linalg.norm(columns, axis=(1, 2)), 1e-300)
    base = np.concatenate([residual[None], columns / size[:, None, None]])
    every = part.errors.hypotheses  # some of which stand for all
    fields = [(every.field == CORRELATIONS.index(one)) & np.isin(every.length, some) for one, some in FIELDS_TRIED]
    few = np.any(fields, axis=0) & np.isin(every.size, np.unique(every.size)[1::SIZES]) | (every.size == 0.0)
    chosen = np.flatnonzero(few & np.all(every.off == OFF, axis=1))
    found = part.errors.products(base, response, chosen)

    def fitted(which: Sequence[int]) -> tuple[float, FloatArray]:
        """The log likelihood where these columns of the response are fitted, and the factor (n,) of each."""
        rows = np.asarray(which)
        square = found.product[:, rows[:, None], rows]
        little = 1e-10 * np.trace(square, axis1=1, axis2=2) + 1e-300  # columns may be alike, or do nothing
        square = square + little[:, None, None] * np.eye(len(rows))
        along = found.product[:, rows, 0]
        multiple = np.linalg.solve(square, along[:, :, None])[:, :, 0]
        left = np.maximum(found.product[:, 0, 0] - np.sum(along * multiple, axis=1), 0.0)
        some = dataclasses.replace(found, product=left[:, None, None], white=found.white[:1, :1])
        value = part.errors.judged(some, np.ones((1, 1))).log_likelihood[:, 0]
        total = float(logsumexp(value))
        return total, np.exp(value - total) @ multiple / size[rows - 1]

    def of(which: Sequence[int]) -> list[int]:
        return [1] + [2 + d * one + axis for one in which for axis in range(d)]

    known = np.flatnonzero(off).tolist()
    before, multiple = fitted(of(known))
    if len(known) + 1 <= max(1, SHARE_MOST * k):
        others = np.flatnonzero(~off).tolist()
        each = [fitted(of([*known, one])) for one in others]
        first = int(np.argmax([value for value, _ in each]))
        value, moved = each[first]
        if 2.0 * (value - before) > HELD_GAIN and np.linalg.norm(moved[-d:]) > LEAST * part.body.scale:
            off[others[first]] = True
            known, multiple = [*known, others[first]], moved
    if not known:
        return None
    step = np.zeros((k, d))
    step[known] = multiple[1:].reshape(-1, d)
    return step


def held_off(seen: Sequence[Observation], stated: Sequence[Observation]) -> Iterator[Doubt]:
    """Names the held particles that were found to be wrong."""
    for one, given in zip(seen, stated, strict=True):
        for particle in () if one.loose is None else one.loose:
            far = float(np.linalg.norm(one.deformed[particle] - given.deformed[particle]))
            off = f"held particle {particle} seems to be {far:.2g} {one.unit} from where it is stated to be"
            yield Doubt("held-off", f"{off}; its place is estimated from the free ones")
