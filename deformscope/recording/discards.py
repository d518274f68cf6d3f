"""Discarded parts of a recording, with reasons: nothing is deleted, and every reader reports them.

Discards during the recording are notes in the recording; later ones are in its ledger."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from deformscope.errors import InputError
from deformscope.frames import SessionNote
from deformscope.recording.ledger import add_discard, check_recording, read_discards


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
