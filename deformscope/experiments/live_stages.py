"""Stages that run while devices do: items of a rig in, results out, computed beside the loop that takes the items.

    with StageProcesses(options.names, quiet_warp) as executors:
        counts = session.run(rig, live_stages(stages_of(options, streams), executors, ended), recorder)

The newest frame wins: while a stage computes, frames pass it by, and are counted. An image is computed on as it is
recorded (decoded from JPEG), and a result names the frames that it rests on: `replay_stages` computes every result of a
recording again and compares it to the last bit. A stage that fails gives a `StageFailure`, and goes on with what comes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from deformscope.frames import Frame, Item, StageCost, StageResult, UsedFrames
from deformscope.images import decode_image, encode_color
from deformscope.session import RigExperiment, Step, with_costs
from deformscope.stages.map.exploration import StageFailure
from deformscope_drivers.clock import monotonic_ns

if TYPE_CHECKING:
    from deformscope.experiments.device_stages import Stage


SOON_S = 0.02
"""How long what devices give is gathered while stages wait for it: a frame is not kept waiting longer."""


class StageExecutor(Protocol):
    """Computes a stage while the loop goes on."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]: ...


@dataclass(slots=True)
class StageCounts:
    """What became of a stage's frames. frames: that came; results; failures among them; late_s: of each result [s]"""

    frames: int = 0
    results: int = 0
    failures: int = 0
    skipped: int = 0
    late_s: list[float] = field(default_factory=list)

    def as_json(self) -> dict[str, object]:
        """Counts, and how far results were behind their frame [ms]; null where there were none."""
        lag = None
        if self.late_s:
            p50, p95, most = (float(value) for value in np.percentile(self.late_s, (50, 95, 100)) * 1e3)
            lag = {"p50": p50, "p95": p95, "max": most}
        counts = {"frames": self.frames, "results": self.results, "failures": self.failures, "skipped": self.skipped}
        return {**counts, "lag_ms": lag}

    def to_text(self) -> str:
        """The same in a line."""
        failed = f", {self.failures} of them FAILED" if self.failures else ""
        lag = ""
        if self.late_s:
            p50, p95, most = np.percentile(self.late_s, (50, 95, 100)) * 1e3
            lag = f", behind their frame by {p50:.0f} ms (median), {p95:.0f} ms (95 %), {most:.0f} ms at most"
        return f"{self.results} results of {self.frames} frames{failed}, {self.skipped} skipped{lag}"


def live_stages(
    stages: Sequence[Stage],
    executors: Mapping[str, StageExecutor],
    ended: Callable[[Sequence[Item]], bool],
    *,
    lossless: bool = False,
) -> RigExperiment[dict[str, StageCounts]]:
    """The experiment that passes on what comes to stages, and gives the `StageResult`s that came; returns the counts.

    executors: what computes each stage, by its name: each has its own, so that none waits for another; ended: sees
    every batch, and says when it is over; lossless: colour images are recorded as they are
    """
    running = [_Running(stage, executors[stage.name], lossless) for stage in stages]
    given = yield Step(batch_s=SOON_S)
    over = False
    while not over:
        items = given if isinstance(given, Sequence) else ()
        results = tuple(result for one in running if (result := one.result()) is not None)
        for one in running:
            one.go_on(items)
        over = ended(items)
        if results or not over:
            costs = tuple(cost for one in running for cost in one.costs()) if results else ()
            given = yield Step(results, batch_s=SOON_S, costs=costs)
    return {one.stage.name: one.end() for one in running}


class _Running:
    """A stage, what it computes now, and what became of its frames so far."""

    def __init__(self, stage: Stage, executors: StageExecutor, lossless: bool) -> None:
        self.stage = stage
        self._executor, self._lossless = executors, lossless
        self._chooser = stage.chooser()
        self._counts = StageCounts()
        self._skipped = 0
        self._frames: tuple[Frame, ...] = ()
        self._future: Future[tuple[tuple[object, int], list[StageCost]]] | None = None
        self._costs: list[StageCost] = []

    def go_on(self, items: Sequence[Item]) -> None:
        """Take what came; begin with the newest where nothing is being computed."""
        for item in items:
            self._chooser.see(item)
            self._counts.frames += isinstance(item, Frame) and item.device == self.stage.device
        if self._future is not None:
            return
        frames = self._chooser.take()
        if frames is None:
            return
        self._frames = frames
        self._skipped, self._chooser.skipped = self._chooser.skipped, 0
        given = compute_stage, self.stage, self.stage.packed(frames), self._lossless
        self._future = self._executor.submit(with_costs, self.stage.name, *given)

    def result(self) -> StageResult | None:
        """The result where it has come."""
        if self._future is None or not self._future.done():
            return None
        future, self._future = self._future, None
        error = future.exception()
        newest, now_ns = self._frames[-1], monotonic_ns()
        if error is None:
            (result, now_ns), self._costs = future.result()
        else:
            result = StageFailure.of(self.stage.name, 0, error if isinstance(error, Exception) else Exception(error))
        counts = self._counts
        counts.results += 1
        counts.failures += isinstance(result, StageFailure)
        counts.skipped += self._skipped
        counts.late_s.append((now_ns - newest.stamp.host_ns) / 1e9)
        used = used_frames(self._frames)
        self._frames = ()
        return StageResult(self.stage.name, used, newest.stamp.host_ns, self._skipped, counts.late_s[-1], result)

    def costs(self) -> list[StageCost]:
        """What the last result cost; none a second time."""
        costs, self._costs = self._costs, []
        return costs

    def end(self) -> StageCounts:
        """The counts, with what nothing was computed from in the end among the skipped."""
        self._counts.skipped += self._chooser.skipped + (self._chooser.take() is not None)
        if self._future is not None:
            self._counts.skipped += self._skipped + 1
        return self._counts


def used_frames(frames: Sequence[Frame]) -> tuple[UsedFrames, ...]:
    """The stretches of these frames in their devices' streams, that of the last frame's device last."""
    found: list[UsedFrames] = []
    for device in sorted({frame.device for frame in frames}, key=lambda device: device == frames[-1].device):
        for frame in (frame for frame in frames if frame.device == device):
            if found and found[-1].device == device and found[-1].last + 1 == frame.index:
                found[-1] = UsedFrames(device, found[-1].first, frame.index)
            else:
                found.append(UsedFrames(device, frame.index, frame.index))
    return tuple(found)


def compute_stage(stage: Stage, packed: Any, lossless: bool) -> tuple[object, int]:
    """A stage's result of live frames, and when it was there [ns]. What fails is a result too."""
    from deformscope.experiments.device_stages import compute

    images = packed if stage.name in ("flow", "beta") else ()
    try:
        if images:
            packed = tuple(decode_image(encode_color(image, lossless=lossless), "image") for image in images)
        result = compute(stage, packed)
    except Exception as error:
        result = StageFailure.of(stage.name, 0, error)
    return result, monotonic_ns()
