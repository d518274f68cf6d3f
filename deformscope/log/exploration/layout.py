"""The layout of an exploration's recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from deformscope.arrays import FloatArray
from deformscope.log.layout import Application, RecordingLayout
from deformscope.stages.map.exploration import PlannedTouch

if TYPE_CHECKING:
    import rerun as rr

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

    def blueprint(self, *, on_page: bool = False) -> rr.blueprint.Blueprint:
        from deformscope.log.exploration.blueprint import exploration_blueprint

        return exploration_blueprint(
            self.streams, self.size_m, truth=self.truth, inclusions=self.inclusions, tabs=on_page
        )

    def log_start(self, rec: rr.RecordingStream) -> None:
        from deformscope.log.exploration.perception import log_frames
        from deformscope.log.exploration.results import log_exploration_start

        log_exploration_start(rec, self.streams, self.base_from_surface)
        log_frames(rec, self.base_from_surface, self.T_surface_camera)

    def touch_after(self, results: Sequence[object], touch: int) -> int:
        """Device items after the plan of a touch belong to that touch."""
        return touch + any(isinstance(one, PlannedTouch) and one.target_m is not None for one in results)
