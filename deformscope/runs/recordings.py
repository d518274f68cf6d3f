"""Recordings in scripts: an opened one, and the result of `record`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import cast

import pyarrow as pa

from deformscope.frames import ColorFrame, Item, SessionNote
from deformscope.pictures.report import Table, cell_text
from deformscope.plain import Json, plain
from deformscope.recording.discards import Discard, discard
from deformscope.recording.items import read_estimates, read_items, read_results
from deformscope.recording.ledger import Losses
from deformscope.recording.reader import Replay
from deformscope.recording.streams import RecordingTables
from deformscope.runs.result import LibraryResult


class OpenRecording(LibraryResult):
    """A recording of deformscope: settings, frames and results, read on demand.

    path: path of the file; its bytes were compared with its ledger when it was opened"""

    def __init__(self, path: Path) -> None:
        """Raises InputError if it is no recording of ours, or has changed since it was recorded."""
        self.path = path
        self._replay = Replay(path)

    @property
    def settings(self) -> Mapping[str, object]:
        """All settings that determined the recorded results."""
        return self._replay.settings

    @property
    def outcome(self) -> Mapping[str, object]:
        """Outcome of the recording; empty after an interrupted run."""
        return self._replay.outcome

    @cached_property
    def kind(self) -> str:
        """The layout of its views: `images`, `pair`, `rig`, `exploration`..."""
        return self._replay.identity[0].removeprefix("deformscope").removeprefix("-") or "images"

    def frames(self) -> Iterator[ColorFrame]:
        """The images that were calibrated, in their order, bit for bit, with their stamps."""
        return self._replay.frames()

    def items(self) -> Iterator[Item]:
        """Everything that the devices of a rig gave, in its order."""
        return read_items(self.path, trust=True)

    @cached_property
    def _tables(self) -> RecordingTables:
        return RecordingTables(self._replay)

    def streams(self) -> tuple[str, ...]:
        """The names for `table`: the entities of devices, results and transforms."""
        return tuple(self._tables.streams)

    def table(self, name: str) -> pa.Table:
        """A stream as an Arrow table: by its entity (`wrench/tip`), or DEVICE/QUANTITY (`tip/force`) for the times and
        the columns of that quantity alone. Units are in the names of columns and in their metadata (`unit`);
        `.to_pandas()` works where pandas is installed. Raises InputError for a missing one."""
        return self._tables.table(name)

    def notes(self) -> tuple[SessionNote, ...]:
        """Remarks during the recording: notes, episodes, tares, alarms of sensors, discards, each with its time on the
        host's clock."""
        found = read_items(self.path, trust=True, kinds=(SessionNote,))
        return tuple(note for note in found if isinstance(note, SessionNote))

    def discarded(self) -> list[Discard]:
        """Discarded parts of the recording, with reasons; the file still has them."""
        return self._replay.discarded

    def discard(self, reason: str, episode: int = 0) -> None:
        """Mark the recording, or one of its episodes (from 1), as not to be used, in its ledger."""
        discard(self.path, reason, episode, self.notes())

    def estimates(self) -> list[Json]:
        """The recorded estimates of a calibration, as in the JSON of the command line."""
        return [cast("Json", plain(one.as_json())) for one in read_estimates(self._replay)]

    def results(self) -> Iterator[object]:
        """The recorded results of an exploration, in the order in which they came."""
        return (row.item for row in read_results(self.path, trust=True))

    def __repr__(self) -> str:
        return f"<recording {self.path}: {self.kind}>"

    def as_json(self) -> Json:
        found = {"recording": self.path, "kind": self.kind, "settings": self.settings, "outcome": self.outcome}
        return found | {"discarded": self.discarded()}

    def tables(self) -> tuple[Table, ...]:
        rows = [("kind", self.kind), ("frames", str(self.outcome.get("frames", "unknown: its run was interrupted")))]
        rows += [(name, cell_text(value)) for name, value in self.outcome.items() if name in ("stopped", "complete")]
        rows += [("discarded", str(one)) for one in self.discarded()]
        rows += [
            (name, cell_text(value)) for name, value in self.settings.items() if isinstance(value, str | int | float)
        ]
        return (Table([row for row in rows if "\n" not in row[1]], caption=str(self.path)),)


@dataclass(frozen=True, slots=True)
class RecordResult(LibraryResult):
    """Result of `record`. found: the JSON of `deformscope record`; table: the result as a table"""

    found: Mapping[str, object]
    table: Table

    @property
    def path(self) -> Path:
        """The recording."""
        return Path(str(self.found["recording"]))

    @property
    def losses(self) -> Losses:
        """The losses of each device; empty without losses."""
        return cast("Losses", self.found.get("losses") or {})

    def open(self) -> OpenRecording:
        """The recording, opened."""
        return OpenRecording(self.path)

    def __repr__(self) -> str:
        return f"<recorded {self.path}: {self.found['frames']} frames>"

    def as_json(self) -> Json:
        return dict(self.found)

    def tables(self) -> tuple[Table, ...]:
        return (self.table,)
