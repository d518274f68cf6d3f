"""Flow and particles over the image that they were found in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.rig.columns import Batch, moments, root, scalars
from deformscope.log.stages.group import StageGroup
from deformscope.log.stages.views import PLOTS
from deformscope.pictures.palette import HELD, LOST, OBSERVED, SIMULATED, colors, round_up
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.see.arrows import FlowArrows

STILL_PX = 0.25
"""Below this an arrow would show the flow's noise."""
LONGEST_STEPS = 2.0
"""The longest arrow, in distances between arrows."""
STRETCHES = (1.0, 2.0, 5.0, 10.0, 20.0)


def log_flow_arrows(batch: Batch, group: StageGroup) -> None:
    for one in group.drawn:
        flow: FlowArrows = one.result
        length = np.nan_to_num(np.hypot(flow.flow_px[:, 0], flow.flow_px[:, 1]))
        moving = length >= STILL_PX
        longest = float(length.max(initial=0.0))
        step = float(np.diff(np.unique(flow.at_px[:, 0])).min(initial=np.inf))
        times = max((k for k in STRETCHES if k * longest <= LONGEST_STEPS * step), default=1.0)
        tints = colors(length[moving] / round_up(longest))
        path = root("display/stage/flow", group.device)
        when = moments([one.host_ns], group.start_ns)
        vectors = flow.flow_px[moving] * times
        arrows = rr.Arrows2D(origins=flow.at_px[moving], vectors=vectors, colors=tints, radii=1.0, draw_order=40.0)
        batch.show(f"{path}/arrows", when, arrows)
        first = one.used[0].first
        words = f"from frame {first} to {one.used[-1].last}: up to {longest:.2g} px, arrows {times:g} times as long"
        _label(batch, f"{path}/words", _above(flow.at_px, step), words, when)


def log_moments(batch: Batch, group: StageGroup) -> None:
    values = []
    for one in group.results:
        fit: MomentFit = one.result
        values.append(np.array([fit.interval[0], fit.value, fit.interval[1]]))
    times = moments([one.host_ns for one in group.results], group.start_ns)
    batch.send_columns(f"{PLOTS}/beta", times, scalars(values))
    for one in group.drawn:
        fit = one.result
        path, when = root("display/stage/beta", group.device), moments([one.host_ns], group.start_ns)
        spacing = _spacing(fit.rest_px)
        known = fit.seen & np.isfinite(fit.simulated_px).all(axis=1)
        lines = np.stack([fit.rest_px[fit.seen], fit.observed_px[fit.seen]], axis=1)
        moved = rr.LineStrips2D(lines.astype(np.float32), colors=LOST, radii=0.03 * spacing, draw_order=40.0)
        batch.show(f"{path}/moved", when, moved)
        held = np.zeros(len(fit.seen), np.bool_)
        held[fit.held] = True
        for name, points, color, share, order in (
            ("observed", fit.observed_px[fit.seen & ~held], OBSERVED, 0.14, 50.0),
            ("held", fit.observed_px[fit.seen & held], HELD, 0.14, 51.0),
            ("simulated", fit.simulated_px[known & ~held], SIMULATED, 0.08, 52.0),
        ):
            marks = rr.Points2D(points, colors=color, radii=share * spacing, draw_order=order)
            batch.show(f"{path}/{name}", when, marks)
        value = "" if np.isnan(fit.value) else f"beta = {fit.value:.3g}: "
        _label(batch, f"{path}/words", _above(fit.rest_px, spacing), value + fit.verdict_text, when)


def _above(points: FloatArray, spacing: float) -> FloatArray:
    """(2,) place of a label over the middle of lattice points (n, 2) [px]."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array([0.5 * (low[0] + high[0]), low[1] - 0.8 * spacing])


def _label(batch: Batch, path: str, place: FloatArray, words: str, when: Sequence[rr.TimeColumn]) -> None:
    batch.show(path, when, rr.Points2D([place], radii=0.1, labels=[words], show_labels=True, draw_order=60.0))


def _spacing(points: FloatArray) -> float:
    """Distance between neighbouring columns or rows of lattice points (n, 2), whichever is less [px]."""
    steps = [np.diff(np.unique(np.round(points[:, axis], 3))) for axis in (0, 1)]
    return float(min((step.min() for step in steps if step.size), default=10.0))
