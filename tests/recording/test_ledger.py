"""No flipped bit, and no lost or added byte, goes unnoticed, and what it concerns is named."""

import resource
import shutil
import struct
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from deformscope.recording import ledger
from deformscope.recording.facts import salvage
from deformscope.recording.ledger import (
    BLOCK_BYTES,
    LedgerBlock,
    LedgerWriter,
    add_discard,
    check_recording,
    ledger_path,
    read_counts,
    read_discards,
    read_ledger,
    write_ledger,
)
from deformscope.recording.rrd_index import TAIL_BYTES, read_index

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "recordings" / "rig.rrd"
HEADER = 16
"""Bytes before the payload of each message of a file: its kind and its length (uint64)."""
QUICK, ALL = (200, 10), (10_000, 1_000)
"""Flips and truncations: by default, and with `-m slow`."""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Bytes without an index of portions."""
    path = tmp_path / "run.rrd"
    path.write_bytes(np.random.default_rng(0).bytes(2 * BLOCK_BYTES + 12345))
    write_ledger(path, {"frames": 7})
    return path


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a whole rig with its ledger."""
    path = tmp_path_factory.mktemp("sample") / "rig.rrd"
    shutil.copy(SAMPLE, path)
    write_ledger(path, {"tip/frames": 1448})
    return path


@dataclass(frozen=True)
class Message:
    """A message of a recording, as rerun's own reader has it. span_s: session time of its rows"""

    start: int
    end: int
    entity: str
    span_s: tuple[float, float] | None


def messages(path: Path) -> list[Message]:
    """Those of portions with rows in time, found by the framing of the file and the ids of portions."""
    known = {}
    for chunk in RrdReader(path).stream():
        times = chunk.to_record_batch()
        span = None
        if "session" in chunk.timeline_names:
            values = [value for value in times.column("session").cast("int64").to_pylist() if value is not None]
            span = (min(values) / 1e9, max(values) / 1e9)
        known[chunk.id.removeprefix("chunk_").lower()] = (chunk.entity_path.removeprefix("/"), span)
    content, at, found = path.read_bytes(), 12, []
    while True:
        kind, length = struct.unpack_from("<QQ", content, at)
        if kind == 0:
            return found
        payload = content[at + HEADER : at + HEADER + length]
        mark = payload.rfind(b"\x32\x12\x09")  # the id of a portion: two fixed numbers
        if kind == 2 and mark >= 0:
            (high,), (low,) = (struct.unpack_from("<Q", payload, mark + offset) for offset in (3, 12))
            entity, span = known.get(f"{high:016x}{low:016x}", ("", None))
            if entity and span is not None:
                found.append(Message(at, at + HEADER + length, entity, span))
        at += HEADER + length


def flipped(path: Path, place: int, bit: int) -> None:
    with path.open("r+b") as file:
        file.seek(place)
        (byte,) = file.read(1)
        file.seek(place)
        file.write(bytes([byte ^ 1 << bit]))


def test_intact(recording: Path) -> None:
    assert check_recording(recording).problems == []
    ledger = read_ledger(recording)
    assert ledger.ended["size"] == recording.stat().st_size
    assert read_counts(recording) == {"frames": 7}
    assert len(ledger.blocks) == 3
    assert not list(recording.parent.glob("*.part"))


def test_portions_are_those_of_the_file(sample: Path) -> None:
    """The ledger's blocks against the file's framing and rerun's own reader."""
    assert check_recording(sample).problems == []
    blocks = {(one.start, one.end): one for one in read_ledger(sample).blocks}
    found = messages(sample)
    assert len(found) > 50
    for message in found:
        block = blocks[message.start, message.end]
        assert block.streams == (message.entity,)
        assert (block.from_s, block.to_s) == pytest.approx(message.span_s, abs=1e-9)


def test_an_index_of_any_length_or_place_is_none(tmp_path: Path) -> None:
    whole, path = SAMPLE.read_bytes(), tmp_path / "r.rrd"
    for place in range(16):  # of the footer: uint64 where it begins, uint64 how long it is
        for bit in (0, 5, 7):
            content = bytearray(whole)
            content[place - TAIL_BYTES] ^= 1 << bit
            path.write_bytes(content)
            assert read_index(path) == [], (place, bit)


@pytest.mark.parametrize("place", [0, 1000, BLOCK_BYTES - 1, BLOCK_BYTES, 2 * BLOCK_BYTES + 12344])
@pytest.mark.parametrize("bit", [0, 7])
def test_any_flip_is_found_and_placed(recording: Path, place: int, bit: int) -> None:
    flipped(recording, place, bit)
    problems = check_recording(recording).problems
    start = place // BLOCK_BYTES * BLOCK_BYTES
    assert len(problems) == 1
    assert f"bytes {start} to" in problems[0]


