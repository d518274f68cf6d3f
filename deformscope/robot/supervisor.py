"""Whether the arm may continue: limits of forces, speeds, joints and space, and the age of its devices' reports.

`BACK_OFF` and `STOP` last until `acknowledge`, and `STOP` replaces `BACK_OFF` (`latch`)."""

import math
from collections import deque
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deformscope.errors import InputError
from deformscope.rig.rig_file import Workspace
from deformscope.robot.clearance import ArmBox, ArmClearance, CollisionWatch, CurrentWatch
from deformscope.robot.latch import Action, Alarm, Decision, LatchingSupervisor
from deformscope.robot.readings import ArmSample, CameraSample, ForceSample, RobotObservation
from deformscope_drivers.arm.kinematics import Chain, FloatArray


class Fault(StrEnum):
    """Why the arm must stop."""

    NONE = "none"
    FORCE_SOFT = "force above the soft stop"
    FORCE_HARD = "force above the hard stop"
    FORCE_SILENT = "force sensor silent"
    FORCE_FROZEN = "force sensor frozen"
    FORCE_INVALID = "force not a number"
    FORCE_UNUSABLE = "force sensor not well"
    FORCE_ASTRAY = "force does not follow the depth"
    CHECKSUMS = "checksum storm"
    ARM_SILENT = "arm silent"
    ARM_FROZEN = "arm frozen"
    ARM_INVALID = "arm's pose not a number"
    ARM_FIFO = "arm's FIFO fills"
    ARM_SPEED = "arm too fast"
    ARM_TURN = "arm turns too fast"
    TILT = "tool turned away"
    JOINT_LIMIT = "joint near its limit"
    SINGULAR = "arm near a singularity"
    TABLE = "arm near the table"
    ITSELF = "arm near itself"
    ARM_BOX = "arm's box left"
    COLLISION = "something pushes the arm"
    TORQUES = "joint torques not known"
    WORKSPACE = "workspace left"
    CAMERA_SILENT = "depth camera silent"
    CAMERA_FROZEN = "depth camera frozen"
    LINK = "link lost"
    REFUSED = "arm takes no commands"
    ASKED = "a person asked"


