"""`python -m studies removal`: how well the robot is taken out of the camera's picture, on simulated ones.

python -m studies removal
python -m studies removal --layouts 4 --picture removal.png --json removal.json
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from tyro.conf import OmitArgPrefixes

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_file, write_json
from deformscope.cli.study import Study
from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Figure, Table
from deformscope.session import Step
from studies.removal_figure import removal_png
from studies.robot_pictures import DOUBT_M, NOISE_PER_M, REMOVALS, RemovalRow, Where, removal_rows, try_removals
from studies.seeds import reported


@dataclass(frozen=True, slots=True)
class RemovalCoverageConfig(RecordedOptions):
    """Count which points of simulated pictures stay, of foam and of a robot with gripper, stick and cable, by how the
    robot is taken out: capsules, convex hulls (Thesis 4.4) or meshes; with the camera's place exact, and off by 5 mm
    and 1 degree."""

    layouts: flags.ManyFlag = 6
    """Robots, from seed SEED on; of each, six pictures. One takes some 30 s of a core."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    picture: flags.PictureFlag = None
    """Draw what was removed of the first robot's pictures to a PNG."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


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


STUDY = Study(RemovalCoverageConfig, run)
