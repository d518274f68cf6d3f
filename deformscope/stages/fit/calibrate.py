"""Calibration of beta and theta: sweep all candidates at once, refine the minimum, and compute interval and verdict.

The sweep is the thesis's Algorithm 3; `method="gradient"` serves Algorithm 2's purpose. The error is eq. 3.18, 3.19.

Prescribed particles whose stated position is wrong.

A simulation follows its held particles, so that a wrong one has no residual, but displaces the free particles around
it. Therefore each held particle gets a displacement as an unknown, in addition to the parameter and the other
explanations of the residuals (`deformscope.stages.fit.noise`). If twice the log likelihood gains far more than noise
explains, the particle counts as wrong. Its position is then estimated, and the remaining error is a part of the
interval, like the noise of the other held particles."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit import doubts
from deformscope.stages.fit.dynamics import MovingSearch, Pace
from deformscope.stages.fit.estimate import (
    Comparison,
    Curve,
    Doubt,
    Estimate,
    Identifiability,
    Parameter,
    relative_verdict,
    verdict,
)
from deformscope.stages.fit.force import contact_stiffness, stiffness_interval
from deformscope.stages.fit.inference import Inference, Inferred
from deformscope.stages.fit.model import (
    FitOptions,
    Model,
    Observation,
    distances,
    explained_share,
    nearest_error,
    unexplained,
)
from deformscope.stages.fit.noise import CORRELATIONS, OFFS
from deformscope.stages.fit.outliers import LeftOut, without_outliers
from deformscope.stages.fit.residuals import Residuals
from deformscope.stages.fit.search import Progress, Search
from deformscope.stages.fit.shared_errors import for_posterior, together
from deformscope.stages.fit.two_materials import FittedBody, two_materials
from deformscope.stages.msm import clusters


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


__all__ = ["Calibration", "FitOptions", "Model", "Observation", "Progress", "calibrate"]

BETA_LIMIT = 0.9999
"""Highest beta that is searched: at 1 a cluster does not resist linear deformation."""

TURNED = 5
"""Number of values of the parameter, over its range, at which displacements with other axes are simulated."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """An estimate, the simulation of every observation at the estimate, and the evidence for it.

    left_out: particles of each observation that do not count as measurements; seen: what was fitted, as given, with
    `model`"""

    estimate: Estimate
    comparisons: tuple[Comparison, ...]
    inferred: Inferred
    left_out: tuple[LeftOut, ...]
    seen: tuple[Observation, ...]
    model: Model


def calibrate(
    seen: Sequence[Observation],
    options: FitOptions,
    *,
    one_motion: bool = False,
    pace: Pace | None = None,
    settings: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Fit one parameter to observations that share it, with its interval and verdicts.

    one_motion: the observations are frames of one motion, whose errors are not independent (`motion`); pace: simulate
    the observations by time stepping, in order, instead of each as a static state
    settings: recorded with the estimate; progress: called with (what, done, all)"""
    model, bounds = options.model, options.bounds
    if len({(s.unit, s.metres_per_unit) for s in seen}) != 1:
        raise InputError("observations in one unit", "pixels and metres mixed, or several scales", "fit them apart")
    highest = BETA_LIMIT if model.parameter == "beta" else 1.0
    if not 0.0 <= bounds[0] < bounds[1] <= highest:
        raise InputError(f"a range that rises within 0 to {highest:g}", f"{bounds[0]:g} to {bounds[1]:g}")
    if options.candidates < 3:
        raise InputError("at least 3 candidates", str(options.candidates))
    fit = Search(seen, model, bounds) if pace is None else MovingSearch(seen, model, bounds, pace)
    used = _settings(seen, options)
    if options.method == "sweep":
        fit.sweep(options.candidates, progress)
        drawn = fit.tried.parameter.copy()
        fit.refine()
        used["candidates"] = options.candidates
    else:
        used["stopped"] = fit.descend(progress)
        drawn = fit.tried.parameter.copy()
    stated, either = seen, list[Doubt]()
    fit.seen, left_out = without_outliers(stated, [body.scale for body in fit.bodies], fit.fitted)
    if not one_motion and pace is None:
        with threadpool_limits(1):
            fit, off, either = _put_held_right(fit, options)
        left_out = tuple(replace(one, held=which) for one, which in zip(left_out, off, strict=True))
    seen = fit.seen
    if any(one.count for one in left_out):
        used["left_out"] = [one.as_json() for one in left_out]
    judged: Search = fit
    if one_motion:
        found = together(fit, options.seed)
        fit.weight = found.weight
        fit.refine()
        judged = fit.only(*for_posterior(found))
        used["frame_weights"] = [round(float(w), 4) for w in found.weight]
        used["frames_worth"] = found.worth
        used["frames_correlation"] = [found.shared.mean, found.shared.most]
        used["frame_values"] = [round(float(v), 4) for v in fit.each_best()]
    with threadpool_limits(1):  # small matrices: more threads cost time, and change the last digits
        inference = Inference(judged, options.seed)
        inferred = inference.run(progress)
    value = inferred.posterior.mode()
    best = int(fit.rows_of(np.array([value]))[0])
    least = fit.best()
    least_aee = float(fit.tried.parameter[least]), float(fit.error()[least])
    ends = inferred.posterior.shortest(options.level, value)
    used["noise"] = inferred.noise
    used["noise_source"] = doubts.noise_source(seen)
    comparisons = tuple(
        Comparison(s.rest, s.deformed, p[best], s.observed, s.held, s.unit)
        for s, p in zip(seen, fit.tried.positions, strict=True)
    )
    supported = (fit.tried.parameter >= ends[0]) & (fit.tried.parameter <= ends[1])
    converged = inferred.converged and bool(fit.tried.converged[supported].all())
    shown = [*options.doubts, *shape_doubts(seen)]
    if pace is None and converged:
        shown += _in_residuals(judged, int(judged.rows_of(np.array([value]))[0]), inference)
    shown += either if "two-materials" not in (one.code for one in shown) else []
    # frames of a motion carry no force
    k = None if one_motion else _stiffness(fit, best, supported, inferred, options.level)
    estimate = estimate_of(
        seen,
        comparisons,
        inferred,
        (model.parameter, value, ends),
        options,
        floor=inference.floor,
        closest=[positions[least] for positions in fit.tried.positions],
        converged=converged,
        found=shown,
        added=held_off(seen, stated),
        stiffness=k,
        contact_stiffness=None if one_motion else contact_stiffness(seen, options.level),
        aee=float(fit.only(np.arange(len(seen)), np.ones(len(seen))).error()[best]),
        least_aee=least_aee,
        curve=Curve(drawn, fit.error()[fit.rows_of(drawn)]),
        settings={**used, **(settings or {})},
    )
    return Calibration(estimate, comparisons, inferred, left_out, tuple(stated), model)


