"""Write a recording in another format: into a draft in the same parent folder, which takes its name once it is
complete."""

import dataclasses
import errno
import json
import os
import re
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any, Literal

from deformscope.errors import InputError
from deformscope.frames import Stream
from deformscope.plain import plain
from deformscope.recording.export.manifest import SCHEMA_VERSION
from deformscope.recording.export.mcap import ExportedImages, Note, Videos, counted_images, export_images
from deformscope.recording.export.table_files import IMAGES, TABLE_FILES, TableFile
from deformscope.recording.lock import one_at_a_time
from deformscope.recording.provenance import exported
from deformscope.recording.reader import Replay
from deformscope.recording.streams import RecordedStream, RecordingTables
from deformscope.rows import OF_DEVICES

Format = Literal["csv", "parquet", "mcap", "video", "npz", "images"]
MANIFESTS = "export.json", ".export.json"
NUMBERED = re.compile(r"\d{6,}\.(png|jpg)")
_drafts = count()


@dataclass(frozen=True, slots=True)
class ExportedFile:
    """A file of an export. rows: number of rows of a stream, messages of an MCAP, or images"""

    entity: str
    file: str
    rows: int


@dataclass(frozen=True, slots=True)
class Exported:
    """The result of an export. images: number of images by kind, in an export of images"""

    folder: Path
    files: list[ExportedFile]
    images: list[ExportedImages]


@dataclass(frozen=True, slots=True)
class Credits:
    """Information that is written into every format. license: licence of the data, as an SPDX identifier; citation: how
    it is cited"""

    license: str = ""
    authors: tuple[str, ...] = ()
    citation: str = ""


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """The request of an export: content, format and place.

    only: entities, with those below them, or devices; () = all; camera: images of this device alone
    anonymous: leave out whatever may name a person, a machine or a path; overwrite: replace an earlier export
    manifest: `export.json` in the folder is not hidden"""

    to: Format
    folder: Path
    only: Sequence[str] = ()
    camera: str | None = None
    anonymous: bool = False
    credits: Credits = field(default_factory=Credits)
    overwrite: bool = False
    manifest: bool = True


def export(replay: Replay, asked: ExportRequest, note: Note) -> Exported:
    """Write it. Raises InputError for sources and targets that cannot be read or written; then the folder is
    unchanged."""
    tables = RecordingTables(replay, anonymous=asked.anonymous)
    chosen = tables.select(asked.only)
    devices = {stream.device for stream in chosen.values()} if asked.only else None
    devices = {asked.camera} if asked.camera is not None else devices
    counts = counted_images(replay, devices) if asked.to in ("images", "video") else {}
    about = _about(replay, asked, tables)
    names = dict[tuple[str, str], str]()
    for device, what in counts:
        names[device, what] = _unused([f"{device}-{what}" if what == "color" else device], names.values())
    with _draft(asked.folder, overwrite=asked.overwrite) as draft:
        images, files = list[ExportedImages](), list[ExportedFile]()
        match asked.to:
            case "images":
                places = dict.fromkeys(counts, ".") if len(counts) == 1 else names
                export_images(tables, {one: draft / place for one, place in places.items()}, note)
                for (device, what), number in counts.items():
                    place = places[device, what]
                    files.append(ExportedFile(device, place, number))
                    images.append(ExportedImages(device=device, what=what, folder=asked.folder / place, count=number))
            case "video":
                cameras = {device for device, _ in counts}
                chosen = {entity: one for entity, one in chosen.items() if one.device in cameras}
                chosen = {entity: one for entity, one in chosen.items() if set(one.schema.names) & set(IMAGES)}
                videos = Videos(draft, {one.device: one.rate_hz for one in chosen.values()}, names)
                files = _write_tables(tables, chosen, draft, "csv", about, note, videos)
                files += [ExportedFile(path.stem, path.name, number) for path, number in videos.counts.items()]
            case "mcap":
                from deformscope.recording.export.mcap import ros_names, write_mcap

                about["topics"] = ros_names(chosen)
                about["device_topics"] = ros_names(dict.fromkeys(one.device for one in tables.streams.values()))
                path = draft / f"{replay.path.stem if not asked.anonymous else 'recording'}.mcap"
                files = [ExportedFile(*one) for one in write_mcap(tables, chosen, path, about, note)]
            case _:
                files = _write_tables(tables, chosen, draft, asked.to, about, note)
        about |= {"streams": [_described(one, files) for one in chosen.values()], "files": files}
        text = json.dumps(plain(about), indent=2, allow_nan=False)
        (draft / MANIFESTS[not asked.manifest]).write_text(f"{text}\n", encoding="utf-8")
    return Exported(asked.folder, files, images)


