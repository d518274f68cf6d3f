"""An arm that is guarded only by the force at its tip: its speed before contact, how far it may go below the surface,
and how deep with a force that does not follow.

An arm with joint torques detects a contact that its force sensor does not show; this one continues to press. The
approach is slow enough to stop in time: during filter, reading, decision and braking, the force grows by stiffness
times speed times that time."""

import math
from collections import deque
from dataclasses import dataclass

from deformscope.robot.readings import PERIOD_NS
from deformscope.robot.robot import Robot

STIFFEST_N_M = 1e5
"""Stiffness that is assumed if the compliance is unknown or smaller [N/m]: that of an industrial arm with a short
stick. A stiffer one makes every touch slower; a softer one lets a stiffer arm's force exceed the limit."""
ARM_CYCLES = 3.0
"""Cycles of the arm from a command to rest: one until the arm receives it, two to follow. A double whose axes lag by
another 60 ms stayed below the hard stop with it (14.1 N at 20 N/mm, `docs/results/safety.md`). A larger value makes
every touch slower."""
HARDENS = 2.0
"""How many times its stiffness since contact (force over depth) a thing may have further down. Larger, foam that creeps
or yields counts as a fault of the sensor; smaller, one that hardens is pressed harder before a fault is noticed."""
RISE_N, KNOWN_N = 0.05, 0.15
"""Least rise of the force over the depth that is watched, and force from which the stiffness is computed [N]: two and
six deviations of a period's mean with the noisiest sensor that passes (`preflight.NOISE_N`). Smaller, noise hides a
fault or makes soft foam look stiff; larger, the plateau of a foam counts as a fault."""
REMAINS, LOST_PERIODS, FELL_PERIODS = 0.5, 15, 2
"""Share of the greatest force of the last LOST_PERIODS control periods that is left without going back: foam relaxes by
a few percent in that time, and a sensor that dies, or whose sign or gain changes, loses more at once. That many periods
mean a fault."""
GONE, GONE_PERIODS = 0.2, 5
"""Share of the contact's force below which the mean of that many control periods is no contact any more. A larger share
stops at a contact that noise made early, a smaller one lets a sensor that died with the contact pass."""
REST_PERIODS = 100
"""Control periods over which the force before contact is averaged: a sensor drifts after its tare by as much as means
contact. More follow its drift too late, fewer follow the force of soft foam before it counts as contact."""
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
    hard_n: the hard stop; doubt_m: uncertainty of the seen surface; currents: the motors' currents are watched"""

    stiffness_n_m: float
    late_s: float
    hard_n: float
    doubt_m: float
    currents: bool

    @classmethod
    def of(cls, robot: Robot) -> "ForceAlone":
        """Computed from the sensor's filter and rate, the arm's cycle and compliance, and the supervisor's limits."""
        force, limits = robot.force.config, robot.supervisor.limits
        filter_hz = getattr(force, "filter_hz", 0.0)
        filtered_s = 1.0 / (2.0 * math.pi * filter_hz) if filter_hz else 0.0
        late_s = filtered_s + 1.0 / force.rate_hz + PERIOD_NS / 1e9 + ARM_CYCLES / robot.arm.state_hz
        stiffness_n_m = 1.0 / max(robot.compliance_m_per_n, 1.0 / STIFFEST_N_M)
        currents = bool(robot.pose.currents) and limits.collision_nm > 0
        return cls(stiffness_n_m, late_s, limits.hard_force_n, robot.doubt_m, currents)

    def speed_m_s(self, share: float) -> float:
        """Speed [m/s], SLOWEST_M_S at least, with which a contact reaches this share of the hard stop until rest."""
        return max(SLOWEST_M_S, share * self.hard_n / (self.stiffness_n_m * self.late_s))

    @property
    def contact_n(self) -> float:
        """The greatest force of a contact above the place where one is expected [N]."""
        return self.stiffness_n_m * self.late_s * self.speed_m_s(SURPRISE_SHARE)

    @property
    def undetected_n(self) -> float:
        """The greatest force [N] if the sensor fails on the way down, and no motor current shows the contact."""
        return self.stiffness_n_m * (self.doubt_m + MISS_M) + self.contact_n

    def words(self, max_depth_m: float) -> str:
        """Text with the forces, and the stiffness and delay from which they follow."""
        # the sensor's gain falls before a contact that is noticed as late as it can be: it looks like a softer thing
        deeper_n = self.undetected_n + self.stiffness_n_m * max_depth_m
        else_n = ", unless its motors' currents show it" if self.currents else ""
        return (
            f"{self.contact_n:.1f} N, by {self.stiffness_n_m / 1e3:.3g} N/mm and {1e3 * self.late_s:.0f} "
            f"ms until the arm rests; {self.undetected_n:.0f} N if the sensor fails on the way down{else_n}; at most "
            f"{deeper_n:.0f} N if it then measures only a small part"
        )


