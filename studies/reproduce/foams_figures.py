"""The figures of experiment 3.B: figure 3.14 with intervals, stiffness, particles, one property at a time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from deformscope.pictures.figures import canvas
from deformscope.stages.fit.estimate import Estimate
from studies.reproduce.foam_fits import HELD, PX_PER_CM, Control, FoamResult, Held, Source, Trend

COLOURS = ("#d55e00", "#e69f00", "#009e73", "#0072b2", "#aa3377")
"""Colours of the foams in their order, which colour-blind readers can distinguish (Okabe and Ito 2008)."""

SIZE_COLOURS = ("#7f3b08", "#2d8fbd", "#8073ac", "#5a5a5a")
"""Colours of the cluster sizes."""

HOLDING: dict[Held, str] = {
    "one": "one particle below the clamp held, as in the thesis",
    "clamp": "all particles below the clamp held",
}
MM_PER_PX = 10.0 / PX_PER_CM


def figure_3_14(results: Sequence[FoamResult], trends: Sequence[Trend], held: Held, path: Path) -> None:
    """Error over beta, and beta over hardness with intervals, for each cluster size."""
    sizes = [t.cluster_size for t in trends if t.held == held and t.source == "flow"]
    figure, axes = _figure(2, len(sizes), 4.2 * len(sizes), 7.2)
    for column, size in enumerate(sizes):
        curve, values = axes[0, column], axes[1, column]
        for place, (result, colour) in enumerate(zip(results, COLOURS, strict=False)):
            one = result.fit("flow", held, size).estimate
            # thick below thin: curves that coincide are all seen
            thick = 5.0 - 4.0 * place / max(1, len(results) - 1)
            curve.plot(one.curve.parameter, one.curve.aee * MM_PER_PX, color=colour, lw=thick, label=result.foam.name)
            curve.plot(one.value, one.aee * MM_PER_PX, "o", color=colour, ms=4.0 + 1.5 * thick)
            _with_interval(values, result, "flow", held, size, colour, -2.0)
            _with_interval(values, result, "true", held, size, colour, 2.0)
        curve.set(title=f"clusters {size} x {size}", xlabel="beta", xlim=(-0.02, 1.0))
        curve.set_ylim(bottom=0.0)
        found = _to_text(next(t for t in trends if (t.source, t.held, t.cluster_size) == ("flow", held, size)))
        values.set(xlabel="hardness [N]  (density/hardness)", ylim=(-0.03, 1.03))
        values.set_title(found, fontsize=9)
        _hardness_ticks(values, results)
    axes[0, 0].set_ylabel("average Euclidean error [mm]")
    axes[0, 0].legend(title="density/hardness", fontsize=8)
    axes[1, 0].set_ylabel("beta, 90 % interval")
    figure.legend(
        handles=[
            mpl.lines.Line2D([], [], color="0.3", marker="o", ls="-", label="from optical flow"),
            mpl.lines.Line2D([], [], color="0.3", marker="o", mfc="white", ls="-", label="from the true positions"),
        ],
        fontsize=9,
        ncols=2,
        loc="outside lower center",
    )
    figure.suptitle(f"Thesis figure 3.14 on virtual foams: {HOLDING[held]}")
    figure.savefig(path)


def stiffness(results: Sequence[FoamResult], path: Path) -> None:
    """The model's k and the force against hardness."""
    sizes = sorted({fit.cluster_size for fit in results[0].fits})
    figure, axes = _figure(1, 2, 11.0, 4.6)
    hardness = np.array([result.foam.hardness for result in results])
    order = np.argsort(hardness)
    for size, marker, shift, colour in zip(sizes, "osD^v", (-2.0, 0.0, 2.0), SIZE_COLOURS, strict=False):
        found = [result.fit("flow", "clamp", size).estimate.stiffness for result in results]
        if any(one is None for one in found):
            continue
        value = np.array([one[0] for one in found if one is not None])
        ends = np.array([one[1] for one in found if one is not None]).T
        axes[0, 0].errorbar(
            (hardness + shift)[order], value[order], yerr=np.abs(ends - value)[:, order], marker=marker, color=colour,
            capsize=3, label=f"k, clusters {size} x {size}",
        )  # fmt: skip
    force = np.array([result.stiffness for result in results])
    axes[0, 0].plot(hardness[order], force[order], "k*--", ms=9, label="force / depth of the clamp")
    axes[0, 0].set(yscale="log", ylabel="stiffness [N/m]", xlabel="hardness [N]  (density/hardness)")
    axes[0, 0].set_title("Stiffness from force and position", fontsize=10)
    axes[0, 0].legend(fontsize=8, loc="lower right")
    axes[0, 0].set_ylim(bottom=20.0)
    _hardness_ticks(axes[0, 0], results)
    for result, colour in zip(results, COLOURS, strict=False):
        depth = 1e3 * np.array([0.0, *result.depth_m])
        axes[0, 1].plot(depth, [0.0, *result.force_n], "o-", color=colour, label=result.foam.name)
    axes[0, 1].set(xlabel="depth of the clamp [mm]", ylabel="force [N] on 10 cm thickness")
    axes[0, 1].set_title("Force during the push", fontsize=10)
    axes[0, 1].legend(title="density/hardness", fontsize=8)
    figure.suptitle("Stiffness needs the force: the model's k and the measured force")
    figure.savefig(path)


