"""`python -m studies beta`: beta where errors are shared, tracks wrong or lost.

python -m studies beta --jobs 8 --json coverage-beta.json
python -m studies beta --only "outliers,lost tracks" --objects 100
"""

from __future__ import annotations

import dataclasses
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
from deformscope.stages.fit.estimate import Parameter
from studies.coverage import rate_json
from studies.disturbed import DISTURBED, DisturbedCase, DisturbedRow, disturbed_rows, try_disturbed
from studies.random_bodies import Rate
from studies.theta_settings import SETTINGS, try_setting


@dataclass(frozen=True, slots=True)
class DisturbedCoverageConfig(RecordedOptions):
    """Count how often the intervals hold the truth where data are not as assumed: errors that neighbours share over 1
    to 6 cells, with and without white noise, outliers, lost tracks, a held particle that is off, whole motions."""

    objects: Annotated[int, flags.least(3)] = 400
    """Random objects for each kind of error, a third of them in space; each takes some .3 s of a core."""
    only: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """These kinds alone, such as "30 % outliers,30 % lost tracks"; parts of their names do."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


def beta(config: DisturbedCoverageConfig) -> None:
    """Of beta."""
    _run(config, "beta")


def theta(config: DisturbedCoverageConfig) -> None:
    """Of theta."""
    _run(config, "theta")


def _run(config: DisturbedCoverageConfig, parameter: Parameter) -> None:
    quiet_warp()
    started, seed, level = time.monotonic(), config.output.seed, config.level
    settings = SETTINGS if parameter == "theta" else ()
    names = names_of(config.only, (*DISTURBED, *settings))
    cases = [DisturbedCase(name, number, seed, parameter, level) for name in names for number in range(config.objects)]
    disturbed, at_settings = ([one for one in cases if (one.name in settings) is kind] for kind in (False, True))
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            rows = disturbed_rows(examined("random objects", try_disturbed, disturbed, config.jobs, note))
            others = disturbed_rows(examined("cubes at two settings", try_setting, at_settings, config.jobs, note))
        tables = [disturbed_table(f"{level:.0%} intervals for {parameter}", rows)] if rows else []
        if others:
            tables.append(settings_table(f"{level:.0%} intervals that hold the theta found at another setting", others))
        found = Findings(tuple(tables))
        show(found)
        recorder.write(Step((found,)))
    write_json(
        {
            "parameter": parameter,
            "level": level,
            "seed": seed,
            "disturbances": [row_json(row) | {"errors": dataclasses.asdict(DISTURBED[row.name])} for row in rows],
            **({"settings": [row_json(row) for row in others]} if settings else {}),
            "seconds": time.monotonic() - started,
        },
        config.output.json,
    )


def names_of(only: str, every: Sequence[str]) -> list[str]:
    """Those whose names contain one of some parts, parted by commas; all for none."""
    parts = [part.strip() for part in only.split(",") if part.strip()]
    names = [name for name in every if not parts or any(part in name for part in parts)]
    if not names:
        raise InputError(f"parts of {'; '.join(every)}", only)
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
        "reasons": {code: rate_json(rate) for code, rate in row.reasons.items()},
        "fit_seconds": row.seconds,
    }


def disturbed_table(title: str, rows: Sequence[DisturbedRow]) -> Table:
    """A line for each disturbance."""
    lines = [
        (
            *_held(row),
            *(_rate(row.by_dim[dim]) for dim in (2, 3)),
            f"{row.width:.3f}",
            _rate(row.identified),
            _rate(row.unidentified),
            row.wrong.hits,
            _rate(row.caught),
            f"{row.alarms.rate:.4f}",
            reasons_text(row),
        )
        for row in rows
    ]
    names: tuple[str, ...] = ("errors", "cases", "held", "95 % band", "2D", "3D", "width", "identified", "unidentified")
    names += ("identified without the truth", "wrong ones left out", "right ones left out", "reasons")
    return Table(lines, names, title)


def settings_table(title: str, rows: Sequence[DisturbedRow]) -> Table:
    """A line for each way in which two fits of a cube differ."""
    lines = [
        (
            *_held(row),
            f"{row.width:.3f}",
            f"{row.rms:.3f}",
            _rate(row.identified),
            row.wrong.hits,
            reasons_text(row),
        )
        for row in rows
    ]
    names = ("the other fit has", "cases", "held", "95 % band", "width", "rms difference", "identified")
    return Table(lines, (*names, "identified without the other", "reasons"), title)


def reasons_text(row: DisturbedRow) -> str:
    """How often each reason was named."""
    return ", ".join(f"{code} {rate.rate:.2f}" for code, rate in row.reasons.items())


def _held(row: DisturbedRow) -> tuple[object, ...]:
    """Name, cases, and how often the intervals held."""
    held = row.covered
    return row.name, held.cases, f"{held.rate:.3f}", "{:.3f} to {:.3f}".format(*held.band)


def _rate(rate: Rate) -> str:
    return f"{rate.rate:.2f}" if rate.cases else ""


STUDY = Study(DisturbedCoverageConfig, beta)
