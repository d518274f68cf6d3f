"""Existing items in the form of a rig, in order of time and in limited portions, so that memory is bounded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Self

from deformscope.frames import HealthReport, Item, Stream, host_ns
from deformscope.recording.portions import item_size

BATCH_NS, BATCH_BYTES = 200_000_000, 16 << 20


class ItemSource:
    """`session.run(ItemSource(items, streams), ...)`: `take` gives about a fifth of a second at a time.

    streams: streams of the devices; start_ns: start of the session, None = time of the first item; now_ns: time of the
    newest item that was taken; ended: no item is left; until_ns: no later item is given"""

    failures: Mapping[str, str] = {}

    def __init__(self, items: Iterator[Item], streams: tuple[Stream, ...], start_ns: int | None = None) -> None:
        self.streams, self.ended, self.until_ns = streams, False, math.inf
        self._items, self._health = items, HealthReport(0, ())
        self._next = next(items, None)
        if start_ns is None and self._next is not None:
            start_ns = host_ns(self._next)
        self.start_ns = self.now_ns = start_ns or 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def take(self, wait_s: float) -> list[Item]:
        """The next items. wait_s: ignored, as nothing waits"""
        found: list[Item] = []
        size = 0
        until_ns = self.until_ns if self._next is None else min(host_ns(self._next) + BATCH_NS, self.until_ns)
        while self._next is not None and host_ns(self._next) <= until_ns and size < BATCH_BYTES:
            found.append(self._next)
            size += item_size(self._next)
            self._next = next(self._items, None)
        self.ended = self._next is None
        self._health = next((one for one in reversed(found) if isinstance(one, HealthReport)), self._health)
        found.sort(key=host_ns)
        self.now_ns = host_ns(found[-1]) if found else self.now_ns
        return found

    def look(self) -> HealthReport:
        """How the devices were by the newest report."""
        return self._health

    def rest(self) -> list[Item]:
        """All items that are left."""
        return []

    def close(self) -> None:
        """Does nothing: the caller closes the source of the items."""
