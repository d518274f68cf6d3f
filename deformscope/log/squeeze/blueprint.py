"""The view of a squeeze in one window: the pads and the container, changes, and the classification of its content."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from deformscope.frames import Stream
from deformscope.log.rig.blueprint import blueprint_of, plot_view, rig_views, tactile_view
from deformscope.log.rig.columns import root
from deformscope.log.rig.numbers import plotted
from deformscope.log.squeeze.display import CHANGE, CONTAINER, CONTENT, FORCE, MEASURED, NAMED, place_views
from deformscope.pictures.palette import BACKGROUND
from deformscope.rows import ENTITIES
from deformscope.stages.squeeze.trial import SqueezePhase
from deformscope_drivers.sdh.kinematics import AXIS_NAMES, FINGERS

WINDOW_S = 6.0
"""How far back the plots show: a squeeze from the air on."""
CLOSING = [axis in (FINGERS[0].proximal_axis, FINGERS[2].proximal_axis) for axis in range(len(AXIS_NAMES))]
"""Which axes close."""


def squeeze_blueprint(
    streams: Sequence[Stream],
    tactile: str,
    camera: str,
    around_px: tuple[float, float, float, float] | None = None,
    *,
    named: bool = False,
    placed: bool = False,
) -> rrb.Blueprint:
    """The views of a squeeze with these devices; the devices' own views in a second tab.

    around_px: left, top, right, bottom of the depth image that is shown, None = all; named: a model names the content
    placed: an arm placed the hand"""
    hand = next(stream for stream in streams if stream.device == tactile)
    simulated = " (SIMULATED)" if hand.simulated else ""
    pictures: list[rrb.View] = [tactile_view(hand)]
    shares = [1.0]
    if camera:
        contents = [f"+ /{root('depth', camera)}", f"+ /{CONTAINER}/**"]
        bounds = None
        if around_px is not None:
            left, top, right, bottom = around_px
            bounds = rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom])
        name = f"{camera}: depth [m], model before (green), after (red){simulated}"
        pictures.append(rrb.Spatial2DView(contents=contents, name=name, visual_bounds=bounds))
        about = f"depth change: data minus model{simulated}"
        pictures.append(rrb.Spatial2DView(contents=[f"+ /{CHANGE}"], name=about, background=list(BACKGROUND)))
        shares += [1.1, 0.9]
    hands = [
        plot_view(
            path,
            "closing axes [deg]: finger 0 orange, 2 pink",
            window_s=WINDOW_S,
            plot_legend=rrb.PlotLegend(visible=False),
            overrides={path: rr.SeriesLines(names=list(AXIS_NAMES), visible_series=CLOSING)},
        )
        for stream in streams
        if stream.kind == "hand"
        for path, _ in plotted(stream)
    ]
    lanes = rrb.StateTimelineView(contents=[f"+ /{ENTITIES[SqueezePhase]}"], origin="squeeze", name="phases")
    plots = [plot_view(FORCE, f"force of the fingertips [N]{simulated}", window_s=WINDOW_S), *hands]
    below: list[rrb.View] = [rrb.TextDocumentView(origin=MEASURED, name="what was measured")]
    if named:
        share = rrb.ScalarAxis(range=(0.0, 1.0), zoom_lock=True)
        plots.append(
            plot_view(CONTENT, "probability of each content, by touch and vision", window_s=WINDOW_S, axis_y=share)
        )
        below.append(rrb.TextDocumentView(origin=NAMED, name="content of the container"))
    numbers = rrb.Horizontal(
        rrb.Vertical(rrb.Horizontal(*plots), lanes, row_shares=[3.0, 1.0]),
        *below,
        column_shares=[1.1 * len(plots), *[1.1, 0.9][: len(below)]],
    )
    above = rrb.Horizontal(*pictures, column_shares=shares)
    shown = rrb.Vertical(above, numbers, row_shares=[3.0, 2.2], name="Squeeze")
    devices = rrb.Vertical(rig_views(streams), name="Devices")
    return blueprint_of(rrb.Tabs(shown, *([place_views(streams, camera)] if placed else []), devices, active_tab=0))