FORCE_FAULTS = frozenset(
    {
        Fault.FORCE_SILENT,
        Fault.FORCE_FROZEN,
        Fault.FORCE_INVALID,
        Fault.FORCE_UNUSABLE,
        Fault.FORCE_ASTRAY,
        Fault.CHECKSUMS,
    }
)
"""Faults after which the force on the tip is unknown."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the robot. The times are set so that a fault is detected within 50 ms (force), 100 ms (arm) and two
    frame periods (camera), a control period of 10 ms included.

    soft_force_n, hard_force_n: magnitude at which the arm backs off, and at which it stops
    speed_m_s, turn_deg_s: measured speed of the tip's centre, and rate at which the arm's end turns, both from poses
    tilt_deg: angle between the measured and the commanded rotation of the arm's end: 5 deg move the tip of a stick of
    10 cm by 9 mm; joint_margin_deg: no joint comes nearer to the end of its range; table_m, itself_m: least distance of
    elbow and wrist from the table's top, and between parts of the arm that may collide (`clearance.ArmClearance`)
    arm_box: low and high corner (3,) in the base frame of a box for elbow, wrist, stick and tip, None = none [m]
    collision_nm: largest difference of a joint's torque from its mean of the last seconds, besides the effect of the
    force on the tip; more is a collision (`collision.CollisionWatch`), 0 = torques are ignored
    low_m, high_m: (3,) box of the tip's centre in the base frame, None = none; look_ahead_s: time ahead at which the
    tip's expected place must be in the box
    force_silent_s, arm_silent_s: greatest age of the newest reading; force_frozen_s: greatest time of equal readings
    axes_rest: the force sensor's axes are a hand's fingers, which read 0 without contact and then do not count as
    frozen; arm_frozen_m, arm_frozen_s: commanded distance and least time of commands without any change of the joints,
    pauses excluded (an arm begins to move, and reports it, some periods after the command)
    refused, unusable: number of damaged frames, or of unusable readings, within window_s
    camera_period_s: period of the camera's pictures; camera_periods: greatest age in periods; camera_repeats: number of
    repeats of a picture that mean a frozen camera (noise makes two real ones differ)"""

    soft_force_n: float = 8.0
    hard_force_n: float = 15.0
    speed_m_s: float = 0.1
    turn_deg_s: float = 40.0
    tilt_deg: float = 5.0
    joint_margin_deg: float = 5.0
    table_m: float = 0.02
    itself_m: float = 0.005
    arm_box: ArmBox | None = None
    collision_nm: float = 4.0
    low_m: tuple[float, float, float] | None = None
    high_m: tuple[float, float, float] | None = None
    look_ahead_s: float = 0.05
    force_silent_s: float = 0.030
    force_frozen_s: float = 0.030
    axes_rest: bool = False
    arm_silent_s: float = 0.075
    arm_frozen_m: float = 0.0015
    arm_frozen_s: float = 0.09
    fifo: int = 5
    refused: int = 4
    unusable: int = 4
    window_s: float = 0.05
    camera_period_s: float = 1.0 / 30.0
    camera_periods: float = 1.6
    camera_repeats: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.soft_force_n < self.hard_force_n:
            raise InputError("0 < soft_force_n < hard_force_n", f"{self.soft_force_n}, {self.hard_force_n}")
        angles = self.turn_deg_s, self.tilt_deg, self.joint_margin_deg
        if not (min(angles) > 0 and math.isfinite(sum(angles))):
            raise InputError("turn_deg_s, tilt_deg and joint_margin_deg above 0", f"{angles}")

    @classmethod
    def of(cls, workspace: Workspace, camera_hz: float = 30.0) -> "Limits":
        """The limits of a rig file's [workspace]. camera_hz: rate of the camera's images"""
        standard, silent_s, frozen_s = cls(), workspace.camera_silent_s, workspace.arm_frozen_s
        return cls(
            soft_force_n=workspace.soft_stop_n,
            hard_force_n=workspace.hard_stop_n,
            speed_m_s=2.0 * workspace.travel_speed_m_s,
            # an arm whose states may come late is seen behind what was commanded while it turns
            tilt_deg=max(standard.tilt_deg, 0.6 * standard.turn_deg_s * workspace.arm_silent_s),
            arm_box=workspace.arm_box,
            collision_nm=workspace.collision_nm,
            low_m=workspace.low_m,
            high_m=workspace.high_m,
            camera_period_s=1.0 / camera_hz,
            camera_periods=standard.camera_periods if silent_s is None else silent_s * camera_hz,
            force_silent_s=workspace.force_silent_s,
            arm_silent_s=workspace.arm_silent_s,
            arm_frozen_s=max(standard.arm_frozen_s, 1.2 * workspace.arm_silent_s) if frozen_s is None else frozen_s,
        )


SafetyDecision = Decision[Fault]

SPEED_OVER_NS = 40_000_000
"""Time between two poses from which speed is computed: four control periods. Speed is measured over this time: over
less, the resolution of the reported joints looks like speed; over more, a fast arm is noticed later."""
APPROACH_DEG_S = 0.5
"""A joint that moves slower than this towards its limit is at rest."""
LATE_NS = 20_000_000
"""A judgement this long after the last one, two control periods, was late (`LatchingSupervisor`)."""
TIP_DECAY = 0.995
"""Share of a force on the tip that explains joint torques still at a reading 1 ms later: torques are read in turn, up
to 0.2 s after (`reading.TURN_NS`)."""


