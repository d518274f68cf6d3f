"""`python -m studies coverage`: how often the intervals hold the truth, counted on random objects.

python -m studies coverage --quick
python -m studies coverage --objects 1000 --jobs 2 --out runs/coverage --json coverage.json
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np

from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.pictures.report import Figure, Table
from deformscope.stages.fit.estimate import Verdict
from studies.doubt_rates import CODES, EXPECTED, Doubted, doubt_plan, doubt_rows, try_doubts
from studies.quantities import Quantity, Rate, Row, band, by, counts, number, rows, share, table
from studies.random_bodies import (
    NEAR_ONE,
    PART_APART,
    QUICK_OBJECTS,
    NothingCase,
    Outcome,
    plan,
    rank_counts,
    ranks_png,
    try_nothing,
    try_object,
)
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.unseen_pokes import PokeCase, UnseenPrediction, try_unseen_poke


@dataclass(frozen=True, slots=True)
class CoverageConfig(StudyOptions):
    """Count how often the intervals hold the truth: random objects under each kind of noise, data without information,
    and unseen pokes of finite element bodies."""

    objects: Annotated[int, flags.least(5)] = 1000
    """Random objects for each kind of noise; a fifth as many with beta = 0, near 1, of finite elements, and for each
    kind of data that are wrong."""
    quick: bool = False
    """15 objects each: a preview, in a minute."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    out: Annotated[Path | None, flags.one_word("DIR", Path), flags.unset] = None
    """Folder for the rank histogram (coverage.png); made where there is none."""

    def check(self) -> None:
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError("a folder after --out", "a file", where=self.out)


def trials(options: CoverageConfig) -> list[Trials[Any, Any]]:
    """Random objects, data without information, reasons to doubt, and unseen pokes."""
    seed, level = options.output.seed, options.level
    cases, nothing = plan(options.objects, seed, level, quick=options.quick)
    bodies = -(-(QUICK_OBJECTS if options.quick else options.objects) // PART_APART)
    return [
        Trials("random objects", try_object, cases),
        Trials("data without information", try_nothing, nothing),
        Trials("reasons to doubt", try_doubts, doubt_plan(bodies, seed)),
        Trials("unseen pokes", try_unseen_poke, [PokeCase(number, seed, level) for number in range(bodies)]),
    ]


def report(
    options: CoverageConfig,
    seconds: float,
    outcomes: Sequence[Outcome],
    verdicts: Sequence[Verdict],
    doubted: Sequence[Doubted],
    predictions: Sequence[UnseenPrediction],
) -> StudyReport:
    """Tables, and the ranks as a picture."""
    level, seed = options.level, options.output.seed
    cases, nothing = plan(options.objects, seed, level, quick=options.quick)
    lines = coverage_rows(outcomes)
    nothing_lines = rows(by(zip(nothing, verdicts, strict=True), lambda pair: pair[0].kind).values(), NO_INFORMATION)
    ranks = rank_counts([one for one, case in zip(outcomes, cases, strict=True) if case.truth == "prior"])
    pokes, doubts = rows(prediction_groups(predictions), POKES), doubt_rows(doubted)
    fit_s = {f"{dim}D": median([one.seconds for one in outcomes if one.dim == dim]) for dim in (2, 3)}
    png, picture = ranks_png(ranks), None if options.out is None else options.out / "coverage.png"
    took = [(f"a fit in {dim}", f"{one:.2g} s") for dim, one in fit_s.items()] + [("all", f"{seconds:.0f} s")]
    within = f"coordinates of an unseen poke within their {level:.0%} predictive intervals"
    return StudyReport(
        (
            coverage_table(f"{level:.0%} intervals for beta: how many hold the truth", lines),
            table(nothing_lines, NO_INFORMATION, "Data without information: how many verdicts are unidentified"),
            doubts_table(doubts),
            table(pokes, POKES, f"Finite element bodies: {within}"),
            Table(took + ([] if picture is None else [("ranks", str(picture))]), caption="Time"),
        ),
        {
            "level": level,
            "seed": seed,
            "coverage": _flat(lines, "covered"),
            "ranks": ranks,
            "no_information": _flat(nothing_lines, "unidentified", "others"),
            "reasons": doubts,
            "unseen_pokes": _flat(pokes, "covered"),
            "fit_seconds": fit_s,
            "seconds": seconds,
            "picture": picture,
        },
        (Figure(png, "Ranks of the truths in their posteriors: level where the intervals are right"),),
        {picture: png},
    )


# What is counted of them ---------------------------------------------------------------------------------------------


def _between(one: Outcome) -> bool:
    return 0.0 < one.beta <= NEAR_ONE


GROUPS: dict[str, Callable[[Outcome], bool]] = {
    "all": _between,
    "2D": lambda one: _between(one) and one.dim == 2,
    "3D": lambda one: _between(one) and one.dim == 3,
    "2 a side": lambda one: _between(one) and one.cluster_size == 2,
    "3 a side": lambda one: _between(one) and one.cluster_size == 3,
    "4 a side": lambda one: _between(one) and one.cluster_size == 4,
    "5 a side": lambda one: _between(one) and one.cluster_size == 5,
    "beta = 0": lambda one: one.beta == 0.0,
    f"beta > {NEAR_ONE}": lambda one: one.beta > NEAR_ONE,
}
"""Parts of the objects: all truths in between, by dimension and by cluster size; apart those where the range ends."""

Group = tuple[str, Sequence[Outcome]]

COVERAGE: tuple[Quantity[Group], ...] = (
    Quantity("condition", lambda group: group[1][0].condition),
    Quantity("group", lambda group: group[0]),
    Quantity("covered", lambda group: Rate.of(one.covered for one in group[1])),
    Quantity("width", lambda group: float(np.median([one.interval[1] - one.interval[0] for one in group[1]]))),
    Quantity("confident_wrong", lambda group: sum(one.confident_wrong for one in group[1])),
)


def coverage_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Rows of each condition's `GROUPS` that have objects."""
    groups = [
        (name, [one for one in mine if belongs(one)])
        for mine in by(outcomes, lambda one: one.condition).values()
        for name, belongs in GROUPS.items()
    ]
    return rows([group for group in groups if group[1]], COVERAGE)


NO_INFORMATION: tuple[Quantity[Sequence[tuple[NothingCase, Verdict]]], ...] = (
    Quantity("kind", lambda some: some[0][0].kind, {"data": str}),
    Quantity(
        "unidentified",
        lambda some: Rate.of(verdict == "unidentified" for _, verdict in some),
        {"cases": lambda rate: rate.cases, "unidentified": share(3), "95 % band": band(3)},
    ),
    Quantity(
        "others",
        lambda some: counts(verdict for _, verdict in some if verdict != "unidentified"),
        {"other verdicts": lambda others: ", ".join(f"{count} {name}" for name, count in others.items())},
    ),
)


def _length(name: str) -> Callable[[tuple[str, Sequence[UnseenPrediction]]], float]:
    """The median of a length [m]."""
    return lambda group: float(median(getattr(one, name) for one in group[1]))


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.2f}"


