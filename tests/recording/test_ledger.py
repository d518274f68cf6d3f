"""No flipped bit, and no lost or added byte, goes unnoticed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from deformscope.recording.ledger import BLOCK_BYTES, check_ledger, ledger_path, write_ledger


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "run.rrd"
    path.write_bytes(np.random.default_rng(0).bytes(2 * BLOCK_BYTES + 12345))
    write_ledger(path, {"frames": 7})
    return path


def test_intact(recording: Path) -> None:
    assert check_ledger(recording) == []
    content = json.loads(ledger_path(recording).read_text())
    assert content["size"] == recording.stat().st_size
    assert content["counts"] == {"frames": 7}
    assert len(content["blocks"]) == 3
    assert not list(recording.parent.glob("*.part"))


@pytest.mark.parametrize("place", [0, 1000, BLOCK_BYTES - 1, BLOCK_BYTES, 2 * BLOCK_BYTES + 12344])
@pytest.mark.parametrize("bit", [0, 7])
def test_any_flip_is_found_and_placed(recording: Path, place: int, bit: int) -> None:
    content = bytearray(recording.read_bytes())
    content[place] ^= 1 << bit
    recording.write_bytes(content)
    problems = check_ledger(recording)
    start = place // BLOCK_BYTES * BLOCK_BYTES
    assert len(problems) == 1
    assert f"bytes {start} to" in problems[0]


def test_lost_and_added_bytes(recording: Path) -> None:
    whole = recording.read_bytes()
    for content in (whole[:-1], whole + b"\0", whole[: BLOCK_BYTES + 5], b""):
        recording.write_bytes(content)
        assert "were recorded" in check_ledger(recording)[0]


def test_a_damaged_ledger_is_no_proof(recording: Path) -> None:
    text = ledger_path(recording).read_text()
    content = json.loads(text)
    for name in ("size", "sha256", "blocks", "counts"):
        changed = {**content, name: content[name] + 1 if name == "size" else "0"}
        ledger_path(recording).write_text(json.dumps(changed))
        assert "does not match itself" in check_ledger(recording)[0]
    for broken in (text[:-20], "", "[]", '{"format": "other"}'):
        ledger_path(recording).write_text(broken)
        assert "the ledger" in check_ledger(recording)[0]


def test_no_ledger_is_told_apart(recording: Path) -> None:
    ledger_path(recording).unlink()
    with pytest.raises(FileNotFoundError):
        check_ledger(recording)
