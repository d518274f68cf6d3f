"""The loop: an experiment receives frames and answers, and gives results and commands; everything is recorded.

An experiment is a generator. It receives a source's items (a frame of a video, or all items of a rig's devices since
the last time), None once a source has ended, and an `Answer` to each of its commands. It yields a `Step`: results, and
a command where it acts. Neither a robot's motion nor a computation blocks the loop: frames are recorded and sent to the
experiment until the answer is ready."""

import concurrent.futures
import dataclasses
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from deformscope.frames import ColorFrame, HealthReport, Item, SessionNote, StageCost

SummaryT = TypeVar("SummaryT")
ValueT = TypeVar("ValueT")

BATCH_S = 0.1
"""Time over which device items are gathered for one recorder call, because each call costs time."""


@dataclass(frozen=True, slots=True)
class Moment:
    """Time of results in a session with a robot.

    now_ns: time on the robot's clock; touch: number of the touch to which they belong, from 1; 0 before the first;
    seen_ns: when their dent was last seen, None without a dent; cell_m: cell size of a plan's maps [m]"""

    now_ns: int
    touch: int = 0
    seen_ns: int | None = None
    cell_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Compute:
    """A command: call a function outside the loop (for devices on their own clock); its value is the answer.

    stage: name under which its cost is recorded"""

    call: Callable[..., object]
    arguments: tuple[object, ...] = ()
    stage: str = "computation"


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of the last command. value: computed value, or result of the robot"""

    value: Any


@dataclass(frozen=True, slots=True)
class Step:
    """Output of an experiment.

    results: stage results, each of a type with a view in `deformscope.log`
    frame: index of the results' frame; None = the frame that was just sent
    moment: their time instead, in a session with a robot; command: a `Compute`, a future that another party will fill,
    such as a person's answer, or a command that the robot carries out; an experiment gives one at a time
    batch_s: time over which device items are then gathered, without a robot
    costs: costs of the computations behind the results; the loop adds them; notes: remarks for the recording"""

    results: tuple[object, ...] = ()
    frame: int | None = None
    moment: Moment | None = None
    command: object | None = None
    batch_s: float = BATCH_S
    costs: tuple[StageCost, ...] = dataclasses.field(default=(), compare=False)
    notes: tuple[SessionNote, ...] = ()


Experiment = Generator[Step, ColorFrame | None, SummaryT]
"""A generator that receives frames and yields steps. `None` means the stream has ended: the experiment may then yield
further steps (each naming its frame) and returns its summary."""

RigExperiment = Generator[Step, Sequence[Item] | Answer | None, SummaryT]
"""An experiment that receives batches of a rig's items, and answers to its commands; an error of a command is raised in
it where it waits for the answer."""


class SessionRecorder(Protocol):
    """Destination of a session's frames and results (`deformscope.recording.recorder.Recorder`)."""

    def write(self, items: object) -> None: ...


class SessionRig(Protocol):
    """Open devices (`deformscope.rig.source.RigSource`)."""

    def take(self, wait_s: float) -> list[Item]: ...

    def look(self) -> HealthReport: ...

    def rest(self) -> list[Item]: ...

    def close(self) -> None: ...


class SessionRobot(Protocol):
    """An object that carries out commands (`deformscope.experiments.commanded_robot`).

    stopped: future that fails when the robot must stop, also without a command"""

    stopped: Future[None]

    def carry_out(self, command: object, keep: Callable[[], object]) -> Future[Any]:
        """Begin with a command. keep: called from time to time by a robot that has to wait before it returns"""

    def reports(self) -> list[Step]:
        """New actions since the last call."""


