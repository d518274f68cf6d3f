"""The tracked model's edges over the depth image, before the contact and after (Thesis fig. 2.8)."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.log.canvas import TEXT
from deformscope.log.result_batch import ResultBatch
from deformscope.pictures.palette import BAD, REST, SIMULATED
from deformscope.stages.squeeze.trial import TrackedContainer

CONTAINER = "display/squeeze/container"
BEFORE_PX, AFTER_PX = 1.4, 0.5
"""Half the width of a line: where the container did not move, both are seen."""


def log_container(now: ResultBatch, tracked: TrackedContainer) -> None:
    """Green at rest, which stays; red as all that is simulated while it is squeezed; darker where the track is bad."""
    before = not tracked.since_s >= 0.0
    color = BAD if not tracked.good else REST if before else SIMULATED
    when = "before contact" if before else f"{tracked.since_s:.1f} s after contact"
    words = f"refused: {tracked.reason}"
    if tracked.good:
        words = f"{100 * tracked.agreeing:.0f} % of the pixels agree"
    if tracked.directions is not None:
        words += f"\ndegrees of freedom: {tracked.degrees}"
    if tracked.lag_s is not None and tracked.live:
        words += f"; {1e3 * tracked.lag_s:.0f} ms behind" + f", {tracked.skipped} left out" * bool(tracked.skipped)
    edges = tracked.edges_px.astype(np.float32)
    path = f"{CONTAINER}/{'before' if before else 'after'}"
    width, order = (BEFORE_PX, 79.0) if before else (AFTER_PX, 80.0)
    now.show(path, rr.LineStrips2D(edges, radii=width, colors=color, draw_order=order))
    points = edges.reshape(-1, 2) if len(edges) else np.zeros((1, 2), np.float32)
    low, high = points.min(axis=0), points.max(axis=0)
    place = [0.5 * (low[0] + high[0]), low[1] - (0.45 if before else 0.3) * (high[1] - low[1])]
    label = [f"{when}: {words}"]
    now.show(
        f"{path}/words",
        rr.Points2D([place], radii=0.01, colors=TEXT, labels=label, show_labels=True, draw_order=81.0),
    )
