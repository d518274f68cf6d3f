"""Checks whether a recording is whole: its bytes, its structure, and the losses that it counted."""

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.recording.facts import Facts, read_facts, run_rrd
from deformscope.recording.ledger import Discard, LedgerCheck, check_recording, inherited, read_counts
from deformscope.recording.lock import is_being_written
from deformscope.recording.losses import named, to_text, without_frames
from deformscope.recording.provenance import left_out
from deformscope.recording.reader import Replay, check_exists, check_magic
from deformscope.runs.result import FoundResult

if TYPE_CHECKING:
    from deformscope.recording.stages import RecordedStage

WHOLE = "all bytes are as recorded"
SHOWN_LETTERS = 90
"""Content of a recording."""
UNCHECKED = "not checked, because there is no ledger: a flipped bit would not be detected"


class Damaged(InputError):
    """The recording has changed, or was never finished."""


@dataclass(frozen=True, slots=True)
class VerifyResult(FoundResult):
    """What `verify` found. error: what is wrong with the recording, None = it is whole; remarks: remarks on what is
    listed; losses: data that it lacks although it can be read completely"""

    error: Damaged | None = None
    remarks: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()

    @property
    def ok(self) -> bool | None:
        """Whether it is whole and finished; None = it has no ledger for a comparison of its bytes."""
        return None if self.found["ok"] is None else bool(self.found["ok"])


def verify_recording(path: Path, *, stages: bool = False, privacy: bool = False) -> VerifyResult:
    """Check bytes, structure and completeness; stages, privacy: list those too. Raises InputError for what is no
    recording, or one that a run is writing."""
    check_exists(path)
    if is_being_written(path):
        raise InputError("a finished recording", "one that a run is writing", "again after the run", path)
    check = _check(path)
    if check is None:
        check_magic(path)
    differs = None if check is None else check.problems
    structure = run_rrd("verify", path)
    if (
        check is not None and check.ended and not differs and "footer" in structure
    ):  # finished without one, as where the disk was short
        structure = run_rrd("verify", "--check-footers=false", path)
    # Without a path: what `recover` makes of it, with its ledger, goes to others.
    structure = structure.removeprefix(f'"{path}": ').replace(str(path), "it")
    facts = read_facts(path)
    outcome, recovered = facts.outcome, "recovered" in facts.outcome
    # Without a footer, or an outcome that says so, the run did not come to its end: that is no damage.
    unfinished = not recovered and not differs and ("footer" in structure or not outcome.get("complete"))
    problems = list(differs or ())
    if structure and not unfinished:
        problems.append(structure)
    if facts.damage and "footer" not in structure:
        problems.append(facts.damage)
    unfinished = unfinished and not problems
    before = [] if check is None else check.source_problems
    counts = (read_counts(path) if differs == [] else {}) or facts.counts  # a damaged ledger says nothing
    reached = "" if facts.until_s is None else f" until {facts.until_s:.1f} s"
    gone = f", but no frame of {', '.join(facts.absent)}" if facts.absent else ""
    state = "damaged" if problems else "interrupted" if unfinished else "readable" if check is None else "whole"
    state = "damaged before it was recovered" if before and state == "whole" else state
    rows = _rows(facts, check, structure, reached, counts, unfinished=unfinished)
    tables = [Table(rows, caption=f"{path}: {state}")]
    found: dict[str, Any] = {
        "recording": path,
        "ok": {"whole": True, "readable": None}.get(state, False),
        "checked": differs is not None,
        "finished": not unfinished,
        "until_s": facts.until_s,
        "problems": problems,
        "source_problems": before,
        "truncated": check is not None and check.truncated,
        "committed_bytes": None if check is None else check.committed,
        "damaged": [] if check is None else check.damaged,
        "counts": counts,
        "outcome": outcome,
        "losses": facts.losses,
        "absent": facts.absent,
        "discarded": facts.discarded,
    }
    remarks: list[str] = []
    if stages and not problems:
        found["stages"] = _stages(path, tables, remarks)
    if privacy and not problems:
        found["privacy"] = _private(path, tables)
    error = None
    if problems:
        hint = f"an intact copy, or its readable part: deformscope recover {path}"
        error = Damaged("a whole recording", "; ".join(dict.fromkeys(problems)) + gone, hint, path)
    elif unfinished:
        saved = f"everything{reached} is there{gone}" if reached else "its readable part exists"
        came = f"one of an interrupted run; {saved}"
        error = Damaged("a finished recording", came, f"deformscope recover {path}", path)
    losses = _losses(facts, checked=differs is not None, reached=reached) if error is None else []
    losses += [inherited(before)] if before and error is None else []
    return VerifyResult(found, tuple(tables), error, tuple(remarks), tuple(losses))


