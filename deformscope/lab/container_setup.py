"""The setup of lab:containers, and the container that a rig's doubles squeeze. Its requested properties
are set, the rest is drawn from the seed.

The laboratory of squeezes with an arm that carries the hand, and a container on a table at an unknown
place: measured by the camera; a hit slides or topples it.

Frames: the table's (z = 0 on it, y away from the arm) is the world's here; `ContainerWorld` squeezes in the hand's."""

import dataclasses
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_CYCLE_NS
from deformscope.lab.container_constants import CONTENTS, TABLE_FRICTION
from deformscope.lab.container_shell import SHAPES, ContainerShape
from deformscope.lab.container_view import PALM, ContainerView, finger_capsules
from deformscope.lab.container_world import TEXEL_M2, ContainerWorld
from deformscope.lab.live_squeeze_lab import NAMES, ContainerCase, SqueezedContainer, SqueezeLab, container_of, members
from deformscope.lab.ray_camera import DepthViewConfig, looking_at
from deformscope.lab.touch_lab import Spoiled
from deformscope.rig.rig_file import Workspace
from deformscope.rig.sections import ContainerSection, HandSection, SqueezeSection
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.description import link_capsules
from deformscope.robot.placement import Placement, best_joints
from deformscope.robot.placing import PlacingSetup, hand_tool
from deformscope.robot.setup import CameraView
from deformscope.robot.squeeze_plan import GripShape, draw_grasp
from deformscope.robot.squeeze_setup import SimulatedContainer, SqueezeNames, SqueezeParts, SqueezeSetup
from deformscope.solid import Capsule, moved, outside_m
from deformscope_drivers.arm.kinematics import Chain, transform
from deformscope_drivers.clock import Clock
from deformscope_drivers.depth_camera import View
from deformscope_drivers.device import Device
from deformscope_drivers.dsa.pads import Pad, Part
from deformscope_drivers.interface import DRIVERS, ArmInLab
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.jaco.chains import J2N6S300
from deformscope_drivers.kuka import Kuka, KukaConfig, KukaDouble
from deformscope_drivers.kuka.config import CHAINS as KUKA
from deformscope_drivers.memory import MemoryTransport
from deformscope_drivers.sdh.double import Port

KINDS = {"box": "cardboard box", "cylinder": "plastic cylinder"}
"""Kinds of containers in words, by form."""
CAMERA_HZ = 30.0
OPEN_DEG, DISTAL_DEG = -24.0, 32.0
"""Angle of the proximal axes: the open fingertips are a centimetre or more from the containers of this laboratory.
Angle of the distal axes: the fingertips lean in by about 15 deg at contact, and press with their first six rows, which
are the feature. Upright ones would press with the middle of their pads."""


@dataclass(frozen=True, slots=True, eq=False)
class ContainerLab:
    """A setup that is not opened, its container, and its laboratory, which has the truth."""

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
    arm: str = "",
) -> ContainerLab:
    """content, container: their names, empty = drawn; session: its number is that of the room's temperature

    camera_hz, alike: as for `SqueezeLab`, `ContainerCase`; arm: `jaco` or `kuka`, which places the hand; empty = none.
    Raises InputError for a content or a container that is not known."""
    content, container = _drawn(content, container, "box", seed)
    shape, _ = container_of(container)
    section = ContainerSection(shape.kind, _size_m(shape), shape.wall.thickness_m, KINDS[shape.kind])
    squeeze = SqueezeSection(open_deg=OPEN_DEG, distal_deg=DISTAL_DEG)
    if arm:
        return _carried(arm, content, container, section, squeeze, _session_number(session), seed, camera_hz)
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


