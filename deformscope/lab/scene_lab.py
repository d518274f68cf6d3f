"""A simulated scene to explore: finite element foam under an arm, a force sensor and a depth camera, on one clock.

A slab that creeps: `SlabWorld` with a memory, in which all moduli relax by the same share.

    world = CreepingWorld(scene, Relaxation((0.3,), (1.0,)))
    world.at(0.01); world.press(tip, center_m)         # from rest, at a time [s]
    world.at(0.02); world.press(tip, center_m) # forces decay while the tip is at rest

The foam is a generalised Maxwell solid, E(t) = E0 (1 - sum g_i + sum g_i exp(-t / t_i)), with constant Poisson's ratio.
Then a touch depends only on the elastic stiffness K of the nodes that a tip may touch, and

    f = (1 - sum g_i) K u + sum_i q_i,      dq_i/dt = g_i K du/dt - q_i / t_i

holds for them exactly, those outside the tip included (their f is 0, and their dent recovers slowly). Over a step in
which u moves evenly this is f = A K u + h with a number A and a known h. Therefore each step is the complementarity
problem of an elastic press with compliance C / A.

Foam with a permanent share of every dent is pressed not from its rest but from its set: f = A K (u - u_p) + h, with u_p
at each node the same share of its greatest depth. On the approach the foam has a modulus that is lower by that share.
On the retract it has its full stiffness, and the tip leaves it at u_p.

Not modelled: foams of different relaxation within the reach of one touch (each touch creeps as the foam below the tip's
middle). The memory of a place is lost if the tip slides further than its mesh allows.

The foam slab with a ball of another material in it: finite elements on two scales.

    world = slab_world(built_in("buried", seed=3))      # `SlabWorld` where nothing is buried
    world.press(tip, center_m)                          # as any

A contact at the tip's scale needs elements of 1.5 mm, which are too small for a mesh as large as an inclusion's effect.
So the surface's compliance is that of the patch without the ball (`slab_world`), plus the ball's change of it. The
change is the difference of two solutions of the whole slab on one mesh, with and without the ball. Its elements are 5
mm around the ball, and wider elsewhere. That difference is smooth, since the ball lies a centimetre deep or more, and
its mesh's errors at the surface are the same in both. The two are factorised once for a slab; a press then costs no
more than without a ball. `tests/lab/test_buried_world.py` compares with one fine mesh of slab and ball."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator, make_interp_spline
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex1, MeshHex

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
from deformscope.lab.arms import arm_in_lab, start_deg
from deformscope.lab.depth_view import DepthView
from deformscope.lab.elasticity import dissected, stiffness_of
from deformscope.lab.plateau_world import PlateauWorld
from deformscope.lab.ray_camera import DepthViewConfig
from deformscope.lab.scenes import BuriedBall, Scene
from deformscope.lab.session_errors import LabErrors
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import Contact, Patch, SlabWorld
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.rig.sections import CableSection, ShapeSection
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.description import AS_CAPSULES, Removal, RobotDescription, arm_shape, describe
from deformscope.robot.placement import Placement
from deformscope.robot.setup import T_BASE_SURFACE, CameraView, Setup, Truth
from deformscope.solid import Capsule, PosedSolid
from deformscope_drivers.arm.kinematics import transform
from deformscope_drivers.arm.wrench import ArmWrenchConfig
from deformscope_drivers.depth_camera import SENSORS, View
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig
from deformscope_drivers.device import Device
from deformscope_drivers.interface import DRIVERS, DeviceDriver
from deformscope_drivers.jaco.chains import J2N6S300
from deformscope_drivers.jaco.config import JacoConfig
from deformscope_drivers.memory import SimulatedClock


@dataclass(frozen=True, slots=True)
class Relaxation:
    """How a foam's modulus relaxes. shares: shares of the instantaneous modulus, by branch, together below 1; times_s:
    each branch's relaxation time; keeps: share of each dent that is permanent"""

    shares: tuple[float, ...] = ()
    times_s: tuple[float, ...] = ()
    keeps: float = 0.0

    def __post_init__(self) -> None:
        alike = len(self.shares) == len(self.times_s)
        if not (alike and min((*self.shares, *self.times_s, 1.0)) > 0.0 and sum(self.shares) < 1.0):
            raise InputError("shares above 0, together below 1, each with a time above 0 s", f"{self}")
        if not 0.0 <= self.keeps < 1.0:
            raise InputError("a permanent share of a dent, from 0 to below 1", f"{self.keeps}")

    @property
    def share(self) -> float:
        """Share of the modulus that relaxes, in all branches together."""
        return sum(self.shares)


