"""Supported sources: bags (ROS 1, ROS 2, MCAP) and tables (CSV, Parquet), message by message, never whole.

Compressed parts of bags are unpacked no further than `check_size` allows: rosbags' own functions have no bound. It
refuses MCAPs without the profile ros2, and with a schema that is not of ROS: here both are read."""

import bz2
import contextlib
import csv
import heapq
import io
import itertools
import json
import operator
import re
import struct
import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path, PurePath
from types import SimpleNamespace
from typing import Any, BinaryIO, Protocol

import pyarrow as pa

from deformscope.errors import InputError
from deformscope.file_io import check_size, nearest_file, utf8_path
from deformscope.files.sources import natural_key
from deformscope.files.table_file import COLUMN_BYTES, TEXTS, TableForm, form_of, moment_ns, open_table, unique_names
from deformscope.recording.export.manifest import ExportedStream, Manifest, read_manifest

BAGS = (".bag", ".mcap", ".db3")
SHEETS = (".xls", ".xlsx")
TABLES = (*TEXTS, ".parquet", *SHEETS)
FILES = (".png", ".tif", ".tiff", ".jpg", ".pcd", ".ply")
TABLE_TYPES = ("csv", "parquet")
BATCH_ROWS = 64
"""Rows that are read together: a column's text, however long, comes once with each."""
RATIO = 100
"""A column's values are larger than its bytes by more only where few bytes stand for many."""
SEGMENT = re.compile(rb"^# (columns|units|springConstant): +(.*\S)", re.MULTILINE)
PACKAGE = "deformscope_msgs/msg/"
"""Package of the messages in deformscope's own exports."""
MAGIC = b"\x89MCAP0\r\n"


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Within it rosbags unpacks with the functions of this module, and reads MCAPs of any profile."""
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap as mcap

    plain: Any = vars(ros2)["zstd"]
    lz4, zstd = _unpack(LZ4FrameDecompressor), _unpack(plain.ZstdDecompressor)
    plain_sized, plain_bytes, plain_definition = mcap.read_sized, mcap.read_bytes, mcap.get_msgdef

    def read_sized(file: Any) -> bytes:
        is_header = not isinstance(file, io.BytesIO) and file.tell() == len(MAGIC) + 1
        found = plain_sized(file)
        return struct.pack("<I4s", 4, b"ros2") if is_header else found

    def definition(schema: Any) -> MessageDefinition:
        if schema is None or schema.encoding in ("ros2msg", "ros2idl", "omgidl", ""):
            return plain_definition(schema)
        of_ros1 = schema.encoding == "ros1msg"
        return MessageDefinition(MessageDefinitionFormat.MSG if of_ros1 else MessageDefinitionFormat.NONE, schema.data)

    own = {"read_sized": read_sized, "get_msgdef": definition}
    own |= {"read_string": lambda file: plain_bytes(file).decode(errors="replace")}  # a schema of protobuf is no text
    tables: list[tuple[Any, dict[str, Any]]] = [
        (ros1.decompressors, {"bz2": _unpack(bz2.BZ2Decompressor), "lz4": lz4}),
        (mcap.DECOMPRESSORS, {"lz4": lz4, "zstd": zstd}),
        (vars(mcap), own),
        (vars(ros2), {"zstd": SimpleNamespace(decompress=zstd, open=plain.open)}),
    ]
    with contextlib.ExitStack() as kept:
        for table, own in tables:
            kept.callback(table.update, {name: table[name] for name in own})
            table.update(own)
        yield


def _unpack(make: Callable[[], Any]) -> Callable[..., bytes]:
    """A function that unpacks frames, one after the other. make: makes the decompressor of a frame"""

    def unpack(data: bytes, declared_bytes: int = 0) -> bytes:
        most, found = check_size("a compressed part", declared_bytes), b""
        while data:
            frame = make()
            found += frame.decompress(data, most + 1 - len(found))
            check_size("a compressed part", len(found))
            if not frame.eof:
                raise ValueError("a compressed part that ends early")
            data = frame.unused_data or b""
        return found

    return unpack


def check_chunks(storage: Any, where: object) -> None:
    """Raises InputError where chunks of one time are too large together: rosbags unpacks all those of an MCAP whose
    times overlap. An MCAP without an index of messages is read chunk by chunk: rosbags would find none in it."""
    found = [each.chunks for each in getattr(storage, "storages", [storage]) if hasattr(each, "chunks")]
    for chunks in found:
        if not any(one.channel_count for one in chunks):
            chunks.clear()
    begins = [(one.message_start_time, one.uncompressed_size) for chunks in found for one in chunks]
    ends = [(one.message_end_time + 1, -one.uncompressed_size) for chunks in found for one in chunks]
    for size in itertools.accumulate(change for _, change in sorted(begins + ends)):
        check_size("chunks of one time, together", size, where)


@dataclass(frozen=True, slots=True)
class Topic:
    """Content of a source under a name. type: type of its messages, `csv` or `parquet`; count: messages, or None

    units: units of fields, or empty; kind: for an export of deformscope, the class of the rows; form: how a table is
    written, in words; cut: its last line, if that was cut off and is left out; spring_n_per_m: stiffness of an AFM's
    cantilever that it states, or 0"""

    name: str
    type: str
    count: int | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    kind: str = ""
    form: str = ""
    cut: str = ""
    spring_n_per_m: float = 0.0


@dataclass(frozen=True)
class Message:
    """log_ns: when it was recorded [ns], 0 = not known; content: the content as read; decode: makes the value from the
    content, None = the content is the value"""

    topic: str
    log_ns: int
    content: Any
    decode: Callable[[Any], Any] | None = None

    @cached_property
    def value(self) -> Any:
        """The decoded value, with fields as attributes or as items of a mapping. Raises InputError."""
        return self.content if self.decode is None else self.decode(self.content)

    def get(self, name: str) -> Any:
        """A field's value, or that of a.b within one, or of a part (`wrench[0]`) of a list; of a list of messages, a
        tuple of each one's. Raises KeyError without such a field, IndexError for a part beyond its end."""
        base, parts = list_parts(name)
        if isinstance(self.value, Mapping):
            if name in self.value:
                return self.value[name]
            found = self.value[base]
        else:
            found = self.value
            for part in base.split("."):
                of_list = isinstance(found, list) and len(found) > 0
                if not hasattr(found[0] if of_list else found, part):
                    raise KeyError(name)
                found = tuple(getattr(one, part) for one in found) if of_list else getattr(found, part)
        found = json.loads(found) if parts and isinstance(found, str) and found.startswith("[") else found
        for at in parts:
            if at >= len(found):
                raise IndexError(f"{name}: {base} has {len(found)} parts, from [0] on")
            found = found[at]
        return found


