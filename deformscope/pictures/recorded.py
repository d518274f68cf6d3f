"""What a recording holds, over touches and over time, as PNG: the curves of the thesis's chapters 2 and 4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.exploration import (
    draw_beta,
    draw_beta_deviation,
    draw_force,
    draw_section,
    draw_stiffness,
    draw_stiffness_deviation,
)
from deformscope.pictures.figures import COLOURS, LINES, canvas, png_of
from deformscope.stages.map.exploration import MapEstimate, TouchEstimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 110
MOST_COLUMNS = 6
"""Touches, or maps, in one picture: the last, if there are more."""
PHASES = ("#eef3f8", "#dfe6ee")


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Lines over time in one panel. label: of the axis, with its unit; time_s: (n,); values: (n, k), NaN = unknown
    names: (k,), empty = none; low, high: (n, k) of the interval, None = none; marks: points, as they are few"""

    label: str
    time_s: FloatArray
    values: FloatArray
    names: tuple[str, ...] = ()
    low: FloatArray | None = None
    high: FloatArray | None = None
    marks: bool = False


def curves_png(
    panels: Sequence[Curves],
    events: Sequence[tuple[str, float]] = (),
    phases: Sequence[tuple[str, float]] = (),
    label: str = "time since the recording's start [s]",
) -> bytes:
    """Panels below one another over the same time. events: upright lines; phases: shaded, by name and start [s]"""
    figure = canvas(9.0, 0.9 + 1.75 * len(panels), layout="constrained")
    axes = figure.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
    times = np.concatenate([one.time_s for one in panels])
    end = float(times.max(initial=0.0))
    for panel, one in zip(axes, panels, strict=True):
        _draw_curves(panel, one)
        for at, (start, stop) in enumerate(_spans(phases, end)):
            panel.axvspan(start, stop, color=PHASES[at % 2], zorder=0, lw=0)
        for at, (_, when) in enumerate(events):
            panel.axvline(when, color="black", ls=LINES[at % len(LINES)], lw=1.1)
    for name, (start, stop) in zip((name for name, _ in phases), _spans(phases, end), strict=True):
        if stop > times.min(initial=0.0):
            axes[0].annotate(
                name, (max(start, float(times.min(initial=0.0))), 1.02), xycoords=("data", "axes fraction"), fontsize=8
            )
    for at, (name, _) in enumerate(events):
        axes[-1].plot([], [], color="black", ls=LINES[at % len(LINES)], lw=1.1, label=name)
    if events:
        axes[-1].legend(fontsize=8, loc="best")
    axes[-1].set_xlabel(label)
    return png_of(figure, DPI)


def _spans(phases: Sequence[tuple[str, float]], end: float) -> list[tuple[float, float]]:
    starts = [start for _, start in phases]
    return list(zip(starts, [*starts[1:], max([end, *starts[-1:]])], strict=True)) if starts else []


def _draw_curves(axes: Axes, curves: Curves) -> None:
    for at in range(curves.values.shape[1]):
        color, name = COLOURS[at % len(COLOURS)], curves.names[at] if curves.names else None
        axes.plot(curves.time_s, curves.values[:, at], color=color, lw=1.5, label=name, marker="o" * curves.marks, ms=4)
        if curves.low is not None and curves.high is not None:
            axes.fill_between(curves.time_s, curves.low[:, at], curves.high[:, at], color=color, alpha=0.2, lw=0)
    axes.set_ylabel(curves.label, fontsize=9)
    axes.grid(alpha=0.25)
    if curves.names:
        axes.legend(fontsize=8, loc="best", ncols=2 if len(curves.names) > 3 else 1)


def touches_png(touches: Sequence[TouchEstimate]) -> bytes:
    """Stiffness and beta of each touch with their intervals (as in Thesis fig. 4.5a)."""
    figure = canvas(9.0, 3.4, layout="constrained")
    left, right = figure.subplots(1, 2)
    number = np.arange(1, len(touches) + 1)
    _draw_intervals(
        left,
        number,
        [one.stiffness_n_per_mm for one in touches],
        [(one.stiffness_n_per_mm,) * 2 if one.rigid else one.stiffness_interval for one in touches],
    )
    for at, one in zip(number, touches, strict=True):
        if one.rigid:
            left.annotate("rigid", (at, one.stiffness_n_per_mm), xytext=(4, 4), textcoords="offset points", fontsize=8)
    left.set(title="Apparent stiffness at the set force, 90 %", ylabel="stiffness [N/mm]")
    left.set_ylim(0.0)
    nan = float("nan")
    beta = [nan if one.beta is None else one.beta for one in touches]
    between = [one.beta_interval or (value, value) for one, value in zip(touches, beta, strict=True)]
    _draw_intervals(right, number, beta, between)
    right.set(title="Beta of the fitted model, 90 %", ylabel="beta [-]", ylim=(-0.03, 1.03))
    if not np.isfinite(beta).any():
        right.text(0.5, 0.5, "no touch has one", transform=right.transAxes, ha="center")
    for axes in (left, right):
        axes.set(xlabel="touch", xticks=number, xlim=(0.5, len(touches) + 0.5))
        axes.grid(alpha=0.25)
    return png_of(figure, DPI)


