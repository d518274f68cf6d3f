"""Pictures of an exploration, as PNG: the maps, the gain of each next place, and a touch's measurement.

The same drawings go into recordings and into the picture of a result. Lengths on the axes are in cm, in the surface
frame; touches are numbered from 1, in their order."""

import functools
import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.images import encode_png
from deformscope.pictures.figures import canvas, png_of
from deformscope.pictures.messages import (
    counted,
    format_inclusions,
    format_iou,
    format_stop,
    format_travel,
    format_verdict,
    stiffness_kind,
)
from deformscope.pictures.palette import OBSERVED, SIMULATED, hexadecimal, round_up
from deformscope.results.render import to_line
from deformscope.stages.map.exploration import (
    InclusionsResult,
    MapEstimate,
    PlannedTouch,
    SurfaceEstimate,
    TouchEstimate,
)
from deformscope.stages.map.perception import TouchPerception

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.text import Text

P = ParamSpec("P")
RECORDED, OTHER = (0, 114, 178), (213, 94, 0)
"""Colours of the recorded result and of other settings' results; distinct to colour-blind readers too."""
REGIONS = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#0072b2", "#d55e00", "#999999")
"""Colours of regions from the softest; colour-blind readers can distinguish them (Okabe and Ito 2008)."""
STIFFNESS, BETA, DEVIATION, GAIN, HEIGHT = "viridis", "plasma", "magma", "cividis", "viridis"
"""Colours of each quantity, everywhere the same."""
TARGET = "#e8112d"
EXCLUDED, STRIPES, STRIPE = "#a4a9b1", "#6f757e", 4
"""Cells that may not be touched: grey, striped, cells from stripe to stripe."""
BETA_STEP = 0.2
"""Ends of a scale of beta are multiples of this."""
LEAST_RANGE_MM = 4.0
"""Smallest range of a scale of heights."""
LEAST = 1e-9
"""Stiffness [N/mm] below which there is none."""
STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)
"""Possible ends of a scale of stiffness, so that it stays the same from touch to touch."""

BEFORE_MM, SECTION_CM, RING_CM = 2.0, 6.0, 0.35
"""Shown of a touch: how far before contact its force is, and how far around it the dent, in rings."""

WIDE, HIGH = 4.4, 3.3
"""One picture [inch]."""
DPI = 130
PLACE = (0.12, 0.12, 0.7, 0.69)
"""Place of a map in its picture (left, bottom, width, height): room for title, labels and colour bar."""
ROWS_OF_WORDS = 3
UNIT_LETTERS = 8
"""Most letters of a colour bar's label; a longer one is part of the label of x."""
NEAR_EDGE = 0.12
"""Share of a map's side at its far edge in which a touch's number is written on the other side of the touch."""
LEAST_SURE = 0.25
"""Probability of a label at and below which its colour is palest."""


@dataclass(frozen=True, slots=True)
class DrawnMap:
    """A map as a picture. values: (rows, columns) values in the units of the colour bar; colors: (rows, columns, 3)
    colours of each cell, from 0 to 255; both empty without a field"""

    png: bytes
    values: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    colors: npt.NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))


def draw_map(quantity: str, maps: MapEstimate) -> DrawnMap:
    """Draw one of `MAP_DRAWINGS`."""
    images: list[Any] = []

    def draw(axes: "Axes") -> None:
        MAP_DRAWINGS[quantity](axes, maps)
        images.extend(axes.images)

    png = _one(draw, PLACE)
    if not images or quantity not in FIELDS:
        return DrawnMap(png)
    values = images[0].get_array()
    return DrawnMap(png, np.ma.filled(values, np.nan), images[0].to_rgba(values, bytes=True)[..., :3].copy())


def result_png(maps: MapEstimate, title: str = "", found: InclusionsResult | None = None) -> bytes:
    """The whole result in one picture: both fields with their deviations, the regions, and the truth if known. In a
    search for inclusions, the inclusions and the detection limit replace beta."""
    figure = canvas(3 * WIDE, 2 * HIGH + 0.5)
    second: tuple[Callable[[Axes, MapEstimate], None], ...] = (draw_beta, draw_beta_deviation)
    if found is not None:
        second = (lambda axes, _: draw_inclusions(axes, found), lambda axes, _: draw_miss_probability(axes, found))
    drawings: tuple[tuple[Callable[[Axes, MapEstimate], None], ...], ...] = (
        (functools.partial(draw_stiffness, path=True), second[0], draw_regions),
        (draw_stiffness_deviation, second[1], draw_truth),
    )
    share = HIGH / (2 * HIGH + 0.5)
    for row, line in enumerate(drawings):
        for column, draw in enumerate(line):
            left, bottom, width, height = PLACE
            axes = figure.add_axes(((column + left) / 3, share * (1 - row + bottom), width / 3, share * height))
            draw(axes, maps)
    figure.text(0.02, 0.975, title or "What the touches measured", fontsize=14, weight="bold", va="top")
    said = [counted(maps.touches, "touch"), format_verdict(maps), format_iou(maps), format_travel(maps.travel_m)]
    figure.text(0.98, 0.972, ", ".join(one for one in said if one), fontsize=11, ha="right", va="top")
    return png_of(figure, DPI)


