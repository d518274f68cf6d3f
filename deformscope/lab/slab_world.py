"""The foam slab that a robot touches: a rigid tip presses into linear elastic finite elements, without friction.

    world = SlabWorld(built_in("two-60-150", seed=3))
    tip = RigidTip(radius=0.01)
    contact = world.press(tip, center_m)       # where the middle of the ball is, surface frame [m]
    contact.force_n, contact.depth_m           # on the tip, and how far it has sunk
    world.displaced_m(contact, xy_m)           # how the surface has moved there, for the camera

Only the neighbourhood of a touch is solved, with the true foams and heights. Its mesh has elements of 1.5 mm under a
tip of 2 cm, is coarser with distance, and is glued to the table. Its equations are factorised once (0.6 s), with the
nodes that a tip may touch last; the remaining block of the factors is their dense stiffness. A press is then a
complementarity problem of about 200 nodes (0.5 ms).

A ball of 2 cm on 5 cm of foam: force within 2 % of the closed form for a bonded layer from 0.5 to 7 mm, within 3 % of
finer meshes, also near a border. At much smaller depths a single node carries the whole force.

Not modelled: friction, speed (`creeping_world`), large strain, and the lateral motion of a deep dent's wall (the gap is
closed along the rest surface's normal). `tests/lab/test_slab_world.py` compares with Hertz and with finer meshes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls
from scipy.sparse import csc_array, eye_array, kron
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex1, MeshHex

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.lab.elasticity import dissected, stiffness_of
from deformscope.lab.scenes import Scene
from deformscope.lab.slab import RigidTip, downward
from deformscope_drivers.arm.kinematics import cross

FINE = 0.15
"""Size of the elements under a tip, as a share of its half width."""

GROWTH_ASIDE, GROWTH_DOWN = 2.0, 1.9
"""Ratio of neighbouring elements away from the tip."""

REACH = 1.6
"""Extent of the mesh beyond the tip, in thicknesses; a free side there changes the force by less than 0.2 %."""

MARGIN = 1.0
"""Number of elements between a tip and the edge of its possible contact: how far the tip may drift before a new mesh is
made."""

FLAT_DRIFT = 0.25
"""Share of that margin for a flat tip, which stays on its nodes."""

TABLE_N_PER_M = 2e5
"""Stiffness of the table's top, which a tip touches outside the slab or through it."""

CLEAR_M = 2e-4
"""Farther from the surface than that, a tip needs no mesh."""

SAMPLES = 5
"""Samples of the modulus along each side of an element."""

SPOTS: FloatArray = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 9)] * 2), axis=-1).reshape(-1, 2)
"""Places of a tip, in half widths, below which the surface is looked at."""

FOOT_ROUNDS = 3
MOST_ROUNDS = 30
MOST_PATCHES = 3
"""Largest number of stored meshes (0.25 GB each); the oldest is dropped first."""


@dataclass(frozen=True, slots=True)
class Contact:
    """A tip at one place, and the foam's response.

    center_m: (3,) place of the tip (middle of a ball, or of a flat tip's face); normal: (3,) normal of the rest surface
    below it; depth_m: how far the lowest point is below the rest surface, along the normal; negative above it [m]
    gap_m: distance from tip to foam along the normal; 0 in contact [m]
    force_n: (3,) force on the tip [N]: opposite to the sum of the nodes' forces, plus that of the table
    place_m: (n, 3) nodes in contact, at rest [m]; node_force_n: (n,) force on each node along the normal [N]: the
    contact force on foam without a memory
    tip: which; mesh_m: (2,) place of the mesh [m], None if the tip is far from the foam;
    node: (n,) numbers of the nodes in contact"""

    center_m: FloatArray
    normal: FloatArray
    depth_m: float
    gap_m: float
    force_n: FloatArray
    place_m: FloatArray
    node_force_n: FloatArray
    tip: RigidTip
    mesh_m: FloatArray | None
    node: IntArray

    @property
    def normal_force_n(self) -> float:
        """How hard the tip is pushed away from the surface [N]."""
        return float(self.force_n @ self.normal)


