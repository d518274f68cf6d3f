"""`deformscope verify`: whether a recording is whole.

deformscope verify run.rrd
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

from deformscope.cli.common import show_table, write_json
from deformscope.config import VerifyConfig
from deformscope.errors import InputError
from deformscope.ledger import check_ledger, read_counts

VERIFY_TIMEOUT_S = 600.0
WHOLE = "every byte is as it was recorded"


class Damaged(InputError):
    """The recording is not what it was."""


def run(config: VerifyConfig) -> None:
    """Check bytes, structure and completeness; raises Damaged where something is wrong."""
    path = config.recording
    if not path.is_file():
        part = next(iter(sorted(path.parent.glob(f"{path.stem}.part*{path.suffix}"))), None)
        hint = f"the unfinished one: {part}" if part is not None else ""
        raise InputError("a recording (.rrd)", "a folder" if path.is_dir() else "nothing there", hint, path)
    problems: list[str] = []
    ledger = WHOLE
    try:
        problems += check_ledger(path)
        ledger = "DIFFERS" if problems else ledger
    except FileNotFoundError:
        ledger = "none: a flipped bit would go unnoticed"
    structure = _structure(path)
    if structure:
        problems.append(structure)
    outcome = _outcome(path)
    if not outcome.get("complete"):
        problems.append("the run did not end by itself: it was cut short or failed")
    counts = read_counts(path) if ledger == WHOLE else {}  # a damaged ledger tells nothing
    losses = _loss_rows(path)
    complete = "complete" if outcome.get("complete") else "NOT complete"
    rows = [
        ("bytes", ledger),
        ("structure", structure or "readable to the end"),
        ("run", f"{complete}; stopped: {outcome['stopped']}" if outcome.get("stopped") else complete),
        *((name, str(count)) for name, count in sorted(counts.items()) if count),
        *losses,
    ]
    show_table(str(path), rows)
    found: dict[str, Any] = {"recording": path, "ok": not problems, "problems": problems, "counts": counts}
    write_json({**found, "outcome": outcome, "losses": dict(losses)}, config.json)
    if problems:
        raise Damaged("a whole recording", "; ".join(problems), "rerun shows what there is", path)


def _structure(path: Path) -> str:
    """What rerun's own check finds wrong, in a line; empty = nothing."""
    from deformscope.live import viewer_executable

    command = [str(viewer_executable()), "rrd", "verify", str(path)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=VERIFY_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return f"its structure was not read within {VERIFY_TIMEOUT_S:g} s"
    if done.returncode == 0:
        return ""
    said = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
    return " ".join(said[-1].split())[:300] if said else "rerun refuses it without a word"


def _outcome(path: Path) -> dict[str, Any]:
    """How the run ended, as far as the recording can be read."""
    from deformscope.replay import Replay

    try:
        return dict(Replay(path, trust=True).outcome)
    except Exception:  # damaged: the structure's line says so
        return {}


def _loss_rows(path: Path) -> list[tuple[str, str]]:
    """What each device of a rig lost, by the last look at its health."""
    from deformscope.cli.record import losses
    from deformscope.frames import HealthReport
    from deformscope.rig_replay import read_items

    last: HealthReport | None = None
    try:
        for item in read_items(path, trust=True, kinds=("health",)):
            last = item if isinstance(item, HealthReport) else last
    except Exception:  # damaged: the structure's line says so
        return []
    return [
        (f"{name} lost", ", ".join(f"{count} {what}" for what, count in losses(health).items() if count) or "nothing")
        for name, health in (() if last is None else last.devices)
    ]
