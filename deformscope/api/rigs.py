"""What the commands about rigs share: devices made from a rig file, doubles where it asks for them, and Ctrl-C."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from deformscope.lab.stand_in import stand_in
from deformscope.rig.rig_file import Rig, RigDevice
from deformscope.rig.source import RigMember
from deformscope.terminal import say


@contextlib.contextmanager
def members_of(rig: Rig) -> Iterator[tuple[RigMember, ...]]:
    """The rig's devices, closed; doubles run for those that the rig wants doubled, until the end of the context."""
    with contextlib.ExitStack() as stack:
        yield tuple([stack.enter_context(member_of(entry)) for entry in rig.devices])


@contextlib.contextmanager
def member_of(entry: RigDevice) -> Iterator[RigMember]:
    """One device of a rig, closed; its double, where the rig wants one, runs until the end of the context.

    Raises InputError where there is none to be made.
    """
    stands_in = stand_in(entry.driver.name, entry.config) if entry.double else contextlib.nullcontext(entry.make())
    with stands_in as device:
        yield RigMember(entry.name, entry.driver, device, simulated=entry.double, late_ns=entry.late_ns)


class Interruption(threading.Event):
    """Set once somebody asked to end. signal_number: with what; 0 before, and where it was otherwise: by, in words"""

    signal_number = 0
    by = ""


@contextlib.contextmanager
def until_interrupted() -> Iterator[Interruption]:
    """An event that Ctrl-C, a request to end or a closed terminal sets once; the second Ctrl-C interrupts as usual."""
    asked = Interruption()

    def stop(number: int, frame: FrameType | None) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.signal_number = number
        asked.set()
        say("ending; Ctrl-C again to leave at once")

    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        for number in kept:
            signal.signal(number, stop)
    except ValueError:  # not in the main thread: whoever runs this there ends it by other means
        yield asked
        return
    try:
        yield asked
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
