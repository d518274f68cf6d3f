"""Stages that run during a rig's recording: they receive the rig's items, and are computed outside of the loop that
reads the items.

    with StageProcesses(options.names, quiet_warp) as executors:
        counts = session.run(rig, live_stages(stages_of(options, streams), executors, ended), recorder)

A stage uses the newest frame: frames that arrive during its computation are skipped and counted. A stage without a
result notes the reason after a second, or with its first frame; a slow one notes its delay behind its frame. A stage
uses an image as recorded (decoded from JPEG), and a result names its frames. `replay_stages` computes every result of a
recording again and compares it to the last bit. A stage that fails gives a `StageFailure`, and continues with later
items.
"""

import contextlib
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.errors import InputError
from deformscope.experiments.live.device_stages import CELL_M, REFERENCE, LiveOptions, Stage, StageName, compute
from deformscope.frames import Frame, Item, NoteKind, SessionNote, StageCost, StageResult, UsedFrames
from deformscope.images import decode_image, encode_color
from deformscope.processes import LAST_NICE, computing
from deformscope.session import RigExperiment, Step, with_costs
from deformscope.stages.fit.moment import MomentFit
from deformscope.stages.map.exploration import StageFailure
from deformscope.stages.map.surface import fit_surface
from deformscope.stages.regions.touches import MapGrid
from deformscope_drivers.clock import monotonic_ns

if TYPE_CHECKING:
    from deformscope.experiments.live.device_stages import Stage

SOON_S = 0.02
"""Time for which device items are collected while stages wait for them: it delays a frame by this at most."""
AT_ONCE_S = 1.0
"""Time without a result after which a stage reports the reason."""
AGAIN_S = 10.0
"""Time after which a reason may be reported again."""
LEFT_OUT_LEAST = 3
"""Number of skipped frames after which a note reports that a stage is too slow."""
NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?")
"""Pattern of numbers: reasons that differ only in numbers count as the same."""


class StageExecutor(Protocol):
    """Computes a stage while the loop continues."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]: ...


@dataclass(slots=True)
class StageCounts:
    """Outcomes of a stage's frames. frames: number of frames that came; results, failures: numbers of results, and of
    failures among them; late_s: delay of each result [s]

    left: frames that were skipped because newer ones came; the others were not finished when it ended; lasted_s: time
    since the first frame [s]; reasons: reasons of the results that give nothing, with how many there were of each
    nothing: why there is no result, "" where there is one"""

    frames: int = 0
    results: int = 0
    failures: int = 0
    skipped: int = 0
    late_s: list[float] = field(default_factory=list)
    left: int = 0
    lasted_s: float = 0.0
    reasons: dict[str, int] = field(default_factory=dict)
    nothing: str = ""

    @property
    def rate_hz(self) -> float:
        """Results per second."""
        return self.results / self.lasted_s if self.lasted_s > 0.0 else 0.0

    @property
    def lag_ms(self) -> dict[str, float] | None:
        """Delay of results behind their frame; None without results."""
        if not self.late_s:
            return None
        return dict(zip(("p50", "p95", "max"), (1e3 * np.percentile(self.late_s, (50, 95, 100))).tolist(), strict=True))

    def as_json(self) -> dict[str, object]:
        """All fields."""
        counts = {"frames": self.frames, "results": self.results, "failures": self.failures, "skipped": self.skipped}
        skipped_by = {"newer": self.left, "ended": self.skipped - self.left}
        more = {"rate_hz": self.rate_hz, "skipped_by": skipped_by, "reasons": self.reasons, "nothing": self.nothing}
        return {**counts, "lag_ms": self.lag_ms, **more}

    def to_text(self) -> str:
        """The counts in a line."""
        failed = f", {self.failures} of them FAILED" if self.failures else ""
        late = "behind their frame by {p50:.0f} ms (median), {p95:.0f} ms (95 %), {max:.0f} ms at most"
        lag = "" if self.lag_ms is None else f", {late.format(**self.lag_ms)}"
        why = f" ({self.left} for newer ones, {self.skipped - self.left} at the end)" if self.skipped else ""
        rate = f", {self.rate_hz:.3g}/s" if self.results else ""
        found = f"{self.results} results of {self.frames} frames{rate}{failed}, {self.skipped} skipped{why}{lag}"
        found += "".join(f"; {count} without a value: {reason}" for reason, count in self.reasons.items())
        return f"{found}; nothing: {self.nothing}" if self.nothing else found


def live_stages(
    stages: "Sequence[Stage]",
    executors: Mapping[str, StageExecutor],
    ended: Callable[[Sequence[Item]], bool],
    *,
    lossless: bool = False,
    watch: Callable[[StageResult], None] = lambda result: None,
    clock: Callable[[], int] = monotonic_ns,
) -> RigExperiment[dict[str, StageCounts]]:
    """The experiment that passes items to stages, and yields their `StageResult`s; returns the counts.

    executors: the executor of each stage, by the stage's name; each has its own, so that no stage waits for another;
    ended: called with every batch and the stages' notes, returns whether to end; lossless: colour images are recorded
    without losses; watch: called with every result; clock: the host's, or that of recorded items [ns]"""
    running = [_Running(stage, executors[stage.name], lossless, clock) for stage in stages]
    given = yield Step(batch_s=SOON_S)
    over = False
    while not over:
        items = given if isinstance(given, Sequence) else ()
        results = tuple(result for one in running if (result := one.result()) is not None)
        for result in results:
            watch(result)
        for one in running:
            one.go_on(items)
        notes = tuple(note for one in running for note in one.notes())
        over = ended((*items, *notes))
        if results or notes or not over:
            costs = tuple(cost for one in running for cost in one.costs()) if results else ()
            given = yield Step(results, batch_s=SOON_S, costs=costs, notes=notes)
    return {one.stage.name: one.end() for one in running}


