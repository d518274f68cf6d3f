"""The registry of views: for each type of result the logging function, and the stages that give it. Every
recorded type has one, and all are looked up here."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

SinkT = TypeVar("SinkT")

View: TypeAlias = Callable[[SinkT, Any], None]
"""Logs a result to a sink: a stream of rerun, or a batch that becomes part of one."""
SOMETIMES = "sometimes"


@dataclass(frozen=True, slots=True)
class ShownStage:
    """A stage of computation: its name, and where recordings store its results.

    name: its name, also that of its costs; chapter: chapter of the thesis, 0 = records of the run itself; gives: its
    result in words; entity: place of its rows, with entities below it, "" = that of its type of result
    field: field of the result, without which a row holds nothing of the stage, "" = each does
    costs: names of other stages that are computed for it; when: the setting of a recording that requests it, such as
    `explore.hold_s`, or a setting with one of its values, such as `stages.names=beta`. Several, separated by spaces,
    are all needed; "" = it is always present, `SOMETIMES` = it may be absent"""

    name: str
    chapter: int
    gives: str
    entity: str = ""
    field: str = ""
    costs: tuple[str, ...] = ()
    when: str = ""

    def is_expected(self, settings: Mapping[str, Any]) -> bool:
        """Whether a run gives this result, by the settings of its recording."""
        return all(_holds(one, settings) for one in self.when.split())


def _holds(when: str, settings: Mapping[str, Any]) -> bool:
    path, _, wanted = when.partition("=")
    value: Any = settings
    for name in path.split("."):
        value = value.get(name, {})
    return wanted in value if wanted else value not in ({}, "none", "", 0)


Views: TypeAlias = Mapping[type, Sequence[ShownStage | View[SinkT]]]
"""For each type of result its stages, at least one, and its view; None if it is recorded and not shown."""


class OwnView(ABC):
    """A result that brings its view: that of a study, which no other recording holds."""

    @abstractmethod
    def log(self, rec: Any) -> None:
        """Log it to a stream of rerun."""


def views_of(kind: type, views: Views[SinkT]) -> Sequence[View[SinkT]]:
    """The views of a type of result. Raises TypeError for a type that the registry lacks."""
    if kind not in views:
        raise TypeError(f"no twin in deformscope.log shows a {kind.__name__}")
    return [one for one in views[kind] if not isinstance(one, ShownStage)]


def stages_of(kind: type, views: Views[SinkT]) -> Sequence[ShownStage]:
    """The stages of a type of result."""
    return [one for one in views[kind] if isinstance(one, ShownStage)]