class Inline(Executor):
    """Computes immediately, while simulated time is stopped."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Compute immediately, as an `Executor`; an interruption is raised here."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


_measured: ContextVar[list[StageCost] | None] = ContextVar("measured", default=None)


@contextmanager
def measuring(stage: str) -> Iterator[None]:
    """Measure the computation in the context as the cost of this stage, without the costs measured inside it."""
    outer, inner = _measured.get(), list[StageCost]()
    kept = _measured.set(inner)
    wall_ns, cpu_ns = time.perf_counter_ns(), time.thread_time_ns()
    try:
        yield
    finally:
        wall_ms, cpu_ms = (time.perf_counter_ns() - wall_ns) / 1e6, (time.thread_time_ns() - cpu_ns) / 1e6
        _measured.reset(kept)
        if outer is not None:
            wall_ms -= sum(one.wall_ms for one in inner)
            cpu_ms -= sum(one.cpu_ms for one in inner)
            outer += [*inner, StageCost(stage, max(wall_ms, 0.0), max(cpu_ms, 0.0))]


def with_costs(stage: str, call: Callable[..., ValueT], *arguments: object) -> tuple[ValueT, list[StageCost]]:
    """Compute a value, and its cost by stage, in any process or thread."""
    costs = list[StageCost]()
    kept = _measured.set(costs)
    try:
        with measuring(stage):
            value = call(*arguments)
    finally:
        _measured.reset(kept)
    return value, costs


def run(
    source: Iterable[ColorFrame] | SessionRig,
    experiment: Generator[Step, Any, SummaryT],
    recorder: SessionRecorder,
    robot: SessionRobot | None = None,
    executor: Executor | None = None,
) -> SummaryT:
    """Drive one experiment over one source to its end and return its summary. executor: computes; None = `Inline`

    The time of a `Compute` is recorded with the next results; with frames of a file, so is that of the experiment."""
    executor = executor or Inline()
    frames = iter(source) if isinstance(source, Iterable) else None
    waiting: Future[Any] | None = None
    heeded = computing = False
    costs = list[StageCost]()

    def send(given: Any) -> Step:
        if frames is None or robot is not None:
            return experiment.send(given)
        step, spent = with_costs("", experiment.send, given)
        costs.extend(spent)
        return step

    def write(step: Step) -> None:
        if step.results and costs:
            step = dataclasses.replace(step, costs=(*step.costs, *costs))
            costs.clear()
        if step.notes:
            recorder.write(step.notes)
        if step.results or (step.moment is None and frames is not None):
            recorder.write(step)

    def keep(wait_s: float = 0.0) -> ColorFrame | Sequence[Item] | None:
        """Record the items."""
        for step in robot.reports() if robot is not None else ():
            write(step)
        if frames is None:
            assert not isinstance(source, Iterable)
            items = source.take(wait_s)
            recorder.write(items)
            return items
        frame = next(frames, None)
        if frame is not None:
            recorder.write(frame)
        return frame

    try:
        step = next(experiment)
        if step.command is None and step.moment is None:  # nothing was sent in yet
            step = send(keep(0.0 if robot is not None else step.batch_s))
        while True:
            write(step)
            if isinstance(step.command, Compute):
                waiting, computing = _started(executor, step.command), True
            elif isinstance(step.command, Future):
                waiting, computing = step.command, False
            elif step.command is not None and robot is not None:
                waiting, computing = robot.carry_out(step.command, keep), False
            if waiting is None:
                step = send(keep(step.batch_s if robot is None else 0.0))
                continue
            either = [waiting] if robot is None or heeded else [waiting, robot.stopped]
            concurrent.futures.wait(either, BATCH_S, concurrent.futures.FIRST_COMPLETED)
            given = keep() if frames is None else None
            ended = next((one for one in either if one.done()), None)
            if ended is None:
                step = send(given)
                continue
            waiting, heeded = None, heeded or ended is not waiting
            if (error := ended.exception()) is not None:
                step = experiment.throw(error)
                continue
            value = ended.result()
            if computing:
                value, spent = value
                costs += spent
            step = send(Answer(value))
    except StopIteration as end:
        summary: SummaryT = end.value
        return summary


def _started(executor: Executor, command: Compute) -> Future[Any]:
    """A computation under way; one that cannot begin has failed."""
    try:
        return executor.submit(with_costs, command.stage, command.call, *command.arguments)
    except Exception as error:
        failed: Future[Any] = Future()
        failed.set_exception(error)
        return failed


def ask(
    command: object, results: tuple[object, ...] = (), moment: Moment | None = None
) -> Generator[Step, Sequence[Item] | Answer | None, Any]:
    """Called in an experiment: give a command, let frames pass, and return its answer's value; raises the command's
    error."""
    given = yield Step(results, moment=moment, command=command)
    while not isinstance(given, Answer):
        given = yield Step(moment=moment)
    return given.value


def finish(rig: SessionRig, recorder: SessionRecorder) -> HealthReport:
    """Close a rig's devices, and record all remaining items and their last health, whose counts are those of the whole
    session; no item is lost."""
    rig.close()
    last = rig.look()
    recorder.write([*rig.rest(), last])
    return last
