"""Simulated arms behind their own drivers, each with a laboratory's interface: its pose, and pushes."""

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from deformscope.errors import InputError
from deformscope.lab.arm_contact import PushedArm
from deformscope.robot.by_hand import Person, PlaceRequest
from deformscope.robot.placement import Placement, best_joints
from deformscope_drivers.arm import Arm
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.jaco.chains import CHAINS as JACO
from deformscope_drivers.kuka import Kuka, KukaConfig, KukaDouble, UdpWire, open_kuka
from deformscope_drivers.kuka.config import CHAINS as KUKA
from deformscope_drivers.kuka.port import free_port
from deformscope_drivers.manual_arm import ManualArm, ManualArmConfig, StandDouble
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.wires import LOOPBACK

UP = np.array([0.0, 0.0, 1.0])
LOOKS = 5
"""Number of the look at which a simulated person answers."""
ACROSS_SD_M, ALONG_SD_M = 5e-4, 3e-5
"""Accuracy of a person who places a stick laterally, and by the scale of a slide along it. Chosen."""


class ArmBody(PushedArm, Protocol):
    """Pose of a simulated arm (`JacoDouble`)."""

    @property
    def T_base_links(self) -> FloatArray:
        """Poses (k, 4, 4) of its joints and, last, of its end [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmInLab:
    """arm: the driver's device, not opened; body: the moving arm; person: the person who places it; None = an arm with
    motors
    wire: connection of driver and double, to be entered before the arm is opened, None = no thread or process runs"""

    arm: Arm[Any]
    body: ArmBody
    person: Person | None = None
    wire: AbstractContextManager[Any] | None = None


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


def arm_in_lab(
    driver: str,
    config: object,
    placement: Placement,
    places_m: Sequence[FloatArray],
    clock: Clock = monotonic_ns,
    seed: int = 0,
) -> ArmInLab:
    """An arm of a driver and its configuration, at the first of places (3,) of the tip's centre [m, surface frame] from
    which it reaches the others. Raises InputError if it does not reach them, and for an arm without a double there."""
    if driver not in _MADE:
        raise InputError(
            f"an arm of {', '.join(_MADE)} over a [surface] scene", driver, "the real arm, without a scene"
        )
    return _MADE[driver](config, placement, places_m, clock, seed)


def start_deg(chain: Chain, placement: Placement, places_m: Sequence[FloatArray]) -> FloatArray:
    """(n,) joint angles for the first of some places."""
    found = best_joints(chain, [placement.T_base_ee(place_m, UP) for place_m in places_m])
    if found is None:
        raise InputError("a table within the arm's reach", "[surface] T_arm_surface that is not", "move it")
    return found


def _jaco(
    config: JacoConfig, placement: Placement, places_m: Sequence[FloatArray], clock: Clock, seed: int
) -> ArmInLab:
    chain = JACO[config.model or "j2n6s300"]
    double = JacoDouble(chain.name, clock, start_deg=start_deg(chain, placement, places_m))
    return ArmInLab(Jaco(config, double, clock=clock), double)


def _kuka(
    config: KukaConfig, placement: Placement, places_m: Sequence[FloatArray], clock: Clock, seed: int
) -> ArmInLab:
    """On the host's clock behind a port of this host, and answered as a controller is."""
    chain = KUKA[config.model]
    begin_deg = start_deg(chain, placement, places_m)
    double = KukaDouble(chain.name, start_deg=begin_deg, cycle_s=config.cycle_s, again_s=0.5)
    double.sends_currents = True
    if isinstance(clock, SimulatedClock):
        return ArmInLab(Kuka(config, MemoryTransport(double, clock, "simulated KUKA"), clock=clock), double)
    port = free_port()
    here = dataclasses.replace(config, address=LOOPBACK, port=port, controller="")
    return ArmInLab(open_kuka(here), double, wire=UdpWire(double, port))


def _manual(
    config: ManualArmConfig, placement: Placement, places_m: Sequence[FloatArray], clock: Clock, seed: int
) -> ArmInLab:
    arm = ManualArm(config, clock=clock)
    stand = StandDouble(arm.T_base_end_effector)
    return ArmInLab(arm, stand, SimulatedPerson(stand, seed))


_MADE: dict[str, Callable[..., ArmInLab]] = {"jaco": _jaco, "kuka": _kuka, "placed": _manual}
