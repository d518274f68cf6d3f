"""Values of JSON's types, for results that are written and for results that are recorded."""

import dataclasses
import math
from pathlib import Path
from typing import Any, TypeAlias, cast

Json: TypeAlias = dict[str, object]
"""An object of JSON, by its keys."""


def plain(value: object) -> object:
    """`value` converted to JSON's types: dict, list, str, int, float, bool and None."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # arrays and their scalars, without importing numpy here
        return plain(cast(Any, value).tolist())
    raise TypeError(f"no JSON for {type(value).__name__}")
