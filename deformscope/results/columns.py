"""Results as columns of a table: their JSON, by names that a filter can use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from deformscope.results.render import to_json

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
