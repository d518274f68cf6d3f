"""Recordings in scripts: an opened one, and the result of `record`."""

import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import cast

import pyarrow as pa

from deformscope.config import ExportConfig
from deformscope.files.squeeze_dataset import SqueezeDataset, TrialEntry
from deformscope.frames import ColorFrame, Item, SessionNote
from deformscope.pictures.messages import counted
from deformscope.pictures.report import Table, cell_text
from deformscope.plain import Json, plain
from deformscope.recording.export.export import Credits, ExportRequest, export
from deformscope.recording.export.manifest import SCHEMA_VERSION
from deformscope.recording.items import read_estimates, read_items, read_results
from deformscope.recording.ledger import Discard, Losses, discard, inherited
from deformscope.recording.losses import named
from deformscope.recording.reader import Replay
from deformscope.recording.streams import RecordingTables
from deformscope.runs.result import FoundResult, LibraryResult
from deformscope.stages.squeeze.table import LabelledTable
from deformscope.terminal import Progress


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


# A recording in other formats: what `deformscope export` writes


@dataclass(frozen=True, slots=True)
class ExportResult(FoundResult):
    """What `export` wrote. remarks: what the recording lacks; checked: whether the recording has a ledger for the
    check"""

    remarks: tuple[str, ...] = ()
    checked: bool = True


def export_recording(config: ExportConfig, progress: Progress) -> ExportResult:
    """Write an export, and list its files."""
    asked = ExportRequest(
        to=config.format,
        folder=config.folder,
        only=config.only,
        camera=config.camera,
        anonymous=config.anonymous,
        credits=Credits(config.license, config.author, config.citation),
        overwrite=config.overwrite,
        manifest=config.to is not None,
    )
    replay = Replay(config.recording)
    found = export(replay, asked, progress)
    if config.format == "images":
        rows = [(f"{one.what} of {one.device}", f"{one.count} in {one.folder}") for one in found.images]
    else:
        rows = [(one.entity, f"{one.rows} in {found.folder / one.file}") for one in found.files]
    said = {"recording": config.recording, "schema_version": SCHEMA_VERSION, "format": config.format}
    said |= {"folder": found.folder, "images": found.images, "files": found.files}
    remarks = [inherited(replay.source_problems)] if replay.source_problems else []
    remarks += [f"losses: {named(replay.losses)}"] if replay.losses else []
    if "recovered" in replay.outcome or not replay.outcome.get("complete"):
        remarks.append("the recording does not have its run's end: what came after is lost")
    written = counted(sum(one.count for one in found.images) or len(found.files), "image" if found.images else "file")
    table = Table(rows, caption=f"{config.recording}: {written} in {found.folder}")
    return ExportResult(said, (table,), tuple(remarks), replay.has_ledger)


# Data sets of squeezes in scripts


class OpenDataset(LibraryResult):
    """A data set of squeezes; each call reads it again. folder: folder of its index and recordings"""

    def __init__(self, folder: Path) -> None:
        """Raises InputError where it is none."""
        self.folder = folder
        self._dataset = SqueezeDataset(folder)
        self._dataset.entries()

    @property
    def trials(self) -> tuple[TrialEntry, ...]:
        """All trials, including discarded ones: `content`, `container`, `session`, `recording`, `discarded`..."""
        return tuple(self._dataset.entries())

    def recording(self, trial: str) -> Path:
        """Path of a trial's recording, for `open_recording`; None without a stored recording."""
        return self._dataset.recording_path(trial)

    def table(self) -> LabelledTable:
        """Features and labels of the trials that are not discarded: `label (N,)`, `group (N,)` the containers,
        `modalities` by name (N, p), `series`. The trials' features as a table, for `classify`."""
        return self._dataset.table()

    def __len__(self) -> int:
        return len(self.trials)

    def __repr__(self) -> str:
        return f"<data set {self.folder}: {len(self)} trials>"

    def as_json(self) -> Json:
        return {"folder": self.folder, "trials": [dataclasses.asdict(one) for one in self.trials]}

    def tables(self) -> tuple[Table, ...]:
        return (dataset_table(self.folder, self.trials),)


def dataset_table(folder: Path, entries: Sequence[TrialEntry], *, trials: bool = False) -> Table:
    """Trials by content and container, and those that are left out; trials: list each trial too"""
    good = [one for one in entries if one.discarded is None]
    contents = Counter(one.content for one in good)
    containers = {content: len({one.container for one in good if one.content == content}) for content in contents}
    rows = [
        (content, f"{count} trials, {containers[content]} containers") for content, count in sorted(contents.items())
    ]
    reasons = Counter(str(one.discarded).partition(":")[0] for one in entries if one.discarded is not None)
    rows += [("left out", f"{count} ({reason})") for reason, count in reasons.most_common()]
    recorded = sum(bool(one.recording) for one in entries)
    rows.append(("in all", f"{len(entries)} trials, {recorded} with recordings"))
    if trials:
        rows += [(one.trial, _format_entry(one)) for one in entries]
    return Table(rows, caption=str(folder))


def _format_entry(entry: TrialEntry) -> str:
    left_out = "" if entry.discarded is None else f", left out: {entry.discarded}"
    return f"{entry.content} in {entry.container}, {entry.recorded_at}{left_out}"
