"""The tracked model's edges over the depth image (Thesis fig. 2.8)."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.log.exploration.moment import ResultBatch
from deformscope.pictures.palette import BAD, SIMULATED
from deformscope.stages.squeeze.trial import TrackedContainer

CONTAINER = "display/squeeze/container"
WIDTH_PX = 1.2


def log_container(now: ResultBatch, tracked: TrackedContainer) -> None:
    """Red like all that is simulated; darker where the track is bad."""
    color = SIMULATED if tracked.good else BAD
    words = f"{100 * tracked.agreeing:.0f} % of the pixels agree"
    label = words if tracked.good else f"not used: {tracked.reason}"
    edges = tracked.edges_px.astype(np.float32)
    now.show(CONTAINER, rr.LineStrips2D(edges, radii=WIDTH_PX, colors=color, draw_order=80.0))
    place = edges.reshape(-1, 2).min(axis=0) if len(edges) else np.zeros(2)
    named = rr.Points2D([place], radii=0.01, colors=color, labels=[label], show_labels=True, draw_order=81.0)
    now.show(f"{CONTAINER}/words", named)
