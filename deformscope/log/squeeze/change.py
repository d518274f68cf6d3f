"""The depth change around the fingertip, data minus model (Thesis fig. 2.6)."""

from __future__ import annotations

import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.result_batch import ResultBatch
from deformscope.pictures.depth_change import depth_change_png
from deformscope.stages.squeeze.trial import ContainerChange, SqueezeFeatures

CHANGE = "display/squeeze/change"


def log_container_change(now: ResultBatch, change: ContainerChange) -> None:
    """During the squeeze; a refused image is reported as text and leaves the last picture."""
    _show(now, change.change_m, change.width_m, change.missing, change.reason)


def log_change(now: ResultBatch, features: SqueezeFeatures) -> None:
    _show(now, features.vision, features.patch_width_m, features.missing, features.reason or "no camera")


def _show(now: ResultBatch, change_m: FloatArray | None, width_m: float, missing: float, reason: str) -> None:
    if change_m is None:
        now.show(f"{CHANGE}/words", rr.TextLog(f"no visual feature: {reason}", level="WARN"))
    else:
        now.show_png(CHANGE, depth_change_png, change_m, width_m, missing)
