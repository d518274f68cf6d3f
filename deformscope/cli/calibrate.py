"""`deformscope calibrate beta|theta`: fit the model to images or to pair files, with interval and verdict."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import EXIT_LOSSES, fit_progress, say, show, write_file, write_json
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.calibrate import PushFlags
from deformscope.page.fit_settings import set_on_a_page

if TYPE_CHECKING:  # loaded once a page is there
    from deformscope.pictures.evidence import Result
    from deformscope.runs.calibration_result import CalibrationResult
    from deformscope.stages.fit.estimate import Estimate


def run(config: BetaConfig | ThetaConfig) -> int:
    """Fit, print the tables, write the requested files. Returns the command's exit status."""
    if set_on_a_page(config):
        from deformscope.page.fit_command import set_on_page

        with set_on_page(config, _read_force, say) as (chosen, show_on_page):
            return _fit(chosen, show_on_page)
    return _fit(config)


def _read_force(push: PushFlags) -> Any:
    from deformscope.runs.force_log import push_of

    return push_of(push)


def _fit(config: BetaConfig | ThetaConfig, show_on_page: "Callable[[Estimate, Result], None] | None" = None) -> int:
    from deformscope.files.model_file import save_model
    from deformscope.runs.calibration import calibrate

    with fit_progress() as progress:
        found = calibrate(config, note=say, progress=progress)
    if show_on_page is not None:
        show_on_page(found[0].estimate, found[0].shown)
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
