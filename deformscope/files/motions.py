"""Motion files: a rest shape, its particles frame by frame, and the held ones, in one `.npz`."""

from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.files.arrays_file import NOT_KNOWN, Arrays, indices, lattice, number, numbers, parsed, rest_of
from deformscope.stages.fit.motion import Motion
from deformscope.stages.fit.plausible import check_metres, check_same_unit


def parse_motion(raw: bytes, where: object = "", *, noise_m: float | None = None) -> Motion:
    """The motion in a file's bytes.

    Needed: `rest (K, d)` before any load and `motion (T, K, d)` in metres, d = 2 or 3, NaN for unseen particles.
    `held`, whose positions are prescribed, is indices `(n,)` for all frames, or bool `(T, K)` for a tool that comes and
    goes. Optional: `dt` [s] between frames, or `(T - 1,)`; `shape` and `cell` as in a pair file; `noise_m`.
    noise_m: noise that replaces the file's. Raises InputError for missing arrays, for arrays that contradict each
    other, and for values that cannot be metres."""
    return parsed(raw, "motion", where, lambda found: _motion(found, noise_m))


def _motion(found: Arrays, noise_m: float | None) -> Motion:
    rest = rest_of(found, ("rest", "motion", "held"), "motion")
    motion = numbers(found, "motion")
    if motion.ndim != 3 or motion.shape[1:] != rest.shape or len(motion) < 2:
        raise InputError(f"motion of shape (T, {rest.shape[0]}, {rest.shape[1]}), T from 2", str(motion.shape))
    shape, cell = lattice(found, rest)
    noise = (number(found, "noise_m", NOT_KNOWN) or None) if noise_m is None else noise_m
    check_metres(rest, None if noise is None else np.array([noise]))
    for position in motion:
        seen = np.isfinite(position).all(axis=1)
        if seen.any():
            check_same_unit(rest, position, seen)
    return Motion(rest, motion, _held(found, motion), _duration(found, len(motion)), shape, cell, noise)


def _held(found: Arrays, motion: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """(T, K) which particles are prescribed in each frame, of such a mask or of indices of particles."""
    if found["held"].dtype == np.bool_ and found["held"].shape == motion.shape[:2]:
        return found["held"].copy()
    held = np.zeros(motion.shape[:2], dtype=bool)
    held[:, indices(found, "held", motion.shape[1])] = True
    return held


def _duration(found: Arrays, frames: int) -> npt.NDArray[np.float64] | None:
    """(T,) duration of each step [s], the last one twice; None where the file has none."""
    if "dt" not in found:
        return None
    dt = numbers(found, "dt").reshape(-1)
    if dt.size not in (1, frames - 1) or not (np.isfinite(dt).all() and (dt > 0.0).all()):
        raise InputError(f"one dt above 0, or {frames - 1}", str(found["dt"].shape))
    return np.full(frames, dt[0]) if dt.size == 1 else np.append(dt, dt[-1])