def list_parts(name: str) -> tuple[str, list[int]]:
    """The field of a part of a list, and the part's places: `T[3][0]` is of T."""
    found = re.fullmatch(r"(.+?)((?:\[\d{1,6}\])+)", name, re.ASCII | re.DOTALL)
    return (found[1], [int(one) for one in found[2][1:-1].split("][")]) if found else (name, [])


class Reader(Protocol):
    """An open source. about: the description in an export of deformscope"""

    @property
    def about(self) -> Manifest: ...

    @property
    def topics(self) -> dict[str, Topic]: ...

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of these topics in the order of recording; those of tables one table after the other."""


@contextlib.contextmanager
def open_reader(path: Path, skip_rows: int = 0, times: Collection[str] = ()) -> Iterator[Reader]:
    """Open a source. times: columns with the times. Raises InputError for unreadable sources."""
    try:
        next(path.iterdir(), None) if path.is_dir() else path.open("rb").close()
    except FileNotFoundError:
        raise InputError("a bag, a table, or a folder of them", "nothing there", nearest_file(path), path) from None
    except OSError as error:
        raise InputError("a readable source", (error.strerror or "").lower(), where=path) from error
    suffix = path.suffix.lower()
    others = {one.suffix.lower() for one in path.iterdir()} & {*TABLES, *FILES} if path.is_dir() else {path}
    if suffix in BAGS or (path / "metadata.yaml").is_file():
        with _opened_bag(path, [path]) as reader:
            yield reader
    elif not others and (parts := _parts(path)):
        with _opened_bag(path, parts) as reader:
            yield reader
    else:
        yield FolderReader(path, skip_rows, times)


@contextlib.contextmanager
def _opened_bag(path: Path, files: Sequence[Path]) -> Iterator[Reader]:
    """files: the parts of a folder without metadata.yaml, or the path"""
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError:
        missing = "pip install 'deformscope[import]'"
        raise InputError("the package rosbags", "none", missing) from None

    def opened(one: Path) -> Any:
        reader = Reader1(one) if one.suffix == ".bag" else Reader2(one)
        reader.open()
        kept.callback(reader.close)
        return reader

    with bounded(), contextlib.ExitStack() as kept:
        try:
            try:
                readers = [opened(one) for one in files]
            except Exception as error:
                if not path.is_dir() or "Serialization format" not in str(error):
                    raise
                readers = [opened(one) for one in _parts(path)]  # beside topics of ROS others, which rosbags refuses
        except Exception as error:  # rosbags and what it reads with have errors of many kinds
            raise _unreadable(path, error) from error
        for one in readers:
            check_chunks(getattr(one, "storage", None), path)
        yield BagReader(path, readers)


def _parts(path: Path) -> list[Path]:
    """The bags of a folder, in their order."""
    found = [one for one in path.iterdir() if one.suffix in BAGS] if path.is_dir() else []
    return sorted(found, key=natural_key)


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, InputError):  # of `bounded`
        return InputError.about(error, path)
    came = "one that is truncated or damaged, or not of ROS: " + (
        " ".join(str(error).split())[:160] or type(error).__name__
    )
    return InputError("a complete bag", came, "mcap recover, or rosbag reindex", path)


class BagReader:
    """A bag, by rosbags. readers: readers of its files. Each connection has its own types: one that cannot be read
    keeps no other from being read."""

    def __init__(self, path: Path, readers: Sequence[Any]) -> None:
        self._path, self._readers = path, readers
        self._decoders: dict[int, Callable[[bytes], Any]] = {}
        self.about = _metadata(path) if path.suffix == ".mcap" else Manifest()

    @cached_property
    def topics(self) -> dict[str, Topic]:
        found: dict[str, Topic] = {}
        for one in itertools.chain(*(reader.connections for reader in self._readers)):
            before, of = found[one.topic].count if one.topic in found else 0, _ros_type(one)
            kind = of.removeprefix(PACKAGE).rstrip("0123456789") if of.startswith(PACKAGE) else ""
            found[one.topic] = Topic(one.topic, of, (before or 0) + one.msgcount, kind=kind)
        return found

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        wanted = [[one for one in reader.connections if one.topic in topics] for reader in self._readers]
        read = [reader.messages(connections=of) for reader, of in zip(self._readers, wanted, strict=True) if of]
        try:
            for connection, log_ns, raw in heapq.merge(*read, key=operator.itemgetter(1)):
                yield Message(connection.topic, log_ns, raw, partial(self._decode, connection))
        except Exception as error:  # as above
            raise _unreadable(self._path, error) from error

    def _decode(self, connection: Any, raw: bytes) -> Any:
        of, hint = _ros_type(connection), "leave its topic out of the map"
        if id(connection) not in self._decoders:
            encoding = _encoding(connection)
            if encoding not in ("cdr", "ros1"):
                raise InputError(f"messages of ROS in {connection.topic}", of, hint, self._path)
            try:
                store = _typestore(connection, of)
            except Exception as error:
                came = f"{of}: {' '.join(str(error).split())[:120]}"
                raise InputError("messages of a known type", came, hint, self._path) from error
            self._decoders[id(connection)] = partial(
                lambda raw, decode, of: decode(raw, of),
                decode=store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr,
                of=of,
            )
        try:
            return self._decoders[id(connection)](raw)
        except KeyError as error:
            raise InputError("messages of a known type", of, hint, self._path) from error
        except Exception as error:  # as above
            raise _unreadable(self._path, error) from error


def _encoding(connection: Any) -> str:
    return str(getattr(connection.ext, "serialization_format", "ros1"))


def _ros_type(connection: Any) -> str:
    """Type of its messages, as ROS 2 spells it; with their encoding, if that is not of ROS."""
    if (encoding := _encoding(connection)) not in ("cdr", "ros1"):
        return f"{connection.msgtype} ({encoding})"
    return (
        re.sub(r"(\w+)/(\w+)", r"\1/msg/\2", connection.msgtype)
        if connection.msgtype.count("/") == 1
        else str(connection.msgtype)
    )


def _typestore(connection: Any, of: str) -> Any:
    """The types of its definition, or of ROS 2 where a bag has none."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    definition = connection.msgdef
    if definition.format == MessageDefinitionFormat.NONE:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    if definition.format == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definition.data, of))
        return store
    line = "=" * 80 + "\n"  # between the parts of a definition by rosbag2, which begin with their names
    parts = definition.data.split(line)[1:] if definition.data.startswith(f"{line}IDL: ") else ["\n" + definition.data]
    types: dict[str, Any] = {}
    for part in parts:
        types |= get_types_from_idl(part.partition("\n")[2])
    store.register(types)
    return store


