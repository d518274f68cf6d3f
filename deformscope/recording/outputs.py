"""The outputs of a recording: its file, a live view, both or neither."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from deformscope.frames import InputFile, Item, StageCost
from deformscope.recording.live import LiveFeed
from deformscope.session import Step

if TYPE_CHECKING:
    import rerun as rr

    from deformscope.log.live_stream import LiveStream
    from deformscope.log.rig import Batch
    from deformscope.recording.rrd_file import RecordingFile

COSTS_AT_ONCE = 200
"""Number of rows of costs that are written together."""


class Outputs:
    """The file and the live view of a recording, if any; only the writer's thread uses them."""

    def __init__(self) -> None:
        self.file: RecordingFile | None = None
        self.feed: LiveFeed[LiveStream] | None = None
        self._costs: list[tuple[int, int | None, StageCost]] = []

    def log(self, job: "Callable[[rr.RecordingStream], None]", size: int = 0) -> None:
        """Log to the file, and to the live view when it is ready. size: bytes that the job keeps alive"""
        if self.file is not None:
            self.file.log(job)
        self.show(lambda live: job(live.rec), size, lasting=True)

    def send(self, batch: "Batch", size: int) -> None:
        """Send encoded data; to the live view only those in one of its views."""
        self.keep(batch)
        self.show(lambda live: live.send(batch, lasting=True), size, lasting=True)

    def keep(self, batch: "Batch") -> None:
        """Send a batch to the file only."""
        if self.file is not None:
            self.file.send(batch)

    def add_cost(
        self, session_ns: int, cost: StageCost, *, frame: int | None = None, behind_ns: int | None = None
    ) -> None:
        """Gather a stage's cost for the file: many are written in one portion, as a portion takes a kilobyte.

        session_ns, frame: session time and frame of its result; behind_ns: time from there to the newest frame; None if
        frames wait, or continue"""
        if self.file is not None:
            behind_ms = None if behind_ns is None else behind_ns / 1e6
            self._costs.append((session_ns, frame, dataclasses.replace(cost, behind_ms=behind_ms)))
            if len(self._costs) >= COSTS_AT_ONCE:
                self.write_costs()

    def write_costs(self) -> None:
        """Write the costs that have been gathered."""
        if self._costs:
            from deformscope.log.rig.columns import prepare_costs

            self.keep(prepare_costs(self._costs))
            self._costs = []

    def show(self, job: "Callable[[LiveStream], None]", size: int, *, lasting: bool = False) -> None:
        """Log to the live view only. lasting: dropped last if the viewer is too slow"""
        if self.feed is not None:
            self.feed.put(job, size, lasting=lasting)

    def lay_out(self, views: "rr.blueprint.Blueprint", shown: "rr.blueprint.Blueprint") -> None:
        """Set the views of the file, and those of the window or page."""
        if self.file is not None:
            self.file.log(lambda rec: rec.send_blueprint(views))
        self.show(lambda live: live.rec.send_blueprint(shown), 0, lasting=True)


class Encoder(Protocol):
    """Encodes items for rerun, in the writer's thread, and gives them to the outputs."""

    def write_items(self, items: Sequence[Item], size: int) -> None:
        """Write items of devices, files or cameras."""

    def write_step(self, step: Step, size: int) -> None:
        """Write the results of a step."""

    def write_input(self, given: InputFile) -> None:
        """Write an input file only to the recording's file: no view shows it."""

    def write_overdue(self) -> None:
        """Write the items that have been gathered for long enough."""

    def write_rest(self) -> None:
        """Write the items that are still gathered, at the end."""
