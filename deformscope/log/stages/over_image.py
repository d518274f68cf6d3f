"""Results of stages as marks: flow and particles over the image that they were found in; centres of pressure on
the picture of the hand, with force and contact area of each pad over time; force and torque at the tip over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.arrays import FloatArray
from deformscope.frames import StageResult, Stream
from deformscope.log.rig.blueprint import blueprint_of, plot_view, rig_views, tactile_view
from deformscope.log.rig.columns import Batch, moments, root, scalars
from deformscope.log.rig.tactile import Hand
from deformscope.pictures.palette import HELD, LOST, OBSERVED, SIMULATED, colors, round_up
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.see.arrows import FlowArrows


@dataclass(frozen=True, slots=True)
class StageGroup:
    """Results of one stage, from one device and of one type, which are logged together.

    pads: layout of the tactile device, None for another device; results: plotted; drawn: results that are marked or
    drawn; start_ns: host time at which `session` is 0 [ns]"""

    pads: Stream | None
    device: str
    results: Sequence[StageResult]
    drawn: Sequence[StageResult]
    start_ns: int


STILL_PX = 0.25
"""Length below which an arrow would show the flow's noise."""
LONGEST_STEPS = 2.0
"""Length of the longest arrow, in distances between arrows."""
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
        batch.show(f"{path}/words", when, _label(flow.at_px, step, words))


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
        lines = np.stack([fit.rest_px, fit.observed_px], axis=1)[fit.seen].astype(np.float32)
        batch.show(f"{path}/moved", when, rr.LineStrips2D(lines, colors=LOST, radii=0.03 * spacing, draw_order=40.0))
        held = np.zeros(len(fit.seen), np.bool_)
        held[fit.held] = True
        for name, points, color, share, order in (
            ("observed", fit.observed_px[fit.seen & ~held], OBSERVED, 0.14, 50.0),
            ("held", fit.observed_px[fit.seen & held], HELD, 0.14, 51.0),
            ("simulated", fit.simulated_px[known & ~held], SIMULATED, 0.08, 52.0),
        ):
            marks = rr.Points2D(points, colors=color, radii=share * spacing, draw_order=order)
            batch.show(f"{path}/{name}", when, marks)
        value = "" if np.isnan(fit.value) else f"{fit.parameter} = {fit.value:.3g}: "
        batch.show(f"{path}/words", when, _label(fit.rest_px, spacing, value + fit.verdict_text))


def _label(points: FloatArray, spacing: float, words: str) -> rr.Points2D:
    """A label over the middle of lattice points (n, 2) [px]."""
    low, high = points.min(axis=0), points.max(axis=0)
    place = np.array([0.5 * (low[0] + high[0]), low[1] - 0.8 * spacing])
    return rr.Points2D([place], radii=0.1, labels=[words], show_labels=True, draw_order=60.0)


def _spacing(points: FloatArray) -> float:
    """Distance between neighbouring columns or rows of lattice points (n, 2), whichever is less [px]."""
    steps = [np.diff(np.unique(np.round(points[:, axis], 3))) for axis in (0, 1)]
    return float(min((step.min() for step in steps if step.size), default=10.0))


MARK_MM = 1.6
CENTER = (0, 255, 220)


