"""`deformscope classify`: evaluates how well contents are classified, from tables and data sets; and saves a
classifier.

deformscope classify squeezes.npz --json -
deformscope classify squeezes.csv --modalities tactile,vision --report report --save contents.npz
deformscope classify squeezes.npz --merge liquid=water,yogurt --merge granular=flour,rice --quick
"""

from deformscope.cli import common
from deformscope.config import ClassifyConfig
from deformscope.config.classify import parse_merges, parse_transfers
from deformscope.session import Step


def run(config: ClassifyConfig) -> None:
    """Evaluate, print, draw and write."""
    from deformscope.files.classifier_file import save_classifier
    from deformscope.runs.classification_report import classify_table, options_of, table_from

    table = table_from(
        config.table, modalities=config.modalities, merge=parse_merges(config.merge), duplicates=config.duplicates
    )
    if config.report is not None and config.report.suffix != ".html":
        common.make_folder(config.report)
    options = options_of(config, parse_transfers(config.transfer))
    with common.recorder_of(config) as recorder:
        with common.fit_progress() as progress:
            result = classify_table(table, str(config.table), options, progress)
        common.show(result)
        recorder.write(Step((result.findings(),), frame=0))
    common.write_json(result.entries(), config.output.json)
    if config.save is None and config.page is None:
        return
    with common.fit_progress() as progress:
        model = result.model(progress)
    if config.save is not None:
        save_classifier(model, config.save)
    if config.page is not None:
        from deformscope.runs.classification_report import classification_page, classification_pictures

        drawn = classification_pictures(result)
        text = classification_page(result, model, drawn, common.settings_of(config))
        if config.report is not None and config.report != config.page:
            for name, png in drawn.items():
                common.write_file(config.report / f"{name}.png", png)
        common.write_file(config.page, text.encode())
        common.wrote("report", config.page)
