"""Pictures of a calibration's results, as PNG: particles, the model's error, the error curve, the posterior.

The same drawings go into recordings, the `--picture` of a command and its report."""

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, ImageArray, IntArray
from deformscope.pictures.close_up import CloseUp, close_up
from deformscope.pictures.figures import canvas, png_of
from deformscope.pictures.palette import HELD, OBSERVED, REST, SIMULATED, hexadecimal, readable, round_up
from deformscope.stages.fit.estimate import Comparison, Estimate, PushCurve
from deformscope.stages.fit.model import distances
from deformscope.stages.see.triangulation import spacing_of, triangulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpecBase, SubplotSpec
    from mpl_toolkits.mplot3d import Axes3D

ERROR, INTERVAL, MINIMUM, POSTERIOR = "#1f5fd0", "#9db8e8", "#d92b2b", "#5b3fa0"
"""Colours of the charts: the curve, the shaded interval, the marked minimum, the density."""

VERDICT_COLORS = {"identified": "#177a2b", "weak": "#a86400"}
OTHER_VERDICT = "#b01818"
WORDS = "#3b4048"

APART = 0.02
"""Largest distance of a posterior's peak from the estimate, as a share of the range, at which the peak has no mark. A
peak outside of the interval has no mark either."""
NARROW = 0.05
"""An interval below this share of the range is drawn a second time, enlarged."""

MOST_ROWS = 8
"""Most comparisons in one picture; of more, those with the worst fit are shown."""

SMOOTH = 3000
"""Number of faces of a surface from which its colours look smooth."""

DPI = 110


@dataclass(frozen=True, slots=True)
class Result:
    """One estimate and its views: (n,) comparisons, each with a name; image: picture under the particles, None =
    none."""

    estimate: Estimate
    comparisons: tuple[Comparison, ...]
    names: tuple[str, ...]
    image: ImageArray | None = None


def errors(comparison: Comparison) -> FloatArray:
    """(K,) distance of each simulated particle from its observed place [unit]; NaN if it was not observed."""
    return np.asarray(
        np.where(comparison.seen, distances(comparison.simulated, comparison.observed), np.nan), dtype=np.float64
    )


def headline(estimate: Estimate) -> str:
    """Value and interval in a line."""
    low, high = estimate.interval
    said = f"{estimate.parameter} = {estimate.value:.3g}, {estimate.level:.0%} interval {low:.3g} to {high:.3g}"
    return said if estimate.converged else f"{said}, NOT CONVERGED"


def verdict_color(estimate: Estimate) -> str:
    """Green for identified, amber for weak, else red; `#rrggbb`."""
    return VERDICT_COLORS.get(estimate.verdict, OTHER_VERDICT) if estimate.converged else OTHER_VERDICT


def where_wrong(comparison: Comparison) -> str:
    """A sentence on the place of the model's error."""
    error = errors(comparison)
    if not np.isfinite(error).any():
        return "No particle was observed."
    worst = int(np.nanargmax(error))
    factor, unit = readable(comparison.unit, float(error[worst]))
    scale, length = _length_unit(comparison)
    place = ", ".join(f"{v * scale:.3g}" for v in comparison.rest[worst])
    known = np.sort(error[np.isfinite(error)] ** 2)[::-1]
    share = (int(np.searchsorted(np.cumsum(known), 0.5 * known.sum())) + 1) / len(known)
    return (
        f"The largest error is {error[worst] * factor:.3g} {unit}, at the particle with rest position ({place}) "
        f"{length}; {share:.0%} of the particles have half of the squared error."
    )


# Whole pictures ------------------------------------------------------------------------------------------------------


def evidence_png(estimate: Estimate) -> bytes:
    """The error over the parameter, below it, on the same axis, the posterior, and below these, of images with a force,
    the force over the depth."""
    pushed = _is_pushed(estimate)
    figure = canvas(8.0, 8.4 if pushed else 5.6, layout="constrained")
    _draw_evidence(figure, figure.add_gridspec(8 if pushed else 5, 1), estimate, size=13)
    return png_of(figure, 130)


def particles_png(result: Result, index: int) -> bytes:
    """Observed and simulated particles of one comparison, with error lines."""
    return _one(result, index, _draw_particles)


def errors_png(result: Result, index: int) -> bytes:
    """The error over the body of one comparison."""
    return _one(result, index, _draw_errors)