@pytest.mark.parametrize("count", [QUICK[0], pytest.param(ALL[0], marks=pytest.mark.slow)])
def test_flips_over_file_and_ledger_are_noticed_and_placed(sample: Path, count: int) -> None:
    """Of a file: the block of that byte, its stream and seconds. Of a ledger: its line."""
    rng, ledger = np.random.default_rng(count), ledger_path(sample)
    size, timed = sample.stat().st_size, messages(sample)
    for flip in range(count):
        path = ledger if flip % 4 == 0 else sample
        place, bit = int(rng.integers(path.stat().st_size)), int(rng.integers(8))
        line = path.read_bytes()[:place].count(b"\n") + 1 if path == ledger else 0
        flipped(path, place, bit)
        check = check_recording(sample)
        flipped(path, place, bit)
        assert check.problems, (path, place, bit)
        if path == sample:
            (block,) = check.damaged
            assert block.start <= place < block.end <= size
            assert not check.truncated
            for message in timed:
                if message.start <= place < message.end:
                    assert block.streams == (message.entity,)
                    assert f"{message.entity}, {block.from_s:.3f} to {block.to_s:.3f} s" in check.problems[0]
        else:
            assert not check.damaged
            told = check.problems[0]
            # a flipped end of a line damages that line and what follows it
            assert line == 1 or f"in line {line}" in told or "cut off" in told or "at its end" in told, told
    assert check_recording(sample).problems == []


@pytest.mark.parametrize("count", [QUICK[1], pytest.param(ALL[1], marks=pytest.mark.slow)])
def test_truncations_are_told_as_such(sample: Path, tmp_path: Path, count: int) -> None:
    """And what is missing is named; what is left is recovered (of every tenth) up to the last whole portion."""
    rng, timed = np.random.default_rng(count), messages(sample)
    whole, cut = sample.read_bytes(), tmp_path / "cut.rrd"
    shutil.copy(ledger_path(sample), ledger_path(cut))
    for number in range(count):
        size = int(rng.integers(len(whole)))
        cut.write_bytes(whole[:size])
        check = check_recording(cut)
        assert (check.truncated, check.damaged, check.ended) == (True, [], True)
        lost = [one for one in timed if one.end > size]
        assert f"truncated: {size} bytes where {len(whole)} were recorded" in check.problems[0]
        if lost:
            first_s = min(one.span_s[0] for one in lost if one.span_s is not None)
            assert f"from {first_s:.3f} s of " in check.problems[0]
        if number % 10 == 0 and len(lost) < len(timed):
            facts, _ = salvage(cut, tmp_path / "saved.rrd")
            kept = {one.entity for one in timed if one.end <= size}
            assert facts.damage == ""
            frames = {name.removesuffix("/frames") for name in facts.counts if name.endswith("/frames")}
            assert {one.split("/")[-1] for one in kept if one == "wrench/tip"} <= frames


