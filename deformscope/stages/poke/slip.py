"""Did the tip slide over the foam while it pressed? The slip is computed from the force and the motion across the
normal.

While a contact sticks, the force across grows with the motion across, dT = k (F / d) dx. A ball on an elastic body is
about STICK times as stiff across as along (Mindlin 1949: 2 (1 - v) / (2 - v) of the tangent, with F / d the secant). A
sensor or a normal that is tilted adds a share of F. Once T reaches a limit, mu F, it stays at the limit while the tip
moves: the tip slides. Both are averaged over k, mu and tilt; the slip is the motion beyond the limit."""

from dataclasses import dataclass

import numpy as np
import scipy

from deformscope.arrays import FloatArray
from deformscope.stages.poke.contact import LOADED

STICK, STICK_SD = 0.9, 0.3
TILT_SD = 0.05
"""Deviation of the share of F that a tilted sensor or normal adds: 3 degrees."""
FRICTION = np.geomspace(0.03, 2.0, 40)
STICKS = STICK + STICK_SD * np.linspace(-2.0, 2.0, 9)
PIECES = 40
"""Number of parts of the touch whose means are compared."""
STICK_OFF = 0.1
"""Error of that law, as a share of the force across."""
START_SD = 0.02
"""Standard deviation of the lateral force before the first part that is compared, as a share of the largest force."""
SMOOTHED = 9
"""Samples over which the way across is averaged."""
SLID_M = 5e-4
"""A smaller slip counts as none."""


@dataclass(frozen=True, slots=True)
class SlipFit:
    """probability: probability that the tip slid by SLID_M or more; slid_m: distance, if it slid; friction:
    lateral force by normal force where it slid"""

    probability: float
    slid_m: float
    friction: float


def fit_slip(
    across_m: FloatArray, across_n: FloatArray, dent_m: FloatArray, force_n: FloatArray, force_sd_n: float
) -> SlipFit:
    """Slip of a touch until its retract. across_m, across_n: (n, 2) place and force in the surface's plane, the force
    without its offset"""
    peak = float(force_n.max())
    loaded = slice(int(np.argmax(force_n > LOADED * peak)), None)
    kernel = np.full(SMOOTHED, 1.0 / SMOOTHED)
    padded = np.pad(across_m, ((SMOOTHED // 2, SMOOTHED // 2), (0, 0)), mode="edge")
    smooth_m = np.stack([np.convolve(one, kernel, mode="valid") for one in padded.T], axis=1)[loaded]
    force, lateral = np.maximum(force_n[loaded], LOADED * peak), across_n[loaded]
    secant = force / np.maximum(dent_m[loaded], 1e-5)
    # how the force across would grow did the contact stick
    steps_m = np.diff(smooth_m, axis=0, prepend=smooth_m[:1])
    sticking = np.cumsum(secant[:, None] * steps_m, axis=0)
    way = sticking[-1] if np.linalg.norm(sticking[-1]) > 0.0 else np.array([1.0, 0.0])
    way = way / np.linalg.norm(way)
    sticking_n, moved_m = sticking @ way, (smooth_m - smooth_m[0]) @ way
    ends = np.unique(np.linspace(0, len(force), PIECES + 1).round().astype(int))
    count = np.diff(ends)

    def pieces(one: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(one, ends[:-1], axis=-1) / count)

    stick, friction = (one.ravel() for one in np.meshgrid(STICKS, FRICTION, indexing="ij"))
    whole = stick[:, None] * sticking_n
    limit = friction[:, None] * force
    slid = np.abs(whole) > limit
    across = pieces(lateral @ way)
    sd = np.hypot(force_sd_n / np.sqrt(count), STICK_OFF * np.abs(across)) + 1e-3
    off = (across - pieces(np.clip(whole, -limit, limit))) / sd
    # tilt and start are taken out in closed form
    taken = np.stack([TILT_SD * pieces(force), np.full(len(count), START_SD * peak)], axis=1) / sd[:, None]
    shared = off @ taken
    fitted = (off**2).sum(axis=1) - (shared * np.linalg.solve(taken.T @ taken + np.eye(2), shared.T).T).sum(axis=1)
    prior = -0.5 * ((stick - STICK) / STICK_SD) ** 2
    log_weight = prior - 0.5 * fitted
    weight = np.exp(log_weight - scipy.special.logsumexp(log_weight))
    steps = np.diff(moved_m, prepend=moved_m[:1])
    slid_m = np.abs((slid * steps).sum(axis=1))
    slides = slid_m > SLID_M
    probability = float(weight[slides].sum())
    given = weight * slides if probability > 0.0 else weight
    return SlipFit(
        probability=probability,
        slid_m=float(np.average(slid_m, weights=given)),
        friction=float(np.average(friction, weights=given)),
    )
