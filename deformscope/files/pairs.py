"""Pair files: a rest shape, the deformed shape, and the held particles, in one `.npz`."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.file_io import replacing
from deformscope.files.arrays_file import NOT_KNOWN, Arrays, indices, lattice, number, numbers, parsed, rest_of, sized
from deformscope.stages.fit.model import Observation, touched_of
from deformscope.stages.fit.plausible import check_metres, check_same_unit
from deformscope.stages.msm.poke import TIP_SHAPES, Tip


def parse_pair(raw: bytes, where: object = "", *, noise_m: float | None = None) -> Observation:
    """The observation in a pair file's bytes.

    Needed: `rest (K, d)`, `deformed (K, d)` in metres, d = 2 or 3, `held (n,)` indices whose deformed position is
    prescribed. Optional: `shape` (lattice, last axis fastest), `cell (K,)` flat lattice index where it has holes,
    `observed (K,)` bool, `noise_m` (a number, or (K,)), `held_noise_m` (a number; 0 = exact), `held_shift_m` (a
    number: deviation of the common offset of all held positions; 0 = registered exactly), `force_n` with
    `contact (m,)`, a subset of `held`, and `force_noise_n`, the standard deviation of that force;
    without `contact` it acts on the held particles that moved (`stages.model.TOUCHED_SHARE`).
    `tip` (flat, disc, sphere) with `tip_size_m`: the tip on `contact`, if particles do not show its size, and `tip_at_m
    (d,)`, the place of its axis: particles show that only within their spacing. Without `shape`, a rest shape that is
    regular within 1 % is taken as a lattice. noise_m: noise that replaces the file's. Raises InputError for missing
    arrays, for arrays that contradict each other, and for values that are not finite, or cannot be metres."""
    return parsed(raw, "pair", where, lambda found: _observation(found, noise_m))


def save_pair(seen: Observation, path: Path) -> None:
    """Write an observation as a pair file; an existing file is replaced. Raises InputError without a scale."""
    if (scale := seen.metres_per_unit) is None:
        raise InputError("a scale for a pair file, which is in metres", "pixels", "--px-per-cm or --scale-from")
    observed = np.isfinite(seen.deformed).all(axis=1) & seen.observed
    arrays = {"rest": scale * seen.rest, "deformed": scale * seen.deformed, "held": seen.held, "observed": observed}
    arrays |= {} if seen.noise is None else {"noise_m": scale * seen.noise}
    arrays |= {} if seen.shape is None or seen.cell is None else {"shape": np.array(seen.shape), "cell": seen.cell}
    if seen.force_n is not None:
        arrays |= {"force_n": np.array(seen.force_n), "contact": seen.touched}
        arrays |= {} if seen.force_noise_n is None else {"force_noise_n": np.array(seen.force_noise_n)}
    with replacing(path) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _observation(found: Arrays, noise_m: float | None) -> Observation:
    rest = rest_of(found, ("rest", "deformed", "held"), "pair")
    deformed = numbers(found, "deformed")
    if deformed.shape != rest.shape:
        raise InputError(f"deformed of rest's shape {rest.shape}", str(deformed.shape))
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
            raise InputError("noise_m of 0 or more", "a negative number, or none", NOT_KNOWN)
    held_noise = number(found, "held_noise_m")
    if noise is not None and held_noise:
        noise[held] = held_noise
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
        force_noise_n=number(found, "force_noise_n", NOT_KNOWN),
        tip=_tip(found),
        tip_at=_tip_at(found, rest.shape[1]),
        held_measured=None if held_noise is None else held_noise > 0.0,
        held_shift=number(found, "held_shift_m", NOT_KNOWN),
    )


def _force(
    found: Arrays, rest: npt.NDArray[Any], deformed: npt.NDArray[Any], held: npt.NDArray[Any]
) -> tuple[float | None, npt.NDArray[Any] | None]:
    """The force [N] and the indices (n,) of the particles that it presses; None, None where the file has none."""
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


def _tip_at(found: Arrays, dim: int) -> npt.NDArray[Any] | None:
    """(d,) place of the tip [m]; None where the file has none."""
    if "tip_at_m" not in found:
        return None
    at = numbers(found, "tip_at_m").reshape(-1)
    if at.size != dim or not np.isfinite(at).all():
        raise InputError(f"tip_at_m of {dim} finite coordinates [m]", f"{at.tolist()}")
    if "tip" not in found:
        raise InputError("tip and tip_size_m with tip_at_m", "no tip")
    return at


def _tip(found: Arrays) -> Tip | None:
    if "tip" not in found:
        return None
    shape = next((one for one in TIP_SHAPES if one == str(found["tip"])), None)
    if shape is None:
        raise InputError(f"a tip out of {', '.join(TIP_SHAPES)}", repr(str(found["tip"])))
    if "tip_size_m" not in found:
        raise InputError("tip_size_m with tip", "none", "its sides or its diameter [m]")
    return Tip(shape, tuple(float(side) for side in numbers(found, "tip_size_m").reshape(-1)))