def _metadata(path: Path) -> Manifest:
    """Description in an export of ours; empty without the package or the description."""
    try:
        from mcap.reader import SeekingReader
    except ImportError:
        return Manifest()
    with path.open("rb") as file:
        try:
            reader = SeekingReader(file, record_size_limit=check_size("", 0))
            found = reader.iter_metadata() if reader.get_summary() else ()  # without it, it would unpack every chunk
            said = next((one.metadata for one in found if one.name == "deformscope"), {})
            about = {name: json.loads(value) for name, value in said.items()}
        except Exception as error:
            raise _unreadable(path, error) from error
    return read_manifest(about, path)


def _sheets(path: Path) -> dict[str, bytes]:
    """The sheets of a workbook by name, as text between tabs. Raises InputError."""
    try:
        from python_calamine import CalamineWorkbook
    except ImportError:
        raise InputError("the package python-calamine", "none", "pip install 'deformscope[excel]'") from None
    try:
        unpacked = sum(one.file_size for one in zipfile.ZipFile(path).infolist()) if zipfile.is_zipfile(path) else 0
        check_size("a workbook", max(unpacked, path.stat().st_size), path)
        book, found = CalamineWorkbook.from_path(path), {}
        for name in book.sheet_names:
            rows = book.get_sheet_by_name(name).to_python()
            rows = [[one.strip() if isinstance(one, str) else one for one in row] for row in rows]
            csv.writer(text := io.StringIO(), "excel-tab").writerows(rows)
            found[name] = text.getvalue().encode()
    except InputError:
        raise
    except Exception as error:  # calamine has errors of many kinds
        came = " ".join(str(error).split())[:160]
        raise InputError("a workbook without a password", came, "its sheets as .csv", path) from error
    return found


