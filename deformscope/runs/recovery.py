"""Makes a complete recording from an unfinished or truncated one."""

import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.recording.facts import Facts, run_rrd, salvage
from deformscope.recording.ledger import read_counts, read_discards, write_ledger
from deformscope.recording.losses import to_text, without_frames
from deformscope.recording.reader import check_exists, check_magic
from deformscope.recording.rrd_file import write_outcome
from deformscope.recording.target import remove_strays
from deformscope.runs.result import FoundResult
from deformscope.runs.verification import verify_recording


def recover_recording(path: Path, out: Path | None = None) -> FoundResult:
    """Write the readable part of a recording as a new one, with its ledger, which has what `verify` says against the
    original. That is only read."""
    out = out or path.with_name(f"{path.stem.split('.part')[0]}.recovered.rrd")
    before = _check(path, out)
    # Beside the new file, so that the last step is a rename.
    with tempfile.TemporaryDirectory(prefix=f".{out.stem}.", suffix=".part", dir=out.parent) as scratch:
        readable, ending, whole = (Path(scratch) / name for name in ("readable.rrd", "ending.rrd", "whole.rrd"))
        # Not `optimize`, which tears rows apart: what belongs to one frame would lie in several portions.
        facts, damage = salvage(path, readable)
        if facts.damage or not facts.counts:
            came = "; ".join([facts.damage or "none of it", *before["problems"]])
            raise InputError("a recording with readable parts", came, where=path)
        # data that the run could not write at its end
        write_outcome(
            ending,
            facts.application,
            facts.recording,
            {"complete": False, "recovered": path.name, "losses": facts.losses, "counts": facts.counts},
        )
        if refused := run_rrd("merge", readable, ending, "-o", whole):
            raise InputError("a recording that can be completed", refused, where=path)
        with whole.open("rb") as file:
            os.fsync(file.fileno())
        _refuse_existing(out)
        whole.replace(out)
    remove_strays(path.parent)
    discarded, problems = read_discards(path), [*before["source_problems"], *before["problems"]]
    write_ledger(out, facts.counts, facts.losses, discarded=discarded, source_problems=problems)
    # Of a ledger that fits: another recording's may lie there.
    then = {} if before["damaged"] else read_counts(path)
    return _report(path, out, facts, damage, problems, then)


def _check(path: Path, out: Path) -> Mapping[str, Any]:
    """What `verify` says of a recording that can be recovered."""
    check_exists(path)
    check_magic(path)
    if not out.parent.is_dir():
        raise InputError("a new file in a folder that exists", "no such folder", "make it first", out.parent)
    _refuse_existing(out)
    if (before := verify_recording(path)).error is None:
        raise InputError("a truncated recording", "a finished one", f"deformscope verify {path}", path)
    free, need = shutil.disk_usage(out.parent).free, 3 * path.stat().st_size
    if free < need:
        raise InputError(f"{need >> 20} MiB free on the disk", f"{free >> 20} MiB", "--out on another disk", out.parent)
    return before.found


def _refuse_existing(out: Path) -> None:
    if out.exists() or out.is_symlink():
        raise InputError("a new file to write", "one that exists", "--out FILE.rrd", out)


def _report(
    path: Path, out: Path, facts: Facts, damage: str, problems: Sequence[str], then: Mapping[str, int]
) -> FoundResult:
    """damage: where reading ended before the end of the file, empty = nowhere; problems: how the original differs from
    its ledger; then: what was recorded, by kind, as far as known"""
    there = {name: facts.counts.get(name, 0) for name in then if name in facts.counts or name.endswith("/frames")}
    missing = {name: then[name] - count for name, count in there.items() if then[name] > count}
    until = "" if facts.until_s is None else f"until {facts.until_s:.2f} s"
    lost = {name: to_text(counts) for name, counts in facts.losses.items()} | without_frames(facts.absent)
    rows = [
        ("recovered", f"{out} ({out.stat().st_size / 1e6:.1f} MB), with its ledger"),
        *(("DIFFERS", one) for one in problems),
        (
            "there is",
            f"{'what is readable' if problems else 'everything'} {until}"
            + (f", but no frame of {', '.join(facts.absent)}" if facts.absent else ""),
        ),
        *((name, str(count)) for name, count in sorted(facts.counts.items())),
        *((f"{name} lost", words) for name, words in sorted(lost.items())),
        ("lost", ", ".join(f"{count} {name}" for name, count in missing.items()) or "what came after"),
        *((("damage", f"{damage}: nothing after it is readable"),) if damage else ()),
        ("original", f"{path}: unchanged"),
    ]
    found = {
        "recording": path,
        "recovered": out,
        "until_s": facts.until_s,
        "counts": facts.counts,
        "losses": facts.losses,
        "absent": facts.absent,
        "missing": missing,
        "damage": damage,
        "problems": problems,
    }
    return FoundResult(found, (Table(rows, caption=str(path)),))
