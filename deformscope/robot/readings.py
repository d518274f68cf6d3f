"""What is known of the robot in one control period: what its devices said since the last one."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.arm.state import ArmState

if TYPE_CHECKING:
    from deformscope_drivers.optoforce.measurement import ForceMeasurement

PERIOD_NS = 10_000_000
"""A control period: the arm takes one velocity in each."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceSample:
    """time_ns: arrival; force_n: (3,) what the tip does to the world, in the tip's frame, positive z = compression,
    tare taken off; pattern: the bits as sent, the same for a frozen sensor; usable: sensor and wire are well
    ticks: the sensor's own count, -1 = none; sensor_n: (3,) before the tare was taken off
    """

    time_ns: int
    force_n: FloatArray
    pattern: Hashable = None
    usable: bool = True
    ticks: int = -1
    sensor_n: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(cls, reading: ForceMeasurement, tare_n: FloatArray) -> ForceSample:
        """The first channel of a reading."""
        sensor_n, stamp = reading.force_n[0], reading.stamp
        ticks = -1 if stamp.device_ticks is None else stamp.device_ticks
        return cls(stamp.host_ns, sensor_n - tare_n, reading.counts, reading.usable, ticks, sensor_n)


@dataclass(frozen=True, slots=True, eq=False)
class ArmSample:
    """time_ns: arrival; T_base_ee: (4, 4) the arm's end; joints_deg: (n,); fifo_count: points that wait in the arm
    torques_nm: (n,) of the joints without those of gravity, as read at times of their own; empty where not known
    currents: (n,) of their motors, in units of the arm's own; empty where not known
    """

    time_ns: int
    T_base_ee: FloatArray
    joints_deg: tuple[float, ...]
    fifo_count: int = 0
    torques_nm: tuple[float, ...] = ()
    currents: tuple[float, ...] = ()

    @classmethod
    def of(cls, state: ArmState) -> ArmSample:
        """The same, of the driver's state; a state that is not finite becomes a pose that is not."""
        finite = all(map(np.isfinite, (*state.position_m, *state.theta_rad)))
        pose = state.T_base_end_effector if finite else np.full((4, 4), np.nan)
        return cls(state.stamp.host_ns, pose, state.joints_deg, state.fifo_count, state.torques_nm, state.currents)


@dataclass(frozen=True, slots=True)
class CameraSample:
    """time_ns: arrival of a picture; pattern: the same for the same picture"""

    time_ns: int
    pattern: Hashable


@dataclass(frozen=True, slots=True, eq=False)
class RobotObservation:
    """What came since the last control period, oldest first.

    refused: frames of the force sensor's wire that failed their checksum or made no sense, since opening
    lost_links: names of devices whose link is down, and why
    """

    now_ns: int
    forces: tuple[ForceSample, ...] = ()
    arms: tuple[ArmSample, ...] = ()
    pictures: tuple[CameraSample, ...] = ()
    refused: int = 0
    lost_links: tuple[tuple[str, str], ...] = ()
