"""An exploration's recorded results, as they were: equal to the last bit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from deformscope.recording.reader import Replay
from deformscope.rows import ENTITIES, Result, result_of


@dataclass(frozen=True, slots=True)
class Recorded:
    """A result and when it came. session_ns: since the recording's start [ns]; touch: its place on that timeline"""

    session_ns: int
    touch: int
    result: Result


def read_results(
    path: Path, kinds: Sequence[type[Result]] = tuple(ENTITIES), *, trust: bool = False
) -> Iterator[Recorded]:
    """The results of a recorded exploration in the order in which they came.

    kinds: those alone; trust: skip the comparison with the ledger. Raises InputError where it is no recording of ours
    """
    replay = Replay(path, trust=trust)
    found = []
    for kind in kinds:
        for chunk in replay.chunks(f"/{ENTITIES[kind]}"):
            batch = chunk.to_record_batch()
            if chunk.is_static or "session" not in chunk.timeline_names:
                continue
            cells = {
                name.split(":")[1]: batch.column(name).to_pylist()
                for name in batch.schema.names
                if name.startswith(f"{kind.__name__}:")
            }
            places = zip(
                batch.column("session").cast("int64").to_pylist(),
                batch.column("touch").to_pylist(),
                batch.column("rerun.controls.RowId").to_pylist(),
                strict=True,
            )
            for row, (session_ns, touch, row_id) in enumerate(places):
                values = {name: column[row] for name, column in cells.items() if column[row] is not None}
                if values:
                    found.append((session_ns, row_id, Recorded(session_ns, touch, result_of(kind, values))))
    found.sort(key=lambda one: one[:2])
    yield from (recorded for _, _, recorded in found)
