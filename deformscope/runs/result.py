"""Common methods of all results: print, JSON, notebook; and common parts of all functions."""

import logging
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, cast

from deformscope.pictures.report import Figure, Findings, Table
from deformscope.plain import Json, plain
from deformscope.results.render import Rows

if TYPE_CHECKING:
    from deformscope.config.options import RecordedOptions, ViewOptions
    from deformscope.log.layout import Application
    from deformscope.recording.recorder import Recorder, RecordingSummary

ViewerChoice = Literal["auto", "native", "page", "none"]
Viewer = Literal["native", "page", "none"]
Note = Callable[[str], None]

log_note: Note = logging.getLogger("deformscope").warning
"""Destination of remarks outside a result, such as on units that look wrong."""


class LibraryResult(ABC):
    """A result: `str()` is its tables, `to_dict()` the JSON of the command line, and a notebook shows its pictures."""

    __slots__ = ()

    @abstractmethod
    def tables(self) -> tuple[Table, ...]:
        """The results, each table with its caption."""

    @abstractmethod
    def as_json(self) -> Json:
        """The public form; it may contain dataclasses and arrays."""

    def figures(self) -> tuple[Figure, ...]:
        """Pictures of the result."""
        return ()

    def findings(self) -> Findings:
        """Tables and pictures together."""
        return Findings(self.tables(), self.figures())

    def to_dict(self) -> Json:
        """The JSON of the command line as a dict of plain Python values; nan and infinities are None."""
        return cast("Json", plain(self.as_json()))

    def __str__(self) -> str:
        return str(Findings(self.tables()))

    def _repr_html_(self) -> str:
        return self.findings().html()


@dataclass(frozen=True, slots=True)
class FoundResult(LibraryResult):
    """What a command found or wrote. found: its JSON; shown: its tables for people"""

    found: Mapping[str, object]
    shown: tuple[Table, ...]

    def as_json(self) -> Json:
        return dict(self.found)

    def tables(self) -> tuple[Table, ...]:
        return self.shown


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceResult(LibraryResult):
    """Results of a source.

    name: name of the source; recording: recording of the run; problems: damage of the source; settings, seed: inputs
    that determine the result"""

    name: str = ""
    recording: "RecordingSummary | None" = None
    problems: tuple[str, ...] = ()
    settings: Mapping[str, object] = field(default_factory=dict)
    seed: int = 0

    def with_problems(self, found: Json) -> Json:
        """The JSON of the result, with the damage of the source."""
        return found | ({"source_problems": list(self.problems)} if self.problems else {})

    def source_rows(self) -> Rows:
        """Damage of the source, and the recording's place."""
        damaged = [("SOURCE DAMAGED", "; ".join(self.problems))] if self.problems else []
        return [*damaged, *([] if self.recording is None else recording_rows(self.recording))]


def resolve_viewer(choice: ViewerChoice) -> Viewer:
    """`auto` is rerun's window if there is a display, else none."""
    if choice != "auto":
        return choice
    return "native" if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") else "none"


def settings_of(config: "RecordedOptions") -> dict[str, object]:
    """All flags of a command, as its recording keeps them."""
    command = type(config).__name__.removesuffix("Config").lower()
    return {"command": command, **cast("dict[str, object]", plain(config))}


def open_recorder(
    output: "ViewOptions", settings: Mapping[str, object], application: "Application", **more: Any
) -> "Recorder":
    """Recorder and viewer of the options. more: options of a `Recorder`"""
    from deformscope.recording.recorder import Recorder

    viewer = resolve_viewer(output.viewer)
    return Recorder(output.record, viewer, settings, application=application, overwrite=output.overwrite, **more)


def recording_rows(recording: "RecordingSummary") -> Rows:
    """The recording's place, and items that a live view did not show."""
    rows = []
    if recording.path is not None:
        rows.append(("recording", f"{recording.path} ({recording.bytes / 1e6:.1f} MB)"))
    if recording.dropped:
        rows.append(("live view", f"{recording.dropped} items dropped; the recording has them all"))
    return rows
