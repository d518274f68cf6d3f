"""Parts that all runs share: devices opened, recorded and closed, the question before a robot moves, and Ctrl-C. At the
end the robot is at rest; a stopped run reports its reason.

The operator of a run: a person at the terminal, at the page if the run has one, or a script with given consent."""

import contextlib
import os
import select
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn, Protocol, TypeVar

from deformscope.errors import InputError
from deformscope.log.layout import RigLayout
from deformscope.page.devices import ShownDevices, WatchedDevices
from deformscope.robot.jogging import LEAVE
from deformscope.session import RigExperiment, Step, finish
from deformscope.terminal import Interruption, say, status_line

if TYPE_CHECKING:
    from pathlib import Path

    from deformscope.arrays import FloatArray
    from deformscope.config import ExploreConfig, SqueezeConfig
    from deformscope.experiments.explore.options import ExploreOptions
    from deformscope.experiments.explore.touching_robot import TouchingRobot
    from deformscope.frames import HealthReport
    from deformscope.page.robot_page import RobotPage
    from deformscope.page.server.page_session import PageSession
    from deformscope.recording.recorder import Recorder
    from deformscope.rig.source import RigSource
    from deformscope.robot.by_hand import PlaceRequest
    from deformscope.robot.setup import Setup
    from deformscope.session import RigExperiment, SessionRecorder
    from deformscope.stages.map.exploration import ExplorationStop
    from deformscope.stages.squeeze.trial import SqueezeStop
    from deformscope.terminal import Interruption

PageT = TypeVar("PageT", bound="RobotPage")

HALTS = 3
"""Number of attempts to halt the arm, as an interruption may end each."""
SHOW_EVERY = 10
"""Number of control periods between two messages to the user."""


@dataclass(slots=True, eq=False)
class OpenRun:
    """A run whose devices are open and recorded.

    line: shows one line, which the next replaces; recorded: the recorder of the session; last: the devices when they
    were closed, None before"""

    source: "RigSource"
    line: Callable[[str], None]
    recorded: "SessionRecorder"
    last: "HealthReport | None" = None

    def watch(self, asked: "Interruption", page: "RobotPage | None" = None) -> "Watch":
        """Function that is called in every control period of its robot."""
        return Watch(asked, self.line, *(() if page is None else (page.show,)))

    def open_page(
        self,
        recorder: "Recorder",
        config: "ExploreConfig | SqueezeConfig",
        make: "Callable[[PageSession, ShownDevices], PageT]",
    ) -> PageT | None:
        """From now on print alarms at the terminal, and show the state of devices on the recorder's page. Returns the
        object of `make` that moves the robot from there, None without a page."""
        session = None if recorder.page is None else recorder.page.session
        shown = None if session is None else ShownDevices(session, self.source.streams)
        self.recorded = WatchedDevices(recorder, shown, self.line)
        if session is None or shown is None:
            return None
        session.show(title=config.rig, beat_s=config.page_timeout)
        return make(session, shown)

    def losses(self) -> dict[str, dict[str, float]]:
        """Losses of each device that lost something, once the devices are closed."""
        from deformscope.recording.losses import losses_of

        return {} if self.last is None else losses_of(self.last)


@contextlib.contextmanager
def open_run(devices: "AbstractContextManager[RigSource]", recorder: "SessionRecorder") -> Iterator[OpenRun]:
    """The opened devices; at the end they are closed, and everything they sent until then is recorded. Devices that
    fail, even at closing, are printed at the end of the run. Opening them starts the recorder."""
    with contextlib.ExitStack() as closed, devices as source, status_line() as line:
        closed.callback(lambda: _say_failures(source.failures))
        run = OpenRun(source, line, recorder)
        yield run
        run.last = finish(source, run.recorded)


@contextlib.contextmanager
def open_rig_run(devices: "AbstractContextManager[RigSource]", recorder: "Recorder") -> Iterator[OpenRun]:
    """Like `open_run`, with a recording like that of a rig's devices."""
    with open_run(devices, recorder) as run:
        recorder.start(RigLayout(tuple(run.source.streams)), run.source.start_ns)
        yield run


def _say_failures(failures: Mapping[str, str]) -> None:
    """Reasons of the devices that failed, by name."""
    for name, reason in failures.items():
        say(f"deformscope: device {name} failed: {reason}")


