"""`deformscope calibrate beta|theta`: fit the model to images or to pair files, with interval and verdict."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from deformscope.cli.common import EXIT_LOSSES, fit_progress, say, show, write_file, write_json
from deformscope.config import BetaConfig, ThetaConfig

if TYPE_CHECKING:
    from deformscope.runs.calibration_result import CalibrationResult


def run(config: BetaConfig | ThetaConfig) -> int:
    """Fit, print the tables, write the requested files. Returns the command's exit status."""
    from deformscope.files.model_file import save_model
    from deformscope.runs.calibration import calibrate

    with fit_progress() as progress:
        found = calibrate(config, note=say, progress=progress)
    show(*found)
    write_summaries(config, found)
    every = [one.to_dict() for one in found]
    if config.model.save is not None:
        save_model(found[0].model(), config.model.save)
        if "model" in every[0]:
            every[0]["model"] = str(config.model.save)
    if config.model.save_pair is not None:
        found[0].save_pair(config.model.save_pair)
    write_json(every[0] if len(every) == 1 else every, config.output.json)
    for one in found:
        if one.problems:
            say(f"deformscope: {config.sources[0]} is damaged: {'; '.join(one.problems)}")
            return EXIT_LOSSES
    return 0


def write_summaries(config: BetaConfig | ThetaConfig, found: "Sequence[CalibrationResult]") -> None:
    """Write the requested picture and report."""
    from deformscope.pictures.evidence import results_png
    from deformscope.runs.calibration_report import calibration_page

    files, shown = config.summary, [one.shown for one in found]
    if files.picture is not None:
        write_file(files.picture, results_png(shown))
    if files.report is not None:
        first = found[0]
        page = calibration_page(shown, seed=first.seed, settings=first.settings, pokes=first.pokes)
        write_file(files.report, page.encode())
