"""Random slabs, half of whose 24 pokes are fitted: do the intervals of the force hold at the other half?

Two ways. In full: finite elements press the slab, a shape-matching model is fitted to what the surface did, and
predicts other places, tips and forces; a quarter of an hour a slab. Fast: what finite elements were found to do with a
border (`PokedSlab.apparent`) stands for both, and the field of stiffness alone is tried, by the thousand.

Either under scatter of the force from poke to poke that the model is not given; a seed has one pattern of it on slabs
of all kinds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import conclude
from deformscope.stages.poke.poke_fit import SeenPoke, fit_pokes, seen_poke
from deformscope.stages.poke.stiffness_field import fit_field
from deformscope.stages.regions.posterior import SurfaceKind
from deformscope.studies.coverage import Rate
from deformscope.studies.poke_slabs import KINDS, POKE_GROUPS, PokedSlab, PokeGroup, SlabKind, Split, draw_slab
from deformscope.studies.poke_study import GRID, OTHER_TIPS, TIP, Press, observe, plan_of
from deformscope.studies.prediction import predict_seen

TIPS = (TIP, *OTHER_TIPS)
"""Of unseen pokes, in turn [m]."""

WRONG = 0.2
"""A force that is off by more is counted."""


@dataclass(frozen=True, slots=True)
class ForceCase:
    """A slab to try. scatter: deviation of the force's logarithm from poke to poke; full: with finite
    elements; split: which half is fitted"""

    kind: SlabKind
    seed: int
    scatter: float = 0.0
    full: bool = False
    level: float = 0.9
    split: Split = "alternate"


@dataclass(frozen=True, slots=True)
class UnseenForce:
    """An unseen poke.

    place [m]; inside: its signed distance to the border [m]; same_tip: as fitted; force: true [N], of the fast way up
    to a factor; error: of the predicted one, relative; low, high: ends of the interval over the true force; held: it
    holds that; width: of it over the predicted force; surface_error: share of the depth, None of the fast way
    """

    group: PokeGroup
    place: tuple[float, float]
    inside: float
    same_tip: bool
    force: float
    error: float
    low: float
    high: float
    held: bool
    width: float
    surface_error: float | None


@dataclass(frozen=True, slots=True)
class TriedSlab:
    """field: what the model takes the surface for; pokes: the unseen ones"""

    case: ForceCase
    field: SurfaceKind
    pokes: tuple[UnseenForce, ...]


@dataclass(frozen=True, slots=True)
class ForceRow:
    """A line of the tables: pokes of one group on slabs of one kind, or of all. error: root mean square, relative;
    wrong: of the pokes, those off by more than a fifth; surface_error: root mean square share of the depth, None of the
    fast way"""

    slab: str
    group: PokeGroup
    scatter: float
    full: bool
    error: float
    wrong: int
    held: Rate
    width: float
    surface_error: float | None


def force_cases(
    kinds: Sequence[SlabKind],
    seeds: Sequence[int],
    scatters: Sequence[float],
    full: bool,
    level: float = 0.9,
    split: Split = "alternate",
) -> list[ForceCase]:
    """Every slab under every scatter."""
    return [
        ForceCase(kind, seed, scatter, full, level, split) for scatter in scatters for kind in kinds for seed in seeds
    ]


def try_slab(case: ForceCase) -> TriedSlab:
    """Draw the slab, fit half of its pokes and predict the others."""
    drawn = draw_slab(case.kind, case.seed, case.split)
    factor = np.exp(case.scatter * np.random.default_rng([case.seed, 29]).normal(size=len(drawn.places)))
    return _in_full(case, drawn, factor) if case.full else _fast(case, drawn, factor)


def _fast(case: ForceCase, drawn: PokedSlab, factor: FloatArray) -> TriedSlab:
    stiffness = factor * drawn.apparent(drawn.places)
    field = fit_field(drawn.places[drawn.fitted], stiffness[drawn.fitted], TIP[0])
    unseen = np.flatnonzero(~drawn.fitted)
    value, ends = field.at(drawn.places[unseen]), field.interval(drawn.places[unseen], case.level)
    pokes = [
        _judged(drawn, int(i), float(stiffness[i]), float(value[row]), (float(ends[row, 0]), float(ends[row, 1])))
        for row, i in enumerate(unseen)
    ]
    return TriedSlab(case, field.kind, tuple(pokes))


def _in_full(case: ForceCase, drawn: PokedSlab, factor: FloatArray) -> TriedSlab:
    plan = plan_of(drawn, TIPS)
    fitted, unseen = np.flatnonzero(drawn.fitted), np.flatnonzero(~drawn.fitted)

    def measured(press: Press, which: int) -> SeenPoke:
        poke = seen_poke(observe(plan.slab, press))
        return dataclasses.replace(poke, force=press.force * float(factor[which]))

    known = [measured(press, int(i)) for press, i in zip(plan.fitted, fitted, strict=True)]
    fit = fit_pokes(MeasuredSurface(plan.slab.grid(GRID), plan.slab.size[2]), known)
    model = conclude(fit, level=case.level, settings={}, provenance={}).model
    pokes = []
    for press, i in zip(plan.unseen, unseen, strict=True):
        poke = measured(press, int(i))
        found, _, score = predict_seen(model, poke)
        assert poke.force is not None
        assert found.force is not None
        assert found.force_interval is not None
        judged = _judged(drawn, int(i), poke.force, found.force, found.force_interval)
        pokes.append(dataclasses.replace(judged, same_tip=press.sides == TIP, surface_error=score.surface_error))
    return TriedSlab(case, model.field_kind, tuple(pokes))


def _judged(drawn: PokedSlab, which: int, force: float, predicted: float, ends: tuple[float, float]) -> UnseenForce:
    x, y = (float(value) for value in drawn.places[which])
    return UnseenForce(
        group=drawn.group(drawn.places[which]),
        place=(x, y),
        inside=float(drawn.inside(drawn.places[which])),
        same_tip=True,
        force=force,
        error=predicted / force - 1.0,
        low=ends[0] / force,
        high=ends[1] / force,
        held=ends[0] <= force <= ends[1],
        width=(ends[1] - ends[0]) / predicted,
        surface_error=None,
    )


def force_rows(tried: Sequence[TriedSlab]) -> list[ForceRow]:
    """All slabs together, then each kind by itself."""
    rows = []
    for scatter in dict.fromkeys(one.case.scatter for one in tried):
        for kind in (None, *KINDS):
            chosen = [one for one in tried if one.case.scatter == scatter and kind in (None, one.case.kind)]
            for group in POKE_GROUPS:
                pokes = [poke for one in chosen for poke in one.pokes if poke.group == group]
                if pokes:
                    rows.append(_row(kind or "all", group, scatter, chosen[0].case.full, pokes))
    return rows


def _row(slab: str, group: PokeGroup, scatter: float, full: bool, pokes: Sequence[UnseenForce]) -> ForceRow:
    error = np.array([poke.error for poke in pokes])
    surface = [poke.surface_error for poke in pokes if poke.surface_error is not None]
    return ForceRow(
        slab=slab,
        group=group,
        scatter=scatter,
        full=full,
        error=float(np.sqrt(np.mean(error**2))),
        wrong=int(np.count_nonzero(np.abs(error) > WRONG)),
        held=Rate(len(pokes), sum(poke.held for poke in pokes)),
        width=float(np.median([poke.width for poke in pokes])),
        surface_error=float(np.sqrt(np.mean(np.square(surface)))) if surface else None,
    )
