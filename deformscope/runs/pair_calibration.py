"""Beta or theta from pairs of shapes."""

import dataclasses
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from deformscope.config import OutputOptions
from deformscope.errors import InputError
from deformscope.experiments.fit.poke_files import LayersOptions, pair_files, poke_files
from deformscope.files.pairs import parse_pair
from deformscope.frames import InputFile
from deformscope.log.layout import PAIR, PAIR_3D
from deformscope.pictures.evidence import Result
from deformscope.runs.calibration_result import CalibrationResult
from deformscope.runs.result import Note, log_note, open_recorder
from deformscope.session import run
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Observation
from deformscope.stages.fit.estimate import Comparison, Estimate
from deformscope.stages.fit.motion import Motion
from deformscope.stages.fit.plausible import size_note
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.clusters import rank
from deformscope.stages.poke.poke_estimate import PokesResult
from deformscope.version import __version__

if TYPE_CHECKING:
    from deformscope.recording.reader import Replay
    from deformscope.recording.recorder import Recorder

BodyT = TypeVar("BodyT", bound=Observation | Motion)
FLAT_SURFACE = "note: a flat surface alone hardly determines beta; --thickness-m fits the material below it"


def arrays_bytes(**arrays: object) -> bytes:
    """The measurements as a file of arrays, so that the recording can be replayed."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **{name: np.asarray(value) for name, value in arrays.items()})
    return file.getvalue()


def recorded_pairs(recording: "Replay") -> list[tuple[str, bytes]]:
    """The pair files in a recording, by name and content."""
    return [(f"{recording.path}, pair {index}", raw) for index, raw in enumerate(recording.read_numbered("pair"))]


def parse_files(
    parse: Callable[..., BodyT], raws: Sequence[tuple[str, bytes]], noise_m: float | None, note: Note
) -> list[BodyT]:
    """Pairs or motions of files given by name and content. A remark is printed for bodies that are unusually large if
    their positions are metres."""
    seen = [parse(raw, name, noise_m=noise_m) for name, raw in raws]
    for remark in filter(None, dict.fromkeys(size_note(one.rest) for one in seen)):
        note(remark)
    return seen


def calibrate_pair_bytes(
    raws: Sequence[tuple[str, bytes]],
    fit: FitOptions,
    output: OutputOptions,
    *,
    noise_m: float | None = None,
    joint: bool = False,
    layers: LayersOptions | None = None,
    note: Note = log_note,
    progress: Progress | None = None,
) -> list[CalibrationResult]:
    """Fit pairs given by name and content: the same for files and recordings. layers: all pairs are pokes of one
    surface, fitted together with the material below it"""
    seen = parse_files(parse_pair, raws, noise_m, note)
    if layers is None and any(one.rest.shape[1] == 3 and rank(one.rest) == 2 for one in seen):
        note(FLAT_SURFACE)

    def say_before(particles: int, spacing_m: float, finest_m: float) -> None:
        if spacing_m > finest_m:
            words = f"{particles} particles, {1e3 * spacing_m:.2g} mm apart"
            note(f"{words}; --fine spaces them {1e3 * finest_m:.2g} mm apart")

    names = [name for name, _ in raws]
    settings: dict[str, Any] = {"sources": names, "noise_m": noise_m, "joint": joint, "fit": dataclasses.asdict(fit)}
    if layers is not None:
        settings["layers"] = dataclasses.asdict(layers)
    with pair_recorder(seen, raws, settings, output) as recorder:
        pokes: PokesResult | None = None
        found: list[Calibration] = []
        if layers is not None:
            provenance = {"deformscope": __version__, "sources": names, "layers": settings["layers"]}
            experiment = poke_files(seen, fit, layers, provenance=provenance, progress=progress, note=say_before)
            pokes = run((), experiment, recorder)
        else:
            found = run((), pair_files(seen, fit, joint=joint, progress=progress), recorder)

    def result(
        estimate: Estimate, comparisons: tuple[Comparison, ...], called: Sequence[str], name: str
    ) -> CalibrationResult:
        shown, recording = Result(estimate, comparisons, tuple(called)), recorder.summary()
        return CalibrationResult(
            estimate, shown, pokes, name=name, recording=recording, settings=settings, seed=output.seed
        )

    if pokes is not None:
        name = names[0] if len(names) == 1 else f"{len(names)} pokes"
        return [result(pokes.estimate, pokes.comparisons, [names[index] for index in pokes.fit.shaped], name)]
    if joint:
        return [result(found[0].estimate, found[0].comparisons, names, "all pairs")]
    return [
        dataclasses.replace(result(one.estimate, one.comparisons, [name], name), pair=(pair, fit.model))
        for name, pair, one in zip(names, seen, found, strict=True)
    ]


@contextmanager
def pair_recorder(
    seen: Sequence[Observation | Motion],
    raws: Sequence[tuple[str, bytes]],
    settings: Mapping[str, object],
    output: OutputOptions,
) -> "Iterator[Recorder]":
    """Records pairs, or a motion, with their unchanged files."""
    planes = {one.rest.shape[1] for one in seen}
    with open_recorder(output, settings, PAIR if planes == {2} else PAIR_3D) as recorder:
        if recorder.active and len(planes) > 1:
            raise InputError("pairs all in the plane, or all in space, in one recording", "both", "two commands")
        for index, (_, raw) in enumerate(raws):
            recorder.write(InputFile("motion" if isinstance(seen[index], Motion) else f"pair/{index}", raw))
        yield recorder
