"""What accompanies an exploration: it is recorded and shown as it goes on, and ended by Ctrl-C or for a reason."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

from deformscope.cli.common import say
from deformscope.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from deformscope.arrays import FloatArray
    from deformscope.cli.rigs import Interruption
    from deformscope.experiments.explore import ExplorationStopped, ExploreOptions
    from deformscope.experiments.touching_robot import TouchingRobot
    from deformscope.recording.recorder import Recorder
    from deformscope.rig.source import RigSource
    from deformscope.robot.setup import Setup
    from deformscope.robot.touch import Phase
    from deformscope.stages.map.exploration import ExplorationStop

AFTER_S = 0.5
"""A recording goes on for so long after the robot was stopped."""
HALTS = 3
"""Attempts to halt the arm, each of which an interruption may cut short."""
SHOW_EVERY, RECORD_EVERY = 10, 50
"""Control periods between two words to the user, and two portions of the recording: each costs bytes and seconds."""


class Companion:
    """Called in every control period (`__call__`) and at each phase of a touch (`phase_began`).

    touch: the one under way, or the last, from 1; 0 before the first
    arm_told: whether the arm could be told to stand
    """

    def __init__(
        self,
        source: RigSource | None,
        recorder: Recorder,
        asked: Interruption,
        show: Callable[[str], None],
        on_phase: Callable[[Phase, int], None] | None = None,
    ) -> None:
        """source: of devices that go on only with the control periods, None where they go on by themselves and are
        recorded meanwhile; asked: set when somebody wants it to end; show: one line that the next replaces
        on_phase: told phase and touch as well"""
        self.touch = 0
        self.arm_told = True
        self.robot: TouchingRobot | None = None
        self._source, self._recorder, self._asked, self._show = source, recorder, asked, show
        self._on_phase = on_phase
        self._recorded: Callable[[], None] | None = None
        self._periods = 0
        self._begun: list[tuple[str, int, int]] = []

    def follow(self, robot: TouchingRobot, recorded: Callable[[], None] | None = None) -> None:
        """From now on it is this robot's touches that are recorded. recorded: raises what keeps the devices from being
        recorded; asked in every control period, as nobody goes on unrecorded"""
        self.robot = robot
        self._recorded = recorded
        robot.on_phase = self.phase_began

    def __call__(self) -> None:
        if self._recorded is not None:
            self._recorded()
        if self._asked.is_set() and self.robot is not None:
            self.robot.ask_to_stop(signal_word(self._asked.signal_number))
        self._periods += 1
        if self._periods % RECORD_EVERY == 0:
            self.write()
        if self._periods % SHOW_EVERY == 0 and self.robot is not None:
            self._show(self.robot.doing)

    def phase_began(self, phase: Phase, time_ns: int) -> None:
        """It is recorded with the next look at the devices, which costs the control period less."""
        from deformscope.robot.touch import Phase

        self.touch += phase is Phase.TRAVEL
        self._begun.append((str(phase), time_ns, self.touch))
        if self._on_phase is not None:
            self._on_phase(phase, self.touch)

    def write(self) -> None:
        """Record what began and what the devices gave since the last call."""
        from deformscope.stages.map.exploration import PhaseStart

        begun, self._begun = self._begun, []
        for name, time_ns, touch in begun:
            self._recorder.write_results((PhaseStart(name, touch - 1),), time_ns, touch, 0.0)
        if self._source is not None:
            self._recorder.write_items(self._source.take(0.0))

    @contextlib.contextmanager
    def halts(self, robot: TouchingRobot) -> Iterator[None]:
        """Whatever ends this, the arm is then told to stand, also where telling it was interrupted. Beyond it are the
        end of each velocity after 40 ms, and the driver, which erases the arm's trajectories as it closes."""
        reason = "what moved it has ended"
        try:
            yield
        except BaseException as error:
            reason += f": {type(error).__name__}"
            raise
        finally:
            self.arm_told = False
            for attempt in range(HALTS):
                try:
                    self.arm_told = robot.halt(reason)
                    break
                except BaseException:
                    if attempt == HALTS - 1:
                        raise

    def stopped(self, error: ExplorationStopped, robot: TouchingRobot) -> ExplorationStop:
        """Record why and when it was stopped, and what came after; the robot stands."""
        from deformscope.stages.map.exploration import PhaseStart

        stop = error.stop
        with self.halts(robot):
            self._show("")
            self.write()
            phase = PhaseStart(f"stopped: {stop.kind}", stop.touch)
            self._recorder.write_results((phase, stop), error.time_ns, self.touch, 0.0)
            self._recorder.stopped_because(f"{stop.kind}: {stop.reason}")
            robot.look_on(AFTER_S)
        return stop


def let_move(
    robot: TouchingRobot,
    setup: Setup,
    options: ExploreOptions,
    calibrated: Mapping[str, bool],
    asked: Interruption,
    *,
    yes: bool,
    places_m: FloatArray | None = None,
) -> None:
    """Look at everything, print the table of checks, and ask before a real arm moves.

    calibrated: what has to be, by name, and whether it is; yes: do not ask
    places_m: (n, 2) that will be touched, None = any that can be reached
    What was checked is checked again after the question, which may have waited for long. Raises InputError where a
    check fails, or nobody says yes, and ExplorationStopped where it is answered by Ctrl-C.
    """
    preflight = robot.preflight(calibrated, places_m)
    say(preflight.table())
    if not setup.simulated and preflight.passed:
        say(
            f"The arm will now move by itself: up to {options.budget} touches of {robot.forces_told}.\n"
            "This program is no safety function: keep the emergency stop in your hand."
        )
        if not yes and not sys.stdin.isatty():
            raise InputError("somebody who says yes", "no terminal to ask at", "--yes")
        if not yes:
            if not _says_yes(asked):
                raise InputError("yes", "something else: nothing has moved")
            if asked.is_set():
                robot.ask_to_stop(signal_word(asked.signal_number))
            preflight = robot.preflight(calibrated, places_m)
            if not preflight.passed:
                say(preflight.table())
    robot.let_move(preflight)


def _says_yes(asked: Interruption) -> bool:
    """Whether somebody at the terminal says yes, or ends it by Ctrl-C."""
    with asked.at_once():
        try:
            return asked.is_set() or input("Type yes to begin: ").strip().lower() == "yes"
        except KeyboardInterrupt:
            return True
        except EOFError:
            return False


def leave(
    stop: ExplorationStop | None, touched: int, signal_number: int, recording: Path | None, *, arm_told: bool = True
) -> None:
    """End the command as the stop demands: with the reason and what to do, or by the signal's own exit status."""
    from deformscope.robot.supervisor import Fault

    stands = "the arm stands" if arm_told else "THE ARM COULD NOT BE TOLD TO STOP: look at it, use its emergency stop"
    touches = f"after {touched} touch{'es' * (touched != 1)}"
    if stop is None or stop.kind == Fault.ASKED:
        kept = "" if recording is None else f"; the recording is whole: {recording}"
        say(f"deformscope: ended by {signal_word(signal_number)} {touches}; {stands}{kept}")
        raise SystemExit(128 + signal_number)
    hint = f"see to {stop.advice}, then explore again" if stop.advice else "explore again"
    came = f"{stop.kind} ({stop.reason.split(' | ')[0]}) {touches}; {stands}"
    raise InputError("an exploration that comes to its end", came, hint, recording or "")


def signal_word(number: int) -> str:
    """As people call it."""
    import signal

    return "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name if number else "request"
