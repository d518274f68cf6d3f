"""An exploration's recorded results, as a recording holds them and as they were: equal to the last bit.

A result is one row of one entity, each of its fields a component of the same name: numbers as float64 or int64, an
array flat with its shape beside it. A field that is None is left out.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import NoneType
from typing import Any, cast, get_args, get_type_hints

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.frames import Pad, Stream
from deformscope.stages.map.exploration import (
    ExplorationStop,
    MapEstimate,
    PhaseStart,
    PlannedTouch,
    StageFailure,
    SurfaceEstimate,
    TouchEstimate,
)
from deformscope.stages.map.measured import LookFrames, SurfaceMeasurement, TouchFrames, TouchMeasurement

Input = LookFrames | TouchFrames | SurfaceMeasurement | TouchMeasurement
"""What an exploration is computed from."""
Result = (
    SurfaceEstimate | TouchEstimate | MapEstimate | PlannedTouch | StageFailure | PhaseStart | ExplorationStop | Input
)

ENTITIES: dict[type[Result], str] = {
    SurfaceEstimate: "exploration/surface",
    TouchEstimate: "exploration/touch",
    MapEstimate: "exploration/maps",
    PlannedTouch: "exploration/plan",
    StageFailure: "exploration/failed",
    PhaseStart: "exploration/phase",
    ExplorationStop: "exploration/stopped",
    LookFrames: "exploration/input/look",
    TouchFrames: "exploration/input/touch",
    SurfaceMeasurement: "exploration/input/surface",
    TouchMeasurement: "exploration/input/measured",
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


def result_of(kind: type[Result], values: dict[str, list[Any]]) -> Result:
    """What `components` made a row of. values: each component's values, by name"""
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


def stream_json(stream: Stream) -> str:
    """One stream as a JSON object."""
    return json.dumps(dataclasses.asdict(stream), default=str, sort_keys=True)


def stream_from_json(text: str) -> Stream:
    """What `stream_json` made."""
    values = json.loads(text)
    pads = tuple(Pad(**{**pad, "texel_m": tuple(pad["texel_m"])}) for pad in values.pop("pads"))
    urdf = values.pop("urdf")
    return Stream(**values, pads=pads, urdf=None if urdf is None else Path(urdf))
