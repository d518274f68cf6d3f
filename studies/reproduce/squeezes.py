"""`python -m studies reproduce squeezes`: new squeezes compared with the simulated truth: events, poses, depth.

python -m studies reproduce squeezes --out runs/squeezes
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from deformscope.config import flags
from deformscope.files.squeeze_dataset import TrialRow
from deformscope.pictures.report import Figure, Table
from studies.reproduce.container_trials import SqueezeJob, dataset_of, squeeze_jobs
from studies.reproduce.squeeze_truth import Numbers, squeeze_errors, truth_rows
from studies.reproduce.squeeze_truth_figure import truth_png
from studies.runner import Study, StudyOptions, StudyReport, Trials


@dataclass(frozen=True, slots=True)
class SqueezesConfig(StudyOptions):
    """Squeeze containers of the laboratory that `reproduce containers` does not have, and compare events, tracked poses
    and changes of depth with the simulated truth."""

    out: flags.Folder = Path("runs/squeezes")
    """Folder of the data set (squeezes/) and of the figure; made if missing."""
    trials: Annotated[int, flags.least(1)] = 300
    """Squeezes of cardboard boxes, in the thesis's proportions."""
    cylinders: Annotated[int, flags.least(0)] = 0
    """Additional squeezes of plastic cylinders."""


def trials(options: SqueezesConfig) -> list[Trials[SqueezeJob, tuple[TrialRow, Numbers]]]:
    """Squeezes with containers, sessions and seeds of their own."""
    jobs = squeeze_jobs(options.out, options.trials, options.cylinders, 0, options.output.seed, new=True)
    return [Trials("squeezes", squeeze_errors, jobs)]


def report(options: SqueezesConfig, seconds: float, tried: Sequence[tuple[TrialRow, Numbers]]) -> StudyReport:
    """Statistics of all, and the data set."""
    dataset_of(options.out, [row for row, _ in tried])
    every = [numbers for _, numbers in tried]
    png, rows = truth_png(every), truth_rows(every)
    caption = "Squeezes of the laboratory compared with the simulated truth"
    json = {"summary": dict(rows), "squeezes": every}
    return StudyReport(
        [Table(rows, caption=caption)], json, [Figure(png, caption)], {options.out / "squeezes.png": png}
    )


STUDY = Study(SqueezesConfig, trials, report)
