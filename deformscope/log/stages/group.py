"""Results of one stage, from one device and of one type, which are logged together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from deformscope.frames import StageResult, Stream


@dataclass(frozen=True, slots=True)
class StageGroup:
    """pads: layout of the tactile device, None for another device; results: plotted; drawn: results that are marked or
    drawn

    start_ns: host time at which `session` is 0 [ns]"""

    pads: Stream | None
    device: str
    results: Sequence[StageResult]
    drawn: Sequence[StageResult]
    start_ns: int