def _draw_intervals(axes: Axes, at: Any, value: Sequence[float], between: Sequence[tuple[float, float]]) -> None:
    middle, ends = np.array(value), np.array(between).reshape(-1, 2)
    off = np.abs(np.stack([middle - ends[:, 0], ends[:, 1] - middle]))
    axes.errorbar(at, middle, yerr=np.nan_to_num(off), fmt="o", color=COLOURS[0], capsize=3, ms=5)


def dents_png(touches: Sequence[TouchEstimate]) -> bytes:
    """Force over depth of each touch, and its dent, observed and simulated (as in Thesis fig. 4.4, 4.6)."""
    drawings: tuple[Callable[[Axes, TouchEstimate], None], ...] = (draw_force, draw_section)
    return _grid_png([[(draw, one) for one in touches[-MOST_COLUMNS:]] for draw in drawings], 4.6, 4.3)


def fields_png(maps: Sequence[MapEstimate]) -> bytes:
    """Beta and stiffness over the surface with their deviations, after one touch and the next (Thesis fig. 4.7)."""
    drawings = draw_beta, draw_beta_deviation, draw_stiffness, draw_stiffness_deviation
    return _grid_png([[(draw, one) for one in maps[-MOST_COLUMNS:]] for draw in drawings], 4.4, 3.5)


def _grid_png(rows: Sequence[Sequence[tuple[Callable[[Axes, Any], None], Any]]], wide: float, high: float) -> bytes:
    figure = canvas(wide * len(rows[0]), high * len(rows))
    for line, row in enumerate(rows):
        for column, (draw, one) in enumerate(row):
            left, bottom = (column + 0.15) / len(row), 1.0 - (line + 0.87) / len(rows)
            draw(figure.add_axes((left, bottom, 0.66 / len(row), 0.6 / len(rows))), one)
    return png_of(figure, DPI)


def progress_png(maps: Sequence[MapEstimate]) -> bytes:
    """Way over the surface, how sure the map is, and its overlap with the truth where that is known, by touch."""
    known = [one.iou for one in maps if one.iou is not None]
    panels = [
        ("way over the surface [m]", [one.travel_m for one in maps]),
        ("mean deviation of log stiffness [-]", [float(np.mean(one.stiffness_log_sd)) for one in maps]),
        *([("IoU with the truth [-]", known)] if len(known) == len(maps) else []),
    ]
    figure = canvas(3.6 * len(panels), 3.0, layout="constrained")
    for axes, (label, values) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        axes.plot([one.touches for one in maps], values, "o-", color=COLOURS[0])
        axes.set(xlabel="touches", ylabel=label, xticks=[one.touches for one in maps])
        axes.set_ylim(0.0, 1.1 * max(values))
        axes.grid(alpha=0.25)
    return png_of(figure, DPI)


def feature_png(tactile: FloatArray, vision_m: FloatArray | None, width_m: float) -> bytes:
    """What is measured at steady state: cells of both fingertips (Thesis fig. 2.7), data minus model (fig. 2.6).

    tactile: (2, rows, columns) [counts]; vision_m: (n, n) [m], None = none; width_m: of its patch
    """
    panels = [(one, f"fingertip {at + 1}", "cell", None) for at, one in enumerate(tactile)]
    figure = canvas(3.4 * len(panels) + (4.0 if vision_m is not None else 0.0), 3.2, layout="constrained")
    axes = figure.subplots(1, len(panels) + (vision_m is not None), squeeze=False)[0]
    most = float(np.nanmax(tactile, initial=1.0))
    for panel, (cells, title, label, _) in zip(axes, panels, strict=False):
        shown = panel.imshow(cells, vmin=0.0, vmax=most, cmap="viridis", interpolation="nearest")
        panel.set(title=title, xlabel=label, ylabel=label)
        figure.colorbar(shown, ax=panel, shrink=0.8, label="pressure [counts]")
    if vision_m is not None:
        half = 50.0 * width_m
        most = max(1e3 * float(np.nanmax(np.abs(vision_m), initial=0.0)), 0.1)
        panel = axes[-1]
        panel.set_facecolor("#5a5e64")
        shown = panel.imshow(
            1e3 * vision_m,
            vmin=-most,
            vmax=most,
            cmap="RdBu_r",
            extent=(-half, half, half, -half),
            interpolation="nearest",
        )
        panel.set(title="depth change, data minus model", xlabel="across [cm]", ylabel="along [cm]")
        figure.colorbar(shown, ax=panel, shrink=0.8, label="change [mm]; grey: not measured")
    return png_of(figure, DPI)


def costs_png(stages: Sequence[tuple[str, float]]) -> bytes:
    """Time of the processor that each stage took in all, by its name [ms]."""
    figure = canvas(7.0, 0.9 + 0.28 * len(stages), layout="constrained")
    axes = figure.subplots()
    names, total_ms = [name for name, _ in stages], [value for _, value in stages]
    bars = axes.barh(names, total_ms, color=COLOURS[0])
    axes.bar_label(bars, fmt="%.3g", padding=3, fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="time of the processor in all [ms]")
    axes.margins(x=0.15)
    return png_of(figure, DPI)