def _carried(
    arm: str,
    content: str,
    container: str,
    section: ContainerSection,
    squeeze: SqueezeSection,
    session: int,
    seed: int,
    camera_hz: float,
) -> ContainerLab:
    """The container is on a table, and an arm carries the hand: the parked thumb is above it."""
    middle = transform(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), GripShape.of(section, squeeze).middle_m)
    section = dataclasses.replace(section, T_hand_container=tuple(tuple(map(float, row)) for row in middle))
    T_base_table = T_BASE_TABLE.get(arm)
    if T_base_table is None:
        raise InputError(f"--place {' or '.join(T_BASE_TABLE)} in lab:containers", repr(arm))
    placement = Placement(T_base_table, hand_tool(T_ARM_HAND, GripShape.of(section, squeeze)))
    lab = CarriedHandLab(arm, placement, ContainerCase(content, container, seed, session), camera_hz)
    lens = lab.view.intrinsics
    setup = SqueezeSetup(
        names=SqueezeNames(*CARRIED_NAMES),
        hand=HandSection(T_arm_hand=tuple(tuple(map(float, row)) for row in T_ARM_HAND)),
        container=section,
        squeeze=squeeze,
        camera=CameraView((lens.fx_px, lens.fy_px), (lens.cx_px, lens.cy_px), rate_hz=camera_hz),
        open_source=lab.source,
        grasp=draw_grasp(section, squeeze, seed),
        T_arm_hand=T_ARM_HAND,
        T_arm_camera=T_base_table @ T_TABLE_CAMERA,
        simulated=True,
        runs_itself=False,
        truth=lab.truth,
        placing=PlacingSetup(lab.chain, placement, workspace_of(T_base_table), {}),
        clock=lab.clock,
        wait_until=lab.wait_until,
    )
    return ContainerLab(setup, content, container, lab)


@dataclass(frozen=True, slots=True, eq=False)
class RigContainer:
    """The container between the doubles of a rig."""

    simulated: SimulatedContainer
    content: str
    container: str


def rig_container(parts: SqueezeParts, content: str, container: str, session: str, seed: int) -> RigContainer:
    """The container that the doubles of a rig file squeeze, on the host's clock; arguments as in `container_lab`.

    Raises InputError for an unknown content, and for a container other than that of `[container]`."""
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
    """The requested content, or a random one if it is empty."""
    random = np.random.default_rng([seed, 0xC0])
    content = content or list(CONTENTS)[int(random.integers(len(CONTENTS)))]
    return content, container or f"{kind}-{int(random.integers(100)):02d}"


def _session_number(session: str) -> int:
    """Number at the end of the session's name; without one, a number made from the name."""
    digits = session.rpartition("-")[2]
    return int(digits) if digits.isdecimal() else zlib.crc32(session.encode())


def _size_m(shape: ContainerShape) -> tuple[float, float, float]:
    x, y, z = (2.0 * float(half_m) for half_m in shape.half_m)
    return x, y, z


T_ARM_HAND: Final = transform(np.eye(3), (0.0, 0.0, 0.02))
"""Pose of the hand on the arm's end: on a plate of 2 cm."""
T_BASE_TABLE: Final = {
    "jaco": transform(Rotation.from_euler("z", 210.0, degrees=True).as_matrix(), (-0.20, -0.50, 0.0)),
    "kuka": transform(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), (0.82, 0.0, 0.0)),
}
"""Pose of the table at which each arm reaches it well; a Jaco's wrist does not reach straight ahead."""
READY_M: Final = (0.0, -0.12, 0.32)
"""First position of the middle between the pads, with the hand level and pointing away from the arm, table's frame."""
SPREAD_M, TURNED_DEG = 0.08, 20.0
"""Half the range along x and y of the container's place, and of its turn. A person sets a carton down with a narrow
side roughly towards the arm."""
CAMERA: Final = DepthViewConfig(distance_m=1.0)
T_TABLE_CAMERA: Final = looking_at(np.array([0.0, 0.0, 0.08]), 1.0, 35.0, 65.0)
"""The camera looks from the far side of the container towards the arm, slightly from the side: the hand comes from
behind."""
ARM_POLL_NS, ALL_POLL_NS = 2_000_000, 10_000_000


