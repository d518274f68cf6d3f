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
        calibrate_axes,
        calibrate_beta,
        calibrate_both,
        calibrate_field,
        calibrate_theta,
        calibrate_viscous,
        calibrate_yield,
        catalog,
        classify,
        compare_recordings,
        discard,
        explore,
        export,
        import_recording,
        load_classifier,
        open_dataset,
        open_recording,
        predict,
        record,
        recover,
        replay,
        report,
        squeeze,
        sweep,
        verify,
    )
    from deformscope.runs.calibration import CalibrationResult
    from deformscope.runs.catalog import CatalogResult, ComparedRecordings
    from deformscope.runs.classification import ClassificationResult
    from deformscope.runs.datasets import OpenDataset
    from deformscope.runs.exploration_result import ExplorationResult
    from deformscope.runs.exploration_run import OwnScene, TouchPlanner
    from deformscope.runs.exporting import ExportResult
    from deformscope.runs.joint_calibration import JointResult
    from deformscope.runs.materials import MaterialResult
    from deformscope.runs.prediction import PredictionResult
    from deformscope.runs.recording_report import RecordingReport
    from deformscope.runs.recordings import OpenRecording, RecordResult
    from deformscope.runs.replay_result import ReplayResult
    from deformscope.runs.result import FoundResult
    from deformscope.runs.squeeze_result import SqueezeResult
    from deformscope.runs.sweep import SweepResult
    from deformscope.runs.verification import VerifyResult
    from deformscope.stages.msm.solver import Msm
    from deformscope.stages.see.flow import dense_flow
    from deformscope.version import __version__

_NAMES = {
    "runs.classification": "ClassificationResult",
    "errors": "InputError",
    "runs.exploration_run": "OwnScene TouchPlanner",
    "library": "calibrate_axes calibrate_beta calibrate_both calibrate_field calibrate_theta "
    "calibrate_viscous calibrate_yield catalog classify compare_recordings discard explore "
    "export import_recording load_classifier open_dataset open_recording predict record "
    "recover replay report squeeze sweep verify",
    "runs.calibration": "CalibrationResult",
    "runs.datasets": "OpenDataset",
    "runs.exploration_result": "ExplorationResult",
    "runs.prediction": "PredictionResult",
    "runs.recordings": "OpenRecording RecordResult",
    "runs.replay_result": "ReplayResult",
    "runs.squeeze_result": "SqueezeResult",
    "runs.sweep": "SweepResult",
    "runs.exporting": "ExportResult",
    "runs.result": "FoundResult",
    "runs.joint_calibration": "JointResult",
    "runs.materials": "MaterialResult",
    "runs.verification": "VerifyResult",
    "runs.catalog": "CatalogResult ComparedRecordings",
    "runs.recording_report": "RecordingReport",
    "stages.msm.solver": "Msm",
    "stages.see.flow": "dense_flow",
    "version": "__version__",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
"""The module of each name, imported at the first use of the name."""

__all__ = [
    "CalibrationResult",
    "CatalogResult",
    "ClassificationResult",
    "ComparedRecordings",
    "ExplorationResult",
    "ExportResult",
    "FoundResult",
    "InputError",
    "JointResult",
    "MaterialResult",
    "Msm",
    "OpenDataset",
    "OpenRecording",
    "OwnScene",
    "PredictionResult",
    "RecordResult",
    "RecordingReport",
    "ReplayResult",
    "SqueezeResult",
    "SweepResult",
    "TouchPlanner",
    "VerifyResult",
    "__version__",
    "calibrate_axes",
    "calibrate_beta",
    "calibrate_both",
    "calibrate_field",
    "calibrate_theta",
    "calibrate_viscous",
    "calibrate_yield",
    "catalog",
    "classify",
    "compare_recordings",
    "dense_flow",
    "discard",
    "explore",
    "export",
    "import_recording",
    "load_classifier",
    "open_dataset",
    "open_recording",
    "predict",
    "record",
    "recover",
    "replay",
    "report",
    "squeeze",
    "sweep",
    "verify",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(importlib.import_module(f"deformscope.{_HOMES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
