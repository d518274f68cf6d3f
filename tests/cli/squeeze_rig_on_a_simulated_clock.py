"""A rig file squeezed on a simulated clock: the same command, hand and drivers as on the host's, but nothing runs by
itself, so that every run is the same on any machine."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from deformscope.lab.container_view import camera_pose
from deformscope.lab.live_squeeze_lab import ContainerCase, ContainerTruth, SqueezeLab
from deformscope.rig.rig_file import RigDevice
from deformscope_drivers.device import Device


class SimulatedSqueezeRig:
    """In place of `LiveSqueezeLab`: the same container, in this thread and on a clock of its own.

    at_contact: called once the wall is pressed"""

    runs_itself = False

    def __init__(self, case: ContainerCase, camera_hz: float) -> None:
        self.camera_hz = camera_hz
        self.lab = SqueezeLab(case, camera_hz)
        self.clock, self.intrinsics = self.lab.clock, self.lab.view.intrinsics
        self.T_hand_camera = camera_pose()
        self.at_contact: Callable[[], None] | None = None
        self.later: list[tuple[int, Callable[[], None]]] = []

    @contextlib.contextmanager
    def devices(self, entries: Sequence[RigDevice]) -> Iterator[dict[str, Device[Any]]]:
        made = {"sdh": self.lab.hand, "dsa": self.lab.pads, "depth_camera": self.lab.camera}
        yield {entry.name: made[entry.driver.name] for entry in entries}

    def opener(self) -> None:
        self.lab.open()

    def truth(self) -> ContainerTruth:
        return self.lab.truth()

    def wait_until(self, until_ns: int) -> None:
        self.lab.wait_until(until_ns)
        if self.at_contact is not None and self.lab.simulated.world.force_n.any():
            happens, self.at_contact = self.at_contact, None
            happens()
        while self.later and self.later[0][0] <= self.clock():
            self.later.pop(0)[1]()

    def closing_deg_s(self) -> float:
        """How fast the fingers close."""
        axes = self.lab.simulated.hand.motion.axes
        return float(np.max([axes[axis].velocity_deg_s for axis in (1, 5)]))

    def limits_a(self) -> tuple[float, ...]:
        """Of the motor currents, as the hand has them."""
        return tuple(axis.move_current_a for axis in self.lab.simulated.hand.motion.axes)


def use_simulated_squeeze_rigs(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[SimulatedSqueezeRig], None] = lambda rig: None
) -> list[SimulatedSqueezeRig]:
    """From now on the container between a rig's doubles is in this thread, on a clock of its own; those made, in order.

    change: called with each before it is opened"""
    made: list[SimulatedSqueezeRig] = []

    def make(case: ContainerCase, camera_hz: float) -> SimulatedSqueezeRig:
        made.append(SimulatedSqueezeRig(case, camera_hz))
        change(made[-1])
        return made[-1]

    monkeypatch.setattr("deformscope.lab.live_squeeze_lab.LiveSqueezeLab", make)
    return made
