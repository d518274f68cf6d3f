"""Pairs of rest and deformed shapes without frames, each fitted alone or all to one value; and pokes of one surface: a
body of layers below it that can be poked elsewhere."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.calibrate import LayersFlags
from deformscope.errors import InputError
from deformscope.session import Experiment, Step, measuring
from deformscope.stages.fit.calibrate import Calibration, calibrate
from deformscope.stages.fit.model import FitOptions, Model, Observation
from deformscope.stages.fit.plausible import check_poke
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.solver import pick_device
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import PokesResult, conclude
from deformscope.stages.poke.poke_fit import fit_pokes, seen_poke, spacing_for


def fit_options(config: BetaConfig | ThetaConfig) -> FitOptions:
    """Method and model of the parameter's search."""
    search = config.search
    known: dict[str, Any] = {"volume": search.volume, "device": pick_device(search.device)}
    if isinstance(config, BetaConfig):
        bounds, size = config.beta_range, config.fitted_cluster_size
        model = Model("beta", config.mode, size, config.alpha, theta=config.fitted_theta, **known)
    else:
        bounds = config.theta_range
        model = Model("theta", config.mode, config.cluster_size, config.alpha, beta=config.beta, **known)
    return FitOptions(model, bounds, search.method, search.candidates, search.level, config.output.seed, config.at)


@dataclass(frozen=True, slots=True)
class LayersOptions(LayersFlags):
    """The material below the surface; spacing of the lattice, cluster size and theta are found unless they are given.
    most_particles: most particles of the lattice; its default spacing is coarser where it would have more; None = any
    number"""

    thickness_m: float = field(kw_only=True)
    cluster_size: int | None = None
    theta: float | None = None
    most_particles: int | None = None


def poke_files(
    seen: Sequence[Observation],
    fit: FitOptions,
    layers: LayersOptions,
    *,
    provenance: Mapping[str, object],
    progress: Progress | None = None,
    note: Callable[[int, float, float], None] = lambda particles, spacing_m, finest_m: None,
) -> Experiment[PokesResult]:
    """Fit all pokes of one surface together. Each poke is one place on the `frame` timeline. note: called before the
    fit with the lattice's particles, its spacing, and the one it has without `most_particles`"""
    yield Step()
    surface = MeasuredSurface(seen[0].rest, layers.thickness_m)
    pokes = [seen_poke(one) for one in seen]
    for poke in pokes:
        if not surface.covers(poke.at[None, :2])[0]:
            raise InputError(
                "pokes of one surface",
                f"one at ({poke.at[0]:.3g}, {poke.at[1]:.3g}) m, outside the first file's points",
            )
        check_poke(surface.points, surface.thickness, poke.depth, poke.tip.width)
    most = np.inf if layers.most_particles is None or layers.spacing_m is not None else layers.most_particles
    spacing, finest, count = spacing_for(surface, pokes, layers.spacing_m, most)
    used = {"finest_spacing_m": finest} if spacing > finest else {}
    note(count, spacing, finest)
    found = fit_pokes(
        surface,
        pokes,
        spacing=spacing,
        cluster_sizes=None if layers.cluster_size is None else [layers.cluster_size],
        beta_range=fit.bounds,
        theta=layers.theta,
        device=fit.model.device,
        progress=progress,
    )
    if progress is not None:
        progress("interval", 0, 1)
    concluded = conclude(found, level=fit.level, settings={"pairs": len(seen), **used}, provenance=provenance)
    for index, comparison in enumerate(concluded.comparisons):
        yield Step((comparison,), frame=int(np.asarray(found.shaped)[index]))
    yield Step((concluded.estimate,), frame=len(seen) - 1)
    return concluded


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
