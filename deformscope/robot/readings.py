"""Readings of the robot's devices in one control period."""

import math
from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np

from deformscope_drivers.arm.device import ArmState
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.interface import ForceReading

PERIOD_NS = 10_000_000
"""A control period: the arm receives one velocity in each."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceSample:
    """A reading of the force sensor.

    time_ns: arrival; force_n: (3,) force of the tip on the world in the tip's frame, positive z = compression, tare
    taken off [N]; sensor_n: (3,) force as the sensor reports it; pattern: the bits as sent, which a frozen sensor
    repeats; usable: sensor and wire report no error; ticks: the sensor's own count, -1 = none"""

    time_ns: int
    force_n: FloatArray
    pattern: Hashable = None
    usable: bool = True
    ticks: int = -1
    sensor_n: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(cls, reading: ForceReading, tare_n: FloatArray) -> "ForceSample":
        """Sample of the first channel of a driver's reading. tare_n: (3,) force in free air, which is subtracted [N]"""
        sensor_n, stamp = reading.force_n[0], reading.stamp
        ticks = -1 if stamp.device_ticks is None else stamp.device_ticks
        return cls(stamp.host_ns, sensor_n - tare_n, reading.counts, reading.usable, ticks, sensor_n)


@dataclass(frozen=True, slots=True, eq=False)
class ArmSample:
    """A state of the arm.

    time_ns: arrival; T_base_ee: (4, 4) pose of the arm's end in the base frame [m]; joints_deg: (n,); fifo_count:
    points that wait in the arm; torques_nm: (n,) torques of the joints without gravity's, read at times of their own;
    currents: (n,) currents of the motors in the arm's own unit; either is empty where the arm reports none"""

    time_ns: int
    T_base_ee: FloatArray
    joints_deg: tuple[float, ...]
    fifo_count: int = 0
    torques_nm: tuple[float, ...] = ()
    currents: tuple[float, ...] = ()

    @classmethod
    def of(cls, state: ArmState) -> "ArmSample":
        """Sample of a driver's state; if that is not finite, the pose is nan."""
        finite = all(map(math.isfinite, (*state.position_m, *state.theta_rad)))
        pose = state.T_base_end_effector if finite else np.full((4, 4), np.nan)
        return cls(state.stamp.host_ns, pose, state.joints_deg, state.fifo_count, state.torques_nm, state.currents)


@dataclass(frozen=True, slots=True)
class CameraSample:
    """An image's arrival. time_ns: when; pattern: a fingerprint, the same for the same image"""

    time_ns: int
    pattern: Hashable


@dataclass(frozen=True, slots=True, eq=False)
class RobotObservation:
    """Items since the last control period, oldest first.

    refused: frames of the force sensor's wire that failed their checksum or made no sense, since opening; lost_links:
    names of devices whose link is down, and why"""

    now_ns: int
    forces: tuple[ForceSample, ...] = ()
    arms: tuple[ArmSample, ...] = ()
    pictures: tuple[CameraSample, ...] = ()
    refused: int = 0
    lost_links: tuple[tuple[str, str], ...] = ()
