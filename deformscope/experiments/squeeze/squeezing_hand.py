"""Opened devices that squeeze: on hardware, on doubles, and in the laboratory on one simulated clock."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from deformscope.errors import InputError
from deformscope.experiments.commanded_robot import CommandedRobot, without_long_pauses
from deformscope.experiments.squeeze.frames import AIR, OPEN, Predict, SqueezeFrames, SqueezeObserver, TactileSource
from deformscope.rig.source import RigSource
from deformscope.robot.squeeze_plan import CLOSING_AXES, PAD_M, GripShape
from deformscope.robot.squeeze_robot import KEEP_S, SqueezeRobot, SqueezeStopped
from deformscope.robot.squeeze_setup import SqueezeSetup
from deformscope.robot.squeeze_supervisor import ADVICE, SqueezeFault, gap_m
from deformscope.session import Inline, Moment, Step
from deformscope.stages.squeeze.events import BASELINE_FRAMES, ArrayCheck, EventRule, OnsetDetector, StillDetector
from deformscope.stages.squeeze.trial import SqueezePhase, SqueezeStop
from deformscope_drivers.errors import DeviceError

TOUCHING_M = 2 * PAD_M + 0.004
"""Fingertips this near touch each other: nothing is between them."""
KEEP_EVERY = 5
"""Control periods of a simulated clock between two portions of the recording."""
AIR_FRAMES = BASELINE_FRAMES
"""Number of tactile frames in the air, with open fingers at rest, before they close."""
AIR_TIMEOUT_S = 3.0
AFTER_S = 0.5
"""Duration of a recording after the hand was stopped."""
RELEASES = (
    SqueezeFault.SATURATED,
    SqueezeFault.OVER_SQUEEZED,
    SqueezeFault.JOINT_RANGE,
    SqueezeFault.NO_CONTACT,
    SqueezeFault.NOT_STILL,
    SqueezeFault.CONTRADICTED,
)
"""Phases after which the hand, once at rest, opens again, so that it does not press for longer."""


@dataclass(frozen=True, slots=True)
class PreShape:
    """A command: open the fingers, park the thumb."""


@dataclass(frozen=True, slots=True)
class SqueezeOnce:
    """A command: close until the fingers rest, hold, open."""


@dataclass(frozen=True, slots=True)
class HandWait:
    """A command: record the devices for a while, whether or not the hand was stopped."""

    seconds: float


class SqueezeEnded(InputError):
    """The squeeze must stop. stop: why; time_ns: when, on the devices' clock"""

    def __init__(self, stop: SqueezeStop, time_ns: int) -> None:
        super().__init__("a squeeze that reaches its steady state", f"{stop.kind}: {stop.reason}", stop.advice)
        self.stop, self.time_ns = stop, time_ns


@contextlib.contextmanager
def feature_executor(setup: SqueezeSetup, hand: "SqueezingHand") -> Iterator[Executor]:
    """The computation of the features. Devices on their own clock do not wait: hand and features then have a thread
    each."""
    if not setup.runs_itself:
        yield Inline()
        return
    calm = contextlib.nullcontext() if setup.placing is None else without_long_pauses()  # an arm's periods are shorter
    with calm, hand.in_a_thread(), ThreadPoolExecutor(1, "features") as executor:
        yield executor


def rule_of(setup: SqueezeSetup) -> EventRule:
    """The rule of its events, from the rig file."""
    squeeze = setup.squeeze
    return EventRule(squeeze.onset_counts, squeeze.onset_frames, squeeze.still_deg, squeeze.still_s)


class CarryingArm(Protocol):
    """The arm that carries the hand (`deformscope.experiments.squeeze.placing.PlacingArm`)."""

    stands: bool

    def do(self, command: object) -> object: ...

    def watched(self) -> AbstractContextManager[Callable[[], str]]: ...

    def ask_to_stop(self, reason: str) -> None: ...

    def halt(self, reason: str) -> bool: ...


def observer_of(setup: SqueezeSetup, source: RigSource, predict: Predict | None = None) -> SqueezeObserver:
    """The observer of its open devices. predict: as in `SqueezeObserver`"""
    names = setup.names
    tactile = TactileSource.of(source.streams, names.tactile, setup.hand.fingers)
    frames = SqueezeFrames(tactile, names.hand, names.camera, rule_of(setup))
    return SqueezeObserver(frames, setup.hand.tactile_end, predict)


