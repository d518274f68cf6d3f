"""Tables of labelled trials: `.npz`, CSV or Parquet files of any origin.

    .npz     label (N,), optional group, kind, trial (N,), and one (N, ...) array of numbers per modality; optional
             `series.NAME` (N, T, p) over the squeeze with `step_s`
    columns  label, optional group, kind, trial, and MODALITY.0, MODALITY.1...

Nothing in them is executed (no pickle).

Tables in text, as loggers and spreadsheets write them: how they are written is decided by their rows.

Separators are tabs, `;`, commas and runs of blanks; numbers have decimal points or commas; lines before the header,
several header rows, rows of units, byte order marks and lines that were cut off are recognised. pyarrow reads the
rows."""

import codecs
import contextlib
import csv
import io
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.file_io import check_size, read_file
from deformscope.files.arrays_file import read_arrays
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


SEPARATORS = {"\t": "tabs", ";": "`;`", "|": "`|`", ",": "commas", " ": "blanks"}
"""The likeliest first, and what they are called."""
SEEN_BYTES, SEEN_LINES = 1 << 16, 16
"""How much of a table is looked at: its beginning as its end."""
COLUMN_BYTES = 1 << 15
"""Memory of a table's column, besides its values."""
BLOCK_BYTES = 1 << 22
"""How much is read at once."""
MISSING = {"", "nan", "-nan", "na", "n/a", "#n/a", "#na", "null"}
UNIT_WORDS = {"N", "mN", "kN", "gf", "kgf", "lbf", "g", "kg", "Nm", "N·m", "N*m", "N m", "mNm", "mN m", "Nmm", "N mm"}
UNIT_WORDS |= {"uN", "nN", "nm"}
UNIT_WORDS |= {"m", "cm", "mm", "um", "µm", "s", "ms", "us", "µs", "ns", "sec", "m/s", "mm/s", "Hz"}
UNIT_WORDS |= {"deg", "°", "rad", "rad/s", "deg/s", "°/s", "Pa", "kPa", "hPa", "MPa", "bar"}
UNIT_WORDS |= {"V", "mV", "A", "mA", "°C", "C", "deg C", "K", "%", "-", "counts"}
SPELLINGS = {"Nm": "N m", "N·m": "N m", "N*m": "N m", "mNm": "mN m", "Nmm": "N mm", "sec": "s", "µs": "us"}
SPELLINGS |= {"µm": "um", "°": "deg", "°C": "deg C", "°/s": "deg/s", "-": "", "1": ""}
_NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?|[+-]?inf(?:inity)?", re.ASCII)
_MOMENT = re.compile(
    r"(?:(\d{4})[-/](\d\d)[-/](\d\d)[T ]|(\d\d)\.(\d\d)\.(\d{4}) )?(\d{1,2}):(\d\d):(\d\d)(?:[.,](\d{1,9}))?"
    r" ?(Z|[+-]\d\d:?\d\d)?",
    re.ASCII,
)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)
_UNIT = re.compile(r"[\[(<]([^\[\]()<>]{1,8})[\])>]\s*$")
_CHINESE = re.compile(rb"(?:[\xb0-\xd7][\xa1-\xfe])+")
"""Frequent characters of GB 2312, of which Western texts have hardly a pair."""
_Row = tuple[list[str], int]
"""Fields of a row, and the number of lines up to its end."""


