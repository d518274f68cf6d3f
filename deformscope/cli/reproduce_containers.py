"""`deformscope reproduce containers`: the experiment of thesis chapter 2 in the laboratory, with its figures.

deformscope reproduce containers --out runs/containers
deformscope reproduce containers --trials 100 --cylinders 0 --quick
"""

from __future__ import annotations

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
)
from deformscope.config import ContainersConfig

if TYPE_CHECKING:
    from deformscope.api.classification import ClassificationResult
    from deformscope.files.squeeze_dataset import SqueezeDataset
    from deformscope.stages.squeeze.table import LabelledTable
    from deformscope.studies.containers import SqueezeJob

KEPT_TOGETHER = 40
"""Trials that are written together: each writing takes seconds."""
QUICK_SPLITS = 30
THREE = {"liquid": ("water", "yogurt"), "granular": ("flour", "rice")}
"""The thesis's three classes, beside `empty`."""


def run(config: ContainersConfig) -> None:
    """Squeeze what is not there yet, evaluate, draw the figures, and put the thesis's statements beside ours."""
    from deformscope.files.squeeze_dataset import SqueezeDataset
    from deformscope.session import Step
    from deformscope.studies.containers import STATEMENTS, squeeze_jobs

    make_folder(config.out)
    folder = config.out / "squeezes"
    jobs = squeeze_jobs(folder, config.trials, config.cylinders, config.whole, config.output.seed)
    dataset = SqueezeDataset(folder)
    with recorder_of(config) as recorder:
        _squeeze(dataset, jobs, config)
        table = dataset.table()
        found = {
            "five": _evaluated(table, config, "five"),
            "three": _evaluated(table.merged(THREE), config, "three"),
        }
        for result in found.values():
            recorder.write(Step((result.findings(),), frame=0))
    left_out = [one for one in dataset.entries() if one.discarded is not None]
    for one in left_out:
        say(f"left out: {one.trial}: {one.discarded}")
    show(*found.values())
    say("the thesis:")
    for statement in STATEMENTS:
        say(f"  {statement}")
    report: dict[str, Any] = {name: result.entries() for name, result in found.items()}
    report |= {"thesis": STATEMENTS, "discarded": len(left_out), "trials": len(table), "dataset": folder}
    write_json(report, config.output.json)


def _squeeze(dataset: SqueezeDataset, jobs: list[SqueezeJob], config: ContainersConfig) -> None:
    """The trials that the folder lacks; kept as they are done, so that the command goes on where it was cut off."""
    from deformscope.experiments.squeeze_trial import feature_settings
    from deformscope.files.squeeze_dataset import SqueezeDataset, TrialRow
    from deformscope.lab.container_setup import container_lab
    from deformscope.processes import in_processes
    from deformscope.studies.containers import run_squeeze

    known = {one.trial for one in dataset.entries()} if dataset.exists else set()
    left = [job for job in jobs if job.trial not in known]
    if not left:
        return
    writing = SqueezeDataset(dataset.folder, feature_settings(container_lab().setup))
    waiting: list[TrialRow] = []
    try:
        with fit_progress() as note:
            for count, (_, row) in enumerate(in_processes(run_squeeze, left, config.workers), start=1):
                waiting.append(row)
                if len(waiting) >= KEPT_TOGETHER:
                    writing.add(waiting)
                    waiting = []
                note("squeezing", count, len(left))
    finally:
        if waiting:
            writing.add(waiting)


def _evaluated(table: LabelledTable, config: ContainersConfig, name: str) -> ClassificationResult:
    """Accuracies, figures and the page of one set of classes."""
    from deformscope.api.classification import classify
    from deformscope.api.classification_report import classification_page, classification_pictures
    from deformscope.files.classifier_file import save_classifier

    few: dict[str, Any] = {"splits": QUICK_SPLITS, "costly_splits": 0, "curve_splits": 0} if config.quick else {}
    with fit_progress() as bar:
        result = classify(table, seed=config.output.seed, progress=bar, **few)
        model = result.model(bar)
    drawn = classification_pictures(result)
    folder = config.out / name
    make_folder(folder)
    for picture, png in drawn.items():
        write_file(folder / f"{picture}.png", png)
    write_file(folder / "index.html", classification_page(result, model, drawn, settings_of(config)).encode())
    save_classifier(model, folder / "contents.npz")
    say(f"report: {folder / 'index.html'}")
    return result
