"""Calibration of beta and theta: sweep all candidates at once, refine the minimum, say how sure it is.

The sweep is the thesis's Algorithm 3; `method="gradient"` serves Algorithm 2's purpose. The error is eq. 3.18, 3.19.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.distance import distances, explained_share, nearest_error, unexplained
from deformscope.stages.fit.dynamics import MovingSearch, Pace
from deformscope.stages.fit.estimate import (
    Comparison,
    Curve,
    Estimate,
    Identifiability,
    Parameter,
    relative_verdict,
    verdict,
)
from deformscope.stages.fit.force import stiffness_interval
from deformscope.stages.fit.inference import Inference, Inferred
from deformscope.stages.fit.model import FitOptions, Model, Observation
from deformscope.stages.fit.outliers import LeftOut, without_outliers
from deformscope.stages.fit.search import Progress, Search
from deformscope.stages.fit.shared_errors import for_posterior, together
from deformscope.stages.msm import clusters

__all__ = ["Calibration", "FitOptions", "Model", "Observation", "Progress", "calibrate"]

BETA_LIMIT = 0.9999
"""Highest beta that is searched: at 1 a cluster resists nothing but rigid motion of the whole."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """An estimate, the simulation at it of every observation that it rests on, and how sure of it one can be.

    left_out: particles of each observation that were taken for no measurement; empty for the frames of a motion
    """

    estimate: Estimate
    comparisons: tuple[Comparison, ...]
    inferred: Inferred
    left_out: tuple[LeftOut, ...] = ()


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

    one_motion: the observations are frames of one motion, whose errors are not independent (`motion`); pace: with it
    they are simulated by time stepping, in order, instead of each as a static state
    settings: recorded with the estimate; progress: called with (what, done, all)
    """
    model, bounds = options.model, options.bounds
    check_observations(seen)
    check_range(model.parameter, bounds)
    if options.candidates < 3:
        raise InputError("at least 3 candidates", str(options.candidates))
    fit = Search(seen, model, bounds) if pace is None else MovingSearch(seen, model, bounds, pace)
    used: dict[str, object] = {
        "cluster_size": model.cluster_size,
        "mode": model.basis,
        "alpha": model.alpha,
        "beta": None if model.parameter == "beta" else model.beta,
        "theta": None if model.parameter == "theta" else model.theta,
        "volume": model.volume,
        "method": options.method,
        "bounds": list(bounds),
        "seed": options.seed,
        "precision": model.precision,
        "device": model.device,
        "pose_held": all(s.pose_held for s in seen),
    }
    if options.method == "sweep":
        fit.sweep(options.candidates, progress)
        drawn = fit.tried.parameter.copy()
        fit.refine()
        used["candidates"] = options.candidates
    else:
        used["stopped"] = fit.descend(progress)
        drawn = fit.tried.parameter.copy()
    left_out: tuple[LeftOut, ...] = ()
    if not one_motion:  # a motion's frames are the tracker's to judge
        left_out = without_outliers(fit)
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
    curve = Curve(drawn, fit.error()[fit.rows_of(drawn)])
    with threadpool_limits(1):  # small matrices: more threads cost time, and change the last digits
        inferred = Inference(judged, options.seed).run(progress)
    best = fit.best()
    ends = inferred.posterior.shortest(options.level, float(fit.tried.parameter[best]))
    used["noise"] = inferred.noise
    used["noise_source"] = "residuals" if seen[0].noise is None else "given"
    comparisons = tuple(
        Comparison(s.rest, s.deformed, p[best], s.observed, s.held, s.unit)
        for s, p in zip(seen, fit.tried.positions, strict=True)
    )
    free = np.concatenate(
        [distances(c.simulated, c.observed)[s.free_observed] for c, s in zip(comparisons, seen, strict=True)]
    )
    near = [nearest_error(c.simulated[c.seen], c.observed[c.seen]) for c in comparisons]
    supported = (fit.tried.parameter >= ends[0]) & (fit.tried.parameter <= ends[1])
    converged = inferred.converged and bool(fit.tried.converged[supported].all())
    identified = identifiability(seen, comparisons, inferred)
    # frames of a motion carry no force
    k = None if one_motion else _stiffness(fit, best, supported, inferred, options.level)
    estimate = Estimate(
        parameter=model.parameter,
        value=float(fit.tried.parameter[best]),
        interval=ends,
        level=options.level,
        bounds=bounds,
        verdict=verdict(ends, bounds, identified) if converged else "unidentified",
        stiffness_verdict="unidentified" if k is None else relative_verdict(*k),
        aee=float(fit.only(np.arange(len(seen)), np.ones(len(seen))).error()[best]),
        aee_free=float(free.mean()),
        nearest=float(np.mean(near)),
        unit=seen[0].unit,
        curve=curve,
        converged=converged,
        settings={**used, **(settings or {})},
        stiffness=k,
        metres_per_unit=seen[0].metres_per_unit,
        posterior=inferred.posterior,
        identifiability=identified,
    )
    return Calibration(estimate, comparisons, inferred, left_out)


def check_observations(seen: Sequence[Observation]) -> None:
    """Refuses observations that cannot be fitted together."""
    if len({(s.unit, s.metres_per_unit) for s in seen}) != 1:
        raise InputError("observations in one unit", "pixels and metres mixed, or several scales", "fit them apart")


def check_range(parameter: Parameter, bounds: tuple[float, float]) -> None:
    """Refuses a range that cannot be searched."""
    highest = BETA_LIMIT if parameter == "beta" else 1.0
    if not 0.0 <= bounds[0] < bounds[1] <= highest:
        raise InputError(f"a range that rises within 0 to {highest:g}", f"{bounds[0]:g} to {bounds[1]:g}")


def identifiability(
    seen: Sequence[Observation], comparisons: Sequence[Comparison], inferred: Inferred
) -> Identifiability:
    """Whether the data identify the parameter: see there."""
    return Identifiability(
        rise=inferred.rise,
        explained=explained(seen, [c.simulated for c in comparisons]),
        deviation=inferred.posterior.deviation(),
        misfit=float(np.sqrt(np.mean([one.misfit() ** 2 for one in inferred.explanations]))),
    )


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
    """k and its interval over all that the parameter may be, with the force's noise and the model's misfit."""
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
