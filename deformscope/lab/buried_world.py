"""The foam slab with a ball of another material in it: finite elements on two scales.

    world = slab_world(built_in("buried", seed=3))      # `SlabWorld` where nothing is buried
    world.press(tip, center_m)                          # as any

A contact at the tip's scale needs elements of 1.5 mm, which are too small for a mesh as large as an inclusion's effect.
So the surface's compliance is that of the patch without the ball (`slab_world`), plus the ball's change of it. The
change is the difference of two solutions of the whole slab on one mesh, with and without the ball. Its elements are 5
mm around the ball, and wider elsewhere. That difference is smooth, since the ball lies a centimetre deep or more, and
its mesh's errors at the surface are the same in both. The two are factorised once for a slab; a press then costs no
more than without a ball. `tests/lab/test_buried_world.py` compares with one fine mesh of slab and ball.
"""

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex1, MeshHex

from deformscope.arrays import FloatArray
from deformscope.lab.elasticity import dissected, stiffness_of
from deformscope.lab.plateau_world import PlateauWorld
from deformscope.lab.scenes import BuriedBall, Scene
from deformscope.lab.slab_world import Contact, Patch, SlabWorld

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
