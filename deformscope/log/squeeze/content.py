"""A model's classification of the content, over time and as text."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.log.result_batch import ResultBatch
from deformscope.pictures.palette import JOINTS
from deformscope.stages.squeeze.trial import ContentPosterior

CONTENT = "display/squeeze/content"
NAMED = "display/squeeze/named"


def log_not_named(now: ResultBatch) -> None:
    text = "*Classified from the first contact on.*"
    now.show(NAMED, rr.TextDocument(text, media_type="text/markdown"))


def log_content(now: ResultBatch, posterior: ContentPosterior) -> None:
    """A line for each content during the squeeze; the posterior of all features together is text alone."""
    if posterior.index >= 0:
        tints = [JOINTS[at % len(JOINTS)] for at in range(len(posterior.labels))]
        lines = rr.SeriesLines(names=list(posterior.labels), colors=tints, widths=[2.0] * len(tints))
        now.log_static(CONTENT, lines)
        now.show(CONTENT, rr.Scalars(posterior.probability))
    order = np.argsort(posterior.probability)[::-1]
    rows = [f"| {posterior.labels[at]} | {100 * posterior.probability[at]:.0f} % |" for at in order]
    head = [f"# {posterior.content}", "", f"{posterior.since_s:.1f} s after first contact, by {posterior.modality}", ""]
    text = "\n".join([*head, "| content | probability |", "| --- | --- |", *rows])
    now.show(NAMED, rr.TextDocument(text, media_type="text/markdown"))
