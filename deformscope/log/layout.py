"""Kinds of recordings, and what an experiment with devices adds to its recorder: the first views, and those of results.
Nothing here imports rerun before it is needed."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from deformscope.arrays import FloatArray
from deformscope.frames import Stream
from deformscope.stages.map.exploration import PlannedTouch

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.rig.columns import Batch, Place
    from deformscope.log.squeeze.results import Fingertips
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

    def variant(self, name: str) -> "Application":
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
    def blueprint(self, *, on_page: bool = False) -> "rr.blueprint.Blueprint":
        """The views. on_page: the views of a page"""

    @abstractmethod
    def log_start(self, rec: "rr.RecordingStream") -> None:
        """Log constants, and the devices' descriptions."""

    def touch_after(self, results: Sequence[object], touch: int) -> int:
        """The touch of the next device items, after these results at a moment of this touch."""
        return touch

    def prepare(
        self, results: Sequence[object], session_ns: int, place: "Place", cell_m: float, failed: "list[StageFailure]"
    ) -> "Batch":
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

    def blueprint(self, *, on_page: bool = False) -> "rr.blueprint.Blueprint":
        """A page shows the devices' health outside the viewer."""
        if self.stages:
            from deformscope.log.stages.over_image import stage_blueprint

            return stage_blueprint(self.stages, self.streams)
        from deformscope.log.rig.blueprint import rig_blueprint

        return rig_blueprint(self.streams, health=not on_page)

    def log_start(self, rec: "rr.RecordingStream") -> None:
        if self.stages:
            from deformscope.log.stages import log_stage_streams

            log_stage_streams(rec, self.stages, self.streams)


# The layout of an exploration's recording

EXPLORATION = Application("deformscope-exploration", devices=True, robot_moves=True)


@dataclass(frozen=True, slots=True)
class ExplorationLayout(RecordingLayout):
    """size_m: size of the surface along x and y; base_from_surface: (4, 4), takes positions from the surface frame to
    the arm's base frame [m], None = the same

    truth: whether the truth is known; inclusions: whether inclusions are sought
    T_surface_camera: (4, 4), None = not known"""

    size_m: tuple[float, float]
    base_from_surface: FloatArray | None
    truth: bool
    inclusions: bool = False
    T_surface_camera: FloatArray | None = None

    by_touch: ClassVar[bool] = True

    def blueprint(self, *, on_page: bool = False) -> "rr.blueprint.Blueprint":
        from deformscope.log.exploration.results import exploration_blueprint

        return exploration_blueprint(
            self.streams, self.size_m, truth=self.truth, inclusions=self.inclusions, tabs=on_page
        )

    def log_start(self, rec: "rr.RecordingStream") -> None:
        from deformscope.log.exploration.perception import log_frames
        from deformscope.log.exploration.results import log_exploration_start

        log_exploration_start(rec, self.streams, self.base_from_surface)
        log_frames(rec, self.base_from_surface, self.T_surface_camera)

    def touch_after(self, results: Sequence[object], touch: int) -> int:
        """Device items after the plan of a touch belong to that touch."""
        return touch + any(isinstance(one, PlannedTouch) and one.target_m is not None for one in results)


# A squeeze's part of its recorder

SQUEEZE = Application("deformscope-squeeze", devices=True, robot_moves=True)


@dataclass(frozen=True, slots=True)
class SqueezeLayout(RecordingLayout):
    """tactile, pads: the device and the pads of the fingertips that squeeze; camera: the depth camera, or empty

    around_px: left, top, right, bottom of its view, None = all; named: a model names the content
    base_from_table: (4, 4) table's frame to the base of the arm that places the hand [m], None = none does"""

    tactile: str
    pads: tuple[int, ...]
    camera: str
    around_px: tuple[float, float, float, float] | None = None
    named: bool = False
    base_from_table: FloatArray | None = None

    def blueprint(self, *, on_page: bool = False) -> "rr.blueprint.Blueprint":
        from deformscope.log.squeeze.results import squeeze_blueprint

        placed = self.base_from_table is not None
        return squeeze_blueprint(
            self.streams, self.tactile, self.camera, self.around_px, named=self.named, placed=placed
        )

    def log_start(self, rec: "rr.RecordingStream") -> None:
        from deformscope.log.squeeze.results import log_place_start, log_squeeze_start

        log_squeeze_start(rec, self._fingertips())
        log_place_start(rec, self.streams, self.base_from_table)

    def prepare(
        self, results: Sequence[object], session_ns: int, place: "Place", cell_m: float, failed: "list[StageFailure]"
    ) -> "Batch":
        """Results as a batch at time `session_ns`, without a frame or touch."""
        from deformscope.log.squeeze.results import prepare_squeeze_results

        return prepare_squeeze_results(results, session_ns, self._fingertips())

    def _fingertips(self) -> "Fingertips":
        from deformscope.log.squeeze.results import Fingertips

        return Fingertips(next(stream for stream in self.streams if stream.device == self.tactile), self.pads)
