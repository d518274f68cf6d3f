"""An exploration's recorded results, as they were: equal to the last bit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from deformscope.recording.items import read_rows
from deformscope.recording.reader import Replay
from deformscope.rows import ENTITIES, Result


@dataclass(frozen=True, slots=True)
class Recorded:
    """A result and when it came. session_ns: since the recording's start [ns]; touch: its place on that timeline"""

    session_ns: int
    touch: int
    result: Result


def read_results(path: Path, kinds: Sequence[type] = (), *, trust: bool = False) -> Iterator[Recorded]:
    """The results of a recorded exploration in the order in which they came.

    kinds: those alone; trust: skip the comparison with the ledger. Raises InputError where it is no recording of ours
    """
    wanted = kinds or [kind for kind, entity in ENTITIES.items() if entity.startswith("exploration/")]
    return (Recorded(row.session_ns, row.touch, row.item) for row in read_rows(Replay(path, trust=trust), wanted))
