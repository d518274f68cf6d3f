"""Results over a picture: of images, of pairs of particle sets, and of studies.

Results of a calibration: simulated against observed particles, their residuals, the model's error over the body, the
error curve with the posterior, the verdict.

Particles over the image: at rest, where they were seen, and those that were lost; optical flow as arrows."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
import rerun as rr

from deformscope.arrays import BoolArray, FloatArray, ImageArray
from deformscope.frames import ColorFrame
from deformscope.images import JPEG_QUALITY
from deformscope.log.canvas import (
    LABEL,
    Canvas,
    deep_bar,
    log_color_bar,
    log_deep_legend,
    log_labels,
    log_legend,
    log_place,
    sides_of,
)
from deformscope.log.findings import RigFindings, log_evidence, log_findings, log_numbers
from deformscope.log.rig import Batch, prepare_items
from deformscope.log.rig.blueprint import rig_blueprint
from deformscope.log.rig.columns import frame_times, root
from deformscope.log.views import OwnView, ShownStage, Views, views_of
from deformscope.pictures.close_up import close_up
from deformscope.pictures.evidence import errors, evidence_png
from deformscope.pictures.messages import estimate_tables
from deformscope.pictures.palette import HELD, LOST, OBSERVED, REST, SIMULATED, Rgb, colors, readable, round_up
from deformscope.pictures.report import Findings, Table, cell_text, table_markdown
from deformscope.rows import to_components
from deformscope.stages.fit.estimate import Comparison, Estimate
from deformscope.stages.fit.particle_frame import ParticleFrame, particle_frame
from deformscope.stages.materials.axis_estimate import AxisEstimate
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.recovery import RecoveryEstimate
from deformscope.stages.materials.yield_estimate import YieldEstimate
from deformscope.stages.poke.certificate import RigBias
from deformscope.stages.poke.indentation import IndentEstimate
from deformscope.stages.see.flow import FlowField
from deformscope.stages.see.particles import ParticleGrid, Tracked
from deformscope.stages.see.triangulation import raster, spacing_of, triangulate
from deformscope.stages.setup.wrench import WrenchWorth

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
EDGE = (30, 30, 30)
REST_RADIUS, OBSERVED_RADIUS, SIMULATED_RADIUS, CROSS = 0.10, 0.22, 0.12, 0.2
"""Shares of the particles' spacing: a simulated particle on its observed one leaves a blue ring around red."""


def log_rest(rec: rr.RecordingStream, rest: FloatArray, canvas: Canvas) -> None:
    """Log rest positions (K, 2) in green."""
    radius = canvas.spacing * REST_RADIUS
    log_place(rec, canvas, "particles/rest")
    rec.log("particles/rest", rr.Points2D(rest, radii=radius, colors=REST, draw_order=30.0))
    log_legend(rec, "particles/legend/rest", canvas, [(0, "rest", REST)])


def log_tracked(rec: rr.RecordingStream, tracked: Tracked, canvas: Canvas) -> None:
    """Log seen particles as blue discs, and lost ones as pale crosses at their last known places."""
    seen = tracked.seen & np.isfinite(tracked.position_px).all(axis=1)
    log_observed(rec, tracked.position_px, seen, canvas)
    rec.log("particles/observed", rr.AnyValues(noise_px=tracked.noise_px, seen=tracked.seen))


def log_observed(
    rec: rr.RecordingStream, position: FloatArray, seen: np.typing.NDArray[np.bool_], canvas: Canvas
) -> None:
    """Log positions (K, 2): blue discs for seen particles, pale crosses for others."""
    lost = ~seen & np.isfinite(position).all(axis=1)
    radius = canvas.spacing * OBSERVED_RADIUS
    log_place(rec, canvas, "particles/observed", "particles/lost")
    rec.log("particles/observed", rr.Points2D(position[seen], radii=radius, colors=OBSERVED, draw_order=40.0))
    rec.log("particles/lost", crosses(position[lost], canvas.spacing * CROSS))
    log_legend(rec, "particles/legend/observed", canvas, [(1.0, "observed", OBSERVED)])
    slot = np.array([canvas.slot(3.0)])
    lost_count = int((~seen).sum())
    if lost_count:
        rec.log("particles/legend/lost", crosses(slot, canvas.mark))
        log_labels(rec, "particles/legend/lost/label", canvas, [(*canvas.slot(3.0), f"lost: {lost_count}")])


