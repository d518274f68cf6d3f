"""The devices of a rig file as the robot that explores: on the host's clock, real ones or doubles over a simulated
table."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from deformscope.errors import InputError
from deformscope.experiments.explore import ExploreOptions, Truth
from deformscope.experiments.explore_wired import TouchingRobot
from deformscope.lab.live_lab import LiveLab
from deformscope.lab.scenes import Scene, built_in
from deformscope.lab.stand_in import stand_in
from deformscope.lab.touch_lab import T_BASE_SURFACE
from deformscope.rig.rig_file import Rig, RigDevice
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.advice import advice
from deformscope.robot.placement import Placement
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.supervisor import Limits, SafetyVerdict
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.see.cloud import Intrinsics
from deformscope.studies.surface_robot import ARM_DOUBT, ARM_N_PER_M, truth_of
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.jaco.kinematics import FloatArray

ROLES = ("jaco", "optoforce", "depth_camera")
CAMERA_HZ = 30.0
FEWEST_PERIODS = 1.5
"""Of a device's, within which it must tell something: one that comes late is no fault."""


class RigBench:
    """A rig that can explore: one arm, one force sensor at its end and one depth camera, and what else there is.

    scene: of the simulated table, None where the devices are real; truth: what is known of it
    Raises InputError, which names what the rig file lacks. A `Bench`.
    """

    runs_itself = True

    def __init__(self, rig: Rig, options: ExploreOptions) -> None:
        self.rig = rig
        self.clock = monotonic_ns
        self._options = options
        self._roles = {driver: _only(rig, driver) for driver in ROLES}
        force = self._roles["optoforce"]
        if not force.double and not force.config.sensitivities:
            raise InputError("its sensitivity, which tells newtons", "none", "the sensor's report", force.name)
        _check_rates(rig, self._roles)
        self.scene = _scene(rig, list(self._roles.values()), options.seed)
        self.truth: Truth | None = None if self.scene is None else truth_of(self.scene)
        self.size_m: tuple[float, float] = rig.surface.size_m if self.scene is None else self.scene.size_m
        self.placement = Placement(self._from_surface(), rig.tool)
        self.T_surface_camera: FloatArray | None = self._from_camera()
        self._live: LiveLab | None = None
        self._devices: dict[str, Device[Any]] = {}
        if self.scene is not None:
            model = self._roles["jaco"].config.model
            self._live = LiveLab(self.scene, self.placement, T_surface_camera=self.T_surface_camera, model=model)
            self.T_surface_camera = np.asarray(self._live.view.surface_from_camera, np.float64)

    @property
    def simulated(self) -> bool:
        """Whether nothing real moves."""
        return self.scene is not None

    @property
    def max_force_n(self) -> float | None:
        """The largest true contact force so far [N]; None where only the sensor knows."""
        return None if self._live is None else self._live.max_force_n

    @property
    def calibrated(self) -> dict[str, bool]:
        """What must be known of a robot before it moves, and whether it is."""
        rig, simulated = self.rig, self.simulated
        return {
            "[surface] T_arm_surface": simulated or rig.surface.T_arm_surface is not None,
            "[camera] T_arm_camera": simulated or rig.camera.T_arm_camera is not None,
            "[tool] compliance_m_per_n": simulated or rig.tool.compliance_m_per_n is not None,
        }

    @property
    def arm(self) -> ArmCompliance:
        """How the arm gives way, as the rig file says."""
        tool = self.rig.tool
        if tool.compliance_m_per_n is None:
            return ArmCompliance(1.0 / ARM_N_PER_M, ARM_DOUBT / ARM_N_PER_M) if self.simulated else ArmCompliance()
        return ArmCompliance(tool.compliance_m_per_n, tool.compliance_sd)

    @contextlib.contextmanager
    def source(self) -> Iterator[RigSource]:
        """All devices of the rig, open."""
        with contextlib.ExitStack() as stack:
            lab: dict[str, Device[Any]] = {}
            if self._live is not None:
                lab = stack.enter_context(self._live.devices(list(self._roles.values())))
            members = []
            for entry in self.rig.devices:
                if entry.name in lab:
                    device = lab[entry.name]
                elif entry.double:
                    device = stack.enter_context(stand_in(entry.driver.name, entry.config))
                else:
                    device = entry.make()
                members.append(RigMember(entry.name, entry.driver, device, simulated=entry.double))
            self._devices = {member.name: member.device for member in members}
            with RigSource(members, raw=self.rig.record.raw) as source:
                yield source

    @contextlib.contextmanager
    def robot(self, on_cycle: Callable[[], None] | None = None) -> Iterator[TouchingRobot]:
        """The robot over the opened devices. on_cycle: called in every control period"""

        def watch(seen: RobotObservation, verdict: SafetyVerdict) -> None:
            if on_cycle is not None:
                on_cycle()

        arm, force, camera = (self._devices[self._roles[driver].name] for driver in ROLES)
        try:
            force.zero()  # type: ignore[attr-defined]
        except DeviceError as error:
            raise InputError.about(error, f"device {self._roles['optoforce'].name}") from error
        fps = self._roles["depth_camera"].config.fps
        robot = Robot(
            arm,  # type: ignore[arg-type]
            force,  # type: ignore[arg-type]
            self.placement,
            Limits.of(self.rig.workspace, camera_hz=float(fps or (10.0 if self.simulated else CAMERA_HZ))),
            camera=camera,
            watch=watch,
        )
        try:
            while not robot.arm_seen:
                robot.cycle()
        except RobotStopped as stopped:
            verdict = stopped.verdict
            came = f"{verdict.fault}: {verdict.reason}"
            raise InputError(
                "devices that are well", came, f"see to {advice(verdict.fault)}", self.rig.name
            ) from stopped
        with _without_long_pauses():
            yield TouchingRobot(
                robot,
                self.size_m,
                self._options,
                (self._intrinsics(), self.T_surface_camera),
                arm=self.arm,
                clock=self.clock,
                workspace=self.rig.workspace,
                doubt_m=self.rig.camera.doubt_m,
            )

    def _from_surface(self) -> FloatArray:
        given = self.rig.surface.T_arm_surface
        return T_BASE_SURFACE if given is None else np.array(given, dtype=np.float64)

    def _from_camera(self) -> FloatArray | None:
        """T_surface_camera (4, 4), None where the file does not say."""
        given = self.rig.camera.T_arm_camera
        if given is None:
            return None
        return np.asarray(np.linalg.inv(self._from_surface()) @ np.array(given), dtype=np.float64)

    def _intrinsics(self) -> Intrinsics | None:
        """As the rig file says; None = as the camera says itself."""
        camera = self.rig.camera
        if camera.focal_px is None or camera.center_px is None:
            return None
        return Intrinsics(camera.focal_px, camera.center_px, camera.distortion)


