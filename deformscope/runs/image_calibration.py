"""Beta or theta from a sequence of images.

The body is found in them where no option names it. A picture shows where it, what holds it and what pushes it are in
the first image."""

import dataclasses
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ImageOptions, OutputOptions, ThetaConfig
from deformscope.config.flags import Selectable
from deformscope.errors import InputError
from deformscope.experiments.fit import calibration_inputs
from deformscope.experiments.fit.push_force import PushOptions
from deformscope.experiments.fit.whole_motion import ParticleOptions, foam_video, whole_motion
from deformscope.file_io import SAMPLE_SCHEME, replacing
from deformscope.files.sources import DEFAULT_FPS, Source, alike
from deformscope.frames import ColorFrame, InputFile
from deformscope.images import encode_png
from deformscope.log.layout import IMAGES
from deformscope.pictures.evidence import Result
from deformscope.pictures.figures import COLOURS, canvas, png_of
from deformscope.recording.recorder import Recorder
from deformscope.runs.calibration_result import CalibrationResult
from deformscope.runs.force_log import force_file, push_of
from deformscope.runs.result import Note, open_recorder
from deformscope.session import run
from deformscope.stages.fit.calibrate import FitOptions
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.search import Progress
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.see.find_body import FoundBody, find_body
from deformscope.stages.see.particles import Rect, clean_mask, outlined, seed_grid, select_held
from deformscope_drivers.clock import Stamp

Draw = Callable[[ImageArray, FoundBody, str], None]

BODY = ("roi", "mask", "outline", "held", "contact")
"""Options that name the body, any of them."""
LOOKED_AT = 7
"""Number of frames, evenly spread, in which the body is sought."""
OUTLINE, CONTACT, HELD, TOOL, SCALE = COLOURS[2], COLOURS[3], COLOURS[4], COLOURS[1], COLOURS[0]


def found_png(image: ImageArray, found: FoundBody, text: str, scale: Sequence[float] | None = None) -> bytes:
    """The first image (H, W[, 3]) with outline, held sides, contact, tool, and the background's motion as arrows.
    scale: x, y of two places [px], and their distance [m]"""
    height, width = image.shape[:2]
    figure = canvas(8.0, 8.0 * height / width + 1.5, layout="constrained")
    axes = figure.subplots()
    axes.imshow(image / max(int(image.max()), 1), cmap="gray")
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) if found.outline is None else found.outline
    for shape, colour, name in ((corners, OUTLINE, "body"), (found.tool, TOOL, "moves as a rigid body")):
        if shape is not None:
            axes.plot(*np.vstack([shape, shape[:1]]).T, color=colour, lw=1.5, label=name)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    ends = {"top": ((left, right), (top, top)), "bottom": ((left, right), (bottom, bottom))}
    ends |= {"left": ((left, left), (top, bottom)), "right": ((right, right), (top, bottom))}
    for part in ends if "border" in found.held else found.held:
        if part in ends:
            axes.plot(*ends[part], color=HELD, lw=5, alpha=0.7, label=f"held: {part}", solid_capstyle="butt")
    if (one := found.contact) is not None:
        x, y = one.x + np.array([0, 1, 1, 0, 0]) * one.width, one.y + np.array([0, 0, 1, 1, 0]) * one.height
        axes.plot(x, y, color=CONTACT, lw=1.5, label="contact")
    if scale is not None:
        axes.plot(scale[:4:2], scale[1:4:2], "|-", color=SCALE, lw=2, label=f"{1e3 * scale[4]:.4g} mm")
    if len(found.background):
        at = np.stack(np.meshgrid(*(np.linspace(0.06, 0.94, 6) * side for side in (width, height))), axis=-1).reshape(
            -1, 2
        )
        moved = at @ (found.background[-1, :, :2].T - np.eye(2)) + found.background[-1, :, 2]
        axes.quiver(*at.T, *moved.T, angles="xy", scale_units="xy", scale=0.1, color=COLOURS[5], width=0.003)
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    axes.legend(loc="upper right", fontsize="small")
    axes.set_title(textwrap.fill(f"{text} Arrows: the background's motion, ten times.", 110), fontsize="small")
    return png_of(figure, 110)


def found_in(
    source: Source, images: ImageOptions, note: Callable[[str], None], draw: Draw | None = None
) -> tuple[ImageOptions, dict[str, object], tuple[Doubt, ...]]:
    """The options with the body that is found in the images, if none is named; what was found, for the record; and the
    doubts. draw: draws both on the first image. Raises InputError for images of two scenes."""
    source.thin(LOOKED_AT)
    seen = [frame.image for frame in source]
    kept = np.unique(np.linspace(0, len(seen) - 1, LOOKED_AT).round().astype(int))
    body = find_body([seen[index] for index in kept])
    if other := next((one for one in body.unfit if one.code in ("scene-cut", "mirrored", "dark")), None):
        wanted = ("images of one scene", other.text, "leave out what is before or after it")
        lit = ("images that can be followed", other.text, "film again with more light")
        raise InputError(*(lit if other.code == "dark" else wanted), source.name)
    unfit = [one for one in body.unfit if one.code != "still"]  # which the fit says with its own numbers
    doubts = [Doubt("unfit-images", one.text, "weak" if one.lowers else None) for one in unfit]
    named = any(getattr(images, one) is not None for one in BODY)
    body = _given(images, body) if named else _usable(body, images, seen[0].shape)
    if draw is not None:
        text = "Given." if named else f"Found: {body.flags()}." + "".join(f" Not sure: {one}." for one in body.doubts)
        draw(seen[0], body, text)
    if named:
        return images, {}, tuple(doubts)
    if body.doubts:
        text = f"not sure what in the images is the body: {', '.join(body.doubts)}"
        doubts.append(Doubt("body-unsure", text, "weak"))
        note(text)
    if body.roi is None:
        return images, {}, tuple(doubts)
    note(f"found in the images: {body.flags()}")
    contact = None if body.contact is None else dataclasses.astuple(body.contact)
    images = dataclasses.replace(
        images, roi=dataclasses.astuple(body.roi), outline=body.corners, held=body.held, contact=contact
    )
    return images, {"flags": body.flags(), "sure": body.sure, "confidence": body.confidence}, tuple(doubts)


def _given(images: ImageOptions, body: FoundBody) -> FoundBody:
    """What the options name, with what was found of background and tool."""
    contact = None if images.contact is None else Rect(*images.contact)
    outline = None if images.outline is None else np.reshape(images.outline, (-1, 2))
    if images.roi is not None and outline is None:
        x, y, width, height = images.roi
        outline = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
    return dataclasses.replace(body, outline=outline, held=images.held_parts(), contact=contact)


def _usable(body: FoundBody, images: ImageOptions, size: tuple[int, ...]) -> FoundBody:
    """The found body, without what has no particles. size: H, W of the images [px]"""
    for one in (body, body.without_contact()):
        if one.corners is None:
            return one
        with suppress(InputError):
            mask = clean_mask(outlined(None, one.corners, (size[0], size[1])))
            select_held(seed_grid(size, one.roi, images.grid, images.spacing_px, mask), one.held, one.contact)
            return one
    return FoundBody(doubts=("region (--outline or --roi)",))


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
