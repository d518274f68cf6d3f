"""Simulated arms behind their own drivers, at a first place over a table; a simulated person who places one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.errors import InputError
from deformscope.robot.by_hand import Person, PlaceRequest
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.placement import Placement, best_joints
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.interface import DRIVERS, ArmInLab
from deformscope_drivers.manual_arm import StandDouble

UP = np.array([0.0, 0.0, 1.0])
LOOKS = 5
"""Number of the look at which a simulated person answers."""
CLEAR_M = 0.03
"""Height of elbow and wrist over the table at the first places: above the least that a preflight accepts."""
ACROSS_SD_M, ALONG_SD_M = 5e-4, 3e-5
"""Accuracy of a person who places a stick laterally, and by the scale of a slide along it. Chosen."""


class SimulatedPerson:
    """Places a stand at requested places, with the errors of a person. asked: every request, in its order"""

    def __init__(self, stand: StandDouble, seed: int = 0) -> None:
        self.asked: list[PlaceRequest] = []
        self._stand, self._looks = stand, 0
        self._random = np.random.default_rng([seed, 0x4A])

    def ask(self, request: PlaceRequest) -> None:
        self.asked.append(request)
        self._looks = 0

    def answered(self) -> str | None:
        self._looks += 1
        if self._looks < LOOKS:
            return None
        T = self.asked[-1].T_base_ee.copy()
        T[:3, 3] += T[:3, :3] @ (self._random.standard_normal(3) * (ACROSS_SD_M, ACROSS_SD_M, ALONG_SD_M))
        self._stand.put(T)
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedArm(ArmInLab):
    """person: the person who places it; None = an arm with motors"""

    person: Person | None = None


def arm_in_lab(
    driver: str,
    config: object,
    placement: Placement,
    places_m: Sequence[FloatArray],
    clock: Clock = monotonic_ns,
    seed: int = 0,
) -> PlacedArm:
    """An arm of a driver and its configuration, at the first of places (3,) of the tip's centre [m, surface frame] from
    which it reaches the others. Raises InputError if it does not reach them, and for an arm without a double there."""
    known = DRIVERS[driver]
    if known.in_lab is None:
        able = ", ".join(one.name for one in DRIVERS.of_kind("arm") if one.in_lab is not None)
        raise InputError(f"an arm of {able} over a [surface] scene", driver, "the real arm, without a scene")
    chain = known.chain(config)
    made = known.in_lab(config, None if chain is None else start_deg(chain, placement, places_m), clock)
    person = SimulatedPerson(made.body, seed) if isinstance(made.body, StandDouble) else None
    return PlacedArm(made.arm, made.body, made.wire, made.faults, person)


def start_deg(chain: Chain, placement: Placement, places_m: Sequence[FloatArray]) -> FloatArray:
    """(n,) joint angles for the first of some places."""
    clearance = ArmClearance(placement, chain.forward(chain.home_deg))

    def free(joints_deg: FloatArray) -> bool:
        links = chain.forward(joints_deg)
        return clearance.over_table_m(links) > CLEAR_M and clearance.to_itself_m(links) > 0.0

    found = best_joints(chain, [placement.T_base_ee(place_m, UP) for place_m in places_m], free=free)
    if found is None:
        raise InputError("a table within the arm's reach", "[surface] T_arm_surface that is not", "move it")
    return found
