"""The recording's data on its way to pages: pieces of encoded rerun data, stored for a while, dropped when too old.

The maker of pieces never waits. A page is sent new data when it has drawn the earlier ones, and these are made
then: made while the page was drawing, it would be old. A page that is slow, hidden or frozen delays nothing, and no
memory grows: data that it did not take in time are skipped and counted."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

RECENT_S, RECENT_BYTES = 30.0, 16 << 20
"""Data for a page that connects during a run."""
FIRST_BYTES, LASTING_BYTES = 4 << 20, 64 << 20
"""Limits of lasting data (views, descriptions, results): this number of first bytes is stored, and this number of the
newest."""
STALE_S = 1.0
"""A connected page is not sent pieces older than this, once something newer exists."""
FASTEST_S, SLOWEST_S = 0.1, 1.0
"""Shortest and longest period of making pieces."""
REST, MOST_REST_S = 0.25, 0.25
"""Pause for a page's other tasks, as a share of its drawing time, and its limit."""


@dataclass(frozen=True, slots=True)
class ViewerPiece:
    """A complete stream of rerun data, which the viewer can read alone. number: from 1; lasting: later pieces depend on
    it; made_s: when [s]

    until_ns: session time of the newest that it or an earlier one holds [ns], 0 = not known"""

    number: int
    data: bytes
    lasting: bool
    made_s: float
    until_ns: int = 0


@dataclass(slots=True)
class PageReader:
    """Progress of a page.

    last: the newest piece that was sent; skipped: pieces that were too old for it; sent_s, newest_s: when its last
    batch was sent, and when the newest piece in it was made; drawing: the last batch is not drawn yet
    shown_s: when the newest piece of the previous batch was made, which the page shows until then
    needs_s: how long the page took to draw the last batch; behind_s: age of its view
    wants_s: when it gets the next batch, so that it has time for other work than drawing"""

    last: int = 0
    skipped: int = 0
    sent_s: float = 0.0
    newest_s: float | None = None
    drawing: bool = False
    shown_s: float | None = None
    needs_s: float | None = None
    behind_s: float | None = None
    wants_s: float = 0.0


class Pieces:
    """Stored pieces, which any thread may use."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._first: list[ViewerPiece] = []
        self._lasting: deque[ViewerPiece] = deque()
        self._passing: deque[ViewerPiece] = deque()
        self._bytes = {"first": 0, "lasting": 0, "passing": 0}
        self._count = 0
        self._readers: list[PageReader] = []
        self._watchers: list[Callable[[], None]] = []
        self._lock = threading.Lock()

    def add(self, data: bytes, *, lasting: bool, until_ns: int = 0) -> None:
        """Add a piece; returns immediately."""
        with self._lock:
            self._count += 1
            piece = ViewerPiece(self._count, data, lasting, self._clock(), until_ns)
            if lasting and self._bytes["first"] + len(data) <= FIRST_BYTES:
                self._first.append(piece)
                self._bytes["first"] += len(data)
            else:
                queue, name = (self._lasting, "lasting") if lasting else (self._passing, "passing")
                queue.append(piece)
                self._bytes[name] += len(data)
            while self._bytes["lasting"] > LASTING_BYTES:
                self._bytes["lasting"] -= len(self._lasting.popleft().data)
            oldest_s = self._clock() - RECENT_S
            while self._passing and (self._bytes["passing"] > RECENT_BYTES or self._passing[0].made_s < oldest_s):
                self._bytes["passing"] -= len(self._passing.popleft().data)
            watchers = tuple(self._watchers)
        for call in watchers:
            call()

    def watch(self, call: Callable[[], None]) -> Callable[[], None]:
        """call: after every new piece, in any thread; returns the function that ends it."""
        with self._lock:
            self._watchers.append(call)
        return lambda: self._watchers.remove(call)

    @property
    def held_bytes(self) -> int:
        """Bytes stored for later pages."""
        return sum(self._bytes.values())

    # Of one page -----------------------------------------------------------------------------------------------------

    def join(self, after: int) -> PageReader:
        """Add a page that has all pieces up to this one, 0 = none."""
        with self._lock:
            reader = PageReader(last=min(after, self._count))
            self._readers.append(reader)
            return reader

    def part(self, reader: PageReader) -> None:
        """Note that a page is gone."""
        with self._lock:
            self._readers.remove(reader)

    def take(self, reader: PageReader) -> list[ViewerPiece]:
        """The page's next pieces, oldest first; the first time also the recent stretch, later nothing stale."""
        with self._lock:
            now_s, joins = self._clock(), reader.newest_s is None
            every = sorted((*self._first, *self._lasting, *self._passing), key=lambda piece: piece.number)
            new = [piece for piece in every if piece.number > reader.last]
            if not new:
                return []
            shown = [
                piece
                for piece in new
                if joins or piece.lasting or now_s - piece.made_s <= STALE_S or piece.number == self._count
            ]
            if not joins:
                reader.skipped += self._count - reader.last - len(shown)
            reader.last, reader.sent_s, reader.drawing = self._count, now_s, True
            reader.shown_s, reader.newest_s = reader.newest_s, new[-1].made_s
            return shown

    def drawn(self, reader: PageReader) -> float:
        """Note that the page has drawn its last piece; returns how long to wait for a newer one [s]."""
        with self._lock:
            now_s = self._clock()
            reader.needs_s, reader.drawing = now_s - reader.sent_s, False
            reader.behind_s = None if reader.shown_s is None else now_s - reader.shown_s
            rest_s = min(REST * reader.needs_s, MOST_REST_S)
            reader.wants_s = now_s + rest_s
            return rest_s + 2 * FASTEST_S

    @property
    def period_s(self) -> float:
        """Time between two pieces: short if a page is ready for the next, else long."""
        with self._lock:
            now_s = self._clock()
            ready = any(not reader.drawing and now_s >= reader.wants_s for reader in self._readers)
            return FASTEST_S if ready else SLOWEST_S
