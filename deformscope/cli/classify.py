"""`deformscope classify`: how well contents are known, from tables and data sets; and a classifier to keep.

deformscope classify squeezes.npz --json -
deformscope classify squeezes.csv --modalities tactile,vision --report report --save contents.npz
deformscope classify squeezes.npz --merge liquid=water,yogurt --merge granular=flour,rice --quick
"""

from __future__ import annotations

from deformscope.cli.common import (
    fit_progress,
    make_folder,
    recorder_of,
    replacing,
    say,
    settings_of,
    show,
    write_json,
)
from deformscope.config import ClassifyConfig
from deformscope.config.classify import parse_merges, parse_transfers

QUICK_SPLITS = 30


def run(config: ClassifyConfig) -> None:
    """Evaluate, print, draw and write."""
    from deformscope.api.classification import classify_table, table_from
    from deformscope.files.classifier_file import save_classifier
    from deformscope.session import Step
    from deformscope.stages.squeeze.evaluation import EvaluationOptions

    table = table_from(
        config.table,
        modalities=config.modalities,
        merge=parse_merges(config.merge),
        duplicates=config.duplicates,
    )
    if config.report is not None and config.report.suffix != ".html":
        make_folder(config.report)
    options = EvaluationOptions(
        splits=min(config.splits, QUICK_SPLITS) if config.quick else config.splits,
        costly_splits=0 if config.quick else config.costly_splits,
        curve_splits=0 if config.quick else config.curve_splits,
        level=config.level,
        seed=config.output.seed,
        transfer=parse_transfers(config.transfer),
    )
    with recorder_of(config) as recorder:
        with fit_progress() as progress:
            result = classify_table(table, str(config.table), options, progress)
        show(result)
        recorder.write(Step((result.findings(),), frame=0))
    if config.save is not None:
        with fit_progress() as progress:
            model = result.model(progress)
        save_classifier(model, config.save)
        say(f"classifier: {config.save}")
    if config.page is not None:
        from deformscope.api.classification_report import classification_page, classification_pictures

        drawn = classification_pictures(result)
        if config.report is not None and config.report.suffix != ".html":
            for name, png in drawn.items():
                with replacing(config.report / f"{name}.png") as file:
                    file.write(png)
        with replacing(config.page) as file:
            file.write(classification_page(result, drawn, settings_of(config)).encode())
        say(f"report: {config.page}")
    write_json(result.entries(), config.output.json)