def _write_tables(
    tables: RecordingTables,
    chosen: Mapping[str, RecordedStream],
    draft: Path,
    kind: str,
    about: Mapping[str, Any],
    note: Note,
    videos: Videos | None = None,
) -> list[ExportedFile]:
    """One file a stream; with videos, the images of each batch go there too."""
    make: Callable[[Path, Any], TableFile] = TABLE_FILES[kind]
    made: dict[str, tuple[Path, TableFile]] = {}
    credited = {f"deformscope.{name}": as_text(about[name]) for name in ("license", "authors", "citation")}
    rows, names = dict.fromkeys(chosen, 0), dict[str, str]()
    total, done = sum(stream.rows for stream in chosen.values()), 0
    try:
        for entity, stream in chosen.items():
            names[entity] = file_name(entity, names.values())
            path = draft / f"{names[entity]}.{kind}"
            path.parent.mkdir(parents=True, exist_ok=True)
            made[entity] = path, make(path, stream.schema.with_metadata((stream.schema.metadata or {}) | credited))
        for stream, batch in tables.batches(chosen):
            made[stream.entity][1].write(batch.replace_schema_metadata(None))
            for what in IMAGES if videos is not None else ():
                for row in batch.select(["host_ns", what]).to_pylist() if what in batch.schema.names else ():
                    if videos is not None and row[what]:
                        videos.write(stream.device, what, row[what], row["host_ns"])
            rows[stream.entity] += batch.num_rows
            done += batch.num_rows
            note("rows", done, total)
    finally:
        for _, file in made.values():
            file.close()
        if videos is not None:
            videos.close()
    inside = {entity: made[entity][0].relative_to(draft).as_posix() for entity in rows}
    return [ExportedFile(entity, inside[entity], written) for entity, written in rows.items()]


def file_name(entity: str, used: Collection[str] = ()) -> str:
    """The path of an entity's file below folders: devices may have any name. used: paths that are already used"""
    first, _, rest = entity.partition("/")
    parts = [first, *([rest] if first in OF_DEVICES.values() else rest.split("/") if rest else ())]
    return _unused(parts, used)


def _unused(parts: Sequence[str], used: Collection[str]) -> str:
    path = "/".join(re.sub(r"[^\w.-]", "_", part).lstrip(".") or "_" for part in parts)
    others = (f"{path}-{number}" for number in count(2))
    return next(name for name in chain([path], others) if name not in used)


def _about(replay: Replay, asked: ExportRequest, tables: RecordingTables) -> dict[str, Any]:
    """Description of the export in the manifest, and in the metadata of an MCAP."""
    application, recording = replay.identity
    found: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "format": asked.to, "recording": recording}
    found |= {"application": application, "source": None if asked.anonymous else replay.path.name}
    found |= {"license": asked.credits.license, "authors": list(asked.credits.authors)}
    found |= {"citation": asked.credits.citation, "anonymous": asked.anonymous}
    found |= {"clock": "host_ns: the host's monotonic clock", "session_starts_ns": tables.start_ns}
    found |= {"devices": {one.device: _device(one.about) for one in tables.streams.values() if one.about is not None}}
    left_out = {"reason": "", "label": ""} if asked.anonymous else {}
    found |= {"complete": bool(replay.outcome.get("complete")), "recovered": "recovered" in replay.outcome}
    found |= {"stopped": "" if asked.anonymous else replay.outcome.get("stopped", ""), "losses": replay.losses}
    found |= {"checked": replay.has_ledger, "source_problems": replay.source_problems}
    found |= {"discarded": [dataclasses.asdict(one) | left_out for one in replay.discarded]}
    return found | {"provenance": exported(replay.properties, anonymous=asked.anonymous)}


