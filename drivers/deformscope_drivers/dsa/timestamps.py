"""Determines which frames are new, by the controller's clock: repeats are not new, and a clock that jumps is
refused."""

from __future__ import annotations

from enum import Enum

STEP_MAX_MS = 1000
"""A longer step between two frames is a jump; frames come every 25 to 90 ms, and a true pause costs one frame."""

_WRAP = 1 << 32


class TimestampStatus(Enum):
    """Status of a frame by its time."""

    NEW = "new"
    REPEATED = "repeated"
    JUMPED = "jumped"
    RESTARTED = "restarted"  # new, on a clock that was set anew


class TimestampGate:
    """Feed each frame's time in turn. A jump is refused, unless the next frame continues from it. Then the clock has
    changed (the controller was switched off and on), and frames count as new from that one.

    Without this rule, two flipped bits that the checksum does not detect could shift the clock by weeks."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._suspect: int | None = None

    def restart(self) -> None:
        """Forget what was seen: the next frame is new, whatever its time."""
        self._last = self._suspect = None

    def check(self, timestamp_ms: int) -> TimestampStatus:
        """timestamp_ms: 32 bits, may wrap around."""
        if timestamp_ms == self._last:
            return TimestampStatus.REPEATED
        if self._last is None or _goes_on(self._last, timestamp_ms):
            verdict = TimestampStatus.NEW
        elif self._suspect is not None and _goes_on(self._suspect, timestamp_ms):
            verdict = TimestampStatus.RESTARTED
        else:
            self._suspect = timestamp_ms
            return TimestampStatus.JUMPED
        self._last, self._suspect = timestamp_ms, None
        return verdict


def _goes_on(before: int, after: int) -> bool:
    return 0 < (after - before) % _WRAP <= STEP_MAX_MS
