"""The registry of views: what logs a result of each type. What is recorded brings one, and all are looked up here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, TypeVar

SinkT = TypeVar("SinkT")

View: TypeAlias = Callable[[SinkT, Any], None]
"""Logs a result to a sink: a stream of rerun, or a batch that becomes part of one."""
Views: TypeAlias = Mapping[type, Sequence[View[SinkT]]]
"""The views of each type of result; none where it is recorded and not shown."""


def views_of(kind: type, views: Views[SinkT]) -> Sequence[View[SinkT]]:
    """The views of a type of result. Raises TypeError for a type that the registry lacks."""
    if kind not in views:
        raise TypeError(f"no twin in deformscope.log shows a {kind.__name__}")
    return views[kind]
