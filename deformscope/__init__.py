"""How soft a thing is, and where.

    import deformscope as ds

    tension = ds.calibrate_beta("sample:tension")
    table = ds.explore("lab:two-60-150", seed=3)
    print(tension, table, sep="\\n")

Every function raises `deformscope.InputError` for what cannot be used; every result prints as a table, has `to_dict()`
(the JSON of the command line), and shows its pictures in a notebook. Nothing heavy is loaded before it is asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deformscope.api.calibration import CalibrationResult, calibrate_beta, calibrate_theta
    from deformscope.api.classification import ClassificationResult, classify, load_classifier
    from deformscope.api.exploration_result import ExplorationResult
    from deformscope.api.prediction import PredictionResult, predict
    from deformscope.api.recordings import OpenRecording, RecordResult, open_recording
    from deformscope.api.squeeze_result import SqueezeResult
    from deformscope.errors import InputError
    from deformscope.runs.exploration import explore
    from deformscope.runs.replay import replay
    from deformscope.runs.replay_result import ReplayResult
    from deformscope.runs.rig_run import record
    from deformscope.runs.squeezing import OpenDataset, open_dataset, squeeze
    from deformscope.stages.msm.solver import Msm
    from deformscope.stages.see.flow import dense_flow
    from deformscope.version import __version__

_NAMES = {
    "api.calibration": ("CalibrationResult", "calibrate_beta", "calibrate_theta"),
    "api.classification": ("ClassificationResult", "classify", "load_classifier"),
    "runs.exploration": ("explore",),
    "api.exploration_result": ("ExplorationResult",),
    "api.prediction": ("PredictionResult", "predict"),
    "api.recordings": ("OpenRecording", "RecordResult", "open_recording"),
    "runs.replay": ("replay",),
    "runs.replay_result": ("ReplayResult",),
    "runs.rig_run": ("record",),
    "api.squeeze_result": ("SqueezeResult",),
    "runs.squeezing": ("OpenDataset", "open_dataset", "squeeze"),
    "errors": ("InputError",),
    "stages.msm.solver": ("Msm",),
    "stages.see.flow": ("dense_flow",),
    "version": ("__version__",),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
"""The module of each name, imported when the name is first asked for."""

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
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(importlib.import_module(f"deformscope.{_HOMES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
