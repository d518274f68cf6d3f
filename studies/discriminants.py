"""`python -m studies discriminants`: own discriminant analyses against scikit-learn's, on splits by group.

python -m studies discriminants
python -m studies discriminants --trials 60 --json discriminants.json

scikit-learn's take a share of the unit matrix, chosen among the same values by cross-validation over groups.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis, QuadraticDiscriminantAnalysis

from deformscope.arrays import FloatArray, IntArray
from deformscope.config import flags
from deformscope.pictures.report import Table
from deformscope.runs.classification_report import table_from
from deformscope.stages.squeeze.classifiers import SHARES, Name, columns_of, fit, floored, folds_of
from deformscope.stages.squeeze.table import LabelledTable, draw
from deformscope.stages.squeeze.trial_run import sides_of
from studies.runner import Study, StudyOptions, StudyReport, Trials

NAMES: tuple[Name, ...] = ("qda", "qda-raw", "linear")


@dataclass(frozen=True, slots=True)
class DiscriminantsConfig(StudyOptions):
    """Compare own `linear`, `qda` and `qda-raw` with scikit-learn's on `sample:squeezes`, whole containers left out.
    Each split takes some 3 s of a core."""

    trials: flags.ManyFlag = 30
    """Splits by group."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Own less scikit-learn's on one split. right: share of right answers; log_loss: mean over the trials"""

    modality: str
    name: Name
    right: float
    log_loss: float


@cache
def squeezes() -> LabelledTable:
    """The sample's table."""
    return table_from("sample:squeezes", modalities=None, merge=None, duplicates="refuse")


def theirs(name: Name, points: FloatArray, target: IntArray, test: FloatArray, fold: IntArray) -> FloatArray:
    """(m, C) log posteriors of (m, d) points, from (n, d) points of classes (n,), by the share of the least log loss
    over folds (n,)."""
    prior = np.full(int(target.max()) + 1, 1.0 / (target.max() + 1))

    def fitted(share: float, of: IntArray, tested: FloatArray) -> FloatArray:
        model = (
            LinearDiscriminantAnalysis(solver="lsqr", shrinkage=share, priors=prior)
            if name == "linear"
            else QuadraticDiscriminantAnalysis(solver="eigen", shrinkage=share, priors=prior)
        )
        posterior = model.fit(points[of], target[of]).predict_proba(tested)
        return floored(np.log(np.maximum(posterior, 1e-300)))

    loss = np.zeros(len(SHARES))
    for one in np.unique(fold):
        inside, others = fold == one, np.flatnonzero(fold != one)
        if np.bincount(target[others], minlength=len(prior)).min() > 1:
            said = [fitted(share, others, points[inside]) for share in SHARES]
            loss -= [logs[np.arange(inside.sum()), target[inside]].sum() for logs in said]
    return fitted(SHARES[int(loss.argmin())], np.arange(len(points)), test)


def compared(number: int) -> list[Difference]:
    """All modalities and methods on the split of this number."""
    table, found = squeezes(), []
    assert table.group is not None
    split = draw("group", table, number + 1, 0)[number]
    group = np.unique(table.group, return_inverse=True)[1]
    missing = {name: table.missing(name) for name in table.modalities}
    for modality, sides in sides_of(table.modalities, missing, split, table.fused).items():
        truth, tested, apart = table.target[sides.train], table.target[sides.test], group[sides.train]
        for name in NAMES:
            columns = columns_of(name, sides.space.kept)
            one, other = sides.space.train[:, :columns], sides.space.test[:, :columns]
            own = fit(name, one, truth, len(table.classes), apart).log_posterior(other)
            both = own, theirs(name, one, truth, other, folds_of(truth, apart))
            right = [float((logs.argmax(axis=1) == tested).mean()) for logs in both]
            loss = [-float(logs[np.arange(len(tested)), tested].mean()) for logs in both]
            found.append(Difference(modality, name, right[0] - right[1], loss[0] - loss[1]))
    return found


def trials(options: DiscriminantsConfig) -> list[Trials[int, list[Difference]]]:
    """All splits."""
    return [Trials("splits", compared, list(range(options.trials)))]


def report(options: DiscriminantsConfig, seconds: float, tried: Sequence[list[Difference]]) -> StudyReport:
    """A row of each method and modality."""
    rows, json = [], []
    for every in zip(*tried, strict=True):
        values = np.array([(one.right, one.log_loss) for one in every])
        mean, error = values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))
        (right, loss), (right_error, loss_error) = mean.tolist(), error.tolist()
        first = every[0]
        rows.append(
            (first.name, first.modality, f"{right:+.3f} ({right_error:.3f})", f"{loss:+.3f} ({loss_error:.3f})")
        )
        json.append(
            {
                "method": first.name,
                "modality": first.modality,
                "right": [right, right_error],
                "log_loss": [loss, loss_error],
            }
        )
    names = "method", "modality", "more often right by", "log loss"
    caption = f"own less scikit-learn's, {len(tried)} splits by group (standard error of the mean)"
    return StudyReport([Table(sorted(rows), names, caption)], {"splits": len(tried), "differences": json})


STUDY = Study(DiscriminantsConfig, trials, report)