def _put_held_right(fit: Search, options: FitOptions) -> tuple[Search, tuple[IntArray, ...], list[Doubt]]:
    """A search with wrong held particles corrected, their indices (n,) in each observation, and the doubt if two
    materials fit equally well. It is the earlier search if two materials, or corrected axes, explain the residuals
    better."""
    as_stated = fit.only(np.arange(len(fit.seen)), fit.weight)
    none = tuple(np.zeros(0, dtype=np.int64) for _ in fit.seen)
    if any(one.noise is None for one in fit.seen):  # a misfit would pass for it
        return fit, none, []
    off = correct_held(fit, options.candidates, options.seed)
    if not any(len(one) for one in off):
        return fit, off, []
    inference, best, right = Inference(as_stated, options.seed), as_stated.best(), fit.best()
    ratio = doubts.residual_ratio(fit.seen, [position[right] for position in fit.tried.positions], inference.floor)
    if ratio is None or ratio > doubts.NOISE_NAMED:  # more is wrong than that
        return as_stated, none, []
    left, count = 0.0, 0
    for row, part in enumerate(inference.parts):
        part.choose(as_stated.tried.positions[row][best][None], inference.response(row, best))
        part.kept = part.chosen
        left += float(fit.weight[row] * np.sum(part.left(fit.tried.positions[row][right]) ** 2))
        count += part.observed.size
    if list(_in_residuals(as_stated, best, inference, left)):
        return as_stated, none, []
    return fit, off, list(_two_betas(as_stated, best, inference, left * float(np.exp(HELD_GAIN / count))))


