"""[shape] of the rig file: shapes of arm, gripper and cables, for their removal from the camera's image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deformscope.rig.checks import check, check_transform

LONGEST_M = 3.0


@dataclass(frozen=True, slots=True)
class CableSection:
    """A cable: lines from point to point, with the distance around them within which it may hang or sway.

    points_m: points in the frame of the arm's end, or with `joints` in the frames of the links behind these joints,
    counted from 1 (0 = the arm's base, -1 = its end); radius_m: its radius"""

    points_m: tuple[tuple[float, float, float], ...]
    radius_m: float = 0.01
    joints: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        check(len(self.points_m) >= 2, "points_m of 2 or more", len(self.points_m))
        check(all(abs(value) <= LONGEST_M for one in self.points_m for value in one), "points_m up to 3", self.points_m)
        check(0 < self.radius_m <= 0.1, "radius_m of a cable above 0 and up to 0.1", self.radius_m)
        counts = self.joints is None or len(self.joints) == len(self.points_m)
        check(counts, "joints, one for each of points_m", self.joints)


@dataclass(frozen=True, slots=True)
class ShapeSection:
    """Shapes of arm, gripper and cables in the camera's image, besides the stick of [tool].

    removal: "mesh": points within margin_m of any mesh of a URDF; "hull": of the convex hull of one of its links
    (Thesis 4.4); "capsules": within 4.5 cm of the lines between joints. Default: "mesh" with a urdf or a gripper, which
    are this file's own and show the robot's true shape, else "capsules"
    urdf: URDF of the arm, including everything mounted on it that moves with its joints; gripper: URDF of the gripper
    at its end, if the arm's URDF does not have it; paths relative to the rig file
    T_ee_gripper: 4x4, the gripper's root to the arm's end [m]; closed: joints whose angle is not reported, such as
    those of fingers: position as a share of the way from the lower limit to the upper one
    margin_m: margin of meshes and hulls, in addition to [camera] doubt_m; cables: cables, for any kind of removal"""

    removal: Literal["capsules", "hull", "mesh"] | None = None
    urdf: str = ""
    gripper: str = ""
    T_ee_gripper: tuple[tuple[float, ...], ...] | None = None
    closed: float = 0.0
    margin_m: float = 0.006
    cables: tuple[CableSection, ...] = ()

    def __post_init__(self) -> None:
        if self.T_ee_gripper is not None:
            check_transform("T_ee_gripper", self.T_ee_gripper)
        check(0 <= self.closed <= 1, "closed between 0 and 1", self.closed)
        check(0 <= self.margin_m <= 0.05, "margin_m between 0 and 0.05", self.margin_m)
