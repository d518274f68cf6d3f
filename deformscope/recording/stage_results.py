"""Results of stages that ran while devices did, as they were recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deformscope.errors import InputError
from deformscope.frames import StageResult
from deformscope.recording.reader import Replay
from deformscope.rows import from_components
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import StageFailure, SurfaceEstimate, TouchEstimate
from deformscope.stages.see.arrows import FlowArrows
from deformscope.stages.see.tactile import TactileContact

KINDS: tuple[type, ...] = (FlowArrows, MomentFit, SurfaceEstimate, TactileContact, TouchEstimate, StageFailure)


def read_stage_results(path: Path, *, trust: bool = False) -> list[StageResult]:
    """The results in the order of the frames that they belong to, equal to what was recorded.

    trust: skip the comparison with the ledger
    """
    found: list[StageResult] = []
    for chunk in Replay(path, trust=trust).chunks("/stage/**"):
        if chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        columns = {name: batch.column(name) for name in batch.schema.names if ":" in name}
        for row in range(batch.num_rows):
            cells = {
                name: column[row].values.to_numpy(zero_copy_only=False)
                for name, column in columns.items()
                if column[row].is_valid
            }
            if cells:
                found.append(_result(cells, path))
    return sorted(found, key=lambda one: (one.host_ns, one.stage))


def _result(cells: dict[str, Any], path: Path) -> StageResult:
    kind = next((kind for kind in KINDS if any(name.startswith(f"{kind.__name__}:") for name in cells)), None)
    if kind is None:
        raise InputError("results of known stages", cells["StageResult:stage"][0], where=path)
    return from_components(StageResult, _of(StageResult, cells), {"result": from_components(kind, _of(kind, cells))})


def _of(kind: type, cells: dict[str, Any]) -> dict[str, Any]:
    """The components of one class, by field."""
    prefix = f"{kind.__name__}:"
    return {name.removeprefix(prefix): value for name, value in cells.items() if name.startswith(prefix)}
