"""The force on the contact of a video: at the fitted frame, or a log over the whole motion."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.calibrate import Observation
from deformscope.stages.fit.doubts import ordered
from deformscope.stages.fit.estimate import Doubt, Estimate, Plane, PushCurve, WithInterval, relative_verdict
from deformscope.stages.fit.force import depth_along, pushed_along
from deformscope.stages.materials.plane_modulus import ForceOffset, find_offset, plane_modulus
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.see.particles import ParticleGrid, Rect, Tracked, select_held

MOST_N = 100.0
"""A larger force is not what a kitchen scale shows [N]."""
GEL_PA = 2e3
"""Modulus below which a foam or a rubber is unlikely, and a force in kilograms likely [Pa]."""
GAIN, RESOLUTION_N = 0.02, 9.80665e-3
"""Standard deviation of a force that is not stated: a share of it, and 1 g."""


TURN_SD, HAND_TURN = 2e-4, 2e-3
"""Standard deviation of a camera's turn that was seen, and of one by a hand [rad]."""
LOOSE = 0.03
"""Standard deviation of a depth from which a turn that is not known is named, as a share."""

OF_IMAGES = ("nothing-moved", "rigid-motion", "axes-swapped", "unfit-images", "body-unsure")
"""Doubts of a fit that concern stiffness and modulus too, which do not rest on the fitted model."""


@dataclass(frozen=True, slots=True)
class PushOptions:
    """force_n: force at the last frame [N], None = that of a log; force_sd_n: its standard deviation [N], None = a
    kitchen scale's; scale_sd, thickness_sd: standard deviations of the picture's scale and of the thickness, as shares
    force_offset_s: time of the log at the first frame [s], None = found by the motion; thickness_m, plane_strain: see
    `plane_modulus`"""

    force_n: float | None = None
    force_sd_n: float | None = None
    scale_sd: float = 0.01
    thickness_m: float | None = None
    thickness_sd: float = 0.02
    plane_strain: bool = False
    force_offset_s: float | None = None


@dataclass(frozen=True, slots=True)
class Pushed:
    """An observation with its force, and what was found of a log. offset: None without a log"""

    seen: Observation
    offset: ForceOffset | None = None
    curve: PushCurve | None = None


def with_force(
    seen: Observation,
    grid: ParticleGrid,
    history: Sequence[Tracked],
    times: Sequence[float],
    turns: FloatArray,
    parts: Sequence[str],
    contact: Rect | None,
    push: PushOptions,
    log: PressForce | None,
    level: float,
) -> Pushed:
    """The last pose with the force on its contact. times, turns: time of each frame after the first [s], and the
    camera's turn since then [rad], NaN where it is not known; parts, contact: what is held, and the footprint of the
    tool; log: the force over time, where `push` has none"""
    known, turn = np.isfinite(turns), np.nan_to_num(turns)
    seen = dataclasses.replace(
        seen,
        contact=_contact(seen, grid, parts, contact),
        scale_sd=push.scale_sd,
        turn=float(turn[-1]),
        turn_sd=TURN_SD if known[-1] else HAND_TURN,
    )
    offset, curve, spread = None, None, 0.0
    if log is None:
        assert push.force_n is not None
        force = push.force_n
    else:
        moved, time_s = _depths(seen, history, turn), np.asarray(times)
        _check_given(push.force_offset_s, time_s, log)
        offset = find_offset(time_s, moved, log, level, push.force_offset_s)
        force, spread = float(offset.force_n[-1]), offset.force_sd_n
        if not force > log.off_n():
            came = f"{force:.2g} N at {time_s[-1] + offset.value:.3g} s of the log"
            raise InputError("a force at the fitted frame", came, "--force-frame of a pressed frame")
        loading = slice(int(moved.argmax()) + 1)
        if seen.metres_per_unit is not None:
            curve = PushCurve(seen.metres_per_unit * moved[loading], offset.force_n[loading])
    usual = float(np.hypot(GAIN * force, RESOLUTION_N))
    sd = float(np.hypot(usual if push.force_sd_n is None else push.force_sd_n, spread))
    return Pushed(dataclasses.replace(seen, force_n=force, force_noise_n=sd), offset, curve)


