"""Permanent set of a touch: the remaining dent at the release, beyond relaxation.

A ball that goes back leaves a viscoelastic foam where

    H(t) = integral of E(t - s) d'(s) ds = 0        (Ting 1966),

its dent d being shallower by the relaxed part. While force is left, F^(1/p) is about linear in H; the line through the
retract, extrapolated to F = 0, gives the H of the release. For foam with a permanent share s of every dent it is s
times the part of the approach in H; for all other foam it is 0."""

from __future__ import annotations

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.poke.contact import ArmCompliance

LEAST_BACK, MOST_BACK = 0.05, 0.6
"""Shares of the peak between which the way back is fitted."""
FEWEST_BACK = 4
LAW_LEFT, LAW_LEFT_SD = -0.013, 0.02
"""Apparent permanent share of elastic foam, and its deviation, due to the law: F^(1/p) is no straight line, and the
table bends the law (50 touches of finite elements, seeds reserved for choosing)."""


def kept_share(
    time_s: FloatArray,
    dent_m: FloatArray,
    force_n: FloatArray,
    held: int,
    exponent: FloatArray,
    share: FloatArray,
    relaxation_s: FloatArray,
    arm: ArmCompliance,
    force_sd_n: float,
) -> tuple[FloatArray, FloatArray] | None:
    """(d,) share of the dent that stays, and its deviation, of laws that are drawn; None where the way back was not
    recorded.

    time_s, force_n: (n,) times and force of a whole touch; dent_m: (d, n), 0 before contact; held: samples until the
    way back; exponent: (d,); share, relaxation_s: (d, b) share and relaxation of the modulus that relaxes"""
    peak = float(force_n[:held].max())
    lost = np.flatnonzero(force_n[held:] < LEAST_BACK * peak)
    if not len(lost):
        return None
    back = np.arange(held, held + int(lost[0]) + 1)
    back = back[force_n[back] < MOST_BACK * peak]
    if len(back) < FEWEST_BACK:
        return None
    moved_m, middle_s = np.diff(dent_m, axis=1), 0.5 * (time_s[1:] + time_s[:-1])
    gone_s = time_s[back, None] - middle_s
    left = np.zeros((len(dent_m), *gone_s.shape))
    left += (1.0 - share.sum(axis=1))[:, None, None]
    for one, relaxed_s in zip(share.T, relaxation_s.T, strict=True):
        left += one[:, None, None] * np.exp(-np.maximum(gone_s, 0.0) / relaxed_s[:, None, None])
    each = np.where(gone_s > 0.0, left, 0.0) * moved_m[:, None]
    whole, way_in = each.sum(axis=2), each[:, :, : held - 1].sum(axis=2)
    rooted = np.maximum(force_n[back] / peak, 0.0) ** (1.0 / exponent[:, None])
    # H over F^(1/p): places scatter, forces hardly
    middle, spread = rooted.mean(axis=1, keepdims=True), whole.mean(axis=1)
    slope = ((rooted - middle) * whole).sum(axis=1) / ((rooted - middle) ** 2).sum(axis=1)
    at_none = spread - slope * middle[:, 0]
    lever = 1.0 / len(back) + middle[:, 0] ** 2 / ((rooted - middle) ** 2).sum(axis=1)
    scatter_m = np.hypot(arm.position_sd_m, slope * force_sd_n / peak)
    put_in = way_in.mean(axis=1)
    return at_none / put_in - LAW_LEFT, np.hypot(scatter_m * np.sqrt(lever) / put_in, LAW_LEFT_SD)
