"""The views of stages: each result on its frames; numbers over time; lag and text."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from deformscope.frames import Stream
from deformscope.log.rig.blueprint import blueprint_of, plot_view, rig_views, tactile_view
from deformscope.log.rig.columns import root

PLOTS = "display/stage/plot"
WORDS = "display/stage/summary"
OVER_IMAGE = ("flow", "particles", "beta", "theta", "field")
TITLES = {
    "flow": "{}: optical flow [px]",
    "particles": "{}: particles (seen blue, lost white)",
    "beta": "{}: beta (observed blue, simulated red, held yellow)",
    "theta": "{}: theta (observed blue, simulated red, held yellow)",
    "field": "{}: stiffness (soft dark, stiff bright, unknown white)",
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
        title = TITLES[name].format(device) + simulated
        if name in OVER_IMAGE:
            contents = [f"+ /{root('color', device)}", f"+ /{root(f'display/stage/{name}', device)}/**"]
            pictures.append(rrb.Spatial2DView(contents=contents, name=title))
        else:
            pictures.append(rrb.Spatial2DView(contents=[f"+ /display/stage/{name}"], name=title))
        if name in ("beta", "theta"):
            plots.append(plot_view(f"{PLOTS}/{name}", f"{name} and its 90 % interval{simulated}"))
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
