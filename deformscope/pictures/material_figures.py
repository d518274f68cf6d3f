"""Pictures of a material's results from pairs and motions: beta along axes, fields, yielding; as PNG."""

from typing import TYPE_CHECKING

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.figures import canvas, png_of
from deformscope.results.render import length_scale

if TYPE_CHECKING:
    from deformscope.stages.fit.motion import Motion
    from deformscope.stages.materials.axis_estimate import AxisEstimate
    from deformscope.stages.materials.field_estimate import FieldEstimate
    from deformscope.stages.materials.recovery import RecoveryEstimate
    from deformscope.stages.materials.yield_estimate import YieldEstimate


def axes_png(found: "AxisEstimate") -> bytes:
    """beta along each axis with its interval, and the one beta for all."""
    figure = canvas(5.2, 4.2, layout="constrained")
    axis = figure.subplots()
    place, value = np.arange(len(found.value)), found.value
    reach = np.abs(found.interval.T - value)
    axis.errorbar(place, value, yerr=reach, fmt="o", capsize=6, color="tab:blue", label=f"{found.level:.0%} interval")
    axis.axhline(found.beta, color="tab:gray", linestyle="--", label=f"one beta for all: {found.beta:.3g}")
    names = ["along (" + ", ".join(f"{part:.2g}" for part in found.axes[:, k]) + ")" for k in place]
    axis.set_xticks(place, names)
    axis.set(ylabel="beta [-]", ylim=(-0.03, 1.03), xlim=(-0.5, len(place) - 0.5))
    axis.set_title(f"probability of no anisotropy: {found.p_isotropic:.2g}", fontsize=10)
    axis.grid(alpha=0.3)
    axis.legend()
    return png_of(figure, 130)


FIELD_LAYERS = 4
"""Most layers of a body in space that are drawn."""


def field_png(found: "FieldEstimate") -> bytes:
    """Maps of stiffness and of beta, each with the width of its interval; of a body in space, some of its layers."""
    from matplotlib.collections import PatchCollection
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.patches import Rectangle

    scale, unit = length_scale(found.unit, found.metres_per_unit)
    place, flat = scale * found.place, found.place.shape[1] == 2
    heights = np.zeros(1) if flat else np.unique(np.round(place[:, 2] / (scale * found.spacing)))
    if len(heights) > FIELD_LAYERS:
        heights = heights[np.linspace(0, len(heights) - 1, FIELD_LAYERS).round().astype(int)]
    width = found.interval[:, 1] / found.interval[:, 0]
    beta_width = found.beta_interval[:, 1] - found.beta_interval[:, 0]
    most = float(max(found.stiffness.max(), 1.0 / found.stiffness.min(), 1.1))
    maps = (
        ("stiffness over its mean [-]", found.stiffness, "RdBu_r", LogNorm(1.0 / most, most)),
        (f"interval ({found.level:.0%}): upper over lower end [-]", width, "viridis", LogNorm(1.0, 10.0)),
        ("beta [-]", found.beta, "cividis", Normalize(0.0, 1.0)),
        (f"interval of beta ({found.level:.0%}), width [-]", beta_width, "viridis", Normalize(0.0, 0.5)),
    )
    figure = canvas(12.0, 1.0 + 2.6 * len(heights) if not flat else 7.4, layout="constrained")
    grid = figure.subplots(2, 2, squeeze=False) if flat else figure.subplots(len(heights), 4, squeeze=False)
    for number, (title, value, colours, norm) in enumerate(maps):
        drawn = None
        for row, height in enumerate(heights):
            axis = grid.flat[number] if flat else grid[len(heights) - 1 - row, number]
            here = (
                np.full(len(place), fill_value=True)
                if flat
                else np.round(place[:, 2] / (scale * found.spacing)) == height
            )
            side = scale * found.spacing
            squares = [Rectangle(tuple(one[:2] - 0.5 * side), side, side) for one in place[here]]
            drawn = PatchCollection(squares, cmap=colours, norm=norm, edgecolor="face", linewidth=0.2)
            drawn.set_array(value[here])
            axis.add_collection(drawn)
            axis.autoscale_view()
            axis.set_aspect("equal")
            axis.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
            if found.unit == "px":
                axis.invert_yaxis()
            layer = "" if flat else f", z {height * side:.3g} {unit}"
            axis.set_title(title + layer if flat else layer.removeprefix(", "), fontsize=9)
        panels = [grid.flat[number]] if flat else list(grid[:, number])
        assert drawn is not None
        figure.colorbar(drawn, ax=panels, label=title, extend="max" if "interval" in title else "neither")
    figure.suptitle(f"{found.verdict}: stiffest over softest {found.ratio:.3g}")
    return png_of(figure, 110)