class WatchedRobot(Protocol):
    """Interface of a robot for a watch. doing: its present action, in words"""

    @property
    def doing(self) -> str: ...

    def ask_to_stop(self, reason: str) -> None: ...

    def halt(self, reason: str) -> bool: ...


class Watch:
    """Called in every control period: ends the run on request, and shows the robot's state. robot: None until it is
    opened;
    arm_stopped: whether the arm could be stopped, in the end"""

    def __init__(self, asked: "Interruption", *shows: Callable[[str], None]) -> None:
        """asked: set when a person requests the end; shows: where one line goes that the next replaces"""
        self.robot: WatchedRobot | None = None
        self.arm_stopped = True
        self._asked, self._shows = asked, shows
        self._periods = 0

    def __call__(self) -> None:
        if self.robot is None:
            return
        if self._asked.is_set():
            self.robot.ask_to_stop(self._asked.by or signal_word(self._asked.signal_number))
        self._periods += 1
        if self._periods % SHOW_EVERY == 0:
            for show in self._shows:
                show(self.robot.doing)

    @contextlib.contextmanager
    def halts(self, robot: WatchedRobot) -> Iterator[None]:
        """In any case the arm is then halted, even if an attempt was interrupted. In addition each velocity ends after
        40 ms, and the driver erases the arm's trajectories when it closes."""
        self.robot = robot
        reason = "the page that moved it has ended"
        try:
            yield
        except BaseException as error:
            reason += f": {type(error).__name__}"
            raise
        finally:
            self.arm_stopped = False
            for attempt in range(HALTS):
                try:
                    self.arm_stopped = robot.halt(reason)
                    break
                except BaseException:
                    if attempt == HALTS - 1:
                        raise


def permitted(
    robot: "TouchingRobot",
    setup: "Setup",
    options: "ExploreOptions",
    calibrated: Mapping[str, bool],
    asked: "Interruption",
    *,
    yes: bool,
    places_m: "FloatArray | None" = None,
    page: "RobotPage | None" = None,
) -> "RigExperiment[None]":
    """Within an experiment: check everything, print the table of checks, and ask before a real arm moves. Before that,
    request a finger on the tip if the force there is the only guard.

    calibrated: the required calibrations, by name, and whether they are done; yes: do not ask
    places_m: (n, 2) places that will be touched, None = any that can be reached; page: where the question can be
    answered too The checks are repeated after the question, which may have waited for long. Raises InputError if a
    check fails, or no person says yes, and ExplorationStopped if the answer is Ctrl-C."""
    from deformscope.experiments.explore.touching_robot import CheckFirst
    from deformscope.session import ask

    def ask_finger(words: str) -> None:
        say(words)
        if page is not None:
            page.session.remark(words)

    preflight = yield from ask(CheckFirst(calibrated, places_m, ask_finger))
    say(preflight.table())
    if not setup.simulated and preflight.passed:
        touches = f"up to {options.budget} touches of {robot.format_forces}"
        if setup.person is None:
            say(
                f"The arm will now move: {touches}.\nThis program is no safety function: keep the emergency "
                "stop in your hand."
            )
        else:
            say(f"You will be asked to place the stick, step by step: {touches}. Keep your hands out of the picture.")
        if not yes:
            yield from agree(asked, page, touches, or_ended=True)
            if asked.is_set():
                robot.ask_to_stop(signal_word(asked.signal_number))
            preflight = yield from ask(CheckFirst(calibrated, places_m))
            if not preflight.passed:
                say(preflight.table())
    robot.let_move(preflight)
    if page is not None:
        page.go_on()


def agree(
    asked: "Interruption", page: "RobotPage | None", what: str, *, enter_when: str = "", or_ended: bool = False
) -> "RigExperiment[None]":
    """Within an experiment: wait until a person permits the motion, at the page if there is one, or at the terminal.

    what: the motion; enter_when: condition, as text, after which Enter at the terminal is sufficient. Otherwise it
    raises InputError unless a person answers yes. or_ended: nor if a person ends the run"""
    operator = RunOperator(asked, None if page is None else page.is_agreed)
    first = ""
    if page is not None:
        page.wait_for(what)
        first = f"Press {page.button} on the page, or "
    if enter_when:
        yield from operator.line(f"{f'{first}Enter,' if first else 'Press Enter'} {enter_when}: ")
    else:
        yield from operator.confirm(f"{f'{first}type yes,' if first else 'Type yes'} to begin: ", or_ended=or_ended)


