"""Kinds of recordings, and what an experiment with devices adds to its recorder: the first views, and those of results.
Nothing here imports rerun before it is needed."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from deformscope.frames import Stream

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.rig.columns import Batch, Place
    from deformscope.stages.map.exploration import StageFailure

PictureLayout = Literal["images", "flow", "pair", "pair-3d"]
"""Layouts over a picture: a calibrated sequence of images; optical flow; pairs of particle sets in the plane; in
space."""


@dataclass(frozen=True, slots=True)
class Application:
    """rerun's application: a viewer keeps one set of views for each.

    name: rerun's id of the application; over_picture: the views of results over a picture, once the picture is known,
    None = the views come with their results; devices: whether devices are recorded; robot_moves: whether a robot moves
    during the recording, whose run reports its state on a page. A recording without its results is useless
    """

    name: str
    over_picture: PictureLayout | None = None
    devices: bool = False
    robot_moves: bool = False

    def variant(self, name: str) -> Application:
        """The application with separate views under this name; without a name the application itself."""
        return dataclasses.replace(self, name=f"{self.name}-{name}") if name else self


IMAGES = Application("deformscope", "images")
FLOW = Application("deformscope-flow", "flow")
PAIR = Application("deformscope-pair", "pair")
PAIR_3D = Application("deformscope-pair-3d", "pair-3d")
FINDINGS = Application("deformscope-findings")


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


RIG = Application("deformscope-rig", devices=True)


@dataclass(frozen=True, slots=True)
class RigLayout(RecordingLayout):
    """A rig's devices, and the results of stages that run meanwhile. stages: the stages, as (name, device)"""

    stages: tuple[tuple[str, str], ...] = ()

    def blueprint(self, *, on_page: bool = False) -> rr.blueprint.Blueprint:
        """A page shows the devices' health outside the viewer."""
        if self.stages:
            from deformscope.log.stages.over_image import stage_blueprint

            return stage_blueprint(self.stages, self.streams)
        from deformscope.log.rig.blueprint import rig_blueprint

        return rig_blueprint(self.streams, health=not on_page)

    def log_start(self, rec: rr.RecordingStream) -> None:
        if self.stages:
            from deformscope.log.stages import log_stage_streams

            log_stage_streams(rec, self.stages, self.streams)
