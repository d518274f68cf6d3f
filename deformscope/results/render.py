"""Renders results from what their dataclasses declare: JSON and its units, rows of a table, a line of words."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Literal

from deformscope.results.declared import Quantity, quantities

Rows = list[tuple[str, str]]


def to_json(result: Any) -> dict[str, Any]:
    """What of a result goes into JSON, by key; arrays may stand in it."""
    found: dict[str, Any] = {}
    for one in quantities(type(result)):
        value = getattr(result, one.name)
        if one.key is None or (one.optional and value is None):
            continue
        if one.length:
            found |= lengths(one.key, value, result.unit, result.metres_per_unit)
        elif one.flat:
            found |= to_json(value)
        else:
            found[one.key] = _json(one, value)
    return found


def units_of(kinds: Iterable[type]) -> dict[str, str]:
    """The units of the JSON of these, by key."""
    return {str(one.key): one.unit for one in sorted(_of(kinds), key=lambda one: str(one.key)) if one.unit}


def _of(kinds: Iterable[type]) -> list[Quantity]:
    return [one for kind in kinds for one in quantities(kind)]


def lengths(name: str, value: Any, unit: str, metres_per_unit: float | None) -> dict[str, Any]:
    """A length, or an array of lengths, as JSON has them: `NAME_m` and `NAME_px`, None where it is not known so."""
    metres = value if unit == "m" else None if metres_per_unit is None or value is None else metres_per_unit * value
    return {f"{name}_m": metres, f"{name}_px": value if unit == "px" else None}


def _json(one: Quantity, value: Any) -> Any:
    if value is None:
        return None
    if one.json is not None:
        return one.json(value)
    if one.json_scale is not None:
        return one.json_scale * value
    return _nested(value)


def _nested(value: Any) -> Any:
    """Results inside a result are rendered as they declare; what declares nothing stays."""
    if dataclasses.is_dataclass(value) and quantities(type(value)):
        return to_json(value)
    if isinstance(value, tuple | list):
        return [_nested(one) for one in value]
    if isinstance(value, Mapping):
        return {key: _nested(one) for key, one in value.items()}
    return value


def to_words(result: Any, name: str) -> str:
    """One quantity as it is shown: number, unit and interval; empty where it is not known."""
    return _words(result, next(one for one in quantities(type(result)) if one.name == name))


def to_rows(result: Any) -> Rows:
    """The quantities that have a label and are known, as names and values."""
    shown = [(one.label, _words(result, one)) for one in quantities(type(result)) if one.label]
    return [row for row in shown if row[1]]


def to_line(result: Any, kind: Literal["line", "caption"] = "line") -> str:
    """What matters most, in a line: all quantities that have a place in it, and are known."""
    shown = [(getattr(one, kind), one) for one in quantities(type(result))]
    known = [(form, words) for form, one in shown if form and (words := _words(result, one))]
    return ", ".join(form.format(words) for form, words in known)


def _words(result: Any, one: Quantity) -> str:
    value = getattr(result, one.name)
    if one.words is not None:
        return one.words(result)
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    between = ""
    if one.interval and (ends := getattr(result, one.interval)) is not None:
        between = " ({} to {})".format(*(_number(one, end) for end in ends))
    unit = f" {one.shown_unit}" if one.shown_unit else ""
    return f"{_number(one, value)}{unit}{between}"


def _number(one: Quantity, value: float) -> str:
    return f"{one.scale * value:{one.digits}}"
