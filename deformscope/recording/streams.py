"""A recording as tables: its streams, each as batches of rows in order of time, names and units as in the JSON.

A column's unit is in its name and in its metadata (`unit`). Vectors are separate columns (`force_x_n`), the two ends of
an interval `NAME_low` and `NAME_high`; values without a fixed length are a list, with the shape of an array as another.
"""

import dataclasses
import json
import logging
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from deformscope.arrays import IntArray
from deformscope.errors import InputError
from deformscope.frames import StageResult, Stream
from deformscope.recording.export.manifest import SCHEMA_VERSION
from deformscope.recording.items import KINDS as STAGE_KINDS
from deformscope.recording.items import VALUES
from deformscope.recording.reader import Replay, Starts, entity_parts, objects_of
from deformscope.results.render import quantities, to_json
from deformscope.rows import ENTITIES, FRAMES, IMAGES, OF_DEVICES, SERIES, SHAPE, field_of, from_components, from_json
from deformscope.stages.fit.estimate import Estimate
from deformscope.stages.fit.particle_frame import ParticleFrame
from deformscope.stages.map.exploration import MapEstimate
from deformscope.stages.map.perception import ForcePose
from deformscope.stages.materials.axis_estimate import AxisEstimate
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.recovery import RecoveryEstimate
from deformscope.stages.materials.yield_estimate import YieldEstimate
from deformscope_drivers.health import Health

if TYPE_CHECKING:
    from rerun.chunk import Chunk

UNITS = {
    "m": "m",
    "m2": "m^2",
    "mm": "mm",
    "cm": "cm",
    "px": "px",
    "pa": "Pa",
    "kpa": "kPa",
    "n": "N",
    "nm": "N m",
    "s": "s",
    "ms": "ms",
    "ns": "ns",
    "hz": "Hz",
    "deg": "deg",
    "rad": "rad",
    "c": "deg C",
    "ppm": "ppm",
    "j": "J",
    "deg_s": "deg/s",
    "m_s": "m/s",
    "mm_s": "mm/s",
    "n_per_mm": "N/mm",
    "n_per_m": "N/m",
    "n_per_s": "N/s",
    "m_per_n": "m/N",
    "bytes": "bytes",
    "ticks": "ticks of the device's clock",
    "counts": "counts of the device",
}
"""Units by the end of a column's name."""
CARTESIAN = ("x", "y", "z")
XYZ = {"force_n", "torque_nm", "position_m", "rotation_rad", "xyz_m", "normal", "tare_n", "xy_m"}
"""Vectors along x, y, z; a sensor of several channels has one each."""
POSE_COLUMNS = (
    *(f"force_{axis}_n" for axis in CARTESIAN),
    *(f"position_{axis}_m" for axis in CARTESIAN),
    *(f"rotation_{axis}_rad" for axis in CARTESIAN),
)
"""Columns of `ForcePose`; the rotation is a vector."""
TRANSFORMS = "transforms"
TRANSFORM_COLUMNS = (*(f"{axis}_m" for axis in CARTESIAN), "qx", "qy", "qz", "qw")
MOST_COLUMNS = 24
"""Most values of a frame's array with a column for each; a longer array is a list."""
BATCH_ROWS, BATCH_BYTES = 1 << 16, 4 << 20
"""Rows and bytes that are gathered before they are written."""
KEPT_TEXT = {
    *("verdict", "beta_verdict", "stiffness_verdict", "stage", "name", "parameter", "about", "link", "unit"),
    *("gain_unit", "modality", "labels", "state", "parent_frame", "child_frame"),
}
"""Text of the program itself: all other text may name a person, a machine or a path, and an anonymous export leaves it
out."""
PRIVATE = {"raw", "input"}
"""Entities that an anonymous export leaves out: raw bytes contain a device's own information, such as its serial
number."""

