"""A container between two fingertips: wall, filling and pads in balance, step by step.

Unknowns of a step are the inward displacements of the wall under each texel, their means over the filling's patches,
the volume that the walls take from the gas, and the container's slide on its table. They follow from the forces by the
shell's compliance (`container_shell`), and the forces from them:

- texel: its foam cover is compressed by the pad's depth within the wall: pressure = stiffness x that, or 0;
- patch and gas: as the filling resists (`Gas`, `Patches`);
- table: Coulomb's friction with the container's weight, whichever finger pushes more.
A few Newton steps on some 60 active unknowns solve it. A joint of a finger moves on only while the contact's torque
about it (virtual work: sum of forces x d depth / d angle) is within its motor's torque; gears hold the reached angle.

Texels keep the place on the wall where they were when their finger came near. Not modelled: friction of the pads,
rotation of the container under the squeeze, the shape of the dent under a single texel.

The content acts on the walls by gas above and within it, and by a resistance behind each patch of wall.

Gas: the rest of the closed container is air at one temperature. When the walls move inwards by a volume V, its pressure
over the outside becomes p0 (T / T0) Vg / (Vg - V) - p0. A liquid passes it on to every wall.

Patches: the content resists a wall that moves inwards by w with a traction q [Pa] above its value at rest. It is
elastic (q_e = k (w - w_p)) until it yields, and then flows or fails, with a viscous part (Perzyna):

    q = q_y(w_p) + N K (dw_p/dt / l)^n  while w_p grows,     q_y(w_p) = q_1 w_p / (w_p + a)

- granular: k = chi_u s / l on unloading, and the first loading (slope q_1 / a) is softer, chi_l s / l in all (EN 1991-4
  annex C: modulus = chi x stress). q_1 is the passive earth pressure K_p sigma_v + 2 c sqrt(K_p) less that at rest
  (Rankine), so that failure needs more at depth, and flour's cohesion adds to it. Unloading follows k: hysteresis. For
  flour the softer first loading is its compaction.
- yogurt: k = 3 G / l (incompressible), q_1 = N tau_y at once (a = 0), then Herschel-Bulkley's K and n.
- water: no yield, n = 1: only its viscosity, which is negligible at this speed (about 1e-3 Pa).
Here l is half the container's width along the squeeze, N = 2 + pi bears on shear (Prandtl), s the stress half way to
q_1. Unloading beyond rest is limited by the active pressure, so that no content pulls at a wall.

Not modelled: waves and inertia (rho v^2 is 1 Pa), flow of a granular filling along the container, settling between
squeezes, the shape of grains."""

import math
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.lab import container_constants as constants
from deformscope.lab.container_constants import AIR_PRESSURE_PA, BEARING_FACTOR, GRAVITY_M_S2, ROOM_K, Content
from deformscope.lab.container_shell import ContainerShape, shell_of
from deformscope_drivers.dsa.scene import COLUMNS, ROWS_DISTAL, TEXEL_PITCH_MM
from deformscope_drivers.sdh.kinematics import BASE_SIDE_M, DISTAL_LINK_M, FINGERS, PROXIMAL_LINK_M

SQUEEZING = (0, 2)
"""The two fingers that face each other when the base axis is at 90 degrees: finger 0 comes from +x of the hand."""
AXES = tuple((FINGERS[finger].proximal_axis, FINGERS[finger].distal_axis) for finger in SQUEEZING)
LOADED = tuple(axis for pair in AXES for axis in pair)
TEXEL_M2 = (TEXEL_PITCH_MM * 1e-3) ** 2
TEXELS = ROWS_DISTAL * COLUMNS
NEAR_M = 0.004
"""A finger is near if a texel's surface is within this distance of the bulging wall at rest."""
TABLE_STIFFNESS_N_M = 2e4
NEWTON_STEPS, DAMPED_FROM = 40, 8
CLOSE_M = 1e-8
CLOSE_N = 1e-4
CORRECTIONS = 3
TORQUE_CLOSE = 0.01
"""Share within which a stalled axis has the torque of its motor."""
ITERATIONS = 12
LEAST_PA = 1e-9
"""Parts with smaller yield do not."""


