"""Errors of a device. Each message has the expectation, the actual value, and what to try; the port comes last.

DeviceError +- NotConnected       it is not there, or cannot be opened
 |   +- Busy           another program, or another session, has it
 +- LinkLost           it was there, and is gone (a reconnect may follow)
 +- NoReply            it is there, and did not answer in time
 +- ProtocolViolation  it sent bytes that its protocol does not allow
 +- CommandRefused     it answered with an error code
 +- SettingsRefused it runs with other settings than the requested ones
 +- OutOfLimits        a command that would leave the limits; nothing was sent
 +- Stale there is no reading of the requested age
 +- LibraryMissing     software of the vendor's, or an optional package, is not installed"""

from collections.abc import Callable
from typing import Self


class DeviceError(Exception):
    """Something is wrong with a device."""

    def __init__(self, expected: str, came: str, try_this: str = "", where: object = "") -> None:
        parts = [f"expected {expected}; got {came}"]
        if try_this:
            parts.append(f"try: {try_this}")
        if str(where):
            parts.append(str(where))
        super().__init__(" | ".join(parts))

    @classmethod
    def from_text(cls, words: str) -> Self:
        """An error that another process reported in words, as one of this one."""
        error = cls.__new__(cls)
        Exception.__init__(error, words)
        return error

    def __reduce__(self) -> tuple[Callable[[str], Self], tuple[str], dict[str, object]]:
        """Its words and attributes: a process of a pool hands its errors over so."""
        return self.from_text, (str(self),), self.__dict__


class NotConnected(DeviceError):
    """The device is not there, cannot be opened, or was closed."""


class Busy(NotConnected):
    """The port is in another's hands."""


class LinkLost(DeviceError):
    """The device was there, and is gone."""


class NoReply(DeviceError):
    """The device did not answer in time."""


class ProtocolViolation(DeviceError):
    """The device sent bytes that its protocol does not allow."""


class CommandRefused(DeviceError):
    """The device answered with an error code.

    code: the device's number; name: its name in the device's documents"""

    def __init__(self, code: int, name: str, doing: str, try_this: str = "", where: object = "") -> None:
        super().__init__(f"success of {doing}", f"error {code} ({name})", try_this, where)
        self.code = code
        self.name = name


class SettingsRefused(DeviceError):
    """The device runs with other settings than the requested ones."""


class OutOfLimits(DeviceError):
    """A command that would leave the limits; nothing was sent."""


class Stale(DeviceError):
    """There is no reading of the requested age."""


class LibraryMissing(DeviceError):
    """Software of the vendor's, or an optional package, is not installed."""


class MotionStopped(DeviceError):
    """The arm was stopped, and refuses commands until a person acknowledges the reason."""


class NotStopped(DeviceError):
    """The arm was moving, and the stop command did not reach it."""


class NotMovedByCommands(DeviceError):
    """The arm takes no velocities: a person places it."""
