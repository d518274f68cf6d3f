"""State of the hand, as a lane over time, and the reason for its stop."""

from __future__ import annotations

import rerun as rr

from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.columns import Sink, states
from deformscope.pictures.palette import BAD, Rgb
from deformscope.rows import ENTITIES
from deformscope.stages.squeeze.trial import SqueezePhase, SqueezeStop

SQUEEZE_PHASES: dict[str, Rgb] = {
    "pre-shape": (110, 115, 125),
    "place": (150, 120, 220),
    "look": (0, 190, 200),
    "travel": (120, 100, 190),
    "approach": (204, 121, 167),
    "retreat": (150, 110, 150),
    "back off": (215, 140, 0),
    "air": (86, 180, 233),
    "close": (230, 159, 0),
    "squeeze": (213, 94, 0),
    "hold": (0, 158, 115),
    "open": (150, 155, 165),
    "stopped": BAD,
}


def log_squeeze_phases(rec: Sink) -> None:
    rec.log(ENTITIES[SqueezePhase], states(SQUEEZE_PHASES), static=True)


def log_squeeze_phase(now: ResultBatch, phase: SqueezePhase) -> None:
    if phase.name not in SQUEEZE_PHASES:  # a stop's name says why
        now.log_static(ENTITIES[SqueezePhase], states(SQUEEZE_PHASES | {phase.name: BAD}))
    now.show(ENTITIES[SqueezePhase], rr.StateChange(state=phase.name))


def log_squeeze_stop(now: ResultBatch, stop: SqueezeStop) -> None:
    now.show(ENTITIES[SqueezeStop], rr.TextLog(f"{stop.kind}: {stop.reason}", level="ERROR"))
