"""Another operator of the robot: doubles that move without a command of deformscope."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator

from deformscope_drivers.jaco import JacoDouble
from deformscope_drivers.jaco.structures import TrajectoryPoint
from deformscope_drivers.sdh.double import Port, SdhDouble

CYCLE_S = 0.01
ANGULAR_VELOCITY = 8
SWINGS = ((12.0, 9.0), (8.0, 7.0), (-9.0, 6.0), (6.0, 5.0), (-8.0, 4.0), (14.0, 3.0))
"""For each joint: the greatest rate [deg/s] and the period [s]; each swings to and fro and goes nowhere."""


@contextlib.contextmanager
def moved_by_hand(arm: JacoDouble) -> Iterator[Callable[[], None]]:
    """Swing the arm's joints to and fro until the end of the context, as a joystick would: one point every 10 ms.
    Yields the reason if the motion ended earlier."""
    ended = threading.Event()

    def move() -> None:
        send = arm.function("SendBasicTrajectory")
        start = time.monotonic()
        for cycle in range(1 << 62):
            due = start + cycle * CYCLE_S
            if ended.wait(max(due - time.monotonic(), 0.0)):
                return
            time_s = cycle * CYCLE_S
            point = TrajectoryPoint()
            point.Position.Type = ANGULAR_VELOCITY
            for number, (rate_deg_s, period_s) in enumerate(SWINGS, start=1):
                rate = rate_deg_s * math.cos(2 * math.pi * time_s / period_s)
                setattr(point.Position.Actuators, f"Actuator{number}", rate)
            send(point)

    mover = threading.Thread(target=move, name="operator", daemon=True)
    mover.start()

    def let_go() -> None:
        ended.set()
        mover.join()

    try:
        yield let_go
    finally:
        let_go()


GRASP_PERIOD_NS = 4_000_000_000
OPEN_DEG = (0.0, -30.0, 10.0, -30.0, 10.0, -30.0, 10.0)
CLOSED_DEG = (0.0, 5.0, 40.0, 5.0, 40.0, 5.0, 40.0)
GRASP_DEG_S = 40.0


class GraspingHand(SdhDouble):
    """A hand that another operator closes and opens, every 4 s in turn."""

    def __init__(self, port: Port) -> None:
        super().__init__(port)
        self._turn_ns: int | None = None
        self._closes = True

    def due(self, now_ns: int) -> bytes:
        sent = super().due(now_ns)
        if self._turn_ns is None or now_ns >= self._turn_ns:
            self._turn_ns = now_ns + GRASP_PERIOD_NS
            for axis in range(len(OPEN_DEG)):
                self.motion.power(axis, True)
            self.motion.advance(now_ns)
            self.motion.start(CLOSED_DEG if self._closes else OPEN_DEG, [GRASP_DEG_S] * len(OPEN_DEG))
            self._closes = not self._closes
        return sent