@contextlib.contextmanager
def _without_long_pauses() -> Iterator[None]:
    """Keep what was loaded until now out of Python's search for garbage, which would hold all threads up for 0.1 s and
    more, in the middle of a motion."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def options_of(rig: Rig, options: ExploreOptions, set_force_n: float | None) -> ExploreOptions:
    """How to explore, with what the rig file says of the surface and the tip. set_force_n: instead of its
    target_force_n"""
    return dataclasses.replace(
        options,
        set_force_n=rig.workspace.target_force_n if set_force_n is None else set_force_n,
        tip_radius_m=rig.tool.radius_m,
        thickness_m=rig.surface.thickness_m,
    )


def _check_rates(rig: Rig, roles: Mapping[str, RigDevice]) -> None:
    """Each device tells more often than it is missed."""
    workspace = rig.workspace
    for driver, key, silent_s in (
        ("jaco", "state_hz", workspace.arm_silent_s),
        ("optoforce", "rate_hz", workspace.force_silent_s),
        ("depth_camera", "fps", workspace.camera_silent_s),
    ):
        entry = roles[driver]
        hz = getattr(entry.config, key)
        if silent_s is not None and hz is not None and hz * silent_s < FEWEST_PERIODS:
            least = f"{key} of {FEWEST_PERIODS / silent_s:.0f} or more for {entry.name}, missed after {silent_s:g} s"
            raise InputError(least, f"{hz:g}", "a higher rate, or a longer ..._silent_s in [workspace]", rig.name)


def _only(rig: Rig, driver: str) -> RigDevice:
    """The device of a rig that plays a part."""
    found = [entry for entry in rig.devices if entry.driver.name == driver]
    if driver == "depth_camera" and rig.camera.device:
        found = [entry for entry in found if entry.name == rig.camera.device]
    if len(found) != 1:
        came = "none" if not found else ", ".join(entry.name for entry in found)
        raise InputError(f'one device with driver = "{driver}", to explore with', came, "the rig file", rig.name)
    return found[0]


def _scene(rig: Rig, entries: list[RigDevice], seed: int) -> Scene | None:
    """The simulated table that the rig file asks for; None where the devices are real."""
    doubled = [entry.name for entry in entries if entry.double]
    names = ", ".join(entry.name for entry in entries)
    if rig.tool.tip != "sphere":
        raise InputError('[tool] tip = "sphere", to explore with', repr(rig.tool.tip), where=rig.name)
    if not rig.surface.scene:
        if doubled:
            expected = f"{names} all real, or all doubled with a [surface] scene"
            raise InputError(expected, f"{', '.join(doubled)} doubled", 'scene = "two-60-150"', rig.name)
        return None
    if len(doubled) != len(entries):
        real = ", ".join(entry.name for entry in entries if not entry.double)
        raise InputError(f"double = true for {names}, with a [surface] scene", f"{real} real", where=rig.name)
    return built_in(rig.surface.scene, seed)
