"""How a squeeze is recorded and shown: its devices as those of any rig, and every result without loss beside what a
person looks at.

    squeeze/phase|stopped|events|features   one row a result, every field of it a component of the same name
    squeeze/fingertips|container|content    likewise, at the time of the frame that it is of
    display/tactile/DEVICE/contact          centre of pressure and principal axis, on the picture of the hand (fig. 2.4)
    display/squeeze/force|content           force of each fingertip [N], probability of each content, over time
    display/squeeze/container               the tracked model's edges over the depth image, before and after (fig. 2.8)
    display/squeeze/change                  the depth change around the fingertip, data minus model (fig. 2.6)
    display/squeeze/measured|named          what was measured, and what the content is taken for, in words
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import rerun as rr

from deformscope.frames import Stream
from deformscope.log.exploration.moment import ResultBatch
from deformscope.log.rig.columns import Batch, log_series
from deformscope.log.squeeze.blueprint import squeeze_blueprint
from deformscope.log.squeeze.change import log_change
from deformscope.log.squeeze.container import log_container
from deformscope.log.squeeze.content import log_content, log_not_named
from deformscope.log.squeeze.fingertips import FORCE, Fingertips, log_fingertips
from deformscope.log.squeeze.phases import log_squeeze_phase, log_squeeze_phases, log_squeeze_stop
from deformscope.log.squeeze.summary import log_measured, log_not_measured
from deformscope.pictures.palette import JOINTS
from deformscope.rows import SqueezeResult
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.trial import (
    ContentPosterior,
    FingertipPressure,
    SqueezeFeatures,
    SqueezePhase,
    SqueezeStop,
    TrackedContainer,
)

__all__ = ["Fingertips", "fingertips_of", "log_squeeze_start", "prepare_squeeze_results", "squeeze_blueprint"]


def log_squeeze_start(rec: rr.RecordingStream, fingertips: Fingertips | None) -> None:
    """What holds throughout: colours of the phases, names of the plots; and that nothing is known yet."""
    log_squeeze_phases(rec)
    if fingertips is not None:
        names = [f"{fingertips.stream.pads[place].name} [N]" for place in fingertips.pads]
        log_series(rec, FORCE, names, [JOINTS[at % len(JOINTS)] for at in range(len(names))])
    batch = Batch()
    for nothing in (log_not_measured, log_not_named):
        nothing(ResultBatch(batch, 0))
    batch.send(rec)


def prepare_squeeze_results(results: Sequence[object], session_ns: int, fingertips: Fingertips | None) -> Batch:
    """Make results ready for one stream or several. session_ns: when, since the recording's start [ns]

    Raises TypeError for what is no result of a squeeze.
    """
    batch = Batch()
    now = ResultBatch(batch, session_ns)
    for result in results:
        if not isinstance(result, SqueezeResult):
            raise TypeError(f"no twin in deformscope.log.squeeze shows a {type(result).__name__}")
        now.record(result)
        _twin(now, result, fingertips)()
    log_measured(now, results)
    return batch


def _twin(now: ResultBatch, result: SqueezeResult, fingertips: Fingertips | None) -> Callable[[], None]:
    """What shows a result."""
    match result:
        case SqueezePhase():
            return lambda: log_squeeze_phase(now, result)
        case SqueezeStop():
            return lambda: log_squeeze_stop(now, result)
        case FingertipPressure():
            return lambda: None if fingertips is None else log_fingertips(now, result, fingertips)
        case TrackedContainer():
            return lambda: log_container(now, result)
        case SqueezeFeatures():
            return lambda: log_change(now, result)
        case ContentPosterior():
            return lambda: log_content(now, result)
        case SqueezeEvents():
            return lambda: None  # in the table of `log_measured`


def fingertips_of(streams: Sequence[Stream], tactile: str, pads: Sequence[int]) -> Fingertips:
    """The squeezing fingertips among the devices."""
    return Fingertips(next(stream for stream in streams if stream.device == tactile), tuple(pads))
