"""A stick's tip and force sensor: the tip's position, the sensor's orientation, its readings in free air, its load.

Axes are those of the tip's frame: z along the stick, outwards. A push is the force of the tip on the world: pressing
the tip onto a table is a push along +z, pressing it with a finger towards -x a push along +x.

The ball at the tip stays in one place (a cone, a ring, a hole's rim) while the arm's end is turned about it, a pivot.
Each pose gives R p + t = q with the tip p in the frame of the arm's end and the place q in the base frame: linear in
both."""

from dataclasses import dataclass

import numpy as np
import scipy

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.transform import ErrorPrior, TransformEstimate, half_widths, judged, rigid

PIVOTED = ErrorPrior(0.0007)
"""Deviation of the ball from its place by the arm's poses [m]: its play, and the arm's repeatability."""
FEWEST = 4
LEAST_SPREAD = 0.12
"""Smallest spread of the rotations, in the direction that they determine least: 0.17 = tilts of 10 degrees each way
about two axes."""
DOUBT_SHARE = 0.6
"""Prior standard deviation of the angle between the two possible directions of a stick: the interval then is that
angle."""
SLID_M = 0.006
"""Scatter of the ball above which it has moved."""


@dataclass(frozen=True, slots=True, eq=False)
class TipEstimate:
    """The tip's centre at the arm's end.

    T_ee_center: the tip's centre to the arm's end. Its z axis runs from the arm's end through the tip, its x axis as
    close as possible to the end's (`calibrate force` finds the turn of the force sensor about the stick)
    pivot_m: (3,) place of the ball, base frame [m]; pivot_sd_m: its scatter; off_m: (n,) offset of each pose"""

    T_ee_center: TransformEstimate
    pivot_m: FloatArray
    pivot_sd_m: float
    off_m: FloatArray


def spread(rotations: FloatArray) -> float:
    """Spread of rotations (n, 3, 3): deviation of R p over them for the unit vector p for which it is least."""
    centred = rotations - rotations.mean(axis=0)
    return float(np.linalg.svd(centred.reshape(-1, 3), compute_uv=False)[-1] / np.sqrt(len(rotations)))


def pivot(T_base_ee: FloatArray) -> TipEstimate:
    """The tip about which the arm's end (n, 4, 4) was turned.

    A pivot does not determine the stick's direction: it is assumed to run from the arm's end to the tip. Its interval
    reaches to the end's own z axis on either side, the direction of a stick that is mounted off the middle. Raises
    InputError for poses that are too few or turned too little, and a ball that slid."""
    poses = np.asarray(T_base_ee, np.float64)
    if len(poses) < FEWEST:
        raise InputError(f"{FEWEST} poses or more", str(len(poses)), "tilt the stick about its ball, each way")
    if not np.isfinite(poses).all():
        raise InputError("finite poses", "NaN or infinity")
    turns = poses[:, :3, :3]
    if (reached := spread(turns)) < LEAST_SPREAD:
        came = f"a spread of {np.degrees(reached):.0f} degrees about the least determined axis"
        hint = "tilt the stick by 20 degrees to the left, to the right, towards you and away"
        raise InputError(f"poses turned by {np.degrees(LEAST_SPREAD):.0f} degrees about two axes", came, hint)
    design = np.concatenate([turns, np.broadcast_to(-np.eye(3), turns.shape)], axis=2).reshape(-1, 6)
    inverse = np.linalg.inv(design.T @ design)
    solution = inverse @ (design.T @ -poses[:, :3, 3].ravel())
    left_over = design @ solution + poses[:, :3, 3].ravel()
    found = judged(solution, inverse, left_over, PIVOTED)
    if found.scatter > SLID_M:
        came = f"one that scatters by {1e3 * found.scatter:.1f} mm"
        raise InputError("a ball that stays in its place", came, "a cone or a ring that holds it, and slower motion")
    tip_m = solution[:3]
    length_m = float(np.linalg.norm(tip_m))
    z = tip_m / length_m
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    if np.linalg.norm(x) < 0.1:
        came = f"a tip at {tip_m.round(3).tolist()} m"
        raise InputError("a stick that is not along the x axis of the arm's end", came)
    x /= np.linalg.norm(x)
    doubt_rad = float(np.arccos(np.clip(z[2], -1.0, 1.0)))
    turned = (DOUBT_SHARE * doubt_rad) ** 2 + np.trace(found.covariance[:3, :3]) / length_m**2
    covariance = scipy.linalg.block_diag(found.covariance[:3, :3], turned * np.eye(3))
    estimate = TransformEstimate(rigid(np.column_stack([x, np.cross(z, x), z]), tip_m), covariance, found.dof)
    off_m = np.linalg.norm(left_over.reshape(-1, 3), axis=1)
    return TipEstimate(estimate, solution[3:], found.sd, off_m)


