"""Outcome of a replay, and the comparison of recorded results with those computed again."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from deformscope.errors import InputError
from deformscope.pictures.report import Figure, Table
from deformscope.plain import Json
from deformscope.results.render import WORDING, is_declared
from deformscope.rows import differing
from deformscope.runs.result import LibraryResult

CLOSE = 0.01
"""Largest difference due to another machine's arithmetic: of the value and its interval as a share of the interval's
width, of an error as a share of the error. On one machine there is no difference."""
VERSIONS = "the versions in the recording's properties"
"""Remedies for different numbers."""


class Different(InputError):
    """The new results differ from the recorded ones."""


@dataclass(frozen=True, slots=True)
class ReplayResult(LibraryResult):
    """Results of a recording, computed again.

    found: the JSON of `deformscope replay`, a list where several pairs were fitted; shown: results with their tables
    verdict: comparison with the recorded result; notes: failures and stops during the recording
    different: the differences, if the results are known nevertheless, else None"""

    found: Json | list[Json]
    shown: tuple[LibraryResult | Table, ...] = ()
    verdict: str = ""
    notes: tuple[str, ...] = ()
    different: Different | None = None

    def as_json(self) -> Json | list[Json]:  # type: ignore[override]  # a list of several pairs
        return self.found

    def tables(self) -> tuple[Table, ...]:
        shown = [(one,) if isinstance(one, Table) else one.tables() for one in self.shown]
        said = [("", words) for words in (self.verdict, *self.notes) if words]
        return (*([Table(said, caption="replay")] if said else []), *(table for tables in shown for table in tables))

    def figures(self) -> tuple[Figure, ...]:
        return tuple(figure for one in self.shown if not isinstance(one, Table) for figure in one.figures())


def _without_words(value: Any) -> Any:
    """A result whose texts are empty where another version may word them differently (`WORDING`)."""
    if type(value) is tuple:
        return tuple(map(_without_words, value))
    if not is_dataclass(value) or isinstance(value, type):
        return value
    changed: dict[str, Any] = {
        one.name: "" if is_declared(one, WORDING) else _without_words(getattr(value, one.name))
        for one in fields(value)
        if one.init
    }
    return replace(value, **changed)


def compare(
    recorded: Sequence[object],
    computed: Sequence[object],
    path: Path,
    leave_out: Callable[[object], Collection[str]] = lambda before: (),
    *,
    what: str = "results",
    cut_short: bool = False,
    distance: Callable[[Any, Any], float] | None = None,
) -> float | None:
    """Raises Different unless each recorded result is as computed, to the last bit. path: path of the recording

    leave_out: fields of a result that may differ; cut_short: more may have been computed than was recorded
    distance: compares two results that may differ by less than `CLOSE`, returns their largest difference; None = no
    difference is allowed"""
    if len(recorded) > len(computed) or (len(recorded) < len(computed) and not cut_short):
        raise Different(f"{len(recorded)} {what} as recorded", str(len(computed)), where=path)
    found: list[float] = []
    for before, now in zip(recorded, computed, strict=False):
        if type(before) is not type(now):
            raise Different(f"a {type(before).__name__}, as recorded", f"a {type(now).__name__}", where=path)
        if (name := differing(_without_words(before), _without_words(now), leave_out(before))) is not None:
            if distance is None:
                came = f"another {name} of {type(before).__name__}"
                raise Different("the recorded numbers, to the last bit", came, VERSIONS, path)
            found.append(distance(before, now))
    if found and max(found) > CLOSE:
        came = f"numbers that differ by {max(found):.1%} of the interval or error"
        raise Different("the recorded numbers", came, VERSIONS, path)
    return max(found, default=None)