def _stages(path: Path, tables: list[Table], remarks: list[str]) -> "list[RecordedStage]":
    """The stages; their tables and what is to be remarked of them are added."""
    from deformscope.recording.stages import recorded_stages
    from deformscope.runs.recording_report import stage_tables

    stages = recorded_stages(path)
    tables += stage_tables(stages)
    remarks.append(f"stages missing: {', '.join(one.name for one in stages if one.missing) or 'none'}")
    if not any(one.computed for one in stages):
        remarks.append("costs: not recorded, as in deterministic recordings")
    return stages


def _private(path: Path, tables: list[Table]) -> dict[str, str]:
    """Information on people and machines, by its place; its table is added."""
    from deformscope.recording.streams import RecordingTables

    replay = Replay(path, trust=True)
    found = left_out(replay.properties) | RecordingTables(replay).left_out()
    lines = {place: textwrap.shorten(said, SHOWN_LETTERS, placeholder=" ...") for place, said in found.items()}
    title = "information on people and machines (export --anonymous leaves it out)"
    tables.append(Table([*lines.items()], caption=title))
    return found


def _check(path: Path) -> LedgerCheck | None:
    """The recording checked by its ledger; None without a ledger."""
    try:
        return check_recording(path)
    except FileNotFoundError:
        return None


def _bytes(check: LedgerCheck) -> str:
    if check.truncated:
        return "TRUNCATED" + (" and DIFFERS" if check.damaged else "")
    if check.problems:
        return "DIFFERS"
    return WHOLE if check.ended else f"as recorded up to the last commit (byte {check.committed})"


def _rows(
    facts: Facts, check: LedgerCheck | None, structure: str, reached: str, counts: dict[str, int], *, unfinished: bool
) -> list[tuple[str, str]]:
    ended = "unfinished: cut short" if unfinished else "complete" if facts.outcome.get("complete") else "NOT complete"
    if "recovered" in facts.outcome:
        ended = f"recovered from {facts.outcome['recovered']}, which was truncated"
    stopped = facts.outcome.get("stopped")
    devices = {name.rsplit("/", 1)[0] for name in counts if name.endswith("/frames")} | set(facts.losses)
    lost = {name: to_text(facts.losses.get(name, {})) or "nothing" for name in devices} | without_frames(facts.absent)
    return [
        ("bytes", UNCHECKED if check is None else _bytes(check)),
        ("structure", structure or "readable to the end"),
        ("run", f"{ended}{reached}" + (f"; ended {stopped}" if stopped else "")),
        *(("before", one) for one in ([] if check is None else check.source_problems)),
        *(("discarded", str(Discard(**one))) for one in facts.discarded),
        *((name, str(count)) for name, count in sorted(counts.items()) if count),
        *((f"{name} lost", lost[name]) for name in sorted(lost)),
    ]


def _losses(facts: Facts, *, checked: bool, reached: str) -> list[str]:
    """The faults of a recording that is readable to its end."""
    remarks = [f"{name}: {lost}" for name, lost in without_frames(facts.absent).items()]
    if facts.losses:
        remarks.append(f"losses: {named(facts.losses)}")
    if "recovered" in facts.outcome:
        remarks.append(f"it was recovered{reached}: later data are lost")
    if not checked:
        remarks.append("it has no ledger: changed bytes cannot be detected")
    return remarks