# One drawing a quantity ----------------------------------------------------------------------------------------------


def draw_stiffness(axes: "Axes", maps: MapEstimate, *, path: bool = False) -> None:
    from matplotlib.colors import LogNorm

    low, high = stiffness_range(maps.stiffness_n_per_mm)
    _draw_map(axes, maps.stiffness_n_per_mm, maps.cell_m, STIFFNESS, "[N/mm]", norm=LogNorm(low, high))
    _title(axes, "Stiffness", f"{stiffness_kind(maps)}, at the set force")
    _draw_contacts(axes, maps.contacts_m, maps.tip_radius_m, path=path)


def draw_stiffness_deviation(axes: "Axes", maps: MapEstimate) -> None:
    percent = 100.0 * np.expm1(maps.stiffness_log_sd)
    _draw_map(axes, percent, maps.cell_m, DEVIATION, "[%]", low=0.0, high=_round_up(percent))
    _draw_contacts(axes, maps.contacts_m, maps.tip_radius_m)
    _title(axes, "Deviation of the stiffness", "one standard deviation upwards")


def draw_beta(axes: "Axes", maps: MapEstimate) -> None:
    _title(axes, "Beta", "shape parameter of the fitted model")
    if maps.beta is None:
        _say(axes, "no beta yet", maps.labels.shape, maps.cell_m)
        return
    low = math.floor(float(np.nanmin(maps.beta)) / BETA_STEP) * BETA_STEP
    high = max(math.ceil(float(np.nanmax(maps.beta)) / BETA_STEP) * BETA_STEP, low + BETA_STEP)
    _draw_map(axes, maps.beta, maps.cell_m, BETA, "[-]", low=low, high=high)
    _draw_contacts(axes, maps.contacts_m, maps.tip_radius_m)


def draw_beta_deviation(axes: "Axes", maps: MapEstimate) -> None:
    _title(axes, "Deviation of beta", "one standard deviation")
    if maps.beta_sd is None:
        _say(axes, "no beta yet", maps.labels.shape, maps.cell_m)
        return
    _draw_map(axes, maps.beta_sd, maps.cell_m, DEVIATION, "[-]", low=0.0, high=_round_up(maps.beta_sd))
    _draw_contacts(axes, maps.contacts_m, maps.tip_radius_m)


def draw_regions(axes: "Axes", maps: MapEstimate) -> None:
    if not maps.region_count:
        _title(axes, "No regions", f"the stiffness changes smoothly (probability {maps.probability:.2f})")
        _say(axes, "", maps.labels.shape, maps.cell_m)
        _draw_contacts(axes, maps.contacts_m, maps.tip_radius_m)
        return
    sure = np.clip((maps.label_probability - LEAST_SURE) / (1.0 - LEAST_SURE), 0.0, 1.0)
    _draw_labels(axes, _label_colors(maps.labels), 0.3 + 0.7 * sure, maps.cell_m)
    _draw_outline(axes, maps.labels, maps.cell_m, "black")
    _draw_contacts(axes, maps.contacts_m, maps.tip_radius_m)
    _draw_keys(axes, maps)
    _title(axes, f"{format_verdict(maps)} found", f"probability {maps.probability:.2f}; the paler, the less certain")


def draw_truth(axes: "Axes", maps: MapEstimate) -> None:
    if maps.truth_labels is None:
        _title(axes, "Truth", "")
        _say(axes, "not known", maps.labels.shape, maps.cell_m)
        return
    truth = maps.truth_labels
    drawn = _label_colors(_matched(truth, maps.labels))
    _draw_labels(axes, drawn, np.ones(truth.shape), maps.cell_m)
    _draw_outline(axes, maps.labels, maps.cell_m, "black")
    _draw_contacts(axes, maps.contacts_m, maps.tip_radius_m)
    score = f"{format_iou(maps)}; " if maps.iou is not None else ""
    _title(axes, f"Truth: {counted(len(np.unique(truth)), 'region')}", f"{score}line: as found")


