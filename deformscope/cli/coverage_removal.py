"""`deformscope coverage removal`: how well the robot is taken out of the camera's picture, on simulated ones.

deformscope coverage removal
deformscope coverage removal --layouts 4 --picture removal.png --json removal.json
"""

from __future__ import annotations

from collections.abc import Sequence

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_file, write_json
from deformscope.config import RemovalCoverageConfig
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Figure, Table
from deformscope.session import Step
from deformscope.studies.removal import DOUBT_M, NOISE_PER_M, REMOVALS, RemovalRow, Where, removal_rows, try_removals
from deformscope.studies.removal_figure import removal_png
from deformscope.studies.seeds import reported

TITLES: dict[Where, str] = {
    "sample": "In the sample's box, as explorations crop it: foam kept (worst picture) / robot left (worst picture)",
    "around a touch": "Within 8 cm of the tip while it presses: foam kept (worst picture) / robot left (worst picture)",
}
ABOUT = {
    "nothing": "exact",
    "surface": "5 mm, 1 deg about the surface",
    "camera": "5 mm, 1 deg about the camera",
}


def run(config: RemovalCoverageConfig) -> None:
    """Take the robot out of all pictures, and print a table for each box."""
    quiet_warp()
    seeds = reported(config.layouts, config.output.seed)
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            counts = [one for some in examined("robots", try_removals, seeds, config.jobs, note) for one in some]
        rows = removal_rows(counts)
        tables = [removal_table(where, rows) for where in TITLES]
        png = removal_png(seeds[0])
        found = Findings((*tables, time_table(rows)), (Figure(png, "Taken for the robot, by how it is taken out"),))
        show(found)
        recorder.write(Step((found,)))
    write_file(config.picture, png)
    write_json({"layouts": config.layouts, "doubt_m": DOUBT_M, "rows": rows}, config.output.json)


def removal_table(where: Where, rows: Sequence[RemovalRow]) -> Table:
    """A line for each sensor and error, a column for each way."""
    by = {(row.sensor, row.about, row.removal): row for row in rows if row.where == where}
    lines = []
    for sensor in NOISE_PER_M:
        for about, words in ABOUT.items():
            some = [by[sensor, about, removal] for removal in REMOVALS]  # type: ignore[index]
            points, outliers = some[0].robot_points // some[0].pictures, f"{some[-1].foam_outliers:.2%}"
            lines.append((sensor, words, points, *map(_shares, some), outliers))
    return Table(lines, ("camera", "its place is off by", "robot points", *REMOVALS, "then outliers"), TITLES[where])


def _shares(row: RemovalRow) -> str:
    kept = f"{row.foam_kept:.2%} ({row.foam_kept_worst:.2%})"
    return f"{kept} / {row.robot_left:.2%} ({row.robot_left_worst:.2%})"


def time_table(rows: Sequence[RemovalRow]) -> Table:
    """What a picture of 640 by 480 takes."""
    lines = []
    for removal in REMOVALS:
        lines.append((removal, *(f"{1e3 * _median_s(rows, where, removal):.0f}" for where in TITLES)))
    return Table(lines, ("removal", *TITLES), "Time of a picture of 640 by 480 pixels on one core [ms]")


def _median_s(rows: Sequence[RemovalRow], where: Where, removal: str) -> float:
    some = sorted(row.seconds for row in rows if row.where == where and row.removal == removal)
    return some[len(some) // 2]
