"""Dents as pictures: cuts through the surface along x under each tip, predicted and, if available, measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from deformscope.pictures.figures import canvas, png_of
from deformscope.stages.poke.comparison import PokeComparison
from deformscope.stages.poke.fitted import Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIMULATED, MEASURED, TIP = "#d92b2b", "#1f5fd0", "#555555"
ACROSS = 3
REACH_M = 0.08


def dents_png(predictions: Sequence[Prediction], compared: Sequence[PokeComparison]) -> bytes:
    """One panel per poke: height change along a line through the tip [mm], and each method's force."""
    import matplotlib as mpl

    measured = {id(one.prediction): one for one in compared}
    rows = -(-len(predictions) // ACROSS)
    columns = min(ACROSS, len(predictions))
    with mpl.rc_context({"font.size": 9}):
        figure = canvas(4.6 * columns, 3.3 * rows + 0.4, layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for panel, one in zip(axes.flat, predictions, strict=False):
            _draw(panel, one, measured.get(id(one)))
        for unused in axes.flat[len(predictions) :]:
            unused.set_axis_off()
        return png_of(figure, 130)


def _draw(axes: Axes, found: Prediction, measured: PokeComparison | None) -> None:
    rest, moved = found.rest[found.surface], (found.position - found.rest)[found.surface]
    at = found.poke.at
    up = rest.shape[1] - 1
    line = np.ones(len(rest), dtype=bool)
    if up == 2:
        off = np.abs(rest[:, 1] - at[1])
        line = off <= off.min() + 1e-9
    line &= np.abs(rest[:, 0] - at[0]) <= REACH_M
    order = np.flatnonzero(line)[np.argsort(rest[line, 0])]
    axes.plot(1e2 * (rest[order, 0] - at[0]), 1e3 * moved[order, up], "-o", ms=3, color=SIMULATED, label="predicted")
    if measured is not None:
        points = measured.poke.points
        off = np.abs(points[:, 1] - at[1])
        near = np.flatnonzero((off <= off.min() + 1e-6) & (np.abs(points[:, 0] - at[0]) <= REACH_M))
        near = near[np.argsort(points[near, 0])]
        x, z = 1e2 * (points[near, 0] - at[0]), 1e3 * measured.poke.moved[near, 2]
        axes.plot(x, z, "x", ms=6, color=MEASURED, label="measured")
    half = 50.0 * found.poke.tip.size[0]
    low = -1e3 * found.depth
    axes.plot([-half, half], [low, low], color=TIP, lw=3, alpha=0.5, label="tip")
    place = ", ".join(f"{v:.3g}" for v in at[:2])
    size = " x ".join(f"{1e3 * side:.3g}" for side in found.poke.tip.size)
    force = "" if found.force is None else f"\n{found.force:.3g} N predicted"
    if measured is not None and measured.poke.force is not None:
        force += f", {measured.poke.force:.3g} N measured"
    axes.set_title(f"{found.poke.tip.shape} {size} mm at ({place}) m{force}", fontsize=9)
    axes.set_xlabel("along x from the tip's axis [cm]")
    axes.set_ylabel("height change [mm]")
    axes.legend(loc="lower right", fontsize=8)
    axes.grid(alpha=0.3)