class Patch:
    """The foam around one place, with factorised equations for tips of one kind.

    xy_m: (2,) the place [m]; reach_m: (2,) largest distance along x and y at which a tip's edge may be [m]
    fine_m: (2,) size of the elements there [m]
    normal: (3,) normal of the rest surface at the place; candidate_m: (n, 3) nodes that a tip may touch, at rest [m]
    compliance: (n, n) displacement of each node against the normal for a unit push on each in that direction [m/N]"""

    def __init__(self, scene: Scene, xy_m: FloatArray, reach_m: FloatArray, fine_m: FloatArray) -> None:
        self.xy_m, self.reach_m, self.normal = np.array(xy_m, dtype=np.float64), reach_m, scene.normal(xy_m)
        axes = [
            _spread(float(self.xy_m[i]), reach_m[i], fine_m[i], REACH * scene.thickness_m, scene.size_m[i])
            for i in range(2)
        ]
        axes.append(downward(scene.thickness_m, 0.7 * float(fine_m.min()), GROWTH_DOWN))
        self._axes = (axes[0], axes[1])
        flat = MeshHex.init_tensor(*axes)
        place = flat.p.copy()
        place[2] *= scene.foam_height_m(place[:2].T) / scene.thickness_m
        basis = Basis(MeshHex(place, flat.t), ElementHex1(), intorder=2)
        node = basis.nodal_dofs[0]  # of each corner of the mesh
        at_rest, flat_at = np.empty((basis.N, 3)), np.empty((basis.N, 3))
        at_rest[node], flat_at[node] = place.T, flat.p.T
        modulus = _mean_modulus_pa(scene, place[:2, flat.t])
        # along two tangents and the normal, so that a push along the normal is one unknown
        frame = _frame(self.normal)
        turn = kron(eye_array(basis.N), csc_array(frame.T), format="csr")
        stiffness = turn.T @ stiffness_of(basis, modulus, np.full(len(modulus), scene.poisson)) @ turn

        top = np.abs(flat_at[:, 2] - scene.thickness_m) < 1e-9
        candidate = np.flatnonzero(top & (np.abs(at_rest[:, :2] - self.xy_m) < reach_m + 0.5 * fine_m).all(axis=1))
        last = 3 * candidate + 2
        free = np.setdiff1d(np.flatnonzero(np.repeat(flat_at[:, 2] > 0.0, 3)), last)
        free = free[dissected(flat_at[free // 3], (axes[0], axes[1], axes[2]))]
        self._order = np.concatenate([free, last])
        own = stiffness[self._order][:, self._order].tocsc()
        # in an order of little fill-in, and positive definite, so that no row is exchanged
        options = {"SymmetricMode": True}
        self._factors = splu(own, permc_spec="NATURAL", diag_pivot_thresh=0.0, options=options)
        # what elimination leaves at the last unknowns is their stiffness with all others free (Schur complement)
        lower, upper = (part[-len(last) :, -len(last) :].toarray() for part in (self._factors.L, self._factors.U))
        left = lower @ upper
        self.compliance: FloatArray = cho_solve(cho_factor(0.5 * (left + left.T)), np.eye(len(last)))
        self.candidate_m: FloatArray = at_rest[candidate]
        self._pushed: BoolArray | None = None  # nodes in contact at the last press, which are nearly those of the next
        self._frame, self._size = frame, 3 * basis.N
        corners = np.flatnonzero(top)
        self._top: IntArray = corners[np.lexsort(flat_at[corners, 1::-1].T)]

    def push_out(self, overlap: FloatArray, softer: float = 1.0) -> FloatArray:
        """(n,) forces along the normal [N] that push the candidates out of a tip, by their overlaps [m], for foam with
        this multiple of compliance."""
        if not (overlap > 0.0).any():
            return np.zeros(len(overlap))
        force = _without_pull(softer * self.compliance, overlap, self._pushed)
        self._pushed = force > 0.0
        return force

    def displaced_m(self, node_force_n: FloatArray, node: IntArray, xy_m: FloatArray) -> FloatArray:
        """(n, 3) displacement of the surface at (n, 2) if `node` of the candidates are pushed down along the normal."""
        load = np.zeros(len(self._order))
        load[len(load) - len(self.candidate_m) + node] = -node_force_n
        moved = np.zeros(self._size)
        moved[self._order] = self._factors.solve(load)
        surface = (moved.reshape(-1, 3)[self._top] @ self._frame).reshape(*(len(axis) for axis in self._axes), 3)
        return np.asarray(RegularGridInterpolator(self._axes, surface, bounds_error=False, fill_value=0.0)(xy_m))


class SlabWorld:
    """A scene's foam, which can be pressed anywhere. Meshes are made on demand and stored."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._patches: list[tuple[RigidTip, Patch]] = []

    def prepare(self, tip: RigidTip, xy_m: FloatArray) -> Patch:
        """Make the mesh for touches at a place (2,) [m] now, so that the first press there does not have to."""
        # a ball rests on a few nodes anyway; a flat tip's edge must stay on its own nodes
        return self._patch(tip, xy_m, drift_m=(1.0 if tip.radius is not None else FLAT_DRIFT) * MARGIN * _fine_m(tip))

    def _patch(self, tip: RigidTip, xy_m: FloatArray, drift_m: FloatArray | float) -> Patch:
        """The latest mesh for a tip within a drift of a place, or else a new one made for just there."""
        xy_m = np.clip(np.asarray(xy_m, dtype=np.float64), 0.0, self.scene.size_m)
        for known, patch in reversed(self._patches):
            if known == tip and (np.abs(patch.xy_m - xy_m) <= drift_m + 1e-9).all():
                return patch
        fine = _fine_m(tip)
        self._patches = self._patches[-MOST_PATCHES + 1 :]  # before the next is made
        patch = self._made(xy_m, _half_m(tip) + MARGIN * fine, fine)
        self._patches.append((tip, patch))
        return patch

    def _made(self, xy_m: FloatArray, reach_m: FloatArray, fine_m: FloatArray) -> Patch:
        """A patch of the slab's mesh, with arguments as for `Patch`."""
        return Patch(self.scene, xy_m, reach_m, fine_m)

    def press(self, tip: RigidTip, center_m: FloatArray) -> Contact:
        """The force on a tip at rest at a place. center_m: (3,) the middle of a ball, or of a flat tip's face, in the
        surface frame [m]. A flat tip is parallel to the rest surface below it."""
        center = np.asarray(center_m, dtype=np.float64)
        if center.shape != (3,) or not np.isfinite(center).all():
            raise InputError("a place of three finite numbers", str(center_m))
        # (3,) the place of the rest surface whose normal goes through a point, and (3,) that normal
        foot = center
        normal = self.scene.normal(center[:2])
        for _ in range(FOOT_ROUNDS):
            foot = np.append(foot[:2], self.scene.foam_height_m(foot[:2]))
            normal = self.scene.normal(foot[:2])
            foot = center - ((center - foot) @ normal) * normal
        depth = (tip.radius or 0.0) - float((center - foot) @ normal)
        table = np.array([0.0, 0.0, TABLE_N_PER_M * max(0.0, (tip.radius or 0.0) - float(center[2]))])
        # what is next to the slab counts where the slab ends
        xy = np.clip(center[:2] + _half_m(tip) * SPOTS, 0.0, self.scene.size_m)
        near = float(_overlap(tip, center, normal, np.column_stack([xy, self.scene.foam_height_m(xy)])).max())
        if near < -CLEAR_M:
            nothing = np.zeros(0, dtype=np.int64)
            gap = min(-near, max(0.0, float(center[2]) - (tip.radius or 0.0)))
            return Contact(center, normal, depth, gap, table, np.zeros((0, 3)), np.zeros(0), tip, None, nothing)
        patch = self.prepare(tip, foot[:2])
        overlap = _overlap(tip, center, patch.normal, patch.candidate_m)
        force, load = self._push_out(patch, overlap)
        node = np.flatnonzero(load)
        gap = 0.0 if force.any() else max(0.0, -float(overlap.max()))
        on_tip = patch.normal * force.sum() + table
        place = patch.candidate_m[node]
        return Contact(center, patch.normal, depth, gap, on_tip, place, load[node], tip, patch.xy_m, node)

    def _push_out(self, patch: Patch, overlap: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Contact forces of a patch's nodes along the normal [N]: (n,) on the tip, (n,) those that move the surface.
        overlap: (n,) depth of each node inside the tip [m]"""
        force = patch.push_out(overlap)
        return force, force

    def displaced_m(self, contact: Contact, xy_m: FloatArray) -> FloatArray:
        """(..., 3) displacement of material points of the surface, at rest at (..., 2) [m]; 0 far from the touch."""
        xy_m = np.asarray(xy_m, dtype=np.float64)
        moved = np.zeros((*xy_m.shape[:-1], 3))
        if contact.mesh_m is not None and len(contact.node):
            patch = self._patch(contact.tip, contact.mesh_m, drift_m=0.0)
            near = (np.abs(xy_m - patch.xy_m) < 2.5 * self.scene.thickness_m + patch.reach_m).all(axis=-1)
            moved[near] = patch.displaced_m(contact.node_force_n, contact.node, xy_m[near])
        return moved


def _half_m(tip: RigidTip) -> FloatArray:
    """(2,) how far a tip reaches along x and y."""
    return np.array(tip.half or (tip.radius, tip.radius), dtype=np.float64)


def _fine_m(tip: RigidTip) -> FloatArray:
    """(2,) size of the elements under a tip; a flat one ends where elements do."""
    half = _half_m(tip)
    fine = FINE * half.min()
    return half / np.ceil(half / fine) if tip.half is not None else np.full(2, fine)


def _overlap(tip: RigidTip, center: FloatArray, normal: FloatArray, points: FloatArray) -> FloatArray:
    """(n,) overlap of points (n, 3) of the rest surface with the tip along a normal [m]; -inf outside the tip."""
    aside = (points - center) @ _frame(normal).T
    if tip.half is not None:
        covered = (np.abs(aside[:, :2]) <= _half_m(tip) + 1.1 * FLAT_DRIFT * _fine_m(tip)).all(axis=1)
        return np.where(covered, aside[:, 2], -np.inf)
    radius = float(tip.radius or 0.0)
    squared = (aside[:, :2] ** 2).sum(axis=1)
    return np.where(squared < radius**2, aside[:, 2] + np.sqrt(np.maximum(radius**2 - squared, 0.0)), -np.inf)


def _without_pull(compliance: FloatArray, overlap: FloatArray, pushed: BoolArray | None = None) -> FloatArray:
    """(n,) forces f >= 0 that leave gaps C f - overlap >= 0, one of the two zero at each node. pushed: (n,) first guess
    of where f > 0

    A primal-dual active set (Hintermueller, Ito and Kunisch 2002); should it run in circles, non-negative least
    squares."""
    possible = np.isfinite(overlap)
    wanted = np.where(possible, overlap, 0.0)
    under = wanted > 0.0
    if pushed is not None and (pushed & under).any():
        under &= pushed
    for _ in range(MOST_ROUNDS):
        force = np.zeros(len(overlap))
        index = np.flatnonzero(under)
        force[index] = cho_solve(cho_factor(compliance[np.ix_(index, index)]), wanted[index])
        short = possible & (compliance @ force < wanted - 1e-9 * wanted.max())
        now = np.where(under, force > 0.0, short)
        if (now == under).all():
            return force
        under = now
    at = np.flatnonzero(possible)
    # f minimises |R f - R^-T overlap|^2 with C = R^T R
    factor = np.linalg.cholesky(compliance[np.ix_(at, at)]).T
    force = np.zeros(len(overlap))
    force[at] = nnls(factor, np.linalg.solve(factor.T, wanted[at]))[0]
    return force


def _mean_modulus_pa(scene: Scene, corner_m: FloatArray) -> FloatArray:
    """(E,) the mean over each element, (2, 8, E) its corners [m]: for a border between two foams from top to bottom,
    both of which are pressed alike."""
    low, side = corner_m.min(axis=1), np.ptp(corner_m, axis=1)
    column, layer = np.unique(np.concatenate([low, side]), axis=1, return_inverse=True)  # the same from top to bottom
    low, side = column[:2], column[2:]
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    spots = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 1, 2)
    return np.asarray(scene.modulus_pa(low.T + spots * side.T).mean(axis=0))[layer]


def _frame(normal: FloatArray) -> FloatArray:
    """(3, 3) rows: two tangents, the first along x as seen from above, and the normal."""
    first, up = np.array([normal[2], 0.0, -normal[0]], np.float64), np.asarray(normal, np.float64)
    first = np.asarray(first / np.linalg.norm(first), np.float64)
    return np.stack([first, cross(up, first), up])


def _spread(middle: float, half: float, fine: float, reach: float, side: float) -> FloatArray:
    """(n,) element borders along one axis of the slab [m]: even around the middle, farther apart beyond, ending at the
    slab's sides."""
    count = int(np.ceil(half / fine - 1e-6))
    outer, step = [count * fine], fine
    while outer[-1] < half + reach:
        step *= GROWTH_ASIDE
        outer.append(outer[-1] + step)
    every = middle + np.concatenate([-np.array(outer[:0:-1]), np.arange(-count, count + 1) * fine, outer[1:]])
    low, high = max(0.0, float(every[0])), min(side, float(every[-1]))
    inner = every[(every > low + 0.4 * fine) & (every < high - 0.4 * fine)]
    return np.concatenate([[low], inner, [high]])
