"""The loop: every frame is recorded before its results, and an experiment may speak after the last."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deformscope.frames import ColorFrame, Frame
from deformscope.session import Experiment, Step, run, watching
from deformscope_drivers.clock import Stamp
from tests.patience import PATIENCE_S


@dataclass
class Notes:
    said: list[object] = field(default_factory=list)

    def write_frame(self, frame: Frame) -> None:
        self.said.append(frame.index)

    def write(self, step: Step) -> None:
        self.said.append(step)


def frames(count: int) -> list[ColorFrame]:
    return [ColorFrame(Stamp(index), index, np.zeros((2, 2), np.uint8)) for index in range(count)]


def echo() -> Experiment[str]:
    frame = yield Step(("never recorded",))
    seen = []
    while frame is not None:
        seen.append(frame.index)
        frame = yield Step((f"saw {frame.index}",))
    for index in seen:
        yield Step((f"again {index}",), frame=index)
    return "summary"


def test_order() -> None:
    notes = Notes()
    assert run(frames(2), echo(), notes) == "summary"
    assert notes.said == [
        0,
        Step(("saw 0",)),
        1,
        Step(("saw 1",)),
        Step(("again 0",), frame=0),
        Step(("again 1",), frame=1),
    ]


def test_an_experiment_may_end_early() -> None:
    def one() -> Experiment[int]:
        frame = yield Step()
        assert frame is not None
        return frame.index

    notes = Notes()
    assert run(frames(3), one(), notes) == 0
    assert notes.said == [0]


def test_no_frames() -> None:
    assert run([], echo(), Notes()) == "summary"


def test_what_keeps_a_rig_from_being_recorded_is_told_while_it_goes_on() -> None:
    """Not only in the end: whoever moves an arm meanwhile asks, and stops."""

    def fail(items: object) -> None:
        raise OSError("the disk is full")

    rig: Any = SimpleNamespace(take=lambda wait_s: [])
    recorder: Any = SimpleNamespace(write_items=fail)
    until = time.monotonic() + PATIENCE_S
    with pytest.raises(OSError, match="disk"), watching(rig, recorder) as go_on:  # noqa: PT012
        while time.monotonic() < until:
            go_on()
        pytest.fail("nobody was told")
