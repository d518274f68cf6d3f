"""What a person sees of a squeeze in one window: the pads and the container, what changed, and what is in it."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from deformscope.frames import Stream
from deformscope.log.rig.blueprint import blueprint_of, plot_view, rig_views, tactile_view
from deformscope.log.rig.columns import root
from deformscope.log.rig.numbers import plotted
from deformscope.log.squeeze.change import CHANGE
from deformscope.log.squeeze.container import CONTAINER
from deformscope.log.squeeze.content import CONTENT
from deformscope.log.squeeze.fingertips import FORCE
from deformscope.log.squeeze.summary import SQUEEZE_SUMMARY
from deformscope.rows import ENTITIES
from deformscope.stages.squeeze.trial import SqueezePhase


def squeeze_blueprint(streams: Sequence[Stream], tactile: str, camera: str) -> rrb.Blueprint:
    """The views of a squeeze with these devices; the devices' own views in a second tab."""
    felt = next(stream for stream in streams if stream.device == tactile)
    said = " (SIMULATED)" if felt.simulated else ""
    pictures: list[rrb.View] = [tactile_view(felt)]
    if camera:
        contents = [f"+ /{root('depth', camera)}", f"+ /{root('display/depth', camera)}", f"+ /{CONTAINER}/**"]
        pictures.append(rrb.Spatial2DView(contents=contents, name=f"{camera}: depth and tracked model{said}"))
        pictures.append(rrb.Spatial2DView(contents=[f"+ /{CHANGE}"], name="Depth change, data minus model"))
    hands = [path for stream in streams if stream.kind == "hand" for path, _ in plotted(stream)]
    lanes = rrb.StateTimelineView(contents=[f"+ /{ENTITIES[SqueezePhase]}"], origin="squeeze", name="Phases")
    summary = rrb.TextDocumentView(contents=[f"+ /{SQUEEZE_SUMMARY}"], origin=SQUEEZE_SUMMARY, name="What is in it")
    over_time = rrb.Vertical(
        rrb.Horizontal(
            plot_view(FORCE, f"force of the fingertips [N]{said}"),
            *(plot_view(path, f"joint angles [deg]{said}") for path in hands),
        ),
        lanes,
        row_shares=[3.0, 1.0],
    )
    below = rrb.Horizontal(
        over_time,
        plot_view(CONTENT, "probability of each content", below=True),
        summary,
        column_shares=[2.4, 1.6, 1.0],
    )
    shown = rrb.Vertical(rrb.Horizontal(*pictures), below, row_shares=[3.0, 2.2], name="Squeeze")
    devices = rrb.Vertical(rig_views(streams), name="Devices")
    return blueprint_of(rrb.Tabs(shown, devices, active_tab=0))