_MATERIALS = (AxisEstimate, FieldEstimate, RecoveryEstimate, YieldEstimate)
_KINDS: dict[str, type] = {
    one.__name__: one
    for one in (
        *OF_DEVICES,
        *ENTITIES,
        *STAGE_KINDS,
        *_MATERIALS,
        StageResult,
        Estimate,
        ParticleFrame,
        Health,
        ForcePose,
    )
}
_SHOWN = {shown: name for name, shown in IMAGES.items()}
_SERIES = {"host_ns": "ForcePose:host_ns", VALUES: "ForcePose:values"}
_TRANSFORM = re.compile(r"Transform3D:(parent_frame|child_frame|translation|quaternion|mat3x3)")
_SCALARS = {"bool": pa.bool_(), "int": pa.int64(), "float": pa.float64(), "str": pa.string()}
_ROW, _SESSION = "rerun.controls.RowId", "session"
_logger = logging.getLogger(__name__)


@dataclass(slots=True)
class RecordedStream:
    """One stream. entity: its place in the recording; kinds: kinds of what each row holds; about: the device, or None
    schema: schema of its batches; rows: how many there are, those that were recorded in part included
    until_ns: time of the last row since the recording's start [ns]; paths: paths of the entities, in rerun's spelling
    words: columns that an anonymous export leaves out"""

    entity: str
    kinds: tuple[type, ...] = ()
    about: Stream | None = None
    schema: pa.Schema = field(default_factory=lambda: pa.schema([]))
    rows: int = 0
    until_ns: int = 0
    paths: set[str] = field(default_factory=set)
    words: tuple[str, ...] = ()
    _types: dict[str, pa.DataType] = field(default_factory=dict)
    _widths: dict[str, set[int]] = field(default_factory=dict)
    _extra: dict[str, set[str]] = field(default_factory=dict)
    _starts: list[tuple[int, str]] = field(default_factory=list)

    @property
    def rate_hz(self) -> float:
        """Mean number of rows a second; 0 with a single row."""
        span_ns = self.until_ns - min(self._starts)[0]
        return 1e9 * (self.rows - 1) / span_ns if span_ns else 0.0

    @property
    def device(self) -> str:
        """Name of the device, or empty."""
        first, _, rest = self.entity.partition("/")
        return rest if first in (*OF_DEVICES.values(), "health") else ""

    def see(self, chunk: "Chunk", raw: pa.Table) -> None:
        """Note the columns of a portion."""
        self.rows += raw.num_rows
        self.paths.add(chunk.entity_path)
        first_ns, last_ns = pc.min_max(raw.column(_SESSION)).as_py().values()
        self.until_ns = max(self.until_ns, last_ns or 0)
        self._starts.append((first_ns or 0, str(chunk.id)))
        for name in raw.schema.names:
            kind = raw.schema.field(name).type
            if name in self._types and self._types[name] != kind:
                kind = _common(self._types[name], kind)
            self._types[name] = kind
            if pa.types.is_list(kind):
                self._widths.setdefault(name, set()).update(np.unique(_lengths(raw.column(name))).tolist())
        for key, values in self._reported(raw).items():
            self._extra.setdefault(key, set()).update(map(_shape_of, values))

    def _reported(self, raw: pa.Table) -> dict[str, list[Any]]:
        """What the JSON has of each result that is not a recorded field by another name."""
        kind = self.kinds[-1] if self.kinds else type(None)
        if not dataclasses.is_dataclass(kind) or not quantities(kind):
            return {}
        found: dict[str, list[Any]] = {}
        renamed = {key for name, key in _renamed(kind).items() if f"{kind.__name__}:{name}" in self._types}
        cells = [cells for part in raw.to_batches() for cells in objects_of(part, kind)]
        for at, one in enumerate(cells):
            try:
                result = from_components(cast("type[Any]", kind), one)
                given = to_json(result)
            except (KeyError, TypeError):  # recorded in part, or before a field was
                continue
            if isinstance(result, MapEstimate):
                given["regions"] = [to_json(region) for region in result.regions]
            for group, value in given.items():
                inner = value.items() if isinstance(value, dict) else ()
                every = [(f"{group}_{key}", each) for key, each in inner] or [(group, value)]
                for key, each in every:
                    if key not in renamed:
                        found.setdefault(key, [None] * len(cells))[at] = each
        return found

    def arrange(self, offset_ns: int | None, anonymous: bool) -> None:
        """Settle the schema. offset_ns: host time at which `session` is 0, if known"""
        places = [pa.field("session_ns", pa.int64()), pa.field("host_ns", pa.int64())]
        none = pa.Table.from_batches([], pa.schema(list(self._types.items())))
        fields = {one.name: one for one in places}
        own = self._own(none)
        fields |= {name: pa.field(name, array.type) for name, array in own.items()}
        fields |= {name: one for name, one in self._extra_fields().items() if name not in fields}
        if offset_ns is None and "host_ns" not in own:
            del fields["host_ns"]
        text = (pa.string(), pa.list_(pa.string()))
        self.words = tuple(name for name, one in fields.items() if one.type in text and name not in KEPT_TEXT)
        if anonymous:
            fields = {name: one for name, one in fields.items() if name not in self.words}
        said = {one.key: one.unit for kind in self.kinds for one in quantities(kind) if one.key and one.unit}
        units = {name: {"unit": unit} for name in fields if (unit := unit_of(name, said))}
        known = [one.with_metadata(units[name]) if name in units else one for name, one in fields.items()]
        about = {"schema_version": str(SCHEMA_VERSION), "entity": self.entity}
        about |= {"kinds": " ".join(kind.__name__ for kind in self.kinds)}
        self.schema = pa.schema(known, {f"deformscope.{key}": value for key, value in about.items()})

    def convert(self, raw: pa.Table, offset_ns: int | None) -> pa.RecordBatch:
        """Rows in the form of the schema."""
        found = {"session_ns": raw.column(_SESSION).combine_chunks(), **self._own(raw)}
        if "host_ns" not in found and offset_ns is not None:
            found["host_ns"] = pc.add(found["session_ns"], offset_ns)
        for key, values in self._reported(raw).items():
            found = _arrays_of(key, values, self._extra[key]) | found
        arrays = [
            _cast(found[one.name], one.type) if one.name in found else pa.nulls(raw.num_rows, one.type)
            for one in self.schema
        ]
        return pa.RecordBatch.from_arrays(arrays, schema=self.schema)

    def _extra_fields(self) -> dict[str, pa.Field]:
        found = {key: _arrays_of(key, [], shapes) for key, shapes in self._extra.items()}
        return {name: pa.field(name, array.type) for arrays in found.values() for name, array in arrays.items()}

    def _own(self, raw: pa.Table) -> dict[str, pa.Array]:
        """Recorded fields as columns."""
        found: dict[str, pa.Array] = {}
        names = sorted(raw.schema.names, key=lambda name: not re.search(r":(stamp|event)\.|^\w+$", name))
        index = "index" if "index" in self._types else "frame"
        for name in names:
            column = raw.column(name).combine_chunks()
            if name in (_ROW, _SESSION):
                continue
            if ":" not in name:
                found["index" if name == index and set(self.kinds) & set(FRAMES) else name] = column
                continue
            owner, _, component = name.partition(":")
            if owner == "Transform3D":
                found |= _transform(component, column)
                continue
            kind = _KINDS[owner]
            if component.endswith(SHAPE) and self._is_flattened(name.removesuffix(SHAPE), kind):
                continue
            plain = component.removeprefix("stamp.").removeprefix("event.").replace(".", "_")
            found |= self._columns(name, _renamed(kind).get(component, plain), kind, component, column)
        for name in TRANSFORM_COLUMNS[3:]:
            if (matrix := found.pop(f"m{name}", None)) is not None:
                found[name] = pc.coalesce(found[name], matrix) if name in found else matrix
        return found

    def _columns(self, name: str, column: str, kind: type, component: str, cells: pa.Array) -> dict[str, pa.Array]:
        of = field_of(kind, component)
        widths = self._widths.get(name, set()) - {0}
        if of is None or kind is ForcePose:  # a shape, or a series
            ones = widths == {1}
            axes = POSE_COLUMNS if component == "values" else [column] if ones and component == "host_ns" else []
            return _vector(cells, axes) if axes else {column: cells}
        if of.form in ("value", "json"):
            return _vector(cells, [column])
        if of.form in ("bytes", "image"):
            return {column: _binary(cells)}
        ends, vector = of.form == "tuple" and "interval" in column, of.form == "array" and column in XYZ
        if self._is_flattened(name, kind) or (ends and widths == {2}) or (vector and widths == {3}):
            return _vector(cells, _axes(column, *widths))
        return {column: cells}

    def _is_flattened(self, name: str, kind: type) -> bool:
        """Whether an array of a frame has a column for each value."""
        widths = self._widths.get(name, set()) - {0}
        return kind in FRAMES and len(widths) == 1 and max(widths) <= MOST_COLUMNS


