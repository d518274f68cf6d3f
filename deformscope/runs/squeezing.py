"""Squeezes of containers, from a script: `deformscope.squeeze`, and their data sets: `deformscope.open_dataset`."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from deformscope.api.result import LibraryResult, ViewerChoice, python_names
from deformscope.api.squeeze_result import SqueezeResult
from deformscope.config import SqueezeConfig
from deformscope.files.squeeze_dataset import SqueezeDataset, TrialEntry
from deformscope.pictures.report import Table
from deformscope.runs.squeeze_run import leave, squeeze_on
from deformscope.stages.squeeze.table import LabelledTable
from deformscope.terminal import Say, messages_to

# One squeeze ---------------------------------------------------------------------------------------------------------


def squeeze(
    rig: str | Path,
    *,
    content: str = "",
    container: str = "",
    dataset: Path | str | None = None,
    keep: Literal["trial", "features"] = "trial",
    model: Path | str | None = None,
    fill: float = 0.9,
    session: str = "",
    operator: str = "",
    place: Literal["person", "jaco", "kuka"] = "person",
    grasp: tuple[float, float, float] | None = None,
    seed: int = 0,
    record: Path | str | None = None,
    viewer: ViewerChoice = "none",
    overwrite: bool = False,
    yes: bool = False,
    trust_rig: bool = False,
    progress: Say | bool | None = None,
) -> SqueezeResult:
    """Squeeze a container once, and take its features; with `model`, name its content.

    rig: a rig file (.toml), or `lab:containers`; content, container: what is squeezed, in the laboratory drawn where
    they are empty; dataset: a data set to add the trial to, with its recording unless keep = "features"
    model: a saved classifier; yes: let a real hand close without asking; with a rig file the question appears
    place: who brings the hand to the container; grasp: where an arm is to [mm, deg, deg], None = drawn from the seed
    progress: as of `explore`
    Raises InputError for what cannot be used, and where the squeeze did not come to its steady state (a data set keeps
    it as discarded, with the reason); KeyboardInterrupt where Ctrl-C ended it.
    """
    given = {name: value for name, value in locals().items() if name not in ("rig", "progress")}
    with python_names():
        config = SqueezeConfig.of(rig=str(rig), **given)
        with messages_to(progress if str(rig).startswith("lab:") or callable(progress) else True):
            return _squeezed(config)


def _squeezed(config: SqueezeConfig) -> SqueezeResult:
    squeezed = squeeze_on(config, lambda result: None)
    if squeezed.interrupted:
        raise KeyboardInterrupt
    leave(squeezed)
    return squeezed.result


# A data set ----------------------------------------------------------------------------------------------------------


class OpenDataset(LibraryResult):
    """A data set of squeezes, read anew by each call. folder: of its index and recordings"""

    def __init__(self, folder: Path) -> None:
        """Raises InputError where it is none."""
        self.folder = folder
        self._dataset = SqueezeDataset(folder)
        self._dataset.entries()

    @property
    def trials(self) -> tuple[TrialEntry, ...]:
        """All of them, discarded ones too: `content`, `container`, `session`, `recording`, `discarded`..."""
        return tuple(self._dataset.entries())

    def recording(self, trial: str) -> Path:
        """Where a trial's recording is, for `open_recording`; only where it was kept."""
        return self._dataset.recording_path(trial)

    def table(self) -> LabelledTable:
        """Features and labels of the trials that are not discarded: `label (N,)`, `group (N,)` the containers,
        `modalities` by name (N, p), `series`. `classify` takes it, or part of it."""
        return self._dataset.table()

    def __len__(self) -> int:
        return len(self.trials)

    def __repr__(self) -> str:
        return f"<data set {self.folder}: {len(self)} trials>"

    def as_json(self) -> dict[str, Any]:
        return {"folder": self.folder, "trials": [dataclasses.asdict(one) for one in self.trials]}

    def tables(self) -> tuple[Table, ...]:
        return (dataset_table(self.folder, self.trials),)


def dataset_table(folder: Path, entries: Sequence[TrialEntry], *, trials: bool = False) -> Table:
    """Trials by content and container, and those that are left out; trials: name each too"""
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
        rows += [(one.trial, _words(one)) for one in entries]
    return Table(rows, caption=str(folder))


def _words(entry: TrialEntry) -> str:
    left_out = "" if entry.discarded is None else f", left out: {entry.discarded}"
    return f"{entry.content} in {entry.container}, {entry.recorded_at}{left_out}"


def open_dataset(folder: Path | str) -> OpenDataset:
    """Open a data set that `deformscope squeeze --dataset` has made. Raises InputError where it is none."""
    return OpenDataset(Path(folder))