class StandingContainer(SqueezedContainer):
    """body: the arm; T_table_container: (4, 4) present pose of the container; toppled

    blind: the camera gives no depth; injected_n: (3,) additional force on the pads of each finger [N]"""

    def __init__(self, arm: ArmInLab, T_base_table: FloatArray, case: ContainerCase, clock: Clock) -> None:
        super().__init__(case, clock, Port.TCP)
        self.body, self._T_table_base = arm.body, np.asarray(np.linalg.inv(T_base_table))
        random = np.random.default_rng([case.seed, 0x1A])
        place = np.array([*random.uniform(-SPREAD_M, SPREAD_M, 2), self.shape.half_m[2]])
        turn = Rotation.from_euler("z", random.uniform(-TURNED_DEG, TURNED_DEG), degrees=True).as_matrix()
        self._stood: FloatArray = transform(turn, place)
        self._gripped: FloatArray | None = None  # the hand's pose for which `world` was made
        self._links: FloatArray | None = None
        self.toppled = self.blind = False
        self.injected_n: FloatArray = np.zeros(3)
        self.view = ContainerView(self.shape, self.world.nodes_m, self._stood, CAMERA, T_TABLE_CAMERA)

    @property
    def T_table_hand(self) -> FloatArray:
        """(4, 4) present pose of the hand [m]."""
        return np.asarray(self._T_table_base @ self.body.T_base_end_effector @ T_ARM_HAND)

    @property
    def T_table_container(self) -> FloatArray:
        if self._gripped is None:
            return self._stood
        return np.asarray(self._gripped @ self.world.T_hand_container)

    def place(self, T_table_container: FloatArray, *, toppled: bool = False) -> None:
        """A person places the container there."""
        self._stood, self._gripped, self.toppled = np.asarray(T_table_container), None, toppled

    def shift(self, x_m: float, y_m: float, turn_deg: float = 0.0) -> None:
        """A person pushes the container aside, and turns it about its axis."""
        pose = self.T_table_container.copy()
        pose[:3, :3] = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix() @ pose[:3, :3]
        pose[:2, 3] += x_m, y_m
        self.place(pose, toppled=self.toppled)

    def topple(self, way: npt.ArrayLike) -> None:
        """Let the container fall over towards a direction (2,) on the table."""
        pose, half_m = self.T_table_container, self.shape.half_m
        out = np.array([*(np.asarray(way, float) / np.linalg.norm(way)), 0.0])
        own = pose[:3, :3].T @ out
        if self.shape.kind == "box":  # over one of its edges
            side = int(np.argmax(np.abs(own[:2])))
            out, own = np.sign(own[side]) * pose[:3, side], np.eye(3)[side]
            wide = half_m[side]
        else:
            wide = half_m[0]
        over = Rotation.from_rotvec(0.5 * np.pi * np.cross([0.0, 0.0, 1.0], out)).as_matrix()
        lying = transform(over @ pose[:3, :3], pose[:3, 3] + out * (wide + half_m[2]))
        lying[2, 3] = wide
        self.place(lying, toppled=True)

    def robot(self) -> list[Capsule]:
        """Arm, hand and fingers at their true pose, table's frame."""
        links = link_capsules(self.body.T_base_links, self._T_table_base)
        angles = np.array([axis.position_deg for axis in self.hand.motion.axes])
        return [*links, *moved([*finger_capsules(angles), PALM], self.T_table_hand)]

    def seen(self) -> View:
        position = np.array([axis.position_deg for axis in self.hand.motion.axes])
        exact = self.view.render(self.world.inward_m(), self.T_table_container, position, self.robot())
        flat = np.abs(exact.facing) < np.sin(np.radians(self.view.config.grazing_deg))
        return View(np.where(flat | self.blind, np.nan, exact.depth_m), exact.color)

    def meet(self) -> None:
        """Called in each of the arm's cycles with motion: objects that the arm hits are pushed aside, or topple if hit
        high."""
        links = self.body.T_base_links
        if self._links is not None and np.array_equal(links, self._links):
            return
        self._links = links
        self._stood, self._gripped = self.T_table_container, None
        pose, half_m = self._stood, np.array(self.shape.half_m)
        robot, shares = self.robot(), np.linspace(0.0, 1.0, 9)[:, None]
        points = np.stack([one.start_m + shares * (one.end_m - one.start_m) for one in robot])
        own = (points - pose[:3, 3]) @ pose[:3, :3]
        apart = outside_m(own, half_m, round=self.shape.kind == "cylinder")
        apart -= np.array([one.radius_m for one in robot])[:, None]
        hits = np.flatnonzero(apart.min(axis=1) < -1e-4)
        if not hits.size:
            return
        first = hits[0], apart[hits[0]].argmin()
        way = pose[:2, 3] - points[first][:2]
        way = way / max(float(np.linalg.norm(way)), 1e-9)
        if not self.toppled and TABLE_FRICTION * points[first][2] > min(self.shape.half_m[:2]):
            self.topple(way)
        else:
            self.shift(*(-apart[first] * way))

    def reach_deg(
        self, position_deg: Sequence[float], wanted_deg: Sequence[float], current_a: Sequence[float], step_s: float
    ) -> Sequence[float]:
        """Like `SqueezedContainer`, around the container at the hand; nothing is pressed elsewhere."""
        hand = self.T_table_hand
        away = np.linalg.inv(hand) @ self.T_table_container
        middle = np.array(finger_capsules(np.array(position_deg))[1].end_m)
        if self.toppled or np.linalg.norm(away[:3, 3] - [0.0, middle[1], middle[2]]) > REACH_M:
            return list(wanted_deg)
        if self._gripped is None:
            if np.array_equal(position_deg, wanted_deg):
                return list(wanted_deg)
            self.world = ContainerWorld(
                self.shape, self.world.content, replace(self.draw, T_hand_container=_aligned(away, self.shape))
            )
            self._gripped = hand
        return super().reach_deg(position_deg, wanted_deg, current_a, step_s)

    def _pressures(self, time_s: float) -> list[npt.NDArray[np.float64]]:
        if self._gripped is None:  # what was pressed before is no longer
            pads = [np.zeros((matrix.cells_y, matrix.cells_x)) for matrix in self.pads.matrices]
        else:
            pads = super()._pressures(time_s)
        for finger, force_n in enumerate(self.injected_n):
            pads[Pad(finger, Part.DISTAL).matrix][:3] += force_n / (3 * pads[1].shape[1] * TEXEL_M2)
        return pads


