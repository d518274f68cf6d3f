"""`deformscope coverage beta` and `coverage theta`: intervals where data are not as assumed.

deformscope coverage beta --jobs 8 --json coverage-beta.json
deformscope coverage beta --only "outliers,lost tracks" --objects 100
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_json
from deformscope.cli.coverage import rate_json
from deformscope.config import DisturbedCoverageConfig
from deformscope.errors import InputError
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from deformscope.stages.fit.estimate import Parameter
from deformscope.studies.coverage import Rate
from deformscope.studies.disturbed import DISTURBED, DisturbedCase, DisturbedRow, disturbed_rows, try_disturbed


def beta(config: DisturbedCoverageConfig) -> None:
    """`coverage beta`."""
    _run(config, "beta")


def theta(config: DisturbedCoverageConfig) -> None:
    """`coverage theta`."""
    _run(config, "theta")


def _run(config: DisturbedCoverageConfig, parameter: Parameter) -> None:
    quiet_warp()
    started, seed, level = time.monotonic(), config.output.seed, config.level
    names = names_of(config.only)
    cases = [DisturbedCase(name, number, seed, parameter, level) for name in names for number in range(config.objects)]
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            rows = disturbed_rows(examined("random objects", try_disturbed, cases, config.jobs, note))
        found = Findings((disturbed_table(f"{level:.0%} intervals for {parameter}", rows),))
        show(found)
        recorder.write(Step((found,)))
    write_json(
        {
            "parameter": parameter,
            "level": level,
            "seed": seed,
            "disturbances": [row_json(row) for row in rows],
            "seconds": time.monotonic() - started,
        },
        config.output.json,
    )


def names_of(only: str) -> list[str]:
    """The disturbances whose names contain one of some parts, parted by commas; all for none."""
    parts = [part.strip() for part in only.split(",") if part.strip()]
    names = [name for name in DISTURBED if not parts or any(part in name for part in parts)]
    if not names:
        raise InputError(f"parts of {'; '.join(DISTURBED)}", only)
    return names


def row_json(row: DisturbedRow) -> dict[str, object]:
    rates = ("covered", "identified", "unidentified", "wrong", "caught", "alarms")
    return {
        "condition": row.name,
        **{name: rate_json(getattr(row, name)) for name in rates},
        "covered_2d": rate_json(row.by_dim[2]),
        "covered_3d": rate_json(row.by_dim[3]),
        "width": row.width,
        "rms": row.rms,
        "verdicts": row.verdicts,
        "fit_seconds": row.seconds,
    } | {"errors": dataclasses.asdict(DISTURBED[row.name])}


def disturbed_table(title: str, rows: Sequence[DisturbedRow]) -> Table:
    """A line for each disturbance."""
    lines = [
        (
            row.name,
            row.covered.cases,
            f"{row.covered.rate:.3f}",
            "{:.3f} to {:.3f}".format(*row.covered.band),
            *(_rate(row.by_dim[dim]) for dim in (2, 3)),
            f"{row.width:.3f}",
            _rate(row.identified),
            _rate(row.unidentified),
            row.wrong.hits,
            _rate(row.caught),
            f"{row.alarms.rate:.4f}",
        )
        for row in rows
    ]
    names: tuple[str, ...] = ("errors", "cases", "held", "95 % band", "2D", "3D", "width", "identified", "unidentified")
    names += ("identified without the truth", "wrong tracks left out", "right ones left out")
    return Table(lines, names, title)


def _rate(rate: Rate) -> str:
    return f"{rate.rate:.2f}" if rate.cases else ""