def results_png(results: Sequence[Result]) -> bytes:
    """Everything in one picture: a row for each comparison, the evidence next to it, the verdict as text above."""
    rows = _rows(results)
    height = sum(_height(results[place].comparisons[index]) for place, index in rows)
    pushed = len(rows) == 1 and _is_pushed(results[0].estimate)
    figure = canvas(17.0, max(height, 7.2 if pushed else 4.4) + 1.0, layout="constrained")
    grid = figure.add_gridspec(len(rows), 3, width_ratios=[1.0, 1.1, 1.15])
    done: list[int] = []
    for row, (place, index) in enumerate(rows):
        result = results[place]
        _draw_particles(figure, grid[row, 0], result, index)
        _draw_errors(figure, grid[row, 1], result, index)
        if place not in done:
            done.append(place)
            taken = sum(1 for other, _ in rows if other == place)
            inner = grid[row : row + min(taken, 2), 2].subgridspec(8 if pushed else 5, 1)
            _draw_evidence(figure, inner, result.estimate, titled=len(results) > 1, size=10, width=44)
    first = results[0].estimate
    if len(results) == 1:
        stiffness = "stiffness: " * (first.force is None) + first.stiffness_text()
        words = "\n".join([headline(first), *(textwrap.fill(one, 130) for one in (first.verdict_text(), stiffness))])
        figure.suptitle(words, color=WORDS, fontsize=13)
    else:
        figure.suptitle(f"{first.parameter} of {len(results)} pairs", fontsize=15, fontweight="bold")
    shown, every = len(rows), sum(len(one.comparisons) for one in results)
    if shown < every:
        figure.supxlabel(f"{shown} of {every} comparisons: those with the largest errors", fontsize=11)
    return png_of(figure, DPI)


def _height(comparison: Comparison) -> float:
    """Inches that a panel some 5 inches wide needs."""
    if comparison.rest.shape[1] == 3:
        return 4.8
    width, height = np.ptp(comparison.rest, axis=0)
    return float(np.clip(4.6 * height / (width or 1.0) + 1.2, 3.4, 7.0))


def _rows(results: Sequence[Result]) -> list[tuple[int, int]]:
    """(result, comparison) to show, in order; of too many, those with the largest errors."""
    every = [(place, index) for place, one in enumerate(results) for index in range(len(one.comparisons))]
    if len(every) <= MOST_ROWS:
        return every
    size = [float(np.nanmean(errors(results[place].comparisons[index]))) for place, index in every]
    return [every[row] for row in sorted(np.argsort(size)[::-1][:MOST_ROWS].tolist())]


def _one(result: Result, index: int, draw: "Callable[[Figure, SubplotSpec, Result, int], None]") -> bytes:
    figure = canvas(6.2, 4.6, layout="constrained")
    draw(figure, figure.add_gridspec(1, 1)[0, 0], result, index)
    return png_of(figure, DPI)


# Error curve and posterior -------------------------------------------------------------------------------------------


def _draw_evidence(
    figure: "Figure", grid: "GridSpecBase", estimate: Estimate, *, titled: bool = True, size: int = 11, width: int = 62
) -> None:
    """The curve in the upper three of five rows, the posterior below it; all for the curve where there is none. The
    force over the depth is in three more rows, if there are eight."""
    if grid.nrows > 5:
        _draw_force(figure.add_subplot(grid[5:, 0]), estimate, size)
    if estimate.posterior is None:
        above = figure.add_subplot(grid[:5, 0])
        above.set_xlabel(f"{estimate.parameter} [-]", fontsize=size)
    else:
        above = figure.add_subplot(grid[:3, 0])
        below = figure.add_subplot(grid[3:5, 0], sharex=above)
        above.tick_params(labelbottom=False)
        _draw_posterior(below, estimate, size)
    _draw_curve(above, estimate, size)
    if titled:
        words = f"{textwrap.fill(headline(estimate), width)}\n{textwrap.fill(estimate.verdict_text(), width)}"
        above.set_title(words, fontsize=size, color=WORDS)


