"""A catalog of the recordings in a folder: a Parquet file there, updated by their content."""

import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
import pyarrow as pa

from deformscope.errors import InputError
from deformscope.executor.local import open_workers
from deformscope.executor.tasks import compute
from deformscope.file_io import nearest_file
from deformscope.files.result_table import make_table, read_table, select_rows, to_utf8, write_table
from deformscope.files.sources import RECORDING_SUFFIX, natural_key
from deformscope.pictures.messages import counted
from deformscope.pictures.report import Link, Section, Table, html_report
from deformscope.plain import Json, plain
from deformscope.recording.ledger import ledger_path
from deformscope.recording.streams import unit_of
from deformscope.results.render import HIGH, LOW, cell_text, cells_of
from deformscope.runs.result import LibraryResult
from deformscope.terminal import Progress
from deformscope.version import __version__

if TYPE_CHECKING:
    from deformscope.recording.reader import Replay
    from deformscope.rig.sections import CertificateSection

INDEX, PAGE, PICTURES = "catalog.parquet", "catalog.html", ".catalog"
UNREAD = "unread"
"""Status if the system refused, or the process that read it ended: it does not describe the recording."""
STATED = ("size", "mtime_ns", "ledger_ns", "by")
"""Conditions for a valid row of the index: of the file, of its ledger, and the version that read it."""
TYPES = {
    **{name: pa.string() for name in ("path", "status", "problem", "kind", "label", "devices", "verdict", "losses")},
    **{name: pa.string() for name in ("notes", "discarded", "command", "version", "sha256", "recorded", "by")},
    **{name: pa.int64() for name in ("size", "mtime_ns", "ledger_ns")},
    "damaged": pa.bool_(),
    "duration_s": pa.float64(),
}
SHOWN = ("path", "status", "kind", "recorded", "duration_s", "beta", "theta", "stiffness", "verdict", "label", "losses")
DECLARED = {"stiffness": "N/mm"}
"""Units of columns whose names do not say them."""
SHOWN_MORE = ("notes", "discarded", "problem")
PICTURE_PX, PAGE_ROWS = 320, 1000


@dataclass(frozen=True, slots=True, repr=False)
class CatalogResult(LibraryResult):
    """folder: folder of the recordings; table: the requested rows; names: names of the columns to show; read: number of
    recordings that were read"""

    folder: Path
    table: pa.Table
    names: tuple[str, ...]
    read: int

    def tables(self) -> tuple[Table, ...]:
        there = [name for name in self.names if self.table[name].null_count < self.table.num_rows]
        rows = [[cell_text(row[name]) for name in there] for row in self.table.select(there).to_pylist()]
        return (Table(rows, [_heading(name) for name in there], counted(self.table.num_rows, "recording")),)

    def as_json(self) -> Json:
        rows = [{name: value for name, value in row.items() if value is not None} for row in self.table.to_pylist()]
        return {"folder": self.folder, "index": self.folder / INDEX, "read": self.read, "recordings": rows}


def _heading(name: str) -> str:
    """A column's name, as conditions have it, and its unit."""
    unit = unit_of(name, DECLARED)
    return f"{name} [{unit}]" if unit else name