def draw_inclusions(axes: "Axes", found: InclusionsResult) -> None:
    from matplotlib.patches import Circle

    _draw_map(axes, 100.0 * found.covered, found.cell_m, GAIN, "[%]", low=0.0, high=100.0)
    axes.plot(*(100.0 * found.contacts_m).T, ".", color="white", ms=4)
    circles = [(*row, "-", "black") for row in 100.0 * np.column_stack([found.centre_m, found.radius_m])]
    if found.truth_m is not None:
        circles += [(*row[:3], "--", TARGET) for row in 100.0 * found.truth_m]
    for x, y, radius, style, color in circles:
        axes.add_patch(Circle((x, y), radius, fill=False, ls=style, ec=color, lw=2.2))
    truth = "" if found.truth_m is None else "; red: the true ones"
    words = f"probability that an inclusion lies below; black: found{truth}"
    _title(axes, format_inclusions(found).capitalize(), words)


def draw_miss_probability(axes: "Axes", found: InclusionsResult) -> None:
    names = [f"{100.0 * radius:.3g}" for radius in found.size_m]
    wanted = found.size_m >= found.smallest_m
    axes.bar(names, 100.0 * found.missed, color=np.where(wanted, REGIONS[5], EXCLUDED))
    axes.axhline(100.0 * found.prior, color="black", lw=1, ls="--")
    axes.set_box_aspect(0.62)  # leaves room for the names below
    axes.set(ylim=(0.0, 110.0 * found.prior), xlabel="radius of the inclusion [cm]", ylabel="missed with [%]")
    words = f"{found.missed_smallest:.1%} of {100.0 * found.smallest_m:.3g} cm radius or more; dashed: before any touch"
    _title(axes, "A missed inclusion", words)


def draw_gain(axes: "Axes", plan: PlannedTouch, cell_m: float, contacts_m: FloatArray | None = None) -> None:
    if plan.gain is not None:
        open_gain = np.where(plan.excluded, np.nan, plan.gain)
        unit = "[-]" if plan.gain_unit is None else f"[{plan.gain_unit.replace('label', 'share of the map corrected')}]"
        _draw_map(axes, open_gain, cell_m, GAIN, f"gain {unit}", low=0.0, high=_round_up(open_gain))
    else:
        _say(axes, "no gain computed", plan.excluded.shape, cell_m)
    _draw_excluded(axes, plan.excluded, cell_m)
    if plan.cost_s is not None:
        _draw_levels(axes, plan.cost_s, cell_m, "s")
    if contacts_m is not None:
        _draw_contacts(axes, contacts_m, 0.0)
    if plan.target_m is not None:
        at = np.asarray(plan.target_m) * 100
        axes.plot(*at, "+", color="white", ms=22, mew=5.5, zorder=7)
        axes.plot(*at, "+", color=TARGET, ms=20, mew=2.8, zorder=8)
        _title(axes, f"Next touch at ({at[0]:.1f}, {at[1]:.1f}) cm", plan.reason)
    else:
        _title(axes, "No further touch", format_stop(plan.stop_reason) if plan.stop_reason else plan.reason)


def draw_height(axes: "Axes", surface: SurfaceEstimate) -> None:
    height_mm = surface.height_m * 1e3
    low, high = float(height_mm.min()), float(height_mm.max())
    more = max(0.5 * (LEAST_RANGE_MM - (high - low)), 0.0)
    low, high = low - more, high + more
    _draw_map(axes, surface.height_m * 1e3, surface.cell_m, HEIGHT, "[mm]", low=low, high=high)
    _draw_levels(axes, surface.deviation_m * 1e3, surface.cell_m, "mm")
    _title(axes, "Height of the surface", "lines: one standard deviation")


