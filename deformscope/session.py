"""The loop: devices or a recording -> frames -> experiment (pure stages) -> recording, one frame at a time."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from deformscope.frames import ColorFrame, HealthReport, Item

SummaryT = TypeVar("SummaryT")
SummaryT_co = TypeVar("SummaryT_co", covariant=True)

BATCH_S = 0.1
"""How long what devices give is gathered before it is recorded together: each call of a recorder's costs its time."""


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


class SessionRecorder(Protocol):
    """Where a session's frames and results go (`deformscope.recording.recorder.Recorder`)."""

    def write_frame(self, frame: ColorFrame) -> None: ...

    def write(self, step: Step) -> None: ...

    def write_items(self, items: Sequence[Item]) -> None: ...


def run(source: Iterable[ColorFrame], experiment: Experiment[SummaryT], recorder: SessionRecorder) -> SummaryT:
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


class SessionRig(Protocol):
    """Open devices (`deformscope.rig.source.RigSource`)."""

    def take(self, wait_s: float) -> list[Item]: ...

    def look(self) -> HealthReport: ...

    def rest(self) -> list[Item]: ...

    def close(self) -> None: ...


@contextlib.contextmanager
def watching(rig: SessionRig, recorder: SessionRecorder) -> Iterator[Callable[[], None]]:
    """Record what the devices of a rig give, from a thread, while something else goes on; what comes last is left to
    who closes them. Yields what raises, once it is asked, what keeps it from recording; so does the context's end."""
    ended = threading.Event()
    failures: list[Exception] = []

    def record() -> None:
        try:
            while not ended.wait(BATCH_S):
                recorder.write_items(rig.take(0.0))
        except Exception as error:
            failures.append(error)

    def go_on() -> None:
        if failures:
            raise failures[0]

    recording = threading.Thread(target=record, name="recording", daemon=True)
    recording.start()
    try:
        yield go_on
    finally:
        ended.set()
        recording.join()
    go_on()


def watch(rig: SessionRig, recorder: SessionRecorder, ended: Callable[[Sequence[Item]], bool]) -> HealthReport:
    """Record what the devices of a rig give until `ended` says so; it sees every batch. Nothing that came is left.

    Returns the last look at the devices, closed by then: its counts are those of the whole session.
    """
    while True:
        items = rig.take(BATCH_S)
        recorder.write_items(items)
        if ended(items):
            break
    rig.close()
    last = rig.look()
    recorder.write_items([*rig.rest(), last])
    return last
