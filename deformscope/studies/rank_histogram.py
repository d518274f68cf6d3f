"""The picture of simulation-based calibration: how truths rank in their posteriors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import binom

from deformscope.pictures.figures import canvas, png_of
from deformscope.studies.coverage import Outcome

BINS = 10


def rank_counts(outcomes: Sequence[Outcome]) -> dict[str, list[int]]:
    """How many truths fall into each tenth of their posterior, of each condition; truths at the bound 0 left out."""
    found: dict[str, list[int]] = {}
    for name in dict.fromkeys(one.condition for one in outcomes):
        ranks = [one.rank for one in outcomes if one.condition == name]
        found[name] = np.histogram(ranks, BINS, (0.0, 1.0))[0].tolist()
    return found


def ranks_png(counts: dict[str, list[int]]) -> bytes:
    """A histogram for each condition, with the band that holds 99 % of bins if the posterior is right."""
    columns = min(4, len(counts))
    rows = -(-len(counts) // columns)
    figure = canvas(3.2 * columns, 2.5 * rows + 0.5, layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel())
    edges = np.linspace(0.0, 1.0, BINS + 1)
    for place, axis in enumerate(axes):
        axis.set_visible(place < len(counts))
    for place, (axis, (name, count)) in enumerate(zip(axes, counts.items(), strict=False)):
        total = sum(count)
        low, high = binom.ppf([0.005, 0.995], total, 1.0 / BINS)
        axis.stairs(count, edges, fill=True, color="tab:blue", label="truths")
        axis.axhspan(low, high, color="0.2", alpha=0.2, label="99 % of bins, if right")
        axis.axhline(total / BINS, color="0.2", linewidth=0.8)
        axis.set_title(name, fontsize=9)
        axis.set_xlim(0.0, 1.0)
        axis.set_ylim(0.0, 1.15 * max(*count, high))
        if place % columns == 0:
            axis.set_ylabel("truths in the bin")
        if place >= len(counts) - columns:
            axis.set_xlabel("posterior mass below the truth")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=8)
    return png_of(figure, 130)