def log_pads(batch: Batch, group: StageGroup) -> None:
    assert group.pads is not None
    times = moments([one.host_ns for one in group.results], group.start_ns)
    for quantity, values in (
        ("force", [one.result.force_n for one in group.results]),
        ("area", [one.result.area_m2 * 1e4 for one in group.results]),
    ):
        batch.send_columns(f"{PLOTS}/{quantity}/{group.device}", times, scalars(values))
    hand = Hand.of(group.pads.pads)
    corners = np.array([(left, top) for top, left in hand.corners]) * hand.texel_mm
    centers, labels, counts = [], [], []
    for one in group.drawn:
        touched = np.flatnonzero(one.result.area_m2 > 0.0)
        centers.append(corners[touched] + one.result.center_m[touched] * 1e3)
        labels += [f"{one.result.force_n[pad]:.2f} N, {one.result.area_m2[pad] * 1e4:.1f} cm2" for pad in touched]
        counts.append(len(touched))
    total = sum(counts)
    columns = [
        *rr.Points2D.columns(
            positions=np.concatenate(centers), radii=[MARK_MM] * total, colors=[CENTER] * total, labels=labels
        ).partition(counts),
        *rr.Points2D.columns(show_labels=[True] * len(group.drawn), draw_order=[70.0] * len(group.drawn)),
    ]
    times = moments([one.host_ns for one in group.drawn], group.start_ns)
    batch.send_columns(root("display/tactile", group.device, "contact"), times, columns)


def log_wrench(batch: Batch, group: StageGroup) -> None:
    for quantity in ("force_n", "torque_nm"):
        known = [one for one in group.results if getattr(one.result, quantity) is not None]
        if known:
            times = moments([one.host_ns for one in known], group.start_ns)
            values = scalars([getattr(one.result, quantity) for one in known])
            batch.send_columns(f"{PLOTS}/{quantity.split('_')[0]}/{group.device}", times, values)


# The views of stages: each result on its frames; numbers over time; lag and text

PLOTS = "display/stage/plot"
WORDS = "display/stage/summary"
OVER_IMAGE = ("flow", "beta")
TITLES = {
    "flow": "{}: optical flow [px]",
    "beta": "{}: beta (observed blue, simulated red, held yellow)",
    "surface": "{}: height of the surface [mm]",
    "contact": "{}: force of the last approach [N]",
}


def stage_blueprint(stages: Sequence[tuple[str, str]], streams: Sequence[Stream]) -> rrb.Blueprint:
    """Two tabs: the stages' results, and the devices' own views. stages: (name, device)"""
    pictures: list[rrb.View] = []
    plots: list[rrb.View] = []
    for name, device in stages:
        stream = next(one for one in streams if one.device == device)
        simulated = " (SIMULATED)" if stream.simulated else ""
        if name == "tactile":
            pictures.append(tactile_view(stream))
            plots.append(plot_view(f"{PLOTS}/force/{device}", f"{device}: force [N]{simulated}"))
            plots.append(plot_view(f"{PLOTS}/area/{device}", f"{device}: contact area [cm2]{simulated}"))
            continue
        if name == "wrench":
            plots.append(plot_view(f"{PLOTS}/force/{device}", f"{device}: force at the tip [N]{simulated}"))
            if stream.torques:
                plots.append(plot_view(f"{PLOTS}/torque/{device}", f"{device}: torque at the tip [N m]{simulated}"))
            continue
        title = TITLES[name].format(device) + simulated
        if name in OVER_IMAGE:
            contents = [f"+ /{root('color', device)}", f"+ /{root(f'display/stage/{name}', device)}/**"]
            pictures.append(rrb.Spatial2DView(contents=contents, name=title))
        else:
            pictures.append(rrb.Spatial2DView(contents=[f"+ /display/stage/{name}"], name=title))
        if name == "beta":
            plots.append(plot_view(f"{PLOTS}/beta", f"beta and its 90 % interval{simulated}"))
    plots.append(plot_view(f"{PLOTS}/lag", "results behind their frame [ms]", below=True))
    words = rrb.TextDocumentView(contents=[f"+ /{WORDS}"], origin=WORDS, name="Stages")
    shown = rrb.Vertical(
        rrb.Grid(*pictures, grid_columns=min(len(pictures), 4)),
        rrb.Horizontal(*plots),
        words,
        row_shares=[4.0, 2.4, 0.5 + 0.25 * len(stages)],
        name="Stages",
    )
    devices = rrb.Vertical(rig_views(streams), name="Devices")
    return blueprint_of(rrb.Tabs(shown, devices, active_tab=0))
