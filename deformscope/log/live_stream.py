"""The stream to a live viewer: it receives visible items, and reports their arrival."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import rerun as rr

from deformscope.frames import Item, StageResult, Stream, host_ns
from deformscope.log.rig import Batch, Place, Shown, prepare_items
from deformscope.log.rig.numbers import visible_in
from deformscope.log.rig.thinned import thinned
from deformscope.log.stages import prepare_stage_results


class LiveStream:
    """A stream to a viewer: entries of `rec` are sent immediately; items of devices are gathered, and thinned at a
    flush.

    check: raises TimeoutError if the viewer does not answer within a time [s], another error if it is gone
    passing: receives items that a later viewer does not need, None = `rec` receives them"""

    def __init__(
        self, rec: rr.RecordingStream, check: Callable[[float], None], passing: rr.RecordingStream | None = None
    ) -> None:
        self.rec = rec
        self._passing = passing or rec
        self._streams_out = (rec,) if passing is None else (rec, passing)
        self._check = check
        self._items: dict[int, list[Item]] = {}
        self._places: dict[int, Place | None] = {}
        self._shown: Shown = {}
        self._start_ns, self._streams = 0, tuple[Stream, ...]()
        self.newest_ns = 0
        """Session time of the newest item that was sent [ns]; 0 before any."""
        self._results: list[StageResult] = []
        self._latest: dict[str, StageResult] = {}

    def add_items(self, items: Sequence[Item], start_ns: int, streams: Sequence[Stream], place: Place | None) -> None:
        """Show items with the next flush; the arguments are those of `prepare_items`."""
        touch = -1 if place is None else place.touch
        self._start_ns, self._streams = start_ns, tuple(streams)
        self._items.setdefault(touch, []).extend(items)
        self._places[touch] = place  # the latest: it knows the most pictures

    def add_results(self, results: Sequence[StageResult], start_ns: int, streams: Sequence[Stream]) -> None:
        """Show results with the next flush: all numbers over time, but only the newest pictures and marks."""
        self._start_ns, self._streams = start_ns, tuple(streams)
        self._results += results

    def send(self, batch: Batch, *, lasting: bool = False) -> None:
        """Send the batch's visible part: a page's time depends on the number of entities."""
        batch.send(self.rec if lasting else self._passing, visible_in(self._streams))

    def flush(self, *, timeout_sec: float) -> None:
        """Send the gathered items, and return once the viewer has all. Raises TimeoutError if that takes longer,
        another error if the viewer is gone."""
        for touch, items in sorted(self._items.items()):
            place = self._places[touch]
            few = thinned(items)
            self.newest_ns = max(self.newest_ns, *(host_ns(item) - self._start_ns for item in few), 0)
            self.send(prepare_items(few, self._start_ns, self._streams, (), place, self._shown, changes_only=True))
        self._items.clear()
        if self._results:
            results, self._results = self._results, []
            start_ns, streams = self._start_ns, self._streams
            self.send(prepare_stage_results(results, start_ns, streams, self._latest, newest_pictures=True))
        began = time.monotonic()
        try:
            for rec in self._streams_out:
                rec.flush(timeout_sec=timeout_sec)
        except Exception as error:
            if time.monotonic() - began < timeout_sec:
                raise
            raise TimeoutError(str(error)) from error
        # rerun calls that done which the operating system has taken for a viewer that reads nothing any more
        self._check(timeout_sec)

    def disconnect(self) -> None:
        for rec in self._streams_out:
            rec.disconnect()
