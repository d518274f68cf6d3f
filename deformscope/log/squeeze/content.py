"""What a model takes the content for, over time and in words."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.log.exploration.moment import ResultBatch
from deformscope.log.squeeze.summary import SQUEEZE_SUMMARY
from deformscope.pictures.palette import JOINTS
from deformscope.stages.squeeze.trial import ContentPosterior

CONTENT = "display/squeeze/content"


def log_content(now: ResultBatch, posterior: ContentPosterior) -> None:
    path = f"{CONTENT}/{posterior.modality}"
    tints = [JOINTS[at % len(JOINTS)] for at in range(len(posterior.labels))]
    names = rr.SeriesLines(names=list(posterior.labels), colors=tints, widths=[2.0] * len(tints))
    now.log_static(path, names)
    now.show(path, rr.Scalars(posterior.probability))
    order = np.argsort(posterior.probability)[::-1]
    rows = [f"| {posterior.labels[at]} | {100 * posterior.probability[at]:.0f} % |" for at in order]
    head = [f"# {posterior.content}", "", f"{posterior.since_s:.1f} s after first contact, by {posterior.modality}", ""]
    text = "\n".join([*head, "| content | probability |", "| --- | --- |", *rows])
    now.show(SQUEEZE_SUMMARY, rr.TextDocument(text, media_type="text/markdown"))
