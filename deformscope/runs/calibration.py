"""Beta or theta from images or pairs of shapes, in files, recordings, samples or arrays."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ImageOptions, OutputOptions, ThetaConfig
from deformscope.config.calibrate import check_arrays
from deformscope.config.flags import Selectable
from deformscope.errors import InputError
from deformscope.experiments.calibration_inputs import (
    fit_options,
    images_of,
    mask_of,
    opened_images,
    particle_options,
)
from deformscope.experiments.foam_video import ParticleOptions, foam_video
from deformscope.experiments.pair_files import pair_files
from deformscope.experiments.poke_files import LayersOptions, poke_files
from deformscope.experiments.whole_motion import whole_motion
from deformscope.file_io import ending_of, read_file
from deformscope.files.model_file import save_model
from deformscope.files.pairs import parse_pair
from deformscope.files.sources import DEFAULT_FPS, Source
from deformscope.frames import ColorFrame, InputFile
from deformscope.images import encode_png
from deformscope.log.application import IMAGES, PAIR, PAIR_3D
from deformscope.pictures.evidence import Result, results_png
from deformscope.pictures.messages import estimate_tables
from deformscope.pictures.report import Figure, Table
from deformscope.plain import Json
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.runs.calibration_report import poke_tables
from deformscope.runs.result import (
    Note,
    SourceResult,
    log_note,
    open_recorder,
)
from deformscope.session import run
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Model, Observation
from deformscope.stages.fit.estimate import Comparison, Doubt, Estimate, Verdict
from deformscope.stages.fit.motion import Motion
from deformscope.stages.fit.plausible import size_note
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.clusters import rank
from deformscope.stages.msm.poke import Law
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.poke.fitted import FittedModel, from_pair
from deformscope.stages.poke.poke_estimate import PokesResult
from deformscope.stages.see.particles import clean_mask
from deformscope.version import __version__
from deformscope_drivers.clock import Stamp

BodyT = TypeVar("BodyT", bound=Observation | Motion)
PairArrays: TypeAlias = Mapping[str, object]
"""A pair by name, as in a pair file: `rest (K, d)`, `deformed (K, d)` [m], `held (n,)`, and a pair file's other
arrays."""

FLOW_S_PER_PX = 5e-7
"""Time of the flow both ways from a frame to the next in steady motion, on two cores [s/px]."""
FOLLOWED_S, FEWEST_FRAMES = 7.5, 16
"""Time limit of tracking a long sequence, and least number of its frames; jumps take up to 7 times that."""
MOST_PARTICLES = 11_000
"""Default number of particles of a fit of layers."""
FLAT_SURFACE = "note: a flat surface alone hardly determines beta; --thickness-m fits the material below it"


@dataclass(frozen=True, slots=True)
class CalibrationResult(SourceResult):
    """Result of `calibrate_beta` or `calibrate_theta`.

    estimate: value, interval, verdicts, error curve; shown: observed and simulated particles
    pokes: pokes of a surface, where layers below it were fitted
    pair: the observation and the model's settings, from which `model` is made, if there was one pair
    """

    estimate: Estimate
    shown: Result
    pokes: PokesResult | None = None
    pair: tuple[Observation, Model] | None = None

    @property
    def value(self) -> float:
        """The parameter with the lowest error."""
        return self.estimate.value

    @property
    def interval(self) -> tuple[float, float]:
        """The parameter's interval, at the estimate's level."""
        return self.estimate.interval

    @property
    def verdict(self) -> Verdict:
        """The verdict on the parameter."""
        return self.estimate.verdict

    @property
    def reasons(self) -> tuple[Doubt, ...]:
        """Why the parameter is doubtful, and its range of validity; reasons that lower the verdict first."""
        return self.estimate.reasons

    def __repr__(self) -> str:
        low, high = self.interval
        return f"<{self.estimate.parameter} {self.value:.4g}, {low:.4g} to {high:.4g}: {self.verdict}>"

    def model(self) -> FittedModel:
        """A model that `deformscope.predict` can poke. Raises InputError if the source has no scale in metres."""
        if self.pokes is not None:
            return self.pokes.model
        if self.pair is None:
            raise InputError("a result of one pair, or of pokes of a surface", "several pairs, or images")
        (seen, model), found = self.pair, self.estimate
        beta, theta = (found.value, model.theta) if model.parameter == "beta" else (model.beta, found.value)
        law = Law(beta, theta, model.cluster_size, model.basis, model.volume)
        stiffness = None if found.stiffness is None else found.stiffness[0]
        error_m = found.aee_free * (found.metres_per_unit or 1.0)
        return from_pair(seen, law, stiffness, error_m, {"deformscope": __version__, "sources": [self.name]})

    def save(self, path: Path | str) -> None:
        """Write `model()` as a file (.npz) for `deformscope predict`."""
        save_model(self.model(), Path(path))

    def picture(self) -> bytes:
        """Particles, the model's error over the body, error curve and posterior, as PNG."""
        return results_png([self.shown])

    def as_json(self) -> Json:
        found = self.estimate.as_json()
        if self.pokes is not None:
            found |= {"pokes": self.pokes.rows(), "tried": self.pokes.tried_json()}
            found |= {"field": self.pokes.model.field_kind, "model": None}
        return self.with_problems(found)

    def tables(self) -> tuple[Table, ...]:
        parameter, rows = self.estimate.parameter, self.source_rows()
        title = f"{parameter} of {self.name}" if self.name else f"Estimate of {parameter}"
        first, *others = estimate_tables(self.estimate, title)
        tables = [Table([*first.rows, *rows], caption=first.caption), *others]
        if self.pokes is not None:
            tables += poke_tables(self.pokes)
        return tuple(tables)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(self.picture(), self.estimate.verdict_text()),)


