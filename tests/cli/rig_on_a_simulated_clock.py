"""A rig file explored on a simulated clock: the same command, robot and drivers as on the host's, but nothing runs by
itself, so that every run is the same on any machine."""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from deformscope.lab.arms import arm_in_lab
from deformscope.lab.depth_view import DepthView
from deformscope.lab.live_lab import CAMERA, LayerWorld, start_places_m
from deformscope.lab.randomized_rig import BoardPicture, RandomizedRig
from deformscope.lab.scenes import Scene
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import RigDevice
from deformscope.robot.by_hand import Person
from deformscope.robot.description import AS_CAPSULES, RobotDescription, arm_shape
from deformscope.robot.placement import Placement
from deformscope.robot.setup import Setup, Truth, rig_setup
from deformscope_drivers.arm.wrench import ArmWrenchConfig
from deformscope_drivers.depth_camera import View
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig
from deformscope_drivers.device import Device
from deformscope_drivers.interface import ArmBody
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.optoforce import OptoforceConfig
from deformscope_drivers.optoforce.double import OMD_20_SE_40N


class SimulatedTable:
    """In place of `LiveLab`: the same table, in this thread and on `clock`."""

    runs_itself = False

    def __init__(
        self,
        clock: SimulatedClock,
        scene: Scene,
        placement: Placement,
        arm: RigDevice,
        *,
        T_surface_camera: npt.NDArray[np.floating] | None = None,
        randomized: RandomizedRig | None = None,
        described: RobotDescription = AS_CAPSULES,
    ) -> None:
        self._described = described
        if randomized is not None:
            placement, T_surface_camera = randomized.placement, randomized.T_surface_camera
        self.clock, self._placement, self._randomized = clock, placement, randomized
        self._board, self._picture = False, BoardPicture()
        self.size_m, self.truth = scene.size_m, Truth(scene.regions)
        self.view = DepthView(scene, CAMERA, T_surface_camera)
        self._world = LayerWorld(scene, placement.tool.radius_m)
        self._arm = arm_in_lab(arm.driver.name, arm.config, placement, start_places_m(scene), clock, scene.seed)
        self.lab: TouchLab

    @property
    def person(self) -> Person | None:
        return self._arm.person

    @property
    def max_force_n(self) -> float:
        return self.lab.contact.max_force_n

    @contextlib.contextmanager
    def devices(self, entries: Sequence[RigDevice]) -> Iterator[dict[str, Device[Any]]]:
        configs = {entry.driver.kind: entry.config for entry in entries}
        own = configs["wrench"] if isinstance(configs["wrench"], ArmWrenchConfig) else None
        given = configs["wrench"] if own is None else OptoforceConfig()
        force_config = dataclasses.replace(given, port="simulated", sensitivity=OMD_20_SE_40N)
        camera_config = SyntheticDepthConfig(
            rate_hz=configs["depth"].fps, missing=0.02, intrinsics=self.view.intrinsics
        )
        self.lab = TouchLab(
            self._world,
            self.clock,
            tool=self._placement.tool,
            T_base_surface=self._placement.T_base_surface,
            view=self._see,
            camera_config=camera_config,
            arm=self._arm,
            force_config=force_config,
            own_wrench=own,
            sensed=None if self._randomized is None else self._randomized.sensed,
        )
        made = {"arm": self.lab.arm, "wrench": self.lab.force, "depth": self.lab.camera}
        yield {entry.name: made[entry.driver.kind] for entry in entries}

    @property
    def body(self) -> ArmBody:
        return self._arm.body

    def push_tip(self, force_n: npt.NDArray[np.floating]) -> None:
        self.lab.contact.finger_n = np.asarray(force_n, np.float64)

    def show_board(self, there: bool) -> None:
        self._board = there

    @property
    def T_surface_camera(self) -> npt.NDArray[np.float64]:
        return np.asarray(self.view.T_world_camera, np.float64)

    def wait_until(self, until_ns: int) -> None:
        self.lab.wait_until(until_ns)

    def opener(self) -> None:
        """As `TouchLab.open`, but the force sensor's zero is left to who explores."""
        for device in (self.lab.force, self.lab.arm, self.lab.camera):
            if device is not None:
                device.open(own_thread=False)

    def _see(self, time_s: float) -> View:
        moved = self._world.displaced_m(self.view.places_m) if self._world.pressed[2] > 0.0 else None
        links, center = self.lab.body.T_base_links, self.lab.contact.center_m
        capsules = arm_shape(self._placement, links, center, description=self._described)
        exact = self.view.render(moved, capsules, self._described.solids(self._placement, links))
        if self._board and self._randomized is not None:
            T_surface_board = self._placement.T_surface_base @ links[-1] @ self._randomized.T_ee_board
            T_camera_board = np.linalg.inv(self.view.T_world_camera) @ T_surface_board
            self._picture.put_into(exact.color, self.view.intrinsics, T_camera_board)
        return View(exact.depth_m, exact.color)


def use_a_simulated_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on a rig's doubles over a table run in this thread, on a clock of their own."""
    monkeypatch.setattr("deformscope.lab.live_lab.LiveLab", partial(SimulatedTable, SimulatedClock(1_000_000_000)))


def count_as_real(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> None:
    """From now on a rig's doubles are treated as real devices, calibrated unless the changes say otherwise."""
    changes = {"calibrated": {"all": True}} | changes

    def made(*arguments: Any) -> Setup:
        return dataclasses.replace(rig_setup(*arguments), simulated=False, **changes)

    monkeypatch.setattr("deformscope.robot.setup.rig_setup", made)
