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
    say,
    settings_of,
    show,
    write_file,
    write_json,
)
from deformscope.config import ClassifyConfig
from deformscope.config.classify import parse_merges, parse_transfers


def run(config: ClassifyConfig) -> None:
    """Evaluate, print, draw and write."""
    from deformscope.api.classification import classify_table, options_of, table_from
    from deformscope.files.classifier_file import save_classifier
    from deformscope.session import Step

    table = table_from(
        config.table,
        modalities=config.modalities,
        merge=parse_merges(config.merge),
        duplicates=config.duplicates,
    )
    if config.report is not None and config.report.suffix != ".html":
        make_folder(config.report)
    options = options_of(config, parse_transfers(config.transfer))
    with recorder_of(config) as recorder:
        with fit_progress() as progress:
            result = classify_table(table, str(config.table), options, progress)
        show(result)
        recorder.write(Step((result.findings(),), frame=0))
    write_json(result.entries(), config.output.json)
    if config.save is None and config.page is None:
        return
    with fit_progress() as progress:
        model = result.model(progress)
    if config.save is not None:
        save_classifier(model, config.save)
        say(f"classifier: {config.save}")
    if config.page is not None:
        from deformscope.api.classification_report import classification_page, classification_pictures

        drawn = classification_pictures(result)
        if config.report is not None and config.report.suffix != ".html":
            for name, png in drawn.items():
                write_file(config.report / f"{name}.png", png)
        write_file(config.page, classification_page(result, model, drawn, settings_of(config)).encode())
        say(f"report: {config.page}")
