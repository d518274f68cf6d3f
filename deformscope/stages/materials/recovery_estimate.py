"""Results of a push and its recovery: relaxing share, relaxation time, and permanent set."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from deformscope.arrays import FloatArray
from deformscope.results.declared import derived, reported
from deformscope.results.render import ReportedResult
from deformscope.stages.fit.estimate import Doubt, LengthUnit
from deformscope.stages.fit.relaxation import ForceKept

RecoveryBehaviour = Literal["elastic", "viscous", "plastic", "viscoplastic", "unidentified"]


MOTION_ALONE = "unidentified: motion alone does not determine it; record a force with the images"


@dataclass(frozen=True, slots=True)
class Number:
    """A number and its interval."""

    value: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryEstimate(ReportedResult):
    """Results of a push and its recovery.

    share: share of the modulus that relaxes; time_s: mean relaxation time [s], each branch weighted by its share
    share and time_s are lower bounds, relaxed an upper bound, if a reason reports that the end was not recorded; their
    intervals are open in that direction from a smaller probability of it on (`recovery.OPEN_RECOVERY`)
    force_kept: remaining share of the force at the end of the push, held there, for times within the record
    set: permanent share of the largest displacement; instant, relaxed: force over displacement of the pressed
    particles, immediate and relaxed [N per unit]; None without a force
    verdict: "viscous" if more than 3 % relaxes, "plastic" if more is permanent, both, neither (elastic), or unknown
    reasons: reasons to doubt it; explained: share of the motion after the release (squares) that one shape explains
    held_s: time from the push to the release; watched_s: time after the release; released: first frame after the
    release; time: (T,) [s]; observed, simulated: (T,) share of the largest displacement, simulated from the release on
    unit, metres_per_unit: unit and scale of the displacements
    """

    parameter: ClassVar[str] = "relaxing_share"

    share: Number = field(metadata=reported("share of the modulus that relaxes", flat=True, digits=".1%"))
    level: float = field(metadata=reported())
    verdict: RecoveryBehaviour = field(metadata=reported())
    reasons: tuple[Doubt, ...] = field(metadata=reported())
    explained: float = field(
        metadata=reported(
            "explained",
            words=lambda found: f"{max(found.explained, 0.0):.1%} of the motion by one shape that grows and shrinks",
        )
    )
    time_s: Number = field(
        metadata=reported(
            "mean relaxation time",
            key="relaxation_time_s",
            shown_unit="s",
        )
    )
    force_kept: tuple[ForceKept, ...] = field(
        metadata=reported(
            "force, held in place", words=lambda found: "; ".join(map(str, (found.force_kept[0], found.force_kept[-1])))
        )
    )
    set: Number = field(metadata=reported("permanent set", key="permanent_set_share", digits=".1%"))

    @property
    @derived()
    def permanent_set_m(self) -> Number | None:
        """Permanent set of the push [m]."""
        metres = 1.0 if self.unit == "m" else self.metres_per_unit
        if metres is None:
            return None
        low, high = (metres * self.largest * end for end in self.set.interval)
        return Number(metres * self.largest * self.set.value, (low, high))

    instant: Number | None = field(
        metadata=reported("stiffness at once", key="instant_n_per_m", per_length=True, missing=MOTION_ALONE)
    )
    relaxed: Number | None = field(
        metadata=reported("stiffness, relaxed", key="relaxed_n_per_m", per_length=True, missing=MOTION_ALONE)
    )
    held_s: float = field(metadata=reported())
    watched_s: float = field(metadata=reported())
    released: int = field(metadata=reported(key="released_frame"))
    largest: float = field(metadata=reported("pressed", key=None, length=True))
    time: FloatArray = field(metadata=reported(key="recovery.time_s"))
    observed: FloatArray = field(metadata=reported(key="recovery.observed"))
    simulated: FloatArray = field(metadata=reported(key="recovery.simulated"))
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    settings: dict[str, object] = field(default_factory=dict, metadata=reported())