class RecordingTables:
    """The streams of a recording. anonymous: leave out whatever may name a person, a machine or a path"""

    def __init__(self, replay: Replay, *, anonymous: bool = False) -> None:
        self._replay, self.anonymous = replay, anonymous

    @property
    def settings(self) -> Mapping[str, Any]:
        """All settings that determined the recorded results; empty if there are none."""
        return self._replay.settings if "settings" in self._replay.properties else {}

    @cached_property
    def streams(self) -> dict[str, RecordedStream]:
        """By entity."""
        return self._found[0]

    @cached_property
    def start_ns(self) -> int | None:
        """Host time at which `session` is 0 [ns]; None if unknown."""
        return self._found[1]

    @cached_property
    def _found(self) -> tuple[dict[str, RecordedStream], int | None]:
        found: dict[str, RecordedStream] = {}
        about: dict[str, Stream] = {}
        offsets: list[int] = []
        for chunk in self._replay.chunks("/**"):
            entity = "/".join(entity_parts(chunk.entity_path))
            batch = chunk.to_record_batch()
            if chunk.is_static and "stream" in batch.schema.names:
                about[entity] = from_json(Stream, batch.column("stream")[0].as_py()[0])
            named = _named(chunk.entity_path, chunk.is_static, batch.schema.names)
            if not named or (self.anonymous and entity.split("/")[0] in PRIVATE):
                continue
            raw = _raw(batch, named)
            at = _stream_of(chunk.entity_path, named)
            stream = found.setdefault(at, RecordedStream(at))
            kinds = dict.fromkeys([*stream.kinds, *_kinds_of(raw.schema.names)])
            stream.kinds = tuple(sorted(kinds, key=lambda kind: kind is not StageResult))
            stream.see(chunk, raw)
            stamps = [name for name in raw.schema.names if name.endswith(":stamp.host_ns")]
            if not offsets and stamps and (stamp := raw.column(stamps[0])[0].as_py()):
                offsets.append(stamp[0] - raw.column(_SESSION)[0].as_py())
        offset = offsets[0] if offsets else None
        for entity, stream in found.items():
            stream.about = about.get(entity)
            stream.arrange(offset, self.anonymous)
        return dict(sorted(found.items())), offset

    def left_out(self) -> dict[str, str]:
        """Parts of the streams that an anonymous export leaves out, by entity and column, and information on devices,
        which no export has."""
        found: dict[str, str] = {}
        for entity, stream in self.streams.items():
            if entity.split("/")[0] in PRIVATE:
                found[entity] = f"raw bytes, {stream.rows} rows"
            else:
                found |= {f"{entity} {name}": f"words, {stream.rows} rows" for name in stream.words}
            known = stream.about
            said = {} if known is None else {"serial": known.serial, "firmware": known.firmware, "urdf": known.urdf}
            found |= {f"{entity} {name}": str(value) for name, value in said.items() if value}
        return found

    def select(self, names: Sequence[str] = ()) -> dict[str, RecordedStream]:
        """The streams of these entities, of those below them, or of these devices; without a name all streams. Raises
        InputError for a missing stream."""
        found: dict[str, RecordedStream] = {}
        for name in names:
            own = {
                entity: stream
                for entity, stream in self.streams.items()
                if f"{entity}/".startswith(f"{name.strip('/')}/") or stream.device == name
            }
            if not own:
                raise self._unknown(name)
            found |= own
        return dict(sorted(found.items())) if names else self.streams

    def _unknown(self, name: str) -> InputError:
        came = f"{name!r}, which the recording lacks"
        return InputError(
            "an entity of the recording", came, ", ".join(self.streams) or "another one", self._replay.path
        )

    def batches(
        self, streams: Collection[str], *, gather: bool = True
    ) -> Iterator[tuple[RecordedStream, pa.RecordBatch]]:
        """Rows of the streams: those of one stream in order of time, the streams in any order. Memory holds only rows
        that may still be out of order, and with `gather` those of a batch that is not full."""
        starts = {entity: Starts(self.streams[entity]._starts) for entity in streams}
        waiting: dict[str, list[pa.Table]] = {entity: [] for entity in streams}
        ready: dict[str, list[pa.RecordBatch]] = {entity: [] for entity in streams}
        for chunk in self._replay.chunks(*sorted(set().union(*(self.streams[one].paths for one in streams)))):
            batch = chunk.to_record_batch()
            named = _named(chunk.entity_path, chunk.is_static, batch.schema.names)
            entity = _stream_of(chunk.entity_path, named)
            if not named or entity not in starts:
                continue
            stream = self.streams[entity]
            waiting[entity].append(_raw(batch, named, stream._types))
            until = starts[entity].after(chunk)
            done, rest = _until(waiting[entity], until)
            waiting[entity] = [rest] if rest is not None and rest.num_rows else []
            if done is not None and (done := _whole(done, stream)).num_rows:
                ready[entity].append(stream.convert(done, self.start_ns))
            own = ready[entity]
            enough = sum(map(len, own)) >= BATCH_ROWS or sum(one.nbytes for one in own) >= BATCH_BYTES
            if own and (not gather or enough):
                yield stream, pa.concat_batches(own)
                ready[entity] = []
        for entity, own in ready.items():
            if own:
                yield self.streams[entity], pa.concat_batches(own)

    def table(self, name: str) -> pa.Table:
        """A stream as one table: by its entity, or by DEVICE/QUANTITY with only its times and the columns of this
        quantity. Raises InputError for a stream that is not there."""
        device, _, quantity = name.strip("/").rpartition("/")
        entities, prefix = [name.strip("/")] if name.strip("/") in self.streams else [], ""
        if not entities:
            own = [one for one in self.streams.values() if device and one.device == device]
            entities, prefix = [one.entity for one in own if _quantity(one.schema, quantity)], quantity
        if len(entities) != 1:
            raise self._unknown(name)
        schema = self.streams[entities[0]].schema
        found = pa.Table.from_batches([batch for _, batch in self.batches(entities)], schema)
        places = [one for one in ("session_ns", "host_ns", "device_ticks", "index", "touch") if one in schema.names]
        return found.select([*places, *_quantity(schema, prefix)]) if prefix else found


