"""Device items, gathered into portions: writing has a cost for each portion, and little for each item."""

import dataclasses
import functools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from deformscope.arrays import IntArray
from deformscope.frames import HealthReport, Item, LinkChange, RawBytes, SessionNote, host_ns

GATHER_S, GATHER_BYTES = 1.0, 8 << 20
"""Time over which items are gathered, and their largest amount."""
GATHER_LIVE_S = 0.15
"""Time of gathering items of devices on their own clock: gathered items are lost if the process is killed."""
ITEM_BYTES = 1 << 10
"""Memory of an item besides its arrays."""


class Portions:
    """Gathers items for this time [s], separately for each touch."""

    def __init__(self, gather_s: float = GATHER_S) -> None:
        self._gather_s = gather_s
        self._items: list[Item] = []
        self._bytes = self._touch = 0
        self._since = 0.0

    def __len__(self) -> int:
        """How many items wait."""
        return len(self._items)

    def add(self, items: Sequence[Item], touch: int, size: int) -> Iterator[tuple[list[Item], int]]:
        """Portions that these items complete: items, and their touch."""
        if touch != self._touch:
            yield from self.rest()
            self._touch = touch
        if not self._items:
            self._since = time.monotonic()
        self._items += items
        self._bytes += size
        if self._bytes >= GATHER_BYTES or host_ns(self._items[-1]) - host_ns(self._items[0]) >= self._gather_s * 1e9:
            yield from self.rest()

    def overdue(self) -> Iterator[tuple[list[Item], int]]:
        """The gathered items, once they have waited for that long."""
        if time.monotonic() - self._since >= self._gather_s:
            yield from self.rest()

    def rest(self) -> Iterator[tuple[list[Item], int]]:
        """The gathered items that are left."""
        if self._items:
            items, self._items, self._bytes = self._items, [], 0
            yield items, self._touch


class RisingTimes:
    """Times that only rise: earlier ones do not change."""

    def __init__(self) -> None:
        self._held: IntArray = np.zeros(1024, np.int64)
        self._count = 0

    @property
    def all(self) -> IntArray:
        """(n,) so far."""
        return self._held[: self._count]

    def add(self, times: Sequence[int]) -> None:
        count = self._count + len(times)
        if count > len(self._held):
            longer = np.zeros(2 * count, np.int64)
            longer[: self._count] = self.all
            self._held = longer
        self._held[self._count : count] = times
        self._count = count


def counted_as(item: Item) -> str:
    """The count to which an item belongs: that of its device, or of its kind."""
    match item:
        case RawBytes():
            return f"{item.device}/{'sent' if item.sent else 'received'}"
        case LinkChange():
            return f"{item.device}/link"
        case HealthReport():
            return "health"
        case SessionNote():
            return "notes"
        case _:
            return f"{item.device}/frames"


def item_size(item: Item) -> int:
    """Bytes of memory that an item holds."""
    return ITEM_BYTES + (len(item.data) if isinstance(item, RawBytes) else arrays_size(item))


def arrays_size(value: object) -> int:
    """Bytes of an array, and of those in a dataclass or a sequence, however deep."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    parts = _parts_of(type(value))  # type: ignore[arg-type]
    return sum(map(arrays_size, parts(value))) if parts is not None else 0


@functools.cache
def _parts_of(kind: type[Any]) -> Callable[[Any], Iterable[object]] | None:
    """A function that gives the parts of an object of a type; None where no part may hold arrays."""
    if issubclass(kind, tuple | list):
        return iter
    if issubclass(kind, Mapping):
        return kind.values
    names = [field.name for field in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
    return (lambda value: [getattr(value, name) for name in names]) if names else None
