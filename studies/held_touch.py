"""A controller's record of a tip that comes down on foam with a memory, holds its force and retracts.

It resembles `studies.touching`: no wires, no control loop."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.lab.scene_lab import CreepingWorld
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld
from studies.touching import Sensing

CLEARANCE_M, BACK_M_S = 0.005, 0.03
"""Above the foam, where it begins and ends; speed of the way back."""
FORCE_PER_S = 5.0
"""Share of a missing force that is made up in a second."""
SLOPE_N_PER_M = 1e3
"""Stiffness of a foam under a ball, about: how fast the balance between arm and foam is found depends on it, nothing
else."""
BALANCED_M, BALANCED_AT_MOST = 1e-7, 20
STICKS = 0.8
"""Stiffness across over force per depth of a contact that sticks (Mindlin 1949, Poisson's ratio about 0.3)."""


@dataclass(frozen=True, slots=True)
class HeldTouch:
    """A touch with a hold and a retract, as recorded, and its truth.

    time_s, position_m, force_n, true_depth_m, true_force_n: as in `Approach`; loading, held: how many samples lead up
    to the set force, and how many were taken until the way back; slid_m: how far it slid until then"""

    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    true_depth_m: FloatArray
    true_force_n: FloatArray
    loading: int
    held: int
    slid_m: float = 0.0


def held_touch(
    world: CreepingWorld,
    tip: RigidTip,
    xy_m: FloatArray,
    *,
    hold_s: float,
    set_force_n: float,
    max_depth_m: float,
    sensing: Sensing,
    lean: float,
    random: np.random.Generator,
) -> HeldTouch:
    """Come down along the normal at a place (2,), keep the force for a while and go back, on foam with a memory.

    The force is controlled as in `robot.touch`: a speed in proportion to the missing force, no faster than the
    approach.
    lean: lateral motion of the tip along x relative to its depth; it sticks, STICKS times as stiff across as along,
    until `sensing.friction` is reached, and slides"""
    xy_m = np.asarray(xy_m, dtype=np.float64)
    normal = world.scene.normal(xy_m)
    rest = np.append(xy_m, world.scene.foam_height_m(xy_m)) + (tip.radius or 0.0) * normal
    period_s, gone_m, give_m = 1.0 / sensing.rate_hz, -CLEARANCE_M, 0.0
    rows: list[tuple[float, float, float]] = []
    loading = held = 0
    stiff_n_per_m = 1.0
    while not held or gone_m > -CLEARANCE_M:
        world.at((len(rows) + 1) * period_s)
        force, give_m = _balanced(world, tip, rest, normal, gone_m, give_m, 1.0 / sensing.arm_n_per_m)
        rows.append((gone_m, gone_m - give_m, force))
        felt = sensing.gain * force
        if not loading and (felt >= set_force_n or gone_m - give_m >= max_depth_m):
            loading = len(rows)
            stiff_n_per_m = max(felt / max(gone_m, 1e-4), 1.0)
        if loading and not held and (len(rows) - loading) * period_s >= hold_s:
            held = len(rows)
        if held:
            gone_m -= BACK_M_S * period_s
        elif loading:
            wanted = FORCE_PER_S * (set_force_n - felt) / stiff_n_per_m
            gone_m += float(np.clip(wanted, -sensing.speed_m_s, sensing.speed_m_s)) * period_s
        else:
            gone_m += sensing.speed_m_s * period_s
    gone, depth, force_n = np.array(rows).T
    position = rest - gone[:, None] * normal + random.normal(scale=sensing.position_sd_m, size=(len(gone), 3))
    felt_n = sensing.gain * force_n[:, None] * normal + random.normal(scale=sensing.force_sd_n, size=(len(gone), 3))
    slid_m = 0.0
    if lean:
        aside_m = lean * np.maximum(gone, 0.0)
        across_n, slid_m = _dragged(aside_m, depth, force_n, sensing.friction, held)
        position[:, 0] += aside_m
        felt_n[:, 0] += sensing.gain * across_n
    return HeldTouch(period_s * np.arange(len(gone)), position, felt_n, depth, force_n, loading, held, slid_m)


def _dragged(
    aside_m: FloatArray, depth_m: FloatArray, force_n: FloatArray, friction: float, held: int
) -> tuple[FloatArray, float]:
    """(n,) force across of a tip that goes aside (n,) [m] while it presses: it sticks until friction is reached; and
    how far it slid before `held`."""
    across_n, slid_m = np.zeros(len(aside_m)), 0.0
    for i in range(1, len(aside_m)):
        stiff_n_per_m = STICKS * force_n[i] / max(float(depth_m[i]), 1e-5)
        limit_n = friction * force_n[i]
        wanted_n = across_n[i - 1] + stiff_n_per_m * (aside_m[i] - aside_m[i - 1])
        across_n[i] = np.clip(wanted_n, -limit_n, limit_n)
        if i < held and stiff_n_per_m > 0.0:
            slid_m += abs(wanted_n - across_n[i]) / stiff_n_per_m
    return across_n, slid_m


def _balanced(
    world: SlabWorld,
    tip: RigidTip,
    rest_m: FloatArray,
    normal: FloatArray,
    gone_m: float,
    give_m: float,
    compliance_m_per_n: float,
) -> tuple[float, float]:
    """The force at which an arm that has gone so far gives as much as its compliance says, and by how much [N, m]."""
    force = 0.0
    for _ in range(BALANCED_AT_MOST):
        force = float(world.press(tip, rest_m - (gone_m - give_m) * normal).force_n @ normal)
        off_m = compliance_m_per_n * force - give_m
        if abs(off_m) < BALANCED_M:
            break
        give_m += off_m / (1.0 + compliance_m_per_n * SLOPE_N_PER_M)
    return force, give_m