def _quantity(schema: pa.Schema, prefix: str) -> list[str]:
    return [name for name in schema.names if f"{name}_".startswith(f"{prefix}_")]


def _kinds_of(names: Iterable[str]) -> list[type]:
    """Types of what columns hold, without a rerun transform."""
    return [_KINDS[owner] for owner in dict.fromkeys(name.partition(":")[0] for name in names) if owner in _KINDS]


def _stream_of(path: str, named: Mapping[str, str]) -> str:
    """The stream that a portion belongs to: its entity, or that of all transforms. named: its columns (`_named`)"""
    return "/".join(entity_parts(path)) if _kinds_of(named.values()) else TRANSFORMS


def _named(path: str, static: bool, names: Sequence[str]) -> dict[str, str]:
    """The columns of a portion that hold what is exported, and what each is called here; empty = none of it."""
    if path.strip("/") == SERIES[ForcePose] and not static:
        return {**{name: name for name in names if name in ("touch", "frame")}, **_SERIES}
    known = {name: _SHOWN.get(name, name) for name in names if _SHOWN.get(name, name).partition(":")[0] in _KINDS}
    shown = {name for name in known if name in _SHOWN}
    known = {name: of for name, of in known.items() if name not in shown or path.split("/")[1] in of.lower()}
    if not known and {"Transform3D:parent_frame", "Transform3D:child_frame"} <= set(names):
        known = {name: name for name in names if _TRANSFORM.fullmatch(name)} if "Transform3D:scale" not in names else {}
    if not known or (static and path.split("/")[1] not in ("calibration", "display")):
        return {}
    places = [name for name in names if ":" not in name and name not in (_SESSION, _ROW, "log_time", "log_tick")]
    return {**{name: name for name in places if name in ("frame", "index", "touch", "step")}, **known}


