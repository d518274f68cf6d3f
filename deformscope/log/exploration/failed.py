"""What failed on a touch, as a line of text that says where."""

from __future__ import annotations

import rerun as rr

from deformscope.log.exploration.moment import ResultBatch
from deformscope.pictures.words import failed_words
from deformscope.rows import ENTITIES
from deformscope.stages.map.exploration import StageFailure


def log_failed(now: ResultBatch, failed: StageFailure) -> None:
    text = f"{failed_words(failed)}\n{failed.trace}".strip()
    now.send(ENTITIES[StageFailure], rr.TextLog.columns(text=[text], level=["ERROR"]))