def _draw_curve(axes: "Axes", estimate: Estimate, size: int) -> None:
    curve = estimate.curve
    factor, unit = readable(estimate.unit, float(np.nanmax(curve.aee, initial=0.0)))
    best = _error_at(estimate) * factor
    _shade(axes, estimate)
    axes.plot(
        curve.parameter,
        curve.aee * factor,
        "o-",
        color=ERROR,
        lw=2,
        ms=4 if len(curve.aee) < 40 else 2.5,
        label="error, all particles",
    )
    if math.isfinite(best):
        axes.plot([estimate.value], [best], "D", color=MINIMUM, ms=8, label=f"estimate: {estimate.value:.3g}")
    if estimate.least_aee is not None:
        value, least = estimate.least_aee
        axes.plot([value], [least * factor], "v", color=ERROR, ms=7, label=f"least AEE (thesis): {value:.3g}")
    lowest, highest = estimate.bounds
    room = 0.03 * (highest - lowest)  # a mark at a bound is seen whole
    axes.set_xlim(lowest - room, highest + room)
    axes.set_ylabel(f"mean error [{unit}]", fontsize=size)
    axes.tick_params(labelsize=size - 1)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=size - 2)


def _draw_posterior(axes: "Axes", estimate: Estimate, size: int) -> None:
    assert estimate.posterior is not None
    _draw_density(axes, estimate)
    axes.set_xlabel(f"{estimate.parameter} [-]", fontsize=size)
    axes.set_ylabel("probability\ndensity [-]", fontsize=size)
    axes.set_ylim(bottom=0.0)
    axes.tick_params(labelsize=size - 1)
    axes.grid(alpha=0.3)
    (low, high), (lowest, highest) = estimate.interval, estimate.bounds
    posterior = estimate.posterior
    likeliest = float(posterior.parameter[np.argmax(posterior.density)])
    if low <= likeliest <= high and abs(likeliest - estimate.value) > APART * (highest - lowest):
        peak, joint = f"most likely, marginally: {likeliest:.3g}", f"estimate: {estimate.value:.3g}"
        axes.plot([likeliest], [posterior.density.max()], "v", color=POSTERIOR, ms=7, label=peak)
        axes.plot([estimate.value], [0.0], "D", color=MINIMUM, ms=7, label=joint, clip_on=False)
        axes.legend(fontsize=size - 2)
    if high - low >= NARROW * (highest - lowest):
        return
    left = 0.5 * (low + high) > 0.5 * (lowest + highest)
    inset = axes.inset_axes((0.06 if left else 0.55, 0.3, 0.39, 0.6))
    _draw_density(inset, estimate)
    room = 0.6 * (high - low) or 1e-9
    inset.set_xlim(max(low - room, lowest), min(high + room, highest))
    inset.set_ylim(bottom=0.0)
    inset.set_yticks([])
    inset.set_xticks([low, high], [f"{low:.4g}", f"{high:.4g}"], fontsize=size - 3)
    inset.set_title("enlarged", fontsize=size - 3, pad=2)


def _is_pushed(estimate: Estimate) -> bool:
    """Whether there is a force over a depth."""
    return estimate.force is not None and estimate.contact_stiffness is not None


def _draw_force(axes: "Axes", estimate: Estimate, size: int) -> None:
    """The measured force over the depth, and the line of the stiffness at the contact, with its interval."""
    assert estimate.force is not None
    assert estimate.contact_stiffness is not None
    (force, ends), (stiffness, (low, high)) = estimate.force, estimate.contact_stiffness
    depth = force / stiffness
    curve = estimate.force_curve or PushCurve(np.array([1e-3 * depth]), np.array([force]))
    line = np.array([0.0, max(depth, 1e3 * float(curve.depth_m.max()))])
    label = f"{stiffness:.3g} N/mm, {estimate.level:.0%} interval"
    axes.fill_between(line, low * line, high * line, color=INTERVAL, alpha=0.4, lw=0, label=label)
    axes.plot(line, stiffness * line, "--", color=MINIMUM, lw=1.2)
    axes.plot([depth, depth], ends, color=WORDS, lw=2)
    axes.plot(1e3 * curve.depth_m, curve.force_n, "o", color=WORDS, ms=4, label="measured")
    axes.set_xlabel("depth of the contact [mm]", fontsize=size)
    axes.set_ylabel("force [N]", fontsize=size)
    axes.tick_params(labelsize=size - 1)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=size - 2)


def _draw_density(axes: "Axes", estimate: Estimate) -> None:
    assert estimate.posterior is not None
    posterior = estimate.posterior
    low, high = estimate.interval
    axes.plot(posterior.parameter, posterior.density, color=POSTERIOR, lw=2)
    inside = np.unique(np.concatenate([posterior.parameter, [low, high]]))
    inside = inside[(inside >= low) & (inside <= high)]
    density = np.interp(inside, posterior.parameter, posterior.density, left=0.0, right=0.0)
    axes.fill_between(inside, density, color=POSTERIOR, alpha=0.35, lw=0)
    _shade(axes, estimate)


