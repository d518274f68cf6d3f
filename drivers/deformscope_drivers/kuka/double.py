"""A KUKA controller with its arm, simulated: RSI's datagrams in each cycle, and its response to the answers.

Like a controller, it accepts an answer only within its cycle and with its IPOC, and counts missing answers. It ends RSI
after too many missing answers, or for a correction that would turn an axis faster or further than its limits. A missing
answer is a correction of zero, or the last one again (HOLDON). Relative corrections add up, absolute ones count from
where RSI began. The behaviour of HOLDON and of both modes is from kuka_experimental (ros_rsi_ethernet.xml, pull request
119), not from a real controller. It has neither port nor thread (`deformscope_drivers.doubles.Double`)."""

import math
import threading
from collections import deque

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm.kinematics import Chain, FloatArray, cross, euler_xyz_from_rotation, jacobian_of
from deformscope_drivers.errors import ProtocolViolation
from deformscope_drivers.kuka.config import CHAINS
from deformscope_drivers.kuka.messages import RobMessage, decode_sen, encode_rob

UNIT_NM = np.array([2.0, 2.0, 1.5, 0.5, 0.5, 0.3])
"""Torque at each axis for one unit of current; all numbers are assumed, of the order of a small six-axis arm."""
MASSES_KG = ((3, 14.0), (5, 5.0), (6, 2.0))
"""Masses at the frames of links."""
COULOMB_NM = np.array([12.0, 15.0, 10.0, 4.0, 3.0, 2.0])
TURNS_DEG_S = 0.02
"""Width of the axis' rate over which friction changes its sign [deg/s]."""
VISCOUS_NM_S_DEG = 0.05
RIPPLE_NM, RIPPLE_DEG = 0.5, 3.6
NOISE_NM = 0.8
_GRAVITY = np.array([0.0, 0.0, -9.81])


def motor_currents(
    chain: Chain, joints_deg: FloatArray, rates_deg_s: FloatArray, wrench: npt.ArrayLike, random: np.random.Generator
) -> FloatArray:
    """(6,) in the units of the controller, of axes at (6,) that turn at (6,), with (6,) on the flange [N, Nm]."""
    links = chain.forward(joints_deg)
    held_nm = -jacobian_of(links).T @ np.asarray(wrench, dtype=float)
    for link, mass_kg in MASSES_KG:
        levers_m = links[link, :3, 3] - links[:link, :3, 3]
        held_nm[:link] -= mass_kg * (cross(links[:link, :3, 2], levers_m) @ _GRAVITY)
    held_nm += COULOMB_NM * np.tanh(rates_deg_s / TURNS_DEG_S) + VISCOUS_NM_S_DEG * rates_deg_s
    held_nm += RIPPLE_NM * np.sin(2 * np.pi * joints_deg / RIPPLE_DEG) + random.normal(0.0, NOISE_NM, 6)
    return np.asarray(held_nm / UNIT_NM)


MOST_MISSED = 100
"""Timeout of kuka_experimental's RSI context: missing answers in a row after which RSI ends."""
WAITING = 64
"""Datagrams that a network keeps for a host that does not read."""
FIRST_IPOC = 4_208_163_634