def particles(results: Sequence[FoamResult], held: Held, cluster_size: int, path: Path) -> None:
    """The last image of each foam, with observed and simulated particles."""
    rows = -(-len(results) // 2)
    figure, axes = _figure(rows, 2, 13.0, 3.9 * rows)
    for axis in axes.flat[len(results) :]:
        axis.axis("off")
    for axis, result in zip(axes.flat, results, strict=False):
        found = result.fit("flow", held, cluster_size)
        shape = found.comparisons[0]
        axis.imshow(result.image, cmap="gray", vmin=0, vmax=255, alpha=0.75)
        seen = shape.observed[shape.seen]
        ends = np.stack([seen, shape.simulated[shape.seen]])
        axis.plot(ends[..., 0], ends[..., 1], color="gold", lw=1.2)
        axis.plot(*seen.T, "o", color="#1a6fdf", ms=4.5, label="observed")
        axis.plot(*shape.simulated.T, "o", color="#e01e1e", ms=3.0, label="simulated")
        axis.plot(*shape.simulated[shape.held].T, "o", mfc="none", color="k", ms=7, label="held")
        one = found.estimate
        words = (
            f"{result.foam.name}: beta {one.value:.2f} [{one.interval[0]:.2f}, {one.interval[1]:.2f}], {one.verdict}"
        )
        axis.set_title(f"{words}; error {one.aee * MM_PER_PX:.2f} mm", fontsize=10)
        axis.set(xlabel="x [px]", ylabel="y [px]")
    shown, names = axes.flat[0].get_legend_handles_labels()
    figure.legend(shown, names, ncols=len(shown), loc="outside lower center")
    figure.suptitle(f"Last image of each push, 50 px = 1 cm; clusters {cluster_size} x {cluster_size}, {HOLDING[held]}")
    figure.savefig(path)


def one_change(found: Sequence[Control], path: Path) -> None:
    """Beta of the middle foam with one property changed at a time, from true positions."""
    sizes = sorted({fit.cluster_size for fit in found[0].fits})
    figure, axes = _figure(1, len(HELD), 13.0, 5.2)
    labels = [f"{_change(one)}\n{one.moved_mm(found[0]):.2f} mm, {one.force_n:.0f} N" for one in found]
    for axis, held in zip(axes.flat, HELD, strict=True):
        for size, marker, shift, colour in zip(sizes, "osD^v", (-0.2, 0.0, 0.2), SIZE_COLOURS, strict=False):
            estimates = [
                next(f.calibration.estimate for f in one.fits if (f.held, f.cluster_size) == (held, size))
                for one in found
            ]
            value = np.array([one.value for one in estimates])
            ends = np.array([one.interval for one in estimates]).T
            axis.errorbar(
                np.arange(len(found)) + shift, value, yerr=np.abs(ends - value), fmt=marker, color=colour, capsize=3,
                label=f"clusters {size} x {size}",
            )  # fmt: skip
        axis.set_xticks(range(len(found)), labels, fontsize=7, rotation=45, ha="right", rotation_mode="anchor")
        axis.set(ylabel="beta, 90 % interval", ylim=(-0.03, 1.03))
        axis.set_title(HOLDING[held], fontsize=10)
        axis.grid(alpha=0.3)
    shown, names = axes.flat[0].get_legend_handles_labels()
    figure.legend(shown, names, ncols=len(shown), fontsize=9, loc="outside lower center")
    figure.suptitle(
        "One property changed at a time, true positions (below: rms motion due to the change, and the force)"
    )
    figure.savefig(path)


def _change(one: Control) -> str:
    units = {"hardness": " N", "density": " kg/m3"}
    names = {"poisson": "Poisson's ratio", "plateau": "plateau exponent"}
    if one.changed == "nothing":
        return f"{one.foam.name}, unchanged"
    return f"{names.get(one.changed, one.changed)} {getattr(one.foam, one.changed):g}{units.get(one.changed, '')}"


def _with_interval(
    axis: Any, result: FoamResult, source: Source, held: Held, size: int, colour: str, shift: float
) -> None:
    one: Estimate = result.fit(source, held, size).estimate
    off = np.abs(np.array(one.interval)[:, None] - one.value)
    face = colour if source == "flow" else "white"
    axis.errorbar(result.foam.hardness + shift, one.value, yerr=off, fmt="o", color=colour, mfc=face, capsize=3)


def _to_text(one: Trend) -> str:
    correlation = "" if one.rank_correlation is None else f"; rank correlation {one.rank_correlation:+.1f}"
    return f"softest - firmest {one.drop:+.2f}{correlation}\n{one.told}"


def _hardness_ticks(axis: Any, results: Sequence[FoamResult]) -> None:
    axis.set_xticks(
        [result.foam.hardness for result in results],
        [f"{result.foam.hardness:g}\n{result.foam.name}" for result in results],
        fontsize=8,
    )
    axis.grid(alpha=0.3)


def _figure(rows: int, columns: int, width: float, height: float) -> tuple[Figure, Any]:
    """Drawn off screen, on any display."""
    figure = canvas(width, height, dpi=110, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)
