"""Number of lumps that touches could distinguish from foam that scatters, with all its parameters known.

    limit(0.07)        # share of lumps as `lab:buried` draws them, within 30 touches, in foam that scatters by 7 %

An oracle with the scatter's deviation and length, and the inclusion's size, depth, contrast and place: 20 touches
spread evenly and 10 around the inclusion, each where it adds most. It then needs readings that are FOUND times as
probable with the lump as without one or with one elsewhere. No detector that has to search finds more.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr

from deformscope.arrays import FloatArray
from deformscope.lab.scenes import BURIED_SIZE_M, built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.stages.map.inclusion_posterior import FOUND, LEVEL_SD, InclusionHypotheses
from deformscope.stages.poke.inclusion_footprint import contrast_share

OWN_SD, EXPONENT_OWN_SD = 0.005, 0.024
"""Deviations of one touch of 5 N with the laboratory's sensors: log stiffness, and exponent."""
CONTACT_M, TIMES = 0.0095, 10.0
SPREAD, AROUND = (5, 4), 10
REACH_M, CELL_M, BORDER_M = 0.04, 0.01, 0.02
PLACES = 64
"""Lumps of 2 cm radius side by side in the field: one is there, or in another place, or there is none."""


def limit(scatter_sd: float, *, lumps: int = 40, seed: int = 0, exponent: bool = True) -> float:
    """Share of lumps that could be found. seed: seed of the first of the scenes; exponent: it is measured too"""
    need = float(np.log(PLACES * FOUND / (1.0 - FOUND)))
    shares = []
    for number in range(seed, seed + lumps):
        x, y, radius_m, depth_m = built_in("buried", number).inclusions_m[0]
        one = InclusionHypotheses(
            *(np.array([part]) for part in ((x, y), radius_m, depth_m, contrast_share(TIMES), 1.0))
        )
        apart = _deviations(one, scatter_sd, exponent)
        # log odds are normal, and half their variance on average
        shares.append(float(ndtr((0.5 * apart**2 - need) / apart)))
    return float(np.mean(shares))


def _deviations(lump: InclusionHypotheses, scatter_sd: float, exponent: bool) -> float:
    """By how many deviations the readings with a lump lie from those without."""
    places = _lattice(*SPREAD)
    every = _lattice(*(round((side - 2.0 * BORDER_M) / CELL_M) + 1 for side in BURIED_SIZE_M))
    near = every[np.linalg.norm(every - lump.centre_m, axis=1) < REACH_M]
    for _ in range(AROUND):
        separations2 = [_separation2(np.vstack([places, one]), lump, scatter_sd, exponent) for one in near]
        places = np.vstack([places, near[int(np.argmax(separations2))]])
    return float(np.sqrt(_separation2(places, lump, scatter_sd, exponent)))


def _separation2(places_m: FloatArray, lump: InclusionHypotheses, scatter_sd: float, exponent: bool) -> float:
    """Square of `_deviations` of touches at places (t, 2)."""
    felt = lump.shifts(places_m, CONTACT_M)
    apart2 = ((places_m[:, None] - places_m) ** 2).sum(axis=-1)
    covariance = scatter_sd**2 * np.exp(-0.5 * apart2 / LabErrors().scatter_length_m ** 2) + LEVEL_SD**2
    covariance += OWN_SD**2 * np.eye(len(places_m))
    log = felt.log[:, 0]
    separation2 = float(log @ cho_solve(cho_factor(covariance), log))
    if exponent:
        separation2 += float(np.var(felt.exponent)) * len(places_m) / EXPONENT_OWN_SD**2
    return separation2


def _lattice(columns: int, rows: int) -> FloatArray:
    x, y = (np.linspace(BORDER_M, side - BORDER_M, n) for side, n in zip(BURIED_SIZE_M, (columns, rows), strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
