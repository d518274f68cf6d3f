"""A KUKA through RSI: each of the controller's cycles is answered at once, with the correction for that cycle.

Corrections are relative: an answer of zeros, or none, lets the arm stand, so nothing waits in it that would have to be
erased. A velocity becomes velocity times cycle, clamped to the axes' speeds, for as long as its sender vouches for it,
and zero after. The controller decides the moments; what comes late it counts, and ends RSI after a hundred in a row.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from deformscope_drivers.arm.beside import ArmBeside
from deformscope_drivers.arm.commands import by_joints
from deformscope_drivers.arm.device import Arm
from deformscope_drivers.arm.kinematics import (
    Chain,
    FloatArray,
    euler_xyz_from_rotation,
    pose_error,
    rotation_from_rpy,
    transform,
)
from deformscope_drivers.arm.state import ArmState
from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.errors import LinkLost, NotConnected, ProtocolViolation, SettingsRefused
from deformscope_drivers.health import Identity
from deformscope_drivers.kuka.chains import CHAINS
from deformscope_drivers.kuka.config import KukaConfig
from deformscope_drivers.kuka.messages import RobMessage, SenMessage, decode_rob, encode_sen
from deformscope_drivers.kuka.port import UdpPort
from deformscope_drivers.transport import Transport

SILENCE_S = 0.5
"""A controller that sends nothing for so long has ended RSI."""
RATES_OVER_NS = 40_000_000
POSE_MM, POSE_DEG = 5.0, 2.0
CYCLES_SEEN = 5
START = (
    "start the RSI program on the smartPAD (RSI_ON(#RELATIVE), RSI_MOVECORR), IP_NUMBER and PORT being this computer's"
)


def open_kuka(config: KukaConfig) -> Arm[Any]:
    """The device, closed: in a process of its own unless the configuration says otherwise."""
    return ArmBeside(Kuka, config) if config.own_process else Kuka(config)


class Kuka(Arm[ArmState]):
    """`with Kuka(KukaConfig(address="192.168.1.25")) as arm:`; opening waits for the controller to begin."""

    def __init__(
        self,
        config: KukaConfig | None = None,
        transport: Transport | None = None,
        *,
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        """transport: a double in place of the network; clock: the host's, or a simulated laboratory's"""
        self.config = config if config is not None else KukaConfig()
        made = UdpPort(self.config.address, self.config.port, self.config.controller)
        self._transport = transport if transport is not None else made
        super().__init__(self._transport.name, reconnect=reconnect, clock=clock)
        self._chain = CHAINS[self.config.model]
        self._ipoc = self._heard_ns = 0
        self._expired = self._late = self._clamped = 0
        self._track: deque[tuple[int, tuple[float, ...]]] = deque()

    @property
    def chain(self) -> Chain:
        return self._chain

    @property
    def urdf(self) -> Path:
        return Path(__file__).parent / f"{self._chain.name}.urdf"

    def identity(self) -> Identity:
        return Identity(self.config.model)

    def stop(self) -> None:
        self._forget()
        self._do(self._noop, SILENCE_S)

    def halt(self, reason: str) -> None:
        self._forget(reason or "by command")
        self._do(self._noop, SILENCE_S)

    def _noop(self) -> None:
        """The device's thread has come round: what it sends from now on is zero."""

    def _forget(self, stopped_because: str = "") -> None:
        with self._commanded:
            self._streamed = None
            self._stopped = self._stopped or stopped_because

    # The cycle: run by the device's own thread -----------------------------------------------------------------------

    def _connect(self) -> None:
        """Answer with zeros until the controller is known to be as it should."""
        self._transport.open()
        self._track.clear()
        self._ipoc = 0
        until_ns = self._clock() + round(self.config.wait_s * 1e9)
        steps_ms: list[int] = []
        message: RobMessage | None = None
        while message is None or len(steps_ms) < CYCLES_SEEN:
            left_s = (until_ns - self._clock()) / 1e9
            if left_s <= 0 or self._closing.is_set():
                raise NotConnected("a controller that sends", f"none in {self.config.wait_s:g} s", START, self.name)
            if not (data := self._transport.read(min(left_s, 0.05))):
                continue
            message = decode_rob(data)
            self._answer(message.ipoc, np.zeros(self._chain.joint_count))
            if self._ipoc:
                steps_ms.append(message.ipoc - self._ipoc)
            self._ipoc = message.ipoc
        self._check(message, min(steps_ms))
        self._heard_ns = self._clock()
        self._expect(self.config.state_hz)

    def _check(self, message: RobMessage, step_ms: int) -> None:
        """That the controller runs at the cycle that corrections are made for, and is the arm of this model."""
        cycle_ms = round(1e3 * self.config.cycle_s)
        if step_ms != cycle_ms:
            raise SettingsRefused(f"cycles of {cycle_ms} ms", f"of {step_ms} ms", "cycle_s", self.name)
        if message.pose is None or not self.config.check_pose:
            return
        yaw, pitch, roll = np.radians(message.pose[3:])
        theirs = transform(rotation_from_rpy(roll, pitch, yaw), np.array(message.pose[:3]) / 1e3)
        error = pose_error(self._chain.end_effector(message.joints_deg), theirs)
        off_mm, off_deg = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
        if not (off_mm <= POSE_MM and off_deg <= POSE_DEG):
            raise SettingsRefused(
                f"the flange within {POSE_MM:g} mm and {POSE_DEG:g} deg of where a {self._chain.name} has it",
                f"one that the controller reports {off_mm:.1f} mm and {off_deg:.1f} deg away",
                "another `model`; or $TOOL = $NULLFRAME and $BASE = $NULLFRAME before RSI_ON: the tool belongs into "
                "the rig file",
                self.name,
            )

    def _disconnect(self) -> None:
        with self._commanded:
            moving, self._streamed = self._streamed is not None, None
            if moving and not self._closing.is_set():
                self._stopped = self._stopped or "the link to the arm was lost while it moved"
        self._transport.close()

    def _wake(self) -> None:
        self._transport.wake()

    def _receive(self, timeout_s: float) -> Iterable[ArmState]:
        data = self._transport.read(timeout_s)
        now_ns = self._clock()
        if not data:
            if now_ns - self._heard_ns > SILENCE_S * 1e9:
                raise LinkLost("datagrams from the controller", f"none for {SILENCE_S:g} s", START, self.name)
            return ()
        self._record_raw(data, now_ns)
        try:
            message = decode_rob(data)
        except ProtocolViolation as error:
            self._count_refused(str(error).split(" | ")[0][:60])
            return ()
        self._answer(message.ipoc, self._correction_deg(message.joints_deg, now_ns))
        lost = round((message.ipoc - self._ipoc) / (1e3 * self.config.cycle_s)) - 1
        if 0 < lost < 10_000:
            self._count_lost(lost)
        self._ipoc, self._heard_ns = message.ipoc, now_ns
        self._late += message.late > 0
        return (self._state(message, now_ns),)

    def _correction_deg(self, joints_deg: tuple[float, ...], now_ns: int) -> FloatArray:
        """(6,) for one cycle: velocity times cycle, never more than an axis may; zero where nobody vouches for one."""
        with self._commanded:
            streamed = self._streamed
            if streamed is not None and now_ns > streamed.expires_ns:
                self._streamed = streamed = None
                self._expired += 1
        zero = np.zeros(self._chain.joint_count)
        if streamed is None:
            return zero
        rates = by_joints(streamed.velocity, self._chain, self.config, joints_deg)
        if isinstance(rates, str):
            self._forget(rates)
            return zero
        cycle_s: float = self.config.cycle_s
        most_deg = self.joint_limits_deg_s * cycle_s
        wanted_deg = np.array(rates.rates_deg_s) * cycle_s
        correction_deg = np.clip(wanted_deg, -most_deg, most_deg)
        self._clamped += bool(np.any(correction_deg != wanted_deg))
        ahead_deg = np.asarray(joints_deg) + 2.0 * correction_deg
        if not self._chain.within_limits(ahead_deg):
            self._forget(f"an axis came to the end of its range: {np.round(joints_deg, 1).tolist()} deg")
            return zero
        return correction_deg

    def _answer(self, ipoc: int, corrections_deg: FloatArray) -> None:
        corrections = tuple(float(value) for value in corrections_deg)
        data = encode_sen(SenMessage(corrections, ipoc, self.config.sen_type))
        self._transport.write(data)
        self._record_raw(data, self._clock(), sent=True)

    def _state(self, message: RobMessage, now_ns: int) -> ArmState:
        track = self._track
        track.append((now_ns, message.joints_deg))
        while len(track) > 2 and now_ns - track[1][0] >= RATES_OVER_NS:
            track.popleft()
        before_ns, before_deg = track[0]
        span_s = max(now_ns - before_ns, 1) / 1e9
        pose = self._chain.end_effector(message.joints_deg)
        x, y, z = (float(value) for value in pose[:3, 3])
        theta_x, theta_y, theta_z = (float(value) for value in euler_xyz_from_rotation(pose[:3, :3]))
        return ArmState(
            stamp=Stamp(now_ns, message.ipoc),
            joints_deg=message.joints_deg,
            rates_deg_s=tuple((a - b) / span_s for a, b in zip(message.joints_deg, before_deg, strict=True)),
            position_m=(x, y, z),
            theta_rad=(theta_x, theta_y, theta_z),
            currents=message.currents,
        )

    def _extra_health(self) -> dict[str, float]:
        return {
            "commands_expired": self._expired,
            "corrections_clamped": self._clamped,
            "answers_late": self._late,
        }
