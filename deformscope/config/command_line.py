"""The text of a command, from its options."""

from __future__ import annotations

import dataclasses

from tyro.conf import Positional
from tyro.constructors import PrimitiveConstructorSpec

from deformscope.config import flags
from deformscope.config.options import Flags, flags_of, marks_of

LEFT_OUT = frozenset({"viewer", "overwrite", "adjust"})
"""Flags of views and output, not of the computation."""


def command_line(name: str, options: Flags) -> list[str]:
    """The words of a command that computes the same result to the last bit, without output files and viewers. name: the
    command, such as `calibrate beta`"""
    return ["deformscope", *name.split(), *_arguments(options)]


def _arguments(options: Flags) -> list[str]:
    first: list[str] = []
    words: list[str] = []
    marks = marks_of(type(options))
    for field in dataclasses.fields(options):  # type: ignore[arg-type]  # all that derive from it are dataclasses
        value, said = getattr(options, field.name), marks[field.name]
        if isinstance(value, Flags):
            words += _arguments(value)
        elif Positional in said:
            first += map(str, value if isinstance(value, tuple) else (value,))
        elif (
            value != field.default
            and field.name not in LEFT_OUT
            and not any(isinstance(mark, flags.Writes) for mark in said)
        ):
            typed = next((mark for mark in said if isinstance(mark, PrimitiveConstructorSpec)), None)
            as_typed = [str(value)] if typed is None else [str(word) for word in typed.str_from_instance(value)]
            words += [flags_of(type(options))[field.name], *([] if value is True else as_typed)]
    return first + words