def calibrate(
    config: BetaConfig | ThetaConfig,
    given: Sequence[PairArrays] | Sequence[ImageArray] = (),
    *,
    note: Note = log_note,
    progress: Progress | None = None,
) -> list[CalibrationResult]:
    """Fit the sources of the options, or given pairs or images (H, W[, 3]) [0..255]; one result, or one for each of
    several pairs."""
    quiet_warp()
    sources, search, output = config.sources, config.search, config.output
    check_arrays(sources, config.images, search.noise_px, "pair files")  # a page sets both until its fit is made
    fit = fit_options(config)
    layers = _layers(config)
    select: tuple[Selectable, ...] | None = None
    if isinstance(config, BetaConfig) and config.motion.whole_motion:
        select = config.motion.select or ()
    if given and isinstance(given[0], Mapping):
        raws = [(name, arrays_bytes(**one)) for name, one in zip(sources, given, strict=True)]  # type: ignore[arg-type]
    elif ending_of(sources[0]) == ".npz":
        raws = [(path, read_file(path, "a pair file (.npz)")) for path in sources]
    elif given or len(sources) > 1 or Path(sources[0]).suffix.lower() != ".rrd":
        raws = []
    else:
        raws = recorded_pairs(Replay(Path(sources[0])))
    if raws and select is not None:
        raise InputError("images with --whole-motion", "pair files", "--joint fits one value to all pairs")
    if raws:
        save = config.model.save is not None
        if save and layers is None and len(raws) > 1:
            expected = "one pair file with --save, or --thickness-m with several pokes of a surface"
            raise InputError(expected, str(len(raws)))
        return calibrate_pair_bytes(
            raws, fit, output, noise_m=search.noise_m, joint=search.joint, layers=layers, note=note, progress=progress
        )
    for flag, used in (
        ("--thickness-m", layers is not None),
        ("--save", config.model.save is not None),
        ("--joint", search.joint),
    ):
        if used:
            raise InputError(f"pair files with {flag}", "images", f"leave out {flag}")
    if search.noise_m is not None:
        raise InputError("--noise-px for images", "--noise-m", "give the noise in pixels")
    images = images_of(config)
    rated = images.fps is not None or (len(sources) == 1 and not given and not Path(sources[0]).is_dir())
    if select is not None and {"alpha", "dt"} & set(select) and not rated:
        raise InputError("--fps with --select alpha or dt", "images without a frame rate", "--fps 30")
    return [calibrate_images(config, images, fit, select, given, progress, note)]  # type: ignore[arg-type]


def _thinned(source: Source, particles: ParticleOptions, every: bool, note: Note) -> ParticleOptions:
    """A long sequence is thinned, unless all frames are requested; the number of frames is announced."""
    each_s, count = FLOW_S_PER_PX * float(np.prod(source.size)), source.count or 0
    if count <= (most := max(FEWEST_FRAMES, round(FOLLOWED_S / each_s))):
        return particles
    if every:
        note(f"{count} frames are tracked")
        return particles
    source.thin(most)
    note(f"{most} of {count} frames are tracked, evenly spread; --fine tracks all")
    return dataclasses.replace(particles, frames_of=count)


def _layers(config: BetaConfig | ThetaConfig) -> LayersOptions | None:
    if not isinstance(config, BetaConfig) or config.layers.thickness_m is None:
        return None
    most = None if config.search.fine else MOST_PARTICLES
    own = {"cluster_size": config.cluster_size, "theta": config.theta, "most_particles": most}
    return LayersOptions(**config.layers.shared(LayersOptions) | own)


