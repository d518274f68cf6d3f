"""What a push and its recovery show: what relaxes, how fast, and what is kept."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.fit.estimate import Doubt, LengthUnit

RecoveryVerdict = Literal["elastic", "viscous", "plastic", "viscoplastic", "unidentified"]


@dataclass(frozen=True, slots=True)
class Number:
    """A number and its interval."""

    value: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True)
class RecoveryEstimate:
    """What a push and its recovery show.

    share: of the modulus that relaxes; time_s: mean relaxation time [s], each branch weighed by its share
    set: share of the largest displacement that is kept for good
    instant, relaxed: force over displacement of what was pressed, at once and when all has relaxed [N per unit]; None
    without a force
    verdict: "viscous" where more than 3 % relaxes, "plastic" where more is kept, both, neither (elastic), or not
    known
    reasons: to doubt it; explained: share of the motion after the release (squares) that one shape explains
    held_s: from the push to the release; watched_s: after it; released: first frame after it
    time: (T,) [s]; observed, simulated: (T,) share of the largest displacement, simulated from the release on
    unit, metres_per_unit: of the displacements
    """

    share: Number
    time_s: Number
    set: Number
    instant: Number | None
    relaxed: Number | None
    verdict: RecoveryVerdict
    level: float
    reasons: tuple[Doubt, ...]
    explained: float
    held_s: float
    watched_s: float
    released: int
    largest: float
    time: FloatArray
    observed: FloatArray
    simulated: FloatArray
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    settings: dict[str, object] = field(default_factory=dict)

    def as_json(self) -> dict[str, object]:
        """The public form."""

        def public(one: Number | None, scale: float | None = 1.0) -> dict[str, object] | None:
            if one is None or scale is None:
                return None
            return {"value": scale * one.value, "interval": [scale * end for end in one.interval]}

        metres = 1.0 if self.unit == "m" else self.metres_per_unit
        stiffness = None if metres is None else 1.0 / metres
        return {
            "parameter": "relaxing_share",
            **(public(self.share) or {}),
            "level": self.level,
            "verdict": self.verdict,
            "reasons": [one.as_json() for one in self.reasons],
            "explained": self.explained,
            "relaxation_time_s": public(self.time_s),
            "permanent_set_share": public(self.set),
            "permanent_set_m": public(self.set, None if metres is None else metres * self.largest),
            "instant_n_per_m": public(self.instant, stiffness),
            "relaxed_n_per_m": public(self.relaxed, stiffness),
            "held_s": self.held_s,
            "watched_s": self.watched_s,
            "released_frame": self.released,
            "recovery": {
                "time_s": self.time.tolist(),
                "observed": self.observed.tolist(),
                "simulated": [None if not np.isfinite(one) else float(one) for one in self.simulated],
            },
            "settings": self.settings,
        }
