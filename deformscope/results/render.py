"""Renders results from their dataclasses' declarations: JSON and its units, rows of a table, a line of text, and
cells of columns, by names that a filter can use.

Declares for each quantity of a result, in its dataclass, its report: name, unit, format, place in the JSON.

A field has the declaration as its metadata, a property as its decorator:

    depth_m: float = field(metadata=reported("dent", unit="m", digits=".1f", scale=1e3, shown_unit="mm"))

    @property
    @derived("dent per force", unit="m/N")
    def dent_m_per_n(self) -> float: ...

Quantities are rendered in the order in which they are declared (`deformscope.results.render`). Undeclared values are
not reported, only recorded."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from typing import Any, Literal, ParamSpec, TypeVar, cast

from deformscope.plain import plain

Function = TypeVar("Function", bound=Callable[..., Any])
P = ParamSpec("P")

_QUANTITY = "quantity"
_places = count()


@dataclass(frozen=True, slots=True)
class Quantity:
    """How one quantity is reported.

    label: name in words, as in a row of a table; key: key in JSON, empty = the field's name, None = not in JSON,
    GROUP.KEY = in an object GROUP
    unit: unit in JSON, listed among the units there; empty = its key ends with it, or it has none
    digits: format of the shown number; scale, shown_unit: it is shown as `scale` times its value, in `shown_unit`
    interval: field or property with the two ends, else the value's `interval`; interval_key: JSON has the number and,
    under this key, the interval separately; so do columns
    words: makes a text in place of a number, from the whole result
    json: converts the value to JSON; json_scale: factor of the value in JSON
    length: it is in the result's `unit` with `metres_per_unit`: JSON has KEY_m and KEY_px, None where not known
    per_length: it is a force per such a unit: JSON has it per metre, None if the scale is unknown
    missing: text in place of None
    optional: JSON lacks the key if the value is None; flat: JSON has the value's parts instead
    line: its text in the line of main values, with "{}" for the value; caption: its text below the title of a picture
    name: name of the field or property; place: number that rises in the order of declaration"""

    label: str = ""
    key: str | None = ""
    unit: str = ""
    digits: str = ".3g"
    scale: float = 1.0
    shown_unit: str = ""
    interval: str = ""
    interval_key: str = ""
    words: Callable[[Any], str] | None = None
    json: Callable[[Any], Any] | None = None
    json_scale: float | None = None
    length: bool = False
    per_length: bool = False
    missing: str = ""
    optional: bool = False
    flat: bool = False
    line: str = ""
    caption: str = ""
    name: str = ""
    place: int = field(default_factory=_places.__next__)


def _as_metadata(make: Callable[P, Quantity]) -> Callable[P, Mapping[str, Quantity]]:
    def reported(*args: P.args, **kwargs: P.kwargs) -> Mapping[str, Quantity]:
        return {_QUANTITY: make(*args, **kwargs)}

    return reported


def _as_decorator(make: Callable[P, Quantity]) -> Callable[P, Callable[[Function], Function]]:
    def derived(*args: P.args, **kwargs: P.kwargs) -> Callable[[Function], Function]:
        quantity = make(*args, **kwargs)

        def declare(function: Function) -> Function:
            function.__dict__[_QUANTITY] = quantity
            return function

        return declare

    return derived


reported = _as_metadata(Quantity)
"""The metadata of a field that is reported; arguments as in `Quantity`."""
derived = _as_decorator(Quantity)
"""Decorates a method or property that is reported like a field; arguments as in `Quantity`."""


WORDING: Mapping[str, object] = {"deformscope.wording": True}
"""The metadata of a text that another version may word differently: a replay does not compare it."""


def is_declared(field: dataclasses.Field[Any], metadata: Mapping[str, object]) -> bool:
    """Whether a field is declared with this metadata, such as `WORDING`."""
    return field.metadata.keys() >= metadata.keys()


def quantities(kind: type) -> tuple[Quantity, ...]:
    """Reported quantities of a dataclass, in the order in which they are declared."""
    return _quantities(cast("Any", kind))


@cache
def _quantities(kind: Any) -> tuple[Quantity, ...]:
    found = [(one.name, one.metadata.get(_QUANTITY)) for one in dataclasses.fields(kind)]
    members = {name: member for each in reversed(kind.__mro__) for name, member in vars(each).items()}
    for name, member in members.items():
        found.append((name, getattr(getattr(member, "fget", member), _QUANTITY, None)))
    named = [
        dataclasses.replace(one, name=name, key=name if one.key == "" else one.key)
        for name, one in found
        if one is not None
    ]
    return tuple(sorted(named, key=lambda one: one.place))


Rows = list[tuple[str, str]]


class ReportedResult:
    """A dataclass whose JSON follows from its declarations. A class variable `parameter` names the fitted one."""

    __slots__ = ()

    def as_json(self) -> dict[str, Any]:
        """The public form."""
        return to_json(self)


def to_json(result: Any) -> dict[str, Any]:
    """The part of a result in JSON, by key, made of JSON's types."""
    return cast("dict[str, Any]", plain(_by_key(result)))


