"""Sections of a rig file: shapes of the robot, for its removal from images; hand, container and squeeze."""

import dataclasses
import datetime
import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.errors import InputError


def check(right: object, expected: str, came: object, try_this: str = "") -> None:
    if not right:
        raise InputError(expected, str(came), try_this)


def check_transform(name: str, rows: tuple[tuple[float, ...], ...]) -> None:
    """A rigid 4x4: rows of a rotation, a translation within 10 m, and 0 0 0 1."""
    check(len(rows) == 4 and all(len(row) == 4 for row in rows), f"{name} of 4 rows of 4 numbers", rows)
    check(all(math.isfinite(value) for row in rows for value in row), f"{name} of finite numbers", rows)
    check(tuple(rows[3]) == (0, 0, 0, 1), f"{name} whose last row is 0 0 0 1", rows[3])
    turn = np.array(rows, np.float64)[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers beyond all use
        turned, mirrored = np.abs(turn @ turn.T - np.eye(3)).max() < 1e-3, np.linalg.det(turn) <= 0
    check(turned, f"{name} whose rotation is one", f"rows {turn.tolist()}")
    advice = (
        "reverse one of its axes: x, y and z of a right hand; or remove the key and measure it, deformscope calibrate"
    )
    check(not mirrored, f"{name} that is no mirror image", f"rows {turn.tolist()}", advice)
    check(max(abs(row[3]) for row in rows[:3]) < 10, f"{name} in metres", [row[3] for row in rows[:3]])


def check_orthogonal(name: str, rows: tuple[tuple[float, ...], ...]) -> None:
    """A 3x3 matrix of axes at right angles, mirrored or not."""
    check(len(rows) == 3 and all(len(row) == 3 for row in rows), f"{name} of 3 rows of 3 numbers", rows)
    check(all(math.isfinite(value) for row in rows for value in row), f"{name} of finite numbers", rows)
    axes = np.array(rows, np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        check(np.abs(axes @ axes.T - np.eye(3)).max() < 1e-3, f"{name} of axes at right angles", axes.tolist())


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


Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class HandSection:
    """Pose of the hand, and how its fingertips are read.

    T_camera_hand: 4x4, hand to depth camera [m], for a fixed hand; or T_arm_hand: 4x4, hand to the end of the arm that
    carries it (with `[camera] T_arm_camera`). The hand's frame is that of `deformscope_drivers.sdh`
    fingers: the two fingers that squeeze; tactile_end: which 36 cells of the fingertip arrays are the feature: the
    first ones that the controller sends (the thesis), or the last
    tactile: name of the tactile device, if the rig has several"""

    T_camera_hand: Rows | None = None
    T_arm_hand: Rows | None = None
    fingers: tuple[int, int] = (0, 2)
    tactile_end: Literal["first", "last"] = "first"
    tactile: str = ""

    def __post_init__(self) -> None:
        check(self.T_camera_hand is None or self.T_arm_hand is None, "T_camera_hand or T_arm_hand", "both")
        for name in ("T_camera_hand", "T_arm_hand"):
            if (rows := getattr(self, name)) is not None:
                check_transform(name, rows)
        check(self.fingers == (0, 2), "fingers = [0, 2], which face each other at 90 deg", self.fingers)


@dataclass(frozen=True, slots=True)
class ContainerSection:
    """The squeezed container. Its frame: origin in the middle of its bounding box, z along its height.

    shape: box (size_m along x, y, z), cylinder (size_m: diameter, diameter, height) or mesh (file, in metres); the
    fingers close along x. wall_m: thickness of its wall; kind: kind in words (cardboard box, plastic cylinder)
    T_hand_container: 4x4, container to hand for the middle grasp [m]; None = from the side: the container's middle
    between the fingertips, its z along the hand's y"""

    shape: Literal["box", "cylinder", "mesh"] = "box"
    size_m: tuple[float, float, float] = (0.06, 0.09, 0.16)
    wall_m: float = 0.00045
    kind: str = ""
    mesh: str = ""
    T_hand_container: Rows | None = None

    def __post_init__(self) -> None:
        check(all(0.01 <= side <= 0.5 for side in self.size_m), "size_m between 0.01 and 0.5", self.size_m)
        check(0.0 < self.wall_m <= 0.02, "wall_m above 0 and up to 0.02", self.wall_m)
        check((self.shape == "mesh") == bool(self.mesh), 'mesh = FILE with shape = "mesh" alone', repr(self.mesh))
        if self.shape == "cylinder":
            check(self.size_m[0] == self.size_m[1], "size_m = [diameter, diameter, height]", self.size_m)
        if self.T_hand_container is not None:
            check_transform("T_hand_container", self.T_hand_container)


@dataclass(frozen=True, slots=True)
class SqueezeSection:
    """The squeeze: the proximal axes of both fingers close at a low speed under a low current limit, until they are at
    rest.

    current_a: limit of the motor currents while it closes [A]; speed_deg_s: speed of the proximal axes; open_deg:
    angles of the proximal axes in the pre-shape; None = 20 deg before the contact that the container's width gives
    distal_deg: angles of the distal axes throughout; None = so that the fingertips are upright at that contact
    thumb_deg: proximal and distal angle at which the thumb is parked
    onset_counts: rise of the sum of a fingertip's texels above its value in the air that means contact
    onset_frames: number of successive frames above it
    still_deg, still_s: the closing axes stay within still_deg for still_s under the constant current: steady state
    hold_s: duration of the current after that, for the relaxation
    over_squeeze_m: limit on the fingertips' closing after the first contact
    contact_timeout_s, still_timeout_s: most time until the first contact, and from there to the steady state
    hand_silent_s, tactile_silent_s: limits on silence that stop the hand. The limits are five periods of the hand's 25
    Hz, and nearly four of pads with at least 11 frames a second; set longer ones on a busy machine
    saturation_counts: a texel that reaches it ends the squeeze; spread_m, tilt_deg: standard deviation of a random
    grasp along the container's longest edge, about its middle, and of its tilt"""

    current_a: float = 0.3
    speed_deg_s: float = 6.0
    open_deg: float | None = None
    distal_deg: float | None = None
    thumb_deg: tuple[float, float] = (-70.0, 0.0)
    onset_counts: float = 40.0
    onset_frames: int = 2
    still_deg: float = 0.15
    still_s: float = 0.3
    hold_s: float = 0.5
    over_squeeze_m: float = 0.03
    contact_timeout_s: float = 12.0
    still_timeout_s: float = 8.0
    hand_silent_s: float = 0.2
    tactile_silent_s: float = 0.35
    saturation_counts: int = 4095
    spread_m: float = 0.01
    tilt_deg: float = 3.0

    def __post_init__(self) -> None:
        check(0.0 < self.current_a <= 0.5, "current_a above 0 and up to 0.5", self.current_a)
        check(0.0 < self.speed_deg_s <= 20.0, "speed_deg_s above 0 and up to 20", self.speed_deg_s)
        for name in ("open_deg", "distal_deg"):
            given = getattr(self, name)
            check(given is None or -90.0 <= given <= 90.0, f"{name} between -90 and 90", given)
        check(all(-90.0 <= angle <= 0.0 for angle in self.thumb_deg[:1]), "thumb_deg of -90 to 0", self.thumb_deg)
        check(abs(self.thumb_deg[1]) <= 90.0, "thumb_deg within -90 and 90", self.thumb_deg)
        check(self.onset_counts > 0 and self.onset_frames >= 1, "an onset above 0", self.onset_counts)
        check(0.0 < self.still_deg <= 2.0, "still_deg above 0 and up to 2", self.still_deg)
        for name, most in (("still_s", 5.0), ("contact_timeout_s", 60.0), ("still_timeout_s", 60.0)):
            check(0.05 <= getattr(self, name) <= most, f"{name} between 0.05 and {most:g}", getattr(self, name))
        for name in ("hand_silent_s", "tactile_silent_s"):
            check(0.05 <= getattr(self, name) <= 1.0, f"{name} between 0.05 and 1", getattr(self, name))
        check(0.0 <= self.hold_s <= 10.0, "hold_s between 0 and 10", self.hold_s)
        check(0.0 < self.over_squeeze_m <= 0.1, "over_squeeze_m above 0 and up to 0.1", self.over_squeeze_m)
        check(1 <= self.saturation_counts <= 4095, "saturation_counts between 1 and 4095", self.saturation_counts)
        check(0.0 <= self.spread_m <= 0.1, "spread_m between 0 and 0.1", self.spread_m)
        check(0.0 <= self.tilt_deg <= 20.0, "tilt_deg between 0 and 20", self.tilt_deg)


# Date and accuracy of each part of a rig's calibration: `deformscope calibrate` writes them with the values

DAYS = {"arm": 365, "place": 30, "tip": 180, "camera": 90, "force": 180, "time": 365, "tool": 180, "wrench": 30}
"""Days after which each calibration is repeated: a table is moved sooner than a stick is bent. Chosen."""

LATEST_S = 0.5
"""Largest offset between two clocks [s] in `calibrate time`."""


@dataclass(frozen=True, slots=True)
class CalibrationEntry:
    """One measurement.

    date: date of the calibration; half_m, half_deg: half widths of the 90 % intervals of a translation along x, y, z
    [m] and of a turn about them [deg], in the transform's target frame; half_size_m: half widths of the intervals of a
    surface's sides [m]; half_gain: half width of the interval of the force sensor's gain;
    half_weight_n: half width of that of a tool's weight
    offset_s, half_s: delay of `device` relative to the force sensor `beside`, below 0 a lead
    oldest_days: age at which it is measured again, None = the usual one of its kind"""

    date: datetime.date
    half_m: tuple[float, ...] = ()
    half_deg: tuple[float, ...] = ()
    half_size_m: tuple[float, ...] = ()
    half_gain: float | None = None
    half_weight_n: float | None = None
    offset_s: float | None = None
    half_s: float | None = None
    device: str = ""
    beside: str = ""
    oldest_days: int | None = None

    def __post_init__(self) -> None:
        check(isinstance(self.date, datetime.date), "date = YEAR-MONTH-DAY", self.date)
        halves = (*self.half_m, *self.half_deg, *self.half_size_m, self.half_gain or 0.0, self.half_weight_n or 0.0)
        check(all(value >= 0.0 for value in halves), "half widths of 0 or more", halves)
        check(self.oldest_days is None or self.oldest_days > 0, "oldest_days above 0", self.oldest_days)

    def days(self, today: datetime.date) -> int:
        """Its age in days; 0 for a date after today, as on a computer whose clock is behind."""
        return max((today - self.date).days, 0)


@dataclass(frozen=True, slots=True)
class CalibratedSection:
    """Calibrations of a rig; None = not measured by `deformscope calibrate`."""

    arm: CalibrationEntry | None = None
    place: CalibrationEntry | None = None
    tip: CalibrationEntry | None = None
    camera: CalibrationEntry | None = None
    force: CalibrationEntry | None = None
    time: CalibrationEntry | None = None
    tool: CalibrationEntry | None = None
    wrench: CalibrationEntry | None = None

    def late_ns(self, devices: Collection[str]) -> dict[str, int]:
        """The delay of a device, by name [ns]: only the later of the two compared devices has one, so that no stamp
        lies in the future. devices: names of all devices. Raises InputError for an unknown device."""
        if self.time is None or self.time.offset_s is None or not self.time.device:
            return {}
        one, other, offset_s = self.time.device, self.time.beside, self.time.offset_s
        for name in (one, other):
            check(name in devices, f"[calibrated.time] device and beside out of {', '.join(devices)}", name)
        check(abs(offset_s) <= LATEST_S, f"[calibrated.time] offset_s within {LATEST_S:g} s", offset_s)
        return {one if offset_s >= 0.0 else other: round(1e9 * abs(offset_s))}

    def ages(self, today: datetime.date | None = None) -> "dict[str, CalibrationAge]":
        """How old each measured calibration is, by name."""
        now = today if today is not None else datetime.datetime.now(tz=datetime.UTC).date()
        found = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {
            name: CalibrationAge(one.days(now), one.oldest_days or DAYS[name])
            for name, one in found.items()
            if one is not None
        }


@dataclass(frozen=True, slots=True)
class CertificateSection:
    """What `deformscope certify` found. bias, interval: what the rig adds to a modulus, as a share, and its 90 %
    interval; causes: value and deviation of each, as `stages.poke.certificate.CAUSES`; oldest_days: age at which it is
    old, as a camera's calibration"""

    date: datetime.date
    sample: str
    tip: str
    bias: float
    interval: tuple[float, float]
    off: str = ""
    conditions: str = ""
    causes: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    oldest_days: int = DAYS["camera"]

    def __post_init__(self) -> None:
        in_order = -0.9 < self.interval[0] <= self.bias <= self.interval[1] < 9.0
        check(in_order, "bias within its interval, above -0.9 and below 9", self.interval)

    @property
    def days(self) -> int:
        """Its age; 0 for a date after today."""
        return CalibrationEntry(self.date).days(datetime.datetime.now(tz=datetime.UTC).date())

    def __str__(self) -> str:
        low, high = (100.0 * one for one in self.interval)
        read = f"this rig read {100.0 * self.bias:+.1f} % ({low:+.1f} to {high:+.1f}) on {self.sample}"
        return f"{read}, {self.days} days ago"


@dataclass(frozen=True, slots=True)
class CalibrationAge:
    """days: age in days; at_most: age at which it is measured again"""

    days: int
    at_most: int

    @property
    def young(self) -> bool:
        """Whether the calibration may still be used."""
        return self.days <= self.at_most