def catalogue(
    folder: Path,
    where: str = "",
    sort: str = "",
    names: Sequence[str] = (),
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> CatalogResult:
    """The recordings of a folder for which a condition holds (`select_rows`); the index is made or updated.

    names: names of columns to show. Raises InputError for unusable arguments; a damaged recording is a row with that
    status."""
    if not folder.is_dir():
        came, hint = ("a file", "its folder") if folder.exists() else ("nothing there", nearest_file(folder))
        raise InputError("a folder of recordings", came, hint, folder)
    table, read = _index(folder, workers, progress)
    shown = [name for name in names if name in table.schema.names]
    if len(shown) < len(names):
        missing = next(name for name in names if name not in shown)
        raise InputError("columns of the catalog", repr(missing), ", ".join(table.schema.names[:20]))
    table = select_rows(table, where, sort)
    known = tuple(shown or (name for name in (*SHOWN, *SHOWN_MORE) if name in table.schema.names))
    return CatalogResult(folder, table, known, read)


def catalogued_paths(source: Path, where: str) -> list[Path]:
    """The recordings of a folder, or of the catalog in it, for which a condition holds."""
    folder = source.parent if source.suffix == ".parquet" else source
    if source.suffix == ".parquet" and source.name != INDEX:
        raise InputError(f"a folder, or the {INDEX} in it", source.name, where=source)
    return [_file(folder, path) for path in catalogue(folder, where).table["path"].to_pylist()]


def _file(folder: Path, name: str) -> Path:
    """The recording of a row."""
    if (path := folder / name).exists():
        return path
    return next((one for one in folder.rglob("*") if to_utf8(str(one.relative_to(folder))) == name), path)


def _index(folder: Path, workers: int | None, progress: Progress | None) -> tuple[pa.Table, int]:
    path = folder / INDEX
    before = read_table(path).to_pylist() if path.exists() else []
    by_path = {row["path"]: row for row in before}
    found = [one for one in folder.rglob(f"*{RECORDING_SUFFIX}") if one.is_file() and not one.name.startswith(".")]
    rows, left = dict[str, dict[str, Any]](), list[tuple[str, str]]()
    for one in sorted(found, key=lambda one: (str(one.parent), natural_key(one))):
        name = str(one.relative_to(folder))
        rows[name] = {"path": name, "status": UNREAD} | _stated(one)
        row = by_path.get(to_utf8(name), {"status": UNREAD})
        if row["status"] not in (UNREAD, "being written") and all(row.get(key) == rows[name][key] for key in STATED):
            rows[name] = row
        else:
            left.append((str(folder), name))
    if not left and len(before) == len(rows):
        return read_table(path), 0
    try:
        with open_workers("local", None, workers, len(left), apart=True) as several:
            for count, outcome in enumerate(compute(several, _summarised, left, attempts=1), start=1):
                rows[outcome.item[1]] |= outcome.value or {"problem": "; ".join(outcome.reasons)}
                if progress is not None:
                    progress("reading recordings", count, len(left))
    finally:  # also what was read where it is broken off
        table = make_table(rows.values(), TYPES)
        try:
            write_table(table, path)
        except OSError as error:
            raise InputError("a folder that the index can be written to", str(error.strerror), where=path) from error
    return table, len(left)


def _stated(path: Path) -> dict[str, Any]:
    stat, ledger = path.stat(), ledger_path(path)
    recorded = datetime.fromtimestamp(stat.st_mtime, UTC).strftime("%Y-%m-%d %H:%M")
    found: dict[str, Any] = {"recorded": recorded, "size": stat.st_size, "mtime_ns": stat.st_mtime_ns}
    return found | {"ledger_ns": ledger.stat().st_mtime_ns if ledger.exists() else -1, "by": __version__}


def _summarised(of: tuple[str, str]) -> dict[str, Any]:
    from deformscope.recording.summary import summarise

    found = plain(summarise(Path(*of)))
    assert isinstance(found, dict)
    return found


# The page -------------------------------------------------------------------------------------------------------------


def catalog_page(
    found: CatalogResult, *, served: bool = False, workers: int | None = None, progress: Progress | None = None
) -> str:
    """A page with a picture of each recording; a click on it opens the recording. Pictures are made once. served: its
    links are the places of recordings on a page that is served, not files"""
    rows = found.table.slice(0, PAGE_ROWS).to_pylist()
    pictures = {row["path"]: found.folder / PICTURES / f"{row['sha256']}.png" for row in rows if row["sha256"]}
    left = [(str(_file(found.folder, name)), str(png)) for name, png in pictures.items() if not png.exists()]
    if left:
        (found.folder / PICTURES).mkdir(exist_ok=True)
        with open_workers("local", None, workers, len(left), apart=True) as several:
            for count, _ in enumerate(compute(several, _draw, left, attempts=1), start=1):
                if progress is not None:
                    progress("drawing", count, len(left))
    names = [name for name in found.names if name != "path" and any(row[name] is not None for row in rows)]
    cells = []
    for number, row in enumerate(rows):
        png = pictures.get(row["path"])
        picture = png.read_bytes() if png is not None and png.exists() else b""
        path = quote(os.fsencode(_file(found.folder, row["path"]).relative_to(found.folder)))
        link = Link(row["path"], f"{number}/" if served else path, picture)
        cells.append((link, *(cell_text(row[name]) for name in names)))
    more = f", of which the first {PAGE_ROWS} are shown" if found.table.num_rows > PAGE_ROWS else ""
    words = f"{found.table.num_rows} recordings{more}. A picture opens its recording"
    words += "." if served else ", where rerun opens .rrd files."
    return html_report(
        f"Recordings in {found.folder.name}", [Section("", [words, Table(cells, ("", *map(_heading, names)))])]
    )


def serve_page(found: CatalogResult, workers: int | None = None, progress: Progress | None = None) -> str:
    """Serve that page: a click plays the recording. Its address."""
    from deformscope.page.playback import serve_catalog

    html = catalog_page(found, served=True, workers=workers, progress=progress)
    paths = [_file(found.folder, name) for name in found.table["path"].slice(0, PAGE_ROWS).to_pylist()]
    return serve_catalog(found.folder.name, html, paths).address


def _draw(of: tuple[str, str]) -> None:
    """The first figure of its report, small."""
    import cv2

    from deformscope.images import decode_image
    from deformscope.runs.recording_report import report_recording

    recording, target = of
    figures = report_recording(Path(recording)).figures()
    if figures:
        image = decode_image(figures[0].png, recording)
        height, width = image.shape[:2]
        scale = PICTURE_PX / max(height, width)
        small = cv2.resize(image, (round(scale * width), round(scale * height)), interpolation=cv2.INTER_AREA)
        Path(target).write_bytes(cv2.imencode(".png", small)[1].tobytes())


# Two recordings -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, repr=False)
class ComparedRecordings(LibraryResult):
    """How the second differs from the first.

    certificates: each rig's bias on a known sample, empty = none; settings: settings that differ, by name; results:
    (name, first, second, difference) as in JSON, values with intervals; series: series of the devices' measurements
    since the first contact; unaligned: why there are no series, empty = there are
    """

    first: Path
    second: Path
    settings: Mapping[str, tuple[object, object]]
    results: Sequence[Json]
    series: Sequence[Json]
    unaligned: str
    certificates: Sequence[str] = ()

    def tables(self) -> tuple[Table, ...]:
        names = ("", self.first.stem, self.second.stem)
        settings = [(name, cell_text(a), cell_text(b)) for name, (a, b) in self.settings.items()]
        results = [
            (_heading(str(one["name"])), *(_with_ends(one.get(which)) for which in ("first", "second", "difference")))
            for one in self.results
        ]
        columns = ("since the first contact", "rms difference", "largest", "over [s]")
        series = [
            (one["name"], f"{one['rms']:.4g}", f"{one['largest']:.4g}", f"{one['from_s']:.2f} to {one['to_s']:.2f}")
            for one in self.series
        ]
        certified = [("certificate", *self.certificates)] if any(self.certificates) else []
        tables = [
            Table(certified, names, "Rigs"),
            Table(settings, names, "Settings that differ"),
            Table(results, (*names, "difference"), "Results"),
        ]
        tables.append(Table(series, columns, "Measurements of devices, aligned by contact"))
        return tuple(one for one in tables if one.rows)

    def as_json(self) -> Json:
        settings = {name: {"first": a, "second": b} for name, (a, b) in self.settings.items()}
        found = {"first": self.first, "second": self.second, "settings": settings, "results": self.results}
        found |= {"certificates": self.certificates} if any(self.certificates) else {}
        return found | {"series": self.series, "unaligned": self.unaligned}


def compare_recordings(first: Path, second: Path, *, corrected: bool = False) -> ComparedRecordings:
    """corrected: without the certified bias of each rig. Raises InputError if a file is damaged, or no recording of
    deformscope, and for a bias to take out where neither rig has one."""
    from deformscope.recording.reader import Replay
    from deformscope.recording.summary import SETTINGS, summarise

    replays = [Replay(path) for path in (first, second)]
    rows = [plain(summarise(path) | _touches(path)) for path in (first, second)]
    a, b = (row for row in rows if isinstance(row, dict))
    certificates = ["" if (one := _certificate(replay)) is None else str(one) for replay in replays]
    if corrected and not any(certificates):
        raise InputError("a recording of a certified rig, for --corrected", "none", "deformscope certify RIG --save")
    if corrected:
        a, b = (_without_bias(row, replay) for row, replay in zip((a, b), replays, strict=True))
    names = list(dict.fromkeys([*a, *b]))
    settings = {
        name.removeprefix(SETTINGS): (a.get(name), b.get(name))
        for name in names
        if (name.startswith(SETTINGS) or name in ("kind", "version", "devices")) and a.get(name) != b.get(name)
    }
    if replays[0].settings.get("rig") != replays[1].settings.get("rig"):
        settings.setdefault("rig", ("its rig file", "another rig file"))
    results = []
    for name in names:
        ends = name.endswith((LOW, HIGH)) and name.rpartition("_")[0] in names
        if not (name.startswith(SETTINGS) or ends or name in NOT_RESULTS):
            results.append(_difference(name, a, b))
    series, unaligned = _series(*replays)
    return ComparedRecordings(first, second, settings, results, series, unaligned, certificates)


def _certificate(replay: "Replay") -> "CertificateSection | None":
    """The certificate of the recorded rig, if it had one."""
    from deformscope.rig.sections import CertificateSection

    text = replay.settings["rig"] if "rig_name" in replay.settings else ""
    given = tomllib.loads(text).get("certificate")
    return None if given is None else CertificateSection(**given)


def _without_bias(row: Json, replay: "Replay") -> Json:
    """A summary without the rig's bias, whose interval widens each other; as it is if an exploration took it out. A
    stiffness at a set force under a ball has 2/3 of a modulus's bias (Hertz)."""
    if (found := _certificate(replay)) is None or replay.settings.get("corrected"):
        return row
    made, ends = dict(row), {LOW: found.interval[1], HIGH: found.interval[0]}
    for name, value in row.items():
        power = {"Pa": 1.0, "N/mm": 2.0 / 3.0}.get(unit_of(name, DECLARED), 0.0)
        bias = next((one for end, one in ends.items() if name.endswith(end)), found.bias)
        made[name] = value * (1.0 + bias) ** -power if isinstance(value, float) else value
    return made


NOT_RESULTS = {
    *("status", "damaged", "problem", "sha256", "kind", "recording", "command", "seed", "version", "devices"),
    *("complete", "frames", "label", "notes", "discarded", "parameter"),
}
"""Columns of a summary that are no results."""


def _touches(path: Path) -> dict[str, Any]:
    """The declared quantities of each touch."""
    from deformscope.recording.items import read_results
    from deformscope.stages.map.exploration import TouchEstimate

    found: dict[str, Any] = {}
    for row in read_results(path, (TouchEstimate,), trust=True):
        found |= {f"touch {row.item.number}.{name}": value for name, value in cells_of(row.item).items()}
    return found


def _difference(name: str, a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    """Both, with their intervals, and second minus first: its interval comes from theirs as for independent estimates
    (MOVER: G. Y. Zou and A. Donner, Statistics in Medicine 27, 2008)."""
    found: dict[str, Any] = {"name": name, "first": _valued(name, a), "second": _valued(name, b)}
    x, y = a.get(name), b.get(name)
    if any(isinstance(one, bool) or not isinstance(one, int | float) for one in (x, y)):
        return found
    found["difference"] = {"value": y - x}  # type: ignore[operator]
    ends = [one.get(name + end) for one in (a, b) for end in (LOW, HIGH)]
    if all(end is not None for end in ends):
        x_low, x_high, y_low, y_high = ends
        below, above = math.hypot(y - y_low, x_high - x), math.hypot(y_high - y, x - x_low)  # type: ignore[operator]
        found["difference"]["interval"] = [y - x - below, y - x + above]  # type: ignore[operator]
    return found


def _valued(name: str, row: Mapping[str, Any]) -> dict[str, Any]:
    ends = [row.get(name + LOW), row.get(name + HIGH)]
    return {"value": row.get(name)} | ({"interval": ends} if None not in ends else {})


def _with_ends(one: object) -> str:
    if not isinstance(one, dict):
        return ""
    ends = " ({:.4g} to {:.4g})".format(*one["interval"]) if "interval" in one else ""
    return cell_text(one["value"]) + ends


def _series(first: "Replay", second: "Replay") -> tuple[list[dict[str, Any]], str]:
    from deformscope.runs.aligned import aligned_series

    try:
        before, after = aligned_series(first), aligned_series(second)
    except InputError as error:
        return [], str(error)
    found = []
    for device, one in before.items():
        other = after.get(device)
        if other is None or other.quantity != one.quantity:
            continue
        (at, mine), (theirs_at, theirs) = (_once(each.since_ns, each.values) for each in (one, other))
        both = (at >= max(0, theirs_at[0])) & (at <= theirs_at[-1])
        if both.any():
            at = at[both]
            apart = np.interp(at, theirs_at, theirs) - mine[both]
            about = {"name": f"{device}: {one.quantity}", "rms": float(np.sqrt(np.mean(apart**2)))}
            about |= {"largest": float(np.abs(apart).max()), "from_s": float(at[0] / 1e9), "to_s": float(at[-1] / 1e9)}
            found.append(about)
    return found, ""


def _once(at: Any, values: Any) -> tuple[Any, Any]:
    """The first of the values that have the same time."""
    times, first = np.unique(at, return_index=True)
    return times, values[first]
