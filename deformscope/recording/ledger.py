"""The ledger beside a recording: what its bytes were when it was closed, so that no flipped bit goes unnoticed.

A recording has no checksum of its own, and most single bit flips in one are read without complaint.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FORMAT = "deformscope-ledger-1"
BLOCK_BYTES = 1 << 20


def ledger_path(recording: Path) -> Path:
    """`run.rrd` has the ledger `run.rrd.ledger`; a link without one has that of what it leads to."""
    beside = recording.with_name(recording.name + ".ledger")
    if recording.is_symlink() and not beside.exists():
        target = Path(os.path.realpath(recording))
        return target.with_name(target.name + ".ledger")
    return beside


Losses = Mapping[str, Mapping[str, float]]
"""What devices lost, by device and kind (`deformscope.recording.losses`)."""


def write_ledger(recording: Path, counts: Mapping[str, int] | None = None, losses: Losses | None = None) -> Path:
    """Write down the size and the SHA-256 of the whole and of every MiB.

    counts: what was recorded, by kind; losses: what was not
    """
    size, whole, blocks = _digest(recording)
    content: dict[str, Any] = {
        "format": FORMAT,
        "size": size,
        "sha256": whole,
        "block_bytes": BLOCK_BYTES,
        "blocks": blocks,
        "counts": dict(counts or {}),
        "losses": dict(losses or {}),
    }
    return _write(recording, content)


def add_discard(recording: Path, entry: Mapping[str, object]) -> Path:
    """Write down that the recording, or a part of it, is not to be used; all else stays."""
    content = json.loads(ledger_path(recording).read_text(encoding="utf-8"))
    content.pop("ledger_sha256")
    content["discarded"] = [*content.get("discarded", ()), dict(entry)]
    return _write(recording, content)


def read_discards(recording: Path) -> list[dict[str, Any]]:
    """What `add_discard` wrote; nothing where there is no ledger, or one that cannot be read."""
    try:
        found = json.loads(ledger_path(recording).read_text(encoding="utf-8"))["discarded"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _write(recording: Path, content: dict[str, Any]) -> Path:
    # The ledger answers for itself as well: a flip in it must not pass for one in the recording.
    content["ledger_sha256"] = _seal(content)
    path = ledger_path(recording)
    new = path.with_name(path.name + ".part")
    with new.open("w", encoding="utf-8") as file:
        json.dump(content, file, indent=1)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)
    return path


def check_ledger(recording: Path) -> list[str]:
    """What differs between a recording and its ledger, one line each; empty when every byte is as it was.

    Raises FileNotFoundError where there is no ledger: nothing can then be said.
    """
    try:
        content = json.loads(ledger_path(recording).read_text(encoding="utf-8"))
    except ValueError:
        return ["the ledger cannot be read: it is damaged"]
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        return [f"the ledger is not one of format {FORMAT}: it is damaged or newer"]
    if content.pop("ledger_sha256", None) != _seal(content):
        return ["the ledger does not match itself: it is damaged"]

    size, whole, blocks = _digest(recording)
    if size == content["size"] and whole == content["sha256"]:
        return []
    problems = []
    if size != content["size"]:
        problems.append(f"{size} bytes where {content['size']} were recorded")
    for index, (now, then) in enumerate(zip(blocks, content["blocks"], strict=False)):
        if now != then:
            start = index * BLOCK_BYTES
            problems.append(f"bytes {start} to {min(start + BLOCK_BYTES, size)} differ from what was recorded")
    return problems or ["the recording differs from what was recorded"]


def read_counts(recording: Path) -> dict[str, int]:
    """What the ledger says was recorded, by kind; raises FileNotFoundError where there is none."""
    content = json.loads(ledger_path(recording).read_text(encoding="utf-8"))
    return {str(name): int(count) for name, count in content.get("counts", {}).items()}


def _digest(path: Path) -> tuple[int, str, list[str]]:
    """Size in bytes, SHA-256 of the whole, SHA-256 of each block."""
    whole = hashlib.sha256()
    blocks = []
    size = 0
    with path.open("rb") as file:
        while block := file.read(BLOCK_BYTES):
            whole.update(block)
            blocks.append(hashlib.sha256(block).hexdigest())
            size += len(block)
    return size, whole.hexdigest(), blocks


def _seal(content: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
