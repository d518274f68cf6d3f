"""The recording and views of an exploration: every result without loss, and views for people.

Every row has three times. `session` is the time since the recording's start; `frame` is the depth camera's newest
picture then. `touch` is 0 before the first touch, then the number of its touch from 1, with the travel to it. The
measurement of a touch is at the frame of its dent. `deformscope.recording.items` reads the results back.

    exploration/surface|touch|maps|lumps|plan   one row a result, every field of it a component of the same name
    exploration/forecast|decision likewise: a person's requests on the page, and decisions
    exploration/input/...                 which frames they are computed from, or measurements where there are none
    exploration/phase                     likewise, and the state that a timeline shows
    exploration/failed|stopped            likewise, and why as a line of text
    display/scene/... the surface in space, the contacts, the next touch; with the arm
    display/dent/...                      close up: observed points and simulated particles around the last touch
    display/maps/...                      pictures of the maps with their axes and colour bars
    display/plan/gain                     why the next touch goes where it goes
    display/touch/force|section           force over depth; the dent's height over the distance from the contact
    display/summary results as text
    exploration/perception/look|touch    results between frames and estimates
    exploration/force_pose                likewise, a row for each reading of the force: force and pose of the tip
    display/perception/...                likewise (`deformscope.log.exploration.perception`)
    display/lumps/map|missed|summary where inclusions are sought: found ones, and the detection limit, as text

Its view is one window: the robot at the left, its estimates at the right. Other settings' results for a recorded
exploration are a layer over it, in the recording's views, in two colours:

    display/scene/beside   where the regions end, on the surface in space: recorded, and with the other settings
    display/beside/...     the same as a picture, and the result of each touch"""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deformscope.arrays import FloatArray
from deformscope.frames import Stream
from deformscope.log.canvas import TEXT
from deformscope.log.exploration import display, scene
from deformscope.log.exploration.perception import ERROR, PIXELS, log_error, log_ground, log_pixels, log_tool
from deformscope.log.exploration.perception import MAPS as FIELD_MAPS
from deformscope.log.exploration.scene import DENT as DENT_VIEW
from deformscope.log.exploration.scene import LINE_M, SCENE, SURFACE_FRAME, log_dent
from deformscope.log.result_batch import ResultBatch, png_view
from deformscope.log.rig.blueprint import FLOOR, LEGEND, blueprint_of, depth_view, named, space_view
from deformscope.log.rig.columns import Batch, Place, root, states
from deformscope.log.rig.numbers import plotted
from deformscope.log.views import SOMETIMES, ShownStage, Views, views_of
from deformscope.pictures import exploration as pictures
from deformscope.pictures.exploration import FIELDS
from deformscope.pictures.messages import format_verdict
from deformscope.pictures.palette import BACKGROUND
from deformscope.rows import ENTITIES
from deformscope.stages.map.exploration import (
    DISPLAY,
    ExplorationStop,
    InclusionsResult,
    MapEstimate,
    PhaseStart,
    PlannedTouch,
    StageFailure,
    SteeringDecision,
    SurfaceEstimate,
    TouchEstimate,
    TouchForecast,
)
from deformscope.stages.map.measured import LookFrames, SurfaceMeasurement, TouchFrames, TouchMeasurement
from deformscope.stages.map.perception import ForcePose, LookPerception, TouchPerception

