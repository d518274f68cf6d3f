"""Random slabs, half of whose 24 pokes are fitted: do the intervals of the force hold at the other half?

Two ways. In full: finite elements press the slab, a shape-matching model is fitted to what the surface did, and predicts
other places, tips and forces; a minute or more a slab. Fast: what finite elements were found to do with a border
(`PokedSlab.apparent`) stands for both, and the field of stiffness alone is tried, by the thousand. Either under scatter
of the force from poke to poke that is not stated to the model.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import conclude
from deformscope.stages.poke.poke_fit import SeenPoke, fit_pokes, seen_poke
from deformscope.stages.poke.stiffness_field import fit_field
from deformscope.stages.regions.posterior import SurfaceKind
from deformscope.studies.coverage import Rate
from deformscope.studies.poke_slabs import KINDS, PokedSlab, SlabKind, draw_slab
from deformscope.studies.poke_study import GRID, TIP, Press, observe
from deformscope.studies.prediction import predict_seen

PokeGroup = Literal["in one material", "near a border", "on the inclusion"]
POKE_GROUPS: tuple[PokeGroup, ...] = get_args(PokeGroup)

FITTED_FORCE = 3.0
UNSEEN_TIPS = (TIP, (0.03, 0.03), TIP, (0.015, 0.015))
UNSEEN_FORCES = (3.0, 4.0, 1.5, 2.0, 5.0)
"""Of unseen pokes, in turn [m], [N]."""

WRONG = 0.2
"""A force that is off by more is counted."""


@dataclass(frozen=True, slots=True)
class ForceCase:
    """A slab to try. scatter: deviation of the force's logarithm from poke to poke; full: with finite elements"""

    kind: SlabKind
    seed: int
    scatter: float = 0.0
    full: bool = False
    level: float = 0.9


@dataclass(frozen=True, slots=True)
class UnseenForce:
    """An unseen poke. same_tip: as fitted; force: true [N], or of the fast way its ratio to any other; error: of the
    predicted one, relative; held: its interval holds it; width: of the interval over the predicted force;
    surface_error: share of the depth, None of the fast way"""

    group: PokeGroup
    place: tuple[float, float]
    same_tip: bool
    force: float
    error: float
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


def force_cases(kinds: Sequence[SlabKind], seeds: Sequence[int], scatters: Sequence[float], full: bool) -> list[ForceCase]:
    """Every slab under every scatter."""
    return [ForceCase(kind, seed, scatter, full) for scatter in scatters for kind in kinds for seed in seeds]


def try_slab(case: ForceCase) -> TriedSlab:
    """Draw the slab, fit half of its pokes and predict the others."""
    drawn = draw_slab(case.kind, case.seed)
    factor = np.exp(case.scatter * np.random.default_rng([case.seed, 29]).normal(size=len(drawn.places)))
    return _in_full(case, drawn, factor) if case.full else _fast(case, drawn, factor)


def _fast(case: ForceCase, drawn: PokedSlab, factor: FloatArray) -> TriedSlab:
    stiffness = factor * drawn.apparent(drawn.places, TIP[0])
    field = fit_field(drawn.places[drawn.fitted], stiffness[drawn.fitted], TIP[0])
    unseen = np.flatnonzero(~drawn.fitted)
    value, ends = field.at(drawn.places[unseen]), field.interval(drawn.places[unseen], case.level)
    pokes = [
        _judged(drawn, int(i), float(stiffness[i]), float(value[row]), (float(ends[row, 0]), float(ends[row, 1])))
        for row, i in enumerate(unseen)
    ]
    return TriedSlab(case, field.kind, tuple(pokes))


def _in_full(case: ForceCase, drawn: PokedSlab, factor: FloatArray) -> TriedSlab:
    slab = drawn.slab()

    def measured(which: int, sides: tuple[float, float], force: float) -> SeenPoke:
        x, y = drawn.places[which]
        poke = seen_poke(observe(slab, Press((float(x), float(y)), sides, force)))
        return dataclasses.replace(poke, force=force * float(factor[which]))

    known = [measured(int(i), TIP, FITTED_FORCE) for i in np.flatnonzero(drawn.fitted)]
    fit = fit_pokes(MeasuredSurface(slab.grid(GRID), slab.size[2]), known)
    model = conclude(fit, level=case.level, settings={}, provenance={}).model
    pokes = []
    for row, i in enumerate(np.flatnonzero(~drawn.fitted)):
        tip = UNSEEN_TIPS[row % len(UNSEEN_TIPS)]
        poke = measured(int(i), tip, UNSEEN_FORCES[row % len(UNSEEN_FORCES)])
        found, _, score = predict_seen(model, poke)
        assert poke.force is not None and found.force is not None and found.force_interval is not None
        judged = _judged(drawn, int(i), poke.force, found.force, found.force_interval)
        pokes.append(dataclasses.replace(judged, same_tip=tip == TIP, surface_error=score.surface_error))
    return TriedSlab(case, model.field_kind, tuple(pokes))


def _judged(
    drawn: PokedSlab, which: int, force: float, predicted: float, ends: tuple[float, float]
) -> UnseenForce:
    group: PokeGroup = "in one material"
    if drawn.border[which]:
        group = "near a border"
    elif drawn.inclusion[which]:
        group = "on the inclusion"
    x, y = (float(value) for value in drawn.places[which])
    width = (ends[1] - ends[0]) / predicted
    held = ends[0] <= force <= ends[1]
    return UnseenForce(group, (x, y), True, force, predicted / force - 1.0, held, width, None)


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
