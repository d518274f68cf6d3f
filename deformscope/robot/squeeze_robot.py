"""A hand and its tactile arrays with one control period, watched by a supervisor: pre-shape, close, hold, open.

The same code runs on real devices, which have threads, and in a simulated laboratory; only `wait_until` differs."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.rig.sections import HandSection, SqueezeSection
from deformscope.robot.robot import Waits, taken
from deformscope.robot.squeeze_plan import CLOSING_AXES, GripShape
from deformscope.robot.squeeze_supervisor import SqueezeDecision, SqueezeFault, SqueezeObservation, SqueezeSupervisor
from deformscope_drivers.clock import Clock
from deformscope_drivers.dsa import Dsa
from deformscope_drivers.dsa.pads import Pad, Part
from deformscope_drivers.errors import DeviceError, LinkLost, NoReply, NotConnected
from deformscope_drivers.health import Link
from deformscope_drivers.sdh import Sdh
from deformscope_drivers.sdh.codes import AXIS_COUNT, MOVING
from deformscope_drivers.sdh.device import CurrentMode
from deformscope_drivers.sdh.results import HandReading

SQUEEZE_PERIOD_NS = 20_000_000
"""A control period: on RS-232 it leaves enough time to read the hand's angles and set its velocity."""
KEEP_S = 0.1
"""Time within which a velocity must be set again, else the hand's driver sets it to 0: five control periods."""
RAMP_DEG_S2 = 400.0
"""Acceleration of the closing axes: the largest that Schunk's library accepts. With it, axes at 6 deg/s rest within 15
ms of a stop; with the hand's default of 100 deg/s2 within 60 ms."""
PRESHAPE_DEG_S = 40.0
"""Speed of the fastest axis; nothing is between the fingers. It is the default of Schunk's library."""
MISSED_DEG = 2.0
"""An axis that ends this far from its pre-shape has hit something: four times the precision of its angles."""
SETTLE_READINGS = 13
"""A hand may report the states from before a command for half a second (IPA): 13 readings at 25 Hz."""
PRESHAPE_MARGIN_S = 4.0
"""Time in addition to the hand's planned duration, or to 15 s if old firmware does not report one."""
OLD_FIRMWARE_S = 15.0
"""Duration of a move with old firmware: the whole range of an axis at 12 deg/s."""
STOP_TRIES, STOP_EVERY_S = 15, 0.1
"""Attempts to stop the hand or to restore its limits, and the pause between them while its link is down: the driver
looks for a lost one after 0.05 s, then less often."""


@dataclass(frozen=True, slots=True)
class FingertipFrame:
    """One tactile frame of the two squeezing fingertips. time_ns: arrival; sums: (2,) sums of each fingertip's texels;
    peak: highest texel of both [counts]; texels: (rows, columns) counts of each"""

    time_ns: int
    sums: FloatArray
    peak: int
    texels: tuple[IntArray, ...]


class SqueezeStopped(Exception):
    """The supervisor has stopped the hand. verdict: why"""

    def __init__(self, verdict: SqueezeDecision) -> None:
        super().__init__(f"the hand was stopped: {verdict.fault}: {verdict.reason}")
        self.verdict = verdict