def yield_png(found: "YieldEstimate", motion: "Motion") -> bytes:
    """The error over the yield strain with the interval, and the set that grows from frame to frame."""
    figure = canvas(11.0, 4.2, layout="constrained")
    left, right = figure.subplots(1, 2)
    strain, rms = found.curve
    scale, unit = length_scale(found.unit, found.metres_per_unit)
    left.plot(strain, scale * rms, "-", color="tab:blue", label="yielding at this strain")
    left.axhline(scale * found.elastic_deviation, color="tab:gray", linestyle="--", label="elastic")
    low, high = found.yield_strain.interval
    left.axvspan(low, high or strain[-1], color="tab:orange", alpha=0.3, label=f"{found.level:.0%} interval")
    if high is not None:
        left.axvline(found.yield_strain.value, color="tab:orange", label=f"{found.yield_strain.value:.3g}")
    left.set(
        xscale="log", yscale="log", xlabel="yield strain |S - I|", ylabel=f"residual of a coordinate, rms [{unit}]"
    )
    left.legend()
    frames = np.flatnonzero(motion.judged.any(axis=1))

    def apart(states: FloatArray) -> FloatArray:
        """(frames,) root mean square distance of states (frames, K, d) from the observed particles, in the unit
        shown."""
        square = np.where(motion.judged, np.sum((states - motion.position) ** 2, axis=2), np.nan)[frames]
        return np.asarray(scale * np.sqrt(np.nanmean(square, axis=1)))

    right.plot(frames, apart(motion.rest[None]), "o-", color="tab:blue", label="observed to rest")
    right.plot(frames, apart(found.elastic), "^--", color="tab:gray", label="observed to elastic")
    right.plot(frames, apart(found.simulated), "s-", color="tab:red", label="observed to yielding")
    right.set(xlabel="frame", ylabel=f"distance of free particles, rms [{unit}]", ylim=(0.0, 1.3 * right.get_ylim()[1]))
    right.legend()
    figure.suptitle(f"Yield strain: {found.verdict}")
    return png_of(figure, 130)


def recovery_png(found: "RecoveryEstimate") -> bytes:
    """Displacement of the surface over time, and the recovery that was fitted after the release."""
    figure = canvas(7.2, 4.2, layout="constrained")
    axis = figure.subplots()
    axis.plot(found.time, found.observed, ".", color="tab:blue", label="observed")
    axis.plot(found.time, found.simulated, "-", color="tab:red", label="law of recovery")
    if found.released < len(found.time):
        axis.axvline(found.time[found.released], color="tab:gray", linestyle="--", label="no contact from here on")
    low, high = found.set.interval
    axis.axhspan(low, max(high, low + 1e-3), color="tab:orange", alpha=0.3, label=f"permanent, {found.level:.0%}")
    axis.set(xlabel="time [s]", ylabel="share of the largest displacement [-]")
    axis.grid(alpha=0.3)
    axis.legend()
    least = "at least " * bool(found.reasons)
    axis.set_title(f"{found.verdict}: {least}{found.share.value:.0%} of the modulus relaxes", fontsize=10)
    if found.force_kept:
        axis.set_xlabel(f"time [s]\nheld in place it {found.force_kept[-1]}")
    return png_of(figure, 130)
