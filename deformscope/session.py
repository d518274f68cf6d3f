"""The loop: devices or a recording -> frames -> experiment (pure stages) -> recording, one frame at a time."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from deformscope.frames import ColorFrame

SummaryT = TypeVar("SummaryT")
SummaryT_co = TypeVar("SummaryT_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Step:
    """What an experiment has to say about one frame.

    frame: the index of the frame that the results belong to; None = the frame just sent
    results: stage results, each of a type that `deformscope.log` knows how to show
    """

    results: tuple[object, ...] = ()
    frame: int | None = None


Experiment = Generator[Step, ColorFrame | None, SummaryT]
"""Frames are sent in, steps come out. `None` means the stream has ended: the experiment may then yield further
steps (each naming its frame) and returns its summary."""


class Recorder(Protocol):
    """Where a session's frames and results go (`deformscope.recorder.Recorder`)."""

    def write_frame(self, frame: ColorFrame) -> None: ...

    def write(self, step: Step) -> None: ...


def run(source: Iterable[ColorFrame], experiment: Experiment[SummaryT], recorder: Recorder) -> SummaryT:
    """Drive one experiment over one source to its end and return its summary."""
    next(experiment)
    try:
        for frame in source:
            recorder.write_frame(frame)
            recorder.write(experiment.send(frame))
        step = experiment.send(None)
        while True:
            recorder.write(step)
            step = next(experiment)
    except StopIteration as end:
        summary: SummaryT = end.value
        return summary
