"""A KUKA through RSI: each of the controller's cycles is answered at once, with the correction for that cycle.

Corrections are relative: an answer of zeros leaves the arm at rest, so no waiting points would have to be erased. A
correction is velocity times cycle, limited to the axes' speeds, until the velocity expires, and zero afterwards. A
missing answer leaves the arm at rest only if the controller is configured so (HOLDON="0"). Opening tests it, with a
correction of PROBE_DEG after which answers are left out, and refuses any other controller. After a link that was lost,
when the tip may press something, the test waits for `acknowledge_stop`."""

from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from deformscope_drivers import errors
from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.device import Arm, ArmState, by_joints
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, ROUND_S, Reconnect
from deformscope_drivers.health import Identity, Link
from deformscope_drivers.kuka.config import CHAINS, KukaConfig
from deformscope_drivers.kuka.messages import AXES, RobMessage, SenMessage, decode_rob, encode_sen
from deformscope_drivers.kuka.port import UdpPort
from deformscope_drivers.transport import Transport

SILENCE_S = 0.5
"""Silence of a controller after which RSI has ended."""
RATES_OVER_NS = 40_000_000
POSE_MM, POSE_DEG = 5.0, 2.0
CYCLES_SEEN = 5
ZEROS_AT_CLOSE = 3
"""Number of answers with zeros before the port is closed: the controller may miss two of them."""
REST_ANSWERS = 50
"""Number of successive ones that must be in time while an arm is stopped. Not a time: this process may be held up."""
PROBE_DEG, PROBE_LEFT_OUT, PROBE_SETTLES_S = 0.01, 2, 0.5
"""At opening: a correction of every axis, how many answers are then left out, and when the axes have settled. A
correction that is held moves an axis by three times as much. Chosen: ten times what AIPos shows at rest."""
PROBES = 5
"""Tries, where an axis did not move: the answer may have come too late, or the program may not be there yet."""
START = (
    "start the RSI program on the smartPAD (RSI_ON(#RELATIVE), RSI_MOVECORR), IP_NUMBER and PORT being this computer's"
)
FILES = "`deformscope arm files RIG` writes the files"


