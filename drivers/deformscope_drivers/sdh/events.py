"""Messages between host and hand, apart from their bytes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Command:
    """A message of the host.

    name: the ASCII protocol's name, lower case; also for binary requests, whose code it stands for
    values: values to set; none = a query; axis: 0 to 6 for a command to one axis; None = all"""

    name: str
    values: tuple[float, ...] = ()
    axis: int | None = None


@dataclass(frozen=True, slots=True)
class Reading:
    """A measurement of the hand.

    quantity: `pos`, `tpap` [deg]; `vel`, `rvel`, `tvav` [deg/s]; `state` (AxisState); `temp` [deg C]. `tpap`, `tvav`:
    actual angles and velocities in answer to a target; `rvel` is the reference velocity; values: 7 values, by axis; 9
    temperatures (7 motors, the FPGA, the board); 1 value if one axis was requested; axis: None = all"""

    quantity: str
    values: tuple[float, ...]
    axis: int | None = None


@dataclass(frozen=True, slots=True)
class ValueReply:
    """A command was done; the values are the new settings, or a duration [s].

    name: lower case"""

    name: str
    values: tuple[float, ...] = ()
    axis: int | None = None


@dataclass(frozen=True, slots=True)
class TextReply:
    """The answer to `ver`, `id`, `sn`, `soc` and their dates."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class ErrorReply:
    """The hand refused a command; `name` is known in binary only."""

    code: int
    name: str | None = None


@dataclass(frozen=True, slots=True)
class DebugLine:
    """A line that starts with `@`, without it: not part of the answer."""

    text: str


Event = Reading | ValueReply | TextReply | ErrorReply | DebugLine
