"""An exploration's recorded results, as a recording holds them and as they were: equal to the last bit.

A result is one row of one entity, each of its fields a component of the same name: numbers as float64 or int64, an
array flat with its shape beside it. A field that is None is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, cast, get_args, get_type_hints

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.replay import Replay
from deformscope.stages.exploration import (
    MapsKnown,
    NextTouch,
    PhaseBegan,
    StageFailed,
    Stopped,
    SurfaceSeen,
    TouchTold,
)

Result = SurfaceSeen | TouchTold | MapsKnown | NextTouch | StageFailed | PhaseBegan | Stopped

ENTITIES: dict[type[Result], str] = {
    SurfaceSeen: "exploration/surface",
    TouchTold: "exploration/touch",
    MapsKnown: "exploration/maps",
    NextTouch: "exploration/plan",
    StageFailed: "exploration/failed",
    PhaseBegan: "exploration/phase",
    Stopped: "exploration/stopped",
}
"""Where each kind stands in a recording."""

SHAPE = "_shape"
"""What the component of an array's shape is called after the array's own name."""

_ARRAYS: dict[Any, tuple[str, type]] = {
    FloatArray: ("float64", np.float64),
    IntArray: ("int64", np.int64),
    BoolArray: ("bool", np.bool_),
}
_VALUES: dict[Any, str] = {float: "float64", int: "int64", bool: "bool", str: "string"}


@dataclass(frozen=True, slots=True)
class Recorded:
    """A result and when it came. session_ns: since the recording's start [ns]; touch: its place on that timeline"""

    session_ns: int
    touch: int
    result: Result


def read_results(
    path: Path, kinds: Sequence[type[Result]] = tuple(ENTITIES), *, trust: bool = False
) -> Iterator[Recorded]:
    """The results of a recorded exploration in the order in which they came.

    kinds: those alone; trust: skip the comparison with the ledger. Raises InputError where it is no recording of ours
    """
    replay = Replay(path, trust=trust)
    found = []
    for kind in kinds:
        for chunk in replay.chunks(f"/{ENTITIES[kind]}"):
            batch = chunk.to_record_batch()
            if chunk.is_static or "session" not in chunk.timeline_names:
                continue
            cells = {
                name.split(":")[1]: batch.column(name).to_pylist()
                for name in batch.schema.names
                if name.startswith(f"{kind.__name__}:")
            }
            places = zip(
                batch.column("session").cast("int64").to_pylist(),
                batch.column("touch").to_pylist(),
                batch.column("rerun.controls.RowId").to_pylist(),
                strict=True,
            )
            for row, (session_ns, touch, row_id) in enumerate(places):
                values = {name: column[row] for name, column in cells.items() if column[row] is not None}
                if values:
                    found.append((session_ns, row_id, Recorded(session_ns, touch, _result(kind, values))))
    found.sort(key=lambda one: one[:2])
    yield from (recorded for _, _, recorded in found)


def components(result: Result) -> dict[str, tuple[str, list[Any]]]:
    """Each component of a result's row: its type's name in Arrow, and its values."""
    found: dict[str, tuple[str, list[Any]]] = {}
    hints = get_type_hints(type(result))
    for field in dataclasses.fields(result):
        value, kind = getattr(result, field.name), _required(hints[field.name])
        if value is None:
            continue
        if kind in _ARRAYS:
            name, dtype = _ARRAYS[kind]
            array: npt.NDArray[Any] = np.asarray(value, dtype)
            found[field.name] = name, cast("list[Any]", array.ravel())
            found[field.name + SHAPE] = "int64", list(array.shape)
        elif kind in _VALUES:
            found[field.name] = _VALUES[kind], [kind(value)]
        else:  # an interval
            found[field.name] = "float64", [float(one) for one in value]
    return found


def _result(kind: type[Result], values: dict[str, list[Any]]) -> Result:
    hints = get_type_hints(kind)
    made: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        wanted = _required(hints[field.name])
        if field.name not in values:
            made[field.name] = None
        elif wanted in _ARRAYS:
            flat: npt.NDArray[Any] = np.array(values[field.name], _ARRAYS[wanted][1])
            made[field.name] = flat.reshape(values[field.name + SHAPE])
        elif wanted in _VALUES:
            made[field.name] = wanted(values[field.name][0])
        else:
            made[field.name] = tuple(values[field.name])
    return kind(**made)


def _required(hint: Any) -> Any:
    """What a field is where it is not None."""
    given = [one for one in get_args(hint) if one is not NoneType]
    return given[0] if NoneType in get_args(hint) else hint