class SqueezeRobot:
    """Opened devices and a supervisor; `cycle` is one control period.

    hand_readings, tactile_frames: items of the last period, oldest first; on_cycle: called in every period, before it
    is judged: the observer may request a stop"""

    def __init__(
        self,
        hand: Sdh,
        tactile: Dsa,
        section: HandSection,
        squeeze: SqueezeSection,
        shape: GripShape,
        *,
        clock: Clock,
        wait_until: Waits,
        on_cycle: Callable[[], None] = lambda: None,
    ) -> None:
        self.hand, self.tactile = hand, tactile
        self.squeeze, self.shape = squeeze, shape
        self.hand_readings: tuple[HandReading, ...] = ()
        self.tactile_frames: tuple[FingertipFrame, ...] = ()
        self._clock, self._wait_until, self._on_cycle = clock, wait_until, on_cycle
        self._fingers = section.fingers
        self._matrices = [Pad(finger, Part.DISTAL).matrix for finger in section.fingers]
        self._hands: Any = hand.readings()
        self._frames: Any = tactile.readings()
        self._limits_a: tuple[float, ...] | None = None
        self._next_ns = clock()
        self._commanded = self._ramped = False
        self.supervisor = SqueezeSupervisor(squeeze, section.fingers, clock())

    # The control period ----------------------------------------------------------------------------------------------

    def start(self) -> None:
        """After a pause without control periods: drop waiting items of the queues; ages count from now on."""
        taken(self._hands)
        taken(self._frames)
        self._next_ns = self._clock()
        self.supervisor.start(self._clock())

    def cycle(self, closing_deg_s: float | None = None) -> None:
        """Close at a speed (None = unchanged), let a control period pass, read the devices, and have them judged.

        Raises SqueezeStopped, after the hand was stopped, if it must stop."""
        if closing_deg_s is not None:
            velocity = [0.0] * AXIS_COUNT
            for axis in CLOSING_AXES:
                velocity[axis] = closing_deg_s
            ramp = None if self._ramped else RAMP_DEG_S2
            self.command(lambda: self.hand.drive(velocity, keep_s=KEEP_S, acceleration_deg_s2=ramp))
            self._ramped = True
        now_ns = self._clock()
        self._next_ns = max(self._next_ns + SQUEEZE_PERIOD_NS, now_ns + SQUEEZE_PERIOD_NS // 2)
        self._wait_until(self._next_ns)
        seen = self._look()
        self._on_cycle()
        verdict = self.supervisor.judge(seen)
        if verdict.fault is not SqueezeFault.NONE:
            self.halt()
            raise SqueezeStopped(verdict)

    def stand_by(self, duration_s: float) -> None:
        """Let time pass, whether or not the hand was stopped, so that a recording shows the time after."""
        until_ns = self._clock() + round(duration_s * 1e9)
        while (now_ns := self._clock()) < until_ns:
            self._wait_until(min(now_ns + SQUEEZE_PERIOD_NS, until_ns))
            self._look()
            self._on_cycle()

    def ask_to_stop(self, reason: str) -> None:
        """Stop on a person's request, within this control period or the next one."""
        self.supervisor.stop(SqueezeFault.ASKED, reason, self._clock())

    def fail(self, fault: SqueezeFault, reason: str) -> None:
        """Stop the hand for a reason that is not in its readings. Raises SqueezeStopped."""
        self.supervisor.stop(fault, reason, self._clock())
        self.halt()
        raise SqueezeStopped(self.supervisor.verdict)

    def halt(self) -> bool:
        """Stop the hand; returns whether it confirmed that, or was never commanded."""
        return not self._commanded or self._insist(self.hand.stop)

    # Commands --------------------------------------------------------------------------------------------------------

    def preshape(self) -> None:
        """Open the fingers, turn them towards each other, park the thumb. Raises SqueezeStopped."""
        self.command(lambda: self._move(self.shape.open_deg))

    def release(self) -> None:
        """Open the fingers after a stop, so that they do not press on. Raises SqueezeStopped if they do not open."""
        self.supervisor = SqueezeSupervisor(self.squeeze, self._fingers, self._clock(), closing=False)
        self.preshape()

    @contextlib.contextmanager
    def low_current(self) -> Iterator[None]:
        """Limit the current of the closing axes while the block runs; the earlier limits are restored after it."""

        def limit() -> None:
            self._limits_a = self.hand.current_limits_a(CurrentMode.MOVE)
            lower = list(self._limits_a)
            for axis in CLOSING_AXES:
                lower[axis] = min(self.squeeze.current_a, lower[axis])
            self.hand.set_current_limits(lower, CurrentMode.MOVE)

        self.command(limit)
        try:
            yield
        finally:
            self.halt()
            self.restore()

    def restore(self) -> bool:
        """Restore the current limits from before `low_current`; returns whether that worked."""
        limits_a = self._limits_a
        if limits_a is None or not self._insist(lambda: self.hand.set_current_limits(limits_a, CurrentMode.MOVE)):
            return limits_a is None
        self._limits_a = None
        return True

    def command(self, send: Callable[[], None]) -> None:
        """Send a command to the hand. Raises SqueezeStopped if the hand refuses it, or its link is down."""
        self._commanded = True
        try:
            send()
        except DeviceError as error:
            lost = self.hand.link is not Link.CONNECTED or isinstance(error, LinkLost | NoReply | NotConnected)
            self.fail(SqueezeFault.HAND_LOST if lost else SqueezeFault.REFUSED, " ".join(str(error).split()))

    def _insist(self, send: Callable[[], object]) -> bool:
        """Send a command up to STOP_TRIES times, also while the link is down; whether the hand took it."""
        for _ in range(STOP_TRIES):
            with contextlib.suppress(DeviceError):
                send()
                return True
            self._wait_until(self._clock() + round(1e9 * STOP_EVERY_S))
        return False

    def _move(self, target_deg: tuple[float, ...]) -> None:
        self._ramped = False
        started_ns = self._clock()
        planned_s = self.hand.move(target_deg, velocity_deg_s=PRESHAPE_DEG_S, wait=False).duration_s
        until_ns = started_ns + round(1e9 * ((planned_s or OLD_FIRMWARE_S) + PRESHAPE_MARGIN_S))
        self.start()
        still = 0
        while still < SETTLE_READINGS:
            self.cycle()
            for reading in self.hand_readings:
                still = 0 if any(state in MOVING for state in reading.state) else still + 1
            if self._clock() > until_ns:
                self.fail(SqueezeFault.PRESHAPE, f"still moving after {(self._clock() - started_ns) / 1e9:.1f} s")
        reached = self.hand.latest(1.0).position_deg
        off_deg = np.abs(reached - np.array(target_deg))
        if off_deg.max() > MISSED_DEG:
            axis = int(off_deg.argmax())
            reason = f"axis {axis} at {reached[axis]:.1f} deg, not {target_deg[axis]:.1f} deg"
            self.fail(SqueezeFault.PRESHAPE, reason)

    # Within ----------------------------------------------------------------------------------------------------------

    def _look(self) -> SqueezeObservation:
        self.hand_readings = tuple(taken(self._hands))
        frames = []
        for reading in taken(self._frames):
            pads = [reading.pads[matrix].astype(np.int64) for matrix in self._matrices]
            sums = np.array([pad.sum() for pad in pads], np.float64)
            peak = max(int(pad.max()) for pad in pads)
            frames.append(FingertipFrame(reading.stamp.host_ns, sums, peak, tuple(pads)))
        self.tactile_frames = tuple(frames)
        temperatures = [one.temperature_c for one in self.hand_readings if one.temperature_c is not None]
        return SqueezeObservation(
            self._clock(),
            tuple(one.stamp.host_ns for one in self.hand_readings),
            tuple(tuple(map(float, one.position_deg)) for one in self.hand_readings),
            float(temperatures[-1][:AXIS_COUNT].max()) if temperatures else None,
            tuple(one.time_ns for one in self.tactile_frames),
            tuple(one.peak for one in self.tactile_frames),
            tuple(
                (fault, device.health().reason or str(device.link))
                for fault, device in ((SqueezeFault.HAND_LOST, self.hand), (SqueezeFault.TACTILE_LOST, self.tactile))
                if device.link is not Link.CONNECTED
            ),
        )