def _raw(batch: pa.RecordBatch, named: Mapping[str, str], types: Mapping[str, pa.DataType] | None = None) -> pa.Table:
    """The rows of a portion that hold anything of it: row id, time, timelines and components."""
    session = batch.column(_SESSION).cast(pa.int64()) if _SESSION in batch.schema.names else None
    session = pa.nulls(batch.num_rows, pa.int64()) if session is None else session
    ids = batch.column(_ROW)
    columns = {_ROW: getattr(ids, "storage", ids), _SESSION: session}
    columns |= {own: batch.column(name) for name, own in named.items() if name in batch.schema.names}
    if types:
        columns = {name: _cast(column, types.get(name, column.type)) for name, column in columns.items()}
    there = np.zeros(batch.num_rows, bool)
    for name, column in columns.items():
        if ":" in name:
            there |= column.is_valid().to_numpy(zero_copy_only=False)
    table = pa.table(columns)
    return table if there.all() else table.filter(pa.array(there))


def _until(waiting: Sequence[pa.Table], until: int | None) -> tuple[pa.Table | None, pa.Table | None]:
    """What is earlier than a time [ns], None = all, in order of time with the parts of each row together; the rest."""
    if not waiting:
        return None, None
    every = (waiting[0] if len(waiting) == 1 else pa.concat_tables(waiting, promote_options="default")).combine_chunks()
    times = pc.fill_null(every.column(_SESSION), 0).to_numpy()
    ids = np.frombuffer(b"".join(every.column(_ROW).to_pylist()), ">u8").reshape(-1, 2)
    if len(waiting) > 1 or np.any(np.diff(times) < 0):
        order = np.lexsort((ids[:, 1], ids[:, 0], times))
        every, times, ids = every.take(pa.array(order)), times[order], ids[order]
    count = len(times) if until is None else int(np.searchsorted(times, until))
    done, rest = every.slice(0, count), every.slice(count)
    first = np.flatnonzero(np.r_[True, np.any(ids[1:count] != ids[: max(count - 1, 0)], axis=1)])
    return _joined(done, first) if len(first) < count else done, rest


