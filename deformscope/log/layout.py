"""What an experiment with devices adds to its recorder: the views with which a viewer opens, and those of results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from deformscope.frames import Stream

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.rig.columns import Batch, Place
    from deformscope.stages.map.exploration import StageFailure


@dataclass(frozen=True, slots=True)
class RecordingLayout(ABC):
    """How a session with devices is recorded and shown. Creating a layout does not import rerun.

    streams: streams of the devices; by_touch: whether device items are on the timelines of an exploration
    (`deformscope.log.rig.Place`)"""

    streams: tuple[Stream, ...]

    by_touch: ClassVar[bool] = False

    @abstractmethod
    def blueprint(self, *, on_page: bool = False) -> rr.blueprint.Blueprint:
        """The views. on_page: the views of a page"""

    @abstractmethod
    def log_start(self, rec: rr.RecordingStream) -> None:
        """Log constants, and the devices' descriptions."""

    def touch_after(self, results: Sequence[object], touch: int) -> int:
        """The touch of the next device items, after these results at a moment of this touch."""
        return touch

    def prepare(
        self, results: Sequence[object], session_ns: int, place: Place, cell_m: float, failed: list[StageFailure]
    ) -> Batch:
        """Prepare results of one time: items of a robot that touches, unless a layout accepts others.

        session_ns: time since the recording's start [ns]; place: place on the timelines of an exploration
        cell_m: cell size of maps that do not say it themselves [m]; failed: receives errors of views"""
        from deformscope.log.exploration.results import prepare_results

        return prepare_results(results, session_ns, place, cell_m=cell_m, failed=failed)
