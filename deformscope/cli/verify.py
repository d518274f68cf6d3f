"""`deformscope verify`: whether a recording is whole.

deformscope verify run.rrd
deformscope verify run.rrd --stages
deformscope verify run.rrd --privacy
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import EXIT_LOSSES, say, show, show_table, write_json
from deformscope.config import VerifyConfig
from deformscope.errors import InputError
from deformscope.pictures.findings import table_text
from deformscope.recording.discards import Discard
from deformscope.recording.facts import Facts, read_facts, run_rrd
from deformscope.recording.ledger import LedgerCheck, check_recording, read_counts
from deformscope.recording.lock import is_being_written
from deformscope.recording.losses import named, to_text
from deformscope.recording.provenance import left_out
from deformscope.recording.reader import Replay, check_magic

if TYPE_CHECKING:
    from deformscope.recording.stages import RecordedStage

WHOLE = "all bytes are as recorded"
SHOWN_LETTERS = 90
"""Content of a recording."""
UNCHECKED = "not checked, because there is no ledger: a flipped bit would not be detected"


class Damaged(InputError):
    """The recording has changed, or was never finished."""


def run(config: VerifyConfig) -> int:
    """Check bytes, structure and completeness. Returns the exit status; raises Damaged where something is wrong."""
    path = config.recording
    if not path.is_file():
        part = next(iter(sorted(path.parent.glob(f"{path.stem}.part*{path.suffix}"))), None)
        hint = f"the unfinished one: {part}" if part is not None else ""
        raise InputError("a recording (.rrd)", "a folder" if path.is_dir() else "nothing there", hint, path)
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
    counts = (read_counts(path) if differs == [] else {}) or facts.counts  # a damaged ledger says nothing
    reached = "" if facts.until_s is None else f" until {facts.until_s:.1f} s"
    show_table(str(path), _rows(facts, check, structure, reached, counts, unfinished=unfinished))
    found: dict[str, Any] = {
        "recording": path,
        "ok": False if problems or unfinished else None if differs is None else True,
        "checked": differs is not None,
        "finished": not unfinished,
        "until_s": facts.until_s,
        "problems": problems,
        "truncated": check is not None and check.truncated,
        "committed_bytes": None if check is None else check.committed,
        "damaged": [] if check is None else check.damaged,
        "counts": counts,
        "outcome": outcome,
        "losses": facts.losses,
        "discarded": facts.discarded,
    }
    if config.stages and not problems:
        found["stages"] = _list_stages(path)
    if config.privacy and not problems:
        found["privacy"] = _list_private(path)
    write_json(found, config.json)
    if problems:
        hint = f"an intact copy, or its readable part: deformscope recover {path}"
        raise Damaged("a whole recording", "; ".join(dict.fromkeys(problems)), hint, path)
    if unfinished:
        kept = f"everything{reached} is there" if reached else "its readable part exists"
        raise Damaged("a finished recording", f"one of an interrupted run; {kept}", f"deformscope recover {path}", path)
    return _name_losses(facts, checked=differs is not None, reached=reached)


def _list_stages(path: Path) -> list[RecordedStage]:
    """Print them."""
    from deformscope.recording.stages import recorded_stages
    from deformscope.runs.recording_report import stage_tables

    stages = recorded_stages(path)
    show(*map(table_text, stage_tables(stages)))
    say(f"stages missing: {', '.join(one.name for one in stages if one.missing) or 'none'}")
    if not any(one.computed for one in stages):
        say("costs: not recorded, as in older and in deterministic recordings")
    return stages


def _list_private(path: Path) -> dict[str, str]:
    """Print information on people and machines, by its place."""
    from deformscope.recording.streams import RecordingTables

    replay = Replay(path, trust=True)
    found = left_out(replay.properties) | RecordingTables(replay).left_out()
    lines = {place: textwrap.shorten(said, SHOWN_LETTERS, placeholder=" ...") for place, said in found.items()}
    show_table("information on people and machines (export --anonymous leaves it out)", [*lines.items()])
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
    facts: Facts,
    check: LedgerCheck | None,
    structure: str,
    reached: str,
    counts: dict[str, int],
    *,
    unfinished: bool,
) -> list[tuple[str, str]]:
    ended = "unfinished: cut short" if unfinished else "complete" if facts.outcome.get("complete") else "NOT complete"
    if "recovered" in facts.outcome:
        ended = f"recovered from {facts.outcome['recovered']}, which was truncated"
    stopped = facts.outcome.get("stopped")
    devices = {name.rsplit("/", 1)[0] for name in counts if name.endswith("/frames")} | set(facts.losses)
    return [
        ("bytes", UNCHECKED if check is None else _bytes(check)),
        ("structure", structure or "readable to the end"),
        ("run", f"{ended}{reached}" + (f"; ended {stopped}" if stopped else "")),
        *(("discarded", str(Discard(**one))) for one in facts.discarded),
        *((name, str(count)) for name, count in sorted(counts.items()) if count),
        *((f"{name} lost", to_text(facts.losses.get(name, {})) or "nothing") for name in sorted(devices)),
    ]


def _name_losses(facts: Facts, *, checked: bool, reached: str) -> int:
    """Name the faults of a recording that is readable to its end."""
    remarks = []
    if facts.losses:
        remarks.append(f"losses: {named(facts.losses)}")
    if "recovered" in facts.outcome:
        remarks.append(f"it was recovered{reached}: later data are lost")
    if not checked:
        remarks.append("it has no ledger: changed bytes cannot be detected")
    for line in remarks:
        say(f"deformscope: {line}")
    return EXIT_LOSSES if remarks else 0