@dataclass(frozen=True)
class TableForm:
    """How a table is written. point: its decimal point; names: its columns' names, each once; units: units of columns,
    as far as it says them; skipped: lines before its first row, and `before` its header; moments: columns with times
    of day or dates; whole: columns that begin with whole numbers; numbers: columns with numbers alone; is_likely: most
    is numbers, below a header; encoding: encoding of its text; end: bytes without a last line that was cut, which is
    `cut`"""

    separator: str
    point: str
    names: tuple[str, ...]
    units: Mapping[str, str]
    skipped: int
    before: int
    moments: frozenset[str]
    whole: frozenset[str]
    numbers: frozenset[str]
    is_likely: bool
    encoding: str = "utf-8"
    end: int = 0
    cut: str = ""

    def to_text(self) -> str:
        """What is unusual about it."""
        said = (
            [f"{SEPARATORS[self.separator]} between columns"] if self.separator != "," and len(self.names) > 1 else []
        )
        said += ["decimal commas"] if self.point == "," else []
        said += [f"{self.before} line{'s' * (self.before > 1)} before its header"] if self.before else []
        without = f"no header after {self.skipped} lines" if self.skipped else "no header"
        said += [f"{without}: columns are named by their places"] if self.names[0] == "#1" and not self.before else []
        said += [cut_words(self.cut)] if self.cut else []
        return "".join(f", {one}" for one in said)


def cut_words(cut: str) -> str:
    """What a person reads of a last line that was cut off."""
    return f"its last line is cut and left out: {cut[:60]!r}"


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names of columns, each once: a name of several, or none, has its place from 1 (`Fx#3`)."""
    found = Counter(names)
    return tuple(one if one and found[one] == 1 else f"{one}#{at}" for at, one in enumerate(names, 1))


def moment_ns(text: str) -> int:
    """A date with a time in UTC, or a time of day, [ns] since 1970 or midnight. Raises ValueError for others."""
    if not (found := _MOMENT.fullmatch(text.strip())):
        raise ValueError(f"no time of day, and no ISO date with one: {text!r}")
    year, month, day, *german, hour, minute, second, part, zone = found.groups()
    if german[0]:
        day, month, year = german
    if int(hour) > 23 or int(minute) > 59 or int(second) > 60:
        raise ValueError(f"no time of day: {text!r}")
    days = date(int(year), int(month), int(day)).toordinal() - date(1970, 1, 1).toordinal() if year else 0
    seconds = days * 86_400 + int(hour) * 3600 + int(minute) * 60 + int(second)
    if zone and zone != "Z":
        away_s = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        seconds -= away_s if zone[0] == "+" else -away_s
    return seconds * 10**9 + int((part or "").ljust(9, "0"))


def form_of(file: BinaryIO, skip_rows: int = 0, where: object = "", *, is_own: bool = False) -> TableForm:
    """The form of a table, by evidence of its first and last lines. skip_rows: lines before its header, 0 = not known;
    is_own: one that deformscope exported. Raises InputError for a header that skip_rows does not lead to."""
    most, count = check_size("", 0), 0
    raw: list[bytes] = []
    while (count < SEEN_BYTES or (len(raw) < SEEN_LINES + skip_rows and count < most)) and (
        line := file.readline(most)
    ):
        bare = re.sub(rb'"[^"]*"', b"", line)
        columns = (max(map(bare.count, (b"\t", b";", b"|", b","))) or bare.count(b" ")) + 1
        check_size(f"a table, of {columns} columns,", columns * COLUMN_BYTES, where)
        raw.append(line)
        count += len(line)
    encoding, is_cut = _encoding(b"".join(raw)), bool(file.read(1))
    lines = _lines(b"".join(raw), encoding)
    lines = lines[:-1] if is_cut and not lines[-1].endswith("\n") else lines  # the file goes on
    size = file.seek(0, io.SEEK_END)
    if is_own:
        return replace(_Looked(",", lines[:1], 0, heads=1).form(), encoding=encoding, end=size)
    looked = [_Looked(one, lines, skip_rows) for one in SEPARATORS]
    best = max(looked, key=lambda one: one.evidence)
    if len(best.others) > best.count and not skip_rows:
        came = f"rows of {', '.join(map(str, sorted({*best.others, best.width})))} numbers"
        raise InputError("a table, whose rows are of one width", came, "a file for each of them", where)
    if skip_rows and not best.is_named:
        free = max((_Looked(one, lines, 0) for one in SEPARATORS), key=lambda one: one.evidence)
        hint = f"skip_rows = {free.form().before}, or the map without it" if free.is_named else "rows with a header"
        came = repr("".join(lines[skip_rows:])[:60].splitlines()[:1] or "the end of the table")
        raise InputError(f"a header of {best.width} columns after skip_rows = {skip_rows} lines", came, hint, where)
    start = max(size - max(SEEN_BYTES, 8 * max(map(len, raw), default=0)), 0) // 2 * 2
    file.seek(start)
    codec = {"utf-8-sig": "utf-8"}.get(encoding, encoding)
    if encoding == "utf-16":
        codec = "utf-16-le" if raw[0].startswith(codecs.BOM_UTF16_LE) else "utf-16-be"
    tail = _lines(file.read(), codec)[1 if start else best.form().skipped :]
    cut = best.cut_off(tail)
    words = cut.strip() if cut.strip("\t;|, \r\n") else ""
    return replace(best.form(), encoding=encoding, end=size - len(cut.encode(codec)), cut=words)


def open_table(file: BinaryIO, form: TableForm, types: Mapping[str, Any], nulls: Sequence[str] | None = None) -> Any:
    """pyarrow's reader of its rows, in batches. types: types of columns; nulls: texts without a value"""
    from pyarrow import csv as arrow

    file.seek(0)
    # blanks are joined before pyarrow sees them
    encoding = {"utf-8-sig": "utf8", "utf-8": "utf8"}.get(form.encoding, form.encoding)
    read = arrow.ReadOptions(skip_rows=form.skipped, column_names=form.names, block_size=BLOCK_BYTES, encoding=encoding)
    convert = arrow.ConvertOptions(column_types=types, decimal_point=form.point, null_values=nulls)
    parse = arrow.ParseOptions(delimiter=form.separator)
    rows = io.BufferedReader(_TextLines(file, form), BLOCK_BYTES)
    return arrow.open_csv(rows, read_options=read, parse_options=parse, convert_options=convert)


