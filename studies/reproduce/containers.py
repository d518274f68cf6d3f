"""`python -m studies reproduce containers`: the experiment of thesis chapter 2 in the laboratory, with its figures.

python -m studies reproduce containers --out runs/containers --resume runs/containers.jsonl
python -m studies reproduce containers --trials 100 --cylinders 0 --quick
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from deformscope.cli.common import fit_progress, make_folder, settings_of, wrote
from deformscope.config import flags
from deformscope.files.classifier_file import save_classifier
from deformscope.files.squeeze_dataset import TrialRow
from deformscope.lab.container_setup import KINDS
from deformscope.pictures.report import Section, Table
from deformscope.runs.classification_report import (
    QUICK_SPLITS,
    ClassificationResult,
    classification_page,
    classification_pictures,
    classify_table,
)
from deformscope.stages.squeeze.evaluation import EvaluationOptions
from deformscope.stages.squeeze.table import LabelledTable
from studies.reproduce.container_findings import FindingComparison, compare_findings
from studies.reproduce.container_trials import SqueezeJob, dataset_of, run_squeeze, squeeze_jobs
from studies.runner import Study, StudyOptions, StudyReport, Trials

THREE = {"liquid": ("water", "yogurt"), "granular": ("flour", "rice")}
"""The thesis's three classes; `empty` is separate."""
COMPARISON_TEXT = (
    "The thesis squeezed real cartons. These are simulated ones; their constants come from handbooks and "
    "were fixed before any classifier ran on them. Nearest neighbours on components as in the thesis, with "
    "90 % intervals; unlike in the thesis, whole containers are left out of the training."
)


@dataclass(frozen=True, slots=True)
class ContainersConfig(StudyOptions):
    """Thesis chapter 2 in the laboratory: squeeze boxes with five contents, evaluate touch, vision and both, and draw
    its figures, with its results for comparison. --resume continues an interrupted command."""

    out: flags.Folder = Path("runs/containers")
    """Folder of the data set (squeezes/) and of the reports (five/, three/); made if missing."""
    trials: Annotated[int, flags.least(20)] = 731
    """Squeezes of cardboard boxes, in the thesis's proportions."""
    cylinders: Annotated[int, flags.least(0)] = 100
    """Additional squeezes of plastic cylinders, on which classifiers trained on boxes are tested."""
    whole: Annotated[int, flags.least(0)] = 20
    """Number of trials whose whole recordings are stored, at the camera's full rate."""
    quick: bool = False
    """At most 30 splits, without learning curve."""


def trials(options: ContainersConfig) -> list[Trials[SqueezeJob, TrialRow]]:
    """The squeezes."""
    jobs = squeeze_jobs(options.out, options.trials, options.cylinders, options.whole, options.output.seed)
    return [Trials("squeezes", run_squeeze, jobs)]


def report(options: ContainersConfig, seconds: float, squeezed: Sequence[TrialRow]) -> StudyReport:
    """Evaluate, draw the figures, and compare the thesis's statements with the laboratory's."""
    dataset = dataset_of(options.out, squeezed)
    table = dataset.table()
    results = {"five": _evaluated(table, options, "five"), "three": _evaluated(table.merged(THREE), options, "three")}
    beside = compare_findings(*(one.evaluation for one in results.values()))
    for name, result in results.items():
        _report(result, options, name, beside)
    left_out = [(one.trial, one.discarded) for one in dataset.entries() if one.discarded is not None]
    tables = [
        *(one for result in results.values() for one in result.tables()),
        _compared(beside),
        *([Table(left_out, caption="Left out")] if left_out else []),
    ]
    json: dict[str, object] = {name: result.entries() for name, result in results.items()}
    json |= {"thesis": beside, "discarded": len(left_out), "trials": len(table), "dataset": dataset.folder}
    return StudyReport(tables, json, [one for result in results.values() for one in result.figures()])


def _compared(beside: Sequence[FindingComparison]) -> Table:
    return Table([(one.thesis, one.ours) for one in beside], ("thesis", "here"), "The thesis and the laboratory")


def _evaluated(table: LabelledTable, options: ContainersConfig, name: str) -> ClassificationResult:
    """Accuracies of one set of classes: of the cardboard boxes, as in the thesis; others are targets of transfers."""
    boxes = table if table.kind is None else table.rows(table.kind == KINDS["box"])
    evaluated = EvaluationOptions(seed=options.output.seed)
    if options.quick:
        evaluated = EvaluationOptions(QUICK_SPLITS, 0, seed=options.output.seed)
    with fit_progress() as bar:
        return classify_table(boxes, f"lab:containers, {name} classes", evaluated, bar, beyond=table)


def _report(
    result: ClassificationResult, options: ContainersConfig, name: str, beside: Sequence[FindingComparison]
) -> None:
    """Figures, the page and the classifier of one set of classes."""
    with fit_progress() as bar:
        model = result.model(bar)
    drawn = classification_pictures(result)
    folder = options.out / name
    make_folder(folder)
    for picture, png in drawn.items():
        (folder / f"{picture}.png").write_bytes(png)
    table = _compared(beside)
    compared = Section(table.caption, [COMPARISON_TEXT, replace(table, caption="")])
    page = classification_page(result, model, drawn, settings_of(options), compared)
    (folder / "index.html").write_text(page, encoding="utf-8")
    save_classifier(model, folder / "contents.npz")
    wrote("report", folder / "index.html")


STUDY = Study(ContainersConfig, trials, report)
