"""A reader's own bounded queue: a slow reader loses the oldest, and learns how many."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Subscription(Generic[T]):
    """A reader's remaining items.

    It ends when the device is closed, or with the error that ended the device; waiting items are still given.
    received: items that were put in; dropped: items lost because the reader was slow.
    Always: received = taken + dropped + waiting."""

    def __init__(self, capacity: int, leave: "Callable[[Subscription[T]], None]") -> None:
        self.capacity = capacity
        self.received = 0
        self.dropped = 0
        self._leave = leave
        self._items: deque[T] = deque()
        self.ended = False  # nothing can come any more; items may still wait
        self._error: BaseException | None = None
        self._changed = threading.Condition()

    def __enter__(self) -> "Subscription[T]":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[T]:
        """Every item until the end; waits for the next one."""
        try:
            while True:
                yield self.get()
        except StopIteration:
            return
        except _Ended:
            return
        finally:
            self.close()

    def __len__(self) -> int:
        """Items that wait."""
        return len(self._items)

    def get(self, timeout_s: float | None = None) -> T:
        """The next item. Raises TimeoutError after the time, EOFError at the end, or what ended the device."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            while not self._items:
                if self._error is not None:
                    raise self._error
                if self.ended:
                    raise _Ended("no more readings")
                left = None if until is None else until - time.monotonic()
                if left is not None and left <= 0:
                    raise TimeoutError(f"no reading within {timeout_s:g} s")
                self._changed.wait(left)
            return self._items.popleft()

    def take(self) -> list[T]:
        """All waiting items, without waiting for more. Raises what ended the device once nothing is left."""
        with self._changed:
            items = list(self._items)
            self._items.clear()
            if not items and self._error is not None:
                raise self._error
        return items

    def close(self) -> None:
        """Receive no more items."""
        self._leave(self)
        self.end()

    def put(self, item: T) -> bool:
        """Add an item, as the device does; returns whether another one was dropped for it."""
        with self._changed:
            if self.ended:
                return False
            lost = len(self._items) >= self.capacity
            if lost:
                self._items.popleft()
                self.dropped += 1
            self._items.append(item)
            self.received += 1
            self._changed.notify()
        return lost

    def end(self, error: BaseException | None = None) -> None:
        """Called by the device when nothing more will come. error: why"""
        with self._changed:
            self.ended = True
            self._error = self._error or error
            self._changed.notify_all()


class _Ended(EOFError):
    """The queue's end, apart from any EOFError of the reader's own."""
