"""What the robot does, as a lane over time."""

from __future__ import annotations

import rerun as rr

from deformscope.log.exploration.moment import ResultBatch
from deformscope.log.rig.columns import Sink
from deformscope.pictures.palette import BAD, Rgb
from deformscope.rows import ENTITIES
from deformscope.stages.map.exploration import PhaseStart

PHASES: dict[str, Rgb] = {
    "look": (86, 180, 233),
    "plan": (150, 120, 220),
    "travel": (110, 115, 125),
    "tare": (120, 160, 160),
    "approach": (230, 159, 0),
    "press": (213, 94, 0),
    "dwell": (0, 158, 115),
    "press more": (180, 70, 0),
    "dwell more": (0, 120, 90),
    "back off": (200, 60, 120),
    "retreat": (150, 155, 165),
    "stopped": BAD,
}


def log_phase_colors(rec: Sink) -> None:
    colored = rr.StateConfiguration(values=list(PHASES), colors=list(PHASES.values()))
    rec.log(ENTITIES[PhaseStart], colored, static=True)


def log_phase(now: ResultBatch, phase: PhaseStart) -> None:
    if phase.name.startswith("stopped"):  # its name says why, so that its colour is not among those known before
        colors = PHASES | {phase.name: BAD}
        now.log_static(ENTITIES[PhaseStart], rr.StateConfiguration(values=list(colors), colors=list(colors.values())))
    now.send(ENTITIES[PhaseStart], rr.StateChange.columns(state=[phase.name]))
