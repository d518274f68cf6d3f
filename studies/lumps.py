"""`python -m studies lumps`: how many lumps `explore --goal inclusions` finds within how many touches, how often it
finds one where there is none, and whether what it says of missed ones is right.

python -m studies lumps --objects 40 --json lumps.json
python -m studies lumps --foam 110 --lump rigid --errors
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Annotated

from tyro.conf import OmitArgPrefixes, arg

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_json
from deformscope.cli.study import Study
from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.lab.scenes import built_in
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from studies.coverage import rate_json
from studies.lump_search import FoamRow, LumpCase, LumpRow, details, foam_rows, lump_rows, seek
from studies.seeds import reported


@dataclass(frozen=True, slots=True)
class LumpCoverageConfig(RecordedOptions):
    """Count how many lumps `explore --goal inclusions` finds within how many touches, how often it finds one where
    there is none, and whether what it says of missed ones is right: fields of 20 by 20 cm of finite elements, with a
    lump of 2 cm radius 1 to 2 cm deep and without."""

    objects: flags.ManyFlag = 40
    """Fields with a lump, and as many without, from seed SEED on; each takes some 25 s."""
    touches: flags.ManyFlag = 30
    """Touches at most."""
    foam: Annotated[str, arg(metavar="N")] = "60"
    """Hardness of the foam [N]."""
    lump: Annotated[str, arg(metavar="N|rigid")] = "600"
    """Hardness of the lump [N]."""
    smallest_lump_cm: Annotated[float, arg(metavar="CM")] = 2.0
    """Radius of the smallest lump that must not be missed [cm]."""
    set_force: Annotated[float, arg(metavar="N")] = 5.0
    """Force to press with [N]."""
    errors: bool = False
    """With all errors of the laboratory, foam that scatters among them; else nothing is kept from the estimator."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


def run(config: LumpCoverageConfig) -> None:
    """Seek in all fields, and print the tables."""
    quiet_warp()
    seeds = reported(config.objects, config.output.seed)
    scenes = f"buried-{config.foam}-{config.lump}", f"empty-{config.foam}"
    for scene in scenes:
        built_in(scene)
    smallest_m = 0.01 * config.smallest_lump_cm
    cases = [
        LumpCase(scene, seed, config.touches, not config.errors, smallest_m, config.set_force)
        for seed in seeds
        for scene in scenes
    ]
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            outcomes = examined("fields", seek, cases, config.jobs, note)
        rows, foams, counted = lump_rows(outcomes), foam_rows(outcomes), details(outcomes)
        title = f"{len(seeds)} fields with a lump and {len(seeds)} without, seeds {seeds.start} to {seeds.stop - 1}"
        tables = [_table(rows, title), *([_foam_table(foams)] if foams else [])]
        found = Findings((*tables, Table(list(_words(counted).items()), caption="Of those that were found")))
        show(found)
        recorder.write(Step((found,)))
    write_json(
        {
            "seeds": [seeds.start, seeds.stop - 1],
            "rows": [
                {
                    "touches": row.touches,
                    "found": rate_json(row.found),
                    "alarms": rate_json(row.alarms),
                    "missed_said": row.said,
                    "missed": rate_json(row.missed),
                }
                for row in rows
            ],
            "foams": [
                {
                    "scatter": row.scatter,
                    "found": rate_json(row.found),
                    "alarms": rate_json(row.alarms),
                    "limit": row.limit,
                }
                for row in foams
            ],
            "details": counted,
            "searches": [dataclasses.asdict(one) for one in outcomes],
        },
        config.output.json,
    )


def _table(rows: list[LumpRow], title: str) -> Table:
    lines = []
    for row in rows:
        found, alarms = row.found, row.alarms
        low, high = found.band
        lines.append(
            (
                row.touches,
                f"{found.hits} of {found.cases}",
                f"{low:.2f} to {high:.2f}",
                f"{alarms.hits} of {alarms.cases}",
                f"{row.said:.3f}",
                f"{row.missed.rate:.3f} ({row.missed.hits} of {row.missed.cases})",
            )
        )
    names = ("touches", "found", "95 % band", "false alarms", "said to be missed", "missed, of all fields")
    return Table(lines, names, title)


def _foam_table(rows: list[FoamRow]) -> Table:
    lines = [
        (
            f"{100.0 * row.scatter[0]:g} to {100.0 * row.scatter[1]:g} %",
            f"{row.found.hits} of {row.found.cases}",
            f"{row.limit:.2f}",
            f"{row.alarms.hits} of {row.alarms.cases}",
        )
        for row in rows
    ]
    names = ("foam scatters by", "found", "could be found at all", "false alarms")
    return Table(lines, names, "By the scatter of the foam, after all touches")


def _words(counted: dict[str, float]) -> dict[str, str]:
    return {
        "touches until found, median": f"{counted['touches_to_find']:.3g}, at most {counted['most_to_find']:.3g}",
        "touches made": f"{counted['touches_with']:.3g} with a lump, {counted['touches_without']:.3g} without (means)",
        "middle off, median": f"{1e3 * counted['off_m']:.1f} mm",
        "middle within what was said (90 %)": f"{counted['within']:.2f}",
        "radius within its interval (90 %)": f"{counted['radius_held']:.2f}",
        "radius off, rms": f"{1e3 * counted['radius_off_m']:.1f} mm",
        "depth told": f"in {counted['depth_told']:.2f}, right in {counted['depth_right']:.2f} of these",
    }


STUDY = Study(LumpCoverageConfig, run)