class Supervisor(LatchingSupervisor[Fault]):
    """The rules of an arm with a force sensor at its tip, and perhaps a camera; `judge` once in each control period."""

    def __init__(
        self,
        limits: Limits,
        now_ns: int,
        T_ee_center: FloatArray | None = None,
        chain: Chain | None = None,
        *,
        by_hand: bool = False,
        clearance: ArmClearance | None = None,
    ) -> None:
        """T_ee_center: (4, 4) the tip's centre in the frame of the arm's end; default: the arm's end itself
        chain: whose joints have limits; None = none
        clearance: clearance of the chain from table and itself; None = it is not watched
        by_hand: a person places the arm, which then is at once where they say: it has no speed, and turns as it should

        axes_frozen_s, to be set: (3,) as `Limits.force_frozen_s`, of each axis of the force sensor; None = unknown, and
        only all of them together are checked"""
        super().__init__(Fault.NONE, LATE_NS)
        self.limits = limits
        self._T_ee_center = np.eye(4) if T_ee_center is None else T_ee_center
        self._chain, self._by_hand, self._clearance = chain, by_hand, clearance
        self._collisions = None if chain is None else CollisionWatch(chain, self._T_ee_center)
        self._refused = 0
        self._torques = False  # whether the arm has reported any
        self._currents, self._motors = CurrentWatch(), False
        self.axes_frozen_s: FloatArray | None = None
        self.start(now_ns)

    @property
    def sees_torques(self) -> bool:
        """Whether the arm has reported joint torques, which show a collision."""
        return self._torques

    @property
    def sees_collisions(self) -> bool:
        """Whether the arm has reported joint torques or motor currents."""
        return self._torques or self._motors

    def start(self, now_ns: int) -> None:
        super().start(now_ns)
        self._force_ns = self._arm_ns = now_ns
        self._pattern: object = None
        self._pattern_ns = now_ns
        self._axes_n, self._axes_ns = np.full(3, np.nan), np.full(3, now_ns)
        self._tip_n = 0.0
        self._unusable: deque[int] = deque()
        self._refusals: deque[int] = deque()
        self._recount = True
        self._joints: tuple[float, ...] = ()
        self._unmoved_m, self._unmoved_ns = 0.0, 0
        self._track: deque[ArmSample] = deque()
        self._clear_m = -math.inf, -math.inf, -math.inf  # the first is compared with nothing
        self._clear_deg: FloatArray = np.zeros(1)
        if self._collisions is not None:
            self._collisions.start()
        self._currents.start()
        self._commanded_ns = now_ns
        self._camera_needed = False
        self._camera_ns = now_ns
        self._picture: object = None
        self._repeats = 0

    def judge(
        self,
        seen: RobotObservation,
        *,
        commanded_m_s: float = 0.0,
        commanded_rotation: FloatArray | None = None,
        camera_needed: bool = False,
    ) -> SafetyDecision:
        """The present demand.

        commanded_m_s: the requested speed since the last call; commanded_rotation: (3, 3) commanded rotation of the
        arm's end in the base frame, None = any; camera_needed: its pictures are needed now, so that it must be neither
        silent nor frozen"""
        self._begin(seen.now_ns)
        found = [
            *(
                (Action.STOP, Fault.LINK, f"the link to the {name} is down: {reason}")
                for name, reason in seen.lost_links
                if name != "camera" or camera_needed
            ),
            *self._forces(seen.forces, seen.now_ns),
            *self._wire(seen),
            *self._arm(seen.arms, seen.now_ns, commanded_m_s, commanded_rotation),
            *self._camera(seen.pictures, seen.now_ns, camera_needed),
        ]
        return self._latch(found, seen.now_ns)

    # What it looks at ------------------------------------------------------------------------------------------------

    def _forces(self, forces: tuple[ForceSample, ...], now_ns: int) -> list[Alarm[Fault]]:
        limits, found = self.limits, []
        for sample in forces:
            self._force_ns = sample.time_ns
            if sample.pattern is None or sample.pattern != self._pattern:
                self._pattern, self._pattern_ns = sample.pattern, sample.time_ns
            live = sample.sensor_n != self._axes_n
            self._axes_ns[live | (sample.sensor_n == 0.0) if limits.axes_rest else live] = sample.time_ns
            self._axes_n = sample.sensor_n
            magnitude_n = math.hypot(*sample.force_n)
            if not math.isfinite(magnitude_n):
                found.append((Action.STOP, Fault.FORCE_INVALID, f"a force of {sample.force_n.tolist()} N"))
                continue
            self._tip_n = max(magnitude_n, TIP_DECAY * self._tip_n)
            if not sample.usable:
                self._unusable.append(sample.time_ns)
            if magnitude_n > limits.hard_force_n:
                found.append((Action.STOP, Fault.FORCE_HARD, f"{magnitude_n:.1f} N, limit {limits.hard_force_n:g} N"))
            elif magnitude_n > limits.soft_force_n:
                why = f"{magnitude_n:.1f} N, limit {limits.soft_force_n:g} N"
                found.append((Action.BACK_OFF, Fault.FORCE_SOFT, why))
        if age_s := self._silent_s(self._force_ns, limits.force_silent_s):
            found.append((Action.STOP, Fault.FORCE_SILENT, f"no force for {age_s * 1e3:.0f} ms"))
        elif (same_s := (self._force_ns - self._pattern_ns) / 1e9) > limits.force_frozen_s:
            found.append((Action.STOP, Fault.FORCE_FROZEN, f"the same force for {same_s * 1e3:.0f} ms"))
        elif self.axes_frozen_s is not None:
            axes_s = (self._force_ns - self._axes_ns) / 1e9
            stuck = np.flatnonzero(axes_s > np.maximum(limits.force_frozen_s, self.axes_frozen_s))
            where = (
                ["on finger 0", "on finger 1", "on finger 2"] if limits.axes_rest else ["along x", "along y", "along z"]
            )
            found += [
                (Action.STOP, Fault.FORCE_FROZEN, f"the same force {where[axis]} for {axes_s[axis] * 1e3:.0f} ms")
                for axis in stuck
            ]
        if _count_since(self._unusable, now_ns - round(limits.window_s * 1e9)) >= limits.unusable:
            found.append((Action.STOP, Fault.FORCE_UNUSABLE, f"{len(self._unusable)} readings that are not usable"))
        return found

    def _wire(self, seen: RobotObservation) -> list[Alarm[Fault]]:
        if self._recount:
            self._refused, self._recount = seen.refused, False
        self._refusals.extend([seen.now_ns] * (seen.refused - self._refused))
        self._refused = seen.refused
        if _count_since(self._refusals, seen.now_ns - round(self.limits.window_s * 1e9)) >= self.limits.refused:
            return [(Action.STOP, Fault.CHECKSUMS, f"{len(self._refusals)} damaged frames from the force sensor")]
        return []

    def _arm(
        self, arms: tuple[ArmSample, ...], now_ns: int, commanded_m_s: float, commanded_rotation: FloatArray | None
    ) -> list[Alarm[Fault]]:
        limits, found = self.limits, []
        if commanded_m_s > 0.0:
            self._unmoved_m += commanded_m_s * (now_ns - self._commanded_ns) / 1e9
            self._unmoved_ns += now_ns - self._commanded_ns
        self._commanded_ns = now_ns
        for sample in arms:
            self._arm_ns = sample.time_ns
            if not np.all(np.isfinite(sample.T_base_ee)) or not np.all(np.isfinite(sample.joints_deg)):
                found.append((Action.STOP, Fault.ARM_INVALID, f"joints {sample.joints_deg}"))
                continue
            if sample.joints_deg != self._joints:
                self._joints, self._unmoved_m, self._unmoved_ns = sample.joints_deg, 0.0, 0
            if sample.fifo_count > limits.fifo:
                found.append((Action.STOP, Fault.ARM_FIFO, f"{sample.fifo_count} points wait in the arm"))
            found += self._motion(sample)
            found += self._collision(sample)
            if commanded_rotation is not None and not self._by_hand:
                found += self._tilt(sample, commanded_rotation)
        if age_s := self._silent_s(self._arm_ns, limits.arm_silent_s):
            found.append((Action.STOP, Fault.ARM_SILENT, f"no state of the arm for {age_s * 1e3:.0f} ms"))
        if self._unmoved_m > limits.arm_frozen_m and self._unmoved_ns >= limits.arm_frozen_s * 1e9:
            why = f"its joints report no motion while commands moved {self._unmoved_m * 1e3:.1f} mm"
            found.append((Action.STOP, Fault.ARM_FROZEN, why))
        return found

    def _collision(self, sample: ArmSample) -> list[Alarm[Fault]]:
        limit_nm, torques_nm = self.limits.collision_nm, sample.torques_nm
        if limit_nm > 0 and (sample.currents or self._motors):
            self._motors = True
            if not sample.currents:
                return [(Action.STOP, Fault.TORQUES, "no motor currents any more, which collisions are detected by")]
            why = self._currents.look(sample.currents, sample.joints_deg, self._tip_n, sample.time_ns)
            return [(Action.STOP, Fault.COLLISION, why)] if why else []
        if self._collisions is None or limit_nm == 0 or not (torques_nm or self._torques):
            return []
        self._torques = True
        if not torques_nm or not np.all(np.isfinite(torques_nm)):
            return [(Action.STOP, Fault.TORQUES, f"torques {torques_nm}, which collisions are detected by")]
        why = self._collisions.look(torques_nm, sample.joints_deg, self._tip_n, limit_nm, sample.time_ns)
        return [(Action.STOP, Fault.COLLISION, why)] if why else []

    def _motion(self, sample: ArmSample) -> list[Alarm[Fault]]:
        """Speed and box of the tip's centre in the base frame, the rate of turning, and joints that approach a limit.
        All come from the difference of poses over SPEED_OVER_NS, as reported velocities are not reliable."""
        limits, found = self.limits, []
        self._track.append(sample)
        while len(self._track) > 2 and sample.time_ns - self._track[1].time_ns >= SPEED_OVER_NS:
            self._track.popleft()
        before = sample if self._by_hand else self._track[0]
        span_s = (sample.time_ns - before.time_ns) / 1e9
        center_m, before_m = ((one.T_base_ee @ self._T_ee_center)[:3, 3] for one in (sample, before))
        velocity_m_s = (center_m - before_m) / span_s if span_s > 0 else np.zeros(3)
        if span_s >= SPEED_OVER_NS / 2e9:
            speed_m_s = float(np.linalg.norm(velocity_m_s))
            if speed_m_s > limits.speed_m_s:
                found.append((Action.STOP, Fault.ARM_SPEED, f"{speed_m_s:.3f} m/s, limit {limits.speed_m_s:g} m/s"))
            turn_deg_s = _angle_deg(before.T_base_ee, sample.T_base_ee) / span_s
            if turn_deg_s > limits.turn_deg_s:
                found.append(
                    (Action.STOP, Fault.ARM_TURN, f"{turn_deg_s:.0f} deg/s, limit {limits.turn_deg_s:g} deg/s")
                )
            joints_deg = np.array(sample.joints_deg)
            rates_deg_s = (joints_deg - np.array(before.joints_deg)) / span_s
            found += self._joint_limits(joints_deg, rates_deg_s) + self._clear(joints_deg, rates_deg_s)
        if limits.low_m is not None and limits.high_m is not None:
            ahead_m = center_m + limits.look_ahead_s * velocity_m_s
            low_m, high_m = np.array(limits.low_m), np.array(limits.high_m)
            leaving = ((ahead_m < low_m) & (ahead_m <= center_m)) | ((ahead_m > high_m) & (ahead_m >= center_m))
            if np.any(leaving):
                axis = "xyz"[int(np.argmax(leaving))]
                where = np.array2string(center_m, precision=3)
                found.append((Action.STOP, Fault.WORKSPACE, f"the tip at {where} m (base), leaving along {axis}"))
        return found

    def _joint_limits(self, joints_deg: FloatArray, rates_deg_s: FloatArray) -> list[Alarm[Fault]]:
        if (chain := self._chain) is None:
            return []
        margin_deg, ahead_s = self.limits.joint_margin_deg, self.limits.look_ahead_s
        left_deg = np.where(rates_deg_s > 0, chain.upper_deg - joints_deg, joints_deg - chain.lower_deg)
        left_deg = left_deg - ahead_s * np.abs(rates_deg_s)
        nearing = (np.abs(rates_deg_s) > APPROACH_DEG_S) & (left_deg < margin_deg)
        return [
            (
                Action.STOP,
                Fault.JOINT_LIMIT,
                f"joint {joint + 1} at {joints_deg[joint]:.1f} deg turns at {rates_deg_s[joint]:.1f} deg/s towards its "
                f"limit, margin {margin_deg:g} deg",
            )
            for joint in np.flatnonzero(nearing)
        ]

    def _clear(self, joints_deg: FloatArray, rates_deg_s: FloatArray) -> list[Alarm[Fault]]:
        """Whether elbow and wrist near the table or the edge of the arm's box, or the arm nears itself: below a limit
        `look_ahead_s` from now, and nearer than at the last call."""
        if self._chain is None or self._clearance is None or not rates_deg_s.any():
            return []
        clearance, limits = self._clearance, self.limits
        ahead_deg = joints_deg + limits.look_ahead_s * rates_deg_s
        limits_m = limits.table_m, limits.itself_m, 0.0
        nearer_m = 2.0 * clearance.reach_m * math.radians(float(np.abs(ahead_deg - self._clear_deg).sum()))
        if all(was_m - nearer_m > limit_m for was_m, limit_m in zip(self._clear_m, limits_m, strict=True)):
            return []  # no part can have come so near since
        links = self._chain.forward(ahead_deg[None])[0]  # of several, so that the present pose stays the latest one
        inside_m = clearance.in_box_m(links, limits.arm_box)
        then_m, self._clear_m = self._clear_m, (clearance.over_table_m(links), clearance.to_itself_m(links), inside_m)
        self._clear_deg = ahead_deg
        what = (
            (Fault.TABLE, "elbow or wrist above the table"),
            (Fault.ITSELF, "between two parts of the arm"),
            (Fault.ARM_BOX, "elbow, wrist or stick inside the arm's box"),
        )
        return [
            (Action.STOP, fault, f"{100 * now_m:.1f} cm {words} and nearing, limit {100 * limit_m:g} cm")
            for (fault, words), now_m, was_m, limit_m in zip(what, self._clear_m, then_m, limits_m, strict=True)
            if now_m < min(limit_m, was_m)
        ]

    def _tilt(self, sample: ArmSample, commanded: FloatArray) -> list[Alarm[Fault]]:
        tilt_deg = _angle_deg(commanded, sample.T_base_ee)
        if tilt_deg <= self.limits.tilt_deg:
            return []
        why = f"{tilt_deg:.1f} deg from the command, limit {self.limits.tilt_deg:g} deg"
        return [(Action.STOP, Fault.TILT, why)]

    def _camera(self, pictures: tuple[CameraSample, ...], now_ns: int, needed: bool) -> list[Alarm[Fault]]:
        limits = self.limits
        if needed and not self._camera_needed:
            self._camera_ns = max(self._camera_ns, now_ns)  # its age counts from when it matters
        self._camera_needed = needed
        for picture in pictures:
            self._camera_ns = picture.time_ns
            same = picture.pattern is not None and picture.pattern == self._picture
            self._repeats = self._repeats + 1 if same else 0
            self._picture = picture.pattern
        if not needed:
            return []
        if self._repeats >= limits.camera_repeats:
            return [(Action.STOP, Fault.CAMERA_FROZEN, f"the same picture {self._repeats + 1} times")]
        if age_s := self._silent_s(self._camera_ns, limits.camera_periods * limits.camera_period_s):
            return [(Action.STOP, Fault.CAMERA_SILENT, f"no picture for {age_s * 1e3:.0f} ms")]
        return []


def _angle_deg(one: FloatArray, other: FloatArray) -> float:
    """Between the rotations of two transforms or rotation matrices [deg]."""
    cosine = 0.5 * (float(np.vdot(one[:3, :3], other[:3, :3])) - 1.0)  # by the trace of one^T other
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


def _count_since(times_ns: deque[int], since_ns: int) -> int:
    while times_ns and times_ns[0] < since_ns:
        times_ns.popleft()
    return len(times_ns)