class _Running:
    """A stage, its present computation, and the outcomes of its frames so far."""

    def __init__(self, stage: "Stage", executors: StageExecutor, lossless: bool, clock: Callable[[], int]) -> None:
        self.stage = stage
        self._executor, self._lossless, self._clock = executors, lossless, clock
        self._began_ns, self._first_ns = clock(), 0
        self._reason, self._said_ns = "", dict[str, int]()
        self._notes: list[SessionNote] = []
        self._chooser = stage.chooser()
        self._counts = StageCounts()
        self._skipped = 0
        self._frames: tuple[Frame, ...] = ()
        self._future: Future[tuple[tuple[object, int], list[StageCost]]] | None = None
        self._costs: list[StageCost] = []

    def go_on(self, items: Sequence[Item]) -> None:
        """Take finished results; begin with the newest item if nothing is being computed."""
        for item in items:
            self._chooser.see(item)
            if isinstance(item, Frame) and item.device == self.stage.device:
                self._counts.frames += 1
                self._first_ns = self._first_ns or self._clock()
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
        newest, now_ns = self._frames[-1], self._clock()
        if error is None:
            (result, now_ns), self._costs = future.result()
        else:
            result = StageFailure.of(self.stage.name, 0, error if isinstance(error, Exception) else Exception(error))
        counts = self._counts
        counts.results += 1
        counts.failures += isinstance(result, StageFailure)
        counts.skipped += self._skipped
        counts.left += self._skipped
        counts.late_s.append((now_ns - newest.stamp.host_ns) / 1e9 if self._clock is monotonic_ns else 0.0)
        reason = reason_of(result)
        if reason:
            same = next((known for known in counts.reasons if alike(known) == alike(reason)), reason)
            counts.reasons[same] = counts.reasons.get(same, 0) + 1
        self._say(reason)
        if counts.skipped > max(counts.results, LEFT_OUT_LEAST - 1):
            self._say_late()
        used = used_frames(self._frames)
        self._frames = ()
        return StageResult(self.stage.name, used, newest.stamp.host_ns, self._skipped, counts.late_s[-1], result)

    def costs(self) -> list[StageCost]:
        """Cost of the last result; none a second time."""
        costs, self._costs = self._costs, []
        return costs

    def end(self) -> StageCounts:
        """The counts, with unused frames at the end among the skipped."""
        counts = self._counts
        counts.nothing = "" if counts.results else self._lack
        left = self._chooser.skipped + (self._skipped if self._future is not None else 0)
        counts.left += left
        counts.skipped += left + (self._chooser.take() is not None) + (self._future is not None)
        counts.lasted_s = (self._clock() - self._first_ns) / 1e9 if self._first_ns else 0.0
        return counts

    def notes(self) -> list[SessionNote]:
        """The present notes."""
        since_ns = self._frames[-1].stamp.host_ns if self._frames else self._began_ns
        if not self._counts.results and self._clock() - since_ns >= AT_ONCE_S * 1e9:
            self._say(self._lack)
        found, self._notes = self._notes, []
        return found

    @property
    def _lack(self) -> str:
        """Why there is no result yet."""
        return self._chooser.lacks if self._future is None else "the first result is still being computed"

    def _say(self, reason: str) -> None:
        """Note why it gives nothing, "" = it gives results, where that is news."""
        if alike(reason) == alike(self._reason):
            return
        self._reason = reason
        text = f"{self.stage.name} gives " + (f"nothing: {reason}" if reason else "results")
        self._note("stage" if reason else "stage-over", text, alike(reason), AGAIN_S)

    def _say_late(self) -> None:
        """Note once that it does not keep up."""
        counts = self._counts
        got = f"{counts.results} of {counts.results + counts.skipped} so far"
        behind = f"{self.stage.name} takes the newest of {self.stage.device}'s frames, {got}: "
        self._note("stage", f"{behind}{counts.late_s[-1] * 1e3:.0f} ms behind its frame", "late", float("inf"))

    def _note(self, about: NoteKind, text: str, kind: str, again_s: float) -> None:
        now_ns = self._clock()
        if kind not in self._said_ns or now_ns - self._said_ns[kind] >= again_s * 1e9:
            self._said_ns[kind] = now_ns
            self._notes.append(SessionNote(now_ns, about, text))


