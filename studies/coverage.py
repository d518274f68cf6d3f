"""`python -m studies coverage`: how often the intervals hold the truth, counted on random objects.

python -m studies coverage --quick
python -m studies coverage --objects 1000 --jobs 2 --out runs/coverage --json coverage.json
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any

from deformscope.cli.common import make_folder
from deformscope.cli.study import Study, StudyOptions, StudyReport, Trials
from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.pictures.report import Figure, Table
from deformscope.stages.fit.estimate import Verdict
from studies.doubt_rates import CODES, EXPECTED, Doubted, doubt_plan, doubt_rows, try_doubts
from studies.quantities import Rate, Row, band
from studies.random_bodies import (
    GROUPS,
    NOTHING,
    PART_APART,
    QUICK_OBJECTS,
    CoverageRow,
    Outcome,
    coverage_rows,
    plan,
    rank_counts,
    ranks_png,
    try_nothing,
    try_object,
)
from studies.unseen_pokes import PokeCase, UnseenPrediction, try_unseen_poke


@dataclass(frozen=True, slots=True)
class CoverageConfig(StudyOptions):
    """Count how often the intervals hold the truth: random objects under each kind of noise, data without information,
    and unseen pokes of finite element bodies."""

    objects: Annotated[int, flags.least(5)] = 1000
    """Random objects for each kind of noise; a fifth as many with beta = 0, near 1, of finite elements, and for each
    kind of data that are wrong."""
    quick: bool = False
    """15 objects each: what it looks like, in a minute."""
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
    if options.out is not None:
        make_folder(options.out)
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
    said = {
        kind: [verdict for case, verdict in zip(nothing, verdicts, strict=True) if case.kind == kind]
        for kind in NOTHING
    }
    unidentified = {kind: Rate(len(some), some.count("unidentified")) for kind, some in said.items()}
    ranks = rank_counts([one for one, case in zip(outcomes, cases, strict=True) if case.truth == "prior"])
    groups, doubts = prediction_groups(predictions), doubt_rows(doubted)
    fit_s = {f"{dim}D": median([one.seconds for one in outcomes if one.dim == dim]) for dim in (2, 3)}
    png, picture = ranks_png(ranks), None if options.out is None else options.out / "coverage.png"
    took = [(f"a fit in {dim}", f"{one:.2g} s") for dim, one in fit_s.items()] + [("all", f"{seconds:.0f} s")]
    lengths = {"width_m": "width", "error_m": "error", "motion_m": "motion"}
    return StudyReport(
        (
            coverage_table(f"{level:.0%} intervals for beta: how many hold the truth", lines),
            _nothing_table(said, unidentified),
            doubts_table(doubts),
            _pokes_table(f"{level:.0%}", groups),
            Table(took + ([] if picture is None else [("ranks", str(picture))]), caption="Time"),
        ),
        {
            "level": level,
            "seed": seed,
            "coverage": [
                {
                    "condition": row.condition,
                    "group": row.group,
                    **dataclasses.asdict(row.covered),
                    "width": row.width,
                    "confident_wrong": row.confident_wrong.hits,
                }
                for row in lines
            ],
            "ranks": ranks,
            "no_information": [{"kind": kind, **dataclasses.asdict(rate)} for kind, rate in unidentified.items()],
            "reasons": doubts,
            "unseen_pokes": [
                {"group": name, "pokes": len(some), **dataclasses.asdict(pooled(some))}
                | {key: middle(some, length) for key, length in lengths.items()}
                for name, some in groups.items()
            ],
            "fit_seconds": fit_s,
            "seconds": seconds,
            "picture": picture,
        },
        (Figure(png, "Ranks of the truths in their posteriors: level where the intervals are right"),),
        {picture: png},
    )


def prediction_groups(predictions: Sequence[UnseenPrediction]) -> dict[str, list[UnseenPrediction]]:
    """All, and by dimension and cluster size."""
    groups = {"all": list(predictions)}
    groups |= {f"{dim}D": [one for one in predictions if one.dim == dim] for dim in (2, 3)}
    groups |= {f"clusters of {s}": [one for one in predictions if one.cluster_size == s] for s in (2, 3, 4)}
    return {name: some for name, some in groups.items() if some}


def pooled(some: Sequence[UnseenPrediction]) -> Rate:
    return Rate(sum(one.coordinates for one in some), sum(one.covered for one in some))


def middle(some: Sequence[UnseenPrediction], length: str) -> float:
    """The median of a length [m]."""
    return float(median(getattr(one, length) for one in some))


# In tables -----------------------------------------------------------------------------------------------------------


def _nothing_table(said: Mapping[Any, list[Verdict]], unidentified: Mapping[Any, Rate]) -> Table:
    rows = []
    for kind, rate in unidentified.items():
        others = ", ".join(f"{said[kind].count(one)} {one}" for one in sorted(set(said[kind]) - {"unidentified"}))
        rows.append((kind, rate.cases, f"{rate.rate:.3f}", band(3)(rate), others))
    names = ("data", "cases", "unidentified", "95 % band", "other verdicts")
    return Table(rows, names, "Data without information: how many verdicts are unidentified")


def doubts_table(rows: Sequence[Row]) -> Table:
    """How often each reason was named, a line for each kind of data, the reason that is true of them marked."""
    codes = [code for code in CODES if any(code in row["named"] for row in rows)]
    lines = []
    for row in rows:
        cells = []
        for code in codes:
            share = f"{row['named'][code].rate:.2f}" if code in row["named"] else ""
            cells.append(f"{share or '0'} <- true" if EXPECTED.get(row["data"]) == code else share)
        wrong = f"{row['identified_wrong'].hits}"
        lines.append((row["data"], row["identified"].cases, *cells, f"{row['identified'].rate:.2f}", wrong))
    names = ("data", "cases", *codes, "identified", "of these without the truth")
    return Table(lines, names, "Reasons to doubt beta: how often each is named")


def _pokes_table(level: str, groups: Mapping[str, list[UnseenPrediction]]) -> Table:
    rows = []
    for name, some in groups.items():
        rate = pooled(some)
        lengths = (f"{1e3 * middle(some, one):.2f}" for one in ("width", "error", "motion"))
        rows.append((name, len(some), rate.cases, f"{rate.rate:.3f}", *lengths))
    names = ("bodies", "pokes", "coordinates", "within", "width [mm]", "error [mm]", "motion [mm]")
    caption = f"Finite element bodies: coordinates of an unseen poke within their {level} predictive intervals"
    return Table(rows, names, caption)


def coverage_table(title: str, rows: Sequence[CoverageRow]) -> Table:
    """A line a condition: all truths in between, parts of them, and apart those where the range ends."""
    present = {row.group for row in rows}
    groups = [group for group in GROUPS if group in present][1:]
    lines = []
    for condition in dict.fromkeys(row.condition for row in rows):
        mine = {row.group: row for row in rows if row.condition == condition}
        every = mine["all"]
        wrong = sum(row.confident_wrong.hits for name, row in mine.items() if name == "all" or name.startswith("beta"))
        held = (f"{mine[name].covered.rate:.3f}" if name in mine else "" for name in groups)
        whole = (every.covered.cases, f"{every.covered.rate:.3f}", band(3)(every.covered), f"{every.width:.3f}")
        lines.append((condition, *whole, *held, wrong))
    return Table(lines, ("noise", "cases", "held", "95 % band", "width", *groups, "confidently wrong"), title)


STUDY = Study(CoverageConfig, trials, report)
