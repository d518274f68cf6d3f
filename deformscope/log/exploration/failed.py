"""What failed on a touch, as a line of text that says where."""

from __future__ import annotations

import rerun as rr

from deformscope.exploration_replay import ENTITIES
from deformscope.exploration_words import failed_words
from deformscope.log.exploration.moment import Moment
from deformscope.stages.exploration import StageFailed


def log_failed(now: Moment, failed: StageFailed) -> None:
    text = f"{failed_words(failed)}\n{failed.trace}".strip()
    now.send(ENTITIES[StageFailed], rr.TextLog.columns(text=[text], level=["ERROR"]))
