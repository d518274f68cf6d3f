"""lab:containers as a setup to squeeze with: what is asked for stands there, the rest is drawn from the seed."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from deformscope.lab.container_constants import CONTENTS
from deformscope.lab.squeeze_lab import NAMES, SqueezeLab, container_of
from deformscope.rig.squeeze_sections import ContainerSection, HandSection, SqueezeSection
from deformscope.robot.setup import CameraView
from deformscope.robot.squeeze_plan import draw_grasp
from deformscope.robot.squeeze_setup import SqueezeNames, SqueezeSetup, SqueezeTruth

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

    camera_hz, alike: as for `SqueezeLab`. Raises InputError for a content or a container that is not known.
    """
    random = np.random.default_rng([seed, 0xC0])
    content = content or list(CONTENTS)[int(random.integers(len(CONTENTS)))]
    container = container or f"box-{int(random.integers(100)):02d}"
    shape, _ = container_of(container)
    x, y, z = (2.0 * float(half_m) for half_m in shape.half_m)
    section = ContainerSection(shape.kind, (x, y, z), shape.wall.thickness_m, KINDS[shape.kind])
    squeeze = SqueezeSection(open_deg=OPEN_DEG, distal_deg=DISTAL_DEG)
    grasp = draw_grasp(section, squeeze, seed)
    digits = session.rpartition("-")[2]
    number = int(digits) if digits.isdecimal() else zlib.crc32(session.encode())
    lab = SqueezeLab(
        content,
        container,
        seed=seed,
        session=number,
        grasp=grasp.T_hand_container,
        alike=alike,
        camera_hz=camera_hz,
    )
    seen = lab.view.intrinsics

    def truth() -> SqueezeTruth:
        now = lab.truth()
        return SqueezeTruth(now.contact_ns or 0, now.steady_ns or 0)

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
        truth=truth,
        clock=lab.clock,
        wait_until=lab.wait_until,
    )
    return ContainerLab(setup, content, container, lab)