def _segments(path: Path) -> tuple[bytes, float]:
    """A force curve that an AFM's software (JPK) exported, whose segments have a header each, as one table, and the
    cantilever's stiffness [N/m]; nothing for other texts. Raises InputError."""
    with path.open("rb") as file:
        if b"\n# columns: " not in file.read(BATCH_ROWS << 10):
            return b"", 0.0
    check_size("a force curve", path.stat().st_size, path)
    raw, said = path.read_bytes(), dict[bytes, list[bytes]]()
    for name, value in SEGMENT.findall(raw):
        said.setdefault(name, []).append(value)
    if len({*said[b"columns"]}) > 1:
        came = b", or ".join(dict.fromkeys(said[b"columns"])).decode(errors="replace")
        raise InputError("segments of the same columns", came, "an export of one segment", path)
    rows = (line for line in raw.splitlines() if line.strip() and not line.startswith(b"#"))
    spring = said.get(b"springConstant", [b"0"])[-1]
    return b"\n".join([said[b"columns"][0], *said.get(b"units", [])[:1], *rows, b""]), float(spring)


class FolderReader:
    """Topics of a folder: tables, named by their paths in it, the sheets of workbooks (`BOOK.xlsx/SHEET`), and files of
    images or points, one frame each, by their folder and ending: such a topic is a pattern (`depth/*.png`). path: path
    of the folder, or of one table"""

    def __init__(self, path: Path, skip_rows: int, times: Collection[str]) -> None:
        self.path, self._skip_rows, self._times = path, skip_rows, times
        self._tables: dict[str, Path] = {}
        self._texts: dict[str, bytes] = {}
        self._springs: dict[str, float] = {}
        self._files: dict[str, list[Path]] = {}
        self._forms: dict[str, TableForm] = {}
        for one in sorted(sorted(path.rglob("*")), key=natural_key) if path.is_dir() else [path]:
            place, suffix = one.relative_to(path if path.is_dir() else path.parent), one.suffix.lower()
            if suffix in SHEETS and one.is_file():
                self._texts |= (sheets := {f"{_name(place)}/{name}": text for name, text in _sheets(one).items()})
                self._tables |= dict.fromkeys(sheets, one)
            elif suffix in TABLES:
                self._tables[_name(place)] = one
                text, spring = _segments(one) if suffix == ".txt" and one.is_file() else (b"", 0.0)
                self._texts |= {_name(place): text} if text else {}
                self._springs[_name(place)] = spring
            elif suffix in FILES and one.is_file():
                self._files.setdefault(_name(place.parent / f"*{one.suffix}"), []).append(one)
        if self._files:  # texts beside images are their times
            self._tables = {name: one for name, one in self._tables.items() if one.suffix.lower() != ".txt"}
        if not self._tables and not self._files:
            known, came = ", ".join((*BAGS, *TABLES, *FILES)), repr(path.suffix or path.name)
            came = "a folder without one" if path.is_dir() else came
            raise InputError(f"a bag, tables or images ({known})", came, where=path)
        self.about = _manifest(path / "export.json")

    @cached_property
    def topics(self) -> dict[str, Topic]:
        found = {name: Topic(name, "files", len(files)) for name, files in self._files.items()}
        for name, path in self._tables.items():
            try:
                with self._opened(name) as (schema, count, _):
                    metadata = schema.metadata or {}
                    units = {one.name: (one.metadata or {}).get(b"unit", b"").decode() for one in schema}
                    units |= {one.name: "ns" for one in schema if _has_ns(one.type)}
                    own = self._own(name)
                    units |= {one.name: one.unit for one in own.columns if one.name in units}
                    kinds = metadata.get(b"deformscope.kinds", b"").decode().split() or [own.kind]
            except InputError:
                if not self._files:
                    raise
                continue
            form, is_text = self._forms.get(name), path.suffix.lower() != ".parquet"
            is_doubtful = form is not None and not own.columns and not form.is_likely
            if is_doubtful and (self._files or (path.suffix in (".txt", *SHEETS) and len(self._tables) > 1)):
                continue  # notes
            if form is not None and not own.columns:
                units |= dict(form.units) | dict.fromkeys(form.moments, "ns")
            words = "" if form is None or own.columns else form.to_text()
            cut = "" if form is None else form.cut
            of, spring = "csv" if is_text else "parquet", self._springs.get(name, 0.0)
            found[name] = Topic(name, of, count, units, kinds[-1], words, cut, spring)
        return found

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        for name in topics:
            for path in self._files.get(name, ()):
                yield Message(name, 0, path)
            if name in self._tables:
                with self._opened(name) as (_, _, batches):
                    moments = self._forms[name].moments if name in self._forms else ()
                    for batch in batches:
                        times = _in_ns(batch, moments)
                        for at in range(0, len(times), BATCH_ROWS):
                            for row in times.slice(at, BATCH_ROWS).to_pylist():
                                yield Message(name, 0, row)

    def _own(self, name: str) -> ExportedStream:
        """Description of a table in an export's manifest; empty for others."""
        return next((one for one in self.about.streams if name in one.files), ExportedStream())

    def _types(self, name: str, form: TableForm) -> dict[str, pa.DataType]:
        """Types of a CSV's columns, whose first rows may be whole numbers though a fraction follows below."""
        if own := self._own(name).columns:
            said = {one.name: one.type for one in own if one.type in ("double", "int64")}
            return {one: pa.type_for_alias(said[one]) for one in form.names if one in said}
        exact = form.whole & {*self._times}
        return dict.fromkeys(form.numbers - exact, pa.float64()) | dict.fromkeys(form.moments, pa.string())

    @contextlib.contextmanager
    def _opened(self, name: str) -> Iterator[tuple[pa.Schema, int | None, Iterator[pa.RecordBatch]]]:
        from pyarrow import parquet

        path = utf8_path(self._tables[name])
        try:
            if path.suffix.lower() == ".parquet":
                with parquet.ParquetFile(path) as file:
                    rows, names = _batch_rows(file.metadata, self._tables[name]), unique_names(file.schema_arrow.names)
                    schema = pa.schema(
                        [one.with_name(name) for one, name in zip(file.schema_arrow, names, strict=True)],
                        file.schema_arrow.metadata,
                    )
                    yield schema, file.metadata.num_rows, (one.rename_columns(names) for one in file.iter_batches(rows))
                return
            raw: BinaryIO = io.BytesIO(self._texts[name]) if name in self._texts else path.open("rb")
            with raw as text:
                if name not in self._forms:
                    is_own = bool(self._own(name).columns)
                    self._forms[name] = form_of(text, self._skip_rows, self._tables[name], is_own=is_own)
                form = self._forms[name]
                with open_table(text, form, self._types(name, form)) as rows:
                    yield rows.schema, None, iter(rows)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._unreadable(name, error) from error

    def _unreadable(self, name: str, error: Exception) -> InputError:
        """What is wrong with a table, with the name of the column."""
        came, form = " ".join(str(error).split())[:160], self._forms.get(name)
        if form is not None and (at := re.search(r"CSV column #(\d+)", came)):
            column, form_names = int(at[1]), form.names
            came = came.replace(at[0], form_names[column] if column < len(form_names) else at[0])
            came = came.replace("CSV conversion error to double: invalid value", "no number:")
        is_row = "CSV" in str(error)
        hint = "the table without that row, or a part of it" if is_row else ""
        return InputError("a readable table", came, hint, self._tables[name])