class _TextLines(io.RawIOBase):
    """A table's whole lines, with one blank for each run of them."""

    def __init__(self, file: BinaryIO, form: TableForm) -> None:
        self._file, self._left, self._ready = file, form.end, b""
        self._is_spaced, self._encoding = form.separator == " ", form.encoding

    def readable(self) -> bool:
        return True

    def readinto(self, into: Any) -> int:
        if not self._ready and self._left > 0:
            found = self._file.read(min(self._left, BLOCK_BYTES))
            if self._is_spaced and not found.endswith(b"\n"):
                found += self._file.readline()
            self._left -= len(found) or self._left
            ends = not self._left and not found.endswith(b"\n") and self._encoding != "utf-16"
            self._ready = found = found + b"\n" * ends  # pyarrow skips whole lines
            if self._is_spaced:
                self._ready = b"\n".join(b" ".join(line.split()) for line in found.split(b"\n"))
        size = min(len(into), len(self._ready))
        into[:size], self._ready = self._ready[:size], self._ready[size:]
        return size


class _Looked:
    """A table's first lines, read with one separator. heads: rows of its header, -1 = by evidence"""

    def __init__(self, separator: str, lines: Sequence[str], skip_rows: int, heads: int = -1) -> None:
        self.separator, self._skip_rows = separator, skip_rows
        self._rows = [(row, end + skip_rows) for row, end in _split(lines[skip_rows:], separator)] or [([""], 0)]
        widths = Counter(len(row) for row, _ in self._rows[-max(3, len(self._rows) // 4) :])
        self.width = max(widths, key=lambda one: (widths[one], one))
        first = max(at for at, (row, _) in enumerate(self._rows) if len(row) == self.width)
        fits = [len(row) == self.width for row, _ in self._rows]
        while first and (fits[first - 1] or (first > 1 and fits[first - 2] and _is_data(self._rows[first - 2][0]))):
            first -= 1  # a row within that lacks a field is no end
        self._before = self._rows[first - 1][1] if first else skip_rows
        block = [row for row, _ in self._rows[first:] if len(row) == self.width]
        ends = [end for (_, end), one in zip(self._rows[first:], fits[first:], strict=True) if one]
        if form := _form_rows(block):
            self._before, block, ends = ends[form - 1], block[form:], ends[form:]
        self._ends = ends
        self._head = block[: _heads(block) if heads < 0 else heads]
        self._heads = len(self._head)
        self._data = block[self._heads :]
        self.count = len(self._data)
        given_rows = (row for row, _ in self._rows if len(row) != self.width)
        self.others = [len(row) for row in given_rows if all(map(_NUMBER.fullmatch, row))]
        """Widths of rows of numbers that are not of the table."""
        self.is_named = self._heads > 0 and not (skip_rows and first)
        given = [one for row in self._data for one in row if not _is_missing(one)]
        known = sum(map(_is_value, given))
        share, order = round(known / max(len(given), 1), 3), -list(SEPARATORS).index(separator)
        # one column of decimal commas reads as well as two of whole numbers: where the header has two, they are two
        is_likely = share >= 0.5 and self.is_named and self.width > 1
        self.evidence = is_likely, share, self.is_named, self.width, order

    @cached_property
    def _point(self) -> str:
        if self.separator == ",":  # where commas separate, those of `"1,500"` rather group digits
            quoted = [one for row in self._data for one in row if "," in one and _NUMBER.fullmatch(one)]
            if all(map(_THOUSANDS.fullmatch, quoted)):
                return "."
        marks = Counter(
            "," if "," in one else "."
            for row in self._data
            for one in row
            if _NUMBER.fullmatch(one) and {*one} & {*".,"}
        )
        return "," if marks[","] > marks["."] else "."

    def form(self) -> TableForm:
        """Names, units and kinds of its columns."""
        heads, named = self._head, 0
        if heads and not self._skip_rows:
            named = max(range(len(heads)), key=lambda at: (not _are_units(heads[at]), len({*heads[at]} - {""}), at))
        raw = heads[named] if heads else [""] * self.width
        names = unique_names(raw)
        under = next((row for at, row in enumerate(heads) if at != named and _are_units(row)), [""] * self.width)
        said = [_UNIT.search(name) for name in raw]
        texts = [
            unit.strip("[]()<> ") or (one[1].strip() if one else "") for unit, one in zip(under, said, strict=True)
        ]
        units = {
            name: SPELLINGS.get(one, one) if one in UNIT_WORDS else "" for name, one in zip(names, texts, strict=True)
        }
        other = re.compile(r"[+-]?\d[\d]*,\d.*|,\d.*" if self._point == "." else r".*\..*")
        columns: dict[str, list[str]] = dict(zip(names, map(list, zip(*self._data, strict=True)), strict=False))
        given = {name: [one for one in columns.get(name, ()) if not _is_missing(one)] for name in names}
        numbers = frozenset(
            name
            for name, found in given.items()
            if all(_NUMBER.fullmatch(one) and not other.fullmatch(one) for one in found)
        )
        moments = frozenset(name for name, found in given.items() if found and all(map(_MOMENT.fullmatch, found)))
        whole = frozenset(name for name in numbers if all(re.fullmatch(r"[+-]?\d+", one) for one in given[name]))
        before = self._ends[named - 1] if named else self._before
        skipped = self._ends[self._heads - 1] if heads else self._before
        is_likely = self.evidence[0]
        kinds = moments, whole, numbers
        return TableForm(self.separator, self._point, names, units, skipped, before if heads else 0, *kinds, is_likely)

    def cut_off(self, tail: Sequence[str]) -> str:
        """What is no row at the end: the last line, if it was cut off, and lines without values. tail: the table's last
        lines"""
        at = len(tail)
        while at and not tail[at - 1].strip("\t;|, \r\n"):
            at -= 1
        *before, row = [one for one, _ in _split(tail[max(at - 64, 0) : at], self.separator)] or [[""] * self.width]
        is_cut = len(row) < self.width
        if len(row) == self.width and at and not tail[at - 1].endswith(("\n", "\r")):
            lasts = [one[-1] for one in before if len(one) == self.width]
            decimals = {*map(_decimals, lasts)}
            is_number = all(map(_NUMBER.fullmatch, lasts)) and lasts
            is_cut = bool(is_number) and (
                not _NUMBER.fullmatch(row[-1]) or (len(decimals) == 1 and _decimals(row[-1]) < max(decimals))
            )
        return "".join(tail[at - (is_cut and at > 0) :])


def _of_numbers(block: Sequence[Sequence[str]]) -> list[int]:
    """The columns with numbers in the last rows."""
    below = zip(*block[-max(1, len(block) // 3) :], strict=True)
    return [
        at
        for at, found in enumerate(below)
        if not all(map(_is_missing, found)) and all(_is_missing(one) or _is_value(one) for one in found)
    ]


def _form_rows(block: Sequence[Sequence[str]]) -> int:
    """How many of the first rows are a form above the table, as of a test machine: texts and numbers, and below them a
    row with a name for each column of numbers."""
    parts = list(zip(*([row[at] for row in block] for at in _of_numbers(block)), strict=True))
    named = [
        at for at, part in enumerate(parts) if part and not any(_is_missing(one) or _is_value(one) for one in part)
    ]
    start = named[-1] if named else 0
    above = parts[: start - 1 if start - 1 in named else start]
    is_form = any(any(map(_is_value, part)) for part in above) and not any(all(map(_is_value, part)) for part in above)
    return len(above) if is_form else 0


def _heads(block: Sequence[Sequence[str]]) -> int:
    """How many of the first rows are a header: texts where the rows below have numbers."""
    of_numbers = _of_numbers(block)
    if not of_numbers:
        return 1
    for at, row in enumerate(block):
        given = [row[one] for one in of_numbers if row[one]]
        if any(map(_is_value, given)) or not given:
            # a name may be a number too: where all below it are, and another is none
            texts = [one for one in of_numbers if not _is_missing(row[one]) and not _NUMBER.fullmatch(row[one])]
            rest = [other[one] for other in block[1:] for one in texts]
            is_first = at == 0 and texts and all(_is_missing(one) or _NUMBER.fullmatch(one) for one in rest)
            return 1 if is_first else at
    return len(block)


def _is_data(row: Sequence[str]) -> bool:
    return 2 * sum(map(_is_value, row)) >= len(row)


def _is_value(text: str) -> bool:
    """Whether it is a number, a time of day or a date."""
    return bool(_NUMBER.fullmatch(text) or _MOMENT.fullmatch(text))


def _decimals(number: str) -> int:
    """How many digits it has after its point or comma."""
    return len(re.split("[.,]", number)[-1]) if {*number} & {*".,"} else 0


def _is_missing(text: str) -> bool:
    return text.lower() in MISSING


def _are_units(row: Sequence[str]) -> bool:
    given = [one.strip("[]()<> ") for one in row if one]
    return bool(given) and all(one in UNIT_WORDS for one in given)


def _encoding(raw: bytes) -> str:
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(raw)
    except UnicodeDecodeError:
        is_chinese = all(map(_CHINESE.fullmatch, re.findall(rb"[\x80-\xff]+", raw)))
        return "gb18030" if is_chinese else "latin-1"
    return "utf-8-sig" if raw.startswith(codecs.BOM_UTF8) else "utf-8"


def _lines(raw: bytes, encoding: str) -> list[str]:
    """Lines with their ends; a character that is cut is left out."""
    return list(io.StringIO(raw.decode(encoding, "ignore"), newline=""))


def _split(lines: Sequence[str], separator: str) -> list[_Row]:
    """Rows that are not empty. A header may be a comment."""
    plain = [re.sub(r"^[#%]+\s*", "", line) for line in lines]
    if separator == " ":
        plain = [" ".join(line.split()) + "\n" for line in plain]
    reader, found = csv.reader(plain, delimiter=separator), []
    with contextlib.suppress(csv.Error):  # of a field that is very long
        for row in filter(None, reader):
            found.append(([one.strip() for one in row], reader.line_num))
    return found
