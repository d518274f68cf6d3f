"""Beta or theta from a sequence of images."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ImageOptions, OutputOptions, ThetaConfig
from deformscope.config.flags import Selectable
from deformscope.errors import InputError
from deformscope.experiments.fit import calibration_inputs
from deformscope.experiments.fit.foam_video import ParticleOptions, foam_video
from deformscope.experiments.fit.found_body import Draw, found_in
from deformscope.experiments.fit.push_force import PushOptions
from deformscope.experiments.fit.whole_motion import whole_motion
from deformscope.file_io import SAMPLE_SCHEME, replacing
from deformscope.files.sources import DEFAULT_FPS, Source, alike
from deformscope.frames import ColorFrame, InputFile
from deformscope.images import encode_png
from deformscope.log.layout import IMAGES
from deformscope.pictures.evidence import Result
from deformscope.pictures.found_body import found_png
from deformscope.recording.recorder import Recorder
from deformscope.runs.calibration_result import CalibrationResult
from deformscope.runs.force_log import force_file, push_of
from deformscope.runs.result import Note, open_recorder
from deformscope.session import run
from deformscope.stages.fit.calibrate import FitOptions
from deformscope.stages.fit.search import Progress
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.see.find_body import FoundBody
from deformscope.stages.see.particles import clean_mask
from deformscope_drivers.clock import Stamp


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
    push, log = push_of(config.push)
    sources = config.sources
    timed = log is not None or (select is not None and not {"alpha", "dt"}.isdisjoint(select))
    if given and timed and images.fps is None:
        expected = "--fps with --select alpha or dt, or with a log of the force"
        raise InputError(expected, "images without a frame rate", "--fps 30")

    def opened() -> Source:
        return _given_images(given, images) if given else calibration_inputs.opened_images(sources, images, timed=timed)

    if (images.roi is None and images.mask is None) or not any(one.startswith(SAMPLE_SCHEME) for one in sources):
        with opened() as source:
            if config.push.force_frame is not None:
                source.end_at(config.push.force_frame)
            images, found, doubts = found_in(source, images, note, _drawn_to(config.summary.setup_picture, images))
        fit = dataclasses.replace(fit, doubts=doubts, found=found)
    particles = calibration_inputs.particle_options(images, config.search.noise_px)
    masked = images.mask is not None or images.outline is not None
    settings = {"sources": list(sources), "stride": images.stride, "fps": images.fps, "mask": masked}
    settings |= {"camera": images.camera} if images.camera is not None else {}
    settings |= {"outline": list(images.outline)} if images.outline is not None else {}
    with opened() as source:
        settings["timed"] = source.timed
        push, log = calibration_inputs.on_one_clock(source, config, push, log)
        mask = calibration_inputs.mask_of(sources, images, source.size)
        particles = calibration_inputs.thinned(source, particles, config, note, every=select is not None)
        return run_images(source, mask, fit, particles, settings, config.output, select, progress, push, log)


def _drawn_to(path: Path | None, images: ImageOptions) -> Draw | None:
    """Draws what is fitted of the images to a file, if there is one."""
    if path is None:
        return None

    def draw(image: ImageArray, body: FoundBody, text: str) -> None:
        with replacing(path) as file:
            file.write(found_png(image, body, text, images.scale_from))

    return draw


def _given_images(given: Sequence[ImageArray], images: ImageOptions) -> Source:
    kept = list(given)[:: images.stride]
    for one in kept:
        if one.dtype not in (np.uint8, np.uint16) or one.ndim not in (2, 3):
            raise InputError("images (H, W) or (H, W, 3) of uint8 or uint16", f"{one.dtype} {one.shape}")
    kept = list(alike((one, f"image {index}") for index, one in enumerate(kept)))
    period_ns = 1e9 * images.stride / (images.fps or DEFAULT_FPS)
    frames = [ColorFrame(Stamp(round(index * period_ns)), index, image) for index, image in enumerate(kept)]
    return Source("images", lambda: iter(frames), len(frames), timed=images.fps is not None)


def run_images(
    source: Source,
    mask: ImageArray | None,
    fit: FitOptions,
    particles: ParticleOptions,
    settings: dict[str, Any],
    output: OutputOptions,
    select: tuple[Selectable, ...] | None = None,
    progress: Progress | None = None,
    push: PushOptions | None = None,
    log: PressForce | None = None,
) -> CalibrationResult:
    """One sequence through the loop: the same for files, samples and recordings. mask: (H, W) [px], 0 = not the body
    select: the option that is chosen by held-out error, with all frames fitted; None = the last frame is fitted
    push, log: see `foam_video`"""
    used = settings | {"particles": dataclasses.asdict(particles), "fit": dataclasses.asdict(fit)}
    if select is not None:
        used["motion"] = {"select": select}
    if push is not None:
        used["push"] = dataclasses.asdict(push)
    region = None if mask is None else clean_mask(mask)
    experiment = (
        foam_video(particles, fit, region, progress, push, log)
        if select is None
        else whole_motion(particles, fit, select, region, progress)
    )
    last: list[ImageArray] = []
    with images_recorder(source, mask, used, output) as recorder:
        if log is not None:
            recorder.write(force_file(log))
        found = run(frames_of(source, progress, last), experiment, recorder)
    shown = Result(found.estimate, found.comparisons[-1:], ("",), last[0])
    recording, problems = recorder.summary(), tuple(source.problems())
    pair = found.seen[-1], found.model
    return CalibrationResult(
        found.estimate, shown, pair=pair, recording=recording, problems=problems, settings=used, seed=output.seed
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
