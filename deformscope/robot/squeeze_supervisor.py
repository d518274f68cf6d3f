"""Whether the hand may continue the squeeze: limits of its angles and pads, and the age of its devices' reports.

The first fault is latched (`latch`)."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.rig.sections import SqueezeSection
from deformscope.robot.latch import Action, Decision, LatchingSupervisor
from deformscope.robot.squeeze_plan import CLOSING_AXES
from deformscope_drivers.sdh.kinematics import fingertips

LIMIT_DEG = 1.0
"""An axis this near to the end of its range counts as at the end: reported angles are precise to 0.5 deg."""
TOO_HOT_C = 70.0
"""Largest temperature of a motor. Assumed: Schunk's firmware switches off at a higher one (error 29), not given."""
LATE_NS = 100_000_000
"""A judgement this long after the last one, five control periods, was late (`LatchingSupervisor`)."""


class SqueezeFault(StrEnum):
    """Why the hand must stop."""

    NONE = "none"
    SATURATED = "tactile array saturated"
    OVER_SQUEEZED = "container over-squeezed"
    JOINT_RANGE = "finger at the end of its range"
    HAND_SILENT = "hand silent"
    HAND_LOST = "hand lost"
    TACTILE_SILENT = "tactile arrays silent"
    TACTILE_LOST = "tactile arrays lost"
    TOO_HOT = "motor too hot"
    REFUSED = "hand takes no commands"
    PRESHAPE = "pre-shape not reached"
    TOUCHED_BEFORE = "fingertips touched before they closed"
    NO_CONTACT = "no contact"
    NOT_STILL = "no steady state"
    CONTRADICTED = "tactile arrays contradict the fingers"
    ARM = "arm that carries the hand"
    ASKED = "a person asked"


ADVICE: dict[SqueezeFault, str] = {
    SqueezeFault.SATURATED: "a lower current_a in [squeeze], or a lower sensitivity of the arrays",
    SqueezeFault.OVER_SQUEEZED: "a lower current_a in [squeeze], or a larger over_squeeze_m",
    SqueezeFault.JOINT_RANGE: "the container's size in [container], and its place",
    SqueezeFault.HAND_SILENT: "the hand's supply and cable",
    SqueezeFault.HAND_LOST: "the hand's supply and cable; it may still press with the current that was set",
    SqueezeFault.TACTILE_SILENT: "the tactile controller's supply and cable",
    SqueezeFault.TACTILE_LOST: "the tactile controller's supply and cable",
    SqueezeFault.TOO_HOT: "a pause, until the motors have cooled down",
    SqueezeFault.REFUSED: "the axis states: deformscope doctor",
    SqueezeFault.PRESHAPE: "obstacles between the fingers",
    SqueezeFault.TOUCHED_BEFORE: "contacts of the fingertips; open_deg in [squeeze]",
    SqueezeFault.NO_CONTACT: "the container's place between the fingers; onset_counts in [squeeze]",
    SqueezeFault.NOT_STILL: "still_deg, still_s and still_timeout_s in [squeeze]",
    SqueezeFault.CONTRADICTED: "each array, pressed by hand in deformscope live RIG --stage tactile; whether a finger "
    "is held next to its array; current_a in [squeeze], which must turn the fingers",
    SqueezeFault.ARM: "the reason for the arm's motion, its cable and supply; the fingers may still hold the container",
}
"""Advice by fault."""


@dataclass(frozen=True, slots=True)
class SqueezeObservation:
    """Items since the last control period, oldest first.

    position_deg: (n, 7) position of the hand's readings, hand_ns: (n,) their times; hottest_c: hottest of the motors,
    None = not known
    peak_counts: (m,) the highest texel of the squeezing fingertips in each tactile frame; tactile_ns: (m,)
    lost: names of devices whose link is down, and why"""

    now_ns: int
    hand_ns: tuple[int, ...] = ()
    position_deg: tuple[tuple[float, ...], ...] = ()
    hottest_c: float | None = None
    tactile_ns: tuple[int, ...] = ()
    peak_counts: tuple[int, ...] = ()
    lost: tuple[tuple[SqueezeFault, str], ...] = ()


