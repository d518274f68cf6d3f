"""`python -m studies force`: how often the intervals of a predicted force hold the true one, on random slabs.

python -m studies force
python -m studies force --full --kinds halves "stiff disc" --slabs 8 --jobs 16 --resume forces.jsonl --json force.json
python -m studies force --full --slabs 4 --seed 2000 --scatter 0 0.03 --conditions "as given" "nu 0.45" "twice as deep"

Random slabs, half of whose 24 pokes are fitted: do the intervals of the force hold at the other half?

Two ways. In full: finite elements press the slab, and a shape-matching model is fitted to the surface's motion. It
predicts other places, tips and forces; about a minute or more per slab, for any number of scatters. Fast: the effect of
a border in finite elements (`FELT`) replaces both, and only the field of stiffness is tested, thousands of times.

Both have a scatter of the force from poke to poke that the model is not given; a seed has one pattern of it on slabs of
all kinds.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from tyro.conf import arg

from deformscope.arrays import FloatArray
from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.stages.poke.fitted import FittedModel, Prediction, Score, predict_seen
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import model_of
from deformscope.stages.poke.poke_fit import SeenPoke, fit_pokes, seen_poke
from deformscope.stages.poke.stiffness_field import fit_field
from deformscope.stages.regions.posterior import SurfaceKind
from studies.quantities import Quantity, Rate, Row, band, by, percent, rows, table
from studies.reproduce.poke_slabs import KINDS, POISSON, PokedSlab, PokeGroup, SlabKind, Split, draw_slab
from studies.reproduce.poke_study import GRID, OTHER_TIPS, TIP, Press, observe, plan_of
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

TIPS = (TIP, *OTHER_TIPS)
"""Tips of unseen pokes, in turn [m]."""

ELEMENT = 0.5
"""Size of the finite elements at the tip, as a share of its half width. Forces are then 2 % above those of elements a
third of it, for any tip, in a quarter of the time."""

WRONG = 0.2
"""A force that is off by more is counted."""

POKE_GROUPS: tuple[PokeGroup, ...] = get_args(PokeGroup)
FELT_M = 0.01 * np.arange(-4.0, 5.0)
FELT = np.array([0.002, 0.008, 0.022, 0.120, 0.463, 0.768, 0.912, 0.963, 0.989])
"""Share of the stiffer material in a poke with a tip of 2 x 2 cm, at distances from the border on its side [m]: finite
elements, 20 and 80 kPa, 5 cm thick. Discs of 4 to 8 cm, 20 and 120 kPa, are within 0.06."""


Condition = Literal["as given", "nu 0.45", "thickness given 10 % more", "twice as deep"]
"""Differences from the foam and the pokes that the model is made for; `twice as deep`: unseen pokes are about twice as
deep as the fitted ones."""

NEARLY_INCOMPRESSIBLE, TOLD_MORE, DEEPER = 0.45, 1.1, 2.0
"""Poisson's ratio; stated thickness over the true one; depth of unseen pokes over that of fitted ones."""


def apparent(drawn: PokedSlab, place: FloatArray) -> FloatArray:
    """Young's modulus (n,) [Pa] of the slab of one material with the same stiffness for a poke at places (n, 2)."""
    if drawn.kind == "gradual":
        return drawn.young(place)
    low, high = sorted(drawn.modulus)
    stiff_side = drawn.inside(place) * (1.0 if drawn.modulus[1] >= drawn.modulus[0] else -1.0)
    return np.asarray(low + (high - low) * np.interp(stiff_side, FELT_M, FELT))


@dataclass(frozen=True, slots=True)
class ForceCase:
    """A slab to try. scatter: deviation of the force's logarithm from poke to poke; full: with finite elements; split:
    which half is fitted; condition: condition number of the full way alone; device: that fits and predicts"""

    kind: SlabKind
    seed: int
    scatter: float = 0.0
    full: bool = False
    level: float = 0.9
    split: Split = "alternate"
    condition: Condition = "as given"
    device: str = "cpu"


