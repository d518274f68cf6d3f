"""Data sets of squeezes in scripts."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from deformscope.files.squeeze_dataset import SqueezeDataset, TrialEntry
from deformscope.pictures.report import Table
from deformscope.plain import Json
from deformscope.runs.result import LibraryResult
from deformscope.stages.squeeze.table import LabelledTable


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