def draw_force(axes: "Axes", touch: TouchEstimate, name: str = "") -> None:
    name = name or f"Touch {touch.number}"
    if not touch.usable:
        _title(axes, f"{name}: {touch.stiffness_text}", f"{touch.dent_text}; {touch.beta_text}")
        axes.plot(touch.approach_m * 1e3, touch.approach_n, ".", color=hexadecimal(OBSERVED), ms=5)
        axes.set_xlabel("displacement of the tip [mm]", fontsize=11)
        axes.set_ylabel("force [N]", fontsize=11)
        return
    depth_mm = (touch.approach_m - touch.contact_m) * 1e3
    order = np.argsort(depth_mm, kind="stable")
    axes.plot(depth_mm, touch.approach_n, ".", color=hexadecimal(OBSERVED), ms=5, label="measured")
    axes.plot(depth_mm[order], touch.fitted_n[order], color=hexadecimal(SIMULATED), lw=2, label="fitted $k(z-z_0)^p$")
    axes.axvline(0.0, color="black", lw=1, ls="--")
    axes.annotate(
        "contact", (0.0, 0.97), xycoords=("data", "axes fraction"), xytext=(-3, 0), textcoords="offset points",
        rotation=90, fontsize=10, ha="right", va="top",
    )  # fmt: skip
    axes.set_xlim(-max(BEFORE_MM, 0.3 * float(depth_mm.max(initial=0.0))), None)
    axes.set_xlabel("depth of the tip [mm]", fontsize=11)
    axes.set_ylabel("force [N]", fontsize=11)
    axes.tick_params(labelsize=10)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=10, loc="lower right", bbox_to_anchor=(1.0, 0.08), frameon=False)
    _title(axes, f"{name}: {touch.stiffness_text}", to_line(touch, "caption"))


def draw_section(axes: "Axes", touch: TouchEstimate) -> None:
    for color, name, points in (
        (hexadecimal(OBSERVED), "observed", touch.observed_m),
        (hexadecimal(SIMULATED), "simulated", _near(touch.simulated_m, touch.xyz_m)),
    ):
        if not len(points):
            continue
        relative_m = points - touch.xyz_m
        height = relative_m @ touch.normal
        away_cm, height_mm = np.linalg.norm(relative_m - height[:, None] * touch.normal, axis=1) * 100, height * 1e3
        axes.plot(away_cm, height_mm, ".", color=color, ms=2.5 if name == "observed" else 5, alpha=0.3, mew=0)
        marked = {"marker": "o", "ms": 5, "mec": "white", "lw": 0} if name == "observed" else {"lw": 2}
        axes.plot(*_rings(away_cm, height_mm), color=color, label=f"{name}, mean", zorder=4, **marked)
    if touch.usable and not touch.rigid:
        axes.plot([0.0], [-touch.depth_m * 1e3], "v", color="black", ms=7, label="tip", zorder=5)
    _title(axes, f"Dent of touch {touch.number}", "over the surface at rest; " + touch.beta_text)
    if not axes.lines:
        _say(axes, "no points were measured")
        return
    deep_mm = max(touch.depth_m * 1e3, 1.0) if touch.usable else 1.0
    axes.set(xlim=(-0.1, SECTION_CM), ylim=(-1.35 * deep_mm - 1.0, 0.4 * deep_mm + 2.5))
    axes.set_xlabel("distance from the contact [cm]", fontsize=11)
    axes.set_ylabel("height [mm]", fontsize=11)
    axes.tick_params(labelsize=10)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=10, loc="lower right", frameon=False)


def draw_error(axes: "Axes", perception: TouchPerception) -> None:
    name = f"E(beta) of touch {perception.number}"
    if perception.error is None or perception.estimate is None:
        _title(axes, name, "")
        _say(axes, "no model was fitted")
        return
    beta, error_m = perception.estimate, perception.error_m
    axes.plot(perception.error.parameter, 1e3 * perception.error.aee, ".-", color=hexadecimal(SIMULATED), ms=5)
    axes.plot([beta], [1e3 * error_m], "v", color="black", ms=8)
    axes.set_xlabel("beta [-]", fontsize=11)
    axes.set_ylabel("error [mm]", fontsize=11)
    axes.grid(alpha=0.3)
    _title(axes, name, f"{1e3 * error_m:.3g} mm at the estimate, beta = {beta:.3g}")


def _near(points: FloatArray, at: FloatArray) -> FloatArray:
    """The part of points (n, 3) within `SECTION_CM` of a place (2 or 3,), measured in the plane [m]."""
    return points[np.linalg.norm(points[:, :2] - at[:2], axis=1) <= SECTION_CM * 1e-2] if len(points) else points


