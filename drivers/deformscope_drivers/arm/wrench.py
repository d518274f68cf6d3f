"""The force at an arm's end by the arm's own report, as a force sensor: `driver = "arm"` in a rig file.

The report has errors that `deformscope calibrate wrench` learns in a motion without contact: a bias that changes with
the pose, friction by the direction of the motion, and poses near singularities where it means nothing."""

import contextlib
import dataclasses
import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm.device import Arm, ArmState
from deformscope_drivers.arm.kinematics import Chain, FloatArray, jacobian_of, least_singular
from deformscope_drivers.device import Device, EndOfReadings
from deformscope_drivers.errors import NotConnected, SettingsRefused
from deformscope_drivers.health import Description
from deformscope_drivers.interface import DeviceDriver, Wrench
from deformscope_drivers.subscription import Subscription

TURN_DEG = 0.1
"""Turn of a joint after which its friction is that of this direction; at rest it stays (Dahl 1968)."""
BEYOND = 1.2
"""How far outside the learned range, in halves of it, the bias still changes with a joint."""
ZERO_READINGS = 25
"""Readings of which the mean is the zero: their noise is then a fifth."""


@dataclass(frozen=True, slots=True)
class ArmWrenchConfig:
    """How an arm's own force is read; `deformscope calibrate wrench` writes the errors.

    filter_hz: limit of its low pass; rate_hz: the arm's, which is taken from it
    least_singular: least singular value of the Jacobian at which the force is used [m/rad]
    middle_deg, half_deg: (n,) middle and half width of the joints' learned range
    bias_n: (f, 3) bias in the base frame by the terms of `pose_terms` [N]; friction_n: (n, 3) friction once each joint
    turned forwards [N]

    Raises ValueError"""

    filter_hz: float = 8.0
    rate_hz: float | None = None
    least_singular: float = 0.0
    middle_deg: tuple[float, ...] = ()
    half_deg: tuple[float, ...] = ()
    bias_n: tuple[tuple[float, float, float], ...] = ()
    friction_n: tuple[tuple[float, float, float], ...] = ()

    def __post_init__(self) -> None:
        joints = len(self.middle_deg)
        rows = (joints + 1) * (joints + 2) // 2 if joints else 0
        if not (
            2.0 <= self.filter_hz <= 50.0 and self.least_singular >= 0.0 and all(one > 0.0 for one in self.half_deg)
        ):
            raise ValueError("expected filter_hz from 2 to 50, least_singular of 0 or more, and half_deg above 0")
        if (len(self.half_deg), len(self.friction_n), len(self.bias_n)) != (joints, joints, rows):
            raise ValueError(f"expected half_deg and friction_n of {joints}, and bias_n of {rows} rows")


def pose_terms(joints_deg: npt.ArrayLike, middle_deg: npt.ArrayLike, half_deg: npt.ArrayLike) -> FloatArray:
    """(..., f) terms of the second order in joint angles (..., n), which are scaled to their learned range."""
    scaled = np.clip((np.asarray(joints_deg) - middle_deg) / np.asarray(half_deg), -BEYOND, BEYOND)
    first, second = np.triu_indices(scaled.shape[-1])
    one = np.ones((*scaled.shape[:-1], 1))
    return np.concatenate([one, scaled, scaled[..., first] * scaled[..., second]], axis=-1)


def way_terms(way: FloatArray, turned_deg: npt.ArrayLike) -> FloatArray:
    """(n,) direction in which each joint turned last, -1 to 1, from that of before and its turn since [deg]."""
    return np.clip(way + np.asarray(turned_deg) / TURN_DEG, -1.0, 1.0)


def low_pass_share(filter_hz: float, rate_hz: float) -> float:
    """The part of each new reading in a low pass of first order."""
    return 1.0 - math.exp(-2.0 * math.pi * filter_hz / rate_hz)


def reported_n(states: Sequence[ArmState], chain: Chain) -> tuple[FloatArray, FloatArray]:
    """(m, 3) force on the arm's end, base frame [N], and the least singular value (m,) of its Jacobian: the force of
    its joints' torques where it reports them, else that which it reports. Raises SettingsRefused without either."""
    jacobians = jacobian_of(chain.forward(np.array([state.joints_deg for state in states])))
    if states[0].torques_nm:
        torques_nm = np.array([state.torques_nm for state in states])[..., None]
        force_n = (np.linalg.pinv(jacobians.swapaxes(-1, -2)) @ torques_nm)[:, :3, 0]
    elif all(map(math.isfinite, states[0].wrench[:3])):
        force_n = np.array([state.wrench[:3] for state in states])
    else:
        came, advice = f"none from a {chain.name}", "a force sensor at its end"
        raise SettingsRefused("an arm that reports its own force, or joint torques", came, advice)
    return np.asarray(force_n, float), least_singular(jacobians)


