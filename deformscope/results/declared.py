"""Declares for each quantity of a result, in its dataclass, its report: name, unit, format, place in the JSON.

A field has the declaration as its metadata, a property as its decorator:

    depth_m: float = field(metadata=reported("dent", unit="m", digits=".1f", scale=1e3, shown_unit="mm"))

    @property
    @derived("dent per force", unit="m/N")
    def dent_m_per_n(self) -> float: ...

Quantities are rendered in the order in which they are declared (`deformscope.results.render`). Undeclared values are
not reported, only recorded."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from typing import Any, ParamSpec, TypeVar, cast

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