class SqueezingHand(CommandedRobot):
    """The hand over the devices of an open source. Its commands are `PreShape`, `SqueezeOnce`, `HandWait`, and the
    arm's; if the hand stops, the reason is raised as SqueezeEnded.

    arm: carries out the arm's commands, None = no arm

    on_cycle: called in every control period; on_phase: called with each phase when it begins
    observer: is informed of each phase"""

    def __init__(
        self,
        setup: SqueezeSetup,
        source: RigSource,
        observer: SqueezeObserver,
        on_cycle: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__("hand", KEEP_EVERY)
        self.on_phase: Callable[[str], None] = lambda phase: None
        self.doing = ""
        self.arm: CarryingArm | None = None
        self.stands = self.restored = True
        self._setup, self._observer, self._on_cycle = setup, observer, on_cycle
        self._arm_faulty: Callable[[], str] = lambda: ""
        self._robot = SqueezeRobot(
            source.device(setup.names.hand),  # type: ignore[arg-type]
            source.device(setup.names.tactile),  # type: ignore[arg-type]
            setup.hand,
            setup.squeeze,
            GripShape.of(setup.container, setup.squeeze),
            clock=setup.clock,
            wait_until=setup.wait_until,
            on_cycle=self.cycled,
        )

    # Commands ---------------------------------------------------------------------------------------------------------

    def ask_to_stop(self, reason: str) -> None:
        """Stop on a person's request: the hand is at rest within a control period."""
        self._robot.ask_to_stop(reason)
        if self.arm is not None:
            self.arm.ask_to_stop(reason)

    def halt(self, reason: str) -> bool:
        """Stop the hand and restore its current limits; returns whether it confirmed both. Stop the hand, from any
        thread: a running command ends in its next control period."""
        self._robot.ask_to_stop(reason)
        try:
            self.stands = self._robot.halt()
            self.restored = self._robot.restore()
        finally:  # an arm that does not answer takes seconds
            arm_stands = self.arm is None or self.arm.halt(reason)
        return self.stands and self.restored and arm_stands

    def perform(self, command: object) -> Callable[[], Any]:
        """Carry a command out, the arm's too; returns a function that returns the answer."""
        if not isinstance(command, PreShape | SqueezeOnce | HandWait):
            if self.arm is None:
                raise TypeError(f"no command of this hand: {command!r}")
            if self._robot.supervisor.verdict.fault is not SqueezeFault.NONE:  # asked for while the arm did nothing
                raise self._ended(SqueezeStopped(self._robot.supervisor.verdict))
            answer = self.arm.do(command)
            return lambda: answer
        try:
            with self._watching():
                match command:
                    case PreShape():
                        self.begin("pre-shape")
                        self._robot.preshape()
                        self.doing = ""
                    case SqueezeOnce():
                        self._squeeze()
                    case HandWait():
                        self._robot.stand_by(command.seconds)
        except SqueezeStopped as stopped:
            raise self._ended(stopped) from stopped
        return lambda: None

    @contextlib.contextmanager
    def _watching(self) -> Iterator[None]:
        """The arm is judged in each control period; not any more while the fingers open after a stop."""
        if self.arm is None:
            yield
            return
        with contextlib.ExitStack() as watch:
            try:
                self._arm_faulty = watch.enter_context(self.arm.watched())
            except DeviceError as error:  # the arm's alone: what the hand raises is not its fault
                self._robot.fail(SqueezeFault.ARM, " ".join(str(error).split()))
            try:
                yield
            finally:
                self._arm_faulty = lambda: ""

    def _squeeze(self) -> None:
        """Close, hold, open; the events end the phases."""
        robot, squeeze = self._robot, self._setup.squeeze
        onset, still = OnsetDetector(rule_of(self._setup)), StillDetector(rule_of(self._setup))
        arrays = ArrayCheck(rule_of(self._setup), squeeze.speed_deg_s)
        robot.start()
        self.begin(AIR)
        self._wait_in_the_air(onset)
        with robot.low_current():
            self.begin("close")
            until_ns = self._clock() + round(1e9 * squeeze.contact_timeout_s)
            arrays.drive(self._clock())
            while not onset.first_ns:
                self._close(onset, arrays)
                if self._clock() > until_ns:
                    robot.fail(SqueezeFault.NO_CONTACT, f"in {squeeze.contact_timeout_s:g} s of closing")
            robot.supervisor.in_contact()
            self.begin("squeeze")
            until_ns = self._clock() + round(1e9 * squeeze.still_timeout_s)
            while not still.steady_ns:
                self._close(onset, arrays)
                for reading in robot.hand_readings:
                    if reading.stamp.host_ns >= onset.first_ns:
                        still.feed(reading.stamp.host_ns, reading.position_deg[list(CLOSING_AXES)])
                if self._clock() > until_ns:
                    robot.fail(SqueezeFault.NOT_STILL, f"in {squeeze.still_timeout_s:g} s from first contact")
            self.begin("hold")
            until_ns = self._clock() + round(1e9 * squeeze.hold_s)
            while self._clock() < until_ns:
                self._close(onset, arrays)
        self.restored = robot.restore()
        self.begin(OPEN)
        robot.preshape()
        self.doing = ""

    def _close(self, onset: OnsetDetector, arrays: ArrayCheck) -> None:
        """One control period of closing. A finger that is held while its array reads nothing, or an array that repeats
        itself, ends the squeeze."""
        robot, since_ns = self._robot, self._clock()
        robot.cycle(self._setup.squeeze.speed_deg_s)
        if self._clock() - since_ns > KEEP_S * 1e9:  # the hand's driver has set the speed to 0 meanwhile
            arrays.drive(self._clock())
        for reading in robot.hand_readings:
            arrays.feed_hand(reading.stamp.host_ns, reading.position_deg[list(CLOSING_AXES)])
        for frame in robot.tactile_frames:
            onset.feed(frame.time_ns, frame.sums)
            arrays.feed_frame(onset.rise, onset.threshold, frame.texels)
        if wrong := arrays.contradictions(self._setup.hand.fingers):
            apart_m = gap_m(robot.hand.latest(1.0).position_deg, self._setup.hand.fingers)
            if not onset.first_ns and apart_m < TOUCHING_M:
                robot.fail(SqueezeFault.NO_CONTACT, f"the fingertips have met each other, {1e3 * apart_m:.0f} mm apart")
            robot.fail(SqueezeFault.CONTRADICTED, "; ".join(wrong))

    def _wait_in_the_air(self, onset: OnsetDetector) -> None:
        """Take the fingertips' baseline. An existing contact would become the zero."""
        robot, seen = self._robot, 0
        until_ns = self._clock() + round(1e9 * AIR_TIMEOUT_S)
        while seen < AIR_FRAMES:
            robot.cycle()
            for frame in robot.tactile_frames:
                onset.feed(frame.time_ns, frame.sums)
                seen += 1
                if frame.sums.max() > self._setup.squeeze.onset_counts:
                    reason = f"{frame.sums.max():.0f} counts before the fingers closed"
                    robot.fail(SqueezeFault.TOUCHED_BEFORE, reason)
            if self._clock() > until_ns:
                robot.fail(SqueezeFault.TACTILE_SILENT, f"{seen} frames in {AIR_TIMEOUT_S:g} s")

    def _ended(self, stopped: SqueezeStopped) -> SqueezeEnded:
        """The hand is at rest, its limits are restored; it opens if it must not press its content longer."""
        verdict, robot = stopped.verdict, self._robot
        self.halt(str(verdict.fault))
        self.begin("stopped")
        advice = ADVICE.get(verdict.fault, "")
        if verdict.fault in RELEASES and self.stands and self.restored:
            try:
                robot.release()
            except SqueezeStopped as error:
                advice = f"the fingers did not open: {error.verdict.fault}: {error.verdict.reason}; {advice}"
        self.doing = ""
        stop = SqueezeStop(str(verdict.fault), verdict.reason, advice, self.stands, self.restored)
        return SqueezeEnded(stop, verdict.time_ns)

    def begin(self, phase: str) -> None:
        """Record and show that a phase begins."""
        self.doing, now_ns = phase, self._clock()
        self._observer.phase(phase, now_ns)
        self._reports.append(Step((SqueezePhase(phase),), moment=Moment(now_ns)))
        self.on_phase(phase)

    def _clock(self) -> int:
        return self._setup.clock()

    def cycled(self) -> None:
        """Called in each control period, also in the arm's. If the arm has left its pose, the hand's motion ends in the
        same period. Fingers that open continue, which frees an arm that is pushed (it does not withdraw then)."""
        self._on_cycle()
        if (faulty := self._arm_faulty()) and self.doing != OPEN:
            self._robot.supervisor.stop(SqueezeFault.ARM, faulty, self._clock())
        super().cycled()
