"""The grasp of a container: the hand's pre-shape, and its random place on the container."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.rig.sections import ContainerSection, SqueezeSection
from deformscope.solid import Capsule
from deformscope_drivers.arm.kinematics import transform
from deformscope_drivers.sdh import kinematics

BASE_DEG = 90.0
"""Angle of the base axis at which its two fingers face each other: `deformscope_drivers.sdh.kinematics`."""
PAD_M = 0.011
"""Distance from the axis of a distal link to its pad's surface: half of a link of some 22 mm. Assumed."""
OPENING_DEG = 12.0
"""Start of the proximal axes before the contact at the container's width: the fingertips are then about 3 cm away. With
a smaller angle, a displaced hand touches before it closes; with a larger one, closing takes longer (2 s for this one at
the standard 6 deg/s)."""
CLOSING_AXES = (1, 5)
"""The proximal axes of fingers 0 and 2 (Schunk's order of axes)."""
PAD_ALONG_M = 0.6 * kinematics.DISTAL_LINK_M
"""Place of its pad's middle along the distal link. Assumed."""


@dataclass(frozen=True, slots=True)
class GripShape:
    """Angles of the axes, (7,) each [deg]. open_deg: angles before and after; contact_deg: where both fingertips touch
    a container of the width given; reach_m: height of the middle of the pads above the palm's origin there [m]"""

    open_deg: tuple[float, ...]
    contact_deg: tuple[float, ...]
    reach_m: float

    @property
    def middle_m(self) -> tuple[float, float, float]:
        """The point midway between the two pads at contact, hand frame [m]."""
        return 0.0, kinematics.FINGERS[0].base_m[1], self.reach_m

    @classmethod
    def of(cls, container: ContainerSection, squeeze: SqueezeSection) -> "GripShape":
        """The pre-shape for a container of this width. Raises InputError if the fingers cannot close on it."""
        half_m = container.size_m[0] / 2 + PAD_M
        lean = (kinematics.BASE_SIDE_M / 2 - half_m) / kinematics.PROXIMAL_LINK_M
        if not abs(lean) < 0.95:
            widest = 2 * (kinematics.BASE_SIDE_M / 2 + 0.95 * kinematics.PROXIMAL_LINK_M - PAD_M)
            raise InputError(f"a container up to {widest:.3f} m wide along x", f"{container.size_m[0]:g} m")
        touching = math.degrees(math.asin(lean))
        distal = -touching if squeeze.distal_deg is None else squeeze.distal_deg
        if squeeze.distal_deg is not None:
            low, high = -80.0, 80.0  # by bisection, where the pad is half_m from the middle of the hand
            for _ in range(40):
                middle = (low + high) / 2
                leaning = kinematics.PROXIMAL_LINK_M * math.sin(math.radians(middle))
                leaning += kinematics.DISTAL_LINK_M * math.sin(math.radians(middle + distal))
                low, high = (middle, high) if kinematics.BASE_SIDE_M / 2 - leaning > half_m else (low, middle)
            touching = low
        opened = touching - OPENING_DEG if squeeze.open_deg is None else squeeze.open_deg
        if not opened < touching:
            came = f"{opened:g}, contact at {touching:.1f} deg"
            raise InputError("[squeeze] open_deg below the angle of contact", came)
        upright = kinematics.PROXIMAL_LINK_M * math.cos(math.radians(touching))
        reach_m = kinematics.BASE_HEIGHT_M + upright + PAD_ALONG_M * math.cos(math.radians(touching + distal))
        return cls(_angles(opened, distal, squeeze), _angles(touching, distal, squeeze), reach_m)


@dataclass(frozen=True, slots=True, eq=False)
class RandomGrasp:
    """The hand's place on the container.

    along_m: distance of the middle of the pads from the container's middle, along its longest edge; tilt_deg: tilt of
    the hand about the axis of closing; T_hand_container: (4, 4) container to hand [m];
    turn_deg: turn about the container's z axis"""

    along_m: float
    tilt_deg: float
    T_hand_container: FloatArray
    turn_deg: float = 0.0


