"""What a calibration found: simulated against observed particles, their residuals, the error curve, the verdict."""

from __future__ import annotations

import io
import json
import math
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.canvas import (
    HELD,
    OBSERVED,
    REST,
    SIMULATED,
    Canvas,
    colors,
    log_color_bar,
    log_legend,
    readable,
    round_up,
)
from deformscope.log.particles import REST_RADIUS, SIMULATED_RADIUS, log_observed, log_rest
from deformscope.plain import plain
from deformscope.stages.estimate import Comparison, Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RESIDUAL_RADIUS, DEEP_RADIUS, DEEP_OBSERVED_RADIUS = 0.15, 0.13, 0.16
"""Shares of the spacing. In space observed spheres are larger, so that red is what departs from them."""
ERROR, INTERVAL, MINIMUM = "#1f5fd0", "#9db8e8", "#d92b2b"
"""Of the chart: the curve, the shaded interval, the marked minimum."""


def log_comparison(rec: rr.RecordingStream, comparison: Comparison, canvas: Canvas) -> None:
    """Simulated particles in red beside the observed ones, and what separates them."""
    residual = comparison.observed - comparison.simulated
    length = np.where(comparison.seen, np.linalg.norm(residual, axis=1), np.nan)
    free = np.ones(len(length), dtype=np.bool_)
    free[comparison.held] = False
    _log_error(rec, length, free, comparison.unit)
    if canvas.flat:
        _log_flat(rec, comparison, length, canvas)
    else:
        _log_deep(rec, comparison, length, canvas)


def _log_error(rec: rr.RecordingStream, length: FloatArray, free: np.typing.NDArray[np.bool_], unit: str) -> None:
    """The average Euclidean error of this moment, over all seen particles (Thesis eq. 3.18) and over the free ones."""
    known = np.isfinite(length)
    for name, label, color, chosen in (
        ("aee", f"all particles [{unit}]", OBSERVED, known),
        ("aee_free", f"free particles [{unit}]", SIMULATED, known & free),
    ):
        if chosen.any():
            rec.log(f"error/{name}", rr.SeriesLines(colors=color, names=label, widths=2.0), static=True)
            rec.log(f"error/{name}", rr.Scalars(float(length[chosen].mean())))


def _log_flat(rec: rr.RecordingStream, comparison: Comparison, length: FloatArray, canvas: Canvas) -> None:
    radius = canvas.spacing
    finite = np.isfinite(comparison.simulated).all(axis=1)
    if not canvas.image:  # a sequence has logged both already, frame by frame
        log_rest(rec, comparison.rest, canvas)
        log_observed(rec, comparison.observed, comparison.seen, canvas, "particles")
    rec.log(
        "particles/simulated",
        rr.Points2D(comparison.simulated[finite], radii=radius * SIMULATED_RADIUS, colors=SIMULATED, draw_order=50.0),
    )
    log_legend(rec, "particles/legend/simulated", canvas, [(2.0, "simulated", SIMULATED)])

    known = np.isfinite(length) & finite
    end = round_up(float(np.max(length[known], initial=0.0)))
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


def _log_deep(rec: rr.RecordingStream, comparison: Comparison, length: FloatArray, canvas: Canvas) -> None:
    radius = canvas.spacing
    known = np.isfinite(length) & np.isfinite(comparison.simulated).all(axis=1)
    for name, position, share, color in (
        ("rest", comparison.rest, REST_RADIUS, REST),
        ("observed", comparison.observed[comparison.seen], DEEP_OBSERVED_RADIUS, OBSERVED),
        ("simulated", comparison.simulated, DEEP_RADIUS, SIMULATED),
    ):
        finite = position[np.isfinite(position).all(axis=1)]
        rec.log(f"particles/{name}", rr.Points3D(finite, radii=radius * share, colors=color))
    end = round_up(float(np.max(length[known], initial=0.0)))
    tints = colors(length[known] / end)
    lines = np.stack([comparison.simulated[known], comparison.observed[known]], axis=1)
    rec.log("residual/lines", rr.LineStrips3D(lines, radii=radius * 0.05, colors=tints))
    rec.log(
        "residual/points", rr.Points3D(comparison.observed[known], radii=radius * DEEP_OBSERVED_RADIUS, colors=tints)
    )
    rec.log("residual/points", rr.AnyValues(particle=np.flatnonzero(known), residual=length[known]))
    factor, unit = readable(comparison.unit, end)
    legend = (
        "**green** rest, **blue** observed, **red** simulated (seen where it departs from blue)\n\n"
        f"residuals: dark blue 0 {unit}, red {end * factor / 2:g} {unit}, yellow {end * factor:g} {unit}"
    )
    rec.log("residual/legend", rr.TextDocument(legend, media_type=rr.MediaType.MARKDOWN))


def log_estimate(rec: rr.RecordingStream, estimate: Estimate, canvas: Canvas) -> None:
    """The error curve as a chart and as numbers, the verdict as text, and all of it as JSON.

    An estimate over a sequence belongs to the whole of it, hence to no moment; a pair's stands at the pair's frame.
    """
    whole = bool(canvas.image)
    curve = estimate.curve
    chart = rr.EncodedImage(contents=chart_png(estimate), media_type="image/png")
    rec.log("calibration/chart", chart, static=whole)
    # No BarChart: its tensor keeps a viewer from opening a second recording of this kind beside the first.
    known = np.isfinite(curve.aee)
    points = {estimate.parameter: curve.parameter[known], "aee": curve.aee[known]}
    rec.log("calibration/curve", rr.AnyValues(True, **points), static=whole)
    rec.log("calibration/summary", rr.TextDocument(summary(estimate), media_type=rr.MediaType.MARKDOWN), static=whole)
    rec.log("calibration/estimate", rr.AnyValues(json=json.dumps(as_json(estimate))), static=whole)