def _device(known: Stream) -> dict[str, Any]:
    """What is known of a device, without what names one: its serial number, firmware and files."""
    left_out = ("device", "serial", "firmware", "urdf")
    return {one.name: getattr(known, one.name) for one in dataclasses.fields(known) if one.name not in left_out}


def _described(stream: RecordedStream, files: Sequence[ExportedFile]) -> dict[str, Any]:
    columns = [
        {"name": one.name, "type": str(one.type), "unit": (one.metadata or {}).get(b"unit", b"").decode()}
        for one in stream.schema
    ]
    known = stream.about
    said = {} if known is None else {"kind": known.kind, "driver": known.driver, "simulated": known.simulated}
    device = None if known is None else {"name": stream.device, **said}
    own = [one.file for one in files if one.entity == stream.entity]
    found = {"entity": stream.entity, "kind": stream.kinds[-1].__name__ if stream.kinds else "", "files": own}
    return found | {"device": device, "columns": columns}


@contextmanager
def _draft(folder: Path, *, overwrite: bool) -> Iterator[Path]:
    """A folder that takes the place of FOLDER when all is written, and is gone on an error. overwrite: what an earlier
    export wrote there is replaced; other files there stay"""
    folder = Path(os.path.realpath(folder.expanduser()))
    is_there = folder.is_dir()  # the draft is then in it: it may be another disk
    draft = (folder if is_there else folder.parent) / f".{folder.name}.{os.getpid()}-{next(_drafts)}.part"
    try:
        _check_empty(folder, "one that holds files", allowed=overwrite)
        draft.mkdir(parents=True)
        yield draft
        if is_there:
            with one_at_a_time(folder):
                _check_empty(folder, "one that something has just been put into", allowed=overwrite)
                _replace(folder, draft)
        else:
            draft.rename(folder)  # fails where another export has put its files there meanwhile
    except OSError as error:
        came = "one that something has just been put into" if error.errno == errno.ENOTEMPTY else _reason(error)
        raise InputError("a folder that can be written to", came, "another one", folder) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _check_empty(folder: Path, came: str, *, allowed: bool) -> None:
    """Refuse a folder that holds something but drafts of exports. allowed: it may"""
    if folder.exists() and any(one.suffix != ".part" for one in folder.iterdir()) and not allowed:
        raise InputError("an empty folder, or a new one", came, "another one, or --overwrite", folder)


def _replace(folder: Path, draft: Path) -> None:
    """Take away what an earlier export wrote, as its manifest says, and move the draft's files there.

    Raises InputError if foreign images would be among the new ones."""
    new = {folder / path.relative_to(draft) for path in draft.rglob("*") if path.is_file()}
    old = set[Path]()
    for manifest in (folder / name for name in MANIFESTS):
        with suppress(OSError, ValueError, TypeError, KeyError):
            ours = [folder / one["file"] for one in json.loads(manifest.read_bytes())["files"]]
            old |= {manifest, *ours, *(path for one in ours for path in _numbered(one))}
    for place in {path.parent for path in new if NUMBERED.fullmatch(path.name)}:
        if others := sorted(_numbered(place) - old - new):
            raise InputError("a folder without other images", others[0].name, "another one", place)
    for path in old:
        if path.is_file() and path.resolve().is_relative_to(folder):
            path.unlink()
    for path in new:
        path.parent.mkdir(parents=True, exist_ok=True)
        (draft / path.relative_to(folder)).replace(path)


def _numbered(folder: Path) -> set[Path]:
    """Images that are named as an export names them."""
    return {path for path in folder.glob("*") if NUMBERED.fullmatch(path.name)}


def as_text(value: Any) -> str:
    """A value as metadata of a file: text unchanged, all else as JSON."""
    return value if isinstance(value, str) else json.dumps(value)


def _reason(error: OSError) -> str:
    number = re.search(r"errno (\d+)\]", str(error))  # Arrow's errors have it in words alone
    return (os.strerror(int(number[1])) if number else error.strerror or str(error)).lower()
