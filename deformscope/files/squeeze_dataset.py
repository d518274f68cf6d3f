"""A data set of squeezes: a folder of recordings, their index, and their features.

    trials/ID.rrd recordings; may be absent if only features are stored
    index.parquet one row for each trial: container, content, time, settings, and the reason for a discard
    features.parquet    trial, then tactile.0..., vision.0..., vision_small.0..., physical.0...; a row of null where a
                        modality is missing; `series` and `series_vision_small`: tactile features and small changes of
                        depth every 0.1 s since first contact, flat

Both files carry `deformscope` in their metadata: format, and the settings that the features were computed with."""

import dataclasses
import json
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.file_io import replacing
from deformscope.recording.lock import one_at_a_time
from deformscope.stages.squeeze.table import LabelledTable

DATASET_FORMAT = 1
INDEX, FEATURES, TRIALS = "index.parquet", "features.parquet", "trials"
META = b"deformscope"
STEP_S = 0.1
MODALITIES = ("tactile", "vision", "vision_small", "physical")
"""In this order."""
SERIES = {"tactile": "series", "vision_small": "series_vision_small"}
"""Columns of the modalities that are stored over the squeeze."""
NEW = "deformscope squeeze ... --dataset FOLDER"


@dataclass(frozen=True, slots=True)
class TrialEntry:
    """One squeeze in the index.

    trial: its name, unlike any other; content, container, container_type: content, container and container type of the
    squeezed container; fill: share of the height; session, operator: their names; T_hand_container: (16,) row by row,
    planned pose of the hand; seed: seed of its random errors
    software: versions; recorded_at: ISO 8601, UTC; recording: path from the folder, or empty
    first_s, steady_s: the events, since the recording's start [s], nan = none
    discarded: why it is left out, None = it is used"""

    trial: str
    content: str
    container: str
    container_type: str = ""
    fill: float = 0.9
    session: str = ""
    operator: str = ""
    T_hand_container: tuple[float, ...] = ()
    seed: int = 0
    software: str = ""
    recorded_at: str = ""
    recording: str = ""
    first_s: float = float("nan")
    steady_s: float = float("nan")
    discarded: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TrialRow:
    """A squeeze and its features by modality; a missing modality was not measured, as in a discarded trial.

    series: by modality (k, p) features every 0.1 s since first contact"""

    entry: TrialEntry
    features: Mapping[str, FloatArray] = field(default_factory=dict)
    series: Mapping[str, FloatArray] = field(default_factory=dict)