def _by_key(result: Any) -> dict[str, Any]:
    fitted = getattr(type(result), "parameter", None)
    found: dict[str, Any] = {"parameter": fitted} if isinstance(fitted, str) else {}
    for one in quantities(type(result)):
        value = _value(result, one)
        if one.key is None or (value is None and (one.optional or one.flat)):
            continue
        *group, key = one.key.split(".")
        inside = found.setdefault(group[0], {}) if group else found
        if one.length:
            inside |= lengths(key, value, result.unit, result.metres_per_unit)
        elif one.flat:
            inside |= cast("dict[str, Any]", plain(_nested(value)))
        elif one.interval_key:
            inside |= {key: getattr(value, "value", None), one.interval_key: getattr(value, "interval", None)}
        elif one.per_length:
            metres = 1.0 if result.unit == "m" else result.metres_per_unit
            inside[key] = None if metres is None else _times(value, 1.0 / metres)
        else:
            inside |= {key: _json(one, value)}
    return found


def _times(value: Any, scale: float) -> Any:
    """A number, an array, or a value with its interval."""
    if value is None or not hasattr(value, "interval"):
        return None if value is None else scale * value
    return {"value": scale * value.value, "interval": [scale * end for end in value.interval]}


def _value(result: Any, one: Quantity) -> Any:
    value = getattr(result, one.name)
    return value() if callable(value) else value


def units_of(kinds: Iterable[type]) -> dict[str, str]:
    """The units in the JSON of these results, by key."""
    every = [one for kind in kinds for one in quantities(kind) if one.unit]
    return {str(one.key): one.unit for one in sorted(every, key=lambda one: str(one.key))}


def lengths(name: str, value: Any, unit: str, metres_per_unit: float | None) -> dict[str, Any]:
    """A length, or an array of lengths, in JSON: `NAME_m` and `NAME_px`, None if unknown in that unit."""
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
    """Results inside a result are rendered by their declarations; undeclared ones are unchanged."""
    if dataclasses.is_dataclass(value) and quantities(type(value)):
        return _by_key(value)
    if isinstance(value, tuple | list):
        return [_nested(one) for one in value]
    if isinstance(value, Mapping):
        return {key: _nested(one) for key, one in value.items()}
    return value


def format_value(result: Any, name: str) -> str:
    """The text of one quantity: number, unit and interval; empty if unknown."""
    return _format(result, next(one for one in quantities(type(result)) if one.name == name))


def to_rows(result: Any, *names: str) -> Rows:
    """Quantities by their labels, each with its text; unknown ones are left out."""
    declared = {one.name: one for one in quantities(type(result))}
    shown = [(declared[name].label, _format(result, declared[name])) for name in names]
    return [row for row in shown if row[1]]


