"""Faults of a simulated laboratory: injected immediately (`inject`), or during the touches (`FaultsToCome`)."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

import numpy as np

from deformscope.errors import InputError
from deformscope.lab.touch_lab import TouchLab
from deformscope.robot.touch import Phase
from deformscope_drivers.jaco import JacoDouble
from deformscope_drivers.optoforce import Optoforce


class Injected(StrEnum):
    """A fault."""

    FORCE_SILENT = "force sensor silent"
    FORCE_CABLE = "force sensor's cable out"
    FORCE_FROZEN = "force value frozen"
    FORCE_BROKEN = "force sensor reports a failure"
    STORM = "checksum storm"
    SPIKE = "force spike above the hard stop"
    PUSH = "push above the soft stop"
    ARM_CABLE = "arm's cable out"
    ARM_SILENT = "arm refuses to answer"
    ARM_INVALID = "arm's pose not a number"
    ARM_TURNS = "arm turns on its own as it moves"
    ARM_FROZEN = "arm's angles frozen"
    ARM_LATE = "arm answers late"
    COLLISION = "collision from the side"
    CAMERA_SILENT = "camera silent"
    CAMERA_FROZEN = "camera frozen"
    CAMERA_CABLE = "camera's cable out"

    @property
    def word(self) -> str:
        """The fault's name on the command line: force-silent."""
        return self.name.lower().replace("_", "-")


_EVERY = tuple(Injected)
FORCE, ARM, CAMERA = _EVERY[:7], _EVERY[7:14], _EVERY[14:]
"""By the device that they strike, in the order above."""

WITHIN_S = {Phase.TRAVEL: 1.0, Phase.APPROACH: 2.0, Phase.PRESS: 0.3, Phase.DWELL: 0.4, Phase.RETREAT: 1.5}
"""Latest time of a fault after the beginning of such a phase; no such phase is much shorter."""
CAMERA_WITHIN_S = 0.3


def inject(lab: TouchLab, injected: Injected, random: np.random.Generator) -> None:
    """Inject the fault now. random: draws the fault's size, if it has one."""
    assert lab.camera is not None
    match injected:
        case _ if injected.word in lab.arm_faults:
            lab.arm_faults[injected.word]()
        case Injected.FORCE_SILENT:
            lab.sensor_double.silent = True
        case Injected.FORCE_CABLE:
            lab.wire.unplug()
        case Injected.FORCE_FROZEN:
            lab.wire.frozen = True
        case Injected.FORCE_BROKEN:
            lab.sensor_double.unplugged.add(0)
        case Injected.STORM:
            lab.wire.spoiled = random.uniform(0.03, 0.5)
        case Injected.SPIKE | Injected.PUSH:
            low_n, high_n = (20.0, 45.0) if injected is Injected.SPIKE else (11.5, 12.0)
            direction = random.normal(size=3)
            force_n = random.uniform(low_n, high_n) * direction / np.linalg.norm(direction)
            lab.contact.hit(force_n, random.uniform(0.02, 0.2))
        case Injected.ARM_CABLE:
            lab.arm_double.unplug()
        case Injected.ARM_SILENT:
            lab.arm_double.inject("GetAngularPosition", 2005, times=10_000)
        case Injected.ARM_INVALID:
            lab.functions.invalid = True
        case Injected.ARM_TURNS:
            axis = random.normal(size=3)
            lab.functions.turning_rad_s = np.radians(random.uniform(20.0, 35.0)) * axis / np.linalg.norm(axis)
        case Injected.ARM_FROZEN:
            lab.functions.frozen = True
        case Injected.ARM_LATE:
            lab.arm_late_s = random.uniform(0.1, 0.3)
        case Injected.COLLISION:
            _collide(lab, random)
        case Injected.CAMERA_SILENT:
            lab.camera.stop()
        case Injected.CAMERA_FROZEN:
            lab.camera.freeze()
        case Injected.CAMERA_CABLE:
            lab.camera.unplug()