def crosses(center: FloatArray, arm: float) -> rr.LineStrips2D:
    """A pale cross with a dark edge, to be seen on any image, at each of (n, 2) places, with arms of length `arm`."""
    diagonal = np.array([[[-1.0, -1.0], [1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]]) * arm
    strips = list((center[:, None, None, :] + diagonal).reshape(-1, 2, 2))
    radii = [arm * 0.42] * len(strips) + [arm * 0.2] * len(strips)
    tints = [EDGE] * len(strips) + [LOST] * len(strips)
    return rr.LineStrips2D(strips + strips, radii=radii, colors=tints, draw_order=55.0)


ARROWS_ALONG = 34
"""Number of arrows along the longer side of the image: more would hide it."""
STILL_PX = 0.25
"""Length below which an arrow would show the flow's noise."""


def log_flow(rec: rr.RecordingStream, flow: FlowField, canvas: Canvas) -> None:
    """Log the motion since the previous frame, at the particles or on a sparse grid, coloured by its length."""
    origin, vector, step_px = _sparse(flow, canvas)
    length_px = np.hypot(vector[:, 0], vector[:, 1])
    end_px = round_up(float(np.max(length_px, initial=0.0)))
    times = _stretch(length_px, step_px)
    moving = length_px >= STILL_PX
    rec.log(
        "flow/arrows",
        rr.Arrows2D(
            origins=origin[moving],
            vectors=vector[moving] * times,
            radii=step_px * 0.08,
            colors=colors(length_px[moving] / end_px),
            draw_order=40.0,
        ),
    )
    log_color_bar(rec, "flow/legend", canvas, end_px, "px")
    note = "arrows at true length" if times == 1 else f"arrows drawn {times:g} times their length"
    log_legend(rec, "flow/legend/note", canvas, [(2.0, note, LABEL)], row=1)


def _sparse(flow: FlowField, canvas: Canvas) -> tuple[FloatArray, FloatArray, float]:
    """(n, 2) origins [px] and (n, 2) vectors [px], and their distance [px]."""
    height, width = flow.flow_px.shape[:2]
    step_px = max(max(height, width) / ARROWS_ALONG, 4.0)
    if canvas.particles is not None:
        # at the particles alone: outside the thing the flow is a guess, often a wild one
        every = -(-len(canvas.particles) // ARROWS_ALONG**2)
        origin, step_px = canvas.particles[::every], max(canvas.spacing, 4.0)
    else:
        x, y = (np.arange(step_px / 2, side - 1, step_px) for side in (width, height))
        origin = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    columns, rows = np.rint(flow.inside(origin)).astype(np.intp).T.clip(0, [[width - 1], [height - 1]])
    vector = flow.flow_px[rows, columns]
    known = np.isfinite(vector).all(axis=1)
    return origin[known], vector[known], step_px


def _stretch(length_px: FloatArray, step_px: float) -> float:
    """How many times longer arrows are drawn, to fill the grid without touching.

    A power of two, so that it stays put from frame to frame and a reader can divide by it."""
    typical = float(np.quantile(length_px, 0.95)) if length_px.size else 0.0
    if typical < STILL_PX:
        return 1.0
    return float(2.0 ** np.floor(np.log2(step_px / typical)))


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
        **dict.fromkeys((AxisEstimate, FieldEstimate, YieldEstimate, RecoveryEstimate, RigBias, WrenchWorth), numbers),
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


RESIDUAL_RADIUS, DEEP_RADIUS, DEEP_OBSERVED_RADIUS = 0.15, 0.13, 0.16
"""Shares of the spacing. In space observed spheres are larger, so that red marks deviations from them."""

NET = 1.2
"""Largest distance, in spacings, of a surface's particles that lines connect."""

CELLS, OVER_IMAGE = 192, 0.75
"""The heat map in the plane: cells along its longer side, and how much of it covers an image."""

BANDS = 32
"""Number of colours of the heat map: enough to see, and small in a file."""

RING: Rgb = (20, 20, 20)


def log_comparison(rec: rr.RecordingStream, comparison: Comparison, canvas: Canvas) -> None:
    """Simulated particles in red with the observed ones, their differences, and the model's error."""
    numbers = to_components(particle_frame(comparison))
    rec.log("particles/observed", rr.DynamicArchetype(ParticleFrame.__name__, components=numbers))
    length = errors(comparison)
    free = np.ones(len(length), dtype=np.bool_)
    free[comparison.held] = False
    _log_error(rec, length, free, comparison.unit)
    known = np.isfinite(length)
    end = round_up(float(np.max(length[known], initial=0.0)))
    if canvas.flat:
        _log_flat(rec, comparison, length, canvas, end)
        _log_flat_heat(rec, comparison, length, canvas, end)
    else:
        _log_deep(rec, comparison, length, canvas, end)
        _log_deep_heat(rec, comparison, length, canvas, end)


def _log_error(rec: rr.RecordingStream, length: FloatArray, free: BoolArray, unit: str) -> None:
    """Log the average Euclidean error of this moment, over all seen particles (Thesis eq. 3.18) and over the free ones.
    length: (K,) error of each particle [unit], NaN where not seen; free: (K,)"""
    known = np.isfinite(length)
    for name, label, color, chosen in (
        ("aee", f"all particles [{unit}]", OBSERVED, known),
        ("aee_free", f"free particles [{unit}]", SIMULATED, known & free),
    ):
        if chosen.any():
            rec.log(f"error/{name}", rr.SeriesLines(colors=color, names=label, widths=2.0), static=True)
            rec.log(f"error/{name}", rr.Scalars(float(length[chosen].mean())))


def _log_flat(rec: rr.RecordingStream, comparison: Comparison, length: FloatArray, canvas: Canvas, end: float) -> None:
    """Log particles and errors of a flat body. length: (K,) error of each particle, NaN where not seen"""
    radius = canvas.spacing
    finite = np.isfinite(comparison.simulated).all(axis=1)
    if not canvas.image:  # a sequence has logged both already, frame by frame
        log_rest(rec, comparison.rest, canvas)
        log_observed(rec, comparison.observed, comparison.seen, canvas)
    log_place(rec, canvas, "particles/simulated", "residual/lines", "residual/points", "residual/held")
    rec.log(
        "particles/simulated",
        rr.Points2D(comparison.simulated[finite], radii=radius * SIMULATED_RADIUS, colors=SIMULATED, draw_order=50.0),
    )
    log_legend(rec, "particles/legend/simulated", canvas, [(2.0, "simulated", SIMULATED)])

    known = np.isfinite(length)
    tints = colors(length[known] / end)
    lines = np.stack([comparison.simulated[known], comparison.observed[known]], axis=1)
    rec.log("residual/lines", rr.LineStrips2D(lines, radii=radius * 0.06, colors=tints, draw_order=40.0))
    rec.log(
        "residual/points",
        rr.Points2D(comparison.observed[known], radii=radius * RESIDUAL_RADIUS, colors=tints, draw_order=41.0),
    )
    rec.log("residual/points", rr.AnyValues(particle=np.flatnonzero(known), residual=length[known]))
    held = comparison.observed[comparison.held]
    held = held[np.isfinite(held).all(axis=1)]
    rec.log("residual/held", rr.Points2D(held, radii=radius * 0.07, colors=HELD, draw_order=42.0))
    log_color_bar(rec, "residual/legend", canvas, end, comparison.unit)
    log_legend(rec, "residual/legend/held", canvas, [(2.0, "held", HELD)], row=1)


def _log_flat_heat(
    rec: rr.RecordingStream, comparison: Comparison, length: FloatArray, canvas: Canvas, end: float
) -> None:
    """Log the error between the particles, as an image over their area, and a ring around the largest. length: (K,)"""
    known = np.isfinite(length)
    if not known.any():
        rec.log("heat", rr.Clear(recursive=True))
        return
    value, low, side = raster(comparison.rest[known], comparison.observed[known], length[known], CELLS)
    band = (np.floor(value / end * BANDS).clip(0, BANDS - 1) + 0.5) / BANDS
    cover = np.where(np.isfinite(value), round(255 * OVER_IMAGE) if canvas.image else 255, 0)
    picture = np.dstack([colors(band.ravel()).reshape(*value.shape, 3), cover.astype(np.uint8)])
    picture[cover == 0] = 0
    picture = np.pad(picture, [(0, CELLS - value.shape[0]), (0, CELLS - value.shape[1]), (0, 0)])
    scale, origin = np.array(canvas.scale or (1.0, 1.0)), np.array(canvas.origin or (0.0, 0.0))
    corner = (low - origin) * scale
    rec.log("heat/map", rr.Transform3D(translation=[*corner, 0.0], scale=[*(side * scale), 1.0]))
    # An opacity below 1 is what makes the viewer blend at all; pictures of one path must all be of one size.
    contents = cv2.imencode(".png", picture[..., [2, 1, 0, 3]], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
    png = rr.EncodedImage(contents=contents, media_type="image/png", opacity=0.99, draw_order=30.0)
    rec.log("heat/map", png, rr.AnyValues(particle=np.flatnonzero(known), error=length[known]))
    log_color_bar(rec, "heat/legend", canvas, end, comparison.unit)
    worst = int(np.nanargmax(length))
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = comparison.observed[worst] + 0.45 * canvas.spacing * np.column_stack([np.cos(angle), np.sin(angle)])
    log_place(rec, canvas, "heat/worst")
    rec.log("heat/worst", rr.LineStrips2D([ring], radii=0.06 * canvas.spacing, colors=RING, draw_order=45.0))
    log_legend(rec, "heat/legend/worst", canvas, [(2.0, _worst(comparison, length), RING)], row=1)


def _worst(comparison: Comparison, length: FloatArray) -> str:
    largest = float(np.nanmax(length))
    factor, unit = readable(comparison.unit, largest)
    return f"largest error: {largest * factor:.3g} {unit}"


def _log_deep(rec: rr.RecordingStream, comparison: Comparison, length: FloatArray, canvas: Canvas, end: float) -> None:
    """Log a body in space: of a surface, the picture's part; the rest goes into the recording alone, where no view
    shows it. length: (K,) error of each particle"""
    radius, surface = canvas.spacing, bool(canvas.scale)
    inside = _inside(comparison, canvas)
    log_place(rec, canvas, *(f"particles/{name}" for name in ("rest", "observed", "simulated", "net")))
    log_place(rec, canvas, "residual/lines", "residual/points")
    for name, position, share, color in (
        ("rest", comparison.rest, 0.05 if surface else REST_RADIUS, REST),
        ("observed", np.where(comparison.seen[:, None], comparison.observed, np.nan), DEEP_OBSERVED_RADIUS, OBSERVED),
        ("simulated", comparison.simulated, REST_RADIUS if surface else DEEP_RADIUS, SIMULATED),
    ):
        finite = np.isfinite(position).all(axis=1)
        rec.log(f"particles/{name}", rr.Points3D(position[finite & inside], radii=radius * share, colors=color))
        if not inside.all():
            rec.log(f"beyond/{name}", rr.Points3D(position[finite & ~inside], colors=color))
    if surface:
        rows = np.flatnonzero(inside & np.isfinite(comparison.simulated).all(axis=1))
        joined = rows[sides_of(triangulate(comparison.rest[rows]))]
        apart = np.linalg.norm(comparison.rest[joined[:, 0]] - comparison.rest[joined[:, 1]], axis=1)
        net = comparison.simulated[np.asarray(joined[apart <= (NET * radius)])]
        rec.log("particles/net", rr.LineStrips3D(net, radii=radius * 0.03, colors=SIMULATED))
    marks = [(0.0, "rest", REST), (0.5, "observed", OBSERVED), (1.0, "simulated", SIMULATED)]
    log_deep_legend(rec, "particles/legend", canvas, marks)
    if drawn := canvas.heights:
        log_deep_legend(rec, "particles/legend/heights", canvas, [(0.5, drawn.strip(", "), RING)], row=1)
    known = np.isfinite(length) & inside
    tints = colors(length[known] / end)
    lines = np.stack([comparison.simulated[known], comparison.observed[known]], axis=1)
    rec.log("residual/lines", rr.LineStrips3D(lines, radii=radius * 0.05, colors=tints))
    rec.log(
        "residual/points", rr.Points3D(comparison.observed[known], radii=radius * DEEP_OBSERVED_RADIUS, colors=tints)
    )
    rec.log("residual/points", rr.AnyValues(particle=np.flatnonzero(known), residual=length[known]))
    log_deep_legend(rec, "residual/legend", canvas, _deep_bar(comparison, end))


def _inside(comparison: Comparison, canvas: Canvas) -> BoolArray:
    """(K,) whether a particle belongs into the picture, seen from above."""
    if not canvas.scale:
        return np.ones(len(comparison.rest), dtype=np.bool_)
    shown = comparison.rest[:, :2] - np.array(canvas.origin[:2])
    low, high = np.array(canvas.low[:2]), np.array(canvas.high[:2])
    grace = 0.1 * canvas.spacing
    return np.asarray(((shown >= low - grace) & (shown <= high + grace)).all(axis=1))


def _log_deep_heat(
    rec: rr.RecordingStream, comparison: Comparison, length: FloatArray, canvas: Canvas, end: float
) -> None:
    """Log the error over the surface or the skin; where there is none, the particles alone. length: (K,)"""
    known = np.flatnonzero(np.isfinite(length) & _inside(comparison, canvas))
    if not known.size:
        rec.log("heat", rr.Clear(recursive=True))
        return
    log_place(rec, canvas, "heat/map")
    place, tints = comparison.observed[known], colors(length[known] / end)
    triangles = triangulate(comparison.rest[known])
    if len(triangles):
        rec.log("heat/map", rr.Mesh3D(vertex_positions=place, triangle_indices=triangles, vertex_colors=tints))
    else:
        rec.log("heat/map", rr.Points3D(place, radii=canvas.spacing * 0.3, colors=tints))
    rec.log("heat/map", rr.AnyValues(particle=known, error=length[known]))
    origin, scale = np.array(canvas.origin or (0.0,) * 3), np.array(canvas.scale or (1.0,) * 3)
    low, high = np.array(canvas.low), np.array(canvas.high)
    at = (comparison.observed[int(known[np.argmax(length[known])])] - origin) * scale
    out = np.array([0.0, 0.0, 1.0]) if canvas.scale else at - 0.5 * (low + high)
    out = out / (float(np.linalg.norm(out)) or 1.0) * 0.15 * float((high - low).max())
    rec.log("heat/worst", rr.LineStrips3D([[at, at + out]], radii=0.06 * canvas.spacing, colors=RING))
    log_deep_legend(rec, "heat/legend", canvas, _deep_bar(comparison, end))
    log_deep_legend(
        rec, "heat/legend/worst", canvas, [(0.5, f"{_worst(comparison, length[known])}{canvas.heights}", RING)], row=1
    )


def _deep_bar(comparison: Comparison, end: float) -> list[tuple[float, str, Rgb]]:
    factor, unit = readable(comparison.unit, end)
    return deep_bar(lambda share: f"{share * end * factor:g} {unit}")


def log_estimate(rec: rr.RecordingStream, estimate: Estimate, canvas: Canvas) -> None:
    """Log the error curve as a chart and as numbers, the verdict as text, and every field of the estimate.

    An estimate over a sequence is logged without a time; that of a pair is at the pair's frame."""
    whole = bool(canvas.image)
    curve = estimate.curve
    chart = rr.EncodedImage(contents=evidence_png(estimate), media_type="image/png")
    rec.log("calibration/chart", chart, static=whole)
    # No BarChart: its tensor keeps a viewer from opening a second recording of this kind next to the first.
    known = np.isfinite(curve.aee)
    points = {estimate.parameter: curve.parameter[known], "aee": curve.aee[known]}
    rec.log("calibration/curve", rr.AnyValues(True, **points), static=whole)
    rec.log("calibration/summary", rr.TextDocument(summary(estimate), media_type=rr.MediaType.MARKDOWN), static=whole)
    rec.log("calibration/estimate", rr.DynamicArchetype("Estimate", components=to_components(estimate)), static=whole)


def summary(estimate: Estimate) -> str:
    """The estimate in a page of Markdown, the verdict in plain words first."""
    used = [(name, cell_text(value)) for name, value in estimate.settings.items() if value is not None]
    tables = [*estimate_tables(estimate, "Numbers"), Table(used, caption="Settings")]
    head = f"# {estimate.parameter} = {estimate.value:.3g}\n\n**{estimate.verdict_text()}**"
    return "\n\n".join([head, *map(table_markdown, tables)])