def to_columns(results: Sequence[Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Results of one kind as columns: names of all quantities with a value in any result, and each's values."""
    shown: list[tuple[str, list[str]]] = []
    for one in quantities(type(results[0])) if results else ():
        if one.label and one.interval_key:
            parts = [_numbers(getattr(result, one.name), one.digits) for result in results]
            shown += (one.label, [number for number, *_ in parts]), ("interval", [f"{a} to {b}" for _, a, b in parts])
        elif one.label:
            shown.append((one.label, [_format(result, one) for result in results]))
    known = [(label, words) for label, words in shown if any(words)]
    return tuple(label for label, _ in known), [*zip(*(words for _, words in known), strict=True)]


def _numbers(value: Any, digits: str, scale: float = 1.0, ends: Sequence[float] | None = None) -> list[str]:
    """A number and, where it has an interval, the ends."""
    ends = getattr(value, "interval", None) if ends is None else ends
    return [f"{scale * each:{digits}}" for each in (getattr(value, "value", value), *(() if ends is None else ends))]


def to_line(result: Any, kind: Literal["line", "caption"] = "line") -> str:
    """The main values in a line: all known quantities that declare a text for it."""
    shown = [(getattr(one, kind), one) for one in quantities(type(result))]
    known = [(form, words) for form, one in shown if form and (words := _format(result, one))]
    return ", ".join(form.format(words) for form, words in known)


def length_scale(unit: str, metres_per_unit: float | None) -> tuple[float, str]:
    """Factor of a length's display, and its unit."""
    if unit == "m":
        return 1e3, "mm"
    return (1.0, "px") if metres_per_unit is None else (1e3 * metres_per_unit, "mm")


def _format(result: Any, one: Quantity) -> str:
    value = _value(result, one)
    if one.words is not None:
        return one.words(result)
    if value is None:
        return one.missing
    if isinstance(value, str):
        return value
    scale, unit = one.scale, one.shown_unit
    if one.length or one.per_length:
        scale, unit = length_scale(result.unit, result.metres_per_unit)
    if one.per_length:
        scale, unit = 1.0 / scale, f"N/{unit}"
    ends = getattr(result, one.interval) if one.interval else None
    number, *around = _numbers(value, one.digits, scale, ends)
    between = " ({} to {})".format(*around) if around else ""
    return f"{number}{unit and f' {unit}'}{between}"


LOW, HIGH = "_low", "_high"
"""Suffixes of a quantity's name, for the ends of its interval."""
WORDS = 200
"""Most letters of a text in a column."""


def cells_of(result: Any) -> dict[str, Any]:
    """The cells of a result that declares its quantities, or of its JSON."""
    return to_cells(result if isinstance(result, Mapping) else to_json(result))


def cell_text(value: object) -> str:
    """The text of a cell in a table."""
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def to_cells(found: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Numbers, texts and booleans by the names of the JSON; nested names have a dot.

    A fitted value has the name of its `parameter`; an interval's ends are NAME_low and NAME_high; a list of results is
    its length, one of reasons their codes. Longer lists and texts are left out."""
    return dict(_cells(found, prefix))


def _cells(found: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    fitted = found.get("parameter")
    names = {"value": fitted} if isinstance(fitted, str) and "value" in found else {}
    for key, value in found.items():
        name = prefix + str(names.get(key, key))
        if "interval" in key and _is_interval(value):
            of = prefix + str(names.get("value", "value") if key == "interval" else _quantity(key, found))
            yield of + LOW, value[0]
            yield of + HIGH, value[1]
        elif isinstance(value, Mapping):
            if "value" in value and _is_interval(value.get("interval")):
                yield name, value["value"]
                yield from zip((name + LOW, name + HIGH), value["interval"], strict=True)
            else:
                yield from _cells(value, f"{name}.")
        elif isinstance(value, list):
            if value and all(isinstance(one, Mapping) for one in value):
                coded = "code" in value[0]
                yield name, ", ".join(str(one.get("code")) for one in value) if coded else len(value)
        elif not isinstance(value, str) or len(value) <= WORDS:
            yield name, value


def _quantity(key: str, found: Mapping[str, Any]) -> str:
    """The key of an interval's quantity: the unit may be in either, in both or in neither."""
    name = key.replace("_interval", "", 1)
    longer = [one for one in found if one.startswith(f"{name}_") and "interval" not in one]
    return longer[0] if name not in found and len(longer) == 1 else name


def _is_interval(value: Any) -> bool:
    return isinstance(value, Sequence) and len(value) == 2 and all(isinstance(one, int | float | None) for one in value)
