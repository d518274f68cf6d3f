"""The setup of lab:containers, and the container that a rig's doubles squeeze. Its requested properties
are set, the rest is drawn from the seed."""

import dataclasses
import zlib
from dataclasses import dataclass

import numpy as np

from deformscope.errors import InputError
from deformscope.lab import carried_hand
from deformscope.lab.container_constants import CONTENTS
from deformscope.lab.container_shell import SHAPES, ContainerShape
from deformscope.lab.squeeze_lab import NAMES, ContainerCase, SqueezeLab, container_of
from deformscope.rig.sections import ContainerSection, HandSection, SqueezeSection
from deformscope.robot.placement import Placement
from deformscope.robot.placing import PlacingSetup, hand_tool
from deformscope.robot.setup import CameraView
from deformscope.robot.squeeze_plan import GripShape, draw_grasp
from deformscope.robot.squeeze_setup import SimulatedContainer, SqueezeNames, SqueezeParts, SqueezeSetup
from deformscope_drivers.arm.kinematics import transform

KINDS = {"box": "cardboard box", "cylinder": "plastic cylinder"}
"""Kinds of containers in words, by form."""
CAMERA_HZ = 30.0
OPEN_DEG, DISTAL_DEG = -24.0, 32.0
"""Angle of the proximal axes: the open fingertips are a centimetre or more from the containers of this laboratory.
Angle of the distal axes: the fingertips lean in by about 15 deg at contact, and press with their first six rows, which
are the feature. Upright ones would press with the middle of their pads."""


@dataclass(frozen=True, slots=True, eq=False)
class ContainerLab:
    """A setup that is not opened, its container, and its laboratory, which has the truth."""

    setup: SqueezeSetup
    content: str
    container: str
    lab: SqueezeLab


def container_lab(
    content: str = "",
    container: str = "",
    session: str = "lab-0",
    seed: int = 0,
    *,
    camera_hz: float = CAMERA_HZ,
    alike: bool = False,
    arm: str = "",
) -> ContainerLab:
    """content, container: their names, empty = drawn; session: its number is that of the room's temperature

    camera_hz, alike: as for `SqueezeLab`, `ContainerCase`; arm: `jaco` or `kuka`, which places the hand; empty = none.
    Raises InputError for a content or a container that is not known."""
    content, container = _drawn(content, container, "box", seed)
    shape, _ = container_of(container)
    section = ContainerSection(shape.kind, _size_m(shape), shape.wall.thickness_m, KINDS[shape.kind])
    squeeze = SqueezeSection(open_deg=OPEN_DEG, distal_deg=DISTAL_DEG)
    if arm:
        return _carried(arm, content, container, section, squeeze, _session_number(session), seed, camera_hz)
    grasp = draw_grasp(section, squeeze, seed)
    case = ContainerCase(content, container, seed, _session_number(session), grasp.T_hand_container, alike)
    lab = SqueezeLab(case, camera_hz)
    seen = lab.view.intrinsics

    setup = SqueezeSetup(
        names=SqueezeNames(*NAMES),
        hand=HandSection(),
        container=section,
        squeeze=squeeze,
        camera=CameraView((seen.fx_px, seen.fy_px), (seen.cx_px, seen.cy_px), rate_hz=camera_hz),
        open_source=lab.source,
        grasp=grasp,
        T_camera_hand=np.linalg.inv(lab.view.T_world_camera),
        placed=True,
        simulated=True,
        runs_itself=False,
        truth=lab.truth,
        clock=lab.clock,
        wait_until=lab.wait_until,
    )
    return ContainerLab(setup, content, container, lab)