REACH_M: Final = 0.06
"""A container further from the middle of the hand is not between the fingers."""


def _aligned(T_hand_container: FloatArray, shape: ContainerShape) -> FloatArray:
    """The same body, its x axis along the squeeze: a cylinder is the same turned by anything, a box by half a turn."""
    x = T_hand_container[:3, :3].T @ np.array([1.0, 0.0, 0.0])
    turn = float(np.arctan2(x[1], x[0]))
    if shape.kind == "box":
        turn = np.pi * round(turn / np.pi)
    return np.asarray(T_hand_container @ transform(Rotation.from_euler("z", turn).as_matrix(), np.zeros(3)))


class _Wire(MemoryTransport):
    """A wire whose reader lets the other devices' time pass while it waits, as it does when an arm is opened.

    passes: until a moment [ns]"""

    passes: Callable[[int], None]

    def read(self, timeout_s: float) -> bytes:
        until_ns = self._clock() + round(max(timeout_s, 0.0) * 1e9)
        while not (data := super().read(0.0)) and self._clock() < until_ns:
            self.passes(min(self._clock() + ARM_POLL_NS, until_ns))
        return data


class CarriedHandLab(SqueezeLab):
    """`SqueezeLab` with an arm, `jaco` or `kuka`; arm: its device, not opened; functions: vendor's functions of a Jaco,
    wire: connection of a KUKA, both of which can be disturbed; scheduled: events at moments of the clock"""

    simulated: StandingContainer

    def __init__(self, arm: str, placement: Placement, case: ContainerCase, camera_hz: float) -> None:
        self._driver, self.placement = arm, placement
        self.chain = J2N6S300 if arm == "jaco" else KUKA[KukaConfig().model]
        self.functions: Spoiled | None = None
        self.wire: MemoryTransport | None = None
        self.scheduled: list[tuple[int, Any]] = []
        super().__init__(replace(case, camera=CAMERA), camera_hz)

    def _made(self, case: ContainerCase) -> StandingContainer:
        start_deg = ready_deg(self.chain, self.placement)
        if self._driver == "jaco":
            double = JacoDouble(self.chain.name, self.clock, start_deg=start_deg)
            self.functions = Spoiled(double, self.placement.T_ee_center)
            config = JacoConfig(state_hz=100.0)
            made = ArmInLab(Jaco(config, self.functions, clock=self.clock), double)
        else:
            kuka = KukaDouble(self.chain.name, start_deg=start_deg)
            kuka.sends_currents = True
            wire = _Wire(kuka, self.clock, "simulated KUKA")
            wire.passes, self.wire = super().wait_until, wire
            made = ArmInLab(Kuka(KukaConfig(), wire, clock=self.clock), kuka)
        self.arm = made.arm
        return StandingContainer(made, self.placement.T_base_surface, case, self.clock)

    def open(self) -> None:
        super().open()
        self.wait_until((self.clock() // ARM_CYCLE_NS + 1) * ARM_CYCLE_NS)  # its slots are then those of its double
        self.arm.open(own_thread=False)

    def source(self) -> RigSource:
        """The devices as a source, named as in `NAMES`, and `arm`."""
        arm = RigMember("arm", DRIVERS[self._driver], self.arm, simulated=True)
        return RigSource([*members(*self._three), arm], clock=self.clock, opener=self.open)

    def schedule(self, moment_ns: int, action: Any) -> None:
        """Call a function at a time of the clock."""
        self.scheduled.append((moment_ns, action))
        self.scheduled.sort(key=lambda one: one[0])

    def wait_until(self, until_ns: int) -> None:
        arm_ns = ARM_CYCLE_NS if self._driver == "jaco" else ARM_POLL_NS
        while (now_ns := self.clock()) < until_ns:
            self.clock.advance_to(min((now_ns // arm_ns + 1) * arm_ns, until_ns))
            while self.scheduled and self.scheduled[0][0] <= self.clock():
                self.scheduled.pop(0)[1]()
            self._poll([self.arm])
            if now_ns // ALL_POLL_NS != self.clock() // ALL_POLL_NS:
                self.simulated.meet()
                self.simulated.hand.position_deg(self.clock())
                self._poll(self._three)

    @property
    def _devices(self) -> tuple[Device[Any], ...]:
        return (*self._three, self.arm)


def ready_deg(chain: Chain, placement: Placement) -> FloatArray:
    """(n,) first joint angles of the arm."""
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # the hand's y axis down, its z away
    poses = []
    for height_m in (READY_M[2], 0.5 * READY_M[2] + 0.05):
        tip = transform(level, (*READY_M[:2], height_m))
        poses.append(placement.T_base_surface @ tip @ np.linalg.inv(placement.T_ee_center))
    found = best_joints(chain, poses)
    assert found is not None
    return found


LOW_M, HIGH_M = (-0.35, -0.50, 0.03), (0.35, 0.35, 0.70)
"""Range of the middle between the pads, table's frame."""


def workspace_of(T_base_table: FloatArray) -> Workspace:
    """The limits of the laboratory's arm: a box in its base frame."""
    sides = np.stack(np.meshgrid(*zip(LOW_M, HIGH_M, strict=True)), axis=-1).reshape(-1, 3)
    corners = sides @ T_base_table[:3, :3].T + T_base_table[:3, 3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    return Workspace(low_m=tuple(map(float, low)), high_m=tuple(map(float, high)))  # type: ignore[arg-type]


CARRIED_NAMES: Final = (*NAMES, "arm")
