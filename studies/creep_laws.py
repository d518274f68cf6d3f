"""Foams of known laws, touched by hereditary integrals: how often the results of a hold are right (`studies.creep`).

The touches share no code with the fit (`studies.independent.viscoelastic`)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.report import Table
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.poke.creep import fit_creep
from studies.independent import viscoelastic
from studies.independent.viscoelastic import Modulus
from studies.quantities import Quantity, Rate, band, by, rows, share, table

RELAXES = (0.1, 0.4)
FIRST_SEED = 5000
"""First seed of the touches that are reported; seeds below are for choosing constants."""
FORCE_AFTER = {30.0: (0.5, 5.0, 30.0), 8.0: (0.5, 2.0, 8.0), 2.0: (0.5, 1.0, 2.0)}
"""By the hold [s]: times after which the remaining force is compared [s]."""
UP = np.array([0.0, 0.0, 1.0])
SURER = (0.7, 0.9)
"""Probabilities of creep without end that are counted in addition to the one of the reason."""
NAMES = ("share", "mean time", "relaxed", "at once")


@dataclass(frozen=True, slots=True)
class FoamLaw:
    """modulus: E(t) / E0; share: that relaxes, 1 of what never ends; mean_s: relaxation time, infinite of the same"""

    modulus: Modulus
    share: float
    mean_s: float


def _even(random: np.random.Generator, least: float, most: float) -> float:
    """Log-uniform."""
    return float(np.exp(random.uniform(np.log(least), np.log(most))))


def _branches(shares: FloatArray, times_s: FloatArray) -> FoamLaw:
    mean_s = float(shares @ times_s / shares.sum()) if shares.any() else float("nan")
    return FoamLaw(viscoelastic.prony(shares, times_s), float(shares.sum()), mean_s)


def _one(random: np.random.Generator, least_s: float, most_s: float) -> FoamLaw:
    return _branches(np.array([random.uniform(*RELAXES)]), np.array([_even(random, least_s, most_s)]))


def _two(random: np.random.Generator) -> FoamLaw:
    shares = random.dirichlet([2.0, 2.0]) * random.uniform(*RELAXES)
    return _branches(shares, np.array([_even(random, 0.2, 5.0) for _ in shares]))


def _power(random: np.random.Generator, least_s: float, most_s: float) -> FoamLaw:
    law = viscoelastic.power_law(random.uniform(0.04, 0.2), _even(random, least_s, most_s))
    return FoamLaw(law, 1.0, float("inf"))


def _logarithmic(random: np.random.Generator) -> FoamLaw:
    return FoamLaw(viscoelastic.logarithmic(random.uniform(0.05, 0.3), _even(random, 0.02, 0.5)), 1.0, float("inf"))


def _zener(random: np.random.Generator) -> FoamLaw:
    share = random.uniform(0.15, 0.5)
    return FoamLaw(viscoelastic.fractional_zener(share, _even(random, 0.2, 3.0)), share, float("inf"))


def _stretched(random: np.random.Generator) -> FoamLaw:
    share, time_s, order = random.uniform(*RELAXES), _even(random, 0.2, 1.5), 0.6
    return FoamLaw(viscoelastic.stretched(share, time_s, order), share, viscoelastic.stretched_mean_s(time_s, order))


LAWS: dict[str, tuple[float, Callable[[np.random.Generator], FoamLaw]]] = {
    "one branch of .2 to 5 s, 8 s hold": (8.0, lambda random: _one(random, 0.2, 5.0)),
    "two branches of .2 to 5 s, 8 s": (8.0, _two),
    "elastic, 8 s": (8.0, lambda random: _branches(np.zeros(1), np.ones(1))),
    "one branch of 15 to 60 s, 8 s": (8.0, lambda random: _one(random, 15.0, 60.0)),
    "branches of .05, .8 and 12 s, 8 s": (
        8.0,
        lambda random: _branches(random.uniform(0.05, 0.15, 3), np.array([0.05, 0.8, 12.0])),
    ),
    "power law since .001 to .1 s, 8 s": (8.0, lambda random: _power(random, 0.001, 0.1)),
    "logarithmic, 8 s": (8.0, _logarithmic),
    "one branch of .2 to 5 s, 2 s": (2.0, lambda random: _one(random, 0.2, 5.0)),
    "two branches of .2 to 5 s, 2 s": (2.0, _two),
    "power law since .3 to 3 s, 8 s": (8.0, lambda random: _power(random, 0.3, 3.0)),
    "fractional Zener, 8 s": (8.0, _zener),
    "stretched exponential, 8 s": (8.0, _stretched),
    "two branches of .2 to 5 s, 30 s": (30.0, _two),
    "logarithmic, 30 s": (30.0, _logarithmic),
}
"""By name: the hold [s], and how a law is drawn. The three before the last two are none that is fitted."""


@dataclass(frozen=True, slots=True)
class LawCase:
    law: str
    seed: int


@dataclass(frozen=True, slots=True)
class LawOutcome:
    """law; reasons: codes; held: whether intervals of NAMES hold, None where nothing is claimed; kept: whether those of
    the remaining force do, after the times of FORCE_AFTER; share_width: over the share itself, None: a bound;
    open: whether intervals are, None: a bound; endless: probability that it creeps without end"""

    law: str
    reasons: tuple[str, ...]
    held: tuple[bool | None, ...]
    kept: tuple[bool, ...]
    share_width: float | None
    open: bool | None
    endless: float


def try_law(case: LawCase) -> LawOutcome:
    """Draw a foam, touch it, and fit."""
    hold_s, draw = LAWS[case.law]
    random = np.random.default_rng([case.seed, list(LAWS).index(case.law)])
    law = draw(random)
    after_s = np.array(FORCE_AFTER[hold_s])
    left = 1.0 - law.share
    made = viscoelastic.touched(law.modulus, left, hold_s, after_s, random)
    arm = ArmCompliance(viscoelastic.ARM_M_PER_N, viscoelastic.ARM_OFF_M_PER_N, viscoelastic.PLACE_SD_M)
    fit = fit_creep(
        made.time_s,
        -made.place_m[:, None] * UP,
        made.force_n[:, None] * UP,
        UP,
        loading=made.loading,
        held=len(made.time_s),
        set_force_n=viscoelastic.SET_N,
        arm=arm,
        radius_m=viscoelastic.RADIUS_M,
    )
    truth = (law.share, law.mean_s, made.relaxed_n_per_mm, made.at_once_n_per_mm)
    said = (fit.share_interval, fit.time_interval, fit.relaxed_interval, fit.instant_interval)
    held = tuple(
        None if ends is None or np.isnan(true) else ends[0] <= true <= ends[1]
        for true, ends in zip(truth, said, strict=True)
    )
    said_after = [next(one for one in fit.force_kept if abs(one.after_s - at) < 0.02) for at in after_s]
    kept = tuple(
        one.interval[0] <= true <= one.interval[1] for one, true in zip(said_after, made.kept.tolist(), strict=True)
    )
    low, high = fit.share_interval
    width = None if fit.reasons or not law.share else (high - low) / law.share
    opened = None if fit.reasons else high == 1.0
    return LawOutcome(case.law, tuple(one.code for one in fit.reasons), held, kept, width, opened, fit.no_plateau)


# What is counted -----------------------------------------------------------------------------------------------------


def _held(at: int) -> Callable[[Sequence[LawOutcome]], Rate]:
    return lambda some: Rate.of(one.held[at] for one in some if one.held[at] is not None)


def _kept(at: int) -> Callable[[Sequence[LawOutcome]], Rate]:
    return lambda some: Rate.of(one.kept[at] for one in some)


def _surer(than: float) -> Callable[[Sequence[LawOutcome]], Rate]:
    return lambda some: Rate.of(one.endless > than for one in some)


def _width(some: Sequence[LawOutcome]) -> float:
    widths = [one.share_width for one in some if one.share_width is not None]
    return float(np.median(widths)) if widths else float("nan")


def _of(rate: Rate) -> str:
    return f"{rate.rate:.2f} ({rate.cases})" if rate.cases else ""


COUNTED: tuple[Quantity[Sequence[LawOutcome]], ...] = (
    Quantity("law", lambda some: some[0].law, {"law": str}),
    Quantity("touches", len, {"touches": str}),
    *(
        Quantity(
            code.replace("-", "_"),
            lambda some, code=code: Rate.of(code in one.reasons for one in some),  # type: ignore[misc]
            {code: share(2)},
        )
        for code in ("short-record", "no-plateau")
    ),
    Quantity(
        "named",
        lambda some: Rate.of(one.reasons for one in some),
        {"either (95 % band)": lambda rate: f"{share(2)(rate)} ({band(2)(rate)})"},
    ),
    Quantity("open", lambda some: Rate.of(one.open for one in some if one.open is not None), {"open, no reason": _of}),
    # what naming it later would spare, and lose
    *(Quantity(f"endless_over_{100 * than:.0f}", _surer(than), {f"P(no end) > {than:g}": share(2)}) for than in SURER),
    *(Quantity(f"{name.replace(' ', '_')}_held", _held(at), {name: _of}) for at, name in enumerate(NAMES)),
    *(
        Quantity(f"force_held_{place}", _kept(at), {f"force, {place}": share(2)})
        for at, place in enumerate(("early", "between", "end"))
    ),
    Quantity("share_width", _width, {"width of share": lambda width: "" if np.isnan(width) else f"{width:.0%}"}),
)


def law_table(outcomes: Sequence[LawOutcome]) -> tuple[Table, list[dict[str, object]]]:
    """A line for each law: how often a reason was named, and how often intervals hold, of those that were given."""
    lines = rows(by(outcomes, lambda one: one.law).values(), COUNTED)
    title = (
        "laws of viscoelasticity by hereditary integrals: reasons, and share of 90 % intervals that hold (of "
        "their number)"
    )
    return table(lines, COUNTED, title), lines


def law_cases(count: int) -> list[LawCase]:
    """So many touches of each law."""
    return [LawCase(name, FIRST_SEED + seed) for name in LAWS for seed in range(count)]
