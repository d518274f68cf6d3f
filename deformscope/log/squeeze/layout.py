"""A squeeze's part of its recorder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from deformscope.arrays import FloatArray
from deformscope.log.layout import Application, RecordingLayout

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.rig.columns import Batch, Place
    from deformscope.log.squeeze.display import Fingertips
    from deformscope.stages.map.exploration import StageFailure

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

    def blueprint(self, *, on_page: bool = False) -> rr.blueprint.Blueprint:
        from deformscope.log.squeeze.blueprint import squeeze_blueprint

        placed = self.base_from_table is not None
        return squeeze_blueprint(
            self.streams, self.tactile, self.camera, self.around_px, named=self.named, placed=placed
        )

    def log_start(self, rec: rr.RecordingStream) -> None:
        from deformscope.log.squeeze.display import log_place_start
        from deformscope.log.squeeze.results import log_squeeze_start

        log_squeeze_start(rec, self._fingertips())
        log_place_start(rec, self.streams, self.base_from_table)

    def prepare(
        self, results: Sequence[object], session_ns: int, place: Place, cell_m: float, failed: list[StageFailure]
    ) -> Batch:
        """Results as a batch at time `session_ns`, without a frame or touch."""
        from deformscope.log.squeeze.results import prepare_squeeze_results

        return prepare_squeeze_results(results, session_ns, self._fingertips())

    def _fingertips(self) -> Fingertips:
        from deformscope.log.squeeze.display import Fingertips

        return Fingertips(next(stream for stream in self.streams if stream.device == self.tactile), self.pads)
