"""The only codec between frozen dataclasses and the columns of a recording: what is read equals what was written.

An object is one row of one entity; each field is a component `CLASS:FIELD`, a field of a dataclass inside it
`CLASS:FIELD.INNER`. Numbers, texts and tuples of these are lists of values, enums are their names, bytes and arrays are
flat. An array's shape is `FIELD_shape` unless it is (n,). None is not written; a dataclass that may be None has at
least one value. Other values, such as mappings, are JSON. An image is encoded by its twin in `deformscope.log`;
`IMAGES` has its place."""

import dataclasses
import enum
import json
from collections.abc import Callable, Collection, Mapping, Sequence, Sized
from dataclasses import dataclass
from functools import cache
from itertools import chain
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from deformscope import frames
from deformscope.arrays import ImageArray, IntArray
from deformscope.images import decode_image
from deformscope.stages.map import exploration
from deformscope.stages.map.measured import LookFrames, SurfaceMeasurement, TouchFrames, TouchMeasurement
from deformscope.stages.map.perception import ForcePose, LookPerception, TouchPerception
from deformscope.stages.squeeze import trial
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.placement import ContainerSighting, HandPlacement

FORMAT = 3
"""Format of a recording, in its properties: which entities and components it has, and how its results are computed. A
change that another version would misread, or compute otherwise, increases it; no other format is read."""

ENTITIES: dict[type, str] = {
    exploration.SurfaceEstimate: "exploration/surface",
    exploration.TouchEstimate: "exploration/touch",
    exploration.MapEstimate: "exploration/maps",
    exploration.InclusionsResult: "exploration/lumps",
    exploration.PlannedTouch: "exploration/plan",
    exploration.TouchForecast: "exploration/forecast",
    exploration.SteeringDecision: "exploration/decision",
    exploration.StageFailure: "exploration/failed",
    exploration.PhaseStart: "exploration/phase",
    exploration.ExplorationStop: "exploration/stopped",
    LookPerception: "exploration/perception/look",
    TouchPerception: "exploration/perception/touch",
    LookFrames: "exploration/input/look",
    TouchFrames: "exploration/input/touch",
    SurfaceMeasurement: "exploration/input/surface",
    TouchMeasurement: "exploration/input/measured",
    trial.SqueezePhase: "squeeze/phase",
    trial.SqueezeStop: "squeeze/stopped",
    SqueezeEvents: "squeeze/events",
    trial.SqueezeFeatures: "squeeze/features",
    trial.FingertipPressure: "squeeze/fingertips",
    trial.TrackedContainer: "squeeze/container",
    trial.ContainerChange: "squeeze/change",
    trial.ContentPosterior: "squeeze/content",
    ContainerSighting: "squeeze/sighting",
    HandPlacement: "squeeze/placement",
    frames.HealthReport: "health",
    frames.SessionNote: "note",
    frames.InputFile: "input",
    frames.StageCost: "cost",
}
"""The place of each kind in a recording."""

SERIES: dict[type, str] = {ForcePose: "exploration/force_pose"}
"""Results that are rows at times of their own: `host_ns` (n,), and `values` (n, k) as scalars that a viewer plots."""

OF_DEVICES: dict[type, str] = {
    frames.WrenchFrame: "wrench",
    frames.TactileFrame: "tactile",
    frames.ArmFrame: "arm",
    frames.HandFrame: "hand",
    frames.ColorFrame: "color",
    frames.DepthFrame: "depth",
    frames.RawBytes: "raw",
    frames.LinkChange: "link",
}
"""Items of a device, whose name follows: `wrench/DEVICE`."""

FRAMES = (
    frames.WrenchFrame,
    frames.TactileFrame,
    frames.ArmFrame,
    frames.HandFrame,
    frames.ColorFrame,
    frames.DepthFrame,
)
"""Rows of these types have the index as their place on the timeline `index` of an exploration, else `frame`."""

IMAGES = {"ColorFrame:image": "EncodedImage:blob", "DepthFrame:depth": "EncodedDepthImage:blob"}
"""Images that a viewer shows: their components are rerun's own."""

SHAPE = "_shape"

_ARROW: dict[Any, pa.DataType] = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}

Form = Literal["value", "tuple", "bytes", "array", "arrays", "image", "nested", "json"]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Column:
    """One component of some rows. values: values of all rows; lengths: (rows,) number of values in each row"""

    values: pa.Array
    lengths: IntArray


@dataclass(frozen=True, slots=True)
class CodecField:
    """One field of a dataclass. kind: type of the value, of a tuple's values, or of the dataclass inside"""

    name: str
    form: Form
    kind: Any
    optional: bool


def to_columns(items: Sequence[object], leave_out: Collection[str] = ()) -> dict[str, Column]:
    """The components of rows, by field. items: items of one class; leave_out: fields that are recorded in another way

    Arrays of one field whose types differ from row to row get the type that holds them all."""
    found: dict[str, Column] = {}
    for field in _fields(cast("Any", type(items[0]))):
        if field.form != "image" and field.name not in leave_out:
            values = [getattr(item, field.name) for item in items]
            if not field.optional or any(value is not None for value in values):
                found |= _ENCODERS[field.form](field, values)
    return found