def test_truncated_is_told_from_damaged(sample: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.rrd"
    shutil.copy(ledger_path(sample), ledger_path(cut))
    content = bytearray(sample.read_bytes()[:2_200_000])
    block = next(one for one in read_ledger(sample).blocks if one.streams == ("wrench/tip",))
    content[block.start + 100] ^= 8
    cut.write_bytes(content)
    check = check_recording(cut)
    assert check.truncated
    assert check.damaged == [block]
    assert ["truncated" in check.problems[0], "wrench/tip" in check.problems[1]] == [True, True]


def test_a_ledger_that_grows_answers_for_what_was_committed(tmp_path: Path) -> None:
    path, rng = tmp_path / "run.part.rrd", np.random.default_rng(0)
    path.write_bytes(b"")
    writer = LedgerWriter(ledger_path(path), path)
    for second in range(4):
        with path.open("ab") as file:
            file.write(rng.bytes(1000))
        writer.commit(path.stat().st_size, ("wrench/tip",), (float(second), second + 1.0))
    writer.close()
    with path.open("ab") as file:
        file.write(rng.bytes(77))
    check = check_recording(path)  # its run may go on, or have been killed
    assert (check.problems, check.ended, check.committed) == ([], False, 4000)
    whole = path.read_bytes()
    path.write_bytes(whole[:2500])
    check = check_recording(path)
    assert (check.truncated, check.damaged) == (True, [])
    assert "from 2.000 s of wrench/tip on" in check.problems[0]
    path.write_bytes(whole)
    flipped(path, 1234, 3)
    assert check_recording(path).damaged[0].streams == ("wrench/tip",)
    assert "bytes 1000 to 2000 (wrench/tip, 1.000 to 2.000 s) differ" in check_recording(path).problems[0]
    path.write_bytes(whole)
    ledger = ledger_path(path).read_bytes()
    ledger_path(path).write_bytes(ledger[:-30])  # killed while it wrote the last line
    check = check_recording(path)
    assert (check.problems, check.committed) == ([], 3000)


def with_room(bytes_more: int, path: Path, write: Callable[[], object]) -> None:
    """Write while the disk takes so much more of a file, and find that it fails."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + bytes_more, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            write()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_line_that_the_disk_takes_in_part_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(np.random.default_rng(0).bytes(3000))
    writer = LedgerWriter(ledger_path(path), path)
    writer.commit(1000)
    with_room(30, ledger_path(path), lambda: writer.commit(2000))
    writer.commit(3000)
    writer.end({}, {})
    writer.close()
    assert check_recording(path).problems == []
    assert [one.end for one in read_ledger(path).blocks] == [1000, 3000]
    whole = ledger_path(path).read_bytes()
    with_room(40, ledger_path(path), lambda: add_discard(path, {"reason": "x" * 50}))
    assert ledger_path(path).read_bytes() == whole
    add_discard(path, {"reason": "late"})
    assert read_discards(path) == [{"reason": "late"}]


def test_discards_at_once_are_all_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.rrd"
    shutil.copy(SAMPLE, path)
    write_ledger(path)
    chained = ledger._chained

    def slow(content: Mapping[str, Any], before: str) -> tuple[str, str]:
        time.sleep(0.01)  # others read meanwhile
        return chained(content, before)

    monkeypatch.setattr(ledger, "_chained", slow)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda at: add_discard(path, {"reason": str(at)}), range(4)))
    monkeypatch.undo()
    assert check_recording(path).problems == []
    assert {one["reason"] for one in read_discards(path)} == set("0123")


def test_a_discard_that_is_cut_off_is_noticed(tmp_path: Path) -> None:
    """At the end of a line, as of any other: the last says that the ledger is whole."""
    sample = tmp_path / "run.rrd"
    shutil.copy(SAMPLE, sample)
    write_ledger(sample)
    for reason in ("it slipped", "wrong foam"):
        add_discard(sample, {"reason": reason})
    path = ledger_path(sample)
    lines = path.read_bytes().splitlines(keepends=True)
    assert check_recording(sample).problems == []
    for count in range(1, len(lines)):
        path.write_bytes(b"".join(lines[:count]))
        assert check_recording(sample).problems, count


def test_a_line_of_another_place_does_not_fit_the_chain(sample: Path) -> None:
    path = ledger_path(sample)
    lines = path.read_text().splitlines(keepends=True)
    swapped = [*lines[:5], lines[6], lines[5], *lines[7:]]
    for changed in (swapped, [*lines[:5], *lines[6:]], [*lines[:5], lines[4], *lines[5:]]):
        path.write_text("".join(changed))
        assert any("does not match itself" in one for one in check_recording(sample).problems)
    path.write_text("".join(lines))
    assert check_recording(sample).problems == []


def test_lost_and_added_bytes(recording: Path) -> None:
    whole = recording.read_bytes()
    for content in (whole[:-1], whole + b"\0", whole[: BLOCK_BYTES + 5], b""):
        recording.write_bytes(content)
        assert "were recorded" in check_recording(recording).problems[0]
        assert check_recording(recording).truncated == (len(content) < len(whole))


def test_a_damaged_ledger_is_no_proof(recording: Path, sample: Path) -> None:
    text = ledger_path(recording).read_text()
    for then, now in (("12345", "12346"), ('"size":', '"site":'), ('{"frames":7}', '{"frames":8}')):
        ledger_path(recording).write_text(text.replace(then, now))
        if now in ledger_path(recording).read_text():
            assert "does not match itself" in check_recording(recording).problems[0]
    for broken in ("", "[]", '{"format": "other"}', "{", "deformscope-ledger-3\n"):
        ledger_path(recording).write_text(broken)
        assert "the ledger" in check_recording(recording).problems[0]
    whole = ledger_path(sample).read_text()
    ledger_path(sample).write_text(whole[:-20])  # a recording that was finished has the last line
    assert "the ledger is cut off" in check_recording(sample).problems[0]
    ledger_path(sample).write_text(whole)


def test_no_ledger_is_told_apart(recording: Path) -> None:
    ledger_path(recording).unlink()
    with pytest.raises(FileNotFoundError):
        check_recording(recording)


def test_a_block_of_many_streams_names_some() -> None:
    block = LedgerBlock(0, 5, "", tuple("abcdefg"), 1.0, 2.0)
    assert str(block) == "bytes 0 to 5 (a, b, c, d and 3 more streams, 1.000 to 2.000 s)"