class CreepingWorld(SlabWorld):
    """A scene's foam with a memory."""

    def __init__(self, scene: Scene, relaxation: Relaxation | Callable[[FloatArray], Relaxation]) -> None:
        """relaxation: relaxation of all foam, or of the foam at a place (2,) [m]"""
        super().__init__(scene)
        self._relaxation = relaxation if callable(relaxation) else lambda xy_m: relaxation
        self._now_s = 0.0
        self._step_s = 0.0
        self._memory: _Memory | None = None

    def at(self, time_s: float) -> None:
        """Set the time of the next press [s]. The last of several presses at one time counts. Without a press since the
        last time, nothing touched the foam."""
        if time_s < self._now_s:
            raise InputError("a time not before the last", f"{time_s:g} s after {self._now_s:g} s")
        if time_s > self._now_s:
            if self._memory is not None:
                self._memory.settle(self._step_s)
            self._step_s = time_s - self._now_s
            self._now_s = time_s

    def press(self, tip: RigidTip, center_m: FloatArray) -> Contact:
        """Like `SlabWorld.press`, center_m: (3,) [m]; the dent recovers when the tip has left the foam."""
        contact = super().press(tip, center_m)
        if contact.mesh_m is None and self._memory is not None:
            patch = self._memory.patch
            load_n = self._memory.moves_n(self._memory.untouched_n(self._step_s))
            node = np.flatnonzero(load_n)
            place = patch.candidate_m[node]
            return replace(contact, place_m=place, node_force_n=load_n[node], mesh_m=patch.xy_m, node=node)
        return contact

    def _push_out(self, patch: Patch, overlap: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._memory is None or self._memory.patch is not patch:
            self._memory = _Memory(patch, self._relaxation(patch.xy_m))
        return self._memory.press(overlap, self._step_s)


class _Memory:
    """Memory of one patch: the forces of its nodes without relaxation, K (u - u_p) (n,) [N]; each node's greatest depth
    and permanent part, u_p, (n,) [m]; K u_p [N]"""

    def __init__(self, patch: Patch, relaxation: Relaxation) -> None:
        self.patch = patch
        self._share, self._time_s = np.array(relaxation.shares), np.array(relaxation.times_s)
        self._elastic_n: FloatArray = np.zeros(len(patch.candidate_m))
        self._branch_n: FloatArray = np.zeros((len(self._share), len(patch.candidate_m)))
        self._next_n: FloatArray | None = None
        self._keeps = relaxation.keeps
        self._deepest_m, self._set_m, self._set_n = (np.zeros(len(patch.candidate_m)) for _ in range(3))
        self._compliance = cho_factor(patch.compliance) if self._keeps else None

    def press(self, overlap: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
        """(n,) forces after a step [N], and (n,) the elastic ones that move the surface as much."""
        stiff, known_n, _, _ = self._law(step_s)
        over = overlap - self._set_m + self.patch.compliance @ known_n / stiff
        force_n = self.patch.push_out(over, 1.0 / stiff)
        self._next_n = (force_n - known_n) / stiff
        return force_n, self.moves_n(self._next_n)

    def moves_n(self, elastic_n: FloatArray) -> FloatArray:
        """(n,) the forces that would move elastic foam equally, with its permanent set [N]."""
        return elastic_n + self._set_n

    def settle(self, step_s: float) -> None:
        """The step happens as it was pressed last, or with nothing on the foam."""
        _, _, left, even = self._law(step_s)
        next_n = self._next_n if self._next_n is not None else self.untouched_n(step_s)
        self._branch_n = left[:, None] * self._branch_n + (self._share * even)[:, None] * (next_n - self._elastic_n)
        self._elastic_n, self._next_n = next_n, None
        if self._compliance is not None:
            self._deepest_m = np.maximum(self._deepest_m, self.patch.compliance @ next_n + self._set_m)
            self._set_m = self._keeps * self._deepest_m
            self._set_n = cho_solve(self._compliance, self._set_m)

    def untouched_n(self, step_s: float) -> FloatArray:
        """(n,) the elastic forces after a step with nothing on the foam [N]."""
        stiff, known_n, _, _ = self._law(step_s)
        self._next_n = None
        return -known_n / stiff

    def _law(self, step_s: float) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """A and h (n,) of a step, each branch's remaining share over it, and its mean over it for a uniform load."""
        over = step_s / self._time_s
        left, even = np.exp(-over), np.where(over > 1e-9, -np.expm1(-over) / np.maximum(over, 1e-9), 1.0)
        stiff = float(1.0 - self._share.sum() + (self._share * even).sum())
        known_n = left @ self._branch_n - float((self._share * even).sum()) * self._elastic_n
        return stiff, known_n, left, even


# The robot that the laboratory's camera sees: a URDF of meshes, with a gripper, a stick and a cable.
#
# Like a real robot it differs from its description: its fingers are closed by a few degrees more or less. Its cable
# hangs and sways, while the description has lines with a radius

FOLDER = Path(__file__).parent / "robots"
URDF = "j2n6s300-stick.urdf"
CLOSED = 0.62
"""How far the fingers are closed on the stick's neck."""
CLOSED_OFF = 0.03
"""Deviation of the fingers' closing: 2.6 degrees."""
CABLE_M = (
    (0.010, -0.004, 0.062),
    (0.048, -0.018, 0.052),
    (0.095, -0.036, 0.000),
    (0.090, -0.032, -0.070),
    (0.038, -0.010, -0.120),
)
"""From the force sensor before the ball up to the palm, in the frame of the arm's end [m]."""
CABLE_RADIUS_M = 0.003
SAG_M, SWAY_M = 0.004, 0.004
"""How far its middle hangs below these places, and deviations of where it sways to, along each axis."""
CABLE_PIECES = 20


def described_robot(removal: Removal | None = None) -> RobotDescription:
    """The [shape] that a careful user would write for this robot: the cable's radius includes sag and sway."""
    cable = CableSection(CABLE_M, CABLE_RADIUS_M + SAG_M + 2.0 * SWAY_M)
    return describe(ShapeSection(removal, URDF, closed=CLOSED, cables=(cable,)), J2N6S300, FOLDER)


class RobotBody:
    """One robot. closed: how far its fingers truly are"""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng([seed, 0xB0D])
        self.closed = float(np.clip(CLOSED + CLOSED_OFF * self._random.standard_normal(), 0.0, 1.0))
        section = ShapeSection(urdf=URDF, closed=self.closed)
        self._truth: RobotDescription = describe(section, J2N6S300, FOLDER)

    def seen(
        self, placement: Placement, T_base_links: NDArray[np.float64], center_m: NDArray[np.float64]
    ) -> tuple[tuple[Capsule, ...], tuple[PosedSolid, ...]]:
        """What a camera sees of the robot, surface frame: first stick, ball and cable, then all other parts.

        T_base_links: (k, 4, 4) poses of joints and end; center_m: (3,) measured centre of the tip, which a push moves
        away from that of the chain"""
        stick = arm_shape(placement, T_base_links, center_m, description=self._truth)
        # capsules along the cable, which hangs between its ends and sways differently in each picture.
        # T_base_links: (k, 4, 4) [m]
        T = placement.T_surface_base @ T_base_links[-1]
        along = np.linspace(0.0, 1.0, CABLE_PIECES + 1)
        knots = np.linspace(0.0, 1.0, len(CABLE_M))
        way = make_interp_spline(knots, np.array(CABLE_M) @ T[:3, :3].T + T[:3, 3])(along)
        sway = np.clip(self._random.standard_normal(3), -2.0, 2.0) * SWAY_M
        way += np.sin(np.pi * along)[:, None] * (sway - (0.0, 0.0, SAG_M))
        return (*stick, *tuple(Capsule(a, b, CABLE_RADIUS_M) for a, b in pairwise(way))), self._truth.solids(
            placement, T_base_links
        )


CAMERA_HZ = 10.0
CREEP_S = 1.0
"""Time constant of foam that creeps."""
CAMERA_AZIMUTH_DEG = -90.0
"""The camera looks across the long edge at y = 0. The arm is beyond the opposite edge."""
BOX_LOW_M, BOX_HIGH_M = (-0.40, -0.66, 0.0), (0.45, 0.10, 0.75)
"""Range of the tip, in the base frame: above the table, and to the arm's parking place."""
T_BASE_AHEAD = transform(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), (0.75, -0.30, 0.0))
AHEAD_BOX_M = (0.15, -0.45, 0.0), (0.90, 0.45, 0.75)
"""The same for other arms, which reach the table straight ahead, from further away."""


def _arm_driver(name: str) -> DeviceDriver:
    """Raises InputError for a driver without an arm that moves on commands and has a double for a laboratory."""
    known = {one.name: one for one in DRIVERS.of_kind("arm") if one.in_lab is not None and one.chains()}
    if name not in known:
        raise InputError(f"--arm {', '.join(known)}", name, "pip install the package of its driver")
    return known[name]


class SceneLab:
    """The laboratory with a scene in it, not opened. lab: its devices and faults; setup: setup with which it is
    explored; drawn: errors that the seed drew, hidden from the exploration"""

    def __init__(
        self,
        scene: Scene,
        *,
        tip_radius_m: float,
        parked_m: float,
        seed: int = 0,
        errors: LabErrors | None = None,
        sensor: str = "",
        robot: RobotBody | None = None,
        described: RobotDescription = AS_CAPSULES,
        travel_speed_m_s: float = 0.05,
        arm: str = "",
        own_wrench: ArmWrenchConfig | None = None,
        tool: Tool | None = None,
    ) -> None:
        """parked_m: first z of the tip's centre [m, surface frame]; errors: distributions of its hidden errors, default
        none; sensor: sensor of SENSORS, the camera's error model, empty = noise alone
        robot: that the camera sees, None = capsules; described: the known description of its shape; travel_speed_m_s:
        between touches; arm: driver of the arm, whose double stands there in place of a Jaco; own_wrench, tool: the
        arm's own force in place of the force sensor, and its deviations"""
        self._robot, self._described = robot, described
        self._driver, self._own_wrench = arm or "jaco", own_wrench
        arm = "" if arm == "jaco" else arm
        low_m, high_m = AHEAD_BOX_M if arm else (BOX_LOW_M, BOX_HIGH_M)
        self._workspace = Workspace(low_m=low_m, high_m=high_m, travel_speed_m_s=travel_speed_m_s)
        self.drawn = (errors or LabErrors.none()).draw([seed, scene.seed])
        foam = self.drawn.foam(scene)
        self.scene = scene = self.drawn.slab(scene)
        self.clock = SimulatedClock(1_000_000_000)
        self._world = slab_world(foam)
        if any(piece.relaxes or piece.keeps for piece in scene.pieces):
            self._world = CreepingWorld(foam, self._relaxation)
            if any(piece.plateau_exponent for piece in scene.pieces):
                raise InputError("foams that yield, or that creep", scene.name, "two-60y20-150y20, two-60c30-150")
        self._tip = RigidTip(radius=tip_radius_m * self.drawn.tip)
        self._contact: Contact | None = None
        self._dent: tuple[Contact | None, FloatArray | None] = None, None  # as a camera last saw it
        view = DepthViewConfig(width=320, height=240, azimuth_deg=CAMERA_AZIMUTH_DEG)
        self.view = DepthView(scene, view)
        # a tip's centre above that touches nothing, on slopes up to 40 degrees too
        self._high_m = float(scene.foam_height_m(self.view.places_m).max()) + 2.5 * tip_radius_m * self.drawn.tip
        tool = dataclasses.replace(tool or Tool(), radius_m=tip_radius_m)
        self.placement = Placement(T_BASE_AHEAD if arm else T_BASE_SURFACE, tool)
        parked = np.array([scene.size_m[0] / 2, scene.size_m[1] / 2, parked_m])
        touching = np.array([*parked[:2], scene.thickness_m])
        other = None
        if arm:
            config = dataclasses.replace(_arm_driver(arm).config(), linear_limit_m_s=travel_speed_m_s)
            other = arm_in_lab(arm, config, self.placement, (parked, touching), self.clock, seed)
        self.lab = TouchLab(
            self,
            self.clock,
            tool=tool,
            T_base_surface=self.placement.T_base_surface,
            arm_stiffness_n_m=self.drawn.arm_n_per_m,
            sensed=self.drawn.sensed,
            arm_config=JacoConfig(state_hz=100.0, linear_limit_m_s=travel_speed_m_s),
            view=self._see,
            camera_config=SyntheticDepthConfig(
                rate_hz=CAMERA_HZ,
                missing=0.02,
                seed=seed,
                intrinsics=self.view.intrinsics,
                sensor=SENSORS[sensor] if sensor else None,
            ),
            arm=other,
            start_deg=None if arm else start_deg(J2N6S300, self.placement, (parked, touching)),
            seed=seed,
            goes_on=isinstance(self._world, CreepingWorld),
            own_wrench=own_wrench,
        )

    @property
    def setup(self) -> Setup:
        """The setup; its arm has the compliance that a calibration on a rigid block would give."""
        intrinsics = self.view.intrinsics
        return Setup(
            size_m=self.scene.size_m,
            placement=self.placement,
            workspace=self._workspace,
            camera=CameraView(
                (intrinsics.fx_px, intrinsics.fy_px),
                (intrinsics.cx_px, intrinsics.cy_px),
                T_surface_camera=self.view.T_world_camera,
                rate_hz=CAMERA_HZ,
            ),
            open_source=self._source,
            names=("arm", "tip", "camera"),
            compliance_m_per_n=1.0 / ARM_STIFFNESS_N_M,
            compliance_sd=ARM_DOUBT / ARM_STIFFNESS_N_M,
            calibrated={"camera to surface": True, "arm's compliance": True},
            simulated=True,
            truth=Truth(self.scene.regions, self.scene.inclusions_m),
            runs_itself=False,
            zeroed=True,
            true_force_n=lambda: self.lab.contact.max_force_n,
            clock=self.clock,
            wait_until=self.lab.wait_until,
            described=self._described,
            press=lambda force_n: self.lab.push_tip(np.asarray(force_n, np.float64)),
            own_wrench=self._own_wrench,
        )

    def _relaxation(self, xy_m: FloatArray) -> Relaxation:
        """Relaxation of the foam at a place (2,) in the surface frame [m]."""
        label = int(self.scene.label(xy_m))
        if label < 0:
            return Relaxation()
        relaxes, keeps = self.scene.pieces[label].relaxes, self.scene.pieces[label].keeps
        return Relaxation((relaxes,), (CREEP_S,), keeps) if relaxes else Relaxation(keeps=keeps)

    def press(self, center_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Force (3,) [N] of the slab on a tip at (3,) [m], in the surface frame: the interface of `TouchLab` to a
        world."""
        if isinstance(self._world, CreepingWorld):
            self._world.at(1e-9 * self.clock())
        elif center_m[2] > self._high_m:
            self._contact = None
            return np.zeros(3)
        elif self._contact is not None and np.array_equal(center_m, self._contact.center_m):
            return np.asarray(self._contact.force_n, np.float64)
        self._contact = self._world.press(self._tip, center_m)
        return np.asarray(self._contact.force_n, np.float64)

    def _source(self) -> RigSource:
        """The devices as a source; entering it opens the laboratory."""
        devices: dict[str, tuple[str, Device[Any]]] = {
            "arm": (self._driver, self.lab.arm),
            "tip": ("optoforce" if self._own_wrench is None else "arm", self.lab.force),
        }
        if self.lab.camera is not None:
            devices["camera"] = ("depth_camera", self.lab.camera)
        members = [RigMember(name, DRIVERS[driver], device, True) for name, (driver, device) in devices.items()]
        return RigSource(members, clock=self.clock, opener=self.lab.open)

    def _see(self, time_s: float) -> View:
        """The camera's present view: the pressed slab, the arm in its pose."""
        if self._contact is not self._dent[0]:
            moved = None
            if self._contact is not None and len(self._contact.node):
                moved = self._world.displaced_m(self._contact, self.view.places_m)
            self._dent = self._contact, moved
        exact = self.view.render(self._dent[1], *self._seen(self.lab.body.T_base_links, self.lab.contact.center_m))
        return View(exact.depth_m, exact.color)  # the camera adds its own noise

    def _seen(
        self, T_base_links: NDArray[np.float64], center_m: NDArray[np.float64]
    ) -> tuple[tuple[Capsule, ...], tuple[PosedSolid, ...]]:
        """The robot as it is before the camera."""
        if self._robot is None:
            return arm_shape(self.placement, T_base_links, center_m), ()
        return self._robot.seen(self.placement, T_base_links, center_m)


ELEMENT_M, AROUND, GROWTH = 0.005, 1.5, 1.5
"""Size of the elements around the ball, up to this multiple of its radius from its middle, and their growth beyond."""
UPPER_M = 0.0025
"""Thickness of the uppermost two layers of elements."""
SAMPLES = 4
"""Samples of the modulus along each side of an element."""


def slab_world(scene: Scene) -> SlabWorld:
    """A scene's foam, which can be pressed anywhere."""
    if scene.buried is not None:
        return BuriedWorld(scene, scene.buried)
    return PlateauWorld(scene) if any(piece.plateau_exponent for piece in scene.pieces) else SlabWorld(scene)


class BuriedWorld(SlabWorld):
    """A scene's foam with a ball in it."""

    def __init__(self, scene: Scene, ball: BuriedBall) -> None:
        super().__init__(scene)
        self._change = BallCompliance(scene, ball)

    def _made(self, xy_m: FloatArray, reach_m: FloatArray, fine_m: FloatArray) -> Patch:
        patch = super()._made(xy_m, reach_m, fine_m)
        patch.compliance += self._change.between(patch.candidate_m[:, :2], patch.candidate_m[:, :2])
        return patch

    def displaced_m(self, contact: Contact, xy_m: FloatArray) -> FloatArray:
        """(..., 3) displacements at places (..., 2) [m], as in `SlabWorld.displaced_m`; the ball's change is vertical
        only."""
        moved = super().displaced_m(contact, xy_m)
        if len(contact.node):
            inside = ((xy_m >= 0.0) & (xy_m <= self.scene.size_m)).all(axis=-1)
            change = self._change.between(np.asarray(xy_m)[inside], contact.place_m[:, :2])
            moved[inside, 2] -= change @ contact.node_force_n
        return moved


class BallCompliance:
    """How much more compliant a ball makes the surface of a slab: below 0 for a stiff ball.

    x_m, y_m: (n,), (m,) x and y of the mesh; change: (n m, n m) additional displacement down of each of its nodes for a
    unit push down on each, y fastest [m/N]"""

    def __init__(self, scene: Scene, ball: BuriedBall) -> None:
        half = AROUND * ball.radius_m
        self.x_m, self.y_m = (
            np.array(_borders(middle, half, side)) for middle, side in zip(ball.centre_m, scene.size_m, strict=True)
        )
        bottom = scene.thickness_m - ball.depth_m - 2.0 * ball.radius_m
        # (n,) element borders along z [m]: even from the surface to below the ball, farther apart below.
        depths, step = [0.0, UPPER_M, 2.0 * UPPER_M], ELEMENT_M
        while depths[-1] < scene.thickness_m:
            if depths[-1] > scene.thickness_m - bottom:
                step *= GROWTH
            depths.append(depths[-1] + step)
        z_m = scene.thickness_m * (1.0 - np.array(depths[::-1]) / depths[-1])
        mesh = MeshHex.init_tensor(self.x_m, self.y_m, z_m)
        basis = Basis(mesh, ElementHex1(), intorder=2)
        # (E,), (E,) modulus of each element, (3, 8, E) its corners [m], without the ball and with it. Elements on
        # its rim have the mean of evenly strained and evenly stressed parts (Hill 1952)
        corner_m = mesh.p[:, mesh.t]
        low, side = corner_m.min(axis=1), np.ptp(corner_m, axis=1)
        share = (np.arange(SAMPLES) + 0.5) / SAMPLES
        spots = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 1, 3)
        places = low.T + spots * side.T
        foam = scene.modulus_pa(places[..., :2])
        middle = np.array([*ball.centre_m, scene.thickness_m - ball.depth_m - ball.radius_m])
        inside = np.linalg.norm(places - middle, axis=-1) < ball.radius_m
        filled = np.where(inside, ball.modulus_pa, foam)
        foam, filled = foam.mean(axis=0), 0.5 * (filled.mean(axis=0) + 1.0 / (1.0 / filled).mean(axis=0))
        axes = (self.x_m, self.y_m, z_m)
        self.change = _surface_compliance(basis, filled, scene.poisson, axes) - _surface_compliance(
            basis, foam, scene.poisson, axes
        )

    def between(self, there_m: FloatArray, pushed_m: FloatArray) -> FloatArray:
        """(n, m) compliance at places (n, 2) for pushes on places (m, 2), all on the slab [m/N]."""
        shape = len(self.x_m), len(self.y_m)
        axes = (self.x_m, self.y_m)
        along = RegularGridInterpolator(axes, self.change.reshape(*shape, -1))(there_m)
        return np.asarray(RegularGridInterpolator(axes, np.moveaxis(along.reshape(-1, *shape), 0, -1))(pushed_m).T)


def _surface_compliance(
    basis: Basis, modulus_pa: FloatArray, poisson: float, axes: tuple[FloatArray, ...]
) -> FloatArray:
    """(n, n) how far down each node of the upper face goes for a unit push down on each, y fastest [m/N]."""
    place = np.empty((basis.N, 3))
    place[basis.nodal_dofs[0]] = basis.mesh.p.T
    stiffness = stiffness_of(basis, modulus_pa, np.full(len(modulus_pa), poisson))
    upper = np.flatnonzero(np.abs(place[:, 2] - axes[2][-1]) < 1e-9)
    last = 3 * upper[np.lexsort(place[upper, 1::-1].T)] + 2
    free = np.setdiff1d(np.flatnonzero(np.repeat(place[:, 2] > 1e-9, 3)), last)
    order = np.concatenate([free[dissected(place[free // 3], axes)], last])
    own = stiffness[order][:, order].tocsc()
    factors = splu(own, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    # what elimination leaves at the last unknowns is their stiffness with all others free (Schur complement)
    lower, upward = (part[-len(last) :, -len(last) :].toarray() for part in (factors.L, factors.U))
    left = lower @ upward
    return np.asarray(cho_solve(cho_factor(0.5 * (left + left.T)), np.eye(len(last))))


def _borders(middle: float, half: float, side: float) -> FloatArray:
    """(n,) element borders along one axis of the slab [m]: even around the middle, farther apart beyond."""
    count = int(np.ceil(half / ELEMENT_M))
    outer, step = [count * ELEMENT_M], ELEMENT_M
    while outer[-1] < side:
        step *= GROWTH
        outer.append(outer[-1] + step)
    every = middle + np.concatenate([-np.array(outer[:0:-1]), np.arange(-count, count + 1) * ELEMENT_M, outer[1:]])
    inner = every[(every > 0.4 * ELEMENT_M) & (every < side - 0.4 * ELEMENT_M)]
    return np.concatenate([[0.0], inner, [side]])