def _settings(seen: Sequence[Observation], options: FitOptions) -> dict[str, object]:
    """What is recorded of how a fit is made."""
    model = options.model
    at = {} if options.at is None else {"at": asdict(at_value(seen, model, options.at))}
    return {
        "cluster_size": model.cluster_size,
        "mode": model.basis,
        "alpha": model.alpha,
        "beta": None if model.parameter == "beta" else model.beta,
        "theta": None if model.parameter == "theta" else model.theta,
        "volume": model.volume,
        "method": options.method,
        "bounds": list(options.bounds),
        "seed": options.seed,
        "precision": model.precision,
        "device": model.device,
        "pose_held": all(s.pose_held for s in seen),
        **at,
        **({"found": options.found} if options.found else {}),
    }


def estimate_of(
    seen: Sequence[Observation],
    comparisons: Sequence[Comparison],
    inferred: Inferred,
    fitted: tuple[Parameter, float, tuple[float, float]],
    options: FitOptions,
    *,
    floor: float,
    least_aee: tuple[float, float],
    closest: Sequence[FloatArray],
    converged: bool,
    found: Sequence[Doubt],
    added: Iterable[Doubt] = (),
    stiffness: tuple[float, tuple[float, float]] | None,
    **given: Any,
) -> Estimate:
    """The estimate of one fitted parameter, its value and interval, with its verdicts.

    floor: least noise [unit]; least_aee: as in `Estimate`; closest: (K, d) states there, by which
    the model is judged; found: further doubts; added: doubts that follow those of
    the numbers and the shapes; given: the remaining fields of the `Estimate`"""
    parameter, value, ends = fitted
    bounds = options.bounds
    known = Identifiability(
        rise=inferred.rise,
        explained=explained(seen, closest),
        deviation=inferred.posterior.deviation(),
        misfit=float(np.sqrt(np.mean([one.misfit() ** 2 for one in inferred.explanations]))),
    )
    noise = doubts.residual_ratio(seen, closest, floor), inferred.noise, doubts.noise_source(seen)
    judge = partial(doubts.found_in_numbers, parameter, ends, known, converged=converged, seen=seen)
    ranked = least_aee[0], inferred.posterior.rank(least_aee[0])
    here = doubts.setting(seen, options.model, known.misfit, inferred.noise) if parameter == "theta" else ()
    reasons = doubts.ordered([*judge(noise=noise, least_aee=ranked), *found, *here, *added])
    of_stiffness = doubts.of_stiffness(reasons)
    free = [distances(c.simulated, c.observed)[s.free_observed] for c, s in zip(comparisons, seen, strict=True)]
    return Estimate(
        parameter=parameter,
        value=value,
        interval=ends,
        level=options.level,
        bounds=bounds,
        verdict=verdict(ends, bounds, known, reasons),
        stiffness_verdict="unidentified" if stiffness is None else relative_verdict(*stiffness, of_stiffness),
        aee_free=float(np.concatenate(free).mean()),
        least_aee=least_aee,
        nearest=float(np.mean([nearest_error(c.simulated[c.seen], c.observed[c.seen]) for c in comparisons])),
        unit=seen[0].unit,
        metres_per_unit=seen[0].metres_per_unit,
        converged=converged,
        stiffness=stiffness,
        posterior=inferred.posterior,
        identifiability=known,
        reasons=reasons,
        **given,
    )