SURFACE = ShownStage("surface", 4, "its height and deviation (eq. 4.3, 4.4)", costs=("look",))
PLAN = ShownStage("plan", 4, "where to touch next, and the gain of each place", costs=("veto",))
CONTACT = ShownStage("contact", 4, "force over depth, and the stiffness of its law", costs=("touch",))
DENT = ShownStage("dent", 4, "points measured around the tip during the press", field="observed_m")
BETA = ShownStage(
    "beta", 3, "particles of the model fitted to the dent (eq. 4.6)", field="simulated_m", when="explore.beta_model"
)
PERCEPTION = ShownStage("perception", 4, "pixels used and removed; what was trained", when="explore.perception")
BETA_ERROR = ShownStage(
    "error over beta", 4, "(eq. 4.6)", field="error.aee", when="explore.perception explore.beta_model"
)
FORCE_POSE = ShownStage(
    "force and pose", 4, "at the force's rate", entity="exploration/force_pose", when="explore.perception"
)
CREEP = ShownStage("creep", 4, "relaxation and loss of a hold", field="creep.held_s", when="explore.hold_s")
REGIONS = ShownStage("regions", 4, "of one stiffness, with their probability", costs=("maps",))
BETA_FIELD = ShownStage("beta field", 4, "over the surface, with deviation", field="beta", when="explore.beta_model")
INCLUSIONS = ShownStage(
    "inclusions", 4, "found inclusions, and the detection limit", costs=("lumps",), when="explore.goal=inclusions"
)
AIM, DECISION, PHASE, FAILED, STOPPED, INPUT = (
    ShownStage(name, 0, gives, when="" if name == "phase" else SOMETIMES)
    for name, gives in (
        ("aim", "forecast of a touch that a person chose"),
        ("decision", "requests of a person about the next touch"),
        ("phase", "state of the robot"),
        ("failed", "a stage that failed"),
        ("stopped", "reason for the early end"),
        ("input", "frames or measurements that results are computed from"),
    )
)

PEAKS = rr.components.AggregationPolicy.MinMax

CELL_M = 0.005
"""Cell size of maps that state none [m]."""
PAPER = [255, 255, 255]
COMPARED_REGIONS = "display/beside/regions"
COMPARED_TOUCHES: dict[Literal["stiffness", "beta"], str] = {
    "stiffness": "display/beside/stiffness",
    "beta": "display/beside/beta",
}
"""Results of other settings with the recorded ones (`deformscope.log.exploration.results`)."""
TITLES = {
    "stiffness": "Stiffness field",
    "stiffness_deviation": "Stiffness field: deviation",
    "beta": "Beta-field",
    "beta_deviation": "Beta-field: deviation",
    "regions": "Regions found",
    "truth": "Truth",
}
ABOVE_M, APART_M = 0.002, 0.07
"""How far the lines are above the surface, and their names above its far edge and each other."""
WIDTHS_M = 3 * LINE_M, LINE_M
"""Line widths, chosen so that both lines are visible where they coincide."""


def comparison_rrd(
    identity: tuple[str, str],
    streams: Sequence[Stream],
    size_m: tuple[float, float],
    recorded: Sequence[tuple[int, object]],
    again: Sequence[object],
    name: str,
) -> bytes:
    """rerun data that a viewer lays over a recording, with views of both.

    identity, streams, size_m: identity, streams and size of the recording and its surface; recorded: its results with
    their time since its start [ns]; again: results with other settings; name: name of these"""
    rec = rr.RecordingStream(identity[0], recording_id=identity[1], send_properties=False)
    encoded = rr.binary_stream(rec)
    truth = any(isinstance(one, MapEstimate) and one.truth_labels is not None for _, one in recorded)
    views = exploration_blueprint(streams, size_m, truth=truth, tabs=True, compared=name)
    rec.send_blueprint(views)
    _batch_of(recorded, again, name).send(rec)
    return encoded.read() or b""


def _batch_of(recorded: Sequence[tuple[int, object]], again: Sequence[object], name: str) -> Batch:
    batch = Batch()
    before: list[TouchEstimate] = []
    others = [one for one in again if isinstance(one, TouchEstimate)]
    maps = {one.touches: one for one in again if isinstance(one, MapEstimate)}
    surface = next((one for _, one in recorded if isinstance(one, SurfaceEstimate)), None)
    for path in (COMPARED_REGIONS, *COMPARED_TOUCHES.values()):
        ResultBatch(batch, 0).show_png(path, pictures.text_png, "no touch yet")
    for session_ns, result in recorded:
        now = ResultBatch(batch, session_ns)
        if isinstance(result, TouchEstimate):
            before.append(result)
            now_known = [one for one in others if one.number <= result.number]
            for quantity, path in COMPARED_TOUCHES.items():
                now.show_png(path, pictures.touch_comparison_png, quantity, before, now_known, name)
        elif isinstance(result, MapEstimate) and (other := maps.get(result.touches)) is not None:
            now.show_png(COMPARED_REGIONS, pictures.region_comparison_png, result, other, name)
            _log_edges(now, (result, other), name, surface)
    return batch


