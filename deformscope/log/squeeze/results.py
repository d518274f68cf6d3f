"""The recording and views of a squeeze: its devices as those of any rig, and every result without loss, with views for
people.

    squeeze/phase|stopped|events|features   one row a result, every field of it a component of the same name
    squeeze/fingertips|container|change|content    likewise, at the time of the frame that it is of
    squeeze/sighting|placement              the container as in the image, the grasp drawn, where an arm places
    display/place/scene|image|words         the same on the table, over the image, and in words
    display/tactile/DEVICE/contact          centre of pressure and principal axis, on the picture of the hand (fig. 2.4)
    display/squeeze/force|content           force of each fingertip [N], probability of each content, over time
    display/squeeze/container               the tracked model's edges over the depth image, before and after (fig. 2.8)
    display/squeeze/change                  the depth change around the fingertip, data minus model (fig. 2.6)
    display/squeeze/measured|named measurements, and the classification of the content, as text"""

from collections.abc import Sequence
from functools import partial

import rerun as rr
import rerun.blueprint as rrb

from deformscope.frames import Stream
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.blueprint import blueprint_of, plot_view, rig_views, tactile_view
from deformscope.log.rig.columns import Batch, log_series, root, states
from deformscope.log.rig.numbers import plotted
from deformscope.log.squeeze import display
from deformscope.log.squeeze.display import (
    CHANGE,
    CONTAINER,
    CONTENT,
    FORCE,
    MEASURED,
    NAMED,
    log_placement,
    log_sighting,
    place_views,
)
from deformscope.log.views import SOMETIMES, ShownStage, Views, views_of
from deformscope.pictures.palette import BACKGROUND, tints_of
from deformscope.rows import ENTITIES
from deformscope.stages.squeeze import trial
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.placement import ContainerSighting, HandPlacement
from deformscope.stages.squeeze.trial import SqueezePhase
from deformscope_drivers.sdh.kinematics import AXIS_NAMES, FINGERS

# The view of a squeeze in one window: the pads and the container, changes, and the classification of its content

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


CAMERA = "squeezed.names.camera"
PHASE, STOPPED = ShownStage("phase", 0, "state of the hand"), ShownStage("stopped", 0, "why", when=SOMETIMES)
SIGHTING = ShownStage("sighting", 2, "the container in the depth image", when=SOMETIMES)
PLACEMENT = ShownStage("placement", 2, "the drawn grasp, and the arm's path to it", when=SOMETIMES)
FINGERTIPS = ShownStage("fingertips", 2, "force, area, centre and axis of pressure (fig. 2.4)")
EVENTS = ShownStage("events", 2, "first contact and steady state")
TRACK = ShownStage("track", 2, "pose of the rigid model in a depth image (fig. 2.8)", when=CAMERA)
FEATURES = ShownStage("features", 2, "tactile and physical, at steady state (fig. 2.7)")
DEPTH_CHANGE = ShownStage("depth change", 2, "data minus model (fig. 2.6)", field="change_m", when=CAMERA)
POSTERIOR = ShownStage("posterior", 2, "probability of each content", when=SOMETIMES)


def log_squeeze_start(rec: rr.RecordingStream, fingertips: display.Fingertips | None) -> None:
    """Log constants: colours of the phases, names of the plots; and empty results."""
    rec.log(ENTITIES[trial.SqueezePhase], states(display.SQUEEZE_PHASES), static=True)
    if fingertips is not None:
        names = [f"{fingertips.stream.pads[place].name} [N]" for place in fingertips.pads]
        log_series(rec, display.FORCE, names, tints_of(len(names)))
    batch = Batch()
    start = ResultBatch(batch, 0)
    start.show_text(display.MEASURED, "*Numbers follow once the fingers are at rest.*")
    start.show_text(display.NAMED, "*Classified from the first contact on.*")
    batch.send(rec)


def prepare_squeeze_results(results: Sequence[object], session_ns: int, fingertips: display.Fingertips | None) -> Batch:
    """Prepare results for one stream or several. session_ns: time since the recording's start [ns].

    Raises TypeError if it is no result of a squeeze."""
    batch = Batch()
    now = ResultBatch(batch, session_ns)
    views = squeeze_views(fingertips)
    for result in results:
        shown = views_of(type(result), views)
        now.record(result)
        for view in shown:
            view(now, result)
    display.log_measured(now, results)
    return batch


def squeeze_views(fingertips: display.Fingertips | None) -> Views[ResultBatch]:
    """The view of each result; events are in the table of `log_measured`."""
    return {
        trial.SqueezePhase: (PHASE, partial(ResultBatch.show_phase, known=display.SQUEEZE_PHASES)),
        trial.SqueezeStop: (STOPPED, ResultBatch.show_stop),
        trial.FingertipPressure: (
            FINGERTIPS,
            *(() if fingertips is None else [partial(display.log_fingertips, fingertips=fingertips)]),
        ),
        trial.TrackedContainer: (TRACK, display.log_container),
        trial.ContainerChange: (DEPTH_CHANGE, display.log_container_change),
        trial.SqueezeFeatures: (FEATURES, display.log_change),
        trial.ContentPosterior: (POSTERIOR, display.log_content),
        SqueezeEvents: (EVENTS,),
        ContainerSighting: (SIGHTING, log_sighting),
        HandPlacement: (PLACEMENT, log_placement),
    }
