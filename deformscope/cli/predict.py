"""`deformscope predict`: predict pokes that were not fitted."""

import tempfile
from itertools import chain
from pathlib import Path

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.cli import common
from deformscope.config import PredictConfig, SimulateConfig
from deformscope.config.options import ViewOptions
from deformscope.errors import InputError
from deformscope.files.arrays_file import numbers, read_arrays
from deformscope.files.model_file import load_model
from deformscope.files.pairs import parse_pair
from deformscope.pictures.figures import dents_png
from deformscope.pictures.report import Figure, Findings, Table
from deformscope.runs import prediction
from deformscope.runs.prediction import compare
from deformscope.runs.simulation import SimulationResult, simulate
from deformscope.session import Step
from deformscope.stages.msm.solver import pick_device
from deformscope.stages.poke.fitted import predict, together
from deformscope.terminal import Progress


def run(config: PredictConfig) -> None:
    """Predict, compare, print and write."""
    model = load_model(config.source)
    asked = [prediction.poke_of(text, model) for text in config.poke]
    points = None if config.points is None else _points(config.points)
    seen = [parse_pair(common.read_file(path, "a pair file (.npz)"), path) for path in config.against]
    common.quiet_warp()
    device = pick_device(config.device)
    with common.fit_progress() as progress:
        other = _simulated(config, progress)
        found = []
        for index, poke in enumerate(asked):
            progress("predicting", index, len(asked))
            found.append(prediction.PredictionResult(predict(model, poke, device=device), points))
        compared = compare(model, seen, device=device, progress=progress) if seen else []
    against: list[tuple[Table, ...]] = [
        (prediction.comparison_table(str(path), one),) for path, one in zip(config.against, compared, strict=True)
    ]
    summary = together(compared) if compared else None
    if summary is not None and len(against) > 1:
        against[-1] = (*against[-1], prediction.together_table(summary))
    every = [*(one.prediction for one in found), *(one.prediction for one in compared)]
    beside = [] if other is None else [(other.predictions(),)]
    common.show(Findings(tuple(chain.from_iterable([*(one.tables() for one in found), *against, *beside]))))
    if config.out is not None:
        with common.replacing(config.out) as file:
            np.savez_compressed(file, **prediction.arrays_of(every))  # type: ignore[arg-type]  # numpy's stub
    with common.recorder_of(config) as recorder:
        for index, one in enumerate(found):
            recorder.write(Step((one.findings(),), frame=index))
        for index, (tables, measured) in enumerate(zip(against, compared, strict=True), start=len(found)):
            png, body = dents_png([measured.prediction], [measured]), prediction.moved_body(measured.prediction)
            figure = Figure(png, "A cut through the dent along x, with the measured surface")
            recorder.write(Step((Findings(tables, (figure,), (body,)),), frame=index))
    if config.picture is not None:
        common.write_file(config.picture, dents_png(every, compared))
    common.write_json(
        {
            "model": str(config.source),
            "provenance": model.provenance,
            "predictions": [one.as_json() for one in found],
            "against": [
                {
                    "pair": str(path),
                    **prediction.PredictionResult(measured.prediction).as_json(),
                    "scores": measured.scores,
                }
                for path, measured in zip(config.against, compared, strict=True)
            ],
            "against_together": summary,
            **({} if other is None else {"in": other.to_dict()}),
        },
        config.output.json,
    )


def _simulated(config: PredictConfig, progress: Progress) -> SimulationResult | None:
    """The pokes in another simulator that was fitted to the measured ones."""
    if config.target is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        fitted_to, quiet = (config.python, config.against, config.poke), ViewOptions(viewer="none")
        asked = SimulateConfig(config.source, config.target, Path(folder), *fitted_to, output=quiet)
        found = simulate(asked, progress)
    return found if isinstance(found, SimulationResult) else None  # of pokes it is one


def _points(path: Path) -> FloatArray:
    expected = "an .npz with `points (n, 3)`"
    found = read_arrays(common.read_file(path, expected), expected, path)
    if "points" not in found:
        raise InputError(expected, ", ".join(sorted(found)) or "nothing in it", where=path)
    points = numbers(found, "points")
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError("finite points (n, 3)", f"shape {points.shape}", where=path)
    return points