def _shade(axes: "Axes", estimate: Estimate) -> None:
    low, high = estimate.interval
    axes.axvspan(low, high, color=INTERVAL, alpha=0.4, lw=0, label=f"{estimate.level:.0%} interval")
    axes.axvline(estimate.value, color=MINIMUM, lw=1.2, ls="--")


def _error_at(estimate: Estimate) -> float:
    """The curve's height at the best value, so that the mark lies on the curve."""
    known = np.isfinite(estimate.curve.aee)
    if not known.any():
        return estimate.aee
    return float(np.interp(estimate.value, estimate.curve.parameter[known], estimate.curve.aee[known]))


# Particles -----------------------------------------------------------------------------------------------------------


def _draw_particles(figure: "Figure", place: "SubplotSpec", result: Result, index: int) -> None:
    comparison = result.comparisons[index]
    if comparison.rest.shape[1] == 2:
        axes = figure.add_subplot(place)
        _draw_flat_particles(axes, comparison, result.image)
    elif (shown := close_up(comparison)).surface:
        axes = figure.add_subplot(place)
        _draw_cut(axes, comparison, shown)
    else:
        axes = figure.add_subplot(place, projection="3d")
        _draw_deep_particles(axes, comparison)
    axes.set_title(_titled("Observed and simulated", result, index), fontsize=11)


def _draw_flat_particles(axes: Any, comparison: Comparison, image: ImageArray | None) -> None:
    """Draw rest, observed and simulated positions with their errors. image: (h, w) or (h, w, 3), below them"""
    from matplotlib.collections import LineCollection

    scale = _frame(axes, comparison, image)
    known = _known(comparison)
    size = _mark(axes, comparison, scale)
    lines = np.stack([comparison.simulated[known], comparison.observed[known]], axis=1) * scale
    axes.scatter(*(comparison.rest * scale).T, s=0.12 * size, color=hexadecimal(REST), label="rest", zorder=2)
    seen = comparison.observed[comparison.seen] * scale
    axes.scatter(*seen.T, s=size, color=hexadecimal(OBSERVED), lw=0, label="observed", zorder=3)
    axes.scatter(*(comparison.simulated * scale).T, s=0.28 * size, color=hexadecimal(SIMULATED), lw=0, zorder=5)
    axes.scatter([], [], s=0.28 * size, color=hexadecimal(SIMULATED), label="simulated")
    axes.add_collection(
        LineCollection(list(lines), colors="black", linewidths=1.4, zorder=5, label="error"), autolim=False
    )
    held = comparison.observed[comparison.held] * scale
    axes.scatter(*held.T, s=0.1 * size, color=hexadecimal(HELD), lw=0, label="held", zorder=6)
    _legend_below(axes)


def _draw_cut(axes: "Axes", comparison: Comparison, shown: CloseUp) -> None:
    """Heights along x through the point that moved the most."""
    rest, observed, simulated = comparison.rest, comparison.observed, comparison.simulated
    motion = np.where(comparison.seen, distances(observed, rest), 0.0)
    deepest = rest[motion >= 0.95 * motion.max()].mean(axis=0)
    at = rest[int(np.argmin(np.linalg.norm(rest - deepest, axis=1)))]
    off = np.abs(rest[:, 1] - at[1])
    inside = np.zeros(len(rest), dtype=bool)
    inside[shown.holds(rest)] = True
    line = np.flatnonzero(inside & (off <= max(float(off[inside].min()), 0.5 * spacing_of(rest)) * (1 + 1e-9)))
    line = line[np.argsort(rest[line, 0])]
    scale, length = _length_unit(comparison)
    heights = np.concatenate([observed[line][comparison.seen[line], 2], simulated[line, 2]])
    factor, unit = readable(comparison.unit, float(np.ptp(heights)) if heights.size else 0.0)
    base = float(rest[line, 2].mean())

    def drawn(position: FloatArray, rows: IntArray | slice) -> tuple[FloatArray, FloatArray]:
        """x and height above the base of some positions (n, 3), in the units of the axes."""
        return position[rows, 0] * scale, (position[rows, 2] - base) * factor

    seen = line[comparison.seen[line]]
    axes.plot(*drawn(rest, line), "--", color=hexadecimal(REST), lw=1.2, label="rest")
    for one in seen:
        ends = np.stack([simulated[one], observed[one]])
        axes.plot(*drawn(ends, slice(None)), color="black", lw=1.2)
    axes.plot([], [], color="black", lw=1.2, label="error")
    axes.plot(*drawn(observed, seen), "o", color=hexadecimal(OBSERVED), ms=7, label="observed")
    axes.plot(*drawn(simulated, line), "o-", color=hexadecimal(SIMULATED), ms=3.5, lw=1.2, label="simulated")
    held = np.intersect1d(line, comparison.held)
    axes.plot(*drawn(observed, held), "o", color=hexadecimal(HELD), ms=3, label="held")
    axes.set_xlabel(f"x [{length}], cut at y = {at[1] * scale:.3g} {length}")
    axes.set_ylabel(f"height [{unit}]")
    axes.grid(alpha=0.3)
    _legend_below(axes)


