"""How a rig is recorded: its devices, and the results of stages that run meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from deformscope.log.application import Application
from deformscope.log.layout import RecordingLayout

if TYPE_CHECKING:
    import rerun as rr

RIG = Application("deformscope-rig", devices=True)


@dataclass(frozen=True, slots=True)
class RigLayout(RecordingLayout):
    """stages: (name, device) stages of those whose results will come"""

    stages: tuple[tuple[str, str], ...] = ()

    def blueprint(self, *, on_page: bool = False) -> rr.blueprint.Blueprint:
        """A page shows the devices' health outside the viewer."""
        if self.stages:
            from deformscope.log.stages.views import stage_blueprint

            return stage_blueprint(self.stages, self.streams)
        from deformscope.log.rig.blueprint import rig_blueprint

        return rig_blueprint(self.streams, health=not on_page)

    def log_start(self, rec: rr.RecordingStream) -> None:
        if self.stages:
            from deformscope.log.stages import log_stage_streams

            log_stage_streams(rec, self.stages, self.streams)
