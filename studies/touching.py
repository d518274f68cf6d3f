"""A controller's record of a tip that moves down on the foam and stops, for statistics over many touches.

Touches without wires or a control loop: the foam's force over depth is computed once, and read at the arm's place at
each sample."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld

FIRST_M, STEP_M, FINER = 2e-6, 3e-4, 1.35
"""Depths at which the force is computed: from the first, each deeper by this factor, until they are a step apart."""


@dataclass(frozen=True, slots=True)
class Sensing:
    """Errors of arm and force sensor.

    rate_hz: samples a second; speed_m_s: speed of the arm; position_sd_m, force_sd_n: noise of each axis of each sample
    arm_n_per_m: stiffness of the arm, whose joint angles do not show its bending; infinite by default; gain: ratio of
    measured to true force; the measured one determines where the arm stops; overshoot_m: overshoot after the stop
    friction: lateral over normal force, in the direction `friction_rad` from the x axis"""

    rate_hz: float = 100.0
    speed_m_s: float = 0.01
    position_sd_m: float = 1e-4
    force_sd_n: float = 0.02
    arm_n_per_m: float = math.inf
    gain: float = 1.0
    overshoot_m: float = 0.0
    friction: float = 0.0
    friction_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Approach:
    """A touch as recorded, and its truth.

    time_s: (n,) time from the start; position_m: (n, 3) the arm's position of the tip's middle (a flat tip's face)
    force_n: (n, 3) measured force on the tip; all in the surface frame; true_depth_m: (n,) how far the tip had sunk
    along the normal, negative above; true_force_n: (n,) true force along the normal
    level_n: the last set force; reached: the set force was reached, not only the largest depth"""

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
    """Move down on a place (2,) along the surface's normal (3,) until the force or the depth is reached.

    If the dent at the set force is shallower than `shallow_m`, the arm continues to the second force. It starts
    `clearance_m` above the surface, and stays `dwell_s` where it stopped. The last sample before the stay is at the
    stop itself, less than a period after the one before."""
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


def force_curve(
    world: SlabWorld, tip: RigidTip, rest_m: FloatArray, normal: FloatArray, most_n: float, deepest_m: float
) -> tuple[FloatArray, FloatArray]:
    """Depths (n,) [m], rising from 0, and the force along the normal at each [N], until a force exceeds `most_n` or the
    depth is `deepest_m`. rest_m: (3,) place of the tip at first contact"""
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
