"""Record of an arm that places the hand: measurements of the container, and the drawn grasp."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from deformscope.arrays import FloatArray, IntArray
from deformscope.results.declared import reported
from deformscope.stages.squeeze.find import ContainerFit, ContainerShift


@dataclass(frozen=True, slots=True)
class ContainerSighting:
    """The container in depth images that were taken together.

    index: the newest image's place in its stream; images: images of all of them; arm_ns, hand_ns: arm time and hand
    time of the states by which the robot was left out, on the devices' clock; when: before, asked (after a person was
    asked), placed, or after (the squeeze)
    near: it was sought close to its earlier place, where the robot may hide a part of it
    fit: None if it was not found; `refused` states why; change: against before
    edges_px: (n, 2, 2) ends of the found container's edges in the image
    """

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
    reached: travel, approach, grasp or retreat: what the arm last came to
    """

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