POKES: tuple[Quantity[tuple[str, Sequence[UnseenPrediction]]], ...] = (
    Quantity("group", lambda group: group[0], {"bodies": str}),
    Quantity("pokes", lambda group: len(group[1]), {"pokes": int}),
    Quantity(
        "covered",
        lambda group: Rate(sum(one.coordinates for one in group[1]), sum(one.covered for one in group[1])),
        {"coordinates": lambda rate: rate.cases, "within": share(3)},
    ),
    Quantity("width_m", _length("width"), {"width [mm]": _mm}),
    Quantity("error_m", _length("error"), {"error [mm]": _mm}),
    Quantity("motion_m", _length("motion"), {"motion [mm]": _mm}),
)


def prediction_groups(predictions: Sequence[UnseenPrediction]) -> list[tuple[str, Sequence[UnseenPrediction]]]:
    """All, and by dimension and cluster size."""
    groups = [("all", list(predictions))]
    groups += [(f"{dim}D", [one for one in predictions if one.dim == dim]) for dim in (2, 3)]
    groups += [(f"clusters of {size}", [one for one in predictions if one.cluster_size == size]) for size in (2, 3, 4)]
    return [group for group in groups if group[1]]


def _flat(lines: Sequence[Row], rate: str, left_out: str = "") -> list[Row]:
    """With the parts of this rate among the others, as the JSON has them."""
    return [
        {key: value for key, value in row.items() if key not in (rate, left_out)} | dataclasses.asdict(row[rate])
        for row in lines
    ]


def doubts_table(doubts: Sequence[Row]) -> Table:
    """How often each reason was named, a line for each kind of data, the reason that is true of them marked."""
    codes = [code for code in CODES if any(code in row["named"] for row in doubts)]
    lines = []
    for row in doubts:
        cells = []
        for code in codes:
            named = f"{row['named'][code].rate:.2f}" if code in row["named"] else ""
            cells.append(f"{named or '0'} <- true" if EXPECTED.get(row["data"]) == code else named)
        wrong = f"{row['identified_wrong'].hits}"
        lines.append((row["data"], row["identified"].cases, *cells, f"{row['identified'].rate:.2f}", wrong))
    names = ("data", "cases", *codes, "identified", "of these without the truth")
    return Table(lines, names, "Reasons to doubt beta: how often each is named")


def coverage_table(title: str, parts: Sequence[Row]) -> Table:
    """A line a condition: all truths in between, parts of them, and apart those where the range ends."""
    present = {row["group"] for row in parts}
    groups = [group for group in GROUPS if group in present][1:]
    lines = []
    for condition in dict.fromkeys(row["condition"] for row in parts):
        mine = {row["group"]: row for row in parts if row["condition"] == condition}
        every = mine["all"]
        wrong = sum(row["confident_wrong"] for name, row in mine.items() if name == "all" or name.startswith("beta"))
        held = (share(3)(mine[name]["covered"]) if name in mine else "" for name in groups)
        whole = (
            every["covered"].cases,
            share(3)(every["covered"]),
            band(3)(every["covered"]),
            number(3)(every["width"]),
        )
        lines.append((condition, *whole, *held, wrong))
    return Table(lines, ("noise", "cases", "held", "95 % band", "width", *groups, "confidently wrong"), title)


STUDY = Study(CoverageConfig, trials, report)