def arrays_bytes(**arrays: object) -> bytes:
    """The measurements as a file of arrays, so that the recording can be replayed."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **{name: np.asarray(value) for name, value in arrays.items()})
    return file.getvalue()


# Images --------------------------------------------------------------------------------------------------------------


def calibrate_images(
    config: BetaConfig | ThetaConfig,
    images: ImageOptions,
    fit: FitOptions,
    select: tuple[Selectable, ...] | None,
    given: Sequence[ImageArray],
    progress: Progress | None,
    note: Note,
) -> CalibrationResult:
    """Fit a sequence of files, or of the given images (H, W[, 3]), and record it on request. images: how they become
    particles; select: as in `run_images`"""
    sources, particles = config.sources, particle_options(images, config.search.noise_px)
    masked = images.mask is not None or images.outline is not None
    settings = {"sources": list(sources), "stride": images.stride, "fps": images.fps, "mask": masked}
    settings |= {"camera": images.camera} if images.camera is not None else {}
    settings |= {"outline": list(images.outline)} if images.outline is not None else {}
    opened = _given_images(given, images) if given else opened_images(sources, images)
    with opened as source:
        mask = mask_of(sources, images, source.size)
        every = config.search.fine or select is not None or images.stride != 1
        particles = _thinned(source, particles, every, note)
        return run_images(source, mask, fit, particles, settings, config.output, select, progress)


def _given_images(given: Sequence[ImageArray], images: ImageOptions) -> Source:
    kept = list(given)[:: images.stride]
    if kept and any(one.shape != kept[0].shape or one.dtype != kept[0].dtype for one in kept):
        raise InputError("images of one size and type", "several", "crop them alike")
    if kept and (kept[0].dtype not in (np.uint8, np.uint16) or kept[0].ndim not in (2, 3)):
        raise InputError("images (H, W) or (H, W, 3) of uint8 or uint16", f"{kept[0].dtype} {kept[0].shape}")
    period_ns = 1e9 * images.stride / (images.fps or DEFAULT_FPS)
    frames = [ColorFrame(Stamp(round(index * period_ns)), index, image) for index, image in enumerate(kept)]
    return Source("images", lambda: iter(frames), len(frames))


def run_images(
    source: Source,
    mask: ImageArray | None,
    fit: FitOptions,
    particles: ParticleOptions,
    settings: dict[str, Any],
    output: OutputOptions,
    select: tuple[Selectable, ...] | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """One sequence through the loop: the same for files, samples and recordings. mask: (H, W) [px], 0 = not the body
    select: the option that is chosen by held-out error, with all frames fitted; None = the last frame is fitted"""
    used = settings | {"particles": dataclasses.asdict(particles), "fit": dataclasses.asdict(fit)}
    if select is not None:
        used["motion"] = {"select": select}
    region = None if mask is None else clean_mask(mask)
    experiment = (
        foam_video(particles, fit, region, progress)
        if select is None
        else whole_motion(particles, fit, select, region, progress)
    )
    last: list[ImageArray] = []
    with images_recorder(source, mask, used, output) as recorder:
        found = run(frames_of(source, progress, last), experiment, recorder)
    shown = Result(found.estimate, found.comparisons[-1:], ("",), last[0])
    recording, problems = recorder.summary(), tuple(source.problems())
    return CalibrationResult(
        found.estimate, shown, recording=recording, problems=problems, settings=used, seed=output.seed
    )


def frames_of(source: Source, progress: Progress | None, last: list[ImageArray] | None = None) -> Iterator[ColorFrame]:
    """All frames of a sequence, each reported to `progress` when it is done. last: the last image, if given"""
    for done, frame in enumerate(source):
        if last is not None:
            last[:] = [frame.image]
        yield frame
        if progress is not None:
            progress("frames", done + 1, source.count or 0)


@contextmanager
def images_recorder(
    source: Source, mask: ImageArray | None, settings: Mapping[str, object], output: OutputOptions
) -> Iterator[Recorder]:
    """Records a sequence, its mask, and at the end the damage of the source."""
    with open_recorder(output, settings, IMAGES) as recorder:
        if mask is not None:
            recorder.write(InputFile("mask", encode_png(mask)))
        yield recorder
        if problems := source.problems():
            recorder.stopped_because(f"with the readable part of {source.name}: {'; '.join(problems)}")


# Pairs ---------------------------------------------------------------------------------------------------------------


def recorded_pairs(recording: Replay) -> list[tuple[str, bytes]]:
    """The pair files in a recording, by name and content."""
    return [(f"{recording.path}, pair {index}", raw) for index, raw in enumerate(recording.read_pair_bytes())]


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
) -> Iterator[Recorder]:
    """Records pairs, or a motion, with their unchanged files."""
    planes = {one.rest.shape[1] for one in seen}
    with open_recorder(output, settings, PAIR if planes == {2} else PAIR_3D) as recorder:
        if recorder.active and len(planes) > 1:
            raise InputError("pairs all in the plane, or all in space, in one recording", "both", "two commands")
        for index, (_, raw) in enumerate(raws):
            recorder.write(InputFile("motion" if isinstance(seen[index], Motion) else f"pair/{index}", raw))
        yield recorder