class ArmWrench(Device[Wrench]):
    """A force sensor in the frame of the arm's end, which reads the reports of `attach`'s arm."""

    prompt = True
    _zero_n: FloatArray

    def __init__(self, config: ArmWrenchConfig | None = None) -> None:
        self.config = config if config is not None else ArmWrenchConfig()
        super().__init__("own wrench of the arm", reconnect=None)
        self.delay_ns = round(1e9 / (2.0 * math.pi * self.config.filter_hz))
        self._arm: Arm[Any] | None = None
        self._states: Subscription[ArmState] | None = None
        self._recent: deque[FloatArray] = deque(maxlen=ZERO_READINGS + 1)
        self._begin()

    def attach(self, arm: Arm[Any]) -> None:
        """Read the reports of this arm, which is open before and closed after it."""
        self._arm, self._clock = arm, arm._clock
        self.config = dataclasses.replace(self.config, rate_hz=arm.state_hz)

    def zero(self) -> None:
        """Take the mean of the last ZERO_READINGS for zero, from the next on. Raises Stale where none come."""
        while len(self._recent) < ZERO_READINGS:
            self.next(1.0)
        self._zeroing = True

    def zeroed(self, reading: Wrench) -> Wrench:
        """The newest reading, with the mean of those before it for zero."""
        self._zeroing, self._zero_n = False, np.mean(list(self._recent)[:-1], axis=0)
        self._smooth_n = self._recent[-1] - self._zero_n
        return dataclasses.replace(reading, force_n=self._smooth_n[None])

    def _begin(self) -> None:
        self._recent.clear()
        self._zeroing = False
        self._zero_n, self._smooth_n = np.zeros(3), np.full(3, np.nan)
        self._way, self._joints_deg = np.zeros(len(self.config.middle_deg)), np.full(1, np.nan)

    def describe(self) -> Description:
        return Description(self.config.rate_hz or 0.0)

    def _connect(self) -> None:
        if self._arm is None or self._arm.by_hand:
            raise NotConnected("an arm whose force it is", "none in the rig", 'a device with driver = "ur" or "jaco"')
        self._begin()
        self._states = self._arm.readings()
        self._expect(self.config.rate_hz)

    def _disconnect(self) -> None:
        states, self._states = self._states, None
        if states is not None:
            states.close()

    def _receive(self, timeout_s: float) -> Iterable[Wrench]:
        assert self._states is not None and self._arm is not None  # noqa: PT018
        states: list[ArmState] = []
        if timeout_s > 0.0 and not self._own_thread:
            self._arm.poll(timeout_s)
        elif timeout_s > 0.0:
            with contextlib.suppress(TimeoutError, EOFError):
                states.append(self._states.get(timeout_s))
        states += self._states.take()
        if not states:
            if self._states.ended:
                raise EndOfReadings("the arm was closed")
            return []
        return self.readings_of(states, self._arm.chain)

    def readings_of(self, states: Sequence[ArmState], chain: Chain) -> list[Wrench]:
        """The readings of the next states of the arm (n)."""
        forces_n, singular = reported_n(states, chain)
        return [self._reading(*one) for one in zip(states, forces_n, singular, strict=True)]

    def _reading(self, state: ArmState, reported: FloatArray, singular: float) -> Wrench:
        config, force_n = self.config, reported
        if config.bias_n:
            terms = pose_terms(state.joints_deg, config.middle_deg, config.half_deg)
            force_n = reported - terms @ np.array(config.bias_n)
            joints_deg = np.array(state.joints_deg)
            self._way = way_terms(self._way, np.nan_to_num(joints_deg - self._joints_deg))
            self._joints_deg = joints_deg
            force_n = force_n - self._way @ np.array(config.friction_n)
        self._recent.append(np.asarray(-state.T_base_end_effector[:3, :3].T @ force_n))
        force_n = self._recent[-1] - self._zero_n
        before_n = force_n if np.isnan(self._smooth_n).any() else self._smooth_n
        self._smooth_n = before_n + low_pass_share(config.filter_hz, config.rate_hz or 100.0) * (force_n - before_n)
        usable = singular >= config.least_singular and bool(np.any(reported))
        counts = tuple(round(1e3 * one) if math.isfinite(one) else 0 for one in reported.tolist())
        reading = Wrench(state.stamp, (counts,), self._smooth_n[None], usable=usable)
        return self.zeroed(reading) if self._zeroing else reading


DRIVER = DeviceDriver("wrench", ArmWrenchConfig, ArmWrench)
