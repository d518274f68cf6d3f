"""Devices to squeeze with, closed: a hand, its tactile arrays, a depth camera and perhaps the arm that carries the
hand; real ones or doubles. A laboratory hands its own in."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.rig.rig_file import Rig, RigDevice
from deformscope.rig.source import RigMember, RigSource
from deformscope.rig.squeeze_sections import ContainerSection, HandSection, SqueezeSection
from deformscope.robot.robot import Waits, sleep_until
from deformscope.robot.setup import CAMERA_HZ, CameraView, SimulatedDevices, only_device, open_rig
from deformscope.robot.squeeze_plan import RandomGrasp, draw_grasp
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.depth_camera.image import Intrinsics


@dataclass(frozen=True, slots=True)
class SqueezeNames:
    """Names of the devices; camera, arm: empty where there is none."""

    hand: str
    tactile: str
    camera: str = ""
    arm: str = ""


class TrueMoments(Protocol):
    """What a laboratory knows of a squeeze, on its clock: the first contact, and from when the fingers stood still;
    None = not yet."""

    @property
    def contact_ns(self) -> int | None: ...

    @property
    def steady_ns(self) -> int | None: ...


class SimulatedContainer(SimulatedDevices, Protocol):
    """A container (`deformscope.lab.live_squeeze_lab.LiveSqueezeLab`).

    T_hand_camera: (4, 4) camera to hand [m]; intrinsics, camera_hz: of that camera
    """

    @property
    def intrinsics(self) -> Intrinsics: ...

    @property
    def camera_hz(self) -> float: ...

    @property
    def T_hand_camera(self) -> FloatArray:
        """(4, 4) [m]."""

    def truth(self) -> TrueMoments:
        """What is simulated, up to now."""


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeParts:
    """What plays which part in a rig file; camera, arm: None where there is none.

    grasp: drawn from the seed
    """

    rig: Rig
    hand: RigDevice
    tactile: RigDevice
    camera: RigDevice | None
    arm: RigDevice | None
    grasp: RandomGrasp

    @classmethod
    def of(cls, rig: Rig, seed: int) -> SqueezeParts:
        """Raises InputError, which names what is missing, or what does not go together."""
        cameras = any(entry.driver.kind == "depth" for entry in rig.devices)
        carried, use = rig.hand.T_arm_hand is not None, "to squeeze with"
        parts = cls(
            rig,
            only_device(rig, "hand", use),
            only_device(rig, "tactile", use, rig.hand.tactile),
            only_device(rig, "depth", use) if cameras else None,
            only_device(rig, "arm", "for [hand] T_arm_hand", driver="jaco") if carried else None,
            draw_grasp(rig.container, rig.squeeze, seed),
        )
        together = [entry for entry in (parts.hand, parts.tactile, parts.camera, parts.arm) if entry is not None]
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
        """The hand, its arrays and the camera, which the container is simulated between."""
        return [entry for entry in (self.hand, self.tactile, self.camera) if entry is not None]


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeSetup:
    """What squeezes, and what is squeezed.

    open_source: opens all devices
    camera: how the depth camera projects; T_camera_hand: (4, 4) hand to camera [m], None = not known, so that nothing
    can be learned from images; T_arm_hand: (4, 4) hand to the end of the arm that carries it, None = none carries it
    T_arm_camera: (4, 4) camera to the arm's base
    grasp: where the hand is to stand on the container; placed: it stands there already
    simulated: nothing real moves; runs_itself: the devices have threads of their own and the host's clock
    truth: of a simulated squeeze, None where only the devices can say
    """

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
    clock: Clock = monotonic_ns
    wait_until: Waits = sleep_until


def squeeze_setup(
    parts: SqueezeParts,
    double: Callable[[RigDevice], AbstractContextManager[RigMember]],
    container: SimulatedContainer | None = None,
) -> SqueezeSetup:
    """All devices of a rig file.

    double: makes a device of the rig that no container is simulated around, or its double
    container: between the doubles; the hand stands at it already, and it brings the pose and projection of its camera
    """
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
        return replace(setup, T_arm_hand=poses[0], T_arm_camera=poses[1])
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


def _transform(rows: tuple[tuple[float, ...], ...] | None) -> FloatArray | None:
    return None if rows is None else np.array(rows, np.float64)