def _rings(away_cm: FloatArray, height_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean distance and height of the points in rings around the contact."""
    ring = np.floor(away_cm / RING_CM).astype(np.int64)
    count = np.bincount(ring)
    filled = count > 0
    away, height = (np.bincount(ring, weights=one)[filled] / count[filled] for one in (away_cm, height_mm))
    return away, height


def draw_region_comparison(axes: "Axes", recorded: MapEstimate, other: MapEstimate, name: str) -> None:
    from matplotlib.lines import Line2D

    sides = ((recorded, RECORDED, 4.0, "recorded"), (other, OTHER, 1.4, name))  # seen both, where they are the same
    _say(axes, "", recorded.labels.shape, recorded.cell_m)
    handles = []
    for maps, color, width, whose in sides:
        _draw_outline(axes, maps.labels, maps.cell_m, hexadecimal(color), width)
        words = f"{whose}: {format_verdict(maps)} (probability {maps.probability:.2f})"
        handles.append(Line2D([], [], color=hexadecimal(color), lw=width, label=words))
    _draw_contacts(axes, recorded.contacts_m, recorded.tip_radius_m)
    matched = _matched(other.labels, recorded.labels) if recorded.region_count and other.region_count else other.labels
    same = float(np.mean(matched == recorded.labels))
    _legend_above(axes, f"Regions: {100 * same:.0f} % of the surface the same", handles)


def draw_touch_comparison(
    axes: "Axes", quantity: str, recorded: Sequence[TouchEstimate], other: Sequence[TouchEstimate], name: str
) -> None:
    from matplotlib.ticker import MaxNLocator

    handles = []
    for touches, color, mark, whose, aside in (
        (recorded, RECORDED, "o", "recorded", -0.1),
        (other, OTHER, "s", name, 0.1),
    ):
        known = [(one.number + aside, *found) for one in touches if (found := _with_interval(one, quantity))]
        at, value, low, high = np.array(known).reshape(-1, 4).T
        ends = np.maximum([value - low, high - value], 0.0)
        handles.append(axes.errorbar(at, value, ends, fmt=mark, color=hexadecimal(color), ms=5, capsize=3, label=whose))
    _legend_above(axes, f"{quantity.capitalize()} of each touch, with its interval", handles)
    axes.set_xlabel("touch", fontsize=11)
    axes.set_ylabel("stiffness [N/mm]" if quantity == "stiffness" else "beta [-]", fontsize=11)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.tick_params(labelsize=10)
    axes.grid(alpha=0.3)


def _legend_above(axes: "Axes", title: str, handles: Sequence[Any]) -> None:
    """Names of the drawn items, below a title and above the axes."""
    names = [textwrap.fill(handle.get_label(), 46) for handle in handles]
    above: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (-0.03, 1.0), "frameon": False, "alignment": "left"}
    bold = {"size": 10, "weight": "bold"}
    axes.legend(handles, names, title=title, title_fontproperties=bold, fontsize=9, **above)


def _with_interval(touch: TouchEstimate, quantity: str) -> tuple[float, float, float] | None:
    """Value, low, high of a touch's result; None without one."""
    if quantity == "beta":
        return None if touch.beta is None else (touch.beta, *(touch.beta_interval or (touch.beta, touch.beta)))
    if not touch.usable:
        return None
    value, (low, high) = touch.stiffness_n_per_mm, touch.stiffness_interval
    return (value, low, high) if np.isfinite(high) else (value, value, value)  # a lower bound


FIELDS = ("stiffness", "stiffness_deviation", "beta", "beta_deviation")
MAP_DRAWINGS: "dict[str, Callable[[Axes, MapEstimate], None]]" = {
    "stiffness": draw_stiffness,
    "stiffness_deviation": draw_stiffness_deviation,
    "beta": draw_beta,
    "beta_deviation": draw_beta_deviation,
    "regions": draw_regions,
    "truth": draw_truth,
}
"""Panels of the maps: fields [N/mm], [-], one standard deviation of each [%], [-]; the regions, the paler the less
certain; the true ones, if known, and over them the outline of the estimated ones."""


# What the drawings share ---------------------------------------------------------------------------------------------


def stiffness_range(stiffness: FloatArray) -> tuple[float, float]:
    """The ends of a logarithmic scale that holds these values (...,) [N/mm], both 1, 2 or 5 times a power of ten."""
    known = stiffness[np.isfinite(stiffness) & (stiffness > LEAST)]
    if not known.size:
        return 0.1, 1.0
    low, high = float(known.min()), float(known.max())
    powers = [10.0**power for power in range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 2)]
    ends = sorted({step * power for power in powers for step in STEPS})
    first = max(end for end in ends if end <= low)
    last = min(end for end in ends if end >= high)
    return (first, last) if last > first else (first, min(end for end in ends if end > first))


def _round_up(values: FloatArray) -> float:
    return round_up(float(values[np.isfinite(values)].max(initial=0.0)), STEPS)