@dataclass(frozen=True, slots=True)
class UnseenForce:
    """An unseen poke.

    place [m]; inside: its signed distance to the border [m], None without one; same_tip: as fitted; force: true [N], of
    the fast way up to a factor; error: relative error of the predicted force; low, high: ends of the interval over the
    true force; held: it holds that; width: width of it over the predicted force; surface_error: share of the depth,
    None of the fast way
    own_nearest: the nearest fitted poke is on the same side of the border"""

    group: PokeGroup
    place: tuple[float, float]
    inside: float | None
    same_tip: bool
    force: float
    error: float
    low: float
    high: float
    held: bool
    width: float
    surface_error: float | None
    own_nearest: bool = True


@dataclass(frozen=True, slots=True)
class TriedSlab:
    """field: what the model takes the surface for; pokes: the unseen ones"""

    case: ForceCase
    field: SurfaceKind
    pokes: tuple[UnseenForce, ...]


SlabCases = tuple[ForceCase, ...]
"""One slab under several scatters."""


def slab_cases(
    kinds: Sequence[SlabKind],
    seeds: Sequence[int],
    scatters: Sequence[float],
    full: bool,
    level: float = 0.9,
    split: Split = "alternate",
    conditions: Sequence[Condition] = ("as given",),
    device: str = "cpu",
) -> list[SlabCases]:
    """Every slab under every condition and scatter, seed by seed."""
    return [
        tuple(ForceCase(kind, seed, one, full, level, split, condition, device) for one in scatters)
        for seed in seeds
        for kind in kinds
        for condition in conditions
    ]


def try_slab(cases: SlabCases) -> tuple[TriedSlab, ...]:
    """Draw the slab, fit half of its pokes and predict the others, under each scatter."""
    drawn = draw_slab(cases[0].kind, cases[0].seed, cases[0].split)
    pressed = _press(drawn, cases[0].condition, cases[0].device) if cases[0].full else None
    tried = []
    for case in cases:
        factor = np.exp(case.scatter * np.random.default_rng([case.seed, 29]).normal(size=len(drawn.places)))
        tried.append(_fast(case, drawn, factor) if pressed is None else _in_full(case, drawn, factor, pressed))
    return tuple(tried)


def _fast(case: ForceCase, drawn: PokedSlab, factor: FloatArray) -> TriedSlab:
    stiffness = factor * apparent(drawn, drawn.places)
    field = fit_field(drawn.places[drawn.fitted], stiffness[drawn.fitted], TIP[0])
    unseen = np.flatnonzero(~drawn.fitted)
    value, ends = field.at(drawn.places[unseen]), field.interval(drawn.places[unseen], case.level)
    pokes = [
        _judged(drawn, int(i), float(stiffness[i]), float(value[row]), (float(ends[row, 0]), float(ends[row, 1])))
        for row, i in enumerate(unseen)
    ]
    return TriedSlab(case, field.kind, tuple(pokes))


@dataclass(frozen=True, slots=True)
class _Pressed:
    """The part that does not depend on the scatter of forces: a fitted model, and unseen pokes with its predictions."""

    model: FittedModel
    unseen: tuple[tuple[Press, SeenPoke, Prediction, Score], ...]


def _press(drawn: PokedSlab, condition: Condition, device: str) -> _Pressed:
    plan = plan_of(drawn, TIPS)
    slab = drawn.slab(NEARLY_INCOMPRESSIBLE if condition == "nu 0.45" else POISSON)

    def measured(press: Press) -> SeenPoke:
        return seen_poke(observe(slab, press, ELEMENT))

    thickness = slab.size[2] * (TOLD_MORE if condition == "thickness given 10 % more" else 1.0)
    fitted = [measured(press) for press in plan.fitted]
    model = model_of(fit_pokes(MeasuredSurface(slab.grid(GRID), thickness), fitted, device=device), {})
    unseen = []
    for press in plan.unseen:
        poke = measured(press)
        if condition == "twice as deep":  # depth goes with force: the elements are linear
            deep = DEEPER * float(np.median([one.depth for one in fitted]))
            press = dataclasses.replace(press, force=press.force * deep / poke.depth)
            poke = measured(press)
        found, _, score = predict_seen(model, poke, device=device)
        unseen.append((press, poke, found, score))
    return _Pressed(model, tuple(unseen))


