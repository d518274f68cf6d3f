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
    display/lumps/map|missed|summary where inclusions are sought: found ones, and the detection limit, as text"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.frames import Stream
from deformscope.log.canvas import TEXT
from deformscope.log.exploration import display, scene
from deformscope.log.exploration.perception import ERROR, log_error, log_ground, log_pixels, log_tool
from deformscope.log.exploration.scene import DENT as DENT_VIEW
from deformscope.log.exploration.scene import log_dent
from deformscope.log.result_batch import ResultBatch, png_view
from deformscope.log.rig.columns import Batch, Place, states
from deformscope.log.rig.numbers import plotted
from deformscope.log.views import SOMETIMES, ShownStage, Views, views_of
from deformscope.pictures import exploration as pictures
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