def open_kuka(config: KukaConfig) -> Arm[Any]:
    """The device, not yet opened: in a separate process unless the configuration disables that."""
    return HostedArm(Kuka, config) if config.own_process else Kuka(config)


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
        self._zeros = self._late_before = 0
        self._resting = self._untested = False
        self._track: deque[tuple[int, tuple[float, ...]]] = deque()

    @property
    def chain(self) -> kinematics.Chain:
        return self._chain

    @property
    def urdf(self) -> Path:
        return Path(__file__).parent / f"{self._chain.name}.urdf"

    def identity(self) -> Identity:
        return Identity(self.config.model)

    def stop(self) -> None:
        self._forget()
        self._do(lambda: self._rest(1), 2 * SILENCE_S)

    def halt(self, reason: str) -> None:
        self._forget(reason or "by command")
        self._do(lambda: self._rest(1), 2 * SILENCE_S)

    def acknowledge_stop(self) -> None:
        """See `Arm.acknowledge_stop`; moves the axes by PROBE_DEG where that is still to be tested. Raises
        SettingsRefused as opening does: it is stopped then."""
        if self._untested:
            self._do(self._check_missing, 3 * PROBES * PROBE_SETTLES_S)
            self._untested = False
        super().acknowledge_stop()

    def _rest(self, zeros: int) -> None:
        """Answer with zeros until a number of successive answers were sent that the controller did not count as late.
        Raises NotStopped, or LinkLost where it asks no more."""
        self._resting = True
        try:
            for _ in range(REST_ANSWERS):
                if self._zeros >= zeros:
                    return
                for state in self._receive(ROUND_S):
                    self._publish(state)
        finally:
            self._resting = False
        came = f"{REST_ANSWERS}, of which the last came too late"
        raise errors.NotStopped(f"{zeros} answers of zeros in time", came, self.stop_by_hand, self.name)

    def _forget(self, stopped_because: str = "") -> None:
        with self._commanded:
            self._streamed = None
            self._stopped = self._stopped or stopped_because

    # The cycle: run by the device's own thread -----------------------------------------------------------------------

    def _connect(self) -> None:
        """Answer with zeros until the controller is known to be as it should."""
        self._transport.open()
        self._track.clear()
        self._ipoc = self._zeros = self._late_before = 0
        message = self._hear(self._zero, self.config.wait_s)
        steps_ms: list[int] = []
        while len(steps_ms) < CYCLES_SEEN:
            before = message.ipoc
            message = self._hear(self._zero)
            steps_ms.append(message.ipoc - before)
        self._check(message, min(steps_ms))
        self._untested = self.still or self._link is Link.LOST
        if self._untested:
            self._stopped = self._stopped or "its link was lost, and missing answers are not tested since"
        else:
            self._check_missing()
        self._not_stopped = None
        self._expect(self.config.state_hz)

    @property
    def _zero(self) -> kinematics.FloatArray:
        """(n,) joint corrections of an arm that keeps still [deg]."""
        return np.zeros(self._chain.joint_count)

    def _hear(self, corrections_deg: kinematics.FloatArray | None, within_s: float = SILENCE_S) -> RobMessage:
        """The next message of a controller that is being opened, answered by corrections (6,), or left unanswered."""
        until_ns = self._clock() + round(within_s * 1e9)
        while (left_s := (until_ns - self._clock()) / 1e9) > 0 and not self._closing.is_set():
            if data := self._transport.read(min(left_s, ROUND_S)):
                message = decode_rob(data)
                self._note(message)
                if corrections_deg is not None:
                    self._answer(message.ipoc, corrections_deg)
                return message
        raise errors.NotConnected("a controller that sends", f"none in {within_s:g} s", START, self.name)

    def _note(self, message: RobMessage) -> None:
        """Take note of a message's number, and whether the last answer is said to have come too late."""
        if message.late > self._late_before:
            self._zeros = 0
        self._ipoc, self._late_before, self._heard_ns = message.ipoc, message.late, self._clock()

    def _check_missing(self) -> None:
        """That one answer moves the axes once, and that they rest while answers are missing."""
        moved_deg = self._zero
        for _ in range(PROBES):
            moved_deg = self._probe_deg()
            if np.any(moved_deg > 1.5 * PROBE_DEG):
                raise errors.SettingsRefused(
                    f"axes that move by {PROBE_DEG:g} deg for one answer, and rest while answers are missing",
                    f"{_by_axis(moved_deg)} after one answer and {PROBE_LEFT_OUT} that were left out: the "
                    "last correction is repeated, and the arm would move on after a failure of this program "
                    "or the cable",
                    f'HOLDON="0" for AK.A1 to AK.A6 in the file that ConfigFile of the ETHERNET object names; {FILES}',
                    self.name,
                )
            if np.all(moved_deg > 0.5 * PROBE_DEG):
                return
            self._settled_deg()
        raise errors.SettingsRefused(
            f"axes that are {PROBE_DEG:g} deg further after one answer with that correction",
            f"{_by_axis(moved_deg)} in {PROBES} tries",
            f"RSI_ON(#RELATIVE) in place of #ABSOLUTE; AK.A1 to AK.A6 wired to AXISCORR; Precision 4 of the ETHERNET "
            f"object; RSI_MOVECORR() running with the drives on; {FILES}",
            self.name,
        )

    def _probe_deg(self) -> kinematics.FloatArray:
        """(6,) by how much each axis moves for one correction of PROBE_DEG after which answers are left out [deg]."""
        joints_deg = np.array(self._hear(self._zero).joints_deg)
        up = self._chain.jacobian(joints_deg)[2] >= 0  # the flange rather rises than goes down
        at_end = self._chain.to_limits_deg(joints_deg) < 1.0
        inwards = joints_deg < 0.5 * (self._chain.lower_deg + self._chain.upper_deg)
        signs = np.where(np.where(at_end, inwards, up), 1.0, -1.0)
        self._hear(PROBE_DEG * signs)
        for _ in range(PROBE_LEFT_OUT):
            self._hear(None)
        moved_deg: kinematics.FloatArray = signs * (self._settled_deg() - joints_deg)
        if np.all(moved_deg < 1.5 * PROBE_DEG):
            self._hear(-PROBE_DEG * np.where(moved_deg > 0.5 * PROBE_DEG, signs, 0.0))  # back, what has moved
        return moved_deg

    def _settled_deg(self) -> kinematics.FloatArray:
        """(6,) where the axes are once zeros have let them settle [deg]."""
        for _ in range(round(PROBE_SETTLES_S / self.config.cycle_s)):
            self._hear(self._zero)
        return np.array(self._hear(self._zero).joints_deg)

    def _check(self, message: RobMessage, step_ms: int) -> None:
        """That the controller runs at the cycle that corrections are made for, and is the arm of this model."""
        cycle_ms = round(1e3 * self.config.cycle_s)
        if step_ms != cycle_ms:
            raise errors.SettingsRefused(f"cycles of {cycle_ms} ms", f"of {step_ms} ms", "cycle_s", self.name)
        if message.pose is None or not self.config.check_pose:
            return
        yaw, pitch, roll = np.radians(message.pose[3:])
        theirs = kinematics.transform(kinematics.rotation_from_rpy(roll, pitch, yaw), np.array(message.pose[:3]) / 1e3)
        error = kinematics.pose_error(self._chain.end_effector(message.joints_deg), theirs)
        off_mm, off_deg = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
        if not (off_mm <= POSE_MM and off_deg <= POSE_DEG):
            raise errors.SettingsRefused(
                f"the flange within {POSE_MM:g} mm and {POSE_DEG:g} deg of the pose of a {self._chain.name}",
                f"one that the controller reports {off_mm:.1f} mm and {off_deg:.1f} deg away",
                "another `model`; or $TOOL = $NULLFRAME and $BASE = $NULLFRAME before RSI_ON: the tool belongs into "
                "the rig file",
                self.name,
            )

    def _disconnect(self) -> None:
        with self._commanded:
            moving, self._streamed = self._streamed is not None or not self._zeros, None
            if moving and not self._closing.is_set():
                self._stopped = self._stopped or "the link to the arm was lost while it moved"
        try:
            if self._ipoc:
                self._rest(ZEROS_AT_CLOSE)
        except errors.DeviceError as error:
            self._not_stopped = error if moving else self._not_stopped
        finally:
            self._ipoc = 0
            self._transport.close()

    def _wake(self) -> None:
        self._transport.wake()

    def _receive(self, timeout_s: float) -> Iterable[ArmState]:
        data = self._transport.read(timeout_s)
        now_ns = self._clock()
        if not data:
            if now_ns - self._heard_ns > SILENCE_S * 1e9:
                raise errors.LinkLost("datagrams from the controller", f"none for {SILENCE_S:g} s", START, self.name)
            return ()
        self._record_raw(data, now_ns)
        try:
            message = decode_rob(data)
        except errors.ProtocolViolation as error:
            self._count_refused(str(error).split(" | ")[0][:60])
            return ()
        lost = round((message.ipoc - self._ipoc) / (1e3 * self.config.cycle_s)) - 1
        self._note(message)
        self._answer(message.ipoc, self._correction_deg(message.joints_deg, now_ns))
        if 0 < lost < 10_000:
            self._count_lost(lost)
        self._late += message.late > 0
        return (self._state(message, now_ns),)

    def _correction_deg(self, joints_deg: tuple[float, ...], now_ns: int) -> kinematics.FloatArray:
        """(6,) for one cycle: velocity times cycle, within an axis's limit; zero without a valid velocity."""
        with self._commanded:
            streamed = self._streamed
            if streamed is not None and now_ns > streamed.expires_ns:
                self._streamed = streamed = None
                self._expired += 1
        zero = self._zero
        if streamed is None or self._resting:
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
            self._forget(f"an axis reached the end of its range: {np.round(joints_deg, 1).tolist()} deg")
            return zero
        return correction_deg

    def _answer(self, ipoc: int, corrections_deg: kinematics.FloatArray) -> None:
        corrections = tuple(float(value) for value in corrections_deg)
        data = encode_sen(SenMessage(corrections, ipoc, self.config.sen_type))
        self._transport.write(data)
        self._zeros = 0 if any(corrections) else self._zeros + 1
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
        theta_x, theta_y, theta_z = (float(value) for value in kinematics.euler_xyz_from_rotation(pose[:3, :3]))
        return ArmState(
            stamp=Stamp(now_ns, message.ipoc),
            joints_deg=message.joints_deg,
            rates_deg_s=tuple((a - b) / span_s for a, b in zip(message.joints_deg, before_deg, strict=True)),
            position_m=(x, y, z),
            theta_rad=(theta_x, theta_y, theta_z),
            currents=message.currents,
        )

    def _extra_health(self) -> dict[str, float]:
        return {"commands_expired": self._expired, "corrections_clamped": self._clamped, "answers_late": self._late}


def _by_axis(moved_deg: kinematics.FloatArray) -> str:
    return ", ".join(f"{axis} {moved:+.3f}" for axis, moved in zip(AXES, moved_deg, strict=True)) + " deg"