def _joined(table: pa.Table, first: IntArray) -> pa.Table:
    """Rows that span several portions as one each. first: (rows,) where each begins"""
    columns = []
    for column in table.columns:
        there = column.combine_chunks().is_valid().to_numpy(zero_copy_only=False)
        best = np.minimum.reduceat(np.where(there, np.arange(len(there)), len(there)), first)
        columns.append(column.take(pa.array(np.minimum(best, len(there) - 1), mask=best == len(there))))
    return pa.table(columns, names=table.schema.names)


def _whole(table: pa.Table, stream: RecordedStream) -> pa.Table:
    """Without frames that were recorded in part: those that lack a part that others have."""
    if not set(stream.kinds) & set(FRAMES):
        return table
    there = np.ones(table.num_rows, bool)
    for name in stream._types:
        of = field_of(stream.kinds[-1], name.partition(":")[2]) if ":" in name else None
        if of is not None and not of.optional:
            there &= table.column(name).is_valid().to_numpy() if name in table.schema.names else False
    if not there.all():
        _logger.warning("%d rows of %s were recorded in part, and are left out", np.sum(~there), stream.entity)
    return table.filter(pa.array(there))


# Columns -------------------------------------------------------------------------------------------------------------


def _renamed(kind: type) -> dict[str, str]:
    """Fields whose column is named by the key that the JSON has: what is there as it is recorded."""
    names = {one.name for one in dataclasses.fields(cast("Any", kind))}
    found = {}
    for one in quantities(kind):
        of = field_of(kind, one.name) if one.name in names else None
        changed = one.json or one.json_scale or one.length or one.flat or one.per_length or one.interval_key
        if one.key and of is not None and of.form != "nested" and not changed:
            found[one.name] = one.key.replace(".", "_")
    return found


