"""Devices for a squeeze, not yet opened: a hand, its tactile arrays, a depth camera and perhaps the arm that carries
the hand; real ones or doubles. A laboratory passes its setup."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.rig.rig_file import Rig, RigDevice
from deformscope.rig.sections import ContainerSection, HandSection, SqueezeSection
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.placement import Placement
from deformscope.robot.placing import PlacingSetup, hand_tool
from deformscope.robot.robot import Waits, sleep_until
from deformscope.robot.setup import CAMERA_HZ, CameraView, SimulatedDevices, only_device, open_rig
from deformscope.robot.squeeze_plan import GripShape, RandomGrasp, draw_grasp
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.images import Intrinsics


@dataclass(frozen=True, slots=True)
class SqueezeNames:
    """Names of the devices; camera, arm: empty without one."""

    hand: str
    tactile: str
    camera: str = ""
    arm: str = ""


class TrueMoments(Protocol):
    """True moments of a squeeze in a laboratory, on its clock: first contact, and the fingers' rest, or None."""

    @property
    def contact_ns(self) -> int | None: ...

    @property
    def steady_ns(self) -> int | None: ...


class SimulatedContainer(SimulatedDevices, Protocol):
    """A container (`deformscope.lab.live_squeeze_lab.LiveSqueezeLab`).

    T_hand_camera: (4, 4) camera to hand [m]; intrinsics, camera_hz: intrinsics and frame rate of that camera"""

    @property
    def intrinsics(self) -> Intrinsics: ...

    @property
    def camera_hz(self) -> float: ...

    @property
    def T_hand_camera(self) -> FloatArray:
        """(4, 4) [m]."""

    def truth(self) -> TrueMoments:
        """The simulated truth, up to now."""


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeParts:
    """Devices of a rig file by their parts; camera, arm: None without one.

    grasp: grasp that was drawn from the seed"""

    rig: Rig
    hand: RigDevice
    tactile: RigDevice
    camera: RigDevice | None
    arm: RigDevice | None
    grasp: RandomGrasp

    @classmethod
    def of(cls, rig: Rig, seed: int, place: str = "person") -> "SqueezeParts":
        """place: an arm's driver, or `person`. Raises InputError, which names missing or contradictory keys."""
        cameras = any(entry.driver.kind == "depth" for entry in rig.devices)
        carried, use = rig.hand.T_arm_hand is not None, "to squeeze with"
        parts = cls(
            rig,
            only_device(rig, "hand", use),
            only_device(rig, "tactile", use, rig.hand.tactile),
            only_device(rig, "depth", use) if cameras else None,
            only_device(rig, "arm", "for [hand] T_arm_hand", driver="" if place == "person" else place)
            if carried or place != "person"
            else None,
            draw_grasp(rig.container, rig.squeeze, seed),
        )
        together = [entry for entry in (parts.hand, parts.tactile, parts.camera, parts.arm) if entry is not None]
        if place != "person":
            if parts.hand.double:
                came = "doubles of a rig file, which no arm carries"
                raise InputError("real devices for --place, or lab:containers", came, "--place person", rig.name)
            if lacks := lacks_to_place(rig):
                expected = "for --place: " + ", ".join(lacks)
                raise InputError(expected, "none", "deformscope doctor RIG lists them", rig.name)
        if len({entry.double for entry in together}) > 1:
            expected = f"{', '.join(entry.name for entry in together)} all real or all doubled"
            doubled = ", ".join(entry.name for entry in together if entry.double)
            raise InputError(expected, f"{doubled} doubled", "double = true in each of their sections", rig.name)
        return parts

    @property
    def simulated(self) -> bool:
        """Whether all devices are doubles."""
        return self.hand.double

    @property
    def around(self) -> list[RigDevice]:
        """The hand, its arrays and the camera, around which the container is simulated."""
        return [entry for entry in (self.hand, self.tactile, self.camera) if entry is not None]


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeSetup:
    """The hand, and the container.

    open_source: opens all devices
    camera: how the depth camera projects; T_camera_hand: (4, 4) hand to camera [m], None = unknown, so that images give
    no features; T_arm_hand: (4, 4) hand to the end of the arm that carries it, None = no arm
    T_arm_camera: (4, 4) camera to the arm's base
    grasp: the hand's place on the container; placed: the hand is already at the container
    simulated: all devices are simulated; runs_itself: the devices have separate threads and the host's clock
    truth: true values of a simulated squeeze, None with real devices
    placing: the arm that places the hand; None = a person does, or the hand is already there"""

    names: SqueezeNames
    hand: HandSection
    container: ContainerSection
    squeeze: SqueezeSection
    camera: CameraView
    open_source: Callable[[], AbstractContextManager[RigSource]]
    grasp: RandomGrasp
    T_camera_hand: FloatArray | None = None
    T_arm_hand: FloatArray | None = None
    T_arm_camera: FloatArray | None = None
    placed: bool = False
    simulated: bool = False
    runs_itself: bool = True
    truth: Callable[[], TrueMoments] | None = None
    placing: PlacingSetup | None = None
    clock: Clock = monotonic_ns
    wait_until: Waits = sleep_until


