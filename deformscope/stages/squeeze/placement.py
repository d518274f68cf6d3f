"""Record of an arm that places the hand: measurements of the container, and the drawn grasp."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.results.render import derived, reported


@dataclass(frozen=True, slots=True)
class ContainerFit:
    """An upright container as in a depth image, in the table's frame: z = 0 on the table, upwards.

    shape; center_m: (3,) middle of its body [m]; yaw_rad: yaw of its x axis, 0 for a cylinder
    size_m: (3,) along x, y, z; of a cylinder its diameter twice and its height [m]
    lean_rad: (2,) lean of its axis towards x and y
    deviation_m: (3,) standard deviation of the middle along x and y and of the height [m]; yaw_sd_rad
    rms_m: root mean square of the points of its sides; points: fitted"""

    shape: str = field(metadata=reported())
    center_m: FloatArray = field(metadata=reported())
    yaw_rad: float = field(metadata=reported())
    size_m: FloatArray = field(metadata=reported())
    lean_rad: FloatArray = field(metadata=reported())
    deviation_m: FloatArray = field(metadata=reported())
    yaw_sd_rad: float = field(metadata=reported())
    rms_m: float = field(metadata=reported())
    points: int = field(metadata=reported())

    @property
    def T_table_container(self) -> FloatArray:
        """(4, 4) as a standing container, its x axis at `yaw_rad` [m]."""
        from scipy.spatial.transform import Rotation

        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("z", self.yaw_rad).as_matrix()
        pose[:3, 3] = self.center_m
        return pose


@dataclass(frozen=True, slots=True)
class ContainerShift:
    """A container compared with its earlier state. kind: stands, moved, toppled, gone (no upright one is found any
    more) or hidden (unknown); `reason` has the cause

    moved_m: motion of its foot on the table; threshold_m: beyond which it counts as moved; turned_rad; lean_rad: lean
    of its axis"""

    kind: str = field(metadata=reported())
    moved_m: float = field(default=0.0, metadata=reported())
    threshold_m: float = field(default=0.0, metadata=reported())
    turned_rad: float = field(default=0.0, metadata=reported())
    lean_rad: float = field(default=0.0, metadata=reported())
    reason: str = field(default="", metadata=reported())

    @property
    @derived(key=None)
    def changed(self) -> bool:
        """Whether it has changed, by the images."""
        return self.kind not in ("stands", "hidden")

    @property
    @derived(key=None)
    def words(self) -> str:
        """In one line."""
        if self.kind in ("gone", "hidden"):
            return f"{self.kind}: {self.reason}"
        by = f"{1e3 * self.moved_m:.1f} mm (limit {1e3 * self.threshold_m:.1f}), {np.degrees(self.turned_rad):.1f} deg"
        return f"{self.kind}{': ' + self.reason if self.reason else ''}; {by} from its first pose"


@dataclass(frozen=True, slots=True)
class ContainerSighting:
    """The container in depth images that were taken together.

    index: the newest image's place in its stream; images: images of all of them; arm_ns, hand_ns: arm time and hand
    time of the states by which the robot was left out, on the devices' clock; when: before, asked (after a person was
    asked), placed, or after (the squeeze)
    near: it was sought close to its earlier place, where the robot may hide a part of it
    fit: None if it was not found; `refused` states why; change: against before
    edges_px: (n, 2, 2) ends of the found container's edges in the image"""

    index: int
    images: IntArray
    arm_ns: int
    hand_ns: int
    when: str = field(metadata=reported())
    near: bool
    fit: ContainerFit | None = field(metadata=reported())
    refused: str = field(metadata=reported())
    change: ContainerShift | None = field(metadata=reported())
    edges_px: FloatArray

    @property
    def words(self) -> str:
        """The sighting in one line."""
        if self.change is not None:
            return self.change.words
        if self.fit is None:
            return f"not found: {self.refused}"
        size, (x, y) = " x ".join(f"{1e3 * side:.0f}" for side in self.fit.size_m), self.fit.center_m[:2]
        sd_mm = 1e3 * float(self.fit.deviation_m[:2].max())
        return f"a {self.fit.shape} of {size} mm at ({x:.3f}, {y:.3f}) m, deviation {sd_mm:.1f} mm"


@dataclass(frozen=True, slots=True)
class HandPlacement:
    """A grasp, and how the arm reached it.

    by: the arm's model; seed: seed of the drawn grasps, -1 = a person chose this one; along_m, tilt_deg, turn_deg:
    distance along the longest edge, tilt and turn of the grasp (`robot.squeeze_plan.RandomGrasp`)
    T_table_hand, T_hand_container: (4, 4) planned pose of the hand, and of the container in it [m]
    tried: (k, 3) along, tilt and turn of each grasp that was drawn; refused: (k,) why not, empty = this one
    T_table_hands: (k, 4, 4) pose of the hand at each time
    path_m: (n, 3) planned path of the middle between the pads, table's frame
    reached: travel, approach, grasp or retreat: what the arm last came to"""

    by: str = field(metadata=reported())
    seed: int = field(metadata=reported())
    along_m: float = field(metadata=reported())
    tilt_deg: float = field(metadata=reported())
    turn_deg: float = field(metadata=reported())
    T_table_hand: FloatArray = field(metadata=reported())
    T_hand_container: FloatArray = field(metadata=reported())
    tried: FloatArray = field(metadata=reported())
    refused: tuple[str, ...] = field(metadata=reported())
    T_table_hands: FloatArray
    path_m: FloatArray
    reached: str = field(metadata=reported())

    @property
    def reasons(self) -> list[str]:
        """Why grasps were refused, each reason once with how often."""
        return [f"{count} {why}" for why, count in Counter(filter(None, self.refused)).items()]