def leave_arm(
    stop: "ExplorationStop | None",
    touched: int,
    asked: "Interruption",
    recording: "Path | None",
    *,
    arm_stopped: bool = True,
) -> NoReturn:
    """Like `leave`, after a number of touches."""
    from deformscope.robot.supervisor import Fault

    stands = "the arm is stopped" if arm_stopped else "THE ARM COULD NOT BE STOPPED: check it, use its emergency stop"
    state = f" after {touched} touch{'es' * (touched != 1)}; {stands}"
    ended = stop is None or stop.kind == Fault.ASKED
    leave(stop, state, asked, recording, "an exploration that ends normally", "explore again", ended=ended)


def leave(
    stop: "ExplorationStop | SqueezeStop | None",
    state: str,
    asked: "Interruption",
    recording: "Path | None",
    expected: str,
    again: str,
    *,
    ended: bool,
) -> NoReturn:
    """End the command after a stop: with the reason and the advice, or with the signal's exit status. state: progress
    of the run, and whether the robot is at rest; ended: a person requested the end"""
    import signal

    advice = f"see to {stop.advice}" if stop is not None and stop.advice else ""
    if ended or stop is None:
        complete = "" if recording is None else f"; the recording is complete: {recording}"
        by = asked.by or f"by {signal_word(asked.signal_number)}"
        say(f"deformscope: ended {by}{state}{advice and f'; {advice}'}{complete}")
        raise SystemExit(128 + (asked.signal_number or signal.SIGINT))
    came = f"{stop.kind} ({stop.reason.split(' | ')[0]}){state}"
    raise InputError(expected, came, f"{advice}, then {again}" if advice else again, recording or "")


def signal_word(number: int) -> str:
    """The signal's name for people."""
    import signal

    return "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name if number else "request"


POLL_S = 0.1
Keys = Callable[[], str]
"""The keys that were pressed since the last call."""


@dataclass(frozen=True, slots=True)
class RunOperator:
    """The person who permits motion.

    asked: set when a person requests the end of the run; agreed: a person has agreed at the page, None without one"""

    asked: Interruption
    agreed: Callable[[], bool] | None = None

    def line(self, prompt: str) -> RigExperiment[str]:
        """The typed line; frames continue to come meanwhile. It is empty after a person ends the run, and yes after the
        page has confirmed."""
        print(prompt, end="", file=sys.stderr, flush=True)
        listens = self.agreed is None or at_terminal()
        while not self.asked.is_set():
            if self.agreed is not None and self.agreed():
                return "yes"
            if select.select([sys.stdin] if listens else [], [], [], POLL_S)[0]:
                return sys.stdin.readline().strip().lower()
            yield Step()
        return ""

    def confirm(self, prompt: str, *, or_ended: bool = False) -> RigExperiment[None]:
        """Ask as `line`; raises InputError unless a person answers yes. or_ended: a person who ends the run does not
        cause the error either"""
        if self.agreed is None and not at_terminal():
            raise InputError("a person who confirms", "no terminal for questions", "--yes")
        if (yield from self.line(prompt)) != "yes" and not (or_ended and self.asked.is_set()):
            raise InputError("yes", f"{self.asked.by or 'something else'}: nothing has moved")


class PersonAtTerminal:
    """Places an arm without motors: a line for each request (`robot.by_hand.Person`)."""

    def ask(self, request: "PlaceRequest") -> None:
        say(request.words)

    def answered(self) -> str | None:
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return None
        if not (line := sys.stdin.readline()):
            raise InputError("a person at the terminal who places the arm", "the end of its input", "a terminal")
        return line.strip()


def at_terminal() -> bool:
    """Whether a person at the terminal can answer."""
    return sys.stdin.isatty()


def wait_for_enter(words: str) -> None:
    """Raises InputError at the end of the standard input."""
    say(f"{words}: press Enter")
    if not sys.stdin.readline():
        raise InputError("Enter on the standard input for every frame", "its end", "--pace fast")


@contextlib.contextmanager
def terminal_keys() -> Iterator[Keys]:
    """The keys of the terminal, each when it is pressed. Raises InputError without a terminal."""
    import termios
    import tty

    if not at_terminal():
        raise InputError("a terminal, whose keys move the arm", "none", "run it in a terminal")
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)

    def pressed() -> str:
        if not select.select([descriptor], [], [], 0.0)[0]:
            return ""
        return os.read(descriptor, 64).decode(errors="replace") or LEAVE

    try:
        tty.setcbreak(descriptor)
        yield pressed
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
