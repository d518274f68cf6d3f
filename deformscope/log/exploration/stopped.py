"""Why an exploration was stopped, as a line of text at the moment when it was."""

from __future__ import annotations

import rerun as rr

from deformscope.exploration_replay import ENTITIES
from deformscope.log.exploration.moment import Moment
from deformscope.stages.exploration import Stopped


def log_stopped(now: Moment, stop: Stopped) -> None:
    now.send(ENTITIES[Stopped], rr.TextLog.columns(text=[f"{stop.kind}: {stop.reason}"], level=["ERROR"]))
