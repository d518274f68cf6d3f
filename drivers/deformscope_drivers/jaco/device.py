"""The arm as a device: its state to read, its motion to command, and a cycle of 10 ms that keeps both honest.

The arm takes one velocity point each 10 ms, queues faster ones, and has no watchdog. The arm executes the points in its
FIFO even if their sender has ended. Therefore the device's thread sends one point in each slot of an absolute schedule
and never in advance. A velocity lasts only as long as its sender renews it:

- not refreshed in time: the next slot sends zero, the one after erases the FIFO
- cycle delayed by more than the deadline, workspace about to be left, or link lost: the FIFO is erased as soon as the
  arm is connected. Further commands are refused until `acknowledge_stop`
- closed, an exception, Ctrl-C, the interpreter's end: erased before the library is closed

A process that is killed outright (SIGKILL) can erase nothing. The arm then carries out the waiting points: one or two
velocity points, that is 20 ms of motion. An arm on its way home goes on."""

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

from deformscope_drivers.arm.device import CALL_MS, Arm, JointVelocity, Velocity, by_joints, linear_velocity_of
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.errors import LinkLost, MotionStopped, NotConnected, OutOfLimits, Stale
from deformscope_drivers.health import Identity, Link
from deformscope_drivers.jaco.chains import urdf_path
from deformscope_drivers.jaco.config import JacoConfig
from deformscope_drivers.jaco.errors import NotHomed, NotReached, VendorError
from deformscope_drivers.jaco.library import Functions, Library, call
from deformscope_drivers.jaco.reading import JacoState, StateReader
from deformscope_drivers.jaco.startup import JacoIdentity, bring_up, check_pose, let_go
from deformscope_drivers.jaco.structures import velocity_point
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.pacing import Pacer, SlotPacer

PERIOD_NS = 10_000_000
FIFO_AHEAD = 2  # points that may wait in the arm before a slot is left out: its clock is not this computer's
REFUSED_IN_A_ROW = 10
COMMAND_TIMEOUT_S = 6.0  # the vendor's library waits up to 5 s for a packet
LOOK_AHEAD_S = 0.1
STATE_AGE_S = 0.5
STILL_DEG_S, STILL_S = 1.0, 0.5
HOME_PAUSE_S = 1.0
"""Time from stopping the control to starting it before `MoveHome`, as in kinova-ros' `KinovaComm::homeArm`."""


def open_jaco(config: JacoConfig) -> Arm[Any]:
    """The device, not yet opened: in a separate process unless the configuration disables that."""
    return HostedArm(Jaco, config) if config.own_process else Jaco(config)