def _draw_deep_particles(axes: "Axes3D", comparison: Comparison) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    scale = _deep_frame(axes, comparison)
    known = _known(comparison)
    seen = comparison.observed[comparison.seen] * scale
    axes.scatter(*seen.T, s=26, color=hexadecimal(OBSERVED), label="observed", alpha=0.45, lw=0, depthshade=False)
    axes.scatter(
        *(comparison.simulated * scale).T, s=9, color=hexadecimal(SIMULATED), label="simulated", lw=0, depthshade=False
    )
    lines = np.stack([comparison.simulated[known], comparison.observed[known]], axis=1) * scale
    axes.add_collection3d(Line3DCollection(list(lines), colors="black", linewidths=1.0, label="error"), autolim=False)
    _legend_below(axes)


# Where the model is wrong --------------------------------------------------------------------------------------------


def _draw_errors(figure: "Figure", place: "SubplotSpec", result: Result, index: int) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    comparison = result.comparisons[index]
    error = errors(comparison)
    largest = float(np.nanmax(error, initial=0.0))
    factor, unit = readable(comparison.unit, largest)
    end = round_up(largest) * factor
    flat = comparison.rest.shape[1] == 2
    shown = None if flat else close_up(comparison)
    axes: Any
    if flat or (shown is not None and shown.surface):
        axes = figure.add_subplot(place)
        _draw_flat_errors(axes, comparison, error * factor, end, result.image, shown)
    else:
        axes = figure.add_subplot(place, projection="3d")
        _draw_deep_errors(axes, comparison, error * factor, end)
    ring = " (ring)" if flat or (shown is not None and shown.surface) else ""
    title = _titled("Error of the model", result, index)
    axes.set_title(f"{title}\nlargest error {largest * factor:.3g} {unit}{ring}", fontsize=11)
    scale = ScalarMappable(Normalize(0.0, end), "plasma")
    if flat or (shown is not None and shown.surface):
        bar = figure.colorbar(scale, cax=axes.inset_axes((1.03, 0.0, 0.04, 1.0)))
    else:
        bar = figure.colorbar(scale, ax=axes, shrink=0.7, pad=0.12)
    bar.set_label(f"error [{unit}]")


def _draw_flat_errors(
    axes: Any, comparison: Comparison, error: FloatArray, end: float, image: ImageArray | None, shown: CloseUp | None
) -> None:
    """Draw the error (K,) over the area of a flat body or of a surface, with a ring around the largest. end: end of its
    scale"""
    known = np.flatnonzero(_known(comparison))
    if shown is not None:
        known = np.intersect1d(known, shown.holds(comparison.rest))
    scale = _frame(axes, comparison, image, shown)
    place = comparison.observed[known, :2] * scale
    triangles = triangulate(comparison.rest[known])
    if len(triangles):
        axes.tripcolor(
            *place.T, triangles, error[known], shading="gouraud", cmap="plasma", vmin=0.0, vmax=end, zorder=2,
            alpha=0.8 if image is not None else 1.0,
        )  # fmt: skip
    size = _mark(axes, comparison, scale, shown)
    axes.scatter(
        *place.T, s=0.25 * size, c=error[known], cmap="plasma", vmin=0.0, vmax=end, zorder=3,
        edgecolors="white", linewidths=0.4,
    )  # fmt: skip
    if known.size:
        worst = int(np.argmax(error[known]))
        axes.scatter(*place[worst], s=1.6 * size, facecolors="none", edgecolors="black", linewidths=1.8, zorder=4)
        axes.scatter(*place[worst], s=1.6 * size, facecolors="none", edgecolors="white", linewidths=0.7, zorder=5)