def _carried(
    arm: str,
    content: str,
    container: str,
    section: ContainerSection,
    squeeze: SqueezeSection,
    session: int,
    seed: int,
    camera_hz: float,
) -> ContainerLab:
    """The container is on a table, and an arm carries the hand: the parked thumb is above it."""
    middle = transform(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), GripShape.of(section, squeeze).middle_m)
    section = dataclasses.replace(section, T_hand_container=tuple(tuple(map(float, row)) for row in middle))
    T_base_table = carried_hand.T_BASE_TABLE.get(arm)
    if T_base_table is None:
        raise InputError(f"--place {' or '.join(carried_hand.T_BASE_TABLE)} in lab:containers", repr(arm))
    placement = Placement(T_base_table, hand_tool(carried_hand.T_ARM_HAND, GripShape.of(section, squeeze)))
    lab = carried_hand.CarriedHandLab(arm, placement, ContainerCase(content, container, seed, session), camera_hz)
    lens = lab.view.intrinsics
    setup = SqueezeSetup(
        names=SqueezeNames(*carried_hand.CARRIED_NAMES),
        hand=HandSection(T_arm_hand=tuple(tuple(map(float, row)) for row in carried_hand.T_ARM_HAND)),
        container=section,
        squeeze=squeeze,
        camera=CameraView((lens.fx_px, lens.fy_px), (lens.cx_px, lens.cy_px), rate_hz=camera_hz),
        open_source=lab.source,
        grasp=draw_grasp(section, squeeze, seed),
        T_arm_hand=carried_hand.T_ARM_HAND,
        T_arm_camera=T_base_table @ carried_hand.T_TABLE_CAMERA,
        simulated=True,
        runs_itself=False,
        truth=lab.truth,
        placing=PlacingSetup(lab.chain, placement, carried_hand.workspace_of(T_base_table), {}),
        clock=lab.clock,
        wait_until=lab.wait_until,
    )
    return ContainerLab(setup, content, container, lab)


@dataclass(frozen=True, slots=True, eq=False)
class RigContainer:
    """The container between the doubles of a rig."""

    simulated: SimulatedContainer
    content: str
    container: str


def rig_container(parts: SqueezeParts, content: str, container: str, session: str, seed: int) -> RigContainer:
    """The container that the doubles of a rig file squeeze, on the host's clock; arguments as in `container_lab`.

    Raises InputError for an unknown content, and for a container other than that of `[container]`."""
    from deformscope.lab.live_squeeze_lab import PICTURES_HZ, LiveSqueezeLab

    section = parts.rig.container
    shape = SHAPES.get(section.shape)
    if shape is None or not np.allclose(section.size_m, _size_m(shape), atol=1e-4):
        known = " or ".join(f"{kind} of {list(_size_m(one))}" for kind, one in SHAPES.items())
        came = f"{section.shape} of {list(section.size_m)}"
        raise InputError(f"[container] shape and size_m that are simulated: {known}", came, where=parts.rig.name)
    content, container = _drawn(content, container, section.shape, seed)
    if content not in CONTENTS:
        raise InputError(f"a content that is simulated: {', '.join(CONTENTS)}", repr(content), where=parts.rig.name)
    if container_of(container)[0].kind != section.shape:
        came = f"{container} with [container] shape = {section.shape!r}"
        raise InputError(f"a container named after its shape, as {section.shape}-07", came, where=parts.rig.name)
    fps = None if parts.camera is None else parts.camera.config.fps
    case = ContainerCase(content, container, seed, _session_number(session), parts.grasp.T_hand_container)
    lab = LiveSqueezeLab(case, float(fps or PICTURES_HZ))
    return RigContainer(lab, content, container)


def _drawn(content: str, container: str, kind: str, seed: int) -> tuple[str, str]:
    """The requested content, or a random one if it is empty."""
    random = np.random.default_rng([seed, 0xC0])
    content = content or list(CONTENTS)[int(random.integers(len(CONTENTS)))]
    return content, container or f"{kind}-{int(random.integers(100)):02d}"


def _session_number(session: str) -> int:
    """Number at the end of the session's name; without one, a number made from the name."""
    digits = session.rpartition("-")[2]
    return int(digits) if digits.isdecimal() else zlib.crc32(session.encode())


def _size_m(shape: ContainerShape) -> tuple[float, float, float]:
    x, y, z = (2.0 * float(half_m) for half_m in shape.half_m)
    return x, y, z
