"""Effect of a stiffness that changes with the force on the law that is fitted to a touch.

    to_log, to_exponent = law_response()
    log, exponent = to_log @ shifts, to_exponent @ shifts        # shifts (3,) of log stiffness under CONTACTS

The wider the contact has grown, the larger is the effect of an inclusion below the surface, or of a near edge. Their
effect on log stiffness grows with the force, and so does the exponent of F = k (z - z0)^p. A foam whose modulus varies
from place to place has the same exponent everywhere. To first order, of samples that are even in depth (`contact`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.poke.contact import EXPONENT

CONTACTS = (0.3, 0.65, 1.0)
"""Radii of the contact over that at the set force (Hertz: proportional to F^(1/3)), between which shifts are computed
parabolas: samples from the least force that is fitted."""
LEAST_SHARE = 0.02
"""Share of the set force from which a free exponent is fitted: 0.1 N of 5 are five times the sensors' noise. The
exponent is then known to 0.026, from 0.05 on to 0.034."""
SAMPLES = 400


@lru_cache(maxsize=1)
def law_response() -> tuple[FloatArray, FloatArray]:
    """(3,) weights of shifts of log stiffness under `CONTACTS` in the log stiffness at the set force that is fitted
    with a given exponent, and (3,) in the fitted exponent if it is free."""
    exponent = EXPONENT["sphere"]
    depth = np.linspace(LEAST_SHARE ** (1.0 / exponent), 1.0, SAMPLES)
    contact = depth ** (exponent / 3.0)
    others = [(one, np.delete(CONTACTS, number)) for number, one in enumerate(CONTACTS)]
    between = np.column_stack([np.prod((contact[:, None] - rest) / (one - rest), axis=1) for one, rest in others])
    moved = -depth[:, None] * between
    law = np.column_stack([np.ones_like(depth), depth, -depth * np.log(depth) / exponent])
    return -np.linalg.lstsq(law[:, :2], moved)[0][1], np.linalg.lstsq(law, moved)[0][2]