def _log_edges(
    now: ResultBatch, maps: tuple[MapEstimate, MapEstimate], name: str, surface: SurfaceEstimate | None
) -> None:
    """On the surface, and above its far edge their names in the same colours."""
    names = ("recorded", name)
    for place, (one, color, whose) in enumerate(zip(maps, (pictures.RECORDED, pictures.OTHER), names, strict=True)):
        edges = pictures.region_edges(one.labels, one.cell_m)
        height_m = np.zeros(edges.shape[:2])
        if surface is not None:
            rows, columns = surface.height_m.shape
            x, y = (
                np.minimum(edges[..., axis] / surface.cell_m, (columns, rows)[axis] - 1).astype(int) for axis in (0, 1)
            )
            height_m = surface.height_m[y, x]
        lines = np.concatenate([edges, (height_m + (1 + place) * ABOVE_M)[..., None]], axis=-1)
        path = f"{SCENE}/beside/{('recorded', 'other')[place]}"
        now.show_lines(path, lines, color, WIDTHS_M[place])
        y_m = one.labels.shape[0] * one.cell_m
        words = f"{whose}: {format_verdict(one)}"
        now.show_points(f"{path}/name", np.array([[0.0, y_m, (1 + place) * APART_M]]), color, 2 * LINE_M, [words])


def exploration_blueprint(
    streams: Sequence[Stream],
    size_m: tuple[float, float] = (0.6, 0.4),
    *,
    truth: bool = True,
    inclusions: bool = False,
    tabs: bool = False,
    compared: str = "",
) -> rrb.Blueprint:
    """The views of an exploration with these devices.

    size_m: size of the surface along x and y; truth: whether the truth is known: otherwise the surface's height is
    shown instead; inclusions: whether inclusions are sought: they replace beta
    tabs: most views are tabs, for a page, which has panels at both sides and may have to draw without a GPU
    compared: other settings, whose results are shown with the recorded ones (`tabs` alone)"""
    maps = {name: _picture(path, title) for (name, title), path in zip(TITLES.items(), display.MAPS, strict=True)}
    if inclusions:
        maps |= {
            "beta": _picture(display.INCLUSIONS, "Inclusions"),
            "beta_deviation": _picture(display.MISSED, "What may be missed"),
        }
    gain, force = (
        _picture(display.GAIN, "Gain of each place for the next touch"),
        _picture(display.FORCE, "Force over depth"),
    )
    truly = maps["truth"] if truth else _picture(display.HEIGHT, "Surface")
    words = display.INCLUSIONS_SUMMARY if inclusions else display.SUMMARY
    summary = rrb.TextDocumentView(contents=[f"+ /{words}"], origin=words, name="What is known")
    if tabs:
        fields = rrb.Tabs(maps["stiffness"], maps["stiffness_deviation"], maps["beta"], maps["beta_deviation"])
        regions, touches = [maps["regions"], truly], [force]
        if compared:
            regions.insert(0, _picture(COMPARED_REGIONS, f"Regions: recorded, {compared}"))
            touches[:0] = [
                _picture(path, f"{name.capitalize()}: recorded, {compared}") for name, path in COMPARED_TOUCHES.items()
            ]
        known = rrb.Vertical(rrb.Tabs(*regions), fields, rrb.Tabs(gain, summary))
        at_touch = rrb.Tabs(*touches, *_sections(), *_looks(streams), _pixels(), *_over_time(streams))
        robot = rrb.Vertical(_scenes(streams, size_m), at_touch, row_shares=[4, 3])
        views = rrb.Horizontal(robot, known, column_shares=[5, 4])
        return blueprint_of(views, play="paused" if compared else "following")
    known = rrb.Vertical(
        rrb.Horizontal(maps["stiffness"], maps["stiffness_deviation"], gain),
        rrb.Horizontal(maps["beta"], maps["beta_deviation"], force),
        rrb.Horizontal(maps["regions"], truly, summary),
    )
    return blueprint_of(rrb.Horizontal(_robot(streams, size_m), known, column_shares=[4, 6]))