SqueezeDecision = Decision[SqueezeFault]


class SqueezeSupervisor(LatchingSupervisor[SqueezeFault]):
    """The rules of a hand with tactile arrays; `judge` once in each control period.

    closing: False if the hand only opens: it then needs no tactile arrays, and may start at the end of its range"""

    def __init__(self, squeeze: SqueezeSection, fingers: tuple[int, int], now_ns: int, *, closing: bool = True) -> None:
        super().__init__(SqueezeFault.NONE, LATE_NS)
        self._closing = closing
        self._squeeze, self._fingers = squeeze, fingers
        self._contact_gap_m: float | None = None
        self._gap_m = np.inf
        self.start(now_ns)

    def start(self, now_ns: int) -> None:
        super().start(now_ns)
        self._hand_ns = self._tactile_ns = now_ns

    def in_contact(self) -> None:
        """Note that the fingertips are in contact: from now on their further closing is limited (`over_squeeze_m`)."""
        self._contact_gap_m = self._gap_m

    def judge(self, seen: SqueezeObservation) -> SqueezeDecision:
        """The verdict on the items of the last control period."""
        self._begin(seen.now_ns)
        tactile = self._tactile(seen) if self._closing else []
        lost = [one for one in seen.lost if self._closing or one[0] is SqueezeFault.HAND_LOST]
        found = (*lost, *self._hand(seen), *tactile)
        return self._latch([(Action.STOP, fault, reason) for fault, reason in found], seen.now_ns)

    def _hand(self, seen: SqueezeObservation) -> list[tuple[SqueezeFault, str]]:
        found: list[tuple[SqueezeFault, str]] = []
        for when, angles in zip(seen.hand_ns, seen.position_deg, strict=True):
            self._hand_ns = when
            self._gap_m = gap_m(np.array(angles), self._fingers)
            closer_m = 0.0 if self._contact_gap_m is None else self._contact_gap_m - self._gap_m
            if closer_m > self._squeeze.over_squeeze_m:
                most_mm = 1e3 * self._squeeze.over_squeeze_m
                found.append(
                    (SqueezeFault.OVER_SQUEEZED, f"{1e3 * closer_m:.1f} mm since contact, limit {most_mm:g} mm")
                )
            for axis in CLOSING_AXES:
                if self._closing and angles[axis] > 90.0 - LIMIT_DEG:
                    found.append((SqueezeFault.JOINT_RANGE, f"axis {axis} at {angles[axis]:.1f} deg"))
        if seen.hottest_c is not None and seen.hottest_c > TOO_HOT_C:
            found.append((SqueezeFault.TOO_HOT, f"{seen.hottest_c:.0f} degC, limit {TOO_HOT_C:g} degC"))
        if age_s := self._silent_s(self._hand_ns, self._squeeze.hand_silent_s):
            found.append((SqueezeFault.HAND_SILENT, f"no reading for {1e3 * age_s:.0f} ms"))
        return found

    def _tactile(self, seen: SqueezeObservation) -> list[tuple[SqueezeFault, str]]:
        found: list[tuple[SqueezeFault, str]] = []
        for when, peak in zip(seen.tactile_ns, seen.peak_counts, strict=True):
            self._tactile_ns = when
            if peak >= self._squeeze.saturation_counts:
                found.append((SqueezeFault.SATURATED, f"a texel at {peak} counts"))
        if age_s := self._silent_s(self._tactile_ns, self._squeeze.tactile_silent_s):
            found.append((SqueezeFault.TACTILE_SILENT, f"no frame for {1e3 * age_s:.0f} ms"))
        return found


def gap_m(position_deg: FloatArray, fingers: tuple[int, int]) -> float:
    """Distance between the two fingertips along the axis of closing [m]. position_deg: (7,) position of the axes"""
    tips = fingertips(np.asarray(position_deg, np.float64))
    return float(tips[fingers[0], 0] - tips[fingers[1], 0])
