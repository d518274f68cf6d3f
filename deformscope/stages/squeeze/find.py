"""Place of a container on a table, by one depth image, before any contact.

    found = find_container(points_m, "cylinder")          # points (n, 3) in the table's frame, z = 0 on it
    found.center_m, found.size_m, found.deviation_m
    compare(found, find_container(later_m, "cylinder")).kind

Points above the table are split into connected pieces as seen from above. The upright cylinder or box is fitted to the
points of its sides by least squares (soft L1), its height to those of its top.
"""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.squeeze.placement import ContainerFit, ContainerShift
from deformscope.stages.squeeze.track import CORRELATED_PX

ABOVE_M = 0.015
"""Lower points belong to the table: several deviations of a depth camera's noise at 1 m. Higher, flat containers are
not seen; lower, noise of the table joins pieces."""
CELL_M, CELL_POINTS = 0.01, 3
"""Least number of points of an occupied cell seen from above: pixels are 2 mm apart at 1 m. A coarser one merges
objects a centimetre apart; a finer one splits a side at grazing angles."""
LEAST_POINTS, LEAST_HEIGHT_M = 300, 0.04
"""Fewest points and least height of a piece that may be a container: half of what one of 4 cm x 5 cm has at 1 m."""
TOP_M = 0.008
"""Distance below the top within which a point may belong to it: five deviations of depth at 1 m."""
MOST_POINTS = 4000
"""Fitted to at most: more change nothing that counts, and cost time in proportion."""
SOFT_M = 0.003
"""Points of a side that are further off weigh less: two deviations of depth at 1 m."""
BAD_RMS_M = 0.0025
"""A fit with a larger residual is refused: a right one at 1 m has 0.5 to 0.8 mm, twice that with twice the noise; a
cylinder fitted as a box 2.8 mm. Larger, another shape passes; smaller, bulging walls are refused."""
WALL_SD_M = 0.001
"""Uncertainty of a full container's middle in addition to the noise: its visible walls bulge by a millimetre."""
MOVED_M, MOVED_SD, TURNED_RAD = 0.005, 4.0, 0.09
"""A container counts as moved beyond this distance, or this number of standard deviations of both fits if that is more,
and as turned beyond this angle. Closing fingers themselves move one by some millimetres. A smaller one reports every
squeeze as a fault; a larger one misses a container that was pushed."""
SIZE_TOLERANCE_M = 0.01
"""Difference of a side from the stated one up to which it is the same container."""
TOPPLED_RAD, LOWER = 0.2, 0.8
"""It has toppled if its axis leans by more, or its height is below this share of its first height."""


class ContainerHidden(InputError):
    """Too little of it is seen to fit it. top_m: height of its level top, inf = not seen"""

    top_m = np.inf


