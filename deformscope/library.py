"""The functions of `import deformscope as ds`: a script's arguments, read into the options of a command, and its run.

Each raises `InputError` for what cannot be used, which names parameters as Python spells them."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

from deformscope.errors import InputError
from deformscope.terminal import Progress, Say, messages_to, shown_progress

OptionsT = TypeVar("OptionsT", bound="Flags")

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray, ImageArray
    from deformscope.config import AxesConfig, BetaConfig, FieldConfig, ThetaConfig, ViscousConfig, YieldConfig
    from deformscope.config.flags import TipName
    from deformscope.config.options import Flags
    from deformscope.config.rigs import ExportFormat
    from deformscope.runs.calibration import PairArrays
    from deformscope.runs.calibration_result import CalibrationResult
    from deformscope.runs.catalog import CatalogResult, ComparedRecordings
    from deformscope.runs.classification_report import ClassificationResult, TableSource
    from deformscope.runs.exploration_result import ExplorationResult
    from deformscope.runs.exploration_run import OwnScene, TouchPlanner
    from deformscope.runs.indentation import CurveArrays, IndentResult
    from deformscope.runs.materials import MaterialResult
    from deformscope.runs.prediction import ModelSource, PredictionResult
    from deformscope.runs.recording_report import RecordingReport
    from deformscope.runs.recordings import ExportResult, OpenDataset, OpenRecording, RecordResult
    from deformscope.runs.replay_result import ReplayResult
    from deformscope.runs.result import FoundResult
    from deformscope.runs.simulation import SimulationResult
    from deformscope.runs.squeeze_result import SqueezeResult
    from deformscope.runs.sweep import SweepResult
    from deformscope.runs.verification import VerifyResult
    from deformscope.stages.squeeze.model import ContentModel

    CalibrationSource: TypeAlias = str | Path | PairArrays | Sequence[str] | Sequence[Path] | Sequence[ImageArray]
    """A video, a folder of frames, a recording, `sample:NAME` or a pair file; image files or images (H, W[, 3]) in
    their order; or a pair as arrays."""


def calibrate_beta(
    source: "CalibrationSource | Sequence[PairArrays]", *, progress: Progress | bool | None = None, **options: object
) -> "CalibrationResult":
    """Find beta, the share of linear deformation, with its interval and a verdict (Thesis eq. 3.13).

    source: see `CalibrationSource`; several pairs are fitted to one value, with thickness_m as pokes of one surface
    progress: called with what is done, how much of it, and of how much; default: shown on stderr where that is a
    terminal or a notebook; True: always, False: never
    options: the flags of `deformscope calibrate beta` by their names (`deformscope.config.BetaConfig`): cluster_size,
    theta, thickness_m, whole_motion, roi, grid, held, px_per_cm, level, seed, fine, record, viewer... Raises InputError
    for what cannot be used, and TypeError for options that it has not."""
    from deformscope.config import BetaConfig

    return _calibrate(BetaConfig, source, options, progress)


def calibrate_theta(
    source: "CalibrationSource | Sequence[PairArrays]", *, progress: Progress | bool | None = None, **options: object
) -> "CalibrationResult":
    """Find theta, how strongly volume is conserved, with its interval and a verdict (Thesis eq. 3.17).

    source: see `CalibrationSource`; several pairs are fitted to one value; progress: see `calibrate_beta`
    options: the flags of `deformscope calibrate theta`: cluster_size, beta, theta_range...
    Raises InputError for what cannot be used, and TypeError for options that it has not."""
    from deformscope.config import ThetaConfig

    return _calibrate(ThetaConfig, source, options, progress)


def _calibrate(
    kind: "type[BetaConfig | ThetaConfig]", source: Any, given: dict[str, Any], progress: Progress | bool | None
) -> "CalibrationResult":
    from deformscope.file_io import ending_of
    from deformscope.runs.calibration import calibrate

    several: list[Any] = [source] if isinstance(source, str | Path | Mapping) else list(source)
    arrays = [] if not several or isinstance(several[0], str | Path) else several
    if arrays:
        pairs = isinstance(arrays[0], Mapping)
        names = [f"pair {number}" for number in range(1, len(arrays) + 1)] if pairs else ["images"]
    else:
        names = [str(one) for one in several]
        pairs = bool(names) and ending_of(names[0]) == ".npz"
    together = pairs and len(names) > 1  # a script that wants one value of each pair calls again
    with _python_names(), shown_progress(progress) as note:
        config = _options(kind, given, sources=names, joint=together)
        return calibrate(config, arrays, progress=note)[0]


def calibrate_axes(
    sources: str | Path | Sequence[str | Path], *, progress: Progress | bool | None = None, **options: object
) -> "MaterialResult":
    """Find a beta along each axis of a material, from images, a recording, or pair files in one fit.

    progress: see `calibrate_beta`; options: the flags of `deformscope calibrate axes`: turn_deg, frame, cluster_size...
    Raises InputError for what cannot be used, and TypeError for options that it has not."""
    from deformscope.config import AxesConfig

    return _calibrate_material(AxesConfig, sources, options, progress)


def calibrate_field(
    sources: str | Path | Sequence[str | Path], *, progress: Progress | bool | None = None, **options: object
) -> "MaterialResult":
    """Find the stiffness of each place of a body relative to the others, from images, a recording, or one pair file.

    progress: see `calibrate_beta`; options: the flags of `deformscope calibrate field`: frame, force_n...
    Raises InputError for what cannot be used, and TypeError for options that it has not."""
    from deformscope.config import FieldConfig

    return _calibrate_material(FieldConfig, sources, options, progress)


def calibrate_yield(
    sources: str | Path | Sequence[str | Path], *, progress: Progress | bool | None = None, **options: object
) -> "MaterialResult":
    """Find the strain at which a body yields, from images, a recording, or a motion file (`sample:press`).

    progress: see `calibrate_beta`; options: the flags of `deformscope calibrate yield`: beta, creep, at, force...
    Raises InputError for what cannot be used, and TypeError for options that it has not."""
    from deformscope.config import YieldConfig

    return _calibrate_material(YieldConfig, sources, options, progress)


def calibrate_viscous(
    sources: str | Path | Sequence[str | Path], *, progress: Progress | bool | None = None, **options: object
) -> "MaterialResult":
    """Find the share of a modulus that relaxes, the relaxation time, and the permanent share, from images, a recording,
    or a motion file.

    progress: see `calibrate_beta`; options: the flags of `deformscope calibrate viscous`: at, released, force...
    Raises InputError for what cannot be used, and TypeError for options that it has not."""
    from deformscope.config import ViscousConfig

    return _calibrate_material(ViscousConfig, sources, options, progress)


def _calibrate_material(
    kind: "type[AxesConfig | FieldConfig | YieldConfig | ViscousConfig]",
    sources: str | Path | Sequence[str | Path],
    options: dict[str, Any],
    progress: Progress | bool | None,
) -> "MaterialResult":
    from deformscope.runs.materials import calibrate_material

    with _python_names(), shown_progress(progress) as note:
        every = [sources] if isinstance(sources, str | Path) else sources
        config = _options(kind, options, sources=list(map(str, every)))
        return calibrate_material(config, progress=note)


def predict(
    model: "ModelSource",
    *,
    at: Sequence[float] | str,
    depth_m: float | None = None,
    force_n: float | None = None,
    tip: "TipName | None" = None,
    size_m: Sequence[float] | str = (),
    points_m: "FloatArray | None" = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
) -> "PredictionResult":
    """Predict a poke that was not fitted: deformed particles, depth and force with its interval.

    model: a file that `calibrate ... --save` wrote, a calibration of a pair or of pokes, or its `model()`
    at: (2,) or (3,) place [m]; depth_m or force_n: its depth [m] or force [N]; tip, size_m: flat (sides), disc or
    sphere (diameter), default the tip of the fit; points_m: (n, 3) points of the surface whose deformed positions are
    predicted too. Raises InputError for unusable input."""
    from deformscope.config.flags import PokeText
    from deformscope.runs.prediction import fitted_model, predicted

    with _python_names():
        if (depth_m is None) == (force_n is None):
            raise InputError("a depth or a force", "both" if depth_m is not None else "neither")
        poke = PokeText(_floats("at", at, ","), tip, _floats("size_m", size_m, "x"), depth_m, force_n)
        return predicted(fitted_model(model), poke, points_m, device)


def _floats(name: str, given: Sequence[float] | str, between: str) -> tuple[float, ...]:
    """Numbers, or their text on the command line. between: the character between two of them there"""
    try:
        return tuple(float(one) for one in (given.split(between) if isinstance(given, str) else given))
    except (TypeError, ValueError):
        raise InputError(f"{name} as numbers, or as text with {between!r} between them", repr(given)) from None


def simulate(
    source: str | Path, *, out: Path | str, progress: Progress | bool | None = None, **options: object
) -> "SimulationResult | FoundResult":
    """Write a measured slab or block as a body of another simulator, and fit its parameters to what was seen.

    source: a model file of layers, or a recording (exploration, pair); out: a folder; progress: as in `calibrate_beta`
    options: the flags of `deformscope simulate` by their names (`deformscope.config.SimulateConfig`): target, against,
    poke, tip, vertices, python... Raises InputError for what cannot be used, and TypeError for options that it has
    not."""
    from deformscope.config import SimulateConfig
    from deformscope.runs.simulation import simulate as simulated

    with _python_names(), shown_progress(progress) as note:
        return simulated(_options(SimulateConfig, options, source=source, out=out), note)


def indent(
    sources: "str | Path | CurveArrays | Sequence[str | Path] | Sequence[CurveArrays]", *, tip: str, **options: object
) -> "IndentResult":
    """Find Young's modulus from force over depth of a rigid tip alone; several sources are places of one sample.

    sources: tables, recordings, or curves as arrays {"depth_m": (n,), "force_n": (n,), "time_s": (n,)}
    tip: "sphere:DIAMETER", "disc:DIAMETER" or "flat:AxB" [m], "cone:HALF_ANGLE" [deg]
    options: the flags of `deformscope indent` by their names (`deformscope.config.IndentConfig`): thickness_m, bonded,
    sliding, poisson, machine_n_per_mm, force_column... Raises InputError for what cannot be used, and TypeError for
    options that it has not."""
    from deformscope.config import IndentConfig
    from deformscope.runs.indentation import indent as fitted

    several: list[Any] = [sources] if isinstance(sources, str | Path | Mapping) else list(sources)
    arrays = [one for one in several if isinstance(one, Mapping)]
    names = [f"curve {number}" for number in range(1, len(arrays) + 1)] or [str(one) for one in several]
    with _python_names():
        return fitted(_options(IndentConfig, options, sources=names, tip=tip), arrays)


def certify(
    rig: str | Path, *, sample: str | Path, progress: Say | bool | None = None, **options: object
) -> "FoundResult":
    """Find a rig's bias on a sample of known modulus, by cause.

    rig: a rig file (.toml), or `lab:block-162`; sample: a silicone by name, or the JSON of `deformscope indent`
    progress: as in `explore`; options: the flags of `deformscope certify` by their names
    (`deformscope.config.CertifyConfig`): touches, thickness_m, sliding, save, seed, record, yes... Raises InputError
    for unusable input, TypeError for options that it has not, and SystemExit if it was stopped before its end."""
    from deformscope.config import CertifyConfig
    from deformscope.runs.arm_calibration import touch_known
    from deformscope.runs.result import FoundResult

    with _python_names(), _messages(rig, progress):
        config = _options(CertifyConfig, options, rig=str(rig), sample=str(sample))
        found = touch_known(config)
    return FoundResult({"kind": found.kind, **found.found}, found.findings(config.rig).tables)


def explore(
    rig: "str | Path | OwnScene",
    *,
    planner: "TouchPlanner | None" = None,
    progress: Say | bool | None = None,
    **options: object,
) -> "ExplorationResult":
    """Map the stiffness of a surface: look, touch the most informative place, update the map, repeat.

    rig: a rig file (.toml), a simulated scene (`lab:NAME`), or an own scene; planner: an own planner,
    which chooses all touches
    progress: called with each line about checks and touches; default: they are printed on stderr where that is a
    terminal or a notebook; True: always, False: never; without it those of a rig file always, unless there is a
    function
    options: the flags of `deformscope explore` by their names (`deformscope.config.ExploreConfig`): touches, goal,
    set_force, beta_model, hold, pace, seed, record, viewer, yes... Raises InputError for unusable input,
    TypeError for options that it has not, and SystemExit if the exploration was stopped before its end."""
    from deformscope.config import ExploreConfig
    from deformscope.runs.exploration_run import explore_on

    scene = None if isinstance(rig, str | Path) else rig
    with _python_names():
        rig = f"lab:{rig.name}" if not isinstance(rig, str | Path) else rig
        config = _options(ExploreConfig, options, rig=str(rig))
        with _messages(rig, progress):
            explored = explore_on(config, lambda explored: None, planner, scene)
    if explored is None:
        raise InputError("an exploration", "none: it ended before the arm could move")
    return explored


def squeeze(rig: str | Path, *, progress: Say | bool | None = None, **options: object) -> "SqueezeResult":
    """Squeeze a container once, and compute its features; with `model`, classify its content.

    rig: a rig file (.toml), or `lab:containers`; progress: as in `explore`
    options: the flags of `deformscope squeeze` by their names (`deformscope.config.SqueezeConfig`): content, container
    (the laboratory draws them if they are empty), dataset, keep, model, place, seed, record, yes... Raises InputError
    for unusable input, and for a squeeze that did not reach its steady state (a data set stores it as discarded, with
    the reason); TypeError for options that it has not; KeyboardInterrupt if Ctrl-C ended it."""
    from deformscope.config import SqueezeConfig
    from deformscope.runs.squeeze_run import leave, squeeze_on

    with _python_names():
        config = _options(SqueezeConfig, options, rig=str(rig))
        with _messages(rig, progress):
            squeezed = squeeze_on(config, lambda result: None)
            if squeezed.interrupted:
                raise KeyboardInterrupt
            leave(squeezed)
    return squeezed.result


def record(
    rig: str | Path,
    file: Path | str | None = None,
    *,
    seconds: float,
    progress: Say | bool | None = None,
    **options: object,
) -> "RecordResult":
    """Record all devices of a rig for some seconds, with every byte of their wires and all losses.

    rig: a rig file (.toml) or `lab:NAME`; file: an `.rrd`, default `runs/NAME-<stamp>.rrd`
    progress: called with each line about devices, links and rates; default: as in `explore`.
    options: the flags of `deformscope record` by their names (`deformscope.config.RecordConfig`): label, stage,
    overwrite... Raises InputError for what cannot be used, and TypeError for options that it has not."""
    from deformscope.config import RecordConfig
    from deformscope.runs.rig_run import run_rig

    with _python_names(), messages_to(progress):
        config = _options(RecordConfig, options, rig=str(rig), record=file, seconds=seconds)
        return run_rig(config, "none", always_record=True).result


def replay(
    path: Path | str,
    *,
    settings: Mapping[str, object] | Sequence[str] | str | None = None,
    progress: Progress | bool | None = None,
    **options: object,
) -> "ReplayResult":
    """Compute a recording again from its inputs, and compare with the recorded numbers.

    settings: settings of an exploration that replace the recorded ones, by name, or as KEY=VALUE; their results are not
    compared to the bit; progress: as in `calibrate_beta`; options: the flags of `deformscope replay`: record... Raises
    InputError where the numbers differ, or for what cannot be used."""
    from deformscope.config import ReplayConfig
    from deformscope.runs.replay import replay_on

    if isinstance(settings, Mapping):
        settings = [f"{name}={value}" for name, value in settings.items()]
    with _python_names(), shown_progress(progress) as note:
        config = _options(ReplayConfig, options, recording=path, set=settings or ())
        found = replay_on(config, note)
        if found.different is not None:
            raise found.different
    return found


def sweep(
    function: Callable[..., object],
    sources: Path | str | Sequence[Path | str],
    *,
    out: Path | str,
    vary: Mapping[str, Sequence[object]] | None = None,
    executor: Literal["local", "ray"] = "local",
    address: str | None = None,
    workers: int | None = None,
    send: bool = False,
    limit_s: float | None = None,
    progress: Progress | bool | None = None,
    **options: object,
) -> "SweepResult":
    """Call a function with each file as its first argument, in many processes, and store each result when it is done;
    the same call again continues an interrupted one.

    function: function of this library, or of another module; sources: files, or a folder with recordings, pair files
    and videos; out: a folder for tasks.jsonl, results.parquet and index.html; vary: values of options, of which every
    combination is computed
    executor, address: `ray` at a cluster's address; workers: most workers; send: send the file instead of its path
    limit_s: time limit of a task; progress: as in `calibrate_beta`; options: options of the function.
    Raises InputError for what cannot be used; a task that fails is a row of `table`, with the reason."""
    from deformscope.config.executor import ExecutorOptions
    from deformscope.runs.sweep import SweepOptions, call_function, files_in, function_variations, one_thread, sweep_on

    out = Path(out)
    with _python_names(), shown_progress(progress) as note:
        if not isinstance(vary or {}, Mapping):
            raise InputError("vary as a dict of lists of values", repr(vary), "vary={'cluster_size': [3, 4]}")
        how = SweepOptions(ExecutorOptions(executor, address), workers, send, limit_s)
        files: Sequence[Path | str] = files_in(Path(sources), out) if isinstance(sources, str | Path) else list(sources)
        variations = function_variations(function, vary or {}, options)
        return sweep_on(call_function, files, variations, out, how, begin=one_thread, progress=note)


def classify(
    table: "TableSource",
    *,
    merge: Mapping[str, Sequence[str]] | Sequence[str] | str | None = None,
    transfer: Sequence[tuple[str, str] | str] | str = (),
    progress: Progress | bool | None = None,
    **options: object,
) -> "ClassificationResult":
    """Evaluate how well the content is classified from each modality, and from all of them fused.

    table: a file, or `label (N,)`, optional `group (N,)` and (N, ...) features by modality
    merge: classes that are merged, or as NAME=A,B; transfer: (trained, tested) patterns of kinds or groups of
    containers, or as TRAINED:TESTED; progress: as in `calibrate_beta`
    options: the flags of `deformscope classify` by their names (`deformscope.config.ClassifyConfig`): modalities,
    splits, curve_splits, duplicates, level, seed... Raises InputError for what cannot be used, and TypeError for
    options that it has not."""
    from deformscope.config import ClassifyConfig
    from deformscope.config.classify import parse_merges, parse_transfers
    from deformscope.runs.classification_report import classify_table, options_of, table_from

    with _python_names():
        patterns = [transfer] if isinstance(transfer, str) else transfer
        pairs = parse_transfers(tuple(one if isinstance(one, str) else ":".join(one) for one in patterns))
        config = _options(ClassifyConfig, options, may=(), table=Path())
        if merge is not None and not isinstance(merge, Mapping):
            merge = parse_merges((merge,) if isinstance(merge, str) else tuple(merge))
        found = table_from(table, modalities=config.modalities, merge=merge, duplicates=config.duplicates)
        name = str(table) if isinstance(table, str | Path) else ""
        with shown_progress(progress) as note:
            return classify_table(found, name, options_of(config, pairs), note)


def load_classifier(path: Path | str) -> "ContentModel":
    """A classifier that `deformscope classify --save` or `ClassificationResult.save` has written: its `labels`, and
    `predict_proba({modality: (n, p) features})`. Raises InputError for any other file."""
    from deformscope.files import classifier_file

    return classifier_file.load_classifier(Path(path))


def verify(path: Path | str, *, stages: bool = False, privacy: bool = False) -> "VerifyResult":
    """Check whether a recording is whole: `ok`, and `error` with the reason if it is not.

    stages: list its stages of computation; privacy: list information on people and machines. Raises InputError for a
    file that is no recording, or one that a run is writing."""
    from deformscope.runs.verification import verify_recording

    return verify_recording(Path(path), stages=stages, privacy=privacy)


def recover(path: Path | str, out: Path | str | None = None) -> "FoundResult":
    """Make a complete recording from one that was cut short; `found["recovered"]` is its path. out: a new file, default
    NAME.recovered.rrd next to it. Raises InputError if nothing can be read."""
    from deformscope.runs.recovery import recover_recording

    return recover_recording(Path(path), None if out is None else Path(out))


def export(
    path: Path | str, out: Path | str, *, to: "ExportFormat", progress: Progress | bool | None = None, **options: object
) -> "ExportResult":
    """Write a recording in another format; `found["files"]` lists what was written.

    out: a new folder; to: csv, parquet, npz, mcap, video or images; progress: as in `calibrate_beta`
    options: the other fields of `deformscope.config.ExportConfig`: only, camera, anonymous, license, overwrite...
    Raises InputError if something cannot be read or written; then the folder is unchanged."""
    from deformscope.config import ExportConfig
    from deformscope.runs.recordings import export_recording

    with _python_names(), shown_progress(progress) as note:
        config = ExportConfig.of(recording=path, out=out, to=to, **options)
        return export_recording(config, note or (lambda what, done, total: None))


def import_recording(
    source: Path | str, *, map: Path | str, record: Path | str, overwrite: bool = False, **options: object
) -> "RecordResult":
    """Make a recording from a bag, a table, or a folder of them.

    map: a TOML file that assigns topics and columns to devices; `deformscope import --inspect` proposes one; record: a
    new .rrd; options: the other fields of `deformscope.config.ImportConfig`, such as those of stages. Raises InputError
    for missing entries of the map and for wrong data; then no file is left."""
    from deformscope.config import ImportConfig
    from deformscope.runs.importing import import_source

    with _python_names():
        given = {"map": map, "record": record, "overwrite": overwrite, "viewer": "none"}
        return import_source(ImportConfig.of(source=source, **given | options))


def report(path: Path | str) -> "RecordingReport":
    """The figures of a recording, from its content alone: `figures()`, `lacks`, and `page()` as HTML.
    Raises InputError where it is none."""
    from deformscope.runs.recording_report import report_recording

    return report_recording(Path(path))


def catalog(
    folder: Path | str,
    *,
    where: str = "",
    sort: str = "",
    columns: Sequence[str] | str = (),
    progress: Progress | bool | None = None,
) -> "CatalogResult":
    """The recordings of a folder, as `table` (Arrow): settings, results with intervals, losses.

    where: a condition, such as 'beta < 0.5 and verdict == "identified"'; sort: a column, -column for descending
    columns: columns to show; progress: as in `calibrate_beta`. Raises InputError for what cannot be used."""
    from deformscope.runs.catalog import catalogue

    with _python_names(), shown_progress(progress) as note:
        shown = columns.split(",") if isinstance(columns, str) else list(columns)
        return catalogue(Path(folder), where, sort, [one for one in shown if one], progress=note)


def compare_recordings(first: Path | str, second: Path | str, *, corrected: bool = False) -> "ComparedRecordings":
    """How two recordings differ: settings, results, and readings of devices aligned by contact. corrected: without the
    bias that each rig's certificate states. Raises InputError if a file is no recording."""
    from deformscope.runs import catalog as catalogs

    return catalogs.compare_recordings(Path(first), Path(second), corrected=corrected)


