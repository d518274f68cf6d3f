"""Distributions of results over many cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from deformscope.pictures.figures import COLOURS, canvas, png_of

COLUMNS, BINS, DPI = 3, 24, 110


def distributions_png(quantities: Mapping[str, Mapping[str, Sequence[float]]]) -> bytes:
    """How many cases gave which value, a panel for each quantity. quantities: finite values by the varied setting"""
    rows = -(-len(quantities) // COLUMNS)
    drawn = canvas(3.6 * COLUMNS, 2.7 * rows, layout="constrained")
    flat = list(np.ravel(drawn.subplots(rows, COLUMNS, squeeze=False)))
    for panel, (name, groups) in zip(flat, quantities.items(), strict=False):
        every = np.concatenate([np.asarray(values, np.float64) for values in groups.values()])
        low, high = every.min(), every.max()
        bins = np.linspace(low, high, BINS + 1) if high > low else np.array([low - 0.5, low + 0.5])
        for number, (group, values) in enumerate(groups.items()):
            filled = "step" if len(groups) > 1 else "stepfilled"
            panel.hist(values, bins, histtype=filled, color=COLOURS[number % len(COLOURS)], label=group)
        panel.locator_params("x", nbins=4)
        panel.set_xlabel(name)
        panel.set_ylabel("cases")
    for panel in flat[len(quantities) :]:
        panel.set_visible(False)
    groups = next(iter(quantities.values()), {})
    if len(groups) > 1:
        flat[0].legend(fontsize="small")
    return png_of(drawn, DPI)
