"""A twin for every stage: how its results are shown. The only place, with the recorder, that knows rerun."""

from __future__ import annotations

import dataclasses
import functools

import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.canvas import Canvas
from deformscope.log.estimate import log_comparison, log_estimate
from deformscope.log.findings import RigFindings, log_evidence, log_findings, log_numbers, log_rig_findings
from deformscope.log.flow import log_flow
from deformscope.log.particles import log_grid, log_tracked
from deformscope.pictures.close_up import close_up
from deformscope.pictures.findings import Findings
from deformscope.stages.fit.estimate import Comparison, Estimate
from deformscope.stages.materials.axis_estimate import AxisEstimate
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.recovery_estimate import RecoveryEstimate
from deformscope.stages.materials.yield_estimate import YieldEstimate
from deformscope.stages.see.flow import FlowField
from deformscope.stages.see.particles import ParticleGrid, Tracked
from deformscope.stages.see.triangulation import spacing_of


def log_result(rec: rr.RecordingStream, result: object, canvas: Canvas) -> None:
    """Log one stage's result at the stream's present time, drawn for this canvas."""
    _log(result, rec, canvas)


@functools.singledispatch
def _log(result: object, rec: rr.RecordingStream, canvas: Canvas) -> None:
    raise TypeError(f"no twin in deformscope.log shows a {type(result).__name__}")


@functools.singledispatch
def canvas_with(result: object, canvas: Canvas) -> Canvas:
    """The canvas after this result: some say where the particles are, and how far apart."""
    return canvas


@_log.register
def _(result: FlowField, rec: rr.RecordingStream, canvas: Canvas) -> None:
    log_flow(rec, result, canvas)


@_log.register
def _(result: ParticleGrid, rec: rr.RecordingStream, canvas: Canvas) -> None:
    log_grid(rec, result, canvas)


@_log.register
def _(result: Tracked, rec: rr.RecordingStream, canvas: Canvas) -> None:
    log_tracked(rec, result, canvas)


@_log.register
def _(result: Comparison, rec: rr.RecordingStream, canvas: Canvas) -> None:
    log_comparison(rec, result, canvas)


@_log.register
def _(result: Estimate, rec: rr.RecordingStream, canvas: Canvas) -> None:
    log_estimate(rec, result, canvas)


@_log.register
def _(result: Findings, rec: rr.RecordingStream, canvas: Canvas) -> None:
    if canvas == Canvas():
        log_findings(rec, result)
    else:
        log_evidence(rec, result, canvas)


@_log.register(AxisEstimate)
@_log.register(FieldEstimate)
@_log.register(YieldEstimate)
@_log.register(RecoveryEstimate)
def _(result: object, rec: rr.RecordingStream, canvas: Canvas) -> None:
    log_numbers(rec, result, canvas)


@_log.register
def _(result: RigFindings, rec: rr.RecordingStream, canvas: Canvas) -> None:
    log_rig_findings(rec, result)


@canvas_with.register
def _(result: ParticleGrid, canvas: Canvas) -> Canvas:
    return dataclasses.replace(canvas.around(result.rest_px), spacing=spacing_of(result.rest_px))


@canvas_with.register
def _(result: Tracked, canvas: Canvas) -> Canvas:
    return canvas.around(result.position_px[result.seen])


@canvas_with.register
def _(result: Comparison, canvas: Canvas) -> Canvas:
    """A pair brings its own picture: in the plane with y upwards, in space the part where something moved."""
    import numpy as np

    if canvas.image:
        return canvas if canvas.spacing else dataclasses.replace(canvas, spacing=spacing_of(result.rest))
    spacing = spacing_of(result.rest)
    if result.rest.shape[1] == 2:
        upwards = np.array([1.0, -1.0])
        every = np.concatenate([result.rest, result.observed[result.seen], result.simulated]) * upwards
        return dataclasses.replace(Canvas().around(every), spacing=spacing, origin=(0.0, 0.0), scale=(1.0, -1.0))
    shown = close_up(result)
    if not shown.surface:
        return Canvas(low=_tuple(shown.low), high=_tuple(shown.high), spacing=spacing)
    origin, scale = shown.middle, np.array([1.0, 1.0, shown.heights])
    return Canvas(
        low=_tuple((shown.low - origin) * scale),
        high=_tuple((shown.high - origin) * scale),
        spacing=spacing,
        origin=_tuple(origin),
        scale=_tuple(scale),
    )


def _tuple(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
