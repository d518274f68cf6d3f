"""The process that moves an arm: what `HostedArm` starts (`deformscope_drivers.hosted`).

The process receives the driver's class and configuration first, then velocities with their expiry times, and calls.
When the other end is closed, for any reason, the process halts the arm, closes it and ends. A long call runs in a
separate thread, so that a halt and the end of the program come first."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any

from deformscope_drivers.arm.device import Arm
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.health import Link
from deformscope_drivers.hosted import Channel
from deformscope_drivers.priority import READING, STEERING, be_prompt

HEALTH_S = 0.5
CALLS = frozenset({"stop", "halt", "acknowledge_stop", "home"})
"""Methods that may be called; velocities have a message of their own."""
LONG = frozenset({"home"})
"""Those of these calls that take seconds."""
UNATTENDED_S = 1.0
"""During a long call its caller sends a message every 0.1 s (`arm.hosted.WAITING_S`); after this time without one there
is no caller."""


def serve(channel: Channel, kind: type[Arm[Any]], config: Any, still: bool) -> None:
    """Move an arm until the program at the other end ends. still: as `Arm.still`. Raises DeviceError where the arm
    cannot be opened."""
    arm = kind(config)
    arm.still = still
    arm.open()
    be_prompt(STEERING)
    try:
        known = {"chain": arm.chain, "identity": arm.identity(), "urdf": arm.urdf, "homed": arm.homed}
        channel.send("opened", known)
        threading.Thread(target=_report, args=(arm, channel), name="states", daemon=True).start()
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


def _report(arm: Arm[Any], channel: Channel) -> None:
    """Pass the arm's states on, and its health now and then, until it is closed."""
    be_prompt(READING)
    health_s = 0.0
    try:
        for state in arm.readings():
            channel.send("state", state, arm.homed, arm.stopped_because)
            if time.monotonic() - health_s > HEALTH_S:
                health_s = time.monotonic()
                channel.send("health", arm.health().extra)
            if arm.link is Link.LOST:
                channel.send("lost", arm.health().reason)
    except DeviceError as error:
        channel.send("lost", str(error))
