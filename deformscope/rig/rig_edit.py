"""Writes values into a rig file, whose comments and order do not change.

The text is changed line by line, then read again: all values that were not edited must be unchanged.
Otherwise no file is written, and the user has to insert the lines."""

import datetime
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from deformscope.errors import InputError

TomlValue = bool | int | float | str | datetime.date | Sequence[Any]
Values = Mapping[str, Mapping[str, TomlValue]]
"""Values by section ("tool", "calibrated.tip"), then by key."""
DIGITS = ".9g"
"""Format of numbers in a rig file."""
HEADER = re.compile(r"\s*\[+\s*[\w\"'.-]+\s*\]+\s*(#.*)?$")


def lines_of(values: Values, digits: str = DIGITS) -> str:
    """The values as lines of a rig file. digits: as in `toml_value`"""
    return "\n".join(
        "\n".join([f"[{section}]", *(f"{key} = {toml_value(value, digits)}" for key, value in keys.items())])
        for section, keys in values.items()
    )


def edited(text: str, values: Values) -> str:
    """The text of a rig file with values set. Raises InputError, with the lines, if the file cannot be edited."""
    lines = text.splitlines()
    for section, keys in values.items():
        for key, value in keys.items():
            _set(lines, section, key, toml_value(value, DIGITS))
    made = "\n".join(lines) + "\n"
    try:
        wanted = tomllib.loads(text)
        for section, keys in values.items():
            table = wanted
            for name in section.split("."):
                table = table.setdefault(name, {})
            table.update(
                tomllib.loads("\n".join(f"{key} = {toml_value(value, DIGITS)}" for key, value in keys.items()))
            )
        same = tomllib.loads(made) == wanted
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        by_hand = lines_of(values).replace("\n", "; ")
        raise InputError("a rig file with plain [SECTION] lines", "another notation", by_hand)
    return made


def _set(lines: list[str], section: str, key: str, value: str) -> None:
    """Put `key = value` in the place of an existing value, else at the end of its section, else into a new section."""
    header = re.compile(rf"\s*\[\s*{re.escape(section)}\s*\]\s*(#.*)?$")
    start = next((index for index, line in enumerate(lines) if header.match(line)), None)
    if start is None:
        while lines and not lines[-1].strip():
            lines.pop()
        lines += [*([""] if lines else []), f"[{section}]", f"{key} = {value}"]
        return
    end = next((index for index in range(start + 1, len(lines)) if HEADER.match(lines[index])), len(lines))
    for index in range(start + 1, end):
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[index]):
            last = _end_of_value(lines, index, end)
            lines[index : last + 1] = [f"{key} = {value}"]
            return
    while end > start + 1 and (not lines[end - 1].strip() or lines[end - 1].lstrip().startswith("#")):
        end -= 1
    lines.insert(end, f"{key} = {value}")


def _end_of_value(lines: list[str], first: int, end: int) -> int:
    """The last line of a value that may go over several."""
    for last in range(first, end):
        try:
            tomllib.loads("\n".join(lines[first : last + 1]))
            return last
        except tomllib.TOMLDecodeError:
            continue
    return first


def toml_value(value: Any, digits: str = "") -> str:
    """A value on one line. digits: format of real numbers, empty = all digits"""
    if isinstance(value, bool | int | str):
        text = json.dumps(value, ensure_ascii=False)
        return "".join(one if one.isprintable() else f"\\U{ord(one):08x}" for one in text)
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, Mapping):
        inner = (f"{toml_value(name)} = {toml_value(one, digits)}" for name, one in value.items())
        return "{" + ", ".join(inner) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(one, digits) for one in value) + "]"
    number = format(float(value), digits)
    return number if any(mark in number for mark in ".en") else f"{number}.0"