PUSHED = ErrorPrior(np.radians(6.0))
"""Deviation of the direction of a push by hand [rad]."""
FREE, FREE_NM = ErrorPrior(0.01), ErrorPrior(0.001)
"""Deviation of a mean force and torque in free air [N, N m]."""
LEAST_WEIGHT_N, MOST_OFF = 0.2, 0.1
"""Least weight whose centre can be found, and largest share of a weight that its readings may be off: an axis of the
sensor that is turned wrongly leaves most of it. Chosen."""
PRESSED = ErrorPrior(0.02)
"""Standard deviation of a scale's load while a person holds it [N]: 2 g."""
LEAST_N = 0.5
LEAST_LOAD_N = 1.0
LEAST_ANGLE_RAD = np.radians(30.0)
"""Least angle between the lines of two pushes across the stick: with a smaller one it is unknown whether the sensor's
axes are mirrored."""
ASIDE_RAD = np.radians(35.0)
"""Angle of a push to every possible axis of the sensor from which it is refused."""
BLOCK_S = 1.0
"""Noise of a filtered sensor is independent over this."""
LEAST_TURN = 0.15
"""Spread of rotations (`tip.spread`)."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceMount:
    """Orientation of the sensor on the stick.

    R_tip_force: (3, 3) orthogonal: forces in the sensor's axes to the tip's; a determinant of -1 = an axis mirrored
    turn_rad, turn_half_rad: its turn about the stick, and half its interval; push_sd_rad: deviation of a push
    off_rad: (n,) angle of each push across the stick from what the others give"""

    R_tip_force: FloatArray
    turn_rad: float
    turn_half_rad: float
    push_sd_rad: float
    off_rad: FloatArray


def mount(force_n: FloatArray, axes: FloatArray) -> ForceMount:
    """Orientation of the sensor, from its forces (n, 3) [N] during pushes along `axes` (n, 3), unit vectors in the
    tip's frame.

    The sensor's z axis is taken to lie along the stick, one way or the other. Raises InputError for pushes too weak,
    along one axis alone, without one along the stick, or that fit no way of sitting."""
    force, pushed = np.asarray(force_n, np.float64), np.asarray(axes, np.float64)
    size_n = np.linalg.norm(force, axis=1)
    if not np.isfinite(force).all() or (size_n < LEAST_N).any():
        raise InputError(f"pushes of {LEAST_N:g} N or more", f"{np.nanmin(size_n):.2f} N", "push harder, and hold")
    along = np.abs(pushed[:, 2]) > 0.9
    if not along.any():
        raise InputError("a push along the stick (z)", "none", "press the tip onto the table: +z")
    signs = np.sign(force[along, 2] * pushed[along, 2])
    aside = np.linalg.norm(force[along, :2], axis=1) > np.tan(ASIDE_RAD) * np.abs(force[along, 2])
    if aside.any() or len(set(signs.tolist())) > 1:
        came = "one that the sensor measures across it" if aside.any() else "pushes whose signs contradict each other"
        raise InputError("pushes along the stick that the sensor measures on its z axis", came, "push along the stick")
    flat, aim = force[~along, :2], pushed[~along, :2]
    lines = np.arctan2(aim[:, 1], aim[:, 0])
    between = np.abs(lines[:, None] - lines) % np.pi
    if np.minimum(between, np.pi - between).max(initial=0.0) < LEAST_ANGLE_RAD:
        raise InputError("pushes along x and along y", "pushes along one axis alone", "push +x as well as +y")
    if (np.abs(force[~along, 2]) > np.tan(ASIDE_RAD) * np.linalg.norm(flat, axis=1)).any():
        came = "one that the sensor measures along the stick"
        raise InputError("pushes across the stick", came, "push along x and y")
    seen = np.arctan2(flat[:, 1], flat[:, 0])
    plain, mirrored = _turned(seen, lines), _turned(-seen, lines)
    turn, off = min((plain, mirrored), key=lambda one: float(one[1] @ one[1]))
    handed = 1.0 if turn == plain[0] else -1.0
    found = judged(np.array([turn]), np.eye(1) / len(off), off, PUSHED)
    if found.scatter > 5.0 * PUSHED.sd:
        came = f"pushes {np.degrees(np.abs(off).max()):.0f} degrees off"
        raise InputError("pushes along the requested axes", came, "push along the arm's axes as shown")
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s * handed, 0.0], [s, c * handed, 0.0], [0.0, 0.0, signs[0]]])
    return ForceMount(R, turn, float(found.half()[0]), found.sd, off)


def _turned(seen: FloatArray, aimed: FloatArray) -> tuple[float, FloatArray]:
    """The angle that turns directions (n,) to others (n,), and the residuals (n,) [rad]."""
    between = np.exp(1j * (aimed - seen))
    turn = float(np.angle(between.mean()))
    return turn, np.asarray(np.angle(between * np.exp(-1j * turn)))


@dataclass(frozen=True, slots=True)
class ForceGain:
    """gain: a sensor's forces over true ones; sd, half: its deviation, and half its interval; off: (n,) offset of each
    load"""

    gain: float
    sd: float
    half: float
    off: FloatArray


def force_gain(force_n: FloatArray, load_n: float) -> ForceGain:
    """The gain, from the forces (n, 3) [N] beyond free air that a sensor gave under a known load [N]. Raises InputError
    for a load that is too small, and for forces outside a sensor's possible gain."""
    measured_n = np.linalg.norm(np.asarray(force_n, np.float64), axis=1)
    if not (load_n >= LEAST_LOAD_N and len(measured_n)):
        raise InputError(f"a load of {LEAST_LOAD_N:g} N or more", f"{load_n:g} N", "the set force of a touch, or more")
    if not 0.5 * load_n < measured_n.mean() < 2.0 * load_n:
        came = f"{measured_n.mean():.2f} N under {load_n:g} N"
        raise InputError("a sensor whose gain is between 0.5 and 2", came, "the load in newtons: 102 g are 1 N")
    mean_n = float(measured_n.mean())
    found = judged(np.array([mean_n]), np.eye(1) / len(measured_n), measured_n - mean_n, PRESSED)
    sd = float(np.sqrt(found.covariance[0, 0]))
    return ForceGain(mean_n / load_n, sd / load_n, float(found.half()[0]) / load_n, (measured_n - mean_n) / load_n)


