"""A moving KUKA whose answers end: motion of its flange afterwards, by the reason and by the controller's HOLDON.

On the host's clock, through the arm's own process and UDP; each run draws cycle, lag, acceleration and moment."""

import contextlib
import os
import signal
import time
from dataclasses import dataclass
from enum import StrEnum
from itertools import product

import numpy as np

from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.errors import DeviceError, SettingsRefused
from deformscope_drivers.kuka import Kuka, KukaConfig, KukaDouble, UdpWire
from deformscope_drivers.kuka.port import free_port
from deformscope_drivers.wires import LOOPBACK

RATES = JointVelocity((8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
FARTHEST_M = 2e-3
AFTER_S = 1.5
"""Longer than the hundred cycles of 12 ms after which RSI ends."""
LAGS_S, ACCELERATIONS_DEG_S2 = (0.0, 0.004), (1000.0, 4000.0)
"""Delays and accelerations of the axes, from which those of a run are drawn. Chosen: no KUKA was measured."""


class Silence(StrEnum):
    """Reason for the end of a moving arm's answers."""

    CABLE = "cable pulled"
    SIGSTOP = "SIGSTOP of the arm's process"
    SIGKILL = "SIGKILL of the arm's process"
    CLOSE = "close()"
    HALT = "halt() and close()"


SILENCES = tuple(product((0, 1), Silence))
"""HOLDON, and what ends the answers."""


@dataclass(frozen=True, slots=True)
class SilentRun:
    """refused: opening refused the controller; moved_m: motion of the flange, after the answers were ended or, where it
    was refused, at most while it was opened; moved_later: it moved on after RSI must have ended; error: why it could
    not be tried, such as a machine too busy to answer"""

    seed: int
    holdon: int
    silence: Silence
    cycle_s: float
    refused: bool
    moved_m: float
    moved_later: bool
    error: str = ""

    @property
    def kind(self) -> str:
        """As a row of a table has it."""
        return f"HOLDON {self.holdon}: {self.silence}"

    @property
    def in_time(self) -> bool:
        """Refused if the controller holds corrections; else it stops within FARTHEST_M."""
        return (
            not self.error and self.refused == bool(self.holdon) and self.moved_m <= FARTHEST_M and not self.moved_later
        )


class _Cable(KukaDouble):
    """A controller whose cable can be disconnected: it continues without receiving or sending."""

    pulled = False

    def receive(self, data: bytes, now_ns: int) -> None:
        if not self.pulled:
            super().receive(data, now_ns)

    def due(self, now_ns: int) -> bytes:
        return super().due(now_ns)[: 0 if self.pulled else None]


def run_silent(seed: int) -> SilentRun:
    """The run that a seed stands for, all of SILENCES in turn."""
    holdon, silence = SILENCES[seed % len(SILENCES)]
    random = np.random.default_rng([seed, 0x5C])
    cycle_s = float(random.choice([0.004, 0.012]))
    lag_s, acceleration_deg_s2 = random.uniform(*LAGS_S), random.uniform(*ACCELERATIONS_DEG_S2)
    double = _Cable(
        again_s=0.1,  # RSI may end before the arm's process is there to answer
        holdon=holdon,
        cycle_s=cycle_s,
        lag_s=lag_s,
        acceleration_deg_s2=acceleration_deg_s2,
    )
    port = free_port()
    arm = HostedArm(Kuka, KukaConfig(address=LOOPBACK, port=port, cycle_s=cycle_s), reconnect=None)
    with UdpWire(double, port):
        before_m, refused, error = _place_m(double), False, ""
        try:
            arm.open()
            arm.set_velocity(RATES, 30.0)
            time.sleep(random.uniform(0.2, 0.4))
            before_m = _place_m(double)
            _end(arm, double, silence)
        except SettingsRefused:
            refused = True
        except DeviceError as other:
            error = str(other)
        time.sleep(AFTER_S)
        after_m = _place_m(double)
        time.sleep(AFTER_S / 5)
        later = float(np.linalg.norm(_place_m(double) - after_m)) > 1e-6
    if arm.process_id is not None:
        os.kill(arm.process_id, signal.SIGKILL)  # one that was stopped would not end
    with contextlib.suppress(DeviceError):
        arm.close()
    moved_m = float(np.linalg.norm(after_m - before_m))
    return SilentRun(seed, holdon, silence, cycle_s, refused, moved_m, later, error)


def _place_m(double: KukaDouble) -> FloatArray:
    return double.chain.end_effector(double.joints_at(monotonic_ns()))[:3, 3]


def _end(arm: HostedArm, double: _Cable, silence: Silence) -> None:
    """End the answers."""
    match silence:
        case Silence.CABLE:
            double.pulled = True
        case Silence.CLOSE | Silence.HALT:
            if silence is Silence.HALT:
                arm.halt("the end")
            arm.close()
        case Silence.SIGSTOP | Silence.SIGKILL:
            assert arm.process_id is not None
            os.kill(arm.process_id, signal.SIGSTOP if silence is Silence.SIGSTOP else signal.SIGKILL)