def _lengths(column: Any) -> IntArray:
    return cast(
        "IntArray", pc.fill_null(pc.list_value_length(column), 0).to_numpy(zero_copy_only=False).astype(np.int64)
    )


def _vector(cells: pa.ListArray, names: Sequence[str]) -> dict[str, pa.Array]:
    """Cells of as many values each, or none, as a column for each of these."""
    lengths = _lengths(cells) if len(cells) else np.zeros(0, np.int64)
    flat, first = cells.flatten(), np.cumsum(lengths) - lengths
    if len(names) == 1 and len(lengths) and lengths.all():
        return {names[0]: flat}
    lacking = lengths < len(names)
    return {name: flat.take(pa.array(np.where(lacking, 0, first + at), mask=lacking)) for at, name in enumerate(names)}


def _binary(cells: pa.ListArray) -> pa.Array:
    """Lists of bytes, or lists of one such list, as bytes."""
    if not len(cells):
        return pa.array([], pa.large_binary())
    lengths = _lengths(cells)
    there, values = cells.is_valid().to_numpy(zero_copy_only=False), cells.flatten()
    if pa.types.is_list(values.type):
        lengths = np.zeros(len(cells), np.int64)
        lengths[_lengths(cells) > 0] = _lengths(values)
        there, values = there & (_lengths(cells) > 0), values.flatten()
    data = np.ascontiguousarray(values.to_numpy(zero_copy_only=False), np.uint8)
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    found = pa.LargeBinaryArray.from_buffers(
        pa.large_binary(), len(cells), [None, pa.py_buffer(offsets), pa.py_buffer(data)]
    )
    return found if there.all() else pc.if_else(pa.array(there), found, pa.scalar(None, pa.large_binary()))


def _transform(component: str, cells: pa.Array) -> dict[str, pa.Array]:
    if component in ("parent_frame", "child_frame"):
        return _vector(cells, [component])
    values = cells.flatten().flatten() if len(cells) else pa.array([], pa.float64())
    lengths = _lengths(cells) > 0 if len(cells) else np.zeros(0, bool)
    if component == "translation":
        return _rows_of(values.to_numpy(zero_copy_only=False), lengths, TRANSFORM_COLUMNS[:3])
    numbers = values.to_numpy(zero_copy_only=False).astype(np.float64)
    if component == "mat3x3" and len(numbers):
        from scipy.spatial.transform import Rotation

        numbers = Rotation.from_matrix(numbers.reshape(-1, 3, 3).swapaxes(1, 2)).as_quat().ravel()
    names = TRANSFORM_COLUMNS[3:] if component == "quaternion" else tuple(f"m{name}" for name in TRANSFORM_COLUMNS[3:])
    return _rows_of(numbers, lengths, names)