def find_container(points_m: FloatArray, shape: str, *, expected: ContainerFit | None = None) -> ContainerFit:
    """The single container among points (n, 3) in the table's frame, without the robot.

    expected: the earlier fit, which gives the size and the place to search: parts may be hidden. Raises InputError,
    with the reason, for none, several, or another shape."""
    if shape not in ("box", "cylinder"):
        raise InputError("a box or a cylinder to find", repr(shape), 'shape = "box" in [container]')
    above = points_m[points_m[:, 2] > ABOVE_M]
    if expected is not None:
        reach_m = float(np.linalg.norm(expected.size_m))
        piece = above[np.linalg.norm(above[:, :2] - expected.center_m[:2], axis=1) < reach_m]
    else:
        pieces = _pieces(above)
        if len(pieces) != 1:
            where = ", ".join(f"({one[:, 0].mean():.2f}, {one[:, 1].mean():.2f})" for one in pieces)
            nothing = f"nothing that is {100 * LEAST_HEIGHT_M:g} cm high"
            came = f"{len(pieces)} things, at {where} m" if pieces else nothing
            raise InputError("one container on the table", came, "clear the table, or check [surface] and T_arm_camera")
        piece = pieces[0]
    if len(piece) < LEAST_POINTS:
        wanted = f"{LEAST_POINTS} points of a container"
        raise ContainerHidden(wanted, f"{len(piece)}", "a camera with the container in view")
    top_m = _top(piece[:, 2])
    if expected is not None:
        top_m = float(min(top_m, expected.size_m[2])) if top_m > LOWER * expected.size_m[2] else top_m
    sides = piece[(piece[:, 2] < top_m - TOP_M)]
    tops = piece[piece[:, 2] >= top_m - TOP_M]
    sides = sides[:: 1 + len(sides) // MOST_POINTS]
    if len(sides) < LEAST_POINTS // 3:
        came = f"{len(sides)} points of them"
        hidden = ContainerHidden("a container with visible sides", came, "a camera less steep")
        hidden.top_m = top_m if len(tops) >= LEAST_POINTS else np.inf
        raise hidden
    found = _upright(shape, sides, tops, top_m, expected)
    if found.rms_m > BAD_RMS_M:
        wanted = f"an upright {shape}, within {1e3 * BAD_RMS_M:.1f} mm"
        came = f"something that is off by {1e3 * found.rms_m:.1f} mm"
        raise InputError(wanted, came, "a container of [container] shape")
    return found


def compare(before: ContainerFit, after: ContainerFit | InputError) -> ContainerShift:
    """Change of a container. after: the container as found now, or why it was not found"""
    if isinstance(after, ContainerHidden) and after.top_m < LOWER * before.size_m[2]:  # it lies, its sides not seen
        reason = f"the object there is {100 * after.top_m:.1f} cm high, not {100 * before.size_m[2]:.1f} cm"
        return ContainerShift("gone", reason=reason)
    if isinstance(after, InputError):
        return ContainerShift("hidden" if isinstance(after, ContainerHidden) else "gone", reason=str(after))
    foot = [one.center_m[:2] - 0.5 * one.size_m[2] * one.lean_rad for one in (before, after)]
    moved_m = float(np.linalg.norm(foot[1] - foot[0]))
    # walls bulge alike in both
    noise = [np.maximum(one.deviation_m[:2] ** 2 - WALL_SD_M**2, 0.0) for one in (before, after)]
    sd_m = float(np.sqrt(np.sum(noise)))
    threshold_m = max(MOVED_M, MOVED_SD * sd_m)
    period = np.pi  # a box is the same turned by half a turn
    turned = abs((after.yaw_rad - before.yaw_rad + 0.5 * period) % period - 0.5 * period)
    turned_limit = max(TURNED_RAD, MOVED_SD * float(np.hypot(before.yaw_sd_rad, after.yaw_sd_rad)))
    lean = float(np.linalg.norm(after.lean_rad))
    kind, reason = "stands", ""
    if moved_m > threshold_m or turned > turned_limit:
        kind = "moved"
    if lean > TOPPLED_RAD or after.size_m[2] < LOWER * before.size_m[2]:
        kind = "toppled"
        reason = f"{100 * after.size_m[2]:.1f} cm high instead of {100 * before.size_m[2]:.1f} cm"
    return ContainerShift(kind, moved_m, threshold_m, float(turned), lean, reason)


def matches(found: ContainerFit, size_m: tuple[float, float, float]) -> ContainerFit:
    """The same with its x axis along the side that a rig file calls x. size_m: size of its `[container]`. Raises
    InputError for another container there."""
    choices = [found]
    if found.shape == "box":
        yaw = (found.yaw_rad + np.pi) % np.pi - 0.5 * np.pi
        choices.append(replace(found, yaw_rad=yaw, size_m=found.size_m[[1, 0, 2]]))
    best = min(choices, key=lambda one: float(np.abs(one.size_m - size_m).max()))
    off_m = np.abs(best.size_m - size_m)
    if (off_m > np.maximum(SIZE_TOLERANCE_M, MOVED_SD * best.deviation_m)).any():
        sizes = [" x ".join(f"{1e3 * side:.0f}" for side in sides) for sides in (size_m, best.size_m)]
        raise InputError(f"the {best.shape} of [container], {sizes[0]} mm", f"one of {sizes[1]} mm", "its size_m")
    return best


def _pieces(points: FloatArray) -> list[FloatArray]:
    """Connected pieces seen from above that may be containers."""
    if not len(points):
        return []
    cell = np.floor(points[:, :2] / CELL_M).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    count = np.zeros(cell.max(axis=0) + 2, np.int64)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1)
    _, label = cv2.connectedComponents((count >= CELL_POINTS).astype(np.uint8), connectivity=8)
    of_point = label[cell[:, 0], cell[:, 1]]
    found = [points[of_point == number] for number in range(1, int(label.max()) + 1)]
    return [one for one in found if len(one) >= LEAST_POINTS and _top(one[:, 2]) >= LEAST_HEIGHT_M]


