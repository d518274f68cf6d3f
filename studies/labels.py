"""`python -m studies labels`: how often intervals of `classify` hold the accuracy in new groups, and how wide they are.

python -m studies labels --trials 200 --json labels.json

The trials are of a generator that shares no code with the program (`studies/independent/labelled_rows.py`). The truth
is that of the classifier that `classify --save` writes, on 800 trials of 160 new containers, or on all other groups of
scikit-learn's tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.config import flags
from deformscope.pictures.report import Table
from deformscope.runs.classification_report import ClassificationResult
from deformscope.stages.squeeze.evaluation import EvaluationOptions, evaluate
from deformscope.stages.squeeze.scores import wilson
from deformscope.stages.squeeze.table import LabelledTable
from studies.independent.labelled_rows import CASES, Case, rows_of
from studies.map_score import Z_90
from studies.runner import Study, StudyOptions, StudyReport, Trials

FIRST_SEED = 2000
SPLITS = 12


@dataclass(frozen=True, slots=True)
class LabelsConfig(StudyOptions):
    """Count the intervals of `classify` on tables with groups, without groups, with copies, and on scikit-learn's. A
    table takes some 2 s of a core."""

    trials: flags.ManyFlag = 200
    """Tables of each case, from seed 2000 + SEED on."""


@dataclass(frozen=True, slots=True)
class Counted:
    """Numbers of one table. told, truth: accuracy; first: the first interval of the output; second: that of `best`;
    noted: whether copies were found"""

    case: Case
    told: float
    truth: float
    first: tuple[float, float]
    second: tuple[float, float]
    noted: bool


def count(job: tuple[Case, int]) -> Counted:
    """One table of a case and seed."""
    case, seed = job
    rows = rows_of(case, seed)
    group = None if case.startswith("untold") else rows.container.astype(np.str_)
    table = LabelledTable(rows.label.astype(np.str_), group, {"touch": rows.features})
    found = evaluate(table, EvaluationOptions(SPLITS, 0))
    label, features = rows.new()
    posterior = ClassificationResult(found).model().predict_proba({"touch": features})
    truth = float((posterior.argmax(axis=1) == label).mean())
    best = found.best.accuracy
    return Counted(case, best.value, truth, found.elsewhere(found.trusted), best.interval, bool(found.copies))


def trials(options: LabelsConfig) -> list[Trials[tuple[Case, int], Counted]]:
    """Tables of every case."""
    first = FIRST_SEED + options.output.seed
    return [Trials(case, count, [(case, first + at) for at in range(options.trials)]) for case in CASES]


def report(options: LabelsConfig, seconds: float, *tried: Sequence[Counted]) -> StudyReport:
    """A row a case."""
    lines, json = [], {}
    for case, mine in zip(CASES, tried, strict=True):
        first, second = (
            [low <= one.truth <= high for one in mine for low, high in [getattr(one, name)]]
            for name in ("first", "second")
        )
        shares = {"first": float(np.mean(first)), "second": float(np.mean(second))}
        told, truth = (float(np.mean([getattr(one, name) for one in mine])) for name in ("told", "truth"))
        noted = float(np.mean([one.noted for one in mine]))
        json[case] = {"told": told, "truth": truth, "noted": noted, "n": len(mine), **shares}
        held = ["{:.2f} ({:.2f} to {:.2f})".format(one, *wilson(one, len(mine), 0.95)) for one in shares.values()]
        width = float(np.mean([np.diff(one.second) for one in mine]))
        rms = float(np.sqrt(np.mean([(one.told - one.truth) ** 2 for one in mine])))
        json[case] |= {"width": width, "rms": rms}
        wide = f"{width:.2f}, {rms:.3f}, {width / (2.0 * Z_90 * max(rms, 1e-9)):.2f}"
        lines.append((case, str(len(mine)), f"{told:.2f}", f"{truth:.2f}", *held, f"{noted:.2f}", wide))
    names = (
        *("case", "tables", "told", "true", "first interval holds", "that of the splits holds", "copies noted"),
        "its width, rms error, width over what that asks",
    )
    return StudyReport([Table(lines, names, "Accuracy in containers never seen, 90 % intervals")], json)


STUDY = Study(LabelsConfig, trials, report)
