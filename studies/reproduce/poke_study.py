"""Predictions of a model fitted to a few pokes of a slab: slabs of finite elements, whose truth is known.

A slab of one modulus is fitted to a single poke, halves and a disc in a softer slab to 12 of 24. The predicted pokes
have other tips, forces and places, some near the border."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.lab.slab import RigidTip, Slab, press
from deformscope.runs.prediction import compare
from deformscope.stages.fit.model import Observation
from deformscope.stages.msm.poke import Tip
from deformscope.stages.poke.fitted import PokeComparison
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import PokesResult, conclude
from deformscope.stages.poke.poke_fit import fit_pokes, seen_poke
from studies.reproduce.poke_slabs import PokedSlab, draw_slab

GRID = 0.01
"""Spacing of the surface points that are seen [m]."""


@dataclass(frozen=True, slots=True)
class Press:
    """A flat tip of sides (x, y) [m] pressed with a force [N] at a place (x, y) [m]."""

    at: tuple[float, float]
    sides: tuple[float, float]
    force: float


@dataclass(frozen=True, slots=True)
class PokeStudyPlan:
    """A slab, its fitted pokes, and predicted ones. drawn: where its materials are, of several"""

    name: str
    slab: Slab
    fitted: tuple[Press, ...]
    unseen: tuple[Press, ...]
    drawn: PokedSlab | None = None


TIP, FITTED_FORCE = (0.02, 0.02), 3.0
OTHER_TIPS, OTHER_FORCES = ((0.03, 0.03), (0.015, 0.015), (0.04, 0.02)), (4.0, 2.0, 5.0, 1.5)
"""Tips and forces of unseen pokes, in turn [m], [N]: the same tip with another force differs by nothing but the
place."""


def plan_of(drawn: PokedSlab, tips: Sequence[tuple[float, float]] = OTHER_TIPS) -> PokeStudyPlan:
    """The plan: half of the slab's pokes with one tip and one force, the others with these tips and various forces in
    turn."""
    places = [(float(x), float(y)) for x, y in drawn.places]
    fitted = [at for at, is_fitted in zip(places, drawn.fitted, strict=True) if is_fitted]
    unseen = [at for at, is_fitted in zip(places, drawn.fitted, strict=True) if not is_fitted]
    return PokeStudyPlan(
        f"{drawn.kind}, {drawn.modulus[0] / 1e3:.0f} and {drawn.modulus[1] / 1e3:.0f} kPa",
        drawn.slab(),
        tuple(Press(at, TIP, FITTED_FORCE) for at in fitted),
        tuple(Press(at, tips[i % len(tips)], OTHER_FORCES[i % len(OTHER_FORCES)]) for i, at in enumerate(unseen)),
        drawn,
    )


def plans() -> tuple[PokeStudyPlan, ...]:
    """The plans: one modulus, fitted to a single poke; halves and a stiff disc, fitted to 12 of 24 pokes."""
    one = PokeStudyPlan(
        "one modulus",
        Slab((0.3, 0.3, 0.05), 40e3, 0.2),
        (Press((0.15, 0.15), TIP, FITTED_FORCE),),
        (
            Press((0.12, 0.16), (0.04, 0.04), 5.0),
            Press((0.18, 0.14), (0.04, 0.02), 2.0),
            Press((0.11, 0.19), (0.01, 0.01), 1.0),
            Press((0.19, 0.12), (0.03, 0.03), 4.0),
        ),
    )
    return (one, *(plan_of(draw_slab(kind, 0)) for kind in ("halves", "stiff disc")))


@dataclass(frozen=True, slots=True)
class Studied:
    """plan; results of the fitted pokes; the unseen ones."""

    plan: PokeStudyPlan
    found: PokesResult
    unseen: tuple[PokeComparison, ...]


def study(plan: PokeStudyPlan) -> Studied:
    """Make the slab's pokes, fit some, predict the others."""
    fitted, unseen = ([observe(plan.slab, one) for one in pokes] for pokes in (plan.fitted, plan.unseen))
    surface = MeasuredSurface(fitted[0].rest, plan.slab.size[2])
    fit = fit_pokes(surface, [seen_poke(one) for one in fitted])
    found = conclude(fit, level=0.9, settings={}, provenance={"slab": plan.name})
    return Studied(plan, found, tuple(compare(found.model, unseen)))


def observe(slab: Slab, one: Press, element: float | None = None) -> Observation:
    """Observation of the slab's surface under a poke, computed by finite elements with this share of the tip's half
    width as size."""
    points = slab.grid(GRID)
    half = (0.5 * one.sides[0], 0.5 * one.sides[1])
    dent = press(
        slab, one.at, RigidTip(half), points, force=one.force, finest=None if element is None else element * min(half)
    )
    touched = np.flatnonzero(dent.touched)
    return Observation(
        points,
        points + dent.displaced,
        touched,
        np.ones(len(points), dtype=bool),
        force_n=one.force,
        contact=touched,
        tip=Tip("flat", one.sides),
        tip_at=np.array([*one.at, slab.size[2]]),
    )


def rows(studied: Sequence[Studied]) -> list[dict[str, object]]:
    """Rows of the table: one for each method and poke."""
    return [
        {
            "slab": one.plan.name,
            "group": "in one material" if one.plan.drawn is None else one.plan.drawn.group(np.array(press_.at)),
            "at_m": f"({press_.at[0]:g}, {press_.at[1]:g})",
            "tip_mm": f"{1e3 * press_.sides[0]:g} x {1e3 * press_.sides[1]:g}",
            "force_n": press_.force,
            "method": score.method,
            "surface_error": score.surface_error,
            "force_error": score.force_error,
            "force_interval_n": unseen.prediction.force_interval if score.method == "MSM" else None,
        }
        for one in studied
        for press_, unseen in zip(one.plan.unseen, one.unseen, strict=True)
        for score in unseen.scores
    ]