def _top(heights_m: FloatArray) -> float:
    """Height of a level top, by the points within reach of the highest ones: single ones are noise."""
    high = np.sort(heights_m)[::-1]
    most = high[min(len(high) - 1, max(5, len(high) // 200))]
    return float(np.median(high[high > most - TOP_M]))


def _fitted(
    residual: Callable[[FloatArray], FloatArray], start: FloatArray, reach: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parameters (k,), their covariance (k, k), residuals at them (n,) [m]. reach: (k,) from the start at most"""
    bounds = start - reach, start + reach
    found = least_squares(residual, start, loss="soft_l1", f_scale=SOFT_M, x_scale=0.1 * reach, bounds=bounds)
    off = residual(found.x)
    off_m = 1.4826 * float(np.median(np.abs(off)))
    # noise of neighbouring pixels is not independent
    hessian = found.jac.T @ found.jac / max(off_m, 1e-5) ** 2 / CORRELATED_PX**2
    return np.asarray(found.x), np.asarray(np.linalg.pinv(hessian)), off


def _rms(off: FloatArray) -> float:
    """Root mean square of all but the worst tenth, corrected for Gaussian errors."""
    kept = np.sort(np.abs(off))[: max(1, int(0.9 * len(off)))]
    return float(np.sqrt(np.mean(kept**2))) * 1.24


def _upright(
    shape: str, sides: FloatArray, tops: FloatArray, top_m: float, expected: ContainerFit | None
) -> ContainerFit:
    """Fitted: place, lean, of a box its yaw, and half its sides or the radius where no size is expected."""
    box, free = shape == "box", expected is None
    seen = tops if free and len(tops) > 60 else sides
    if expected is not None:
        first, half, yaw = expected.center_m[:2], 0.5 * expected.size_m[: 1 + box], expected.yaw_rad
    elif box:
        middle_mm, size_mm, degrees = cv2.minAreaRect(1e3 * seen[:, :2].astype(np.float32))
        first, half, yaw = 1e-3 * np.array(middle_mm), 5e-4 * np.array(size_mm), float(np.radians(degrees))
    else:
        # the sides that are seen lie on one half of it: its middle is where its top is, if that is seen
        low, high = sides[:, :2].min(axis=0), sides[:, :2].max(axis=0)
        first = np.median(tops[:, :2], axis=0) if len(tops) > 30 else 0.5 * (low + high)
        half, yaw = np.array([0.5 * (high - low).max()]), 0.0

    def across(points: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 2) from the container's axis, along its sides."""
        aside = points[:, :2] - p[:2] - points[:, 2:] * p[2:4]
        c, s = (np.cos(p[4]), np.sin(p[4])) if box else (1.0, 0.0)
        return np.asarray(aside @ np.array([[c, -s], [s, c]]))

    def residual(p: FloatArray) -> FloatArray:
        size, out = p[4 + box :] if free else half, across(sides, p)
        if not box:
            return np.asarray(np.hypot(out[:, 0], out[:, 1]) - size[0])
        off = (np.abs(out) - size).max(axis=1)
        if not free:
            return np.asarray(off)
        # sides that are not seen end where the top does: shares of 1 % beyond either end of what is seen of it
        ends = np.quantile(across(seen, p), [0.01, 0.99], axis=0) / 0.98
        extent = np.concatenate([ends[1] - size, ends[0] + size])
        return np.asarray(np.concatenate([off, np.sqrt(0.05 * len(off)) * extent]))

    start = np.array([*first, 0.0, 0.0, *([yaw] * box), *(half if free else [])], np.float64)
    near_m = 0.02 if box and free else 0.1
    reach = [near_m, near_m, 1.0, 1.0, *([0.5] * box), *([0.01, 0.01] if box else [0.05])]
    p, covariance, off = _fitted(residual, start, np.array(reach[: len(start)]))
    half_m, size = 0.5 * top_m, 2.0 * (p[4 + box :] if free else half)
    at_middle = np.eye(len(p))[:2] + half_m * np.eye(len(p))[2:4]
    spread = np.diag(at_middle @ covariance @ at_middle.T)
    top_sd_m = 1.4826 * float(np.median(np.abs(tops[:, 2] - np.median(tops[:, 2]))))
    top_sd_m *= CORRELATED_PX / np.sqrt(max(len(tops), 1.0))
    return ContainerFit(
        shape=shape,
        center_m=np.array([*(p[:2] + half_m * p[2:4]), half_m]),
        yaw_rad=float((p[4] + 0.5 * np.pi) % np.pi - 0.5 * np.pi) if box else 0.0,
        size_m=np.array([size[0], size[-1], top_m]),
        lean_rad=p[2:4],
        deviation_m=np.array([*np.sqrt(spread + WALL_SD_M**2), top_sd_m]),
        yaw_sd_rad=float(np.sqrt(covariance[4, 4])) if box else 0.0,
        rms_m=_rms(off[: len(sides)]),
        points=len(sides),
    )