def as_json(estimate: Estimate) -> dict[str, Any]:
    """The estimate's public form, in strict JSON: what is not finite becomes null."""
    return cast(dict[str, Any], plain(estimate.as_json()))


def summary(estimate: Estimate) -> str:
    """The estimate in a page of Markdown."""
    low, high = estimate.interval
    lines = [
        f"# {estimate.parameter} = {estimate.value:.3g}: {estimate.verdict}",
        "",
        f"{estimate.level:.0%} interval **{low:.3g} to {high:.3g}** (searched {estimate.bounds[0]:g} to "
        f"{estimate.bounds[1]:g})",
        "",
        _stiffness(estimate),
        "",
        "| error at the best value | |",
        "| --- | --- |",
        f"| all particles (eq. 3.18) | {_length(estimate, estimate.aee)} |",
        f"| free particles | {_length(estimate, estimate.aee_free)} |",
        f"| to the nearest particle (eq. 4.6) | {_length(estimate, estimate.nearest)} |",
        f"| converged | {'yes' if estimate.converged else '**NO**: do not rely on the value'} |",
        "",
        *_selection(estimate),
        "| setting | |",
        "| --- | --- |",
    ]
    lines += [f"| {name} | {value} |" for name, value in estimate.settings.items()]
    return "\n".join(lines)


def _selection(estimate: Estimate) -> list[str]:
    """The ways of fitting that were tried, with the error on particles left out."""
    if not estimate.selection:
        return []
    lines = [
        f"Chosen by the error on particles left out: {estimate.selection_text}",
        "",
        f"| a side | held | alpha | dt [s] | left out | fitted | {estimate.parameter} |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for one in estimate.selection:
        pace = ("static", "") if one.alpha is None else (f"{one.alpha:g}", f"{one.dt:g}")
        error = _length(estimate, one.held_out)
        told = [str(one.cluster_size), ", ".join(one.held), *pace, f"**{error}**" if one.chosen else error]
        lines.append(f"| {' | '.join(told)} | {_length(estimate, one.fit)} | {one.value:.3g} |")
    return [*lines, ""]


def _stiffness(estimate: Estimate) -> str:
    said = f"Stiffness: **{estimate.stiffness_verdict}**"
    if estimate.stiffness is not None:
        value, (low, high) = estimate.stiffness
        return f"{said}, k = {value:.4g} N/m ({low:.4g} to {high:.4g})"
    return said + (" (positions alone cannot tell it)" if estimate.stiffness_verdict == "unidentified" else "")


def _length(estimate: Estimate, length: float) -> str:
    """A length in its unit, and in metres too where an image's scale is known."""
    factor, unit = readable(estimate.unit, estimate.aee)
    said = f"{length * factor:.4g} {unit}"
    if estimate.unit == "px" and estimate.metres_per_unit is not None:
        said += f" = {length * estimate.metres_per_unit * 1e3:.3g} mm"
    return said


def chart_png(estimate: Estimate) -> bytes:
    """The error over the parameter, drawn to be read at a glance, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    _draw(figure.add_subplot(), estimate)
    encoded = io.BytesIO()
    figure.savefig(encoded, format="png", metadata={"Software": None})
    return encoded.getvalue()


def _draw(axes: Axes, estimate: Estimate) -> None:
    curve, (low, high) = estimate.curve, estimate.interval
    factor, unit = readable(estimate.unit, float(np.nanmax(curve.aee, initial=0.0)))
    best = _error_at(estimate) * factor
    axes.axvspan(low, high, color=INTERVAL, alpha=0.45, lw=0, label=f"{estimate.level:.0%} interval")
    axes.plot(
        curve.parameter,
        curve.aee * factor,
        "o-",
        color=ERROR,
        lw=2,
        ms=4 if len(curve.aee) < 40 else 2.5,
        label="error, all particles",
    )
    axes.axvline(estimate.value, color=MINIMUM, lw=1.2, ls="--")
    if math.isfinite(best):
        axes.plot([estimate.value], [best], "D", color=MINIMUM, ms=9, label=f"lowest at {estimate.value:.3g}")
    lowest, highest = estimate.bounds
    room = 0.03 * (highest - lowest)  # a mark at a bound is seen whole
    axes.set_xlim(lowest - room, highest + room)
    axes.set_xlabel(f"{estimate.parameter} [-]", fontsize=14)
    axes.set_ylabel(f"average Euclidean error [{unit}]", fontsize=14)
    color = {"identified": "#177a2b", "weak": "#a86400"}.get(estimate.verdict, "#b01818")
    axes.set_title(
        f"{estimate.parameter} = {estimate.value:.3g}  [{low:.3g}, {high:.3g}]: {estimate.verdict}"
        + ("" if estimate.converged else ", NOT CONVERGED"),
        fontsize=16,
        color=color,
        fontweight="bold",
    )
    axes.tick_params(labelsize=12)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=12)


def _error_at(estimate: Estimate) -> float:
    """The curve's height at the best value, so that the mark lies on the curve."""
    known = np.isfinite(estimate.curve.aee)
    if not known.any():
        return estimate.aee
    return float(np.interp(estimate.value, estimate.curve.parameter[known], estimate.curve.aee[known]))
