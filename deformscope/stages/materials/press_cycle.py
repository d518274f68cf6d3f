"""When a motion has its largest load, and when its load ends: by displacement, by force, or as given by the user.

The pressed particles move along the push and come back after the release; nothing loads them any more once they rest
again. A camera cannot show whether a resting tool still presses, so that a force, if there is one, decides instead."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.results.render import ReportedResult, reported

RESTS = 0.03
"""Share of the push within which the pressed particles count as at rest, or as at the greatest depth."""

OFF_N, OFF_SHARE, OFF_SDS = 0.05, 0.05, 5.0
"""A tool is off if its force is at most this [N], or this share of the largest, or this number of standard deviations
of the sensor's readings before the push."""

ROUNDS, CAUCHY = 20, 2.0
"""Rounds of the weights, and of them the scale: medians of how far particles are off."""

LOST_HINT = "images in order, the one at rest first; a --roi with more texture, its edge inside; a smaller --stride"
FEWEST = 6
"""Least number of particles that must be seen throughout."""

RECORD = "record until the tool is off and the thing rests, or name both frames with --at LOADED,UNLOADED"


@dataclass(frozen=True, slots=True)
class PressForce:
    """A force over a motion. time_s: (n,) rising, on the motion's clock [s]; force_n: (n,) magnitude without the
    sensor's zero [N]; zero_sd_n: how the sensor scatters in free air [N]"""

    time_s: FloatArray
    force_n: FloatArray
    zero_sd_n: float

    def at(self, time_s: FloatArray) -> FloatArray:
        """Forces (T,) [N] at times of the motion."""
        return np.asarray(np.interp(time_s, self.time_s, self.force_n))

    def off_n(self) -> float:
        """Largest reading without contact [N]."""
        return max(OFF_N, OFF_SHARE * float(self.force_n.max()), OFF_SDS * self.zero_sd_n)


@dataclass(frozen=True, slots=True)
class PressCycle(ReportedResult):
    """A push and its end.

    loaded: last frame at the deepest; unloaded: first frame without a load, at rest by displacement
    course: (T,) displacement of the pressed particles along the push [unit of the positions]
    kept: share of that way that is left at the unloaded frame; source: source of the unloaded frame"""

    loaded: int = field(metadata=reported(key="loaded_frame"))
    unloaded: int = field(metadata=reported(key="unloaded_frame"))
    course: FloatArray
    kept: float = field(metadata=reported(key="kept_share"))
    source: Literal["displacement", "force", "given"] = field(metadata=reported())


def course_of(moved: FloatArray, pressed: IntArray) -> FloatArray:
    """(T,) displacement of the pressed particles along the push.

    moved: (T, K, d) displacements of all particles, NaN where one was not seen; pressed: particles that were pressed

    Particles below a tool are easily lost when it lifts. Therefore the share of the push in each frame is computed from
    all particles tracked throughout, and its size from the pressed particles at the largest depth."""
    amplitude, loaded, _ = share_of_push(moved)
    down = moved[loaded, pressed]
    down = down[np.isfinite(down).all(axis=1)]
    if not len(down):
        raise InputError("pressed particles that can be followed to the deepest frame", "every one was lost", LOST_HINT)
    return np.asarray(amplitude * float(np.linalg.norm(down.mean(axis=0))))


def share_of_push(moved: FloatArray) -> tuple[FloatArray, int, BoolArray]:
    """Each frame's share (T,) of the largest displacement, the frame of that displacement, and the particles (K,) that
    were tracked in all frames, which determine the shares.

    moved: (T, K, d) displacements, NaN where a particle was not seen"""
    known: BoolArray = np.asarray(np.isfinite(moved).all(axis=(0, 2)))
    if known.sum() < FEWEST:
        raise InputError(f"{FEWEST} particles that can be followed to the end", str(int(known.sum())), LOST_HINT)
    size = np.sum(moved[:, known] ** 2, axis=(1, 2))
    loaded = int(size.argmax())
    shape = moved[loaded, known]
    return np.array([_share(one, shape) for one in moved[:, known]]), loaded, known