def to_components(item: object, leave_out: Collection[str] = ()) -> dict[str, npt.NDArray[Any]]:
    """An object's components by field: (n,) values each, flat."""
    columns = to_columns([item], leave_out)
    return {name: column.values.to_numpy(zero_copy_only=False) for name, column in columns.items()}


def from_components(
    kind: type[T],
    components: Mapping[str, Any],
    given: Mapping[str, Any] | None = None,
    read_image: Callable[[bytes, str], Any] = decode_image,
) -> T:
    """Inverse of `to_components`; raises KeyError if a part is missing.

    components: flat arrays, or lists of words, by field; given: fields that were left out
    read_image: replacement of an encoded image, which the second argument identifies"""
    made: dict[str, Any] = dict(given or {})
    for field in _fields(cast("Any", kind)):
        if field.name in made:
            continue
        if field.optional and not _is_there(field, components):
            made[field.name] = None
        elif field.form == "nested":
            prefix = field.name + "."
            inner = {name.removeprefix(prefix): v for name, v in components.items() if name.startswith(prefix)}
            made[field.name] = from_components(field.kind, inner)
        elif field.form == "image":
            where = f"{field.name} {made.get('index', '')} of {made.get('device', kind.__name__)}"
            made[field.name] = read_image(np.asarray(components[field.name], np.uint8).tobytes(), where)
        else:
            made[field.name] = _DECODERS[field.form](field, components)
    return kind(**made)


def differing(before: object, now: object, leave_out: Collection[str] = ()) -> str | None:
    """The first component in which two objects of a class differ, to the last bit; None if they are equal. leave_out:
    fields, or components of them, that may differ"""
    first, second = to_components(before, leave_out), to_components(now, leave_out)
    for name in sorted((first.keys() | second.keys()) - set(leave_out)):
        one, other = first.get(name), second.get(name)
        if one is None or other is None or not np.array_equal(one, other, equal_nan=one.dtype.kind == "f"):
            return name
    return None


def field_of(kind: type, component: str) -> CodecField | None:
    """The field that a component `FIELD` or `FIELD.INNER` holds; None for a shape, and for other components."""
    name, _, inner = component.partition(".")
    found = next((field for field in _fields(cast("Any", kind)) if field.name == name), None)
    return field_of(found.kind, inner) if found is not None and found.form == "nested" else found


def to_json(value: object) -> str:
    """Dataclasses, mappings and similar values as JSON."""
    built = msgspec.to_builtins(value, enc_hook=lambda one: one.item() if isinstance(one, np.generic) else str(one))
    return json.dumps(built, sort_keys=True)


def from_json(kind: type[T], text: str) -> T:
    """Inverse of `to_json`, for this kind."""
    return msgspec.convert(
        json.loads(text), kind, dec_hook=lambda wanted, one: one if wanted is object else wanted(one)
    )


@cache
def _fields(kind: Any) -> tuple[CodecField, ...]:
    hints = get_type_hints(kind)
    return tuple(_field(field.name, hints[field.name]) for field in dataclasses.fields(kind))


def _field(name: str, hint: Any) -> CodecField:
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    kinds = tuple(option for option in options if option is not NoneType)
    optional, kind = len(kinds) < len(options), kinds[0]
    inner, varied = get_args(kind), Ellipsis in get_args(kind)
    if kinds == get_args(ImageArray):
        return CodecField(name, "image", kind, optional)
    if len(kinds) > 1:
        return CodecField(name, "json", hint, optional)
    if _is_array(kind):
        return CodecField(name, "array", kind, optional)
    if kind is bytes and not optional:
        return CodecField(name, "bytes", kind, optional)
    if get_origin(kind) is Literal and set(map(type, inner)) == {str}:
        return CodecField(name, "value", str, optional)
    if kind in _ARROW or _is_enum(kind):
        return CodecField(name, "value", kind, optional)
    if dataclasses.is_dataclass(kind):
        return CodecField(name, "nested", kind, optional)
    if get_origin(kind) is tuple and not (optional and varied):  # None and () would be one
        if inner[0] in _ARROW and set(inner) <= {inner[0], Ellipsis}:
            return CodecField(name, "tuple", inner[0], optional)
        if _is_array(inner[0]) and varied:
            return CodecField(name, "arrays", inner[0], optional)
    return CodecField(name, "json", kind, optional)


def _is_array(kind: object) -> bool:
    """Whether a type hint is of a NumPy array: from NumPy 2.5 on, NDArray is an alias with a value."""
    return get_origin(getattr(kind, "__value__", kind)) is np.ndarray


def _is_enum(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, enum.Enum)


def _is_there(field: CodecField, components: Mapping[str, Any]) -> bool:
    """Whether an optional field is not None: it has a value, or the shape of none."""
    if field.form == "nested":
        return any(len(value) > 0 for name, value in components.items() if name.startswith(field.name + "."))
    name = field.name + SHAPE if field.form == "array" else field.name
    return name in components and len(components[name]) > 0