def _robot(streams: Sequence[Stream], size_m: tuple[float, float]) -> rrb.Container:
    dent, *depths = _looks(streams)
    *plots, lanes = _over_time(streams)
    close = rrb.Horizontal(dent, _tabbed([*depths, _pixels()]))
    over_time = rrb.Vertical(*plots, lanes, row_shares=[*[1.6] * len(plots), 1.0])
    below = rrb.Horizontal(_tabbed(_sections()), over_time, column_shares=[1.0, 1.05])
    return rrb.Vertical(_scenes(streams, size_m), close, below, row_shares=[3.6, 2.7, 2.9])


def _tabbed(views: Sequence[rrb.View]) -> rrb.Container | rrb.View:
    return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]


def _sections() -> list[rrb.View]:
    return [_picture(display.SECTION, "The dent in section"), _picture(ERROR, "Error over beta")]


def _pixels() -> rrb.View:
    """Which pixels were used."""
    names = "blue used, grey outside, yellow lone, red to pink robot"
    return rrb.Spatial2DView(contents=[f"+ /{PIXELS}"], name=f"Pixels: {names}", background=list(BACKGROUND))


def _scenes(streams: Sequence[Stream], size_m: tuple[float, float]) -> rrb.Container | rrb.View:
    """The scene, and each map on the surface."""
    names = {quantity: f"{quantity.replace('_', ': ').capitalize()} on the surface" for quantity in FIELDS}
    maps = [_scene((), size_m, f"{FIELD_MAPS}/{one}", name) for one, name in names.items()]
    return _tabbed([_scene(streams, size_m), *maps])


def _looks(streams: Sequence[Stream]) -> list[rrb.View]:
    name = "The dent: observed blue, simulated red"
    dent = space_view(name, [f"+ /{DENT_VIEW}/**"], [0.5, -1.95, 0.95], [0.0, -0.2, -0.15])
    return [dent, *(depth_view(stream) for stream in streams if stream.kind == "depth")]


def _over_time(streams: Sequence[Stream]) -> list[rrb.View]:
    """Forces, and last the phases."""
    plots = [
        rrb.TimeSeriesView(contents=[f"+ /{path}"], origin=path, name=named(stream, title), plot_legend=LEGEND)
        for stream in streams
        if stream.kind == "wrench"
        for path, title in plotted(stream)
        if "force" in title
    ]
    return [*plots, rrb.StateTimelineView(contents=[f"+ /{ENTITIES[PhaseStart]}"], origin="exploration", name="Phases")]


def _scene(
    streams: Sequence[Stream], size_m: tuple[float, float], what: str = f"{SCENE}/**", name: str = ""
) -> rrb.View:
    """Seen from the front, above and to the side, near enough that surface and arm fit."""
    simulated = " (SIMULATED)"
    arms = [stream for stream in streams if stream.kind == "arm" and stream.urdf is not None]
    x, y = size_m
    wide = max(x, y)
    return space_view(
        name or f"Surface{''.join(f' and {arm.device}{simulated * arm.simulated}' for arm in arms)}",
        [f"+ /{what}", *(f"+ /{root('display/arm', arm.device)}/**" for arm in arms)],
        [x / 2 + 0.25 * wide, y / 2 - 1.05 * wide, (0.85 if arms else 0.75) * wide],
        [x / 2, y / 2 + 0.05 * wide, (0.17 if arms else 0.0) * wide],
        frame=SURFACE_FRAME,
        floor=FLOOR,
    )


def _picture(path: str, name: str) -> rrb.View:
    return rrb.Spatial2DView(contents=[f"+ /{path}"], name=name, background=PAPER)