def _collide(lab: TouchLab, random: np.random.Generator) -> None:
    """A push across elbow, forearm or wrist, without a Jaco across the arm's end, so that the most loaded joint has 6
    to 20 Nm."""
    links, double = lab.body.T_base_links, lab.body
    link = int(random.integers(1, 4)) if isinstance(double, JacoDouble) else len(links) - 2
    levers = np.cross(links[: link + 1, :3, 2], links[link + 1, :3, 3] - links[: link + 1, :3, 3])
    direction = random.normal(size=3)
    force_n = direction * random.uniform(6.0, 20.0) / np.abs(levers @ direction).max()
    if isinstance(double, JacoDouble):
        double.push_link(link, force_n)
    else:
        lab.contact.aside = np.concatenate([force_n, np.zeros(3)])


def _possible(lab: TouchLab) -> list[Injected]:
    """The faults of a laboratory: of its arm, of its camera, and of its force sensor where it has one."""
    force = FORCE if isinstance(lab.force, Optoforce) else ()
    return [
        one
        for one in (*force, *ARM, *CAMERA)
        if one not in ARM[:5] or isinstance(lab.body, JacoDouble) or one.word in lab.arm_faults
    ]


@dataclass(frozen=True, slots=True)
class FaultAt:
    """Kind of a fault and number of its touch, from 1."""

    injected: Injected
    touch: int

    @classmethod
    def parse(cls, text: str, touches: int) -> "FaultAt":
        """KIND@TOUCH, such as force-silent@2. touches: how many there are at most. Raises InputError."""
        kinds = {kind.word: kind for kind in Injected}
        word, at, number = text.partition("@")
        if word not in kinds:
            near = next(iter(difflib.get_close_matches(word, kinds, n=1, cutoff=0.0)))
            raise InputError(f"a fault out of {', '.join(kinds)}", repr(word), f"{near}@{number or 1}")
        if not (at and number.isascii() and number.isdigit() and 1 <= int(number) <= touches):
            came = repr(text) if not number else f"touch {number}"
            raise InputError(f"--fault KIND@TOUCH with a touch from 1 to {touches}", came, f"--fault {word}@1")
        return cls(kinds[word], int(number))


class FaultsToCome:
    """Injects faults during touches: each at a moment drawn from the seed, within its touch.

    A fault of force sensor or arm strikes in any phase; one of the camera while it dwells, when its pictures matter.
    struck: faults that have occurred, and when on the laboratory's clock [ns]"""

    def __init__(self, lab: TouchLab, faults: Sequence[FaultAt], seed: int) -> None:
        self._lab = lab
        can = _possible(lab)
        if others := [fault.injected.word for fault in faults if fault.injected not in can]:
            raise InputError(f"faults of these devices: {', '.join(one.word for one in can)}", ", ".join(others))
        self.struck: list[tuple[FaultAt, int]] = []
        self._waiting: list[tuple[FaultAt, Phase, int, np.random.Generator]] = []
        for number, fault in enumerate(faults):
            random = np.random.default_rng([seed, number, 0xFB])
            if fault.injected in CAMERA:
                phase, within_s = Phase.DWELL, CAMERA_WITHIN_S
            else:
                phase = list(WITHIN_S)[int(random.integers(len(WITHIN_S)))]
                within_s = WITHIN_S[phase]
            self._waiting.append((fault, phase, round(random.uniform(0.0, within_s) * 1e9), random))

    def phase_began(self, phase: Phase, touch: int) -> None:
        """Called when a phase of a touch begins. touch: its number, from 1"""
        for one in list(self._waiting):
            fault, waited_for, delay_ns, random = one
            if (fault.touch, waited_for) == (touch, phase):
                self._waiting.remove(one)
                self._lab.schedule(self._lab.clock() + delay_ns, partial(self._strike, fault, random))

    @property
    def waiting(self) -> tuple[FaultAt, ...]:
        """The faults that have not been injected yet."""
        return tuple(fault for fault, *_ in self._waiting)

    def _strike(self, fault: FaultAt, random: np.random.Generator) -> None:
        self.struck.append((fault, self._lab.clock()))
        inject(self._lab, fault.injected, random)
