"""The depth change around the fingertip, data minus model (Thesis fig. 2.6)."""

from __future__ import annotations

import rerun as rr

from deformscope.log.result_batch import ResultBatch
from deformscope.pictures.depth_change import depth_change_png
from deformscope.stages.squeeze.trial import ContainerChange, SqueezeFeatures

CHANGE = "display/squeeze/change"


def log_container_change(now: ResultBatch, change: ContainerChange) -> None:
    """As it happens; what is refused stands in words and leaves the last picture."""
    if change.change_m is None:
        now.show(f"{CHANGE}/words", rr.TextLog(f"no change of depth: {change.reason}", level="WARN"))
        return
    now.show_png(CHANGE, depth_change_png, change.change_m, change.width_m, change.missing)


def log_change(now: ResultBatch, features: SqueezeFeatures) -> None:
    if features.vision is None:
        words = f"no visual feature: {features.reason or 'no camera'}"
        now.show(f"{CHANGE}/words", rr.TextLog(words, level="WARN"))
        return
    now.show_png(CHANGE, depth_change_png, features.vision, features.patch_width_m, features.missing)