def _draw_deep_errors(axes: "Axes3D", comparison: Comparison, error: FloatArray, end: float) -> None:
    """Draw the error (K,) over the skin of a body in space. end: end of its scale"""
    import matplotlib as mpl
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    scale = _deep_frame(axes, comparison)
    known = np.flatnonzero(_known(comparison))
    place = comparison.observed[known] * scale
    triangles = triangulate(comparison.rest[known])
    colors = mpl.colormaps["plasma"]
    if not len(triangles):
        axes.scatter(*place.T, s=14, c=colors(error[known] / end), lw=0, depthshade=False)
        return
    corners = np.dstack([place[triangles], error[known][triangles]])
    while len(corners) < SMOOTH:
        a, b, c = np.moveaxis(corners, 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        corners = np.concatenate(
            [np.stack(one, axis=1) for one in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    tints = colors(corners[:, :, 3].mean(axis=1) / end)
    skin = Poly3DCollection(corners[:, :, :3], facecolors=tints, edgecolors=tints, linewidths=0.3)
    axes.add_collection3d(skin, autolim=False)


# What every drawing shares -------------------------------------------------------------------------------------------


def _frame(axes: "Axes", comparison: Comparison, image: ImageArray | None, shown: CloseUp | None = None) -> float:
    """Set limits and labels, and draw the image (h, w) or (h, w, 3) below; the factor from a position to the
    drawing."""
    scale, unit = _length_unit(comparison)
    if shown is not None:
        low, high = shown.low[:2] * scale, shown.high[:2] * scale
    elif image is not None:
        every = comparison.observed[comparison.seen]
        around = 2.0 * spacing_of(comparison.rest)
        size = np.array([image.shape[1], image.shape[0]], dtype=np.float64)
        low, high = np.maximum(every.min(axis=0) - around, 0.0), np.minimum(every.max(axis=0) + around, size)
        grey = image if image.ndim == 2 else image.mean(axis=2)
        dark, bright = np.percentile(grey, [1, 99])
        axes.imshow(grey, cmap="gray", vmin=dark, vmax=bright + 1e-9, zorder=0, alpha=0.75)
    else:
        every = np.concatenate([comparison.rest, comparison.observed[comparison.seen], comparison.simulated]) * scale
        low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    room = 0.0 if image is not None else 0.05 * float((high - low).max())
    axes.set_xlim(low[0] - room, high[0] + room)
    axes.set_ylim(low[1] - room, high[1] + room)
    if comparison.unit == "px":
        axes.invert_yaxis()
    axes.set_aspect("equal")
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")
    return scale


def _deep_frame(axes: "Axes3D", comparison: Comparison) -> float:
    scale, unit = _length_unit(comparison)
    every = np.concatenate([comparison.observed[comparison.seen], comparison.simulated]) * scale
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(np.maximum(high - low, 1e-9), zoom=1.1)
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]", zlabel=f"z [{unit}]")
    axes.view_init(elev=22, azim=-55)
    return scale


def _length_unit(comparison: Comparison) -> tuple[float, str]:
    """The factor and the unit that positions are shown in."""
    if comparison.unit == "px":
        return 1.0, "px"
    size = float(np.ptp(comparison.rest, axis=0).max())
    return (1e3, "mm") if size < 0.1 else (1e2, "cm") if size < 3.0 else (1.0, "m")


def _known(comparison: Comparison) -> BoolArray:
    """(K,) particles that were seen and whose simulated position is finite."""
    return (
        comparison.seen & np.isfinite(comparison.observed).all(axis=1) & np.isfinite(comparison.simulated).all(axis=1)
    )


def _mark(axes: "Axes", comparison: Comparison, scale: float, shown: CloseUp | None = None) -> float:
    """Area [points^2] of a mark that half fills the space between particles in a picture some 4 inches wide."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    inch = spacing_of(comparison.rest) * scale / max(abs(x1 - x0) / 4.2, abs(y1 - y0) / 3.2)
    return float(np.clip((0.42 * 72.0 * inch) ** 2, 4.0, 110.0))


def _legend_below(axes: "Axes") -> None:
    axes.legend(
        fontsize=9, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=3.9, ncols=5, frameon=False,
        handletextpad=0.3,
    )  # fmt: skip


def _titled(what: str, result: Result, index: int) -> str:
    name = PurePath(result.names[index]).name
    return what if not name else f"{what}: {name}"
