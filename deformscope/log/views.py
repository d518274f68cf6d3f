"""The registry of views: what logs a result of each type, and which stages it is of. What is recorded brings one, and
all are looked up here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeAlias, TypeVar

from deformscope.rows import ENTITIES

SinkT = TypeVar("SinkT")

View: TypeAlias = Callable[[SinkT, Any], None]
"""Logs a result to a sink: a stream of rerun, or a batch that becomes part of one."""


@dataclass(frozen=True, slots=True)
class ShownStage:
    """A stage of computation, as recordings have it.

    name: as its costs are named; chapter: of the thesis, 0 = what is recorded of the run itself; gives: in words
    entity: where its rows are, with what is below it, "" = that of its type of result
    field: of the result, without which a row holds nothing of the stage, "" = each does
    costs: names of what else is computed for it; asked: what has to be asked for to have it, "" = nothing
    expected: whether a run of these settings (of its recording) gives it
    """

    name: str
    chapter: int
    gives: str
    entity: str = ""
    field: str = ""
    costs: tuple[str, ...] = ()
    asked: str = ""
    expected: Callable[[Mapping[str, Any]], bool] = lambda settings: True


@dataclass(frozen=True, slots=True)
class Registered(Generic[SinkT]):
    """A type of result. stages: that it is a result of, one at least; views: none where it is recorded, not shown"""

    stages: tuple[ShownStage, ...]
    views: tuple[View[SinkT], ...] = ()

    def __post_init__(self) -> None:
        if not self.stages:
            raise ValueError("a view is registered with the stage that it shows")


Views: TypeAlias = Mapping[type, Registered[SinkT]]


def views_of(kind: type, views: Views[SinkT]) -> Sequence[View[SinkT]]:
    """The views of a type of result. Raises TypeError for a type that the registry lacks."""
    return _registered(kind, views).views


def stages_of(kind: type, views: Views[SinkT]) -> Sequence[ShownStage]:
    """The stages of a type of result. Raises TypeError for a type that the registry lacks."""
    return _registered(kind, views).stages


def entity_of(kind: type, stage: ShownStage) -> str:
    """Where the rows of a stage are."""
    return stage.entity or ENTITIES[kind]


def of_run(name: str, gives: str, *, asked: str = "where there is one") -> tuple[ShownStage]:
    """What is recorded of the run itself."""
    return (ShownStage(name, 0, gives, asked=asked, expected=lambda settings: not asked),)


def _registered(kind: type, views: Views[SinkT]) -> Registered[SinkT]:
    if kind not in views:
        raise TypeError(f"no twin in deformscope.log shows a {kind.__name__}")
    return views[kind]
