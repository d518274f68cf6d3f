"""What a person can see of a rig's items: few enough for a page that a slow machine draws.

A recording keeps every item; a viewer that is fed while it goes on gets these.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeVar

import cv2
import numpy as np

from deformscope.arrays import ImageArray
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, HandFrame, Item, RawBytes, TactileFrame, WrenchFrame

COLOR_WIDTH, DEPTH_WIDTH = 480, 320
"""Images are at most so wide [px]."""
WRENCHES, TACTILES, POSES = 20, 2, 2
"""Frames of a force sensor, of tactile pads, and of an arm or a hand."""

FrameT = TypeVar("FrameT")


def thinned(items: Sequence[Item]) -> list[Item]:
    """What one portion of a live view shows of these, which may be any number, in order of time: the newest picture of
    each camera, made smaller; the extremes of what is plotted; the newest pose; no bytes of the wire."""
    groups: dict[tuple[type, str], list[Item]] = {}
    for item in items:
        if not isinstance(item, RawBytes):
            groups.setdefault((type(item), getattr(item, "device", "")), []).append(item)
    return [item for group in groups.values() for item in _shown(group)]


def _shown(group: list[Item]) -> Sequence[Item]:
    """Of the items of one kind and device."""
    match newest := group[-1]:
        case ColorFrame():
            return [dataclasses.replace(newest, image=_smaller(newest.image, COLOR_WIDTH, cv2.INTER_AREA))]
        case DepthFrame():  # distances must not be mixed; a colour image on its pixels is in no view
            depth = _smaller(newest.depth, DEPTH_WIDTH, cv2.INTER_NEAREST)
            return [dataclasses.replace(newest, depth=depth, color=None)]
        case WrenchFrame():
            return extremes(group, WRENCHES, lambda frame: float(np.linalg.norm(frame.force_n)))  # type: ignore[union-attr]
        case TactileFrame():
            return extremes(group, TACTILES, lambda frame: float(frame.counts.max(initial=0)))  # type: ignore[union-attr]
        case ArmFrame() | HandFrame():
            return [group[at] for at in np.unique(np.linspace(0, len(group) - 1, POSES).round().astype(int))]
        case _:
            return group


def extremes(frames: Sequence[FrameT], most: int, value: Callable[[FrameT], float]) -> list[FrameT]:
    """At most so many, in order: the least and the greatest value of each of `most // 2` stretches of equal length, so
    that no peak is left out."""
    if len(frames) <= most:
        return list(frames)
    values = np.nan_to_num([value(frame) for frame in frames])
    kept = set()
    for stretch in np.array_split(np.arange(len(frames)), most // 2):
        kept |= {int(stretch[np.argmin(values[stretch])]), int(stretch[np.argmax(values[stretch])])}
    return [frames[at] for at in sorted(kept)]


def _smaller(image: ImageArray, width: int, interpolation: int) -> ImageArray:
    height, wide = image.shape[:2]
    if wide <= width:
        return image
    shown: ImageArray = cv2.resize(image, (width, max(1, round(height * width / wide))), interpolation=interpolation)  # type: ignore[assignment]
    return shown