@dataclass(frozen=True, slots=True)
class Gas:
    """The air in a closed container. volume_m3: volume of it; warming_k: warming since it was closed"""

    volume_m3: float
    warming_k: float = 0.0

    def pressure_pa(self, squeezed_m3: float) -> tuple[float, float]:
        """Pressure above the outside's after the walls reduced the volume, and its slope [Pa/m3]."""
        left = max(self.volume_m3 - squeezed_m3, 0.05 * self.volume_m3)
        inside = AIR_PRESSURE_PA * (1.0 + self.warming_k / ROOM_K) * self.volume_m3 / left
        return inside - AIR_PRESSURE_PA, inside / left


@dataclass(frozen=True, slots=True)
class Patches:
    """The resistance behind patches of wall, (p,) each. It has elastic stiffness, greatest and least yield traction,
    plastic displacement at half of the greatest, and viscous traction at 1 m/s; and the index of the rate."""

    stiffness_pa_m: FloatArray
    most_pa: FloatArray
    least_pa: FloatArray
    half_m: FloatArray
    viscous_pa: FloatArray
    index: float

    @classmethod
    def of(cls, content: Content, depth_m: FloatArray, half_width_m: float) -> "Patches":
        """Resistance of patches (p,) at a depth below the content's surface; patches above it have none."""
        under = depth_m > 0.0
        none = np.zeros(depth_m.shape)
        if content.shear_modulus_pa > 0.0:
            rate = BEARING_FACTOR * content.consistency_pa_sn / half_width_m**content.flow_index
            most = BEARING_FACTOR * content.yield_pa * under
            stiffness = 3.0 * content.shear_modulus_pa / half_width_m * under
            return cls(stiffness, most, -most, none, rate * under, content.flow_index)
        if content.friction_deg == 0.0:
            return cls(none, none, none, none, none, 1.0)
        sine = np.sin(np.radians(content.friction_deg))
        passive = (1.0 + sine) / (1.0 - sine)
        vertical = content.density_kg_m3 * GRAVITY_M_S2 * np.maximum(depth_m, 0.0)
        rest = content.lateral_ratio * vertical
        most = (passive * vertical + 2.0 * content.cohesion_pa * np.sqrt(passive) - rest) * under
        active = np.maximum(vertical / passive - 2.0 * content.cohesion_pa / np.sqrt(passive), 0.0)
        stress = rest + 0.5 * most
        elastic = content.unload_modulus * stress / half_width_m * under
        first = content.load_modulus * stress / half_width_m
        half = np.where(under, most * (1.0 / np.maximum(first, 1e-9) - 1.0 / np.maximum(elastic, 1e-9)), 0.0)
        return cls(elastic, most, (active - rest) * under, half, none, 1.0)

    @property
    def resist(self) -> bool:
        """Whether there is any resistance."""
        return bool((self.stiffness_pa_m > 0.0).any())

    def moved(
        self, moved_m: FloatArray, traction_pa: FloatArray, plastic_m: FloatArray, step_s: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Tractions, plastic displacements and slopes [Pa/m] after walls moved inwards by `moved_m` (p,) in a step,
        from tractions and plastic displacements before it."""
        stiffness = self.stiffness_pa_m
        trial = traction_pa + stiffness * moved_m
        hardening = plastic_m / np.maximum(plastic_m + self.half_m, 1e-12)
        over = trial - (self.most_pa * np.where(self.half_m > 0.0, hardening, 1.0))
        flows = (over > LEAST_PA) & (stiffness > 0.0)
        growth, slope = np.zeros(trial.shape), stiffness.copy()
        if flows.any():
            growth[flows], slope[flows] = self._grow(flows, trial[flows], plastic_m[flows], over[flows], step_s)
        traction = trial - stiffness * growth
        low = traction < self.least_pa
        return np.where(low, self.least_pa, traction), plastic_m + growth, np.where(low, 0.0, slope)

    def _grow(
        self, at: BoolArray, trial: FloatArray, plastic_m: FloatArray, over: FloatArray, step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Growth of the plastic displacement, and the traction's slope: Newton from below, where the residual is convex
        and falls, so that it never passes the root."""
        k, most, half, viscous = (v[at] for v in (self.stiffness_pa_m, self.most_pa, self.half_m, self.viscous_pa))
        rate = viscous / step_s**self.index
        harden = np.where(half > 0.0, most * half / np.maximum(plastic_m + half, 1e-12) ** 2, 0.0)
        x = over / (3.0 * np.maximum(k, harden))
        x = np.where(
            rate > 0.0, np.minimum(x, (over / (3.0 * np.where(rate > 0.0, rate, 1.0))) ** (1.0 / self.index)), x
        )
        falls = k
        for _ in range(ITERATIONS):
            yields = np.where(half > 0.0, most * (plastic_m + x) / np.maximum(plastic_m + x + half, 1e-12), most)
            hardens = np.where(half > 0.0, most * half / np.maximum(plastic_m + x + half, 1e-12) ** 2, 0.0)
            flow = rate * x**self.index
            falls = k + hardens + self.index * flow / x
            step = (trial - k * x - yields - flow) / falls
            x = x + step
            if (np.abs(step) <= 1e-9 * x).all():
                break
        return x, k * (1.0 - k / falls)


@dataclass(frozen=True, slots=True)
class ContainerDraw:
    """Variations from squeeze to squeeze and between instances.

    T_hand_container: (4, 4) first pose of the container [m]; fill: share of the height; softness: softness of the wall
    over nominal; warming_k: warming since it was closed; room_k: temperature of hand and pads over their calibration
    gear_loss: (7,) share of each axis's torque"""

    T_hand_container: FloatArray
    fill: float
    softness: float
    warming_k: float
    room_k: float
    gear_loss: FloatArray

    @classmethod
    def draw(
        cls, shape: ContainerShape, seed: int, instance: int, session: int = 0, grasp: FloatArray | None = None
    ) -> "ContainerDraw":
        """A random draw: the wall depends on the instance, the temperature on the session, and nothing on the content.
        grasp: (4, 4) planned pose of the container in the hand; None = it is drawn too"""
        own = np.random.default_rng([seed, 0x15])
        wall = np.random.default_rng([instance, 0x16])
        room = np.random.default_rng([session, 0x17])
        thick = 1.0 + shape.wall.thickness_cv * wall.standard_normal()
        young = 1.0 + shape.wall.young_cv * (wall.standard_normal() + room.standard_normal()) / math.sqrt(2.0)
        along, roll, deep, off, yaw = own.uniform(-1.0, 1.0, 5)
        if grasp is None:
            grasp = hand_from_container(constants.GRASP_ALONG_M * along, constants.ROLL_DEG * roll)
        return cls(
            T_hand_container=misplaced(
                grasp, constants.GRASP_DEEP_M * deep, constants.OFF_CENTRE_M * off, constants.YAW_DEG * yaw
            ),
            fill=min(constants.FILL + constants.FILL_SD * own.standard_normal(), 0.99),
            softness=1.0 / (young * thick**3),
            warming_k=constants.TEMPERATURE_SD_K * own.standard_normal(),
            room_k=constants.TEMPERATURE_SD_K * room.standard_normal(),
            gear_loss=constants.GEAR_LOSS + constants.GEAR_LOSS_SD * own.standard_normal(7),
        )


PADS_MIDDLE_M = (0.0, BASE_SIDE_M / 2 * math.tan(math.radians(30.0)), 0.1445)
"""Between the middles of both pads in the hand frame: the two fingers are on both sides of its z axis; along z where
upright fingertips touch a container of 6 cm."""


def hand_from_container(along_m: float = 0.0, roll_deg: float = 0.0) -> FloatArray:
    """(4, 4) pose in a level hand of an upright container: its middle between the pads, its z along the hand's y.
    along_m: height of the grasp above the container's middle; roll_deg: turn about the squeeze"""
    roll = math.radians(roll_deg)
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # container axes in the hand
    turn = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    pose = np.eye(4)
    pose[:3, :3] = turn @ level
    pose[:3, 3] = PADS_MIDDLE_M
    pose[:3, 3] -= pose[:3, 2] * along_m
    return pose


def misplaced(T_hand_container: FloatArray, deep_m: float, off_m: float, yaw_deg: float) -> FloatArray:
    """(4, 4) the pose after a displacement out of the hand, one to the side of finger 0, and a turn about the
    container's z."""
    yaw = math.radians(yaw_deg)
    pose = T_hand_container.copy()
    pose[:3, :3] = pose[:3, :3] @ [[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]
    pose[:3, 3] += (off_m, 0.0, deep_m)
    return pose


class _Finger:
    """The distal pad of one finger, texel by texel, row 0 at its tip: its pose in the frame of a fixed container, and
    its depth within the wall."""

    def __init__(self, number: int, T_container_hand: FloatArray) -> None:
        """number: 0 or 1, of `SQUEEZING`; T_container_hand: (4, 4) pose of the hand [m]"""
        self.kind = FINGERS[SQUEEZING[number]]
        self.side = (1, -1)[number]
        self.axes = AXES[number]
        self.own = slice(number * TEXELS, (number + 1) * TEXELS)
        self._rotation = T_container_hand[:3, :3]
        self._base = T_container_hand[:3, :3] @ np.array(self.kind.base_m) + T_container_hand[:3, 3]
        self.normal: FloatArray | None = None  # (78, 3) of the wall under each texel, once the finger is near

    def points_m(self, position_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(78, 3) texels' surfaces, and (2, 78, 3) how they move with the proximal and the distal joint [m/rad]."""
        turn = 0.0 if self.kind.base_axis is None else math.radians(position_deg[self.kind.base_axis])
        lean = np.array([self.kind.bend_sign[0] * math.sin(turn), self.kind.bend_sign[1] * math.cos(turn), 0.0])
        across = self._rotation @ np.array([lean[1], -lean[0], 0.0])
        plane = np.stack([self._rotation @ lean, self._rotation[:, 2]])  # leaning in, and up
        proximal, distal = (math.radians(position_deg[axis]) for axis in self.axes)
        middle = PROXIMAL_LINK_M * np.array([math.sin(proximal), math.cos(proximal)])
        sine, cosine = math.sin(proximal + distal), math.cos(proximal + distal)
        along, inward = DISTAL_LINK_M + _TEXEL_ALONG, constants.PAD_OFFSET_M - _TEXEL_RECESS
        in_plane = middle + np.stack([along * sine + inward * cosine, along * cosine - inward * sine], axis=-1)
        moved = np.stack([in_plane, in_plane - middle])[..., ::-1] * (1.0, -1.0)
        points = self._base + in_plane @ plane + _TEXEL_ACROSS[:, None] * across
        return points, moved @ plane


def _texels() -> tuple[FloatArray, FloatArray, FloatArray]:
    """(78,) along, (78,) across and (78,) recess of the texels of a pad in the finger's frame [m]."""
    pitch = TEXEL_PITCH_MM * 1e-3
    row, column = np.divmod(np.arange(TEXELS), COLUMNS)
    across = (column - (COLUMNS - 1) / 2) * pitch
    beyond = np.maximum(constants.TIP_ROWS - row, 0) * pitch
    along = (row - (ROWS_DISTAL - 1) / 2) * pitch
    recess = across**2 / (2 * constants.PAD_CURVATURE_M) + along**2 / (2 * constants.PAD_LENGTH_CURVATURE_M)
    recess += beyond**2 / (2 * constants.TIP_CURVATURE_M)
    return -(constants.TIP_MARGIN_M + row * pitch), across, recess


_TEXEL_ALONG, _TEXEL_ACROSS, _TEXEL_RECESS = _texels()


@dataclass(slots=True)
class _Balance:
    """Result of a step. y: displacements; slid_m, held_m: slip of the container, and the displacement at which friction
    holds it"""

    y: FloatArray
    slid_m: float
    held_m: float
    traction_pa: FloatArray
    plastic_m: FloatArray
    force_n: FloatArray
    loads: FloatArray
    torque_nm: FloatArray


@dataclass(slots=True)
class _Tangent:
    """Response of the balance to a small load: the matrix of the last Newton step, and its compliance between pressed
    texels and all its unknowns. It lists the pressed texels, and their normals along the slide."""

    matrix: FloatArray
    compliance: FloatArray
    pressed: IntArray
    aside: FloatArray


class ContainerWorld:
    """A container with a content, and its response to the fingers.

    shape, content, trial: as given; mass_kg: mass of all of it"""

    def __init__(self, shape: ContainerShape, content: constants.Content, trial: ContainerDraw) -> None:
        self.shape, self.content, self.trial = shape, content, trial
        self._shell = shell_of(shape)
        level = trial.fill * shape.height_m
        self._patches = Patches.of(content, level - self._shell.patch_z_m, shape.half_m[0])
        self._gas = Gas(shape.volume_m3 - content.solid_share * shape.area_m2 * level, trial.warming_k)
        self.mass_kg = shape.wall_mass_kg + content.density_kg_m3 * shape.area_m2 * level
        self._friction_n = constants.TABLE_FRICTION * self.mass_kg * constants.GRAVITY_M_S2
        leaning = -content.lateral_ratio * content.density_kg_m3 * constants.GRAVITY_M_S2
        weight = leaning * self._shell.pressure_row(0.0, level, slope=True)
        self._bulge = trial.softness * self._shell.solve(weight[:, None])[:, 0]
        self._near_m = NEAR_M - float(self._shell.at_nodes(self._bulge).min())
        T_container_hand = np.linalg.inv(trial.T_hand_container)
        self._fingers = [_Finger(number, T_container_hand) for number in range(2)]
        self._area = self._shell.patch_area_m2
        fields, across = self._shell.filling_compliance
        scale = np.append(1.0 / self._area, 1.0)  # a patch's displacement is its mean
        count, size = 2 * TEXELS, 2 * TEXELS + len(scale)
        self._compliance = np.zeros((size, size))
        self._compliance[count:, count:] = trial.softness * across * np.outer(scale, scale)
        self._fields = np.zeros((len(self._bulge), size))
        self._fields[:, count:] = trial.softness * fields * scale
        self._offset = np.full(count, np.inf)  # of the wall at rest, inwards; inf: no wall under this texel
        self._across = np.zeros(count)
        patch = np.zeros(len(self._area))
        nothing = np.zeros(count)
        self._state = _Balance(np.zeros(size), 0.0, 0.0, patch, patch, nothing, np.zeros(size), np.zeros(4))
        self._still: tuple[float, ...] | None = None  # directions and torques with which nothing moves any more
        self._stalled: dict[int, float] = {}  # axes that their motor does not turn on, and in which direction
        self._state, _ = self._solved(np.full(count, -np.inf), np.zeros((count, 4)), 1.0)

    # What can be seen of it ------------------------------------------------------------------------------------------

    @property
    def T_hand_container(self) -> FloatArray:
        """(4, 4) present pose [m]."""
        pose = self.trial.T_hand_container.copy()
        pose[:3, 3] += pose[:3, 0] * self._state.slid_m
        return pose

    @property
    def force_n(self) -> FloatArray:
        """(2,) forces of the fingers of `SQUEEZING` on the wall."""
        return np.asarray(self._state.force_n.reshape(2, TEXELS).sum(axis=1))

    @property
    def pressure_pa(self) -> FloatArray:
        """(2, 13, 6) pressures on the texels of their distal pads."""
        return self._state.force_n.reshape(2, ROWS_DISTAL, COLUMNS) / TEXEL_M2

    @property
    def torque_nm(self) -> FloatArray:
        """(7,) torques of the contact about each axis, against growing angles."""
        torque = np.zeros(7)
        torque[list(LOADED)] = self._state.torque_nm
        return torque

    @property
    def nodes_m(self) -> tuple[FloatArray, FloatArray]:
        """Coordinates (n,) along s and (m,) along z [m] of `inward_m`."""
        return self._shell.s_m, self._shell.z_m

    def inward_m(self) -> FloatArray:
        """(nodes along s, nodes along z) present depth of the wall within the undeformed container."""
        return self._shell.at_nodes(self._bulge + self._fields @ self._state.loads)

    @property
    def dent_m(self) -> FloatArray:
        """(2,) largest inward displacement of the wall since rest, under a pressed texel of each finger."""
        moved = np.where(self._state.force_n > 0.0, self._state.y[: 2 * TEXELS], 0.0)
        return np.asarray(moved.reshape(2, TEXELS).max(axis=1))

    # How it goes on --------------------------------------------------------------------------------------------------

    def reach_deg(
        self, position_deg: FloatArray, wanted_deg: FloatArray, torque_nm: FloatArray, step_s: float
    ) -> FloatArray:
        """(7,) angles that the axes reach in a step, from `position_deg` towards `wanted_deg`, with motors of at most
        `torque_nm` against the contact."""
        step = wanted_deg - position_deg
        self._stalled = {axis: way for axis, way in self._stalled.items() if np.sign(step[axis]) == way}
        goal = wanted_deg.copy()
        goal[list(self._stalled)] = position_deg[list(self._stalled)]  # most likely they stay where they are
        asked = (*np.sign(step), *torque_nm)
        if self._still == asked and not (goal - position_deg)[list(LOADED)].any():
            return goal
        depth, slope = self._reached(goal)
        if not any(finger.normal is not None for finger in self._fingers):
            return goal
        before = self._state.y
        state, tangent = self._solved(depth, slope, step_s)
        for _ in range(CORRECTIONS):
            room = {}
            for axis, by in self._off(state, step, torque_nm).items():
                end_deg = wanted_deg[axis] if by * step[axis] > 0.0 else position_deg[axis]
                if not math.isclose(goal[axis], end_deg, abs_tol=1e-9):
                    room[axis] = by
            if not room:
                break
            goal = self._corrected(goal, room, self._torque_slope(tangent, slope), position_deg, wanted_deg)
            depth, slope = self._reached(goal)
            state, tangent = self._solved(depth, slope, step_s)
        moves = np.abs(state.y - before).max() >= CLOSE_M or (goal - position_deg)[list(LOADED)].any()
        self._still = None if moves else asked
        self._state = state
        return goal

    def _off(self, state: _Balance, step: FloatArray, torque_nm: FloatArray) -> dict[int, float]:
        """By stalled axis: how much its torque has to grow to be its motor's; only where that is much."""
        off = {}
        for axis, torque in zip(LOADED, state.torque_nm, strict=True):
            most = torque_nm[axis]
            against = step[axis] * torque > 0.0
            if against and abs(torque) > most * (1.0 + TORQUE_CLOSE):
                self._stalled[axis] = float(np.sign(step[axis]))
            elif not against:
                self._stalled.pop(axis, None)
            by = math.copysign(most, step[axis]) - torque
            if axis in self._stalled and abs(by) > TORQUE_CLOSE * most:
                off[axis] = by
        return off

    @staticmethod
    def _corrected(
        goal: FloatArray, off: dict[int, float], slope: FloatArray, position_deg: FloatArray, wanted_deg: FloatArray
    ) -> FloatArray:
        """Goals with which the stalled axes have their motors' torques, to first order, limited to the requested
        ones."""
        index = [LOADED.index(axis) for axis in off]
        part = slope[np.ix_(index, index)] + 1e-6 * np.eye(len(index))
        corrected = goal.copy()
        for axis, by in zip(off, np.degrees(np.linalg.solve(part, list(off.values()))), strict=True):
            low, high = sorted((position_deg[axis], wanted_deg[axis]))
            corrected[axis] = min(max(goal[axis] + by, low), high)
        return corrected

    def _reached(self, position_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(156,) depths of the texels' surfaces within the wall at rest, -inf where none; (156, 4) their slopes by the
        loaded axes [m/rad]; both without the slide."""
        depth, slope = np.full(2 * TEXELS, -np.inf), np.zeros((2 * TEXELS, 4))
        for number, finger in enumerate(self._fingers):
            points, moved = finger.points_m(position_deg)
            own_m = self.shape.depth_m(points, finger.side)
            if finger.normal is None and own_m.max() + finger.side * self._state.slid_m > -self._near_m:
                self._approach(number, points)
            if finger.normal is not None:
                depth[finger.own] = own_m - self._offset[finger.own]
                slope[finger.own, 2 * number : 2 * number + 2] = -(moved * finger.normal).sum(axis=-1).T
        return depth, slope

    def _approach(self, number: int, points: FloatArray) -> None:
        """Set where a finger's texels lie on the wall once it is near. points: (n, 3) points of the texels in the
        container's frame [m]"""
        finger = self._fingers[number]
        s_m, z_m, normal, on_wall = self.shape.under(points - (self._state.slid_m, 0.0, 0.0), finger.side)
        if not on_wall.any():
            return
        finger.normal, own, count = normal, finger.own, 2 * TEXELS
        rows = self._shell.rows(s_m, z_m)
        self._across[own] = normal[:, 0]
        self._offset[own] = np.where(on_wall, rows @ self._bulge, np.inf)
        self._fields[:, own] = self.trial.softness * self._shell.solve(rows.T.toarray())
        others = np.vstack([self._shell.patch_rows / self._area[:, None], self._shell.volume_row])
        self._compliance[count:, own] = others @ self._fields[:, own]
        self._compliance[own, :] = rows @ self._fields
        self._compliance[:, own] = self._compliance[own, :].T
        self._state.y[own] = rows @ (self._fields @ self._state.loads)

    def _solved(self, depth: FloatArray, slope: FloatArray, step_s: float) -> tuple[_Balance, _Tangent]:
        """The balance of forces at the end of a time step. depth, slope: (156,) and (156, 4), as `_reached` gives
        them"""
        before, count, patches = self._state, 2 * TEXELS, self._patches
        y, slid = before.y.copy(), before.slid_m
        cover = constants.PAD_STIFFNESS_PA_M * TEXEL_M2
        filled = count + np.arange(len(self._area) if patches.resist else 0)
        slips = 0.0  # the direction in which the table rubs, once the container does not stick
        for turn in range(NEWTON_STEPS):
            deep = depth + self._across * slid - y[:count]
            pressed = np.flatnonzero(deep > 0.0)
            aside, touched = self._across[pressed], len(pressed)
            force = np.zeros(count)
            force[pressed] = cover * deep[pressed]
            moved = y[count:-1] - before.y[count:-1]
            traction, plastic, stiff = patches.moved(moved, before.traction_pa, before.plastic_m, step_s)
            gas, gas_slope = self._gas.pressure_pa(float(y[-1]))
            loads = np.concatenate([force, -traction * self._area, [-gas]])
            rub, rub_slope = TABLE_STIFFNESS_N_M * (slid - before.held_m), TABLE_STIFFNESS_N_M
            if slips:
                rub, rub_slope = slips * self._friction_n, 1.0  # 1 N/m, so that there is one solution
            at = np.concatenate([pressed, filled, [len(y) - 1]])
            residual = np.append(y[at] - self._compliance[at] @ loads, -(force @ self._across) - rub)
            part = self._compliance[np.ix_(at, at)]
            slopes = np.concatenate([np.full(touched, -cover), -(stiff * self._area)[filled - count], [-gas_slope]])
            matrix = np.empty((len(at) + 1, len(at) + 1))
            matrix[:-1, :-1] = np.eye(len(at)) - part * slopes
            matrix[:-1, -1] = -part[:, :touched] @ (cover * aside)
            matrix[-1] = 0.0
            matrix[-1, :touched] = cover * aside
            matrix[-1, -1] = -cover * float(aside @ aside) - rub_slope
            if np.abs(residual[:-1]).max() < CLOSE_M and abs(residual[-1]) < CLOSE_N:
                if slips or abs(rub) <= self._friction_n:
                    held = slid - rub / TABLE_STIFFNESS_N_M
                    found = _Balance(y, slid, held, traction, plastic, force, loads, slope.T @ force)
                    return found, _Tangent(matrix, part[:, :touched], pressed, aside)
                slips = math.copysign(1.0, rub)
                continue
            change = np.linalg.solve(matrix, -residual)
            # damped where it jumps between texels that touch and do not
            part_way = 1.0 if turn < DAMPED_FROM else 0.5
            grown = loads.copy()
            grown[at] += slopes * change[:-1]
            grown[pressed] += cover * aside * change[-1]
            y = y + part_way * (self._compliance @ grown - y)
            slid += part_way * change[-1]
        raise ArithmeticError(f"no balance of a squeezed container within {NEWTON_STEPS} steps")

    @staticmethod
    def _torque_slope(tangent: _Tangent, slope: FloatArray) -> FloatArray:
        """(4, 4) how the torques grow with the angles of the loaded axes [Nm/rad]."""
        cover, own = constants.PAD_STIFFNESS_PA_M * TEXEL_M2, slope[tangent.pressed]
        right = np.vstack([tangent.compliance @ (cover * own), cover * tangent.aside @ own])
        moved = np.linalg.solve(tangent.matrix, right)
        deeper = own + tangent.aside[:, None] * moved[-1] - moved[: len(own)]
        return np.asarray(own.T @ (cover * deeper))