def _draw_map(
    axes: "Axes",
    values: FloatArray,
    cell_m: float,
    colors: str,
    label: str,
    *,
    low: float | None = None,
    high: float | None = None,
    norm: Any = None,
) -> None:
    """Draw a map (rows, columns) of square cells with its colour bar; low, high or norm: of its colours."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    limits: dict[str, Any] = {} if norm is not None else {"vmin": low, "vmax": high}
    shown = axes.imshow(
        values, origin="lower", extent=_extent(values.shape, cell_m), cmap=colors, interpolation="nearest",
        norm=norm, **limits,
    )  # fmt: skip
    _label_axes(axes)
    bar = axes.figure.colorbar(shown, cax=axes.inset_axes((1.035, 0.0, 0.045, 1.0)))
    bar.ax.tick_params(labelsize=10)
    if norm is None:  # whole numbers, not differences from one, and as short as there is room
        bar.locator, bar.formatter = MaxNLocator(4), FuncFormatter(lambda value, _: f"{value:.3g}")
        bar.update_ticks()
    if len(label) <= UNIT_LETTERS:
        bar.ax.text(0.55, -0.035, label, transform=bar.ax.transAxes, fontsize=10, va="top", ha="left")
    else:
        axes.set_xlabel(f"{axes.get_xlabel()}; colour: {label}")
    if norm is not None:
        _number_log_bar(bar, norm.vmin, norm.vmax)


def _number_log_bar(bar: "Colorbar", low: float, high: float) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    steps = (1.0, 2.0, 5.0) if high / low > 4 else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [step * 10.0**power for power in powers for step in steps]
    within = [tick for tick in ticks if low * (1 - 1e-9) <= tick <= high * (1 + 1e-9)]
    bar.ax.yaxis.set_major_locator(FixedLocator(within))
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _draw_levels(axes: "Axes", values: FloatArray, cell_m: float, unit: str) -> None:
    """Draw three lines of equal value over a map (rows, columns)."""
    if not float(np.nanmax(values) - np.nanmin(values)) > 0:
        return
    rows, columns = values.shape
    x, y = (np.arange(columns) + 0.5) * cell_m * 100, (np.arange(rows) + 0.5) * cell_m * 100
    lines = axes.contour(x, y, values, levels=3, colors="white", linewidths=0.8, alpha=0.8)
    axes.clabel(lines, fmt=lambda value: f"{value:g} {unit}", fontsize=8)


def _draw_labels(axes: "Axes", tints: FloatArray, sure: FloatArray, cell_m: float) -> None:
    """Draw labels in their colours (rows, columns, 3), paler where less sure (rows, columns)."""
    blended = 1.0 + (tints - 1.0) * sure[..., None]
    axes.imshow(blended, origin="lower", extent=_extent(sure.shape, cell_m), interpolation="nearest")
    _label_axes(axes)


def _label_colors(labels: IntArray) -> FloatArray:
    """(rows, columns, 3) from 0 to 1."""
    from matplotlib.colors import to_rgb

    table = np.array([to_rgb(color) for color in REGIONS])
    return table[labels % len(table)]


def _matched(truth: IntArray, found: IntArray) -> IntArray:
    """The truth's labels (rows, columns), renamed so that a region has the colour of the found one that it overlaps the
    most."""
    from scipy.optimize import linear_sum_assignment

    there, found_labels = np.unique(truth), np.unique(found)
    overlap = np.array(
        [[np.count_nonzero((truth == one) & (found == other)) for other in found_labels] for one in there]
    )
    renamed = np.full(truth.shape, -1, np.int64)
    rows, columns = linear_sum_assignment(-overlap)
    for row, column in zip(rows, columns, strict=True):
        renamed[truth == there[row]] = found_labels[column]
    missed = [label for label in there if not (renamed[truth == label] >= 0).any()]
    for fresh, label in enumerate(missed, start=int(found_labels.max()) + 1):
        renamed[truth == label] = fresh
    return renamed


def _draw_outline(axes: "Axes", labels: IntArray, cell_m: float, color: str, width: float = 1.4) -> None:
    """Draw lines between cells of different labels (rows, columns), along the cells' edges."""
    from matplotlib.collections import LineCollection

    lines = LineCollection(list(100 * region_edges(labels, cell_m)), colors=color, linewidths=width)
    axes.add_collection(lines, autolim=False)


