"""The visible part of a rig's items, small enough for a page on a slow machine.

A recording keeps every item; a live viewer receives these."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import cv2
import numpy as np

from deformscope.arrays import ImageArray
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, HandFrame, Item, RawBytes, TactileFrame, WrenchFrame

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
