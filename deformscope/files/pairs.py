"""Pair files: a rest shape, the deformed shape, and what was held, in one `.npz`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.files.arrays_file import Arrays, indices, lattice, numbers, read_arrays, sized
from deformscope.stages.fit.model import Observation, touched_of
from deformscope.stages.fit.plausible import check_metres, check_same_unit
from deformscope.stages.msm.poke import TIP_SHAPES, Tip


def parse_pair(raw: bytes, where: object = "", *, noise_m: float | None = None) -> Observation:
    """The observation in a pair file's bytes.

    Needed: `rest (K, d)`, `deformed (K, d)` in metres, d = 2 or 3, `held (n,)` indices whose deformed position is
    prescribed. Optional: `shape` (lattice, last axis fastest), `cell (K,)` flat lattice index where it has holes,
    `observed (K,)` bool, `noise_m` (a number, or (K,)), `held_noise_m` (a number; 0 = exact), `force_n` with
    `contact (m,)`, a subset of `held`, and `force_noise_n`, the standard deviation of that force;
    without `contact` it acts on the held particles that moved (`stages.model.TOUCHED_SHARE`).
    `tip` (flat, disc, sphere) with `tip_size_m`: what pressed `contact`, where particles do not tell its size.
    Without `shape`, a rest shape that is regular within 1 % is taken as a lattice. noise_m: instead of the file's.
    Raises InputError for what is missing, does not fit together, is not finite, or cannot be metres.
    """
    found = read_arrays(raw, "a pair file (.npz of arrays)", where)
    try:
        return _observation(found, noise_m)
    except InputError as error:
        raise type(error).about(error, where) from error


def _observation(found: Arrays, noise_m: float | None) -> Observation:
    missing = [name for name in ("rest", "deformed", "held") if name not in found]
    if missing:
        keys = ", ".join(sorted(found)) or "nothing"
        raise InputError(f"{' and '.join(missing)} in the pair file", keys, "`Pair files` in docs/calibrating.md")
    rest, deformed = numbers(found, "rest"), numbers(found, "deformed")
    if rest.ndim != 2 or rest.shape[1] not in (2, 3):
        raise InputError("rest of shape (K, 2) or (K, 3)", str(rest.shape))
    if deformed.shape != rest.shape:
        raise InputError(f"deformed of rest's shape {rest.shape}", str(deformed.shape))
    if not np.isfinite(rest).all():
        raise InputError("finite positions", "NaN or infinity in rest", "drop those particles")
    count = len(rest)
    observed = np.ones(count, dtype=bool)
    if "observed" in found:
        observed = sized(found, "observed", count).astype(bool)
    held = indices(found, "held", count)
    shape, cell = lattice(found, rest)
    noise = None
    if noise_m is not None:
        noise = np.full(count, noise_m)
    elif "noise_m" in found:
        noise = numbers(found, "noise_m")
        if noise.size not in (1, count):
            raise InputError(f"one noise_m, or {count}", str(noise.size))
        noise = np.broadcast_to(noise.reshape(-1), (count,)).copy()
        if not (np.isfinite(noise).all() and (noise >= 0.0).all()):
            raise InputError("noise_m of 0 or more", "a negative or no number", "leave it out if it is not known")
    exact = None
    if "held_noise_m" in found:
        held_noise = numbers(found, "held_noise_m").reshape(-1)
        if held_noise.size != 1 or not (np.isfinite(held_noise).all() and held_noise[0] >= 0.0):
            raise InputError("one held_noise_m of 0 or more", "something else")
        exact = bool(held_noise[0] == 0.0)
        if noise is not None and not exact:
            noise[held] = held_noise[0]
    check_metres(rest, noise)
    known = observed | np.isin(np.arange(count), held)
    if np.isfinite(deformed[known]).all():  # an Observation refuses what is not
        check_same_unit(rest, deformed, known)
    force, contact = _force(found, rest, deformed, held)
    return Observation(
        rest,
        deformed,
        held,
        observed,
        noise=noise,
        shape=shape,
        cell=cell,
        force_n=force,
        contact=contact,
        force_noise_n=_force_noise(found),
        tip=_tip(found),
        held_measured=None if exact is None else not exact,
    )


def _force(
    found: Arrays, rest: npt.NDArray[Any], deformed: npt.NDArray[Any], held: npt.NDArray[Any]
) -> tuple[float | None, npt.NDArray[Any] | None]:
    if "force_n" not in found:
        return None, None
    force = abs(float(numbers(found, "force_n").reshape(-1)[0])) if found["force_n"].size else float("nan")
    if not np.isfinite(force):
        raise InputError("a finite force_n", "no number")
    if "contact" in found:
        contact = indices(found, "contact", len(rest))
        if not np.isin(contact, held).all():
            raise InputError("contact among the held particles", "others too", "add them to `held`")
        return force, contact
    return force, touched_of(rest, deformed, held)


def _tip(found: Arrays) -> Tip | None:
    if "tip" not in found:
        return None
    shape = next((one for one in TIP_SHAPES if one == str(found["tip"])), None)
    if shape is None:
        raise InputError(f"a tip out of {', '.join(TIP_SHAPES)}", repr(str(found["tip"])))
    if "tip_size_m" not in found:
        raise InputError("tip_size_m with tip", "none", "its sides or its diameter [m]")
    return Tip(shape, tuple(float(side) for side in numbers(found, "tip_size_m").reshape(-1)))


def _force_noise(found: Arrays) -> float | None:
    if "force_noise_n" not in found:
        return None
    noise = numbers(found, "force_noise_n").reshape(-1)
    if noise.size != 1 or not (np.isfinite(noise).all() and noise[0] >= 0.0):
        raise InputError("one force_noise_n of 0 or more", "something else", "leave it out if it is not known")
    return float(noise[0])
