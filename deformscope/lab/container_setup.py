"""lab:containers as a setup to squeeze with, and the container that a rig's doubles squeeze: what is asked for stands
there, the rest is drawn from the seed."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from deformscope.errors import InputError
from deformscope.lab.container_constants import CONTENTS
from deformscope.lab.container_shell import SHAPES, ContainerShape
from deformscope.lab.squeeze_lab import NAMES, ContainerCase, SqueezeLab, container_of
from deformscope.rig.squeeze_sections import ContainerSection, HandSection, SqueezeSection
from deformscope.robot.setup import CameraView
from deformscope.robot.squeeze_plan import draw_grasp
from deformscope.robot.squeeze_setup import (
    SimulatedContainer,
    SqueezeNames,
    SqueezeParts,
    SqueezeSetup,
)

KINDS = {"box": "cardboard box", "cylinder": "plastic cylinder"}
"""In words, by the form of a container."""
CAMERA_HZ = 30.0
OPEN_DEG, DISTAL_DEG = -24.0, 32.0
"""Of the proximal axes: the open fingertips are a centimetre or more from the containers of this laboratory. Of the
distal ones: the fingertips lean in by some 15 deg when they touch, and press with their first six rows, which are the
feature. Upright ones would press with the middle of their pads."""


@dataclass(frozen=True, slots=True, eq=False)
class ContainerLab:
    """A setup, closed, what stands there, and the laboratory behind it, which has the truth."""

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
) -> ContainerLab:
    """content, container: empty = drawn; session: its number is that of the room's temperature

    camera_hz, alike: as for `SqueezeLab`, `ContainerCase`
    Raises InputError for a content or a container that is not known.
    """
    content, container = _drawn(content, container, "box", seed)
    shape, _ = container_of(container)
    section = ContainerSection(shape.kind, _size_m(shape), shape.wall.thickness_m, KINDS[shape.kind])
    squeeze = SqueezeSection(open_deg=OPEN_DEG, distal_deg=DISTAL_DEG)
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


@dataclass(frozen=True, slots=True, eq=False)
class RigContainer:
    """What stands between the doubles of a rig."""

    simulated: SimulatedContainer
    content: str
    container: str


def rig_container(parts: SqueezeParts, content: str, container: str, session: str, seed: int) -> RigContainer:
    """The container that the doubles of a rig file squeeze, on the host's clock; as for `container_lab`.

    Raises InputError for a content that is not known, and a container that is not the one of `[container]`.
    """
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
    """What is asked for, or drawn where it is empty."""
    random = np.random.default_rng([seed, 0xC0])
    content = content or list(CONTENTS)[int(random.integers(len(CONTENTS)))]
    return content, container or f"{kind}-{int(random.integers(100)):02d}"


def _session_number(session: str) -> int:
    """As its name says, or one of its own."""
    digits = session.rpartition("-")[2]
    return int(digits) if digits.isdecimal() else zlib.crc32(session.encode())


def _size_m(shape: ContainerShape) -> tuple[float, float, float]:
    x, y, z = (2.0 * float(half_m) for half_m in shape.half_m)
    return x, y, z
