"""Errors of an arm, in addition to those of any device."""

from __future__ import annotations

from deformscope_drivers.errors import DeviceError


class MotionStopped(DeviceError):
    """The arm was stopped, and refuses commands until a person acknowledges the reason."""


class NotStopped(DeviceError):
    """The arm was moving, and the stop command did not reach it."""


class NotMovedByCommands(DeviceError):
    """The arm takes no velocities: a person places it."""
