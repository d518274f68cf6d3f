"""An arm's driver in a child process: a fault or the end of this program does not keep the arm moving.

The other process opens the arm and carries out velocities until they expire there, on the clock that both share. When
this process is suspended, no velocity is renewed and it expires. When this process ends, the socket between them
closes, and the other process halts the arm, releases it and ends too. A long call runs in a thread there, so that a
halt and the end of the program come first."""

import contextlib
import itertools
import threading
import time
from collections.abc import Iterable
from concurrent.futures import Future, wait
from functools import partial
from pathlib import Path
from typing import Any

from deformscope_drivers.arm.device import Arm, ArmState, Velocity
from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.device import RECONNECT, RawChunk, Reconnect
from deformscope_drivers.errors import DeviceError, LinkLost, NoReply, NotConnected
from deformscope_drivers.health import Identity, Link
from deformscope_drivers.hosted import Channel, HostedProcess
from deformscope_drivers.pacing import READING, STEERING, be_prompt
from deformscope_drivers.subscription import Subscription

OPEN_S, ANSWER_S, END_S = 90.0, 6.0, 5.0
"""An arm may be sought for long, and a vendor's library may wait 5 s for a packet."""
WAITING_S = 0.1
"""Period of messages from a caller that waits for an answer: without them an arm on its way home is halted there."""


class HostedArm(Arm[ArmState]):
    """Any arm of this package, opened in another process: `HostedArm(Jaco, JacoConfig(...))`."""

    def __init__(self, kind: type[Arm[Any]], config: object, *, reconnect: Reconnect | None = RECONNECT) -> None:
        """kind: the driver's class, made there of config alone"""
        self.config = config
        self._kind = kind
        port = getattr(config, "port", None)
        name = port if isinstance(port, str) else f"{kind.__name__} in its own process"
        super().__init__(name, reconnect=reconnect, clock=monotonic_ns)
        self._hosted = HostedProcess("a process that moves the arm", self.name, None)
        self._known: dict[str, Any] = {}
        self._health: dict[str, float] = {}
        self._homed = False
        self._refused: DeviceError | None = None
        self.goes_home = kind.goes_home
        self._questions = itertools.count(1)
        self._answers: dict[int, Future[Any]] = {}

    @property
    def chain(self) -> Chain:
        chain: Chain | None = self._known.get("chain")
        if chain is None:
            raise NotConnected("an arm that was opened", "one that was not yet", "open() it", self.name)
        return chain

    @property
    def urdf(self) -> Path | None:
        known: Path | None = self._known.get("urdf")
        return known

    @property
    def homed(self) -> bool:
        return self._homed

    @property
    def process_id(self) -> int | None:
        """Identifier of the process that hosts the driver; None where none runs."""
        return self._hosted.process_id

    def identity(self) -> Identity:
        known: Identity = self._known.get("identity", Identity())
        return known

    def set_velocity(self, velocity: Velocity, valid_for_s: float | None = None) -> None:
        """Call the arm's `set_velocity`; an error of one velocity is raised with the next one."""
        refused, self._refused = self._refused, None
        if refused is not None:
            raise refused
        super().set_velocity(velocity, valid_for_s)
        with self._commanded:
            streamed = self._streamed
        if streamed is not None:
            self._hosted.send("velocity", streamed.velocity, streamed.expires_ns)

    def stop(self) -> None:
        with self._commanded:
            self._streamed = self._refused = None
        self.ask("stop")

    def halt(self, reason: str) -> None:
        with self._commanded:
            self._streamed = None
            self._stopped = self._stopped or reason or "by command"
        self.ask("halt", self._stopped)

    def close(self) -> None:
        """Call the arm's `close`. The arm is halted at once, while this thread may wait for a state."""
        words = "it is being closed"
        with self._commanded:
            moving = self._streamed is not None
        try:
            if moving:
                self.ask("halt", words)
            else:
                with contextlib.suppress(DeviceError):
                    self._hosted.send("call", 0, "halt", (words,))
        except DeviceError as error:
            self._not_stopped = error
        finally:
            super().close()

    def acknowledge_stop(self) -> None:
        self.ask("acknowledge_stop", timeout_s=2 * ANSWER_S)
        self._refused = None
        super().acknowledge_stop()

    def home(self, timeout_s: float = 60.0) -> ArmState:
        """Call the arm's `home`; the arm is also stopped if this process is stopped or ends meanwhile."""
        try:
            state: ArmState = self.ask("home", timeout_s, timeout_s=timeout_s + ANSWER_S)
        except BaseException:
            with contextlib.suppress(DeviceError):
                self.stop()
            raise
        return state

    def ask(self, name: str, *arguments: object, timeout_s: float = ANSWER_S) -> Any:
        """Call a method of the arm there; its result, or error. Threads do not wait for one another's answers."""
        self._require_open()
        if self._link is not Link.CONNECTED:
            raise LinkLost("a device that is connected", self._reason or self._link, where=self.name)
        number, until_ns = next(self._questions), self._clock() + round(timeout_s * 1e9)
        answer = self._answers[number] = Future()
        try:
            self._hosted.send("call", number, name, arguments)
            while not answer.done():
                if (left_s := (until_ns - self._clock()) / 1e9) <= 0:
                    raise NoReply(f"{name} done within {timeout_s:g} s", "nothing", where=self.name)
                if threading.current_thread() is self._thread:  # which takes the answers
                    for state in self._receive(min(left_s, WAITING_S)):
                        self._publish(state)
                else:
                    wait([answer], min(left_s, WAITING_S))
                if not answer.done():
                    self._hosted.send("waiting")
        finally:
            del self._answers[number]
        return answer.result()

    # Run by the device's own thread ----------------------------------------------------------------------------------

    def _connect(self) -> None:
        self._hosted.start(serve, self._kind, self.config, self.still or self._link is Link.LOST)
        report = self._hosted.opened(OPEN_S, self._closing)
        if report is None:
            raise NotConnected(f"an arm that is opened within {OPEN_S:g} s", "nothing", where=self.name)
        self._known, self._homed = report, report["homed"]
        self._expect(self.state_hz)

    def _disconnect(self) -> None:
        with self._commanded:
            moving, self._streamed = self._streamed is not None, None
            if moving and not self._closing.is_set():
                self._stopped = self._stopped or "the process that moves the arm was lost"
        for answer in list(self._answers.values()):
            if not answer.done():
                answer.set_exception(LinkLost("a process that moves the arm", "one that has ended", where=self.name))
        self._hosted.end(END_S)  # it halts the arm, and ends

    def _receive(self, timeout_s: float) -> Iterable[ArmState]:
        found: list[ArmState] = []
        message = self._hosted.receive(timeout_s)
        while message is not None:
            self._handle(message, found)
            message = self._hosted.receive(0.0)
        return found

    def _handle(self, message: tuple[Any, ...], found: list[ArmState]) -> None:
        match message:
            case ("state", state, homed, stopped):
                self._homed = homed
                self._tally.in_sync()
                if stopped and not self._stopped:  # the arm was stopped there
                    with self._commanded:
                        self._streamed, self._stopped = None, stopped
                found.append(state)
            case ("raw", chunks):
                for one in chunks:
                    self._record_raw(one.data, one.host_ns, sent=one.sent)
            case ("refused", error):
                self._refused = error
            case ("count", name, what) if name in COUNTED:
                getattr(self, name)(what)
            case ("health", extra):
                self._health = extra
            case ("answer", number, error, result):
                answer = self._answers.get(number)
                if answer is None or answer.done():  # nobody waits any more
                    return
                if error is not None:
                    answer.set_exception(error)
                else:
                    answer.set_result(result)
            case ("lost", words):
                raise LinkLost("an arm that is connected", words, where=self.name)

    def _extra_health(self) -> dict[str, float]:
        return dict(self._health)


