"""Results over a picture: of images, of pairs of particle sets, and of studies."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
import rerun as rr

from deformscope.arrays import ImageArray
from deformscope.frames import ColorFrame
from deformscope.images import JPEG_QUALITY
from deformscope.log.canvas import Canvas
from deformscope.log.estimate import log_comparison, log_estimate
from deformscope.log.findings import RigFindings, log_evidence, log_findings, log_numbers
from deformscope.log.particles import log_flow, log_rest, log_tracked
from deformscope.log.rig import Batch, prepare_items
from deformscope.log.rig.blueprint import rig_blueprint
from deformscope.log.rig.columns import frame_times, root
from deformscope.log.views import OwnView, ShownStage, Views, views_of
from deformscope.pictures.close_up import close_up
from deformscope.pictures.report import Findings
from deformscope.stages.fit.estimate import Comparison, Estimate
from deformscope.stages.materials.axis_estimate import AxisEstimate
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.recovery import RecoveryEstimate
from deformscope.stages.materials.yield_estimate import YieldEstimate
from deformscope.stages.poke.certificate import RigBias
from deformscope.stages.poke.indentation import IndentEstimate
from deformscope.stages.see.flow import FlowField
from deformscope.stages.see.particles import ParticleGrid, Tracked
from deformscope.stages.see.triangulation import spacing_of

FLOW, PARTICLES, TRACKING, SIMULATION, ESTIMATE, FINDINGS = (
    ShownStage(name, 3, gives, entity=entity)
    for name, gives, entity in (
        ("flow", "optical flow since the frame before", "flow/arrows"),
        ("particles", "at rest", "particles/rest"),
        ("tracking", "particles where they were seen (eq. 3.20)", "particles/observed"),
        ("simulation", "particles of the best value, and their error (eq. 3.18)", "particles/simulated"),
        ("estimate", "value, interval, verdict and error curve", "calibration/estimate"),
        ("findings", "tables and pictures", "found/tables"),
    )
)
CURVES = ShownStage("curves", 4, "modulus by each curve", entity="calibration/estimate", when="indented")
OF_APPLICATION: dict[str | None, tuple[type, ...]] = {
    "images": (FlowField, ParticleGrid, Tracked, Comparison, Estimate),
    "flow": (FlowField,),
    "pair": (Comparison, Estimate),
    "pair-3d": (Comparison, Estimate),
    None: (Findings, IndentEstimate),
}
"""The types of result that recordings of each layout hold."""


def log_over_picture(rec: rr.RecordingStream, shown: Sequence[tuple[object, Canvas]]) -> None:
    """Log results at the stream's present time, each drawn for its canvas."""
    for result, canvas in shown:
        if isinstance(result, OwnView):
            result.log(rec)
            continue
        for view in views_of(type(result), picture_views(canvas)):
            view(rec, result)


def picture_views(canvas: Canvas) -> Views[rr.RecordingStream]:
    """The view of each result on this canvas."""
    numbers = (ESTIMATE, partial(log_numbers, canvas=canvas))
    findings = log_findings if canvas == Canvas() else partial(log_evidence, canvas=canvas)
    return {
        FlowField: (FLOW, partial(log_flow, canvas=canvas)),
        ParticleGrid: (PARTICLES, lambda rec, grid: log_rest(rec, grid.rest_px, canvas)),
        Tracked: (TRACKING, partial(log_tracked, canvas=canvas)),
        Comparison: (SIMULATION, partial(log_comparison, canvas=canvas)),
        Estimate: (ESTIMATE, partial(log_estimate, canvas=canvas)),
        Findings: (FINDINGS, findings),
        RigFindings: (FINDINGS, lambda rec, one: log_findings(rec, one.found, rig_blueprint(one.streams))),
        IndentEstimate: (CURVES, partial(log_numbers, canvas=canvas)),
        **dict.fromkeys((AxisEstimate, FieldEstimate, YieldEstimate, RecoveryEstimate, RigBias), numbers),
    }


def canvas_after(result: object, canvas: Canvas) -> Canvas:
    """The canvas after this result: some results state the particles' positions and spacing."""
    match result:
        case ParticleGrid():
            return dataclasses.replace(canvas.around(result.rest_px), spacing=spacing_of(result.rest_px))
        case Tracked():
            return canvas.around(result.position_px[result.seen])
        case Comparison():
            return _around_pair(result, canvas)
        case _:
            return canvas


def _around_pair(result: Comparison, canvas: Canvas) -> Canvas:
    """A pair brings its own picture: in the plane with y upwards, in space the part where something moved."""
    if canvas.image:
        return canvas if canvas.spacing else dataclasses.replace(canvas, spacing=spacing_of(result.rest))
    spacing = spacing_of(result.rest)
    if result.rest.shape[1] == 2:
        upwards = np.array([1.0, -1.0])
        every = np.concatenate([result.rest, result.observed[result.seen], result.simulated]) * upwards
        return dataclasses.replace(Canvas().around(every), spacing=spacing, origin=(0.0, 0.0), scale=(1.0, -1.0))
    shown = close_up(result)
    if not shown.surface:
        return Canvas(low=tuple(shown.low.tolist()), high=tuple(shown.high.tolist()), spacing=spacing)
    origin, scale = shown.middle, np.array([1.0, 1.0, shown.heights])
    return Canvas(
        low=tuple(((shown.low - origin) * scale).tolist()),
        high=tuple(((shown.high - origin) * scale).tolist()),
        spacing=spacing,
        origin=tuple(origin.tolist()),
        scale=tuple(scale.tolist()),
    )


# The images of a sequence: recorded without loss, and the picture below the results

DISPLAY = "display/image"


def canvas_of(frame: ColorFrame) -> Canvas:
    """The picture on which results are drawn."""
    height, width = frame.image.shape[:2]
    path = root("color", frame.device) if frame.image.dtype == np.uint8 else DISPLAY
    return Canvas(low=(0.0, 0.0), high=(float(width), float(height)), image=path)


def range_of(image: ImageArray) -> tuple[float, float]:
    """The darkest and the brightest value of an image (h, w) or (h, w, 3), at least 1 apart."""
    return float(image.min()), max(float(image.max()), float(image.min()) + 1.0)


def prepare_image(frame: ColorFrame, start_ns: int, limits: tuple[float, float], *, lossless: bool) -> Batch:
    """Prepare one image for a recording or, with losses, for a live view. start_ns: host time at which
    `session` is 0 [ns]; limits: range that is mapped to 8 bits if the image has 16, as viewers do not show these"""
    batch = Batch()
    eight = frame.image.dtype == np.uint8
    if eight or lossless:
        batch = prepare_items([frame], start_ns, (), {frame.device} if lossless else ())
    if not eight:
        low, high = limits
        spread = ((frame.image.astype(np.float32) - low) * (255.0 / (high - low))).clip(0, 255).astype(np.uint8)
        ordered = spread if spread.ndim == 2 else spread[..., ::-1]
        jpeg = cv2.imencode(".jpg", ordered, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
        columns = rr.EncodedImage.columns(blob=[jpeg], media_type=["image/jpeg"], draw_order=[-10.0])
        batch.send_columns(DISPLAY, frame_times([frame], start_ns), columns)
    return batch