class KukaDouble:
    """Attributes that a simulation reads: missed: answers in a row that did not come; ended: why RSI ended, empty while
    it runs; corrections: answers that were taken; and sets: sends_currents: those of its motors (DEF_MACur); running:
    it sends at all; frozen: it reports the angles of before, whatever its axes do"""

    def __init__(
        self,
        model: str = "kr6r900sixx",
        *,
        start_deg: npt.ArrayLike | None = None,
        cycle_s: float = 0.012,
        T_base_tool_offset_m: float = 0.0,
        again_s: float | None = None,
        holdon: int | tuple[int, ...] = 0,
        absolute: bool = False,
        timeout: int = MOST_MISSED,
        lag_s: float = 0.0,
        acceleration_deg_s2: float = math.inf,
    ) -> None:
        """start_deg: (6,) where the axes are (default: upright, flange down); T_base_tool_offset_m: a $TOOL that is set
        in the controller reaches so far beyond the flange [m]; again_s: time after RSI's end at which a person restarts
        its program, None = never

        holdon: HOLDON of the corrections, of all or (6,): 1 repeats the last one where an answer is missing; absolute:
        RSI_ON(#ABSOLUTE); timeout: missing answers in a row after which RSI ends, and the axes brake
        lag_s: time constant with which the axes follow their commands, in addition to one cycle; acceleration_deg_s2:
        of every axis at most
        """
        self.chain = CHAINS[model]
        self.missed = self.corrections = 0
        self.ended = ""
        self.running = True
        self._start_deg: FloatArray = np.array(self.chain.home_deg if start_deg is None else start_deg, dtype=float)
        self._joints_deg, self._setpoint_deg = self._start_deg.copy(), self._start_deg.copy()
        self._begin_deg = self._start_deg
        self._cycle_ns = round(cycle_s * 1e9)
        self._offset_m = T_base_tool_offset_m
        self._again_ns = None if again_s is None else round(again_s * 1e9)
        self._holdon = np.broadcast_to(holdon, self._start_deg.shape).astype(bool)
        self._absolute, self._timeout = absolute, timeout
        self._lag_s, self._acceleration_deg_s2 = lag_s, acceleration_deg_s2
        self._held_deg, self._rates_deg_s = np.zeros_like(self._start_deg), np.zeros_like(self._start_deg)
        self._ipoc = FIRST_IPOC
        self._answer: FloatArray | None = None
        self._next_ns: int | None = None  # its program is started as somebody first listens
        self._waiting: deque[bytes] = deque(maxlen=WAITING)
        self._lock = threading.Lock()
        self.sends_currents = self.frozen = False
        self._reported_deg, self._wrench = self._start_deg, np.zeros(6)
        self._random = np.random.default_rng(0xCA)

    # For who runs the simulation -------------------------------------------------------------------------------------

    @property
    def joints_deg(self) -> FloatArray:
        """(6,) where the axes are [deg]."""
        with self._lock:
            return self._joints_deg.copy()

    def joints_at(self, now_ns: int) -> FloatArray:
        """(6,) angles of the axes within a cycle [deg]; `joints_deg` has those at its beginning."""
        with self._lock:
            self._live(now_ns)
            began_ns = (now_ns if self._next_ns is None else self._next_ns) - self._cycle_ns
            share = np.clip((now_ns - began_ns) / self._cycle_ns, 0.0, 1.0)
            return np.asarray(self._joints_deg + share * self._rates_deg_s * self._cycle_ns / 1e9)

    @property
    def T_base_links(self) -> FloatArray:
        """(7, 4, 4) of the axes and the flange [m]."""
        return self.chain.forward(self.joints_deg)

    @property
    def T_base_end_effector(self) -> FloatArray:
        """(4, 4) where the flange is [m]."""
        return np.asarray(self.T_base_links[-1])

    def push(self, wrench: npt.ArrayLike) -> None:
        """A push changes the motors' currents, no angles. wrench: (6,) on the flange, in the base frame [N, Nm]"""
        self._wrench = np.array(wrench, dtype=float)

    # The wire --------------------------------------------------------------------------------------------------------

    def power_up(self, now_ns: int) -> None:
        """A person restarts its program; the arm has not moved."""
        with self._lock:
            self._start(now_ns)

    def _start(self, now_ns: int) -> None:
        self.missed, self.ended, self._answer = 0, "", None
        self._begin_deg, self._setpoint_deg = self._joints_deg.copy(), self._joints_deg.copy()
        self._held_deg = np.zeros_like(self._held_deg)
        self._waiting.clear()
        self._next_ns = now_ns

    def receive(self, data: bytes, now_ns: int) -> None:
        with self._lock:
            self._live(now_ns)
            try:
                answer = decode_sen(data)
            except ProtocolViolation:
                return
            if answer.ipoc == self._ipoc:
                self._answer = np.array(answer.corrections_deg)

    def due(self, now_ns: int) -> bytes:
        with self._lock:
            self._live(now_ns)
            return self._waiting.popleft() if self._waiting else b""

    def next_ns(self, now_ns: int) -> int | None:
        with self._lock:
            if self._waiting:
                return now_ns
            if self.ended and self._again_ns is not None and self._next_ns is not None:
                return self._next_ns + self._again_ns
            return self._next_ns if self.running and self._moves else None

    @property
    def _moves(self) -> bool:
        """RSI runs, or the axes still brake after its end."""
        return not self.ended or bool(np.any(self._rates_deg_s))

    def _live(self, now_ns: int) -> None:
        """Compute the controller's cycles up to now_ns [ns]."""
        if self._next_ns is None or not self.running:
            self._next_ns = now_ns
        if self.ended and self._again_ns is not None and now_ns >= self._next_ns + self._again_ns:
            self._start(now_ns)
        while self.running and self._moves and self._next_ns <= now_ns:
            # the axes move all the way, or as lag and acceleration let them
            target_deg, cycle_s = self._joints_deg if self.ended else self._setpoint_deg, self._cycle_ns / 1e9
            gap_deg = target_deg - self._joints_deg
            most_deg_s = self._acceleration_deg_s2 * cycle_s
            wanted_deg_s = gap_deg / (cycle_s + self._lag_s)
            change_deg_s = np.clip(wanted_deg_s - self._rates_deg_s, -most_deg_s, most_deg_s)
            self._rates_deg_s = self._rates_deg_s + change_deg_s
            arrives = np.abs(self._rates_deg_s * cycle_s - gap_deg) < 1e-9
            self._joints_deg = np.where(arrives, target_deg, self._joints_deg + self._rates_deg_s * cycle_s)
            if not self.ended:
                self._cycle()
            self._next_ns += self._cycle_ns

    def _cycle(self) -> None:
        """The end of one cycle, and the begin of the next."""
        taken_deg, self._answer = self._answer, None
        if taken_deg is None:  # a missing answer: HOLDON decides
            self.missed += 1
            taken_deg = np.where(self._holdon, self._held_deg, 0.0)
        else:
            self.missed = 0
            self.corrections += bool(np.any(taken_deg))
            self._held_deg = taken_deg
        before_deg = self._setpoint_deg
        self._setpoint_deg = (self._begin_deg if self._absolute else before_deg) + taken_deg
        step_deg = np.abs(self._setpoint_deg - before_deg)
        if self.missed > self._timeout:
            self.ended = f"{self.missed} answers in a row were late"
        elif np.any(step_deg > self.chain.velocity_deg_s * self._cycle_ns / 1e9):
            self.ended = f"a correction by {step_deg.max():.3f} deg in a cycle"
        elif not self.chain.within_limits(self._setpoint_deg):
            self.ended = f"axes at {np.round(self._setpoint_deg, 2).tolist()} deg"
        if self.ended:
            return
        self._ipoc += round(self._cycle_ns / 1e6)
        pose = self.chain.forward(self._joints_deg)[-1]
        place_mm = 1e3 * (pose[:3, 3] + self._offset_m * pose[:3, 2])
        c, b, a = -np.degrees(euler_xyz_from_rotation(pose[:3, :3].T))  # Rz(A) Ry(B) Rx(C)
        joints_deg = self._reported_deg if self.frozen else self._joints_deg
        currents = tuple[float, ...]()
        if self.sends_currents:
            rates_deg_s = (joints_deg - self._reported_deg) / (1e-9 * self._cycle_ns)
            currents = tuple(motor_currents(self.chain, joints_deg, rates_deg_s, self._wrench, self._random))
        said = RobMessage(
            tuple(joints_deg), self._ipoc, (*place_mm, a, b, c), tuple(self._start_deg), self.missed, currents
        )
        self._reported_deg = joints_deg
        self._waiting.append(encode_rob(said))