def discard(path: Path | str, reason: str, *, episode: int = 0) -> None:
    """Mark a recording, or one of its episodes (from 1), as not to be used, in its ledger. Nothing is deleted.
    Raises InputError if it is no recording, or has no such episode."""
    from deformscope.runs.recordings import OpenRecording

    OpenRecording(Path(path)).discard(reason, episode)


def open_recording(path: Path | str) -> "OpenRecording":
    """Open a recording of deformscope. Raises InputError if it is no recording, or was changed after it was
    recorded."""
    from deformscope.runs.recordings import OpenRecording

    return OpenRecording(Path(path))


def open_dataset(folder: Path | str) -> "OpenDataset":
    """Open a data set that `deformscope squeeze --dataset` has made. Raises InputError where it is none."""
    from deformscope.runs.recordings import OpenDataset

    return OpenDataset(Path(folder))


def _options(
    kind: type[OptionsT], options: Mapping[str, object], may: Sequence[str] = ("--record",), **own: object
) -> OptionsT:
    """The options of a command, from a script's. may: the files that a call writes; results write the others."""
    config = kind.of(**{"viewer": "none", **own, **options})
    if others := [one.flag.strip("-") for one in config.writes() if one.flag not in may]:
        raise TypeError(f"unexpected options: {', '.join(others)}; the result has what these files hold")
    return config


def _messages(rig: str | Path, progress: Say | bool | None) -> AbstractContextManager[None]:
    """Destination of lines about checks and touches: of a rig file they are printed, unless there is a function."""
    return messages_to(progress if str(rig).startswith("lab:") or callable(progress) else True)


@contextmanager
def _python_names() -> Iterator[None]:
    """Errors name parameters as Python spells them: the checks are those of the command line's flags."""
    try:
        yield
    except InputError as error:
        words = re.sub(r"--([a-z][a-z-]*)", lambda flag: flag[1].replace("-", "_"), str(error))
        raise type(error).about(Exception(words), "") from None
