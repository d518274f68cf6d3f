"""`deformscope dataset`: list a data set of squeezes, correct it, and merge several."""

import dataclasses
from pathlib import Path
from typing import Any

import msgspec

from deformscope.cli.common import say, show, write_json
from deformscope.config import DatasetConfig, DiscardConfig, MergeConfig, RelabelConfig, RepairConfig
from deformscope.errors import InputError
from deformscope.files.squeeze_dataset import TRIALS, SqueezeDataset, TrialEntry, TrialRow
from deformscope.pictures.report import table_text
from deformscope.runs.recordings import dataset_table


def listing(config: DatasetConfig) -> None:
    """Print the trials by content and container."""
    _show(config.folder, config.json, trials=config.trials)


def relabel(config: RelabelConfig) -> None:
    """Correct the index's labels of trials."""
    SqueezeDataset(config.folder).change(config.trial, **config.changes())
    _show(config.folder, config.json)


def discard(config: DiscardConfig) -> None:
    """Discard trials, or restore them."""
    SqueezeDataset(config.folder).change(config.trial, discarded=None if config.restore else config.reason)
    _show(config.folder, config.json)


def merge(config: MergeConfig) -> None:
    """Copy the trials of other data sets."""
    target = SqueezeDataset(config.folder)
    for source in config.sources:
        say(f"{target.merge(SqueezeDataset(source))} trials from {source}")
    _show(config.folder, config.json)


def repair(config: RepairConfig) -> None:
    """Add recordings that the index lacks."""
    dataset = SqueezeDataset(config.folder)
    known = {one.trial for one in dataset.entries()} if dataset.exists else set()
    files = sorted((config.folder / TRIALS).glob("*.rrd"))
    if not files and not known:
        raise InputError("a data set of squeezes, or a folder with its trials/", "neither", where=config.folder)
    for file in files:
        if file.name.endswith(".part.rrd"):
            say(f"{file.name} is unfinished: deformscope recover {file}")
        elif file.stem not in known:
            row, settings = _recorded(file)
            SqueezeDataset(config.folder, settings).add([row])
            say(f"taken in: {file.stem}")
    _show(config.folder, config.json)


def _recorded(file: Path) -> tuple[TrialRow, dict[str, Any]]:
    """A recorded trial and its features, computed again; and the features' settings."""
    from deformscope.recording.reader import Replay
    from deformscope.runs.replay_squeeze import squeeze_again

    recording = Replay(file)
    if "squeezed" not in recording.settings:
        raise InputError("the recording of a squeeze", "another one", where=file)
    again = squeeze_again(recording)
    entry = msgspec.convert(recording.settings["trial"], TrialEntry)
    stopped = recording.outcome.get("stopped") or again.failure or None
    entry = dataclasses.replace(entry, trial=file.stem, recording=f"{TRIALS}/{file.name}", discarded=stopped)
    settings: dict[str, Any] = recording.settings["squeezed"]["features"]
    if again.features is None:
        return TrialRow(entry), settings
    return TrialRow(entry, again.features.modalities, again.features.series), settings


def _show(folder: Path, target: str | None, *, trials: bool = False) -> None:
    entries = SqueezeDataset(folder).entries()
    show(table_text(dataset_table(folder, entries, trials=trials)))
    write_json([dataclasses.asdict(one) for one in entries], target)