def squeeze_setup(
    parts: SqueezeParts,
    double: Callable[[RigDevice], AbstractContextManager[RigMember]],
    container: SimulatedContainer | None = None,
    place: str = "person",
) -> SqueezeSetup:
    """All devices of a rig file.

    double: makes a device of the rig, or its double, without a simulated container; container: simulated
    container between the doubles, with the hand at it; it gives the pose and projection of its camera
    place: as in `SqueezeParts.of`"""
    rig, seen = parts.rig, parts.rig.camera
    arm, camera = parts.arm, parts.camera
    setup = SqueezeSetup(
        names=SqueezeNames(
            parts.hand.name,
            parts.tactile.name,
            "" if camera is None else camera.name,
            "" if arm is None or container is not None else arm.name,
        ),
        hand=rig.hand,
        container=rig.container,
        squeeze=rig.squeeze,
        camera=CameraView(
            seen.focal_px,
            seen.center_px,
            seen.distortion,
            rate_hz=float((None if camera is None else camera.config.fps) or CAMERA_HZ),
        ),
        open_source=partial(open_rig, rig, double, container, parts.around),
        grasp=parts.grasp,
        T_camera_hand=_transform(rig.hand.T_camera_hand),
    )
    if container is None:
        poses = _transform(rig.hand.T_arm_hand), _transform(seen.T_arm_camera)
        setup = replace(setup, T_arm_hand=poses[0], T_arm_camera=poses[1])
        return replace(setup, placing=placing_of(parts)) if place != "person" else setup
    lens = container.intrinsics
    return replace(
        setup,
        camera=CameraView((lens.fx_px, lens.fy_px), (lens.cx_px, lens.cy_px), rate_hz=container.camera_hz),
        T_camera_hand=np.asarray(np.linalg.inv(container.T_hand_camera)),
        placed=True,
        simulated=True,
        runs_itself=container.runs_itself,
        truth=container.truth,
        clock=container.clock,
        wait_until=container.wait_until,
    )


def lacks_to_place(rig: Rig) -> list[str]:
    """Keys that a rig file lacks for an arm that places the hand."""
    has = {
        "[hand] T_arm_hand": rig.hand.T_arm_hand,
        "[camera] T_arm_camera": rig.camera.T_arm_camera,
        "[camera] focal_px and center_px": rig.camera.focal_px and rig.camera.center_px,
        "[surface] T_arm_surface": rig.surface.T_arm_surface,
        "[workspace] low_m and high_m": rig.workspace.low_m,
        "[container] shape box or cylinder": rig.container.shape != "mesh",
    }
    return [name for name, there in has.items() if not there]


def placing_of(parts: SqueezeParts) -> PlacingSetup:
    """The arm of a rig that places its hand. Raises InputError for an arm with unknown joints."""
    rig, arm = parts.rig, parts.arm
    chain = None if arm is None else arm.driver.chain(arm.config)
    T_arm_hand, T_base_table = _transform(rig.hand.T_arm_hand), _transform(rig.surface.T_arm_surface)
    if chain is None or T_arm_hand is None or T_base_table is None:
        raise InputError("an arm with joints that are known, for --place", "none", "--place person", rig.name)
    tool = hand_tool(T_arm_hand, GripShape.of(rig.container, rig.squeeze))
    return PlacingSetup(
        chain, Placement(np.asarray(T_base_table, np.float64), tool), rig.workspace, dict(rig.calibrated.ages())
    )


def _transform(rows: tuple[tuple[float, ...], ...] | None) -> FloatArray | None:
    return None if rows is None else np.array(rows, np.float64)