def _name(place: PurePath) -> str:
    """Name of a topic, in a form that a map in UTF-8 can hold."""
    return place.as_posix().encode(errors="backslashreplace").decode()


def _manifest(path: Path) -> Manifest:
    """Description in an export of ours; empty if the file is another's."""
    try:
        found = json.loads(path.read_bytes())
    except RecursionError as error:
        came = "one nested too deeply"
        raise InputError("a description of an export", came, "the folder without it, or a new export", path) from error
    except (OSError, ValueError):
        found = {}
    return read_manifest(found, path)


def _batch_rows(about: Any, path: Path) -> int:
    """Rows of a Parquet file that are read together. Raises InputError for a file that a few bytes make large."""
    most = check_size(f"a table, of {about.num_columns} columns,", about.num_columns * COLUMN_BYTES, path)
    longest = 1
    for group in map(about.row_group, range(about.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            values = column.num_values if column.num_values > group.num_rows else 0  # of lists
            size = max(column.total_uncompressed_size, 8 * values)
            if size > RATIO * column.total_compressed_size:
                check_size(f"column {column.path_in_schema}", size, path)
            longest = max(longest, size if column.physical_type.endswith("BYTE_ARRAY") else 1)
    return min(BATCH_ROWS, most // longest + 1)


def _has_ns(kind: pa.DataType) -> bool:
    return bool(pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or pa.types.is_time(kind))


def _in_ns(batch: pa.RecordBatch, moments: Collection[str]) -> pa.RecordBatch:
    """Its times as whole numbers [ns]. moments: columns of times as text"""
    for at, one in enumerate(batch.schema):
        if _has_ns(one.type):
            kind = pa.time64("ns") if pa.types.is_time(one.type) else pa.duration("ns")
            kind = pa.timestamp("ns", one.type.tz) if pa.types.is_timestamp(one.type) else kind
            batch = batch.set_column(at, one.name, batch.column(at).cast(kind).cast(pa.int64()))
        elif one.name in moments:
            texts = batch.column(at).to_pylist()
            batch = batch.set_column(at, one.name, pa.array([moment_ns(text) if text else None for text in texts]))
    return batch
