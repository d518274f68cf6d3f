"""What a controller would record while a tip comes down on the foam and stops: for statistics over many touches.

No wires, no control loop: the foam's force against depth is found once, and read where the arm is at each sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.creeping_world import CreepingWorld
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld

FIRST_M, STEP_M, FINER = 2e-6, 3e-4, 1.35
"""Depths at which the force is found: from the first, each so many times deeper, until they are a step apart."""


FORCE_PER_S = 5.0
"""Share of a missing force that is made up in a second."""
SLOPE_N_PER_M = 1e3
"""Of a foam under a ball, about: how fast the balance between arm and foam is found depends on it, nothing else."""
BALANCED_M, BALANCED_AT_MOST = 1e-7, 20
STICKS = 0.8
"""Stiffness across over force per depth of a contact that sticks (Mindlin 1949, Poisson's ratio about 0.3)."""


@dataclass(frozen=True, slots=True)
class Sensing:
    """What arm and force sensor make of it.

    rate_hz: samples a second; speed_m_s: of the arm; position_sd_m, force_sd_n: noise of each axis of each sample
    arm_n_per_m: stiffness of the arm, which reads joints and does not see itself bend; infinite by default
    gain: force as measured over the true one, which decides where it stops; overshoot_m: how far it goes on after that
    friction: force aside over the normal one, towards `friction_rad` from the x axis
    lean: of a touch that is held: how far it goes aside along x for its way down; it then sticks, STICKS times as stiff
    across as along, until `friction` is reached, and slides
    """

    rate_hz: float = 100.0
    speed_m_s: float = 0.01
    position_sd_m: float = 1e-4
    force_sd_n: float = 0.02
    arm_n_per_m: float = math.inf
    gain: float = 1.0
    overshoot_m: float = 0.0
    friction: float = 0.0
    friction_rad: float = 0.0
    lean: float = 0.0


@dataclass(frozen=True, slots=True)
class Approach:
    """A touch as recorded, and as it was.

    time_s: (n,) from the start; position_m: (n, 3) where the arm believes the tip's middle (a flat tip's face) to be
    force_n: (n, 3) on the tip, as measured; all in the surface frame
    true_depth_m: (n,) how far the tip had sunk along the normal, negative above; true_force_n: (n,) along the normal
    level_n: the force that it was to stop at last; reached: it did, rather than stop at the depth
    """

    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    true_depth_m: FloatArray
    true_force_n: FloatArray
    level_n: float
    reached: bool


def approach(
    world: SlabWorld,
    tip: RigidTip,
    xy_m: FloatArray,
    normal: FloatArray | None = None,
    *,
    set_force_n: float = 3.0,
    max_depth_m: float = 0.015,
    second_force_n: float = 5.0,
    shallow_m: float = 0.002,
    clearance_m: float = 0.005,
    dwell_s: float = 0.0,
    sensing: Sensing | None = None,
    random: np.random.Generator,
) -> Approach:
    """Come down on a place (2,) along the surface's normal (3,) until the force is reached, or the depth.

    Where the dent at the set force is shallower than `shallow_m`, the arm goes on to the second force. It starts
    `clearance_m` above the surface, and stays `dwell_s` where it stopped. The last sample before that is at the stop
    itself, in less than a period from the one before.
    """
    sensing = sensing or Sensing()
    if not 0.0 < set_force_n <= second_force_n:
        raise InputError("forces above 0, the second not below the first", f"{set_force_n:g} and {second_force_n:g} N")
    xy_m = np.asarray(xy_m, dtype=np.float64)
    along = world.scene.normal(xy_m) if normal is None else np.asarray(normal) / np.linalg.norm(normal)
    surface = np.append(xy_m, world.scene.foam_height_m(xy_m))
    rest = surface + (tip.radius or 0.0) * along
    depth, force = force_curve(world, tip, rest, along, second_force_n / sensing.gain, max_depth_m)
    # the foam's and the arm's own give: how far the joints have gone since the touch
    travel = depth + force / sensing.arm_n_per_m
    level, stop = _stop(depth, sensing.gain * force, travel, set_force_n, second_force_n, shallow_m)
    stop = min(stop + sensing.overshoot_m, float(travel[-1]))

    time = np.arange(math.floor((clearance_m + stop) * sensing.rate_hz / sensing.speed_m_s) + 1) / sensing.rate_hz
    end = (clearance_m + stop) / sensing.speed_m_s
    time = np.append(time[time < end - 1e-9], end)
    time = np.append(time, end + np.arange(1, round(dwell_s * sensing.rate_hz) + 1) / sensing.rate_hz)
    gone = np.minimum(time * sensing.speed_m_s - clearance_m, stop)
    true_depth = np.where(gone > 0.0, PchipInterpolator(travel, depth)(np.maximum(gone, 0.0)), gone)
    true_force = np.where(gone > 0.0, PchipInterpolator(travel, force)(np.maximum(gone, 0.0)), 0.0)
    position = rest - gone[:, None] * along + random.normal(scale=sensing.position_sd_m, size=(len(time), 3))
    aside = np.array([np.cos(sensing.friction_rad), np.sin(sensing.friction_rad), 0.0])
    truly_up = world.scene.normal(xy_m)
    pushed = along + sensing.friction * (aside - (aside @ truly_up) * truly_up)
    felt = sensing.gain * true_force[:, None] * pushed
    felt = felt + random.normal(scale=sensing.force_sd_n, size=(len(time), 3))
    reached = bool(sensing.gain * true_force[-1] > level * (1.0 - 1e-6))
    return Approach(time, position, felt, true_depth, true_force, level, reached)


@dataclass(frozen=True, slots=True)
class HeldTouch:
    """A touch that was held under its force and went back, as recorded, and as it was.

    time_s, position_m, force_n, true_depth_m, true_force_n: as of `Approach`; loading, held: how many samples lead up
    to the set force, and how many were taken until the way back; slid_m: how far it slid until then
    """

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
    set_force_n: float = 3.0,
    max_depth_m: float = 0.015,
    clearance_m: float = 0.005,
    back_m_s: float = 0.03,
    sensing: Sensing | None = None,
    random: np.random.Generator,
) -> HeldTouch:
    """Come down along the normal at a place (2,), keep the force for a while and go back, on foam with a memory.

    The force is kept as `robot.touch` keeps it: a speed in proportion to what is missing, no faster than the approach.
    """
    sensing = sensing or Sensing()
    xy_m = np.asarray(xy_m, dtype=np.float64)
    normal = world.scene.normal(xy_m)
    rest = np.append(xy_m, world.scene.foam_height_m(xy_m)) + (tip.radius or 0.0) * normal
    period_s, gone_m, give_m = 1.0 / sensing.rate_hz, -clearance_m, 0.0
    rows: list[tuple[float, float, float]] = []
    loading = held = 0
    stiff_n_per_m = 1.0
    while not held or gone_m > -clearance_m:
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
            gone_m -= back_m_s * period_s
        elif loading:
            wanted = FORCE_PER_S * (set_force_n - felt) / stiff_n_per_m
            gone_m += float(np.clip(wanted, -sensing.speed_m_s, sensing.speed_m_s)) * period_s
        else:
            gone_m += sensing.speed_m_s * period_s
    gone, depth, force_n = np.array(rows).T
    position = rest - gone[:, None] * normal + random.normal(scale=sensing.position_sd_m, size=(len(gone), 3))
    felt_n = sensing.gain * force_n[:, None] * normal + random.normal(scale=sensing.force_sd_n, size=(len(gone), 3))
    slid_m = 0.0
    if sensing.lean:
        aside_m = sensing.lean * np.maximum(gone, 0.0)
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


