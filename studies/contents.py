"""`python -m studies contents`: calibration of probabilities of contents by touch and vision, over time.

python -m studies contents
python -m studies contents --train 100 --trials 100 --jobs 16 --json contents.json

Each simulated carton is squeezed with each content once, in a room of its own temperature for five cartons. A
classifier is trained on the squeezes of the first seeds, one on each third of these. Each classifies those of the
others, whose cartons and rooms were not in its training.
"""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from deformscope.config import flags
from deformscope.experiments.squeeze.squeeze import feature_settings
from deformscope.files.squeeze_dataset import SqueezeDataset, TrialRow
from deformscope.lab.container_setup import container_lab
from deformscope.pictures.report import Table
from deformscope.results.render import to_json
from deformscope.stages.squeeze.model import fit_model
from deformscope.stages.squeeze.model_check import check_model
from deformscope.stages.squeeze.table import LabelledTable
from studies.reproduce.container_trials import SqueezeJob, run_squeeze
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

CONTENTS = ("empty", "water", "yogurt", "rice", "flour")
FIRST = 1000
"""Number of the first carton and of the first room, which no command draws."""
CARTONS = 5
"""That share a room."""


@dataclass(frozen=True, slots=True)
class ContentsConfig(StudyOptions):
    """Count the calibration of the probabilities of contents 0.2, 0.5 and 1 s after first contact and in the end, on
    squeezes of other cartons than those of the training. Each squeeze takes some 2 s of a core."""

    train: Annotated[int, flags.least(30)] = 300
    """Squeezes that the classifier is trained on, from seed SEED on."""
    trials: flags.ManyFlag = 300
    """New squeezes, of the seeds after these."""


def squeezed(seed: int) -> TrialRow:
    """The squeeze of a seed."""
    carton = seed // len(CONTENTS)
    content, room = CONTENTS[seed % len(CONTENTS)], FIRST + carton // CARTONS
    return run_squeeze(SqueezeJob(content, f"box-{FIRST + carton}", f"lab-{room}", seed, Path()))


def trials(options: ContentsConfig) -> list[Trials[int, TrialRow]]:
    """All squeezes."""
    seeds = reported(options.train + options.trials, options.output.seed)
    return [Trials("squeezes", squeezed, list(seeds))]


def table_of(rows: Sequence[TrialRow]) -> LabelledTable:
    """As a data set of these squeezes has it."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = SqueezeDataset(Path(folder), feature_settings(container_lab().setup))
        dataset.add(rows)
        return dataset.table()


def report(options: ContentsConfig, seconds: float, tried: Sequence[TrialRow]) -> StudyReport:
    """A row of each time, for each set of training squeezes."""
    new, lines, json = table_of(tried[options.train :]), [], {}
    third = options.train // 3
    for seeds in (*(range(at * third, (at + 1) * third) for at in range(3)), range(options.train)):
        named = f"{options.output.seed + seeds.start} to {options.output.seed + seeds.stop - 1}"
        model = fit_model(table_of(tried[seeds.start : seeds.stop]), by_group=True)
        times = check_model(model, new, seed=options.output.seed).times
        json[named] = [to_json(one) for one in times]
        for one in times:
            when = "end" if math.isnan(one.time_s) else f"{one.time_s:g} s"
            ranges = [
                f"{value:.3f} ({low:.3f} to {high:.3f})"
                for value, (low, high) in (
                    (one.score.accuracy.value, one.score.accuracy.interval),
                    (one.score.calibration_error, one.error_interval),
                    (one.debiased.value, one.debiased.interval),
                )
            ]
            lines.append((named, when, one.score.modality, *ranges, f"{one.by_chance:.3f}"))
    names = "trained on seeds", "after contact", "by", "accuracy", "calibration error", "without chance", "by chance"
    caption = f"{len(new)} squeezes of new cartons, 90 % intervals"
    return StudyReport([Table(lines, names, caption)], {"squeezes": len(new), "trained_on": json})


STUDY = Study(ContentsConfig, trials, report)
