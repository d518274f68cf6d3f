"""`python -m studies contents`: calibration of probabilities of contents by touch and vision, over time.

python -m studies contents
python -m studies contents --train 100 --trials 100 --jobs 16 --json contents.json

Each simulated carton is squeezed with each content once, in a room of its own temperature for five cartons. A
classifier is trained on the squeezes of the first seeds, one on each third of these. Each classifies those of the
others, whose cartons and rooms were not in its training.
"""

import dataclasses
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import scipy

from deformscope.arrays import FloatArray, IntArray
from deformscope.config import flags
from deformscope.experiments.squeeze.placing import feature_settings
from deformscope.files.squeeze_dataset import SqueezeDataset, TrialRow
from deformscope.lab.container_setup import container_lab
from deformscope.pictures.report import Table
from deformscope.results.render import reported as stated
from deformscope.results.render import to_json
from deformscope.stages.squeeze.evaluation import held_values
from deformscope.stages.squeeze.model import ContentModel, fit_model
from deformscope.stages.squeeze.scores import BINS, ClassificationScore, Estimated, Interval, score_of
from deformscope.stages.squeeze.table import LabelledTable, Split, absent
from deformscope.stages.squeeze.trial_run import Key, answers_of, joined_name
from studies.reproduce.container_trials import SqueezeJob, run_squeeze
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

CONTENTS = ("empty", "water", "yogurt", "rice", "flour")
FIRST = 1000
"""Number of the first carton and of the first room, which no command draws."""
CARTONS = 5
"""That share a room."""
LEVEL = 0.9
DRAWS = 4000
"""Perfectly calibrated classifiers that are drawn: a share of 0.1 is then known within 0.01."""
TIMES_S = (0.2, 0.5, 1.0)
"""Times since first contact at which a model's posteriors are evaluated."""


@dataclass(frozen=True, slots=True)
class ContentsConfig(StudyOptions):
    """Count the calibration of the probabilities of contents 0.2, 0.5 and 1 s after first contact and in the end, on
    squeezes of other cartons than those of the training. Each squeeze takes some 2 s of a core."""

    train: Annotated[int, flags.least(30)] = 300
    """Squeezes that the classifier is trained on, from seed SEED on."""
    trials: flags.ManyFlag = 300
    """New squeezes, of the seeds after these."""


@dataclass(frozen=True, slots=True)
class TimeCheck:
    """A model's posterior at this time after first contact, of the modalities of `score`; time_s: NaN = in the end, of
    all that are fused; error_interval: interval of the calibration error, by bootstrap over trials; by_chance: mean
    error of a perfectly calibrated model with the same posteriors, as its bins hold few trials
    debiased: root mean square error over the bins, without the contribution of chance to its square (Kumar, Liang and
    Ma 2019); with many trials it is not below the mean error"""

    time_s: float = field(metadata=stated(json=lambda time_s: None if math.isnan(time_s) else time_s))
    score: ClassificationScore = field(metadata=stated(flat=True))
    error_interval: Interval = field(metadata=stated(key="calibration_interval"))
    by_chance: float = field(metadata=stated(key="calibration_by_chance"))
    debiased: Estimated = field(
        metadata=stated(key="calibration_debiased", interval_key="calibration_debiased_interval")
    )


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


def _during(model: ContentModel, table: LabelledTable, level: float, seed: int) -> Iterator[TimeCheck]:
    """At `TIMES_S`, of the trials in which there is touch then, and in the end, of all."""
    held = {name: held_values(values) for name, values in table.series.items() if name in model.steps}
    for time_s in TIMES_S if "tactile" in held and table.step_s == model.step_s else ():
        step = round(time_s / model.step_s)
        now = {name: values[:, min(step, values.shape[1] - 1)] for name, values in held.items()}
        rows = np.flatnonzero(~absent(now["tactile"]))
        names, posterior = model.predict_at(time_s, {name: values[rows] for name, values in now.items()})
        yield _time_check(time_s, _score(table, posterior, rows, names, level), posterior, table.target[rows], seed)
    posterior = model.predict_proba({name: table.modalities[name] for name in model.modalities})
    score = _score(table, posterior, np.arange(len(table)), tuple(model.modalities), level)
    yield _time_check(math.nan, score, posterior, table.target, seed)


def _score(
    table: LabelledTable, posterior: FloatArray, rows: IntArray, names: tuple[str, ...], level: float
) -> ClassificationScore:
    """Of trials at rows (n,) that one model named once each by a posterior (n, classes) of these modalities; the table
    has the contents that the model has."""
    target = table.target[rows]
    answers = answers_of(rows, np.log(posterior), target, 0)
    key: Key = joined_name(names), "late-fusion" if len(names) > 1 else "pooled"
    score = score_of(table, key, "transfer", [Split(rows, rows)], [answers], level)
    over = score.overconfidence.value
    scatter = (answers.sure - (answers.answer == target)).std() / np.sqrt(len(rows))
    half = float(scipy.stats.norm.ppf(0.5 + level / 2) * np.hypot(scatter, 1.0 / score.worth))
    return dataclasses.replace(score, overconfidence=Estimated(over, (over - half, over + half)))


def _time_check(
    time_s: float, score: ClassificationScore, posterior: FloatArray, target: IntArray, seed: int
) -> TimeCheck:
    """With the calibration errors of a posterior (n, classes); few trials err upwards by chance. target: (n,)"""
    right, size = posterior.argmax(axis=1) == target, len(target)
    sure, random = posterior.max(axis=1), np.random.default_rng([seed, 0xEC])
    place = np.minimum((sure * BINS).astype(int), BINS - 1)

    def errors(of: IntArray) -> tuple[float, float]:
        """The mean error of these trials, and the square of the debiased one."""
        count = np.bincount(place[of], minlength=BINS)
        off, hit = (np.bincount(place[of], values[of], BINS) for values in (sure - right, right))
        several = count > 1
        count, share = count[several], hit[several] / count[several]
        square = (off[several] / count) ** 2 - share * (1.0 - share) / (count - 1)
        return float(np.abs(off).sum()) / size, float(count @ square) / size

    drawn = np.array([errors(random.integers(size, size=size)) for _ in range(DRAWS)])
    low, high = np.quantile(drawn[:, 0], [0.5 - score.level / 2, 0.5 + score.level / 2])
    perfect = [np.bincount(place, sure - (random.random(size) < sure), BINS) for _ in range(DRAWS)]
    found, half = errors(np.arange(size))[1], scipy.stats.norm.ppf(0.5 + score.level / 2) * drawn[:, 1].std()
    root, least, most = np.sqrt(np.maximum([found, found - half, found + half], 0.0)).tolist()
    return TimeCheck(
        time_s,
        score,
        error_interval=(float(low), float(high)),
        by_chance=float(np.abs(perfect).sum(axis=1).mean()) / size,
        debiased=Estimated(root, (least, most)),
    )


def report(options: ContentsConfig, seconds: float, tried: Sequence[TrialRow]) -> StudyReport:
    """A row of each time, for each set of training squeezes."""
    new, lines, json = table_of(tried[options.train :]), [], {}
    third = options.train // 3
    for seeds in (*(range(at * third, (at + 1) * third) for at in range(3)), range(options.train)):
        named = f"{options.output.seed + seeds.start} to {options.output.seed + seeds.stop - 1}"
        model = fit_model(table_of(tried[seeds.start : seeds.stop]), by_group=True)
        times = list(_during(model, new, LEVEL, options.output.seed))
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