def draw_grasps(container: ContainerSection, squeeze: SqueezeSection, seed: int, count: int) -> list[RandomGrasp]:
    """Grasps, the same for a seed, as in `draw_grasp`: from both sides of a box, from any side of a cylinder."""
    random = np.random.default_rng([seed, 0x97])
    found = []
    for _ in range(count):
        along, tilt = np.clip(random.standard_normal(2), -2.0, 2.0)
        turn_deg = random.uniform(-180.0, 180.0) if container.shape == "cylinder" else 180.0 * random.integers(2)
        along_m, tilt_deg = float(along * squeeze.spread_m), float(tilt * squeeze.tilt_deg)
        found.append(grasp_at(container, squeeze, along_m, tilt_deg, float(turn_deg)))
    return found


def draw_grasp(container: ContainerSection, squeeze: SqueezeSection, seed: int) -> RandomGrasp:
    """A grasp around the middle of the container's longest edge (Thesis 5.1), within two standard deviations."""
    random = np.random.default_rng([seed, 0x5E])
    along, tilt = np.clip(random.standard_normal(2), -2.0, 2.0)
    return grasp_at(container, squeeze, float(along * squeeze.spread_m), float(tilt * squeeze.tilt_deg))


def grasp_at(
    container: ContainerSection, squeeze: SqueezeSection, along_m: float, tilt_deg: float, turn_deg: float = 0.0
) -> RandomGrasp:
    """The grasp with these numbers, as in `RandomGrasp`."""
    size = container.size_m
    edge = 1 if size[1] > size[2] else 2
    middle = grasp_middle(container, squeeze)
    offset = np.zeros(3)
    offset[edge] = -along_m
    # about the middle between the pads, which stays on the container's axis of closing
    pads = np.array(GripShape.of(container, squeeze).middle_m)
    about = transform(np.eye(3), pads) @ _turned("x", tilt_deg) @ transform(np.eye(3), -pads)
    posed = about @ middle @ transform(np.eye(3), offset)
    if turn_deg:
        posed = posed @ _turned("z", turn_deg)
    return RandomGrasp(along_m, tilt_deg, np.asarray(posed), turn_deg)


def _turned(axis: str, by_deg: float) -> FloatArray:
    return transform(Rotation.from_euler(axis, by_deg, degrees=True).as_matrix(), np.zeros(3))


LINK_M, PALM_M = 0.012, 0.055
"""Radii of the capsules of a finger's links and of the palm. Assumed: the SDH's links are some 22 mm thick."""


def hand_capsules(position_deg: npt.NDArray[np.float64]) -> list[Capsule]:
    """Fingers and palm in the hand frame. position_deg: (7,)"""
    found = []
    for finger in range(len(kinematics.FINGERS)):
        points = kinematics.finger_points(position_deg, finger)
        found += [Capsule(points[0], points[1], LINK_M), Capsule(points[1], points[2], LINK_M)]
    palm = np.array([[0.0, 0.0, -0.05], [0.0, 0.0, kinematics.BASE_HEIGHT_M - PALM_M + 0.02]])
    return [*found, Capsule(palm[0], palm[1], PALM_M)]


def grasp_middle(container: ContainerSection, squeeze: SqueezeSection) -> FloatArray:
    """(4, 4) container to hand for the grasp in its middle [m], as in the rig file. By default the hand grasps from the
    side: the container's middle is between the pads, its x is the hand's x, and its z the hand's y."""
    if container.T_hand_container is not None:
        return np.array(container.T_hand_container, np.float64)
    from_side = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return np.asarray(transform(from_side, GripShape.of(container, squeeze).middle_m))


def _angles(proximal: float, distal: float, squeeze: SqueezeSection) -> tuple[float, ...]:
    thumb = squeeze.thumb_deg
    return (BASE_DEG, proximal, distal, thumb[0], thumb[1], proximal, distal)