def _share(moved: FloatArray, shape: FloatArray) -> float:
    """Scale of a displacement (k, d) relative to a shape (k, d): wrong tracks, as next to a tool that lifts, hardly
    count (Cauchy's weights)."""
    along, square = np.sum(moved * shape, axis=1), np.sum(shape**2, axis=1)
    weight, share = np.ones(len(shape)), 0.0
    for _ in range(ROUNDS):
        share = float(weight @ along) / max(float(weight @ square), 1e-300)
        off = np.linalg.norm(moved - share * shape, axis=1)
        weight = 1.0 / (1.0 + (off / max(CAUCHY * float(np.median(off)), 1e-300)) ** 2)
    return share


def find_cycle(
    course: FloatArray,
    noise: float,
    *,
    time_s: FloatArray | None = None,
    force: PressForce | None = None,
    given: tuple[int, int] | None = None,
) -> PressCycle:
    """The loaded and the unloaded frame of a course (T,).

    noise: deviation of the course; time_s: (T,) times of the frames, for a force; given: both frames, if the user named
    them. Raises InputError for a motion without a push, or without its end."""
    last = len(course) - 1
    if given is not None:
        if not 0 < given[0] < given[1] <= last:
            expected = f"--at LOADED,UNLOADED with 0 < LOADED < UNLOADED <= {last}, the last frame"
            raise InputError(expected, f"{given[0]},{given[1]}")
        return _cycle(course, *given, "given")
    peak = float(course.max())
    near = max(RESTS * peak, 3.0 * noise)
    if peak <= 2.0 * near:
        came = f"one whose contact moves by {peak:.3g}, with a noise of {noise:.2g}"
        raise InputError("a motion that is pressed", came, "a deeper push, or --contact where the tool is")
    loaded = int(np.flatnonzero(course >= peak - near)[-1])
    if force is not None and time_s is not None:
        off = force.at(time_s) <= force.off_n()
        off[: loaded + 1] = False
        pressed = np.flatnonzero(~off)
        if pressed[-1] == last:
            came = f"{float(force.at(time_s)[-1]):.2g} N at the last frame"
            raise InputError("a motion whose force goes back to nothing", came, RECORD)
        return _cycle(course, loaded, int(pressed[-1]) + 1, "force")
    if loaded == last:
        came = "one that is as deep at its last frame as ever"
        raise InputError("a motion that is loaded and released", came, RECORD)
    moving = np.flatnonzero(np.abs(course - course[-1]) > near)
    unloaded = int(moving[-1]) + 1
    if unloaded == last and course[-1] > near:
        came = f"one still on its way back at the last frame, {course[-1] / peak:.0%} deep"
        raise InputError("a motion that rests in the end", came, RECORD)
    return _cycle(course, min(loaded, unloaded - 1), unloaded, "displacement")


def _cycle(
    course: FloatArray, loaded: int, unloaded: int, source: Literal["displacement", "force", "given"]
) -> PressCycle:
    """The cycle of a course (T,) of the load, with the share of it that is left once unloaded."""
    left = float(course[unloaded] / course[loaded]) if course[loaded] else 0.0
    return PressCycle(loaded, unloaded, course, left, source)


def frames_to_fit(cycle: PressCycle, most: int, *, between: bool) -> IntArray:
    """Indices (n,) of at most this number of frames, rising: even along the loading, with the loaded, the unloaded and
    the last one.

    The first frame, at rest, is left out: a history of loads depends on the way, not on its duration. between: include
    frames of the unloading, for materials that flow with time; tracks next to a lifting tool are least accurate"""
    last = len(cycle.course) - 1
    known = {cycle.loaded, cycle.unloaded, (cycle.unloaded + last + 1) // 2, last}
    end = cycle.unloaded if between else cycle.loaded
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(cycle.course[: end + 1])))])
    even = np.linspace(0.0, way[-1], max(most - len(known), 0) + 2)[1:-1]
    return np.array(sorted(known | {max(1, int(np.searchsorted(way, one))) for one in even}))