class PressWatch:
    """Whether a measured force can be that of a tip which goes deeper into what it has met; `look` once in each control
    period from the approach to the end of the dwell.

    A force that stays is noticed before the stiffness in series could have added CONTACT_SHARE of the hard stop: the
    arm's, or HARDENS times that since contact where it is less."""

    def __init__(self, alone: ForceAlone, contact_n: float, noise_n: float = 0.0) -> None:
        """contact_n: force that means contact [N]; noise_n: deviation of a reading, if more than a sensor's [N]"""
        self._alone, self._contact_n = alone, contact_n
        self._noise_n, self._known_n = noise_n, max(KNOWN_N, 6.0 * noise_n)
        self._farthest_m = alone.doubt_m + MISS_M
        self._passed: deque[tuple[float, float]] = deque()
        self._recent: deque[tuple[float, float]] = deque(maxlen=LOST_PERIODS)
        self._free_m = self._stiffness_n_m = self._rest_n = 0.0
        self._fell = self._pressed = 0

    def look(self, down_m: float, force_n: float, *, in_contact: bool) -> str:
        """Why the sensor must be wrong; empty where it need not be. down_m: place of the tip along the normal,
        downwards [m]; force_n: measured force along the normal [N]; in_contact: after contact"""
        alone = self._alone
        self._recent.append((force_n, down_m))
        mean_n = sum(one_n for one_n, _ in [*self._recent][-GONE_PERIODS:]) / GONE_PERIODS
        if not in_contact:
            if self._noise_n or force_n - self._rest_n < 0.25 * self._contact_n:
                self._free_m = down_m
            self._rest_n += (force_n - self._rest_n) / REST_PERIODS
            self._fell = self._fell + 1 if force_n < -2.0 * self._contact_n else 0
            return f"{force_n:.2f} N before contact: something pulls the tip" if self._fell >= FELL_PERIODS else ""
        most_n, at_m = max(self._recent)
        back_n = alone.stiffness_n_m * max(at_m - down_m, 0.0)
        fell = most_n - force_n > (1.0 - REMAINS) * most_n + back_n + max(RISE_N, 4.0 * self._noise_n)
        self._fell = self._fell + 1 if fell else 0
        self._pressed += 1
        if self._fell >= FELL_PERIODS or (self._pressed > GONE_PERIODS and mean_n < GONE * self._contact_n):
            return f"{force_n:.2f} N after {most_n:.2f} N, although the tip did not go back"
        # noise hides where contact began: then what is more than the force that means contact counts, from there on
        more_n = force_n - (self._contact_n if self._noise_n else self._rest_n)
        if more_n > self._known_n and down_m > self._free_m:
            seen_n_m = HARDENS * more_n / (down_m - self._free_m)
            self._stiffness_n_m = min(max(self._stiffness_n_m, seen_n_m), alone.stiffness_n_m)
        way_m = self._farthest_m
        if self._stiffness_n_m:
            way_m = min(way_m, CONTACT_SHARE * alone.hard_n / self._stiffness_n_m)
        self._passed.append((down_m, force_n))
        while len(self._passed) > 1 and self._passed[1][0] <= down_m - way_m:
            self._passed.popleft()
        then_m, then_n = self._passed[0]
        if then_m > down_m - way_m or force_n - then_n >= RISE_N:
            return ""
        return f"{force_n:.2f} N, {1e3 * (down_m - then_m):.2f} mm deeper than at {then_n:.2f} N"