def region_edges(labels: IntArray, cell_m: float) -> FloatArray:
    """(n, 2, 2) edges between cells of different labels, each from a corner to the next [m]."""
    rows, columns = np.nonzero(labels[:, 1:] != labels[:, :-1])
    upright = np.stack([np.stack([columns + 1, rows], -1), np.stack([columns + 1, rows + 1], -1)], axis=1)
    rows, columns = np.nonzero(labels[1:] != labels[:-1])
    level = np.stack([np.stack([columns, rows + 1], -1), np.stack([columns + 1, rows + 1], -1)], axis=1)
    return np.concatenate([upright, level]) * cell_m


def _draw_contacts(axes: "Axes", contacts_m: FloatArray, tip_radius_m: float, *, path: bool = False) -> None:
    """Touches in their order; the circle is the tip's size."""
    from matplotlib.collections import EllipseCollection
    from matplotlib.patheffects import withStroke

    if not len(contacts_m):
        return
    at = np.asarray(contacts_m) * 100
    if path and len(at) > 1:
        axes.plot(*at.T, color="white", lw=2.2, zorder=4, alpha=0.9)
        axes.plot(*at.T, color="black", lw=0.9, zorder=4)
    if tip_radius_m > 0:
        wide = np.full(len(at), 200 * tip_radius_m)
        for color, line in (("black", 2.2), ("white", 1.0)):
            axes.add_collection(
                EllipseCollection(
                    wide, wide, np.zeros(len(at)), units="x", offsets=at, offset_transform=axes.transData,
                    facecolors="none", edgecolors=color, linewidths=line, zorder=5,
                ),
                autolim=False,
            )  # fmt: skip
    else:
        axes.plot(*at.T, "o", color="white", mec="black", ms=4, zorder=5)
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    for number, place in enumerate(at, start=1):
        inward = np.where(place > limits @ [NEAR_EDGE, 1.0 - NEAR_EDGE], -1.0, 1.0)  # else it is over the edge
        axes.annotate(
            str(number), tuple(place + 80 * tip_radius_m * inward), xytext=(inward[0], 0), textcoords="offset points",
            ha="left" if inward[0] > 0 else "right", va="bottom" if inward[1] > 0 else "top",
            fontsize=10, weight="bold", color="black", zorder=6,
            path_effects=[withStroke(linewidth=2.2, foreground="white")], annotation_clip=True,
        )  # fmt: skip


def _draw_excluded(axes: "Axes", excluded: BoolArray, cell_m: float) -> None:
    """Draw the excluded cells (rows, columns) grey with stripes, crisp at the cells' edges."""
    from matplotlib.colors import to_rgb

    if not excluded.any():
        return
    rows, columns = np.indices(excluded.shape)
    striped = (rows + columns) % STRIPE == 0
    drawn = np.zeros((*excluded.shape, 4))
    drawn[excluded] = [*to_rgb(EXCLUDED), 1.0]
    drawn[excluded & striped] = [*to_rgb(STRIPES), 1.0]
    axes.imshow(drawn, origin="lower", extent=_extent(excluded.shape, cell_m), interpolation="nearest", zorder=2)


def _draw_keys(axes: "Axes", maps: MapEstimate) -> None:
    """Each region's number and stiffness, in its place within the axes."""
    from matplotlib.patheffects import withStroke

    axes.apply_aspect()  # else the axes have another place until they are drawn
    for label, region in enumerate(maps.regions):
        inside = maps.labels == label
        if inside.any():
            words = f"region {label + 1}\n{region.level_text}\nN/mm\n{region.modulus_text}".strip()
            text = axes.text(
                0, 0, words, ha="center", va="center", fontsize=10,
                weight="bold", zorder=7, path_effects=[withStroke(linewidth=2.5, foreground="white")],
            )  # fmt: skip
            text.set_position(_free_place(axes, text, inside, maps))


def _free_place(axes: "Axes", text: "Text", inside: BoolArray, maps: MapEstimate) -> tuple[float, float]:
    """Place [cm] of a text in its region (rows, columns): within the axes, over as little as possible of touches and
    their numbers, and as deep inside as that allows."""
    from scipy.ndimage import distance_transform_edt

    def corners(one: "Text") -> FloatArray:
        return np.asarray(axes.transData.inverted().transform(one.get_window_extent().get_points()))

    half = np.ptp(corners(text), axis=0) / 2
    touches = [100.0 * (at + maps.tip_radius_m * np.array([[-1.0], [1.0]])) for at in maps.contacts_m]
    taken = np.array([*touches, *(corners(one) for one in axes.texts if one is not text)]).reshape(-1, 2, 2)
    deep = distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1][inside]
    cell_cm = 100.0 * maps.cell_m
    at = np.clip(cell_cm * (np.argwhere(inside)[:, ::-1] + 0.5), half, cell_cm * np.array(inside.shape)[::-1] - half)
    low, high = np.maximum(at[:, None] - half, taken[:, 0]), np.minimum(at[:, None] + half, taken[:, 1])
    over = np.prod(np.maximum(high - low, 0.0), axis=2).sum(axis=1)
    x, y = at[np.lexsort((-deep, over))[0]]
    return float(x), float(y)