def shape_doubts(seen: Sequence[Observation]) -> Iterator[Doubt]:
    """What the shapes alone show: units and mirrored axes."""
    yield from doubts.implausible_lengths(seen)
    for one in seen:
        if reasons := list(doubts.mirrored(one.rest, one.deformed, doubts.known_of(one))):
            yield reasons[0]
            return


def _in_residuals(search: Search, best: int, inference: Inference, rival: float = np.inf) -> Iterator[Doubt]:
    """What simulations with other axes, and with two betas, show of the residuals of the best; see `two_materials`."""
    low, high = map(search.stretch, search.bounds)
    tried = np.append(search.shrink(np.linspace(low, high, TURNED)), search.tried.parameter[best])

    def simulate(shapes: Sequence[FloatArray]) -> list[FloatArray]:
        """States (B, K, d) of each observation whose particles are prescribed as in shapes (K, d)."""
        each = zip(search.seen, search.bodies, shapes, strict=True)
        return [search.relax(body, shape[one.held], tried, None).settled for one, body, shape in each]

    bulge = doubts.bulging(search.seen, search.bodies, search.values(tried)[0])
    yield from doubts.swapped_axes(search.seen, simulate, bulge, search.weight, rival)
    yield from _two_betas(search, best, inference, rival)


def _two_betas(search: Search, best: int, inference: Inference, rival: float = np.inf) -> Iterator[Doubt]:
    """Doubts that simulations with two betas show."""
    model = search.model
    beta, theta = (float(one) for one in search.values(float(search.tried.parameter[best])))
    grouped = [model.grouping(one) for one in search.seen]
    if any(one.count < 2 for one in grouped):
        return

    def states(row: int, stretched: FloatArray) -> FloatArray:
        """(B, K, d) of one observation for -log(1 - beta) of each cluster (B, C), theta as at the best candidate."""
        one = search.seen[row]
        how: Any = {"volume": model.volume, "start": search.tried.positions[row][best]}
        return search.bodies[row].relax(one.deformed[one.held], -np.expm1(-stretched), theta, **how).settled

    bodies = []
    for row, (part, group, weight) in enumerate(zip(inference.parts, grouped, search.weight, strict=True)):
        position, response = search.tried.positions[row][best], inference.response(row, best)
        nothing = np.zeros((0, *part.observed.shape))
        bodies.append(FittedBody(part, group, position, response, nothing, partial(states, row), float(weight)))
    top = search.bounds[1] if model.parameter == "beta" else BETA_LIMIT
    yield from two_materials(bodies, beta, top, rival)


def explained(seen: Sequence[Observation], simulated: Sequence[FloatArray]) -> float:
    """Share of the motion beyond a rigid one that simulations (K, d) of all observations explain together."""
    left = [
        unexplained(s.rest, s.deformed, one, s.free_observed, s.observed | clusters.held_mask(len(s.rest), s.held))
        for s, one in zip(seen, simulated, strict=True)
    ]
    return explained_share(left, max(float(np.ptp(s.rest, axis=0).max()) for s in seen))


def _stiffness(
    fit: Search, best: int, supported: BoolArray, inferred: Inferred, level: float
) -> tuple[float, tuple[float, float]] | None:
    """Stiffness k and its interval over supported (B,) candidates, with the force's noise and the misfit."""
    inside = np.flatnonzero(supported)
    inside = np.unique([*inside[:: max(1, inside.size // 12)], *inside[-1:]]).astype(np.int64)
    parameter = fit.tried.parameter[inside]
    share = np.interp(parameter, inferred.posterior.parameter, inferred.posterior.density, left=0.0, right=0.0)
    share = share * np.gradient(parameter) if len(parameter) > 1 else share
    share = np.append(share, 1e-9 + 1e-3 * share.sum())  # the estimate counts wherever it lies
    inside = np.append(inside, best)
    beta, theta = fit.values(fit.tried.parameter[inside])
    positions = [p[inside] for p in fit.tried.positions]
    return stiffness_interval(fit.seen, fit.model, positions, beta, theta, share, inferred.explanations, level)


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