def _rows_of(values: Any, there: Any, names: Sequence[str]) -> dict[str, pa.Array]:
    rows = np.full((len(there), len(names)), np.nan)
    rows[there] = np.asarray(values, np.float64).reshape(-1, len(names))
    return {name: pa.array(rows[:, at], mask=~there) for at, name in enumerate(names)}


def _axes(column: str, width: int) -> list[str]:
    """Names of a vector's columns."""
    base, unit = split_unit(column)
    if column in XYZ and width % 3 == 0:
        parts = [(f"{at // 3}_" if width > 3 else "") + CARTESIAN[at % 3] for at in range(width)]
    elif "interval" in column and width == 2:
        parts = ["low", "high"]
    else:
        parts = [str(at) for at in range(width)]
    return [f"{base}_{part}{unit and f'_{unit}'}" for part in parts]


def columns_of(name: str, columns: Iterable[str]) -> list[str]:
    """The columns that hold a frame's field of this name: one column, or one for each of its values, in order."""
    base, unit = split_unit(name)
    each = re.compile(rf"{re.escape(base)}_(\d+_)?([xyz]|\d+){unit and f'_{unit}'}")
    found = (one for one in columns if one == name or each.fullmatch(one))
    return sorted(found, key=lambda one: [part.zfill(20) for part in one.split("_")])


def split_unit(column: str) -> tuple[str, str]:
    """A name, and the unit at its end or empty."""
    parts = column.split("_")
    for at in range(1, len(parts)):
        if (unit := "_".join(parts[at:])) in UNITS and unit not in ("counts", "ticks"):
            return "_".join(parts[:at]), unit
    return column, ""


def unit_of(name: str, declared: Mapping[str, str]) -> str:
    """The unit of a column: declared for it or its quantity, or at the end of its name; otherwise empty."""
    base = re.sub(r"_(low|high|[xyz]|\d+)(?=_|$)", "", name)
    return (
        declared.get(name) or declared.get(base) or UNITS.get(split_unit(name)[1]) or UNITS.get(base.split("_")[-1], "")
    )


def _shape_of(value: object) -> str:
    """Name of a value's type, with the length of a list of numbers; "json" of all that no column holds."""
    if isinstance(value, list) and all(isinstance(one, float | int) and not isinstance(one, bool) for one in value):
        return f"list{len(value)}"
    known = (kind.__name__ for kind in (bool, int, float, str) if isinstance(value, kind))
    return "none" if value is None else next(known, "json")


def _arrays_of(key: str, values: Sequence[Any], shapes: set[str]) -> dict[str, pa.Array]:
    """Values out of JSON as columns. shapes: shapes of all that the recording has"""
    own = shapes - {"none"}
    if (not own and "interval" in key) or (own and all(shape.startswith("list") for shape in own)):
        lists = pa.array(values, pa.list_(pa.float64()))
        if own <= {"list2"} and "interval" in key:
            return _vector(lists, _axes(key, 2))
        return {key: lists}
    if own == {"int", "float"} or (not own and split_unit(key)[1]):
        own = {"float"}
    if len(own) == 1 and (kind := _SCALARS.get(*own)) is not None:
        return {key: pa.array(values, kind)}
    return {key: pa.array([None if value is None else json.dumps(value) for value in values], pa.string())}


def _common(one: pa.DataType, other: pa.DataType) -> pa.DataType:
    """The type that holds both."""
    schemas = [pa.schema([("x", kind)]) for kind in (one, other)]
    return pa.unify_schemas(schemas, promote_options="permissive").field(0).type


def _cast(array: Any, kind: pa.DataType) -> Any:
    return array if array.type == kind else array.cast(kind)
