"""Devices to squeeze with, closed: a hand, its tactile arrays, a depth camera and perhaps the arm that carries the
hand; real ones or doubles. A laboratory hands its own in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.rig.rig_file import Rig, RigDevice
from deformscope.rig.source import RigMember, RigSource
from deformscope.rig.squeeze_sections import ContainerSection, HandSection, SqueezeSection
from deformscope.robot.robot import Waits, sleep_until
from deformscope.robot.setup import CAMERA_HZ, CameraView
from deformscope.robot.squeeze_plan import RandomGrasp, draw_grasp
from deformscope_drivers.clock import Clock, monotonic_ns


@dataclass(frozen=True, slots=True)
class SqueezeNames:
    """Names of the devices; camera, arm: empty where there is none."""

    hand: str
    tactile: str
    camera: str = ""
    arm: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeTruth:
    """What a simulated squeeze really was, on the laboratory's clock: first_ns of the first contact, steady_ns from
    when the fingers stood still; 0 = not yet"""

    first_ns: int
    steady_ns: int


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
    truth: Callable[[], SqueezeTruth] | None = None
    clock: Clock = monotonic_ns
    wait_until: Waits = sleep_until


def squeeze_setup(
    rig: Rig, double: Callable[[RigDevice], AbstractContextManager[RigMember]], seed: int
) -> SqueezeSetup:
    """All devices of a rig file. double: makes a device of the rig, or its double

    Raises InputError, which names what is missing.
    """
    hand = _one_of(rig, "sdh", "")
    tactile = _one_of(rig, "dsa", rig.hand.tactile)
    cameras = [entry for entry in rig.devices if entry.driver.name == "depth_camera"]
    camera = _one_of(rig, "depth_camera", rig.camera.device) if cameras else None
    arms = [entry for entry in rig.devices if entry.driver.name == "jaco"]
    arm = _one_of(rig, "jaco", "") if arms and rig.hand.T_arm_hand is not None else None
    if rig.hand.T_arm_hand is not None and arm is None:
        raise InputError("an arm for [hand] T_arm_hand", "none", '[devices.NAME] driver = "jaco"', rig.name)
    doubled = [entry.name for entry in rig.devices if entry.double]
    moving = [entry for entry in (hand, arm) if entry is not None]
    if len({entry.double for entry in moving}) > 1:
        raise InputError("hand and arm both real or both doubled", f"{', '.join(doubled)} doubled", where=rig.name)

    @contextmanager
    def open_source() -> Iterator[RigSource]:
        with ExitStack() as stack:
            members = [stack.enter_context(double(entry)) for entry in rig.devices]
            with RigSource(members, raw=rig.record.raw) as source:
                yield source

    seen = rig.camera
    fps = None if camera is None else camera.config.fps
    return SqueezeSetup(
        names=SqueezeNames(
            hand.name, tactile.name, "" if camera is None else camera.name, "" if arm is None else arm.name
        ),
        hand=rig.hand,
        container=rig.container,
        squeeze=rig.squeeze,
        camera=CameraView(seen.focal_px, seen.center_px, seen.distortion, rate_hz=float(fps or CAMERA_HZ)),
        open_source=open_source,
        grasp=draw_grasp(rig.container, rig.squeeze, seed),
        T_camera_hand=_transform(rig.hand.T_camera_hand),
        T_arm_hand=_transform(rig.hand.T_arm_hand),
        T_arm_camera=_transform(seen.T_arm_camera),
        simulated=hand.double,
    )


def _transform(rows: tuple[tuple[float, ...], ...] | None) -> FloatArray | None:
    return None if rows is None else np.array(rows, np.float64)


def _one_of(rig: Rig, driver: str, name: str) -> RigDevice:
    found = [entry for entry in rig.devices if entry.driver.name == driver and name in ("", entry.name)]
    if len(found) != 1:
        came = "none" if not found else ", ".join(entry.name for entry in found)
        raise InputError(f'one device with driver = "{driver}", to squeeze with', came, "the rig file", rig.name)
    return found[0]