def found_by_force(estimate: Estimate, pushed: Pushed, push: PushOptions, seed: int) -> Estimate:
    """An estimate with its force, and with the modulus if scale and thickness are known."""
    seen, level = pushed.seen, estimate.level
    assert seen.force_n is not None
    half = float(ndtri(0.5 + 0.5 * level)) * float(seen.force_noise_n or 0.0)
    force: WithInterval = (seen.force_n, (max(seen.force_n - half, 0.0), seen.force_n + half))
    at = pushed.offset
    offset = None if at is None else (at.value, at.interval)
    of_both = [one for one in estimate.reasons if one.code in OF_IMAGES]
    stiffness = estimate.contact_stiffness
    estimate = dataclasses.replace(
        estimate,
        force=force,
        force_curve=pushed.curve,
        force_offset=offset,
        stiffness_verdict="unidentified" if stiffness is None else relative_verdict(*stiffness, of_both),
    )
    doubts = list(estimate.reasons)
    if seen.force_n > MOST_N:
        doubts.append(Doubt("units", f"a force of {seen.force_n:.3g} N: grams given as newtons?"))
    depth = pushed_along(seen)
    if depth is not None and seen.turn_sd == HAND_TURN and depth[2] > LOOSE * depth[1]:
        text = f"the depth is off by {depth[2] / depth[1]:.0%} if a hand turned the camera: film more of what is still"
        doubts.append(Doubt("unfit-images", text, "weak"))
    if push.thickness_m is None or seen.metres_per_unit is None:
        return dataclasses.replace(estimate, reasons=ordered(doubts))
    plane: Plane = "strain" if push.plane_strain else "stress"
    try:
        found = plane_modulus(seen, push.thickness_m, push.thickness_sd, plane, level, seed)
    except InputError as error:  # of the motion: the fit itself stands
        doubts.append(Doubt("not-converged", f"no modulus: {error}"))
        return dataclasses.replace(estimate, modulus_verdict="unidentified", reasons=ordered(doubts))
    doubts += [one for one in found.reasons if one.code == "units"]
    if found.modulus[0] < GEL_PA:
        doubts.append(Doubt("units", f"a modulus of {found.modulus[0]:.3g} Pa is a gel's: kilograms given as newtons?"))
    return dataclasses.replace(
        estimate,
        modulus=found.modulus,
        poisson=found.poisson,
        plane=plane,
        modulus_verdict=relative_verdict(*found.modulus, [*found.reasons, *of_both]),
        reasons=ordered(doubts),
    )


def _contact(seen: Observation, grid: ParticleGrid, held: Sequence[str], contact: Rect | None) -> IntArray:
    """The held particles (m,) that something pressed: the contact, else the part that moved most."""
    parts = ["contact"] if "contact" in held else list(held)
    each = [np.intersect1d(select_held(grid, [one], contact), seen.held) for one in parts]
    each = [one for one in each if len(one)] or [seen.touched]
    move = seen.deformed - seen.rest
    return max(each, key=lambda one: float(np.linalg.norm(move[one].mean(axis=0))))


def _depths(seen: Observation, history: Sequence[Tracked], turns: FloatArray) -> FloatArray:
    """(T,) depth of the contact at each frame, along the push [px]. turns: (T,) of the camera [rad]"""
    push = pushed_along(seen)
    if push is None:
        raise InputError("a contact that moves, for its force", "none", "the frames in order, the one at rest first")
    found = []
    for moment, turn in zip(history, turns, strict=True):
        there = np.asarray(moment.position_px, dtype=np.float64)
        now = dataclasses.replace(seen, deformed=there, observed=moment.seen, turn=float(turn))
        found.append(depth_along(now, push[0]))
    return np.array(found)


def _check_given(offset_s: float | None, time_s: FloatArray, log: PressForce) -> None:
    if offset_s is not None and not log.time_s[0] <= time_s[-1] + offset_s <= log.time_s[-1]:
        came = f"{log.time_s[0]:.4g} to {log.time_s[-1]:.4g} s, and the last frame at {time_s[-1] + offset_s:.4g} s"
        raise InputError("a force log that has the fitted frame", came, "another --force-offset-s")
