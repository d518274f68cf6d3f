"""An arm that is guarded only by the force at its tip: its speed before contact, and how far it may go below the
surface.

An arm with joint torques detects a contact that its force sensor does not show; this one continues to press. The
approach is slow enough to stop in time: during filter, reading, decision and braking, the force grows by stiffness
times speed times that time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from deformscope.robot.readings import PERIOD_NS
from deformscope.robot.robot import Robot

STIFFEST_N_M = 1e5
"""Stiffness that is assumed if the compliance is unknown or smaller [N/m]: that of an industrial arm with a short
stick. A stiffer one makes every touch slower; a softer one lets the force of a stiffer arm exceed the limit of its
speed."""
ARM_CYCLES = 3.0
"""Cycles of the arm from a command to rest: one until the arm receives it, two to follow. A double whose axes lag by
another 60 ms stayed below the hard stop with it (14.1 N at 20 N/mm, `docs/results/safety.md`). A larger value makes
every touch slower."""
SLOWEST_M_S = 1e-3
"""Lowest speed of the tip on its way down: 3 cm take half a minute. If a lower speed is needed, the preflight refuses
(`tip: force at contact`): a touch would take too long."""
CONTACT_SHARE, SURPRISE_SHARE = 1 / 3, 0.6
"""Share of the hard stop that a contact may reach where it is expected, and higher up. Larger leaves less for a delay
that is longer than reckoned; smaller makes every touch slower. Measured with them: 14.1 N of 15 N where a surface was
45 mm too high and axes lagged by another 60 ms (`docs/results/safety.md`)."""
MISS_M = 0.005
"""Distance below the observed surface, beyond the camera's uncertainty, to which the tip is sent without a contact [m].
An arm whose sensor fails on the way presses with its stiffness times this (509 N at 100 N/mm,
`docs/results/safety.md`); a smaller value misses a surface whose height was overestimated."""


@dataclass(frozen=True, slots=True)
class ForceAlone:
    """Bounds of the force of an arm that has no joint torques to show a contact.

    stiffness_n_m: stiffness of tip, sensor, stick and arm in series; late_s: time from a force until the arm rests
    hard_n: the hard stop; doubt_m: uncertainty of the seen surface; currents: the motors' currents are watched
    """

    stiffness_n_m: float
    late_s: float
    hard_n: float
    doubt_m: float
    currents: bool

    @classmethod
    def of(cls, robot: Robot) -> ForceAlone:
        """Computed from the sensor's filter and rate, the arm's cycle and compliance, and the supervisor's limits."""
        force, limits = robot.force.config, robot.supervisor.limits
        filtered_s = 1.0 / (2.0 * math.pi * force.filter_hz) if force.filter_hz else 0.0
        late_s = filtered_s + 1.0 / force.rate_hz + PERIOD_NS / 1e9 + ARM_CYCLES / robot.arm.state_hz
        stiffness_n_m = 1.0 / max(robot.compliance_m_per_n, 1.0 / STIFFEST_N_M)
        currents = bool(robot.pose.currents) and limits.collision_nm > 0
        return cls(stiffness_n_m, late_s, limits.hard_force_n, robot.doubt_m, currents)

    def speed_m_s(self, share: float) -> float:
        """The speed [m/s] at which a contact reaches this share of the hard stop until the arm rests; SLOWEST_M_S at
        least."""
        return max(SLOWEST_M_S, share * self.hard_n / (self.stiffness_n_m * self.late_s))

    @property
    def contact_n(self) -> float:
        """The greatest force of a contact above the place where one is expected [N]."""
        return self.stiffness_n_m * self.late_s * self.speed_m_s(SURPRISE_SHARE)

    @property
    def unfelt_n(self) -> float:
        """The greatest force [N] if the sensor fails on the way down, and no motor current shows the contact."""
        return self.stiffness_n_m * (self.doubt_m + MISS_M) + self.contact_n

    @property
    def words(self) -> str:
        """Text with both forces, and the stiffness and delay from which they follow."""
        else_n = ", unless its motors' currents show it" if self.currents else ""
        return (
            f"{self.contact_n:.1f} N, by {self.stiffness_n_m / 1e3:.3g} N/mm and {1e3 * self.late_s:.0f} "
            f"ms until the arm rests; {self.unfelt_n:.0f} N if the sensor fails on the way down{else_n}"
        )
