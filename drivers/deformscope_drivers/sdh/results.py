"""Return values of the hand's driver."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Stamp
from deformscope_drivers.sdh.codes import AxisState
from deformscope_drivers.sdh.config import Limits

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class HandReading:
    """Pose of the hand. The protocol has no measured motor currents, so that a reading has none.

    stamp: when the angles arrived; states and velocities were requested right before them (3.4 ms each on RS-232)
    position_deg, velocity_deg_s: (7,) angles and speeds by axis; state: state of each axis
    temperature_c: (9,) the 7 motors, the FPGA and the board, read more rarely: at `temperature_stamp`; None before"""

    stamp: Stamp
    position_deg: FloatArray
    velocity_deg_s: FloatArray
    state: tuple[AxisState, ...]
    temperature_c: FloatArray | None = None
    temperature_stamp: Stamp | None = None


@dataclass(frozen=True, slots=True)
class HandIdentity:
    """The hand's own identity. firmware: its release; binary: whether the driver uses the binary protocol"""

    firmware: str
    firmware_date: str
    name: str
    serial_number: str
    binary: bool
    limits: Limits


class Outcome(StrEnum):
    """End of a motion."""

    STARTED = "started"  # it was not waited for
    REACHED = "reached"  # still, at the targets
    BLOCKED = "blocked"  # still; an axis met something
    LIMITED = "limited"  # still; an axis came to the end of its range
    STOPPED = "stopped"  # `stop` was called
    MISSED = "missed"  # still, not at the targets, and no axis says why
    TIMED_OUT = "timed out"  # it went on for too long and was stopped


@dataclass(frozen=True, slots=True, eq=False)
class MoveResult:
    """Result of a motion.

    duration_s: what the hand planned, None where old firmware does not report it
    elapsed_s: time until it was seen at rest
    blocked, limited, disabled: axes in such a state; reading: the last one, None where it was not waited for
    error_deg: largest distance of an axis from its target, None where it was not waited for"""

    outcome: Outcome
    duration_s: float | None
    elapsed_s: float = 0.0
    blocked: tuple[int, ...] = ()
    limited: tuple[int, ...] = ()
    disabled: tuple[int, ...] = ()
    error_deg: float | None = None
    reading: HandReading | None = None
