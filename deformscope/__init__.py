"""How soft a thing is, and where.

    import deformscope as ds

    tension = ds.calibrate_beta("sample:tension")
    table = ds.explore("lab:two-60-150", seed=3)
    print(tension, table, sep="\\n")

Every function raises `deformscope.InputError` for unusable input. Every result prints as a table, has `to_dict()` (the
JSON of the command line), and shows its pictures in a notebook. Nothing heavy is loaded before it is used.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deformscope.errors import InputError as InputError
    from deformscope.library import calibrate_axes as calibrate_axes
    from deformscope.library import calibrate_beta as calibrate_beta
    from deformscope.library import calibrate_field as calibrate_field
    from deformscope.library import calibrate_theta as calibrate_theta
    from deformscope.library import calibrate_viscous as calibrate_viscous
    from deformscope.library import calibrate_yield as calibrate_yield
    from deformscope.library import catalog as catalog
    from deformscope.library import certify as certify
    from deformscope.library import classify as classify
    from deformscope.library import compare_recordings as compare_recordings
    from deformscope.library import discard as discard
    from deformscope.library import explore as explore
    from deformscope.library import export as export
    from deformscope.library import import_recording as import_recording
    from deformscope.library import indent as indent
    from deformscope.library import load_classifier as load_classifier
    from deformscope.library import open_dataset as open_dataset
    from deformscope.library import open_recording as open_recording
    from deformscope.library import predict as predict
    from deformscope.library import record as record
    from deformscope.library import recover as recover
    from deformscope.library import replay as replay
    from deformscope.library import report as report
    from deformscope.library import simulate as simulate
    from deformscope.library import squeeze as squeeze
    from deformscope.library import sweep as sweep
    from deformscope.library import verify as verify
    from deformscope.runs.calibration_result import CalibrationResult as CalibrationResult
    from deformscope.runs.catalog import CatalogResult as CatalogResult
    from deformscope.runs.catalog import ComparedRecordings as ComparedRecordings
    from deformscope.runs.classification_report import ClassificationResult as ClassificationResult
    from deformscope.runs.exploration_result import ExplorationResult as ExplorationResult
    from deformscope.runs.exploration_run import OwnScene as OwnScene
    from deformscope.runs.exploration_run import TouchPlanner as TouchPlanner
    from deformscope.runs.indentation import IndentResult as IndentResult
    from deformscope.runs.materials import MaterialResult as MaterialResult
    from deformscope.runs.prediction import PredictionResult as PredictionResult
    from deformscope.runs.recording_report import RecordingReport as RecordingReport
    from deformscope.runs.recordings import ExportResult as ExportResult
    from deformscope.runs.recordings import OpenDataset as OpenDataset
    from deformscope.runs.recordings import OpenRecording as OpenRecording
    from deformscope.runs.recordings import RecordResult as RecordResult
    from deformscope.runs.replay_result import ReplayResult as ReplayResult
    from deformscope.runs.result import FoundResult as FoundResult
    from deformscope.runs.simulation import SimulationResult as SimulationResult
    from deformscope.runs.squeeze_result import SqueezeResult as SqueezeResult
    from deformscope.runs.sweep import SweepResult as SweepResult
    from deformscope.runs.verification import VerifyResult as VerifyResult
    from deformscope.stages.msm.solver import Msm as Msm
    from deformscope.stages.see.flow import dense_flow as dense_flow
    from deformscope.version import __version__ as __version__

_NAMES = {
    "runs.classification_report": "ClassificationResult",
    "errors": "InputError",
    "runs.exploration_run": "OwnScene TouchPlanner",
    "library": "calibrate_axes calibrate_beta calibrate_field calibrate_theta "
    "calibrate_viscous calibrate_yield catalog certify classify compare_recordings discard "
    "explore export import_recording indent load_classifier open_dataset open_recording predict record "
    "recover replay report simulate squeeze sweep verify",
    "runs.calibration_result": "CalibrationResult",
    "runs.exploration_result": "ExplorationResult",
    "runs.indentation": "IndentResult",
    "runs.prediction": "PredictionResult",
    "runs.recordings": "ExportResult OpenDataset OpenRecording RecordResult",
    "runs.recording_report": "RecordingReport",
    "runs.replay_result": "ReplayResult",
    "runs.simulation": "SimulationResult",
    "runs.squeeze_result": "SqueezeResult",
    "runs.sweep": "SweepResult",
    "runs.result": "FoundResult",
    "runs.materials": "MaterialResult",
    "runs.verification": "VerifyResult",
    "runs.catalog": "CatalogResult ComparedRecordings",
    "stages.msm.solver": "Msm",
    "stages.see.flow": "dense_flow",
    "version": "__version__",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
"""The module of each name, imported at the first use of the name."""

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(importlib.import_module(f"deformscope.{_HOMES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