@dataclass(frozen=True, slots=True, eq=False)
class FreeAir:
    """Readings of the sensor while nothing touches it.

    tare_n: (3,) mean reading [N]; noise_n: (3,) deviation of a reading [N]
    drift_n_per_min, drift_half: (3,) drift and half its interval [N/min]"""

    tare_n: FloatArray
    noise_n: FloatArray
    drift_n_per_min: FloatArray
    drift_half: FloatArray


def free_air(time_s: FloatArray, force_n: FloatArray) -> FreeAir:
    """Tare, noise and drift out of readings (n, 3) [N] at times (n,) [s], by means over BLOCK_S."""
    when, force = np.asarray(time_s, np.float64), np.asarray(force_n, np.float64)
    block = ((when - when[0]) / BLOCK_S).astype(int) if len(when) else np.zeros(0, int)
    whole = np.unique(block)[:-1]
    if len(whole) < 5:
        raise InputError(f"{6 * BLOCK_S:g} s of readings in free air", f"{np.ptp(when) if len(when) else 0:.1f} s")
    means = np.array([force[block == one].mean(axis=0) for one in whole])
    minutes = np.array([when[block == one].mean() for one in whole]) / 60.0
    design = np.column_stack([np.ones(len(whole)), minutes - minutes.mean()])
    inverse = np.linalg.inv(design.T @ design)
    fits = [judged(inverse @ design.T @ y, inverse, y - design @ (inverse @ design.T @ y), NOTHING) for y in means.T]
    noise = np.concatenate([force[block == one] - force[block == one].mean(axis=0) for one in whole]).std(axis=0)
    slopes, halves = ([float(one.value[1]) for one in fits], [float(one.half()[1]) for one in fits])
    return FreeAir(force.mean(axis=0), noise, np.array(slopes), np.array(halves))


