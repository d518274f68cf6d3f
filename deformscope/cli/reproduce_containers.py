"""`deformscope reproduce containers`: the experiment of thesis chapter 2 in the laboratory, with its figures.

deformscope reproduce containers --out runs/containers
deformscope reproduce containers --trials 100 --cylinders 0 --quick
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import (
    fit_progress,
    make_folder,
    recorder_of,
    say,
    settings_of,
    show,
    write_file,
    write_json,
    wrote,
)
from deformscope.config import ContainersConfig

if TYPE_CHECKING:
    from deformscope.files.squeeze_dataset import SqueezeDataset
    from deformscope.reproduce.container_findings import FindingComparison
    from deformscope.reproduce.containers import SqueezeJob
    from deformscope.runs.classification import ClassificationResult
    from deformscope.stages.squeeze.table import LabelledTable

KEPT_TOGETHER = 40
"""Number of trials that are written together: each writing takes seconds."""
THREE = {"liquid": ("water", "yogurt"), "granular": ("flour", "rice")}
"""The thesis's three classes; `empty` is separate."""
COMPARISON_TEXT = (
    "The thesis squeezed real cartons. These are simulated ones; their constants come from handbooks and "
    "were fixed before any classifier ran on them. Nearest neighbours on components as in the thesis, with "
    "90 % intervals; unlike in the thesis, whole containers are left out of the training."
)


def run(config: ContainersConfig) -> None:
    """Squeeze missing trials, evaluate, draw the figures, and compare the thesis's statements with the laboratory's."""
    from deformscope.files.squeeze_dataset import SqueezeDataset
    from deformscope.reproduce.container_findings import compare_findings
    from deformscope.reproduce.containers import squeeze_jobs
    from deformscope.session import Step

    make_folder(config.out)
    folder = config.out / "squeezes"
    jobs = squeeze_jobs(folder, config.trials, config.cylinders, config.whole, config.output.seed)
    dataset = SqueezeDataset(folder)
    with recorder_of(config) as recorder:
        _squeeze(dataset, jobs, config)
        table = dataset.table()
        results = {
            "five": _evaluated(table, config, "five"),
            "three": _evaluated(table.merged(THREE), config, "three"),
        }
        beside = compare_findings(*(one.evaluation for one in results.values()))
        for name, result in results.items():
            recorder.write(Step((result.findings(),), frame=0))
            _report(result, config, name, beside)
    left_out = [one for one in dataset.entries() if one.discarded is not None]
    for one in left_out:
        say(f"left out: {one.trial}: {one.discarded}")
    show(*results.values())
    for finding in beside:
        say(f"thesis: {finding.thesis}\n  here: {finding.ours}")
    report: dict[str, Any] = {name: result.entries() for name, result in results.items()}
    report |= {"thesis": beside, "discarded": len(left_out), "trials": len(table), "dataset": folder}
    write_json(report, config.output.json)


def _squeeze(dataset: SqueezeDataset, jobs: list[SqueezeJob], config: ContainersConfig) -> None:
    """The trials that the folder lacks; each is stored when done, so that an interrupted command continues."""
    from deformscope.cli.study import Trials, tried
    from deformscope.experiments.squeeze_trial import feature_settings
    from deformscope.files.squeeze_dataset import SqueezeDataset
    from deformscope.lab.container_setup import container_lab
    from deformscope.reproduce.containers import run_squeeze

    known = {one.trial for one in dataset.entries()} if dataset.exists else set()
    left = [job for job in jobs if job.trial not in known]
    if not left:
        return
    writing = SqueezeDataset(dataset.folder, feature_settings(container_lab().setup))
    tried(
        Trials("squeezing", run_squeeze, left),
        config.on,
        config.workers,
        keep=lambda new: writing.add([row for _, row in new]),
        together=KEPT_TOGETHER,
    )


def _evaluated(table: LabelledTable, config: ContainersConfig, name: str) -> ClassificationResult:
    """Accuracies of one set of classes: of the cardboard boxes, as in the thesis; others are targets of transfers."""
    from deformscope.lab.container_setup import KINDS
    from deformscope.runs.classification import QUICK_SPLITS, classify_table
    from deformscope.stages.squeeze.evaluation import EvaluationOptions

    boxes = table if table.kind is None else table.rows(table.kind == KINDS["box"])
    options = EvaluationOptions(seed=config.output.seed)
    if config.quick:
        options = EvaluationOptions(QUICK_SPLITS, 0, 0, seed=config.output.seed)
    with fit_progress() as bar:
        return classify_table(boxes, f"lab:containers, {name} classes", options, bar, beyond=table)


def _report(
    result: ClassificationResult, config: ContainersConfig, name: str, beside: Sequence[FindingComparison]
) -> None:
    """Figures, the page and the classifier of one set of classes."""
    from deformscope.files.classifier_file import save_classifier
    from deformscope.pictures.report import Section, Table
    from deformscope.runs.classification_report import classification_page, classification_pictures

    with fit_progress() as bar:
        model = result.model(bar)
    drawn = classification_pictures(result)
    folder = config.out / name
    make_folder(folder)
    for picture, png in drawn.items():
        write_file(folder / f"{picture}.png", png)
    rows = [(one.thesis, one.ours) for one in beside]
    compared = Section("The thesis and the laboratory", [COMPARISON_TEXT, Table(rows, ("thesis", "here"))])
    page = classification_page(result, model, drawn, settings_of(config), compared)
    write_file(folder / "index.html", page.encode())
    save_classifier(model, folder / "contents.npz")
    wrote("report", folder / "index.html")
