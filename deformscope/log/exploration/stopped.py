"""Why an exploration was stopped, as a line of text at the moment when it was."""

from __future__ import annotations

import rerun as rr

from deformscope.log.exploration.moment import ResultBatch
from deformscope.rows import ENTITIES
from deformscope.stages.map.exploration import ExplorationStop


def log_stopped(now: ResultBatch, stop: ExplorationStop) -> None:
    now.send(ENTITIES[ExplorationStop], rr.TextLog.columns(text=[f"{stop.kind}: {stop.reason}"], level=["ERROR"]))
