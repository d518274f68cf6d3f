"""A simulated arm in cycles of 10 ms: the effect of the points that its controller receives.

As in the protocol reference, the arm has a FIFO of 2000 trajectory points. One velocity point is used in each cycle:
points sent faster accumulate, and the arm continues to move after the sender has stopped. Cartesian velocities are
ignored without a report after motion by joints, and all Cartesian motion until the arm was homed (kinova-ros issues 62,
148, 269). There are joint ranges and speeds, and fingers that open. Control must be started; its first start after a
cold boot may be ignored. If the real arm's behaviour is not published, the simplest one is modelled and marked. Joints
follow at once unless they have greatest accelerations: there is no inertia."""

from collections import deque

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.jaco import structures

CYCLE_S = 0.01
FIFO_SIZE = 2000
FINGER_SPEED = 5000.0  # units/s; not published
HOME_SPEED_DEG_S = 20.0
AT_HOME_DEG = 0.5


class SimulatedArm:
    """The arm's state, and `cycle` that carries it 10 ms on.

    wrench: (6,) what pushes the end effector [N, Nm] in the base frame; torque_bias_nm: (n,) what the joints' torque
    sensors show too much; cycles: number of cycles so far. All attributes may be set between cycles.
    lag: the next rates, one for each cycle, by which the arm follows its commands late
    acceleration_deg_s2: largest acceleration of each joint at the start and end of a motion
    link_push: a link, from 0, and the force on its far end (3,) [N] in the base frame, None = nothing pushes one
    closed: boxes (3,), (3,) in the base frame [m] that the hand does not enter by Cartesian motions; motions by joints
    may enter
    gravity_left, torque_noise_nm: share of gravity's torques that its model leaves in those without gravity; deviation
    homed: it was at home since it was switched on; cartesian: it executes Cartesian velocities"""

    def __init__(self, chain: Chain, start_deg: npt.ArrayLike | None, cold_boot: bool) -> None:
        """start_deg: (n,) first angles of the arm (default: home); cold_boot: the first `start_control` is ignored"""
        self.chain = chain
        self.joints_deg: FloatArray = chain.clip(chain.home_deg if start_deg is None else start_deg)
        self.rates_deg_s: FloatArray = np.zeros(chain.joint_count)
        self.links: FloatArray = chain.forward(self.joints_deg)
        self.fingers: FloatArray = np.zeros(structures.FINGER_COUNT)
        self.fingers_ready = False
        self.fifo: deque[structures.TrajectoryPoint] = deque()
        self.wrench: FloatArray = np.zeros(6)
        self.torque_bias_nm: FloatArray = np.zeros(chain.joint_count)
        self.control = False
        self.lag: deque[FloatArray] = deque()
        self.acceleration_deg_s2 = np.inf
        self.link_push: tuple[int, FloatArray] | None = None
        self.closed: tuple[tuple[FloatArray, FloatArray], ...] = ()
        self.gravity_left = self.torque_noise_nm = 0.0
        self._random = np.random.default_rng(0x70)
        self.homed = self.cartesian = not cold_boot
        self._cold = cold_boot
        self._homing = False
        self._opening = False
        self.cycles = 0

    # Commands ------------------------------------------------------------------------------------------------------

    def start_control(self) -> None:
        """Take points from here on; a cold arm ignores this once."""
        self.control = self.control or not self._cold
        self._cold = False

    def stop_control(self) -> None:
        """Accept no more points; waiting ones remain."""
        self.control = False
        self._homing = self._opening = False

    def queue(self, point: structures.TrajectoryPoint) -> bool:
        """Append a point to the FIFO; False if it is full. Without control the point is ignored."""
        if not self.control:
            return True
        if len(self.fifo) >= FIFO_SIZE:
            return False
        self._homing = self._opening = False
        self.fifo.append(point)
        return True

    def erase(self) -> None:
        """Forget all points, and stop."""
        self.fifo.clear()
        self._homing = self._opening = False

    def go_home(self) -> None:
        """Set out for the home pose, joint by joint."""
        self.erase()
        self._homing = True

    def open_fingers(self) -> None:
        """Open all fingers, after which they are referenced."""
        self._opening = True

    def power_up(self, cold_boot: bool) -> None:
        """Start as after switching on: nothing is left to do, control is off, the joints stay where they are."""
        self.erase()
        self.control = self.fingers_ready = self.homed = self.cartesian = False
        self._cold = cold_boot

    @property
    def retract(self) -> structures.RetractType:
        """The state that the arm reports of its home pose: not initialized, on its way, at home, or elsewhere."""
        if self._homing:
            return structures.RetractType.NORMAL_TO_READY
        if not self.homed:
            return structures.RetractType.NOT_INITIALIZED
        at_home = bool(np.abs(self.joints_deg - self.chain.home_deg).max() < AT_HOME_DEG)
        return structures.RetractType.READY_STANDBY if at_home else structures.RetractType.NORMAL_STANDBY

    # The cycle -------------------------------------------------------------------------------------------------------

    @property
    def at_rest(self) -> bool:
        """Whether the next cycle would change nothing."""
        busy = self.control and (self.fifo or self._homing or self._opening)
        return not busy and not np.any(self.rates_deg_s) and not any(map(np.any, self.lag))

    def cycle(self) -> None:
        """10 ms of the arm's own loop."""
        rates = np.zeros(self.chain.joint_count)
        if self.control:
            if self._homing:
                left_deg = self.chain.home_deg - self.joints_deg
                rates = np.clip(left_deg / CYCLE_S, -HOME_SPEED_DEG_S, HOME_SPEED_DEG_S)
                self._homing = bool(np.any(rates))
                if not self._homing:
                    self.homed = self.cartesian = True
            elif self.fifo:
                rates = self._follow(self.fifo.popleft())
            if self._opening:
                self.fingers = np.maximum(self.fingers - FINGER_SPEED * CYCLE_S, 0.0)
                self._opening = bool(np.any(self.fingers))
                self.fingers_ready = not self._opening
        if self.lag:
            self.lag.append(rates)
            rates = self.lag.popleft()
        if np.isfinite(self.acceleration_deg_s2):
            most = self.acceleration_deg_s2 * CYCLE_S
            rates = self.rates_deg_s + np.clip(rates - self.rates_deg_s, -most, most)
        self._turn(rates)

    def _follow(self, point: structures.TrajectoryPoint) -> FloatArray:
        """Joint rates (n,) [deg/s] that a point asks for."""
        position = point.Position
        rates = np.zeros(self.chain.joint_count)
        kind = position.Type
        if kind == structures.PositionType.ANGULAR_VELOCITY:
            self.cartesian = False  # until it goes home: kinova-ros issue 269
            asked = np.array(structures.actuator_values(position.Actuators, self.chain.joint_count))
            rates = np.clip(asked, -self.chain.velocity_deg_s, self.chain.velocity_deg_s)
        elif kind == structures.PositionType.CARTESIAN_VELOCITY and self.cartesian:  # else ignored, without a word
            twist = np.array(structures.cartesian_values(position.CartesianPosition))
            twist[3:] = self.links[-1, :3, :3] @ twist[3:]  # a point's rotation is in the end effector's frame
            rates = self._outside_zones(self._rates_of(twist))
        return rates

    def _rates_of(self, twist: FloatArray) -> FloatArray:
        """Joint rates (n,) [deg/s] of a twist (6,) [m/s, rad/s] in the base frame, slowed alike where one is too fast.

        How the arm itself behaves near singularities is not public; here the pseudo-inverse is damped."""
        if not np.any(twist):
            return np.zeros(self.chain.joint_count)
        rates = np.degrees(kinematics.damped_joint_rates(kinematics.jacobian_of(self.links), twist))
        fastest = float(np.max(np.abs(rates) / self.chain.velocity_deg_s))
        return rates / max(1.0, fastest)

    def _outside_zones(self, rates_deg_s: FloatArray) -> FloatArray:
        """The same, or none where they would bring the hand into a zone."""
        if self.closed:
            hand_m = self.chain.end_effector(self.joints_deg + rates_deg_s * CYCLE_S)[:3, 3]
            if any(np.all((low_m < hand_m) & (hand_m < high_m)) for low_m, high_m in self.closed):
                return np.zeros(self.chain.joint_count)
        return rates_deg_s

    def _turn(self, rates_deg_s: FloatArray) -> None:
        """Turn the joints for one cycle; a joint at the end of its range stops there."""
        if not np.any(rates_deg_s):
            self.rates_deg_s = rates_deg_s
            return
        before = self.joints_deg
        self.joints_deg = self.chain.clip(before + rates_deg_s * CYCLE_S)
        self.rates_deg_s = (self.joints_deg - before) / CYCLE_S
        self.links = self.chain.forward(self.joints_deg)

    # What its sensors show -------------------------------------------------------------------------------------------

    def external_torque_nm(self) -> FloatArray:
        """Torques of the joints' sensors without gravity, (n,) [Nm]."""
        torque: FloatArray = np.array(self.torque_bias_nm)
        if np.any(self.wrench):
            torque += kinematics.jacobian_of(self.links).T @ self.wrench
        if self.link_push is not None:
            link, force_n = self.link_push
            levers_m = self.links[link + 1, :3, 3] - self.links[: link + 1, :3, 3]
            torque[: link + 1] += np.cross(self.links[: link + 1, :3, 2], levers_m) @ force_n
        if self.gravity_left:
            torque += self.gravity_left * self.chain.gravity_torque_nm(self.links)
        if self.torque_noise_nm:
            torque += self._random.normal(0.0, self.torque_noise_nm, len(torque))
        return torque

    def torque_nm(self) -> FloatArray:
        """Readings of the joints' sensors, gravity included, (n,) [Nm]."""
        return self.external_torque_nm() + self.chain.gravity_torque_nm(self.links)

    def measured_wrench(self) -> FloatArray:
        """The arm's wrench from its joints' sensors, (6,) [N, Nm]: their bias appears as a push.

        The arm's sign is not verified: here the force is that of the world on the end effector."""
        if not np.any(self.torque_bias_nm):
            return self.wrench
        ghost: FloatArray = np.linalg.pinv(kinematics.jacobian_of(self.links).T, rcond=1e-2) @ self.torque_bias_nm
        return self.wrench + ghost

    def shown_rates_deg_s(self) -> FloatArray:
        """The firmware's output for the joints' rates (n,) [deg/s]: half of them, 181 to 360 for negative ones
        (kinova-ros `kinova_comm.cpp`, getJointVelocities; `kinova_arm.cpp`), and not near zero at rest (issue 366)."""
        noise = 1.5 * np.sin(7.3 * np.arange(self.chain.joint_count) + 0.41 * self.cycles)
        return np.asarray((0.5 * self.rates_deg_s + noise) % 360.0)

    def currents_a(self) -> FloatArray:
        """About 0.1 A a joint at rest and 1 A for each 20 Nm, (n,) [A]: plausible, not measured."""
        return 0.1 + np.abs(self.torque_nm()) / 20.0
