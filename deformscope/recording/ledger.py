"""The ledger of a recording: checksums of its bytes, so that a flipped bit is detected and located.

A recording has no checksum, and most single bit flips in it are read without an error. The ledger is
text: a line with its format, then a line per block. A line is JSON (bytes, their SHA-256, the streams and the session
time in them) and a SHA-256 of that JSON and of the line before, which chains the lines. The ledger grows with the file:
a line at each flush. Lines that mark the recording as discarded follow. The line `ended` is the last, so that a
truncation before it is detected: size and SHA-256 of the whole, recorded and lost items, and what a recovered recording
inherits: how its original differed from its own ledger. Without that line, the run was interrupted."""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deformscope.errors import InputError
from deformscope.file_io import replacing
from deformscope.frames import SessionNote
from deformscope.recording.lock import one_at_a_time
from deformscope.recording.rrd_index import Portion, read_index

FORMAT = "deformscope-ledger-2"
BLOCK_BYTES = 1 << 20
"""Most bytes of a block whose contents are unknown."""
SEVERAL = 4
"""Most streams that are named for a block."""


def ledger_path(recording: Path) -> Path:
    """`run.rrd` has the ledger `run.rrd.ledger`; a link without a ledger has that of its target."""
    own = recording.with_name(recording.name + ".ledger")
    if recording.is_symlink() and not own.exists():
        target = Path(os.path.realpath(recording))
        return target.with_name(target.name + ".ledger")
    return own


Losses = Mapping[str, Mapping[str, float]]
"""What devices lost, by device and kind (`deformscope.recording.losses`)."""


@dataclass(frozen=True, slots=True)
class LedgerBlock:
    """Bytes from start to before end. streams: entities whose rows they contain, between these session times [s]"""

    start: int
    end: int
    sha256: str
    streams: tuple[str, ...] = ()
    from_s: float | None = None
    to_s: float | None = None

    def __str__(self) -> str:
        held = [_named([self])] if self.streams else []
        if self.from_s is not None and self.to_s is not None:
            held.append(f"{self.from_s:.3f} to {self.to_s:.3f} s")
        return f"bytes {self.start} to {self.end}" + (f" ({', '.join(held)})" if held else "")


