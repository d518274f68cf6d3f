"""The stages of every kind of recording, as their views are registered."""

from __future__ import annotations

from typing import Any

from deformscope.log import application
from deformscope.log.canvas import Canvas
from deformscope.log.exploration.layout import EXPLORATION
from deformscope.log.exploration.results import CELL_M, exploration_views
from deformscope.log.over_picture import OF_APPLICATION, picture_views
from deformscope.log.rig_layout import RIG
from deformscope.log.squeeze.layout import SQUEEZE
from deformscope.log.squeeze.results import squeeze_views
from deformscope.log.stages import STAGE_VIEWS
from deformscope.log.views import ShownStage, Views, stages_of
from deformscope.rows import ENTITIES
from deformscope.stages.msm.state_sweep import StateSweeps

PICTURES = (application.IMAGES, application.FLOW, application.PAIR, application.PAIR_3D, application.FINDINGS)


def registries() -> dict[str, Views[Any]]:
    """What is registered for each of rerun's applications."""
    over = picture_views(Canvas())
    return {
        EXPLORATION.name: exploration_views(0, None, CELL_M),
        SQUEEZE.name: squeeze_views(None),
        RIG.name: STAGE_VIEWS,
        application.FINDINGS.variant("shapes").name: {StateSweeps: over[StateSweeps]},
        **{one.name: {kind: over[kind] for kind in OF_APPLICATION[one.over_picture]} for one in PICTURES},
    }


def stages_in(application_id: str) -> list[tuple[type, str, ShownStage]]:
    """Type of result, entity and stage of all that recordings of an application hold, by chapter; of a variant of one
    (`Application.variant`) too; empty for one that is not known."""
    every = registries()
    name = max((one for one in every if f"{application_id}-".startswith(f"{one}-")), key=len, default="")
    views = every.get(name, {})
    found = [(kind, one.entity or ENTITIES[kind], one) for kind in views for one in stages_of(kind, views)]
    return sorted(found, key=lambda row: row[2].chapter or 9)
