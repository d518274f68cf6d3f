"""`python -m studies regions`: how often a map's levels and its number of regions are right, on known surfaces.

python -m studies regions --objects 300 --jobs 8 --json -
python -m studies regions --objects 50 --scatter 0.08 --only "scatter 8 %"
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from tyro.conf import OmitArgPrefixes, arg

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_json
from deformscope.cli.study import Study
from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.errors import InputError
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from studies import region_coverage
from studies.coverage import rate_json
from studies.random_bodies import Rate
from studies.region_coverage import (
    RegionCase,
    RegionCondition,
    RegionRow,
    ReliabilityBin,
    explore_known,
    region_rows,
    reliability,
    scattered,
)
from studies.seeds import reported


@dataclass(frozen=True, slots=True)
class RegionCoverageConfig(RecordedOptions):
    """Count how often a map's levels lie in their intervals, and its number of regions is right: surfaces of known
    truth, drawn from the stated prior and from violations of it, touched in closed form and explored as `explore`
    does."""

    objects: Annotated[int, flags.least(5)] = 300
    """Explorations of each condition; each takes some 5 s of a core."""
    scatter: Annotated[float | None, arg(metavar="SHARE")] = None
    """One more condition: foam whose log stiffness scatters by this, such as 0.08."""
    only: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """These conditions alone, such as "stated prior,scatter 6 %"."""
    touches: flags.ManyFlag = 8
    """Touches of each exploration at most."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.scatter is not None and not 0.0 < self.scatter < 1.0:
            raise InputError("a share above 0 and below 1 after --scatter", f"{self.scatter:g}", "0.08")


def run(config: RegionCoverageConfig) -> None:
    """Explore all of them, and print the tables."""
    quiet_warp()
    started = time.monotonic()
    seeds = reported(config.objects, config.output.seed)
    conditions = _conditions(config)
    cases = [RegionCase(condition, seed, config.touches) for seed in seeds for condition in conditions]
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            outcomes = examined("explorations", explore_known, cases, config.jobs, note)
        outcomes.sort(key=lambda one: [condition.name for condition in conditions].index(one.condition))
        rows = region_rows(outcomes)
        bins = {row.condition: reliability([one for one in outcomes if one.condition == row.condition]) for row in rows}
        seconds = time.monotonic() - started
        found = Findings((_levels_table(rows), _bins_table(bins), Table([("all", f"{seconds:.0f} s")], caption="Time")))
        show(found)
        recorder.write(Step((found,)))
    write_json(
        {
            "seeds": [seeds.start, seeds.stop - 1],
            "touches": config.touches,
            "conditions": [
                {
                    "condition": row.condition,
                    "truth": condition.truth,
                    "objects": row.objects,
                    "levels": rate_json(Rate(row.levels, row.covered)),
                    "level_width": row.width,
                    "number_right": rate_json(Rate(row.objects, row.right)),
                    "number_claimed": row.claimed,
                    "wrong_share": row.wrong,
                    "wrong_share_claimed": row.wrong_claimed,
                    "scatter_learned": row.scatter,
                    "touches": row.touches,
                    "reliability": [
                        {"cases": one.cases, "claimed": one.claimed, "right": one.right, "band": list(one.band)}
                        | {"holds": one.holds}
                        for one in bins[row.condition]
                    ],
                }
                for row, condition in zip(rows, conditions, strict=True)
            ],
            "explorations": outcomes,
            "seconds": seconds,
        },
        config.output.json,
    )


def _conditions(config: RegionCoverageConfig) -> list[RegionCondition]:
    every = list(region_coverage.REGION_CONDITIONS)
    if config.scatter is not None and scattered(config.scatter) not in every:
        every.append(scattered(config.scatter))
    named = [name.strip() for name in config.only.split(",") if name.strip()]
    known = [one.name for one in every]
    if unknown := [name for name in named if name not in known]:
        raise InputError(f"conditions out of {', '.join(known)}", ", ".join(map(repr, unknown)), "leave --only out")
    return [one for one in every if one.name in named] if named else every


def _levels_table(rows: Sequence[RegionRow]) -> Table:
    lines = []
    for row in rows:
        covered, right = Rate(row.levels, row.covered), Rate(row.objects, row.right)
        low, high = covered.band
        lines.append(
            (
                row.condition,
                row.objects,
                row.levels,
                f"{covered.rate:.3f}",
                f"{low:.3f} to {high:.3f}",
                f"{row.width:.3f}",
                f"{right.rate:.2f}",
                f"{row.claimed:.2f}",
                f"{row.wrong:.3f}",
                f"{row.wrong_claimed:.3f}",
                f"{row.touches:.1f}",
            )
        )
    names = ("truths", "explored", "levels", "held", "95 % band", "width")
    numbers = ("number right", "claimed", "wrong share", "claimed share", "touches")
    return Table(lines, (*names, *numbers), "Levels in 90 % intervals where the number is right, and that number")


def _bins_table(bins: dict[str, list[ReliabilityBin]]) -> Table:
    lines = [
        (
            *(name, one.cases, f"{one.claimed:.3f}", f"{one.right / one.cases:.3f}"),
            *(f"{one.band[0]:.3f} to {one.band[1]:.3f}", "yes" if one.holds else "no"),
        )
        for name, some in bins.items()
        for one in some
    ]
    names = ("truths", "explored", "claimed", "right", "90 % band", "holds the claim")
    return Table(lines, names, "Probability of the number of regions, in bins of as many explorations")


STUDY = Study(RegionCoverageConfig, run)