class Jaco(Arm[JacoState]):
    """`with Jaco(JacoConfig(library="/opt/kinova")) as arm:`; with the three reads that every device has.

    Only one thread calls the vendor's library, which does not support several."""

    goes_home = True
    stop_by_hand = "the emergency stop, or the arm's own joystick"

    def __init__(
        self,
        config: JacoConfig | None = None,
        functions: Functions | None = None,
        *,
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        """functions: a double in place of the vendor's library; clock: the host's, or a simulated laboratory's"""
        self.config = config if config is not None else JacoConfig()
        self._functions = functions if functions is not None else Library(self.config.library, self.config.connection)
        super().__init__(self._functions.where, reconnect=reconnect, clock=clock)
        self._arm: JacoIdentity | None = None
        self._waiting = Pacer(clock)
        self._homing_until_ns: int | None = None
        self._erase_due = False
        self._pacer = SlotPacer(PERIOD_NS)
        self._reader: StateReader | None = None
        self._state: JacoState | None = None
        self._crowded = False
        self._sent = self._expired = self._left_out = self._refused_in_a_row = 0

    # Lifecycle -------------------------------------------------------------------------------------------------------

    def open(self, *, own_thread: bool = True) -> Self:
        """Take control of the arm, at rest. Raises NotConnected, LibraryMissing, or the vendor's code by its name."""
        if not self.is_open:
            self._pacer = SlotPacer(PERIOD_NS)
            self._sent = self._expired = self._left_out = 0
        return super().open(own_thread=own_thread)

    @property
    def chain(self) -> Chain:
        """The arm's kinematics; known once it was opened."""
        if self._arm is None:
            raise NotConnected("an arm that was opened", "one that was not yet", "open() it", self.name)
        return self._arm.chain

    @property
    def urdf(self) -> Path:
        return urdf_path(self.chain.name)

    def identity(self) -> Identity:
        """Model, serial number, and firmware with the version of the vendor's library."""
        arm = self._arm
        if arm is None:
            return Identity()
        firmware, library = (".".join(map(str, version)) for version in (arm.firmware, arm.library_version))
        return Identity(arm.model, arm.serial, f"{firmware} (library {library})")

    def _connect(self) -> None:
        self._arm = bring_up(self._functions, self.config, self._pause)
        self._not_stopped = None  # bringing it up has erased what was left
        check_pose(self._functions, self.chain)
        self._reader = StateReader(self._functions, self.chain, self.config.state_hz, self._clock)
        self._state = self._reader.whole()
        self._expect(self.config.state_hz)
        self._pacer.start(self._clock() + PERIOD_NS)  # the zero point of bringing it up had this slot
        self._refused_in_a_row = 0
        self._crowded = False

    def _disconnect(self) -> None:
        with self._commanded:
            moving = self._erase_due or self._streamed is not None or self._homing_until_ns is not None
            self._streamed = self._homing_until_ns = None
            self._erase_due = False
            if moving and not self._closing.is_set():
                self._stopped = self._stopped or "the link to the arm was lost while it moved"
        not_erased = let_go(self._functions)
        if moving:
            self._not_stopped = not_erased

    def _wake(self) -> None:
        self._waiting.wake()

    def _extra_health(self) -> dict[str, float]:
        median_ms, high_ms, greatest_ms = self._pacer.lateness_ms()
        return {
            "points_sent": self._sent,
            "slots": self._pacer.slots,
            "slots_missed": self._pacer.missed,
            "slots_left_out": self._left_out,
            "commands_expired": self._expired,
            "late_ms_median": median_ms,
            "late_ms_p99": high_ms,
            "late_ms_max": greatest_ms,
            CALL_MS: 0.0 if self._reader is None else self._reader.call_ms,
        }

    # The cycle: run by the device's own thread -----------------------------------------------------------------------

    def _receive(self, timeout_s: float) -> Iterable[JacoState]:
        """One slot: first the commands for the arm, then the queries that fit before the next slot."""
        if not self._waiting.wait_until(self._pacer.due_ns, timeout_s):
            return ()
        now_ns = self._clock()
        late_ns = self._pacer.enter(now_ns)
        assert self._reader is not None
        try:
            self._command(now_ns, late_ns)
            state = self._reader.go_on(self._pacer.due_ns)
        except VendorError as error:  # the link is lost, or the arm refused a call, which may pass
            self._count_refused(f"{error.vendor_code or error.code} {error.symbol}")
            self._refused_in_a_row += 1
            if isinstance(error, LinkLost):
                raise
            if isinstance(error, NotConnected) or self._refused_in_a_row >= REFUSED_IN_A_ROW:
                raise LinkLost("an arm that answers", str(error), error.remedy, self.name) from error
            return ()
        if state is None:
            return ()
        self._refused_in_a_row = 0
        self._state = state
        self._crowded = state.fifo_count > FIFO_AHEAD
        return (state,)

    def _command(self, now_ns: int, late_ns: int) -> None:
        """Send the point of this slot, if there is one; end motions that must stop."""
        with self._commanded:
            streamed, homing_until_ns = self._streamed, self._homing_until_ns
        if streamed is None:
            if homing_until_ns is not None and now_ns > homing_until_ns:
                self._halt("no caller waited any more for the arm to be at home")
            if self._erase_due:
                self._erase()
            return
        late_ns = min(late_ns, now_ns - streamed.since_ns)  # before there was a command nothing came too late
        if late_ns > self.config.command_deadline_s * 1e9:
            self._halt(f"the cycle was {late_ns / 1e6:.0f} ms late")
        elif now_ns > streamed.expires_ns:
            with self._commanded:
                if self._streamed is streamed:
                    self._streamed = None
            self._expired += 1
            self._erase_due = True
            self._send(JointVelocity((0.0,) * self.chain.joint_count))
        elif reason := self._forbids(streamed.velocity, now_ns):
            self._halt(reason)
        elif self._crowded:
            self._crowded = False
            self._left_out += 1
        elif isinstance(sent := self._by_joints(streamed.velocity), str):
            self._halt(sent)
        else:
            self._send(sent)

    def _by_joints(self, velocity: Velocity) -> JointVelocity | str:
        assert self._state is not None
        return by_joints(velocity, self.chain, self.config, self._state.joints_deg)

    def _send(self, velocity: JointVelocity) -> None:
        call(self._functions, "SendBasicTrajectory", velocity_point(velocity))
        self._sent += 1

    def _erase(self) -> None:
        call(self._functions, "EraseAllTrajectories")
        self._erase_due = False

    def _halt(self, reason: str) -> None:
        """Stop the arm, and refuse commands until a person acknowledges it."""
        self._forget_commands(reason)
        self._erase()

    def _forget_commands(self, stopped_because: str = "") -> None:
        """The command is over, and the FIFO is due to be erased; no command can slip in between."""
        with self._commanded:
            self._streamed = self._homing_until_ns = None
            self._stopped = self._stopped or stopped_because
            self._erase_due = True

    def _forbids(self, velocity: Velocity, now_ns: int) -> str:
        """Why a velocity must end: the arm's state is unknown, or it would leave its workspace."""
        state = self._state
        assert state is not None
        age_s = (now_ns - state.stamp.host_ns) / 1e9
        if age_s > STATE_AGE_S:
            return f"the arm's state could not be read for {age_s:.2f} s"
        box = self.config.workspace
        if box is None:
            return ""
        linear_m_s = linear_velocity_of(velocity, self.chain, state.joints_deg)
        for axis, name in enumerate("xyz"):
            here, speed = state.position_m[axis], linear_m_s[axis]
            ahead = here + LOOK_AHEAD_S * speed
            if (speed > 0 and ahead > box.high_m[axis]) or (speed < 0 and ahead < box.low_m[axis]):
                return f"the workspace would have been left along {name} at {here:.3f} m"
        return ""

    def _pause(self, seconds: float) -> None:
        """Wait in the thread that owns the link, by a simulated clock where it runs on one."""
        if isinstance(self._clock, SimulatedClock):
            self._clock.advance_to(self._clock() + round(seconds * 1e9))
        else:
            self._closing.wait(seconds)

    # Motion ----------------------------------------------------------------------------------------------------------

    def stop(self) -> None:
        self._forget_commands()
        self._do(self._erase, COMMAND_TIMEOUT_S)

    def halt(self, reason: str) -> None:
        self._forget_commands(reason or "by command")
        self._do(self._erase, COMMAND_TIMEOUT_S)

    def home(self, timeout_s: float = 60.0) -> JacoState:
        """Send the arm to its own home pose, on its own path and at its own speed. Wait until it is at rest, and
        reports that it is at home. An arm needs this once after it was switched on, by this call or by its joystick's
        home button. The arm's control is first stopped and started again, as in the vendor's driver. Raises NotReached
        after timeout_s; on any exception, Ctrl-C too, the arm is stopped."""
        self._require_moves()
        moving_ns: int | None = None
        until_ns = self._clock() + round(timeout_s * 1e9)
        began = given_up = False

        def set_out() -> None:
            nonlocal began
            with self._commanded:
                self._require_moves()
                if given_up:  # by Ctrl-C, say, before the device's thread came to it
                    return
                if self._streamed is not None or self._homing_until_ns is not None:
                    raise OutOfLimits("an arm at rest", "one that is moving", "stop() first", self.name)
                self._homing_until_ns = until_ns + round(STATE_AGE_S * 1e9)
                began = True
            self._erase()
            call(self._functions, "StopControlAPI")

        def require_under_way() -> None:
            self._require_moves()
            if self._homing_until_ns is None:
                raise MotionStopped("an arm on its way home", "stop()", "send it again", self.name)

        def move_home() -> None:
            require_under_way()
            call(self._functions, "MoveHome")

        try:
            self._do(set_out, COMMAND_TIMEOUT_S)
            try:
                self._pass_time(HOME_PAUSE_S)
            finally:
                self._do(lambda: call(self._functions, "StartControlAPI"), COMMAND_TIMEOUT_S)
            self._do(move_home, COMMAND_TIMEOUT_S)
            while (left_s := (until_ns - self._clock()) / 1e9) > 0:
                state = None
                with contextlib.suppress(Stale):
                    state = self.next(min(left_s, STATE_AGE_S))
                require_under_way()
                if state is None:
                    continue
                if moving_ns is None or max(map(abs, state.rates_deg_s)) > STILL_DEG_S:
                    moving_ns = state.stamp.host_ns
                if state.homed and state.stamp.host_ns - moving_ns >= STILL_S * 1e9:
                    return state
            raise NotReached("home", f"an arm that arrives within {timeout_s:g} s", "a longer timeout_s", self.name)
        finally:
            with self._commanded:
                given_up = True
            if began and self.is_open and self.link is Link.CONNECTED:
                self.stop()

    # Within ----------------------------------------------------------------------------------------------------------

    def _pass_time(self, seconds: float) -> None:
        """Wait in the caller's thread, the cycle going on."""
        if self._own_thread:
            time.sleep(seconds)
            return
        until_ns = self._clock() + round(seconds * 1e9)
        while (left_ns := until_ns - self._clock()) > 0:
            self.poll(left_ns / 1e9)

    @property
    def homed(self) -> bool:
        """Whether the arm says that it was at home since it was switched on; read once a second."""
        return self._state is not None and self._state.homed

    def _require_ready(self) -> None:
        if self.config.require_home and not self.homed:
            advice = "hold its joystick's home button until it rests; or deformscope arm home RIG; or arm.home()"
            raise NotHomed("an arm that was homed after power-on", "one that was not", advice, self.name)
        if self._homing_until_ns is not None:
            raise OutOfLimits("an arm that is not on its way home", "one that is", "stop() first", self.name)
