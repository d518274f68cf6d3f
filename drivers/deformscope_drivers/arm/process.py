"""The process that moves an arm, started by `ArmBeside`: `python -m deformscope_drivers.arm.process FD`.

It gets the driver's class and configuration first, then velocities with the moments at which they expire and calls;
when the other end is closed, whatever ended it, it halts the arm, closes it and ends. A call that takes long runs in a
thread of its own, so that a halt and the end of the program come first.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection
from typing import Any

from deformscope_drivers.arm.device import Arm
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.health import Link
from deformscope_drivers.priority import READING, STEERING, be_prompt

HEALTH_S = 0.5
CALLS = frozenset({"stop", "halt", "acknowledge_stop", "home"})
"""What may be called; velocities have a message of their own."""
LONG = frozenset({"home"})
"""Of these, what takes seconds."""
UNATTENDED_S = 1.0
"""During a long call whoever waits for it says so every 0.1 s (`beside.WAITING_S`); after this nobody does."""


class Sender:
    """Messages of several threads, one after the other."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._sending = connection, threading.Lock()

    def __call__(self, *message: Any) -> None:
        with self._sending, contextlib.suppress(OSError):  # the other end is closed: `serve` sees it
            self._connection.send(message)


def serve(connection: Connection) -> None:
    """Move an arm until the other end is closed."""
    send = Sender(connection)
    kind, config = connection.recv()
    arm: Arm[Any] = kind(config)
    try:
        arm.open()
    except DeviceError as error:
        send("failed", _name(error), str(error))
        return
    be_prompt(STEERING)
    try:
        known = {"chain": arm.chain, "identity": arm.identity(), "urdf": arm.urdf, "homed": arm.homed}
        send("opened", known)
        threading.Thread(target=_report, args=(arm, send), name="states", daemon=True).start()
        long: threading.Thread | None = None
        while True:
            if long is not None and not connection.poll(UNATTENDED_S) and long.is_alive():
                with contextlib.suppress(DeviceError):
                    arm.halt("the program that moves it does not answer")
            long = _heed(connection.recv(), arm, send) or long
    except (EOFError, OSError):
        with contextlib.suppress(DeviceError):
            arm.halt("the program that moved it has ended")
    finally:
        with contextlib.suppress(DeviceError):
            arm.close()


def _heed(message: tuple[Any, ...], arm: Arm[Any], send: Sender) -> threading.Thread | None:
    """Carry a message out; the thread that does so, where that takes long."""
    match message:
        case ("velocity", velocity, expires_ns):
            left_s = (expires_ns - monotonic_ns()) / 1e9
            if left_s > 0:
                try:
                    arm.set_velocity(velocity, left_s)
                except DeviceError as error:
                    send("refused", _name(error), str(error))
        case ("call", number, name, arguments) if name in LONG:
            thread = threading.Thread(target=_answer, args=(arm, send, number, name, arguments), name=name, daemon=True)
            thread.start()
            return thread
        case ("call", number, name, arguments) if name in CALLS:
            _answer(arm, send, number, name, arguments)
    return None


def _answer(arm: Arm[Any], send: Sender, number: int, name: str, arguments: tuple[Any, ...]) -> None:
    try:
        send("answer", number, False, getattr(arm, name)(*arguments))
    except DeviceError as error:
        send("answer", number, True, _name(error), str(error))


def _report(arm: Arm[Any], send: Sender) -> None:
    """Pass the arm's states on, and its health now and then, until it is closed."""
    be_prompt(READING)
    health_s = 0.0
    try:
        for state in arm.readings():
            send("state", state, arm.homed, arm.stopped_because)
            if time.monotonic() - health_s > HEALTH_S:
                health_s = time.monotonic()
                send("health", arm.health().extra)
            if arm.link is Link.LOST:
                send("lost", arm.health().reason)
    except DeviceError as error:
        send("lost", str(error))


def _name(error: DeviceError) -> str:
    """The first of its classes that the other process knows too."""
    known = ("deformscope_drivers.errors", "deformscope_drivers.arm.errors")
    return next(kind.__name__ for kind in type(error).__mro__ if kind.__module__ in known)


def main(descriptor: int) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the program that moves the arm decides; its end closes the socket
    serve(Connection(descriptor))


if __name__ == "__main__":
    main(int(sys.argv[1]))