def _in_full(case: ForceCase, drawn: PokedSlab, factor: FloatArray, pressed: _Pressed) -> TriedSlab:
    """Force errors by these factors (24,) change only the stiffness of pokes."""
    model = dataclasses.replace(pressed.model, stiffness=pressed.model.stiffness * factor[drawn.fitted])
    assert model.between is not None
    pokes = []
    for (press, poke, found, score), i in zip(pressed.unseen, np.flatnonzero(~drawn.fitted), strict=True):
        assert poke.force is not None
        assert found.force is not None
        assert found.stiffness is not None
        assert found.layers is not None
        here = model.stiffness_at(found.poke, found.layers.spacing, found.force_deviation)
        assert here is not None
        reaction = found.force / found.stiffness
        low, high = (reaction * end for end in here[1])
        judged = _judged(drawn, int(i), poke.force * float(factor[i]), reaction * here[0], (low, high))
        pokes.append(dataclasses.replace(judged, same_tip=press.sides == TIP, surface_error=score.surface_error))
    return TriedSlab(case, model.between.kind, tuple(pokes))


def _judged(drawn: PokedSlab, which: int, force: float, predicted: float, ends: tuple[float, float]) -> UnseenForce:
    x, y = (float(value) for value in drawn.places[which])
    fitted = drawn.places[drawn.fitted]
    nearest = fitted[np.argmin(np.linalg.norm(fitted - drawn.places[which], axis=1))]
    inside = float(drawn.inside(drawn.places[which]))
    return UnseenForce(
        group=drawn.group(drawn.places[which]),
        place=(x, y),
        inside=inside if np.isfinite(inside) else None,
        same_tip=True,
        force=force,
        error=predicted / force - 1.0,
        low=ends[0] / force,
        high=ends[1] / force,
        held=ends[0] <= force <= ends[1],
        width=(ends[1] - ends[0]) / predicted,
        surface_error=None,
        own_nearest=drawn.kind == "gradual" or bool((drawn.inside(nearest) > 0.0) == (inside > 0.0)),
    )


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ForceCoverageConfig(StudyOptions):
    """Count how often the intervals of a predicted force hold the true one. Random slabs of one material, halves, stiff
    and soft discs and gradual ones have 24 pokes, half of them fitted, with scatter that the model is not given."""

    slabs: flags.ManyFlag = 20
    """Slabs of each kind, from seed SEED on. A slab takes some 3 s."""
    kinds: Annotated[tuple[SlabKind, ...], arg(metavar="KIND...")] = ()
    """Kinds of slabs; default all."""
    scatter: Annotated[tuple[float, ...], arg(metavar="SHARE...")] = (0.0, 0.03, 0.06, 0.1)
    """By how much the force scatters from poke to poke, as a share."""
    full: bool = False
    """Press the slabs with finite elements and fit shape-matching models to what their surfaces do: some minutes a
    slab."""
    split: Literal["alternate", "random"] = "alternate"
    """Which half is fitted: every other poke, as on a chess board, or any half."""
    conditions: Annotated[tuple[Condition, ...], arg(metavar="CONDITION...")] = ("as given",)
    """With --full: what differs from the foam and the pokes that the model is meant for."""
    device: flags.Device = "cpu"
    """That fits the models and predicts, with --full."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""

    def check(self) -> None:
        if self.conditions != ("as given",) and not self.full:
            raise InputError("--full with --conditions", "none: the fast mode has only the condition `as given`")
        if not self.scatter or any(not 0.0 <= one < 1.0 for one in self.scatter):
            raise InputError("shares from 0 to below 1 after --scatter", " ".join(f"{one:g}" for one in self.scatter))


Pokes = tuple[str, Sequence[TriedSlab], Sequence[UnseenForce]]
"""The pokes of one group under one condition: on slabs of which kind, or of all, these slabs, and the pokes."""

QUANTITIES: tuple[Quantity[Pokes], ...] = (
    Quantity("slab", lambda some: some[0], {"slab": str}),
    Quantity("condition", lambda some: some[1][0].case.condition, {"condition": str}),
    Quantity("group", lambda some: some[2][0].group, {"unseen pokes": str}),
    Quantity("scatter", lambda some: some[1][0].case.scatter),
    Quantity("full", lambda some: some[1][0].case.full),
    Quantity(
        "held",
        lambda some: Rate.of(poke.held for poke in some[2]),
        {"number": lambda rate: rate.cases, "held (95 % band)": lambda rate: f"{rate.rate:.2f} ({band(2)(rate)})"},
    ),
    Quantity("error", lambda some: _rms([poke.error for poke in some[2]]), {"force off (rms)": percent(1)}),
    # of those alone whose nearest fitted poke is on the same side of the border
    Quantity(
        "own_error",
        lambda some: _rms([poke.error for poke in some[2] if poke.own_nearest]),
        {"nearest is of its material": lambda error: "" if error is None else f"{error:.1%}"},
    ),
    Quantity("wrong", lambda some: sum(abs(poke.error) > WRONG for poke in some[2]), {"by a fifth": int}),
    Quantity("width", lambda some: float(np.median([poke.width for poke in some[2]])), {"width": percent(0)}),
    # as a share of the depth; None of the fast way
    Quantity(
        "surface_error",
        lambda some: _rms([poke.surface_error for poke in some[2] if poke.surface_error is not None]),
        {"surface off": lambda error: "" if error is None else f"{error:.1%}"},
    ),
)


def _rms(errors: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.array(errors) ** 2))) if errors else None


COLUMNS = (
    *("slab", "condition", "unseen pokes", "number", "force off (rms)", "nearest is of its material", "by a fifth"),
    *("held (95 % band)", "width", "surface off"),
)


def force_rows(tried: Sequence[TriedSlab]) -> list[Row]:
    """All slabs together, then each kind alone."""
    groups: list[Pokes] = []
    for slabs in by(tried, lambda one: (one.case.condition, one.case.scatter)).values():
        for kind in (None, *KINDS):
            chosen = [one for one in slabs if kind in (None, one.case.kind)]
            pokes = by((poke for one in chosen for poke in one.pokes), lambda poke: poke.group)
            groups += [(kind or "all", chosen, pokes[group]) for group in POKE_GROUPS if group in pokes]
    return rows(groups, QUANTITIES)


def trials(options: ForceCoverageConfig) -> list[Trials[SlabCases, tuple[TriedSlab, ...]]]:
    """Every slab, under every scatter."""
    seeds = reported(options.slabs, options.output.seed)
    cases = slab_cases(
        options.kinds or KINDS,
        seeds,
        options.scatter,
        options.full,
        options.level,
        options.split,
        options.conditions,
        options.device,
    )
    return [Trials("random slabs", try_slab, cases)]


def report(options: ForceCoverageConfig, seconds: float, tried: Sequence[tuple[TriedSlab, ...]]) -> StudyReport:
    """A table for each scatter."""
    slabs = [one for some in tried for one in some]
    lines = force_rows(slabs)
    title = f"{options.level:.0%} intervals of predicted forces"
    tables = [
        table(
            [row for row in lines if row["scatter"] == scatter],
            QUANTITIES,
            f"{title}, scatter {scatter:.0%} from poke to poke",
            {name: name for name in COLUMNS},
        )
        for scatter in options.scatter
    ]
    return StudyReport(
        tables, {"level": options.level, "full": options.full, "split": options.split, "rows": lines, "slabs": slabs}
    )


STUDY = Study(ForceCoverageConfig, trials, report)
