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

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import rerun as rr

from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.columns import Batch, log_series, states
from deformscope.log.squeeze import display
from deformscope.log.squeeze.display import log_placement, log_sighting
from deformscope.log.views import SOMETIMES, ShownStage, Views, views_of
from deformscope.pictures.palette import tints_of
from deformscope.rows import ENTITIES
from deformscope.stages.squeeze import trial
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.placement import ContainerSighting, HandPlacement

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