@dataclass(slots=True)
class Ledger:
    """The content of a ledger. ended: its last line; None = the run was cut short; problems: errors in it"""

    blocks: list[LedgerBlock] = field(default_factory=list)
    ended: dict[str, Any] | None = None
    discarded: list[dict[str, Any]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    chain: str = ""

    @property
    def committed(self) -> int:
        """Bytes of the recording that it covers."""
        return max([int((self.ended or {}).get("size", 0)), *(one.end for one in self.blocks)])


@dataclass(frozen=True, slots=True)
class LedgerCheck:
    """A recording compared with its ledger. problems: one line each, none if every byte in the ledger is unchanged;
    truncated: bytes are missing at its end; damaged: blocks that differ; ended: the run was completed
    source_problems: problems of the original, if this recording was recovered"""

    problems: list[str]
    truncated: bool
    damaged: list[LedgerBlock]
    ended: bool
    committed: int
    source_problems: list[str]


class LedgerWriter:
    """Makes a ledger, a block at a time. path: path of the ledger; an existing one is replaced"""

    def __init__(self, path: Path, recording: Path) -> None:
        self._recording, self._at, self._chain = recording, 0, ""
        self._whole = hashlib.sha256()
        self._file = path.open("wb", buffering=0)  # what was written stays when the process is killed
        self._file.write(f"{FORMAT}\n".encode())

    def commit(self, end: int, streams: Sequence[str] = (), span_s: tuple[float, float] | None = None) -> None:
        """Add the recording's bytes up to END, which are on the disk. Raises OSError."""
        if end <= self._at:
            return
        digest, whole = hashlib.sha256(), self._whole.copy()
        with self._recording.open("rb") as file:
            for piece in _pieces(file.fileno(), self._at, end):
                digest.update(piece)
                whole.update(piece)
        known: dict[str, Any] = {"bytes": [self._at, end], "sha256": digest.hexdigest()}
        known |= {"streams": list(streams)} if streams else {}
        known |= {"session_s": list(span_s)} if span_s is not None else {}
        self.add(known)
        self._at, self._whole = end, whole

    def end(self, counts: Mapping[str, int], losses: Losses, source_problems: Sequence[str] = ()) -> None:
        """Add the line for the complete recording."""
        told = {"size": self._at, "sha256": self._whole.hexdigest(), "counts": dict(counts), "losses": dict(losses)}
        self.add({"ended": told | ({"source_problems": list(source_problems)} if source_problems else {})})

    def add(self, content: Mapping[str, Any]) -> None:
        """Write a line, completely or not at all. Raises OSError."""
        text, link = _chained(content, self._chain)
        end, data = self._file.seek(0, os.SEEK_END), text.encode()
        try:
            while data:  # of a disk that is nearly full a write takes a part, and does not say so
                data = data[self._file.write(data) :]
        except OSError:
            self._file.truncate(end)
            raise
        self._chain = link

    def close(self) -> None:
        """Write the ledger to the disk, if the disk accepts it."""
        with self._file, suppress(OSError):
            os.fsync(self._file.fileno())


def write_ledger(
    recording: Path,
    counts: Mapping[str, int] | None = None,
    losses: Losses | None = None,
    *,
    discarded: Sequence[Mapping[str, object]] = (),
    source_problems: Sequence[str] = (),
) -> Path:
    """Write the ledger of a finished recording: a block for each portion of its index, or the blocks of the ledger that
    grew with it.

    counts: what was recorded, by kind; losses: numbers of losses; discarded: see `add_discard`
    source_problems: see `LedgerCheck`"""
    path, size = ledger_path(recording), recording.stat().st_size
    grown = [one for one in read_ledger(recording).blocks if one.end <= size] if path.exists() else []
    new = path.with_name(path.name + ".part")
    writer = LedgerWriter(new, recording)
    at = 0
    for end, streams, span_s in _joined(read_index(recording)) or [(one.end, one.streams, _span(one)) for one in grown]:
        writer.commit(end, streams, span_s)
        at = end
    for end in [*range(at + BLOCK_BYTES, size, BLOCK_BYTES), size]:
        writer.commit(end)
    for one in discarded:
        writer.add({"discarded": dict(one)})
    writer.end(counts or {}, losses or {}, source_problems)
    writer.close()
    new.replace(path)
    return path


def add_discard(recording: Path, entry: Mapping[str, object]) -> Path:
    """Add to the ledger that the recording, or a part of it, is not to be used; the recording is unchanged."""
    path = ledger_path(recording)
    with one_at_a_time(path.parent):  # each line continues the one before
        ledger = read_ledger(recording)
        before = [json.loads(line[:-65]) for line in path.read_bytes().splitlines()[1:]]
        told = [*(one for one in before if "ended" not in one), {"discarded": dict(entry)}, {"ended": ledger.ended}]
        text, chain = f"{FORMAT}\n", ""
        for one in told:
            line, chain = _chained(one, chain)
            text += line
        with replacing(path) as file:
            file.write(text.encode())
    return path


def read_discards(recording: Path) -> list[dict[str, Any]]:
    """The lines of `add_discard`; empty without a readable ledger."""
    try:
        found: list[Any] = read_ledger(recording).discarded  # of whatever wrote that ledger
        return [one for one in found if isinstance(one, dict)]
    except OSError:
        return []


def read_counts(recording: Path) -> dict[str, int]:
    """Recorded numbers by kind, from the ledger; empty if the run was cut short, or the ledger is missing or
    damaged."""
    ledger = read_ledger(recording) if ledger_path(recording).exists() else Ledger()
    if ledger.problems:
        return {}
    return {str(name): int(count) for name, count in (ledger.ended or {}).get("counts", {}).items()}


def check_recording(recording: Path) -> LedgerCheck:
    """Compare a recording with its ledger, block by block. Raises FileNotFoundError without a ledger."""
    ledger = read_ledger(recording)
    size, committed = recording.stat().st_size, ledger.committed
    problems, damaged, whole, at = list(ledger.problems), list[LedgerBlock](), hashlib.sha256(), 0
    with recording.open("rb") as file:
        for block in ledger.blocks:
            if block.end > size:
                break
            digest = hashlib.sha256()
            for piece in _pieces(file.fileno(), block.start, block.end):
                digest.update(piece)
                whole.update(piece)
            at = block.end
            if digest.hexdigest() != block.sha256:
                damaged.append(block)
    if ledger.ended is None and not problems and read_index(recording):
        problems.append(f"the ledger is cut off: it answers for {committed} of {size} bytes")
    truncated = size < committed
    if truncated:
        lost = [one for one in ledger.blocks if one.end > size]
        times = [one.from_s for one in lost if one.from_s is not None]
        gone = f", from {min(times):.3f} s of {_named(lost)} on" if times else ""
        problems.append(f"truncated: {size} bytes where {committed} were recorded{gone}")
    elif ledger.ended is not None and size > committed:
        problems.append(f"{size} bytes where {committed} were recorded")
    if len(damaged) > 2 and at == damaged[-1].end and len(damaged) == sum(one.end <= at for one in ledger.blocks):
        problems.append(f"{_joint(damaged)} differ from what was recorded, every block: is the ledger of another file?")
    else:
        problems += [f"{one} differ from what was recorded" for one in damaged]
    if not problems and ledger.ended is not None and (at, whole.hexdigest()) != (size, ledger.ended["sha256"]):
        problems.append("the recording differs from what was recorded")
    before = [str(one) for one in (ledger.ended or {}).get("source_problems", ())]
    return LedgerCheck(problems, truncated, damaged, ledger.ended is not None, min(committed, size), before)


def inherited(source_problems: Sequence[str]) -> str:
    """The damage of a recovered recording in a line."""
    return f"damaged before it was recovered: {'; '.join(source_problems)}"


def read_ledger(recording: Path) -> Ledger:
    """The content of the ledger, and its errors. Raises FileNotFoundError without a ledger."""
    content = ledger_path(recording).read_bytes()
    first, *lines = content.split(b"\n")
    if first != FORMAT.encode():
        return Ledger(problems=[f"the ledger is not one of format {FORMAT}: it is damaged or newer"])
    ledger, rest = Ledger(), lines.pop() if lines else b""
    for number, line in enumerate(lines, 2):
        before, ledger.chain = ledger.chain, line[-64:].decode(errors="replace")
        try:
            known = json.loads(line[:-65])
            if line + b"\n" != _chained(known, before)[0].encode():
                raise ValueError("not the line that was written")
            if "ended" in known:
                ledger.ended = known["ended"]
            elif "discarded" in known:
                ledger.discarded.append(known["discarded"])
            else:
                streams, span = tuple(known.get("streams", ())), known.get("session_s", (None, None))
                (start, end), (from_s, to_s) = known["bytes"], span
                ledger.blocks.append(LedgerBlock(start, end, known["sha256"], streams, from_s, to_s))
        except (ValueError, KeyError, TypeError):
            about = f", behind {ledger.blocks[-1]}" if ledger.blocks else ""
            ledger.problems.append(f"the ledger does not match itself: it is damaged in line {number}{about}")
    if rest and ledger.ended is not None:
        ledger.problems.append("the ledger is damaged at its end")
    return ledger


def _chained(content: Mapping[str, Any], before: str) -> tuple[str, str]:
    """A line, and its link of the chain. before: the link of the line before"""
    text = json.dumps(content, separators=(",", ":"))
    link = hashlib.sha256(f"{before}{text}".encode()).hexdigest()
    return f"{text} {link}\n", link


def _joined(portions: Sequence[Portion]) -> list[tuple[int, tuple[str, ...], tuple[float, float] | None]]:
    """Ends, streams and session times of blocks: of a portion each; those without a time that follow each other are
    one."""
    found: list[tuple[int, tuple[str, ...], tuple[float, float] | None]] = []
    for one in portions:
        span_s = None if one.from_s is None or one.to_s is None else (one.from_s, one.to_s)
        if span_s is None and found and found[-1][2] is None:
            found.pop()
        found.append((one.end, (one.entity,) if span_s else ("descriptions",), span_s))
    return found


def _span(block: LedgerBlock) -> tuple[float, float] | None:
    return None if block.from_s is None or block.to_s is None else (block.from_s, block.to_s)


def _joint(blocks: Sequence[LedgerBlock]) -> LedgerBlock:
    """Blocks as one."""
    streams = tuple(dict.fromkeys(name for one in blocks for name in one.streams))
    times = [time_s for one in blocks for time_s in (one.from_s, one.to_s) if time_s is not None]
    return LedgerBlock(blocks[0].start, blocks[-1].end, "", streams, min(times, default=None), max(times, default=None))


def _named(blocks: Sequence[LedgerBlock]) -> str:
    names = list(dict.fromkeys(name for one in blocks for name in one.streams))
    return ", ".join(names[:SEVERAL]) + (f" and {len(names) - SEVERAL} more streams" if len(names) > SEVERAL else "")


def _pieces(handle: int, start: int, end: int) -> Iterator[bytes]:
    while start < end and (piece := os.pread(handle, min(BLOCK_BYTES, end - start), start)):
        yield piece
        start += len(piece)


# Discarded parts of a recording, with reasons: nothing is deleted, and every reader reports them.
#
# Discards during the recording are notes in the recording; later ones are in its ledger


@dataclass(frozen=True, slots=True)
class Discard:
    """episode: its number, from 1, 0 = the whole recording; label: the episode's label"""

    reason: str
    episode: int = 0
    label: str = ""

    def __str__(self) -> str:
        what = f"episode {self.episode} ({self.label})" if self.episode else "all of it"
        return f"{what}: {self.reason}"


def discards_of(recording: Path, notes: Iterable[SessionNote]) -> list[Discard]:
    """Its discarded parts, by its notes and its ledger."""
    found, labels = [], list[str]()
    for note in notes:
        if note.about == "episode-begin":
            labels.append(note.text)
        elif note.about == "discard-episode" and labels:
            found.append(Discard(note.text, len(labels), labels[-1]))
        elif note.about == "discard-recording":
            found.append(Discard(note.text))
    for one in read_discards(recording):  # of whatever wrote that ledger
        found.append(Discard(str(one.get("reason", "")), int(one.get("episode", 0)), str(one.get("label", ""))))
    return found


def discard(recording: Path, reason: str, episode: int, notes: Iterable[SessionNote]) -> Discard:
    """Mark a finished recording, or one of its episodes (0 = all), in its ledger; the recording is unchanged.

    Raises InputError if it has no such episode, or no valid ledger."""
    labels = [note.text for note in notes if note.about == "episode-begin"]
    if not 0 <= episode <= len(labels):
        listed = ", ".join(f"{at} = {label}" for at, label in enumerate(labels, 1)) or "none"
        raise InputError("an episode of the recording", str(episode), f"episodes: {listed}", recording)
    try:
        check = check_recording(recording)
        problems = check.problems or ([] if check.ended else ["an unfinished one"])
    except FileNotFoundError:
        problems = ["one without: it was not finished, or its ledger was not copied with it"]
    if problems:  # a new ledger would say that its bytes are as they were recorded
        raise InputError("a recording that its ledger fits", problems[0], "deformscope verify", recording)
    found = Discard(reason, episode, labels[episode - 1] if episode else "")
    add_discard(recording, {"reason": found.reason, "episode": found.episode, "label": found.label})
    return found