NOTHING = ErrorPrior(0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class HangingWeight:
    """Load of the sensor, from readings in free air in several poses.

    weight_n, weight_half_n: its weight and half its interval [N]; bias_n: (3,) reading without it
    down: (3,) direction of its weight, base frame: an upright base has (0, 0, -1); off_n: (n,) left over
    covariance: (6, 6) covariance of bias and weight, base frame; dof: its scale's degrees of freedom"""

    weight_n: float
    weight_half_n: float
    bias_n: FloatArray
    down: FloatArray
    off_n: FloatArray
    covariance: FloatArray
    dof: float

    @property
    def bias_half_n(self) -> FloatArray:
        """(3,) half the interval of the bias [N]."""
        return half_widths(self.covariance, self.dof)[:3]


def hanging_weight(force_n: FloatArray, R_base_tip: FloatArray, R_tip_force: FloatArray) -> HangingWeight:
    """The weight on the sensor, from mean readings (n, 3) [N] with the tip turned as R_base_tip (n, 3, 3).

    A load that hangs pulls at the sensor, which a tip that presses compresses: f = b - R_tip_force^T R_base_tip^T w.
    Raises InputError for poses that are turned too little."""
    force = np.asarray(force_n, np.float64)
    turns = -np.swapaxes(np.asarray(R_base_tip, np.float64) @ np.asarray(R_tip_force, np.float64), -1, -2)
    if len(force) < 3 or spread(turns) < LEAST_TURN:
        came = f"{len(force)} poses that are turned too little"
        raise InputError("three poses or more, tilted by 20 degrees", came, "tilt the stick left, right and away")
    design = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2).reshape(-1, 6)
    inverse = np.linalg.inv(design.T @ design)
    value = inverse @ (design.T @ force.ravel())
    left_over = design @ value - force.ravel()
    found = judged(value, inverse, left_over, FREE)
    weight_n = float(np.linalg.norm(value[3:]))
    down = value[3:] / max(weight_n, 1e-9)
    half = half_widths(np.atleast_2d(down @ found.covariance[3:, 3:] @ down), found.dof)
    off_n = np.linalg.norm(left_over.reshape(-1, 3), axis=1)
    return HangingWeight(weight_n, float(half[0]), value[:3], down, off_n, found.covariance, found.dof)


@dataclass(frozen=True, slots=True, eq=False)
class ToolLoad:
    """What a sensor carries. weight: from its forces; center_m, center_half_m: (3,) the centre of mass in the sensor's
    frame and half its interval, bias_nm, bias_half_nm: (3,) the torque without it; None without torques"""

    weight: HangingWeight
    center_m: FloatArray | None = None
    center_half_m: FloatArray | None = None
    bias_nm: FloatArray | None = None
    bias_half_nm: FloatArray | None = None


def tool_load(
    force_n: FloatArray, torque_nm: FloatArray | None, R_base_tip: FloatArray, R_tip_force: FloatArray
) -> ToolLoad:
    """Weight, and centre of mass, from mean readings of a six-axis sensor; arguments as in `hanging_weight`, torque_nm:
    (n, 3) [N m], None for a sensor of three axes. Torques are linear in the centre: t = b + c x f (Kubus et al. 2007).

    Raises InputError for poses that are turned too little, a weight below LEAST_WEIGHT_N, and forces of no weight."""
    weight = hanging_weight(force_n, R_base_tip, R_tip_force)
    if weight.weight_n < LEAST_WEIGHT_N:
        raise InputError(f"a tool of {LEAST_WEIGHT_N:g} N or more", f"{weight.weight_n:.2f} N", "no calibration of it")
    off = float(np.sqrt((weight.off_n**2).mean())) / weight.weight_n
    if off > MOST_OFF:
        came = f"forces that are off by {100.0 * off:.0f} % of it"
        raise InputError("forces of one weight", came, "deformscope calibrate force RIG first, and poses in free air")
    if torque_nm is None:
        return ToolLoad(weight)
    turns = -np.swapaxes(np.asarray(R_base_tip @ R_tip_force, np.float64), -1, -2)
    levers = -_crossed(turns @ (weight.weight_n * weight.down))  # c x f, as a matrix of c
    design = np.concatenate([np.broadcast_to(np.eye(3), levers.shape), levers], axis=2).reshape(-1, 6)
    inverse = np.linalg.inv(design.T @ design)
    value = inverse @ (design.T @ torque_nm.ravel())
    found = judged(value, inverse, design @ value - torque_nm.ravel(), FREE_NM)
    by_weight = inverse @ design.T @ (_crossed(value[3:]) @ turns).reshape(-1, 3)  # the weight is known to its interval
    covariance = found.covariance + by_weight @ weight.covariance[3:, 3:] @ by_weight.T
    half = half_widths(covariance, found.dof)
    return ToolLoad(weight, value[3:], half[3:], value[:3], half[:3])


def _crossed(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) that give the cross product of vectors (..., 3) with another."""
    return np.asarray(np.cross(vectors[..., None, :], np.eye(3)).swapaxes(-1, -2))