# To columns ----------------------------------------------------------------------------------------------------------


def _values(field: CodecField, values: Sequence[Any]) -> dict[str, Column]:
    lengths = np.array([value is not None for value in values], np.int64)
    there = values if lengths.all() else [value for value in values if value is not None]
    if _is_enum(field.kind):
        return {field.name: Column(pa.array([value.name for value in there], pa.string()), lengths)}
    return {field.name: Column(pa.array(list(map(field.kind, there)), _ARROW[field.kind]), lengths)}


def _tuples(field: CodecField, values: Sequence[Any]) -> dict[str, Column]:
    rows = [value or () for value in values]
    flat = pa.array(list(map(field.kind, chain.from_iterable(rows))), _ARROW[field.kind])
    return {field.name: Column(flat, _lengths(rows))}


def _bytes(field: CodecField, values: Sequence[bytes]) -> dict[str, Column]:
    return {field.name: Column(pa.array(np.frombuffer(b"".join(values), np.uint8)), _lengths(values))}


def _arrays(field: CodecField, values: Sequence[Any]) -> dict[str, Column]:
    arrays = [None if value is None else np.asarray(value) for value in values]
    there = [array for array in arrays if array is not None]
    lengths = np.array([0 if array is None else array.size for array in arrays], np.int64)
    found = {field.name: Column(pa.array(_flat(there)), lengths)}
    if field.optional or any(array.ndim != 1 for array in there):
        shapes = [() if array is None else array.shape for array in arrays]
        found[field.name + SHAPE] = _shapes(shapes)
    return found


def _tuples_of_arrays(field: CodecField, values: Sequence[Sequence[Any]]) -> dict[str, Column]:
    rows = [[np.asarray(array) for array in row] for row in values]
    lengths = np.array([sum(array.size for array in row) for row in rows], np.int64)
    shapes = [[side for array in row for side in (array.ndim, *array.shape)] for row in rows]
    flat = _flat([array for row in rows for array in row])
    return {field.name: Column(pa.array(flat), lengths), field.name + SHAPE: _shapes(shapes)}


def _nested(field: CodecField, values: Sequence[object]) -> dict[str, Column]:
    there = np.array([value is not None for value in values])
    found = {}
    for name, column in to_columns([value for value in values if value is not None]).items():
        lengths = np.zeros(len(values), np.int64)
        lengths[there] = column.lengths
        found[f"{field.name}.{name}"] = Column(column.values, lengths)
    return found


def _as_json(field: CodecField, values: Sequence[object]) -> dict[str, Column]:
    texts = [to_json(value) for value in values if value is not None]
    return {field.name: Column(pa.array(texts, pa.string()), np.array([value is not None for value in values], int))}


def _flat(arrays: Sequence[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    return np.concatenate([array.ravel() for array in arrays]) if arrays else np.zeros(0)


def _shapes(shapes: Sequence[Sequence[int]]) -> Column:
    return Column(pa.array(np.fromiter(chain.from_iterable(shapes), np.int64)), _lengths(shapes))


def _lengths(rows: Sequence[Sized]) -> IntArray:
    return np.fromiter(map(len, rows), np.int64, len(rows))


_ENCODERS: dict[Form, Callable[[CodecField, Sequence[Any]], dict[str, Column]]] = {
    "value": _values,
    "tuple": _tuples,
    "bytes": _bytes,
    "array": _arrays,
    "arrays": _tuples_of_arrays,
    "nested": _nested,
    "json": _as_json,
}


# From components -----------------------------------------------------------------------------------------------------


def _value(field: CodecField, components: Mapping[str, Any]) -> Any:
    value = components[field.name][0]
    return field.kind[value] if _is_enum(field.kind) else field.kind(value)


def _array(field: CodecField, components: Mapping[str, Any]) -> npt.NDArray[Any]:
    flat = np.asarray(components[field.name])
    shape = components.get(field.name + SHAPE)
    return flat if shape is None else flat.reshape([int(side) for side in shape])


def _tuple_of_arrays(field: CodecField, components: Mapping[str, Any]) -> tuple[npt.NDArray[Any], ...]:
    flat, sides = np.asarray(components[field.name]), [int(side) for side in components[field.name + SHAPE]]
    found, at, place = list[npt.NDArray[Any]](), 0, 0
    while place < len(sides):
        shape = sides[place + 1 : place + 1 + sides[place]]
        size = int(np.prod(shape, dtype=np.int64))
        found.append(flat[at : at + size].reshape(shape))
        at, place = at + size, place + 1 + len(shape)
    return tuple(found)


_DECODERS: dict[Form, Callable[[CodecField, Mapping[str, Any]], Any]] = {
    "value": _value,
    "tuple": lambda field, components: tuple(map(field.kind, components[field.name])),
    "bytes": lambda field, components: np.asarray(components[field.name], np.uint8).tobytes(),
    "array": _array,
    "arrays": _tuple_of_arrays,
    "json": lambda field, components: from_json(cast("type[Any]", field.kind), components[field.name][0]),
}
