"""Tables of labelled trials: `.npz`, CSV or Parquet files of any origin.

    .npz     label (N,), optional group, kind, trial (N,), and one (N, ...) array of numbers per modality; optional
             `series.NAME` (N, T, p) over the squeeze with `step_s`
    columns  label, optional group, kind, trial, and MODALITY.0, MODALITY.1...

Nothing in them is executed (no pickle)."""

import io
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.file_io import read_file
from deformscope.files.arrays_file import read_arrays
from deformscope.files.delimited import form_of, open_table
from deformscope.stages.squeeze.table import LISTED, LabelledTable, TextArray

if TYPE_CHECKING:
    import pyarrow as pa

TEXTS = (".csv", ".tsv", ".txt", ".dat")
"""Endings of tables in text."""
SUFFIXES = (".npz", *TEXTS, ".parquet")
HOW = "columns label, group and MODALITY.0, MODALITY.1..., as sample:table has them"
ABOUT = ("label", "group", "kind", "trial")
"""Columns about a trial; every other one is a feature."""
SERIES = "series."
_FEATURE = re.compile(r"(.+)\.(\d+)")


def read_table(path: Path) -> LabelledTable:
    """A table, by the ending of its name. Raises InputError for another kind of file, a damaged one, or columns that
    contradict each other."""
    if path.suffix.lower() not in SUFFIXES:
        came = "a folder" if path.is_dir() else repr(path.suffix or path.name)
        raise InputError(f"a table that ends in {', '.join(SUFFIXES)}", came, HOW, path)
    raw = read_file(path, "a table of labelled trials", HOW)
    try:
        if path.suffix.lower() == ".npz":
            return table_of_arrays(read_arrays(raw, "a table (.npz of arrays)"))
        return table_of_columns(_csv(raw) if path.suffix.lower() in TEXTS else _parquet(raw))
    except InputError as error:
        raise type(error).about(error, path) from error


def table_of_arrays(found: Mapping[str, npt.NDArray[Any]]) -> LabelledTable:
    """A table of arrays by name: features (trials, columns), series (trials, steps, columns), texts (trials,)."""
    if "label" not in found:
        raise InputError("`label` in the table", ", ".join(sorted(found)) or "nothing", HOW)
    about = {name: _texts(found[name], name) for name in ABOUT if name in found}
    modalities, series = {}, {}
    step_s = 0.1
    for name, values in found.items():
        if name in ABOUT:
            continue
        if values.dtype.kind not in "fiub":
            raise InputError(f"numbers in {name}, or a name out of {', '.join(ABOUT)}", str(values.dtype), HOW)
        if name == "step_s":
            step_s = float(values.reshape(-1)[0]) if values.size else float("nan")
            if not (np.isfinite(step_s) and step_s > 0.0):
                raise InputError("a step_s above 0", f"{step_s}")
        elif name.startswith(SERIES):
            series[name.removeprefix(SERIES)] = values.astype(np.float64)
        elif values.ndim == 1 and values.dtype.kind in "iub":
            came = "one whole number for each trial, as of a name"
            hint = "call it trial, group or kind, leave it out, or make it float"
            raise InputError(f"features in {name}", came, hint)
        elif values.ndim:
            modalities[name] = values.astype(np.float64).reshape(len(values), -1) if values.size else values
        else:
            raise InputError(f"a row of {name} for each label", "one number", HOW)
    return _table(about, modalities, series, step_s)


