"""A slab whose foam yields: a `SlabWorld` with the forces of Ogden's foam at large strain.

Foam with a plateau resists a light touch with its modulus, and a deep one with far less, as its cells' walls buckle.
The reduction is computed once for a foam, a ball and a thickness, around the ball's axis (`axisymmetric_contact`),
relative to the same ball on linear foam. At each depth a touch's force is the linear force times that share. On foam of
one kind, far from its edges, force over depth is therefore that of the large-strain solution.

Not modelled: near a border or an edge, the share is that of the foam below the tip's middle on a level layer of the
same thickness. The dent around the tip is that of linear foam at the same depth, while on a plateau it is narrower."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from deformscope.arrays import FloatArray
from deformscope.lab.axisymmetric_contact import press_ball
from deformscope.lab.ogden import OgdenFoam
from deformscope.lab.scenes import Piece, Scene
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import Contact, SlabWorld

DEPTHS_M = (0.25e-3, 0.5e-3, 1e-3, 1.5e-3, 2e-3, 3e-3, 4e-3, 6e-3, 8e-3, 10e-3, 12e-3, 15e-3)
"""Depths at which the share is computed, below half the layer's thickness; beyond the last it is constant."""
THICKNESS_STEP_M = 0.005
MODULUS_PA = 1e5
"""Any value would do: forces of both laws are in proportion to it."""


class PlateauWorld(SlabWorld):
    """A scene in which some foams yield (`Piece.plateau_exponent`)."""

    def press(self, tip: RigidTip, center_m: FloatArray) -> Contact:
        """Like `SlabWorld.press`, for a ball with its middle at (3,) [m]."""
        contact = super().press(tip, center_m)
        label = int(self.scene.label(contact.center_m[:2]))
        plateau_exponent = self.scene.pieces[label].plateau_exponent if label >= 0 else 0
        if not plateau_exponent or not len(contact.node) or tip.radius is None:
            return contact
        height_m = float(self.scene.foam_height_m(contact.center_m[:2]))
        steps = max(1, round(height_m / THICKNESS_STEP_M))
        share = _shares(plateau_exponent, self.scene.poisson, tip.radius, steps)(contact.depth_m)
        lost_n = (1.0 - float(share)) * float(contact.node_force_n.sum())
        return replace(contact, force_n=contact.force_n - lost_n * contact.normal)


def force_share(
    plateau_exponent: int, poisson: float, radius_m: float, thickness_m: float, depth_m: FloatArray
) -> FloatArray:
    """(n,) force of foam that yields over that of linear foam of the same modulus, at depths (n,) [m] of a ball.
    plateau_exponent: Ogden's exponent: the plateau is near the modulus over this"""
    linear = SlabWorld(Scene("level", 0, (Piece("", MODULUS_PA),), {}, thickness_m=thickness_m, poisson=poisson))
    middle, tip = 0.5 * np.asarray(linear.scene.size_m), RigidTip(radius=radius_m)
    stays_n = [
        linear.press(tip, np.array([*middle, thickness_m + radius_m - depth])).normal_force_n for depth in depth_m
    ]
    law = OgdenFoam((0.5 * MODULUS_PA / (1.0 + poisson),), (float(plateau_exponent),), poisson)
    return np.asarray(press_ball(law, radius_m, thickness_m, list(depth_m)).force_n / np.array(stays_n))


@functools.lru_cache(maxsize=64)
def _shares(plateau_exponent: int, poisson: float, radius_m: float, steps: int) -> Callable[[float], FloatArray]:
    """The share of the elastic force that is left, as a function of depth [m]; 1 at none."""
    thickness_m = steps * THICKNESS_STEP_M
    depth_m = np.array([depth for depth in DEPTHS_M if depth < 0.5 * thickness_m])
    share = force_share(plateau_exponent, poisson, radius_m, thickness_m, depth_m)
    over = PchipInterpolator([0.0, *depth_m], [1.0, *share])
    return lambda depth: over(np.clip(depth, 0.0, depth_m[-1]))