def log_exploration_start(
    rec: rr.RecordingStream, streams: Sequence[Stream], base_from_surface: FloatArray | None = None
) -> None:
    """Log constants: the phases' colours, the pose of each arm's base in the surface frame; and empty results at the
    start.

    base_from_surface: (4, 4), takes positions from the surface frame to the arm's base frame [m]; None = the same"""
    rec.log(ENTITIES[PhaseStart], states(display.PHASES), static=True)
    for stream in streams:
        if stream.kind == "wrench":
            for path, _ in plotted(stream):  # averages of a whole touch would hide its peak
                rec.log(path, rr.SeriesLines.from_fields(aggregation_policy=PEAKS), static=True)
        if stream.kind == "arm" and stream.urdf is not None:
            scene.log_base(rec, stream, np.eye(4) if base_from_surface is None else base_from_surface)
    batch = Batch(Place(0, np.zeros(0, np.int64)))
    start = ResultBatch(batch, 0)
    empty = pictures.text_png("no touch yet")
    for path in (*display.MAPS, display.FORCE, display.SECTION, ERROR):
        start.show(path, rr.EncodedImage(contents=empty, media_type="image/png"))
    start.show_png(display.GAIN, pictures.text_png, "no plan yet")
    start.show_points(f"{DENT_VIEW}/scale/label", np.zeros((1, 3)), TEXT, 0.002, ["no touch yet"])
    start.show_text(display.SUMMARY, "# No touch yet")
    batch.send(rec)


def prepare_results(
    results: Sequence[object],
    session_ns: int,
    place: Place,
    *,
    cell_m: float = CELL_M,
    failed: list[StageFailure] | None = None,
) -> Batch:
    """Prepare results for one stream or several, including pictures: about 0.1 s for each, six of them for the maps.

    session_ns: time since the recording's start [ns]; place: place on the other timelines; cell_m: cell size of a
    plan's maps, without a map of the same time
    failed: receives errors of views: every result is recorded nevertheless, with the error. A plan with maps is drawn
    over their contacts. Raises TypeError if it is no result of an exploration."""
    batch = Batch(place)
    now = ResultBatch(batch, session_ns)
    maps = next((result for result in results if isinstance(result, MapEstimate)), None)
    views = exploration_views(place.touch, maps, cell_m)
    for result in results:
        shown = views_of(type(result), views)
        now.record(result)
        for view in shown:
            try:
                view(now, result)
            except Exception as error:  # a picture that cannot be drawn must not end what is drawn
                found = StageFailure.of(DISPLAY, place.touch, error)
                now.record(found)
                display.log_failed(now, found)
                if failed is not None:
                    failed.append(found)
    return batch


def exploration_views(touch: int, maps: MapEstimate | None, cell_m: float) -> Views[ResultBatch]:
    """The view of each result of a touch. maps: maps of the same moment; cell_m: cell size of a plan's maps where there
    are none"""
    shown_with = (cell_m, None) if maps is None else (maps.cell_m, maps.contacts_m)
    height = png_view(display.HEIGHT, pictures.height_png)
    force, section = png_view(display.FORCE, pictures.force_png), png_view(display.SECTION, pictures.section_png)
    return {
        SurfaceEstimate: (SURFACE, partial(scene.log_surface, colored=touch == 0), height, log_ground),
        TouchEstimate: (CONTACT, DENT, BETA, CREEP, scene.log_contact, log_dent, force, section, scene.log_no_forecast),
        MapEstimate: (REGIONS, BETA_FIELD, scene.log_stiffness, display.log_maps, display.log_summary),
        InclusionsResult: (INCLUSIONS, display.log_inclusions),
        PlannedTouch: (PLAN, scene.log_target, png_view(display.GAIN, pictures.gain_png, *shown_with)),
        TouchForecast: (AIM, scene.log_forecast),
        SteeringDecision: (DECISION, _log_decision),
        PhaseStart: (PHASE, partial(ResultBatch.show_phase, known=display.PHASES)),
        StageFailure: (FAILED, display.log_failed),
        ExplorationStop: (STOPPED, ResultBatch.show_stop),
        LookPerception: (PERCEPTION, log_pixels),
        TouchPerception: (PERCEPTION, BETA_ERROR, log_pixels, log_error),
        ForcePose: (FORCE_POSE, log_tool),
        **dict.fromkeys((LookFrames, TouchFrames, SurfaceMeasurement, TouchMeasurement), (INPUT,)),
    }


def _log_decision(now: ResultBatch, decision: SteeringDecision) -> None:
    if decision.kind in ("veto", "held"):
        scene.log_no_forecast(now, decision)
