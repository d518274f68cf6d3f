"""How soft a thing is, and where.

    import deformscope as ds

    tension = ds.calibrate_beta("sample:tension")
    table = ds.explore("lab:two-60-150", seed=3)
    print(tension, table, sep="\\n")

Every function raises `deformscope.InputError` for unusable input. Every result prints as a table, has `to_dict()` (the
JSON of the command line), and shows its pictures in a notebook. Nothing heavy is loaded before it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deformscope.errors import InputError
    from deformscope.library import (
        calibrate_beta,
        calibrate_theta,
        classify,
        explore,
        load_classifier,
        open_dataset,
        open_recording,
        predict,
        record,
        replay,
        squeeze,
        sweep,
    )
    from deformscope.runs.calibration import CalibrationResult
    from deformscope.runs.classification import ClassificationResult
    from deformscope.runs.datasets import OpenDataset
    from deformscope.runs.exploration_result import ExplorationResult
    from deformscope.runs.prediction import PredictionResult
    from deformscope.runs.recordings import OpenRecording, RecordResult
    from deformscope.runs.replay_result import ReplayResult
    from deformscope.runs.squeeze_result import SqueezeResult
    from deformscope.runs.sweep import SweepResult
    from deformscope.stages.msm.solver import Msm
    from deformscope.stages.see.flow import dense_flow
    from deformscope.version import __version__

_NAMES = {
    "runs.classification": "ClassificationResult",
    "errors": "InputError",
    "library": "calibrate_beta calibrate_theta classify explore load_classifier open_dataset open_recording predict"
    " record replay squeeze sweep",
    "runs.calibration": "CalibrationResult",
    "runs.datasets": "OpenDataset",
    "runs.exploration_result": "ExplorationResult",
    "runs.prediction": "PredictionResult",
    "runs.recordings": "OpenRecording RecordResult",
    "runs.replay_result": "ReplayResult",
    "runs.squeeze_result": "SqueezeResult",
    "runs.sweep": "SweepResult",
    "stages.msm.solver": "Msm",
    "stages.see.flow": "dense_flow",
    "version": "__version__",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
"""The module of each name, imported at the first use of the name."""

__all__ = [
    "CalibrationResult",
    "ClassificationResult",
    "ExplorationResult",
    "InputError",
    "Msm",
    "OpenDataset",
    "OpenRecording",
    "PredictionResult",
    "RecordResult",
    "ReplayResult",
    "SqueezeResult",
    "SweepResult",
    "__version__",
    "calibrate_beta",
    "calibrate_theta",
    "classify",
    "dense_flow",
    "explore",
    "load_classifier",
    "open_dataset",
    "open_recording",
    "predict",
    "record",
    "replay",
    "squeeze",
    "sweep",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(importlib.import_module(f"deformscope.{_HOMES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
