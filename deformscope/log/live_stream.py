"""The stream to a live viewer: it receives visible items, thinned for a page on a slow machine, and reports their
arrival. A recording keeps every item."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import cv2
import numpy as np
import rerun as rr

from deformscope.arrays import ImageArray
from deformscope.frames import (
    ArmFrame,
    ColorFrame,
    DepthFrame,
    HandFrame,
    Item,
    RawBytes,
    StageResult,
    Stream,
    TactileFrame,
    WrenchFrame,
    host_ns,
)
from deformscope.log.rig import Batch, Place, Shown, prepare_items
from deformscope.log.rig.numbers import visible_in
from deformscope.log.stages import prepare_stage_results

COLOR_WIDTH, DEPTH_WIDTH = 480, 320
"""Images are at most so wide [px]."""
WRENCH_HZ, TACTILE_HZ, POSE_HZ = 50.0, 5.0, 10.0
"""Frames a second of a force sensor, of tactile pads, and of an arm or a hand."""
LEAST, MOST = 2, 200
"""Frames of each, however short or long the time was."""

FrameT = TypeVar("FrameT")


def thinned(items: Sequence[Item]) -> list[Item]:
    """The live view of one portion of items, in order of time. It has the newest picture of
    each camera, made smaller, the extremes of plots, and the newest pose, but no bytes of the wire."""
    groups: dict[tuple[type, str], list[Item]] = {}
    for item in items:
        if not isinstance(item, RawBytes):
            groups.setdefault((type(item), getattr(item, "device", "")), []).append(item)
    return [item for group in groups.values() for item in _shown(group)]


def _shown(group: list[Any]) -> Sequence[Item]:
    """Those to be shown of the items of one kind and device."""
    match newest := group[-1]:
        case ColorFrame():
            return [dataclasses.replace(newest, image=_smaller(newest.image, COLOR_WIDTH, cv2.INTER_AREA))]
        case DepthFrame():  # distances must not be mixed; a colour image on its pixels is in no view
            depth = _smaller(newest.depth, DEPTH_WIDTH, cv2.INTER_NEAREST)
            return [dataclasses.replace(newest, depth=depth, color=None)]
        case WrenchFrame():
            return extremes(group, _count(group, WRENCH_HZ), lambda frame: float(np.linalg.norm(frame.force_n)))
        case TactileFrame():
            return extremes(group, _count(group, TACTILE_HZ), lambda frame: float(frame.counts.max(initial=0)))
        case ArmFrame() | HandFrame():
            count = min(_count(group, POSE_HZ), len(group))
            return [group[at] for at in np.linspace(0, len(group) - 1, count).round().astype(int)]
        case _:
            return group


def _count(frames: Sequence[Any], rate_hz: float) -> int:
    """How many of these frames of a device are shown."""
    seconds = (frames[-1].stamp.host_ns - frames[0].stamp.host_ns) / 1e9
    return int(min(max(LEAST, np.ceil(rate_hz * seconds)), MOST))


def extremes(frames: Sequence[FrameT], most: int, value: Callable[[FrameT], float]) -> list[FrameT]:
    """At most `most` of the values, in order: the least and the greatest of each of `most // 2` stretches of equal
    length, so that no peak is lost."""
    if len(frames) <= most:
        return list(frames)
    values = np.nan_to_num([value(frame) for frame in frames])
    chosen = set()
    for stretch in np.array_split(np.arange(len(frames)), most // 2):
        chosen |= {int(stretch[np.argmin(values[stretch])]), int(stretch[np.argmax(values[stretch])])}
    return [frames[at] for at in sorted(chosen)]


def _smaller(image: ImageArray, width: int, interpolation: int) -> ImageArray:
    """An image (h, w) or (h, w, 3) made no wider than `width` px."""
    height, wide = image.shape[:2]
    if wide <= width:
        return image
    shown: ImageArray = cv2.resize(image, (width, max(1, round(height * width / wide))), interpolation=interpolation)  # type: ignore[assignment]
    return shown


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