def force_curve(
    world: SlabWorld, tip: RigidTip, rest_m: FloatArray, normal: FloatArray, most_n: float, deepest_m: float
) -> tuple[FloatArray, FloatArray]:
    """(n,) depths [m], rising from 0, and the force along the normal at each [N], until one is beyond `most_n` or at
    `deepest_m`. rest_m: (3,) the tip where it just touches"""
    depths, forces = [0.0], [0.0]
    while forces[-1] <= most_n and depths[-1] < deepest_m:
        last = depths[-1]
        deeper = min(deepest_m, max(FIRST_M, min(FINER * last, last + STEP_M)))
        depths.append(deeper)
        forces.append(float(world.press(tip, rest_m - deeper * normal).force_n @ normal))
    return np.array(depths), np.maximum.accumulate(forces)


def _stop(
    depth: FloatArray, force: FloatArray, travel: FloatArray, first_n: float, second_n: float, shallow_m: float
) -> tuple[float, float]:
    """The force to stop at, and how far the arm has gone then since the touch [m]."""
    deep = PchipInterpolator(travel, depth)

    def at(level: float) -> float:
        if force[-1] <= level:
            return float(travel[-1])
        after = int(np.searchsorted(force, level, side="right"))
        low, high = travel[after - 1], travel[after]
        curve = PchipInterpolator(travel, force)
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if curve(middle) < level else (low, middle)
        return float(high)

    stop = at(first_n)
    if force[-1] > first_n and deep(stop) < shallow_m:
        return second_n, at(second_n)
    return first_n, stop