def reason_of(result: object) -> str:
    """Why a result has no value; "" if it has one."""
    if isinstance(result, StageFailure):
        return result.reason
    return result.verdict_text if isinstance(result, MomentFit) and np.isnan(result.value) else ""


def alike(reason: str) -> str:
    """The reason without its numbers."""
    return NUMBER.sub("#", reason)


def used_frames(frames: Sequence[Frame]) -> tuple[UsedFrames, ...]:
    """The ranges of these frames in their devices' streams; that of the last frame's device is last."""
    found: list[UsedFrames] = []
    for device in sorted({frame.device for frame in frames}, key=lambda device: device == frames[-1].device):
        for frame in (frame for frame in frames if frame.device == device):
            if found and found[-1].device == device and found[-1].last + 1 == frame.index:
                found[-1] = UsedFrames(device, found[-1].first, frame.index)
            else:
                found.append(UsedFrames(device, frame.index, frame.index))
    return tuple(found)


def compute_stage(stage: "Stage", packed: Any, lossless: bool) -> tuple[object, int]:
    """A stage's result from live frames, and when it was ready [ns]. A failure is a result too."""
    from deformscope.experiments.live.device_stages import REFERENCE, compute

    images = packed if stage.name in REFERENCE else ()
    try:
        if images:
            packed = tuple(decode_image(encode_color(image, lossless=lossless), "image") for image in images)
        result = compute(stage, packed)
    except Exception as error:
        result = StageFailure.of(stage.name, 0, error)
    return result, monotonic_ns()


# Processes that compute stages outside the loop that reads devices


class StageProcesses:
    """A process for every stage; they have loaded their modules when the context begins, before any device is opened.

    Stages have processes, not threads, because threads would compete for Python's lock. On two cores with `lab:bench` a
    fit of beta came 3.6 s after its frame from a thread, 0.6 s from a process. They have the lowest priority by
    default: eight stages of the same priority as the recording left it 6 % of a core, and ended it."""

    def __init__(self, names: Sequence[StageName], start_engine: Callable[[], None], *, nice: int = LAST_NICE) -> None:
        """start_engine: starts the simulation engine, in the process of a stage that needs it"""
        self._warm_ups = {name: partial(warm_up, name, start_engine) for name in names}
        self._nice = nice
        self._processes: dict[str, StageProcess] = {}

    def __enter__(self) -> Mapping[str, StageExecutor]:
        self._processes = {name: StageProcess(warm, self._nice) for name, warm in self._warm_ups.items()}
        for process in self._processes.values():
            process.warm.result()
        return self._processes

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        for process in self._processes.values():
            process.close()


class StageProcess(contextlib.ExitStack):
    """One process; it is replaced if it dies. warm: future that is done when its stage is loaded"""

    def __init__(self, warm_up: Callable[[], None], nice: int) -> None:
        super().__init__()
        self._warm_up, self._nice = warm_up, nice
        self._start()

    def _start(self) -> None:
        self._executor = self.enter_context(computing(bool, nice=self._nice))
        self.warm = self._executor.submit(self._warm_up)

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Compute an input after earlier submissions."""
        try:
            return self._executor.submit(function, *arguments)
        except BrokenProcessPool:
            self.close()
            self._start()
            return self._executor.submit(function, *arguments)


def warm_up(name: StageName, start_engine: Callable[[], None]) -> None:
    """Import modules and compile kernels in advance."""
    if name in ("beta", "theta", "field"):
        start_engine()
    if name in REFERENCE:
        image = np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8)
        before = np.asarray(cv2.GaussianBlur(image, (0, 0), 2.0))
        stage = Stage(name, LiveOptions((name,), color="camera"))
        with contextlib.suppress(InputError):
            compute(stage, (before, np.roll(before, 2, axis=1)))
    elif name == "surface":
        x, y = np.meshgrid(np.linspace(0.0, 0.1, 12), np.linspace(0.0, 0.1, 12))
        points = np.column_stack([x.ravel(), y.ravel(), 1e-3 * np.sin(40.0 * x.ravel())])
        with threadpool_limits(1):
            fit_surface(points).on(MapGrid((0.1, 0.1), CELL_M))