def _extent(shape: tuple[int, ...], cell_m: float) -> tuple[float, float, float, float]:
    return 0.0, shape[1] * cell_m * 100, 0.0, shape[0] * cell_m * 100


def _label_axes(axes: "Axes") -> None:
    axes.set_xlabel("x [cm]", fontsize=10, labelpad=1)
    axes.set_ylabel("y [cm]", fontsize=10, labelpad=1)
    axes.tick_params(labelsize=10)


def _say(axes: "Axes", words: str, shape: tuple[int, ...] = (), cell_m: float = 0.0) -> None:
    """Words where there is no map, on the same ground."""
    axes.set_facecolor("#eef0f3")
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", fontsize=13, color="#70757d")
    if shape:
        x0, x1, y0, y1 = _extent(shape, cell_m)
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
        _label_axes(axes)
    else:
        axes.set(xticks=[], yticks=[])


def _title(axes: "Axes", title: str, words: str) -> None:
    square = axes.get_aspect() == 1.0 and np.ptp(axes.get_xlim()) < 1.2 * np.ptp(axes.get_ylim())
    wrapped = textwrap.wrap(words, 42 if square else 52, break_on_hyphens=False)[:ROWS_OF_WORDS]
    axes.text(
        0.0, 1.03, "\n".join(wrapped), transform=axes.transAxes, fontsize=10, va="bottom", ha="left", color="#3b4048"
    )
    above = 5 + 13 * len(wrapped)
    axes.annotate(
        title, (0.0, 1.0), xycoords="axes fraction", xytext=(0, above), textcoords="offset points", fontsize=13,
        weight="bold", va="bottom", ha="left",
    )  # fmt: skip


# Figures -------------------------------------------------------------------------------------------------------------


def _one(
    draw: "Callable[Concatenate[Axes, P], None]",
    place: tuple[float, float, float, float],
    *given: P.args,
    **named: P.kwargs,
) -> bytes:
    """place: place of the axes in the picture: left, bottom, width, height, shares of it"""
    figure = canvas(WIDE, HIGH)  # no layout engine: it takes longer than the drawing
    axes = figure.add_axes(place)
    draw(axes, *given, **named)
    drawn: Any = figure.canvas
    figure.set_dpi(DPI)
    drawn.draw()
    picture: npt.NDArray[np.uint8] = np.asarray(drawn.buffer_rgba())[..., :3]
    return encode_png(np.ascontiguousarray(picture))


def _picture(
    draw: "Callable[Concatenate[Axes, P], None]", place: tuple[float, float, float, float] = PLACE
) -> Callable[P, bytes]:
    """The drawing as PNG, by a function that another process can be sent."""
    return functools.partial(_one, draw, place)


text_png = _picture(_say)
gain_png = _picture(draw_gain)
"""The expected information of a touch of each cell, the cells that may not be touched, the next touch and why."""
force_png = _picture(draw_force, (0.14, 0.155, 0.8, 0.57))
"""Force over the depth of the tip, the fitted law, and where contact began; a name instead of the touch's number."""
error_png = _picture(draw_error, (0.17, 0.155, 0.79, 0.66))
"""The error of the model of a touch over its beta (Thesis eq. 4.6)."""
section_png = _picture(draw_section, (0.17, 0.155, 0.79, 0.62))
"""The dent around the tip, observed and simulated: height over the distance from the contact."""
height_png = _picture(draw_height)
"""The surface of the Gaussian process: height, and lines of equal standard deviation [mm]."""
region_comparison_png = _picture(draw_region_comparison, (0.12, 0.12, 0.84, 0.62))
"""Borders of the regions in a recorded map, and in the map with other settings, which are named."""
touch_comparison_png = _picture(draw_touch_comparison, (0.16, 0.14, 0.8, 0.62))
"""Result of each touch, with its interval: as recorded, and with other settings, which are named."""
inclusions_png = _picture(draw_inclusions)
"""How probably each cell lies above an inclusion, those that were found, and the true ones where they are known."""
miss_probability_png = _picture(draw_miss_probability, (0.15, 0.155, 0.8, 0.62))
"""How probably an inclusion of each size is missed."""
