"""What deformscope needs of the Jaco's driver."""

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from deformscope_drivers.clock import Clock
from deformscope_drivers.device import Device
from deformscope_drivers.interface import ArmInLab, DeviceDriver, FloatArray, Scene
from deformscope_drivers.jaco.chains import CHAINS
from deformscope_drivers.jaco.config import JacoConfig
from deformscope_drivers.jaco.device import Jaco, open_jaco
from deformscope_drivers.jaco.double import JacoDouble
from deformscope_drivers.jaco.reading import JacoState
from deformscope_drivers.jaco.structures import PositionType, TrajectoryPoint

CYCLE_S = 0.01
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
            point.Position.Type = PositionType.ANGULAR_VELOCITY
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


@contextlib.contextmanager
def _simulated(config: JacoConfig, scene: Scene | None) -> Iterator[Device[Any]]:
    arm = JacoDouble(config.model or "j2n6s300")
    with moved_by_hand(arm) as let_go:

        class Led(Jaco):
            """Whoever leads it lets go of it before it goes home."""

            def home(self, timeout_s: float = 60.0) -> JacoState:
                let_go()
                return super().home(timeout_s)

        yield Led(config, arm)


def _in_lab(config: JacoConfig, start_deg: FloatArray | None, clock: Clock) -> ArmInLab:
    double = JacoDouble(config.model or "j2n6s300", clock, start_deg=start_deg)
    return ArmInLab(Jaco(config, double, clock=clock), double)


DRIVER = DeviceDriver("arm", JacoConfig, open_jaco, simulated=_simulated, chains=lambda: CHAINS, in_lab=_in_lab)