def table_of_columns(table: "pa.Table") -> LabelledTable:
    """From columns label, optional group, kind and trial, and MODALITY.0, MODALITY.1..."""
    import pyarrow as pa

    names = table.column_names
    if len(set(names)) < len(names):
        raise InputError("each column once", ", ".join(sorted({one for one in names if names.count(one) > 1})))
    if "label" not in names:
        raise InputError("a column `label`", ", ".join(names[:LISTED]) or "nothing", HOW)
    about = {}
    for name in ABOUT:
        if name in names:
            if table[name].null_count:
                raise InputError(f"a {name} in every row", f"{table[name].null_count} rows without one")
            about[name] = _texts(np.asarray(table[name].to_pylist()), name)
    numbered: dict[str, dict[int, str]] = defaultdict(dict)
    others = []
    for name in names:
        if found := _FEATURE.fullmatch(name):
            numbered[found[1]][int(found[2])] = name
        elif name not in ABOUT:
            others.append(name)
    if others:
        shown = ", ".join(others[:LISTED]) + (f" and {len(others) - LISTED} more" if len(others) > LISTED else "")
        raise InputError("columns label, group, kind, trial and MODALITY.NUMBER", shown, "rename or leave them out")
    modalities = {}
    for modality, columns in numbered.items():
        if missing := sorted(set(range(len(columns))) - set(columns)):
            raise InputError(f"columns {modality}.0 to {modality}.{max(columns)}", f"no {modality}.{missing[0]}")
        features = np.empty((len(table), len(columns)))
        for number, name in columns.items():
            kind = table[name].type
            if not (
                pa.types.is_floating(kind)
                or pa.types.is_integer(kind)
                or pa.types.is_boolean(kind)
                or pa.types.is_null(kind)
            ):
                raise InputError(f"numbers in column {name}", str(kind))
            features[:, number] = table[name].cast(pa.float64()).to_numpy(zero_copy_only=False)
        modalities[modality] = features
    return _table(about, modalities, {}, 0.1)


def _table(
    about: Mapping[str, TextArray],
    modalities: Mapping[str, FloatArray],
    series: Mapping[str, FloatArray],
    step_s: float,
) -> LabelledTable:
    return LabelledTable(
        about["label"],
        about.get("group"),
        modalities,
        kind=about.get("kind"),
        trial=about.get("trial"),
        series=series,
        step_s=step_s,
    )


def _texts(values: npt.NDArray[Any], name: str) -> TextArray:
    """(N,) texts of texts or whole numbers."""
    if values.ndim != 1:
        raise InputError(f"one {name} for each trial, (N,)", f"shape {values.shape}", HOW)
    if values.dtype.kind == "S":
        values = np.char.decode(values, "utf-8", "replace")
    if values.dtype.kind == "f":
        if not (np.isfinite(values).all() and (values == np.round(values)).all()):
            raise InputError(f"texts or whole numbers in {name}", "other numbers", HOW)
        values = values.astype(np.int64)
    if values.dtype.kind not in "Uiub":
        raise InputError(f"texts or whole numbers in {name}", str(values.dtype), HOW)
    texts = values.astype(np.str_)
    if (texts == "").any():
        raise InputError(f"a {name} in every row", f"none in row {int(np.flatnonzero(texts == '')[0]) + 1}")
    return texts


def _csv(raw: bytes) -> "pa.Table":
    import pyarrow as pa

    form = form_of(io.BytesIO(raw))
    if form.cut:
        raise InputError("a table with a whole last line", repr(form.cut[:60]), "the table without that line")
    if twice := sorted({name.rpartition("#")[0] for name in form.names if "#" in name} - {""}):
        raise InputError("each column once", f"{', '.join(twice)} several times", HOW)
    try:
        types = dict.fromkeys(form.numbers, pa.float64()) | dict.fromkeys({*ABOUT} & {*form.names}, pa.string())
        with open_table(io.BytesIO(raw), form, types, ["", "NaN", "nan", "NA"]) as rows:
            return rows.read_all()
    except pa.ArrowException as error:
        raise InputError("a CSV table with a header", " ".join(str(error).split())[:200], HOW) from error


def _parquet(raw: bytes) -> "pa.Table":
    import pyarrow as pa
    from pyarrow import parquet

    try:
        return parquet.read_table(pa.BufferReader(raw))
    except (pa.ArrowException, OSError) as error:
        raise InputError("a Parquet table", "a damaged file, or one of another kind", HOW) from error