# In the other process -----------------------------------------------------------------------------------------------

HEALTH_S = 0.5
CALLS = frozenset({"stop", "halt", "acknowledge_stop", "home"})
"""Methods that may be called; velocities have a message of their own."""
COUNTED = ("_count_lost", "_count_skipped", "_count_refused")
"""Methods that count losses: called there, carried out here."""
LONG = frozenset({"home"})
"""Those of these calls that take seconds."""
UNATTENDED_S = 1.0
"""A long call's caller sends a message every `WAITING_S`; after this time without one there is no caller."""


def serve(channel: Channel, kind: type[Arm[Any]], config: Any, still: bool) -> None:
    """Move an arm until the program at the other end ends. still: as `Arm.still`. Raises DeviceError at opening."""
    arm = kind(config)
    arm.still = still
    for name in COUNTED:
        setattr(arm, name, partial(channel.send, "count", name))
    raw = arm.raw()
    arm.open()
    be_prompt(STEERING)
    try:
        known = {"chain": arm.chain, "identity": arm.identity(), "urdf": arm.urdf, "homed": arm.homed}
        channel.send("opened", known)
        threading.Thread(target=_report, args=(arm, channel, raw), name="states", daemon=True).start()
        long: threading.Thread | None = None
        while True:
            if long is not None and not channel.poll(UNATTENDED_S) and long.is_alive():
                with contextlib.suppress(DeviceError):
                    arm.halt("the program that moves it does not answer")
            long = _handle(channel.receive(), arm, channel) or long
    except (EOFError, OSError):
        with contextlib.suppress(DeviceError):
            arm.halt("the program that moved it has ended")
    finally:
        with contextlib.suppress(DeviceError):
            arm.close()


def _handle(message: tuple[Any, ...], arm: Arm[Any], channel: Channel) -> threading.Thread | None:
    """Carry a message out; the thread that does so, where that takes long."""
    match message:
        case ("velocity", velocity, expires_ns):
            left_s = (expires_ns - monotonic_ns()) / 1e9
            if left_s > 0:
                try:
                    arm.set_velocity(velocity, left_s)
                except DeviceError as error:
                    channel.send("refused", error)
        case ("call", number, name, arguments) if name in LONG:
            thread = threading.Thread(
                target=_answer, args=(arm, channel, number, name, arguments), name=name, daemon=True
            )
            thread.start()
            return thread
        case ("call", number, name, arguments) if name in CALLS:
            _answer(arm, channel, number, name, arguments)
    return None


def _answer(arm: Arm[Any], channel: Channel, number: int, name: str, arguments: tuple[Any, ...]) -> None:
    try:
        channel.send("answer", number, None, getattr(arm, name)(*arguments))
    except DeviceError as error:
        channel.send("answer", number, error, None)


def _report(arm: Arm[Any], channel: Channel, raw: Subscription[RawChunk]) -> None:
    """Pass the arm's states on, the bytes of each before it, and its health now and then, until it is closed."""
    be_prompt(READING)
    health_s = 0.0
    readings = arm.readings()
    try:
        while True:
            with contextlib.suppress(TimeoutError):  # a lost arm has no states
                state = readings.get(WAITING_S)
                if chunks := raw.take():
                    channel.send("raw", chunks)
                channel.send("state", state, arm.homed, arm.stopped_because)
            if time.monotonic() - health_s > HEALTH_S:
                health_s = time.monotonic()
                channel.send("health", arm.health().extra)
            if arm.link is Link.LOST:
                channel.send("lost", arm.health().reason)
    except (DeviceError, EOFError) as error:
        channel.send("lost", str(error))