class SqueezeDataset:
    """`dataset = SqueezeDataset(folder)`, read again by each call; `add` makes the folder if it is missing.

    settings: settings of the features; None = those of the folder"""

    def __init__(self, folder: Path, settings: Mapping[str, Any] | None = None) -> None:
        self.folder = Path(folder)
        self._settings = settings

    @property
    def exists(self) -> bool:
        return (self.folder / INDEX).is_file()

    def recording_path(self, trial: str) -> Path:
        """Path of a trial's recording, existing or future."""
        return self.folder / TRIALS / f"{trial}.rrd"

    # Reading ---------------------------------------------------------------------------------------------------------

    def entries(self) -> list[TrialEntry]:
        """All trials, including discarded ones. Raises InputError if it is no data set."""
        rows = self._read(INDEX).to_pylist()
        try:
            return [TrialEntry(**{**row, "T_hand_container": tuple(row["T_hand_container"])}) for row in rows]
        except TypeError as error:
            raise InputError("an index of squeezes", str(error), where=self.folder / INDEX) from error

    def settings(self) -> dict[str, Any]:
        """Settings of the features."""
        found: dict[str, Any] = self._metadata(self._read(INDEX))["settings"]
        return found

    def rows(self) -> list[TrialRow]:
        """All trials with their features. Raises InputError if a trial lacks them and is not discarded."""
        entries, table = self.entries(), self._read(FEATURES)
        at = {trial: row for row, trial in enumerate(table["trial"].to_pylist())}
        if missing := [one.trial for one in entries if one.trial not in at and one.discarded is None]:
            more = f" and of {len(missing) - 1} more" if len(missing) > 1 else ""
            raise InputError(f"features of {missing[0]}{more}", "none", "deformscope dataset repair", self.folder)
        arrays = {name: _matrix(table, name) for name in MODALITIES}
        series = {name: table[column].to_pylist() for name, column in SERIES.items() if column in table.column_names}
        found = []
        for entry in entries:
            row = at.get(entry.trial)
            if row is None:
                found.append(TrialRow(entry))
                continue
            own = {name: values[row] for name, values in arrays.items() if not np.isnan(values[row]).all()}
            over = {
                name: np.array(flat[row], np.float64).reshape(-1, arrays[name].shape[1])
                for name, flat in series.items()
                if flat[row] is not None and arrays[name].shape[1]
            }
            found.append(TrialRow(entry, own, over))
        return found

    def table(self) -> LabelledTable:
        """The trials that are not discarded, as a table for classifiers: groups are containers, kinds their types."""
        rows = [one for one in self.rows() if one.entry.discarded is None]
        if not rows:
            raise InputError("trials that are not discarded", "none", NEW, self.folder)
        widths = {name: len(one.features[name]) for one in rows for name in MODALITIES if name in one.features}
        modalities = {
            name: np.stack([one.features.get(name, np.full(widths[name], np.nan)) for one in rows])
            for name in MODALITIES
            if name in widths
        }
        about = [one.entry for one in rows]
        kinds = np.array([one.container_type or "" for one in about])
        series = {}
        for name in SERIES:
            longest = max((len(one.series[name]) for one in rows if name in one.series), default=0)
            if longest and name in widths:
                series[name] = np.full((len(rows), longest, widths[name]), np.nan)
                for row, one in enumerate(rows):
                    if name in one.series:
                        series[name][row, : len(one.series[name])] = one.series[name]
        return LabelledTable(
            np.array([one.content for one in about]),
            np.array([one.container for one in about]),
            modalities,
            kind=kinds if len(set(kinds)) > 1 else None,
            trial=np.array([one.trial for one in about]),
            series=series,
            step_s=STEP_S,
            settings=self.settings(),
        )

    # Writing ---------------------------------------------------------------------------------------------------------

    def add(self, rows: Sequence[TrialRow]) -> None:
        """Append trials. Add a trial. Raises InputError for one that exists already, by name or with the same features
        in all modalities."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with one_at_a_time(self.folder):
            known = self.rows() if self.exists else []
            if self.exists and self._settings is not None and self.settings() != _plain(self._settings):
                raise InputError(
                    "features with the settings of the data set", "others", "another --dataset", self.folder
                )
            self._refuse_duplicates(known, rows)
            self._write([*known, *rows])

    def change(self, trials: Sequence[str], **changes: Any) -> None:
        """Set fields of the index of these trials. Raises InputError for a trial that is not there."""
        with self._changing() as rows:
            names = {one.entry.trial for one in rows}
            if unknown := [trial for trial in trials if trial not in names]:
                raise InputError(f"a trial of {self.folder}", repr(unknown[0]), "deformscope dataset list")
            for at, row in enumerate(rows):
                if row.entry.trial in trials:
                    rows[at] = dataclasses.replace(row, entry=dataclasses.replace(row.entry, **changes))

    def merge(self, other: "SqueezeDataset") -> int:
        """Copy the trials of another data set, with their recordings; returns their number. Trials that are here
        already and equal are skipped; raises InputError for a trial of the same name that differs."""
        theirs = other.rows()
        here = {one.entry.trial: one for one in self.rows()} if self.exists else {}
        for row in theirs:
            same = here.get(row.entry.trial)
            if same is not None and not _alike(same, row):
                came = f"another trial {row.entry.trial} in {other.folder}"
                raise InputError("trials of different names", came, "rename one of the folders' sessions", self.folder)
        new = [row for row in theirs if row.entry.trial not in here]
        if new:
            merged = SqueezeDataset(self.folder, other.settings())
            merged.add(new)
            for row in new:
                source = other.folder / row.entry.recording
                if row.entry.recording and source.is_file():
                    target = self.folder / row.entry.recording
                    target.parent.mkdir(parents=True, exist_ok=True)
                    for beside in (source, source.with_name(source.name + ".ledger")):
                        if beside.is_file():
                            shutil.copy2(beside, target.with_name(beside.name))
        return len(new)

    @contextmanager
    def _changing(self) -> Iterator[list[TrialRow]]:
        self._read(INDEX)  # refuses what is no data set, a folder that is not there too
        with one_at_a_time(self.folder):
            rows = self.rows()
            yield rows
            self._write(rows)

    def _refuse_duplicates(self, known: Sequence[TrialRow], rows: Sequence[TrialRow]) -> None:
        names = {one.entry.trial for one in known}
        measured = {_features_of(one): one.entry.trial for one in known if one.features}
        for row in rows:
            name = row.entry.trial
            if name in names:
                raise InputError("a trial of another name", f"{name}, which is there", "another --seed", self.folder)
            if row.features:
                same = measured.setdefault(_features_of(row), name)
                if same != name:
                    came = f"{name}, whose features are those of {same}"
                    raise InputError("a trial with a new name", came, "another --seed", self.folder)
            names.add(name)

    def _write(self, rows: Sequence[TrialRow]) -> None:
        """Features first: an index names none that are not there."""
        settings = self._settings if self._settings is not None else self.settings() if self.exists else {}
        meta = {META: json.dumps({"format": DATASET_FORMAT, "settings": _plain(settings)}).encode()}
        measured = [one for one in rows if one.features]
        columns: dict[str, Any] = {"trial": pa.array([one.entry.trial for one in measured], pa.string())}
        for name in MODALITIES:
            width = max((len(one.features[name]) for one in measured if name in one.features), default=0)
            nothing = np.full(width, np.nan)
            values = np.array([one.features.get(name, nothing) for one in measured]).reshape(len(measured), width)
            columns |= {f"{name}.{column}": values[:, column] for column in range(width)}
        for name, column in SERIES.items():
            flat = [one.series[name].ravel() if name in one.series else None for one in measured]
            columns[column] = pa.array(flat, pa.list_(pa.float64()))
        self._replace(FEATURES, pa.table(columns).replace_schema_metadata(meta))
        entries = [dataclasses.asdict(one.entry) for one in rows]
        self._replace(INDEX, pa.Table.from_pylist(entries, schema=_index_schema()).replace_schema_metadata(meta))

    def _replace(self, name: str, table: pa.Table) -> None:
        with replacing(self.folder / name) as file:
            pq.write_table(table, file)

    def _read(self, name: str) -> pa.Table:
        path = self.folder / name
        try:
            table = pq.read_table(path)
        except FileNotFoundError as error:
            came = "a folder without it" if self.folder.is_dir() else "no such folder"
            raise InputError(f"a data set of squeezes, with its {name}", came, NEW, self.folder) from error
        except (OSError, pa.ArrowException) as error:
            raise InputError("a data set of squeezes", f"a damaged {name}", "a copy of it", path) from error
        metadata = self._metadata(table)
        if metadata.get("format") != DATASET_FORMAT:
            came = f"format {metadata.get('format')}"
            raise InputError(f"a data set of format {DATASET_FORMAT}", came, "a newer deformscope", path)
        there = set(table.column_names)
        wanted = _index_schema().names if name == INDEX else _feature_columns(there)
        if missing := [one for one in wanted if one not in there]:
            raise InputError("a data set of squeezes", f"a {name} without {missing[0]}", "a copy of it", path)
        return table

    def _metadata(self, table: pa.Table) -> dict[str, Any]:
        try:
            found = json.loads((table.schema.metadata or {})[META])
        except (KeyError, ValueError) as error:
            raise InputError("a data set of squeezes", "another table", NEW, self.folder) from error
        return found if isinstance(found, dict) else {}


def _index_schema() -> pa.Schema:
    kinds: dict[object, pa.DataType] = {str: pa.string(), float: pa.float64(), int: pa.int64(), str | None: pa.string()}
    return pa.schema(
        [pa.field(one.name, kinds.get(one.type, pa.list_(pa.float64()))) for one in dataclasses.fields(TrialEntry)]
    )


def _feature_columns(names: Collection[str], modalities: Sequence[str] = MODALITIES) -> list[str]:
    """`trial`, and MODALITY.0, MODALITY.1... of as many as these names have."""
    counts = {one: sum(name.startswith(f"{one}.") for name in names) for one in modalities}
    return ["trial", *(f"{one}.{at}" for one, count in counts.items() for at in range(count))]


def _matrix(table: pa.Table, modality: str) -> FloatArray:
    """(rows, columns) of MODALITY.0, MODALITY.1..."""
    names = _feature_columns(table.column_names, [modality])[1:]
    columns = [table[name].to_numpy(zero_copy_only=False) for name in names]
    return np.stack(columns, axis=1) if columns else np.full((len(table), 0), np.nan)


def _features_of(row: TrialRow) -> tuple[tuple[str, bytes], ...]:
    """All of them; touch alone may be the same where the cells of the feature were not touched."""
    return tuple((name, values.tobytes()) for name, values in sorted(row.features.items()))


def _alike(one: TrialRow, other: TrialRow) -> bool:
    """Features and label; later corrections may differ."""
    return one.features.keys() == other.features.keys() and all(
        np.array_equal(values, other.features[name], equal_nan=True) for name, values in one.features.items()
    )


def _plain(settings: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(settings))
