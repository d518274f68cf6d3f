"""One touch: down along the normal, press to a set force, dwell until still, and back.

A state machine that is stepped once in a control period: its input are forces and the tip's place, its output is a
velocity. Near contact the control is hybrid (Raibert and Craig 1981): force along the normal, position or force
across it."""

import dataclasses
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from deformscope.arrays import IntArray
from deformscope.errors import InputError
from deformscope.robot.force_alone import CONTACT_SHARE, MISS_M, SURPRISE_SHARE, ForceAlone, PressWatch
from deformscope.robot.latch import Action
from deformscope.robot.placement import Placement
from deformscope.robot.readings import PERIOD_NS, ArmSample, ForceSample, RobotObservation
from deformscope.robot.robot import MotionHeld, Robot, RobotStopped, TipVelocity
from deformscope.robot.supervisor import Fault
from deformscope.robot.travel import GAIN_PER_S, NotThere, to_above
from deformscope_drivers.arm.kinematics import FloatArray


class ForceControl:
    """The force along the normal becomes a velocity: `v = (set - force) / (stiffness * tau)`, admittance control.

    The stiffness is the slope of force over depth of the last periods. Before contact it is that of a rigid contact
    behind a compliant arm, which prevents overshoot."""

    TAU_S = 0.12
    RIGID_N_M, SOFT_N_M = 6000.0, 150.0
    LEAST_WAY_M = 1e-4

    def __init__(self, fastest_m_s: float, rigid_n_m: float = RIGID_N_M) -> None:
        """fastest_m_s: bound of the velocity; rigid_n_m: stiffness taken before one is measured [N/m]"""
        self._fastest_m_s = fastest_m_s
        self._seen: deque[tuple[float, float]] = deque(maxlen=16)
        self.stiffness_n_m = rigid_n_m
        self._most_n_m = max(10 * self.RIGID_N_M, rigid_n_m)

    def see(self, depth_m: float, force_n: float) -> None:
        """Update the stiffness with one period's depth [m] and force along the normal [N]."""
        self._seen.append((depth_m, force_n))
        slopes = []
        for back in (4, 15):
            if len(self._seen) > back:
                then_m, then_n = self._seen[-1 - back]
                if (way_m := depth_m - then_m) > self.LEAST_WAY_M:
                    slopes.append((force_n - then_n) / way_m)
        if slopes:
            self.stiffness_n_m = min(max(*slopes, self.SOFT_N_M), self._most_n_m)

    def velocity_m_s(self, set_n: float, force_n: float) -> float:
        """Velocity along -normal, positive into the surface [m/s]. set_n, force_n: requested and measured [N]"""
        asked = (set_n - force_n) / (self.stiffness_n_m * self.TAU_S)
        return min(max(asked, -self._fastest_m_s), self._fastest_m_s)


class Phase(StrEnum):
    """State of the touch, for a state timeline."""

    TRAVEL = "travel"
    TARE = "tare"
    APPROACH = "approach"
    PRESS = "press"
    DWELL = "dwell"
    PRESS_MORE = "press more"
    DWELL_MORE = "dwell more"
    BACK_OFF = "back off"
    RETREAT = "retreat"
    DONE = "done"


class TouchEnding(StrEnum):
    """Why a touch ended."""

    SET_FORCE = "set force reached"
    DEPTH = "greatest depth reached"
    NO_CONTACT = "nothing met"
    NOT_SETTLED = "set force not reached in time"
    SOFT_STOP = "backed off"
    STOPPED = "stopped"
    NOT_REACHED = "target not reached"
    HELD = "held"


@dataclass(frozen=True, slots=True)
class TouchPlan:
    """Where and how to touch; lengths [m], forces [N], speeds [m/s], in the surface frame.

    point_m: (3,) estimated place of the surface; normal: (3,) normal of the surface there, outwards
    set_force_n: force of the touch; more_force_n: force if the dent stays below small_dent_m, None = never
    max_depth_m: greatest depth below the first contact; standoff_m: height of the tip above the point before and after;
    travel_height_m: z of the tip's centre when it crosses; slow_within_m: distance from the point within which the
    approach is slow; miss_m: how far below the point contact is sought
    far_speed_m_s, contact_speed_m_s, travel_speed_m_s: speeds far, near and in contact, and between touches
    contact_force_n: force along the normal that means contact; noise_n: deviation of a reading, where it is that of an
    arm's own force; dwell_s: duration at rest; dwell_at_most_s: longest
    dwell; tangential: "held" = the tip stays on the normal's line, "free" = it follows forces across
    passing_m: distance above the point at which the tip continues, without coming to rest there
    slow_back: until contact is lost the tip goes back as slowly as it came, to measure the energy that the foam returns
    braking_per_s: share of the remaining way that the tip travels in a second while it slows down in free air; None =
    slowly; rigid_n_m: assumed stiffness of a contact before it is known"""

    point_m: FloatArray
    normal: FloatArray
    set_force_n: float = 3.0
    more_force_n: float | None = 5.0
    small_dent_m: float = 0.002
    max_depth_m: float = 0.015
    standoff_m: float = 0.05
    travel_height_m: float = 0.18
    slow_within_m: float = 0.03
    miss_m: float = 0.02
    far_speed_m_s: float = 0.03
    contact_speed_m_s: float = 0.01
    travel_speed_m_s: float = 0.05
    contact_force_n: float = 0.1
    noise_n: float = 0.0
    dwell_s: float = 0.5
    dwell_at_most_s: float = 3.0
    tangential: Literal["held", "free"] = "held"
    passing_m: float = 0.0
    slow_back: bool = False
    braking_per_s: float | None = None
    rigid_n_m: float = ForceControl.RIGID_N_M

    def __post_init__(self) -> None:
        point, normal = np.asarray(self.point_m, float), np.asarray(self.normal, float)
        if point.shape != (3,) or normal.shape != (3,) or not np.all(np.isfinite([point, normal])):
            raise InputError("point_m (3,) and normal (3,), finite", f"{point.tolist()}, {normal.tolist()}")
        size = float(np.linalg.norm(normal))
        if not (size > 1e-6 and normal[2] / size > math.cos(math.radians(45.0))):
            raise InputError("a normal within 45 deg of up", f"{normal.tolist()}", "another place")
        object.__setattr__(self, "point_m", point)
        object.__setattr__(self, "normal", normal / size)
        if not 0 < self.contact_force_n < self.set_force_n <= (self.more_force_n or self.set_force_n):
            forces = f"{self.contact_force_n}, {self.set_force_n}, {self.more_force_n}"
            raise InputError("0 < contact_force_n < set_force_n <= more_force_n", forces)
        if not 0 < self.contact_speed_m_s <= self.far_speed_m_s <= 0.05:
            speeds = f"{self.contact_speed_m_s}, {self.far_speed_m_s}"
            raise InputError("0 < contact_speed_m_s <= far_speed_m_s <= 0.05", speeds)
        if not 0 < self.slow_within_m <= self.standoff_m:
            raise InputError("0 < slow_within_m <= standoff_m", f"{self.slow_within_m}, {self.standoff_m}")

    def no_faster(self, contact_speed_m_s: float, travel_speed_m_s: float) -> "TouchPlan":
        """The touch with speed limits [m/s]: near the surface and in contact, and elsewhere."""
        return dataclasses.replace(
            self,
            contact_speed_m_s=min(self.contact_speed_m_s, contact_speed_m_s),
            far_speed_m_s=min(self.far_speed_m_s, travel_speed_m_s),
            travel_speed_m_s=min(self.travel_speed_m_s, travel_speed_m_s),
        )

    def slowed_for(self, alone: ForceAlone) -> "TouchPlan":
        """The same touch, no faster and no farther down than an arm may go that only its force sensor guards. It
        presses more only where even something rigid would not be at the hard stop then."""
        slower = self.no_faster(alone.speed_m_s(CONTACT_SHARE), self.travel_speed_m_s)
        return dataclasses.replace(
            slower,
            far_speed_m_s=min(self.far_speed_m_s, alone.speed_m_s(SURPRISE_SHARE)),
            miss_m=min(self.miss_m, alone.doubt_m + MISS_M),
            rigid_n_m=max(self.rigid_n_m, alone.stiffness_n_m),
            small_dent_m=min(
                self.small_dent_m,
                alone.hard_n / alone.stiffness_n_m * self.set_force_n / (self.more_force_n or self.set_force_n),
            ),
        )

    def places_m(self, center_offset_m: float) -> FloatArray:
        """(3, 3) where the tip's centre goes at most: crossing, above the point, and deepest [m, surface frame]."""
        touching_m = self.point_m + center_offset_m * self.normal
        above_m = touching_m + self.standoff_m * self.normal
        crossing_m = np.array([above_m[0], above_m[1], max(self.travel_height_m, above_m[2])])
        return np.array([crossing_m, above_m, touching_m - (self.miss_m + self.max_depth_m) * self.normal])


@dataclass(frozen=True, slots=True)
class PhaseSpan:
    """A phase with its begin and end on the robot's clock [s]."""

    phase: Phase
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class TouchRecord:
    """Record of a touch; times [s] on the robot's clock, places and forces in the surface frame.

    time_s (n,), position_m (n, 3), force_n (n, 3): from the approach to the end of the dwell, at the arm's rate.
    Positions are the tip's centre by the joints, forces act on the tip; loading: number of samples, from the first,
    until the set force (without the dwell and what follows); contact_m: (3,) place of the tip's centre at contact, None
    without contact; depth_m: below that at the end of the dwell
    center_m, final_force_n: (3,) mean over the last of the dwell; None where there was none
    peak_force_n: greatest measured magnitude; noise_n: (3,) deviation of a reading in free air at the tare
    phases: state of the touch at each time; ending, reason: why it ended; settled: dent and force were still
    arms, forces: the states and readings from which the record is computed, each reading with the time of the arm's
    newest state [ns]; poses: all states of the arm, also before the approach; back: states on the way back"""

    plan: TouchPlan
    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    loading: int
    contact_m: FloatArray | None
    depth_m: float
    center_m: FloatArray | None
    final_force_n: FloatArray | None
    peak_force_n: float
    tare_n: FloatArray
    noise_n: FloatArray
    phases: tuple[PhaseSpan, ...]
    ending: TouchEnding
    reason: str = ""
    fault: Fault = Fault.NONE
    settled: bool = False
    arms: tuple[ArmSample, ...] = ()
    forces: tuple[tuple[ForceSample, int], ...] = ()
    poses: tuple[ArmSample, ...] = ()
    back: tuple[ArmSample, ...] = ()


HELD_GAIN_PER_S = 3.0
"""Rate at which a distance shrinks, across the normal and towards the greatest depth: by a factor e in 1/3 s. A larger
one overshoots where an arm follows late (share times delay must stay far below 1, and is 0.03 for a control period). A
smaller one leaves the tip beyond the normal's line for longer."""
FREE_M_S_N = 0.004
"""Speed of yielding to a tangential force [m/s/N], if the plan has "free": 2.5 N give ACROSS_M_S. Larger swings
where an arm follows late; smaller leaves the force across for longer."""
ACROSS_M_S = 0.01
"""Greatest tangential speed in contact [m/s]: half of the 20 mm/s allowed near contact. With 10 mm/s along the normal
the tip stays within them (14 mm/s)."""
STILL_S = 0.3
"""Time over which force and place must hold [s], and over whose last their means are taken. Shorter, a dent that still
creeps counts as still; longer, every touch takes longer: its dwell is 0.5 s of 13.4 s (`docs/results/maps.md`)."""
STILL_FORCE, STILL_FORCE_N, STILL_M = 0.03, 0.03, 1.5e-4
"""Allowed variation of force and place over STILL_S: share of the set force, force [N], place [m]. 3 % of 3 N is nearly
twice the noise of a reading that the preflight lets pass (`preflight.NOISE_N`). Smaller, noise alone keeps a touch
until it may dwell no longer; larger, creep counts as still, and as depth."""
PAUSE_PERIODS = 3
"""Control periods at rest before the tip backs away from too large a force: an arm needs one to take a command and two
to stop (`force_alone.ARM_CYCLES`). More press for longer; fewer turn round an arm that still moves on."""
NEAR_M = 2e-4
"""Distance to the greatest depth at which it counts as reached: the speed falls towards it."""
PRESS_AT_MOST_S = 8.0
"""Time limit of a press without its force [s]: the greatest depth of 15 mm takes 1.5 s at 10 mm/s, the rest is for soft
foam, which is loaded slowly. A shorter one ends touches of soft foam; a longer one continues where the force is never
reached."""
AVERAGED_NS = 3_000_000
"""Forces within this time before and after an arm's state are averaged for it, so that they have no delay."""


class TouchStateMachine:
    """The states from approach to retreat; `step` once in a control period, then `phase` is DONE.

    Its input is the force along the normal and the depth. place: the tip's centre at the estimated point's contact."""

    def __init__(self, plan: TouchPlan, center_offset_m: float, start_s: float) -> None:
        self.plan = plan
        self.phase = Phase.APPROACH
        self.spans: list[PhaseSpan] = []
        self.ending = TouchEnding.NO_CONTACT
        self.settled = False
        self.contact_m: FloatArray | None = None
        self._touching_m = plan.point_m + center_offset_m * plan.normal
        self._since_s = start_s
        self._hits = 0
        self._control = ForceControl(plan.contact_speed_m_s, plan.rigid_n_m)
        self._recent: deque[tuple[float, float, float]] = deque()
        self._pause = 0

    @property
    def pressing(self) -> bool:
        """Whether it is between contact and the end of the dwell."""
        return self.phase in (Phase.PRESS, Phase.DWELL, Phase.PRESS_MORE, Phase.DWELL_MORE)

    def depth_m(self, center_m: FloatArray) -> float:
        """Depth of the tip's centre (3,) [m, surface frame] below the first contact, along the normal [m]; 0 before."""
        return 0.0 if self.contact_m is None else float((self.contact_m - center_m) @ self.plan.normal)

    def back_off(self, time_s: float) -> None:
        """Handle a force that is too high: rest for PAUSE_PERIODS, then retreat. time_s: now"""
        if self.phase not in (Phase.BACK_OFF, Phase.DONE):
            self.ending = TouchEnding.SOFT_STOP
            self._pause = PAUSE_PERIODS
            self._enter(Phase.BACK_OFF, time_s)

    def step(self, time_s: float, center_m: FloatArray, force_n: FloatArray, still_seen: bool = True) -> FloatArray:
        """The tip's velocity (3,) [m/s] for the next period. center_m: (3,) the tip's centre; force_n: (3,) force on
        the tip; still_seen: the observer of the dent sees no change"""
        plan = self.plan
        along_n = float(force_n @ plan.normal)
        match self.phase:
            case Phase.APPROACH:
                return self._approach(time_s, center_m, along_n) + self._across(center_m, np.zeros(3))
            case Phase.PRESS | Phase.PRESS_MORE:
                return self._press(time_s, center_m, along_n) + self._across(center_m, force_n)
            case Phase.DWELL | Phase.DWELL_MORE:
                return self._dwell(time_s, center_m, along_n, still_seen) + self._across(center_m, force_n)
            case Phase.BACK_OFF:
                self._pause -= 1
                return np.zeros(3) if self._pause >= 0 else self._away(time_s, center_m, plan.contact_speed_m_s)
            case Phase.RETREAT:
                slow = plan.slow_back and self.depth_m(center_m) > 0.0
                return self._away(time_s, center_m, plan.contact_speed_m_s if slow else plan.far_speed_m_s)
        return np.zeros(3)

    def end(self, time_s: float) -> None:
        """End the touch in any phase. time_s: now"""
        if self.phase is not Phase.DONE:
            self._enter(Phase.DONE, time_s)

    # Phases ----------------------------------------------------------------------------------------------------------

    def _approach(self, time_s: float, center_m: FloatArray, along_n: float) -> FloatArray:
        plan = self.plan
        above_m = float((center_m - self._touching_m) @ plan.normal)
        self._hits = self._hits + 1 if along_n > plan.contact_force_n else 0
        if self._hits == 1:
            self.contact_m = center_m.copy()
        if self._hits >= 2 or along_n > 3.0 * plan.contact_force_n:
            self._control.see(self.depth_m(center_m), along_n)
            self._enter(Phase.PRESS, time_s)
            return self._press(time_s, center_m, along_n)
        if self._hits:
            return np.zeros(3)
        self.contact_m = None
        if above_m < -plan.miss_m:
            self._enter(Phase.RETREAT, time_s)
            return np.zeros(3)
        speed = plan.contact_speed_m_s
        if above_m > plan.slow_within_m:
            # slowing down begins early enough to be slow where it has to be
            braking_per_s = plan.braking_per_s or GAIN_PER_S
            speed = min(plan.far_speed_m_s, speed + braking_per_s * (above_m - plan.slow_within_m))
        return -speed * plan.normal

    def _press(self, time_s: float, center_m: FloatArray, along_n: float) -> FloatArray:
        plan = self.plan
        set_n = self._set_n()
        depth_m = self.depth_m(center_m)
        self._control.see(depth_m, along_n)
        self._remember(time_s, depth_m, along_n)
        dwell = Phase.DWELL if self.phase is Phase.PRESS else Phase.DWELL_MORE
        if along_n >= set_n - max(STILL_FORCE * set_n, STILL_FORCE_N):
            self.ending = TouchEnding.SET_FORCE
            self._enter(dwell, time_s)
        elif depth_m >= plan.max_depth_m - NEAR_M:
            self.ending = TouchEnding.DEPTH
            self._enter(dwell, time_s)
        elif time_s - self._since_s > PRESS_AT_MOST_S:
            self.ending = TouchEnding.NOT_SETTLED
            self._enter(dwell, time_s)
        return self._down(set_n, along_n, depth_m)

    def _dwell(self, time_s: float, center_m: FloatArray, along_n: float, still_seen: bool) -> FloatArray:
        plan = self.plan
        set_n, depth_m = self._set_n(), self.depth_m(center_m)
        self._control.see(depth_m, along_n)
        self._remember(time_s, depth_m, along_n)
        still = still_seen and self._still(set_n)
        long_enough = time_s - self._since_s >= plan.dwell_s
        if (still and long_enough) or time_s - self._since_s >= plan.dwell_at_most_s:
            self.settled = still
            more = plan.more_force_n is not None and plan.more_force_n > set_n and self.ending is TouchEnding.SET_FORCE
            if more and self.phase is Phase.DWELL and depth_m < plan.small_dent_m:
                self._enter(Phase.PRESS_MORE, time_s)
            else:
                self._enter(Phase.RETREAT, time_s)
                return np.zeros(3)
        return self._down(self._set_n(), along_n, depth_m)

    def _down(self, set_n: float, along_n: float, depth_m: float) -> FloatArray:
        """(3,) velocity [m/s] of the force control along the normal, which falls to 0 at the greatest depth."""
        speed = self._control.velocity_m_s(set_n, along_n)
        left_m = self.plan.max_depth_m - depth_m
        speed = min(speed, max(left_m, 0.0) * HELD_GAIN_PER_S)
        return -speed * self.plan.normal

    def _away(self, time_s: float, center_m: FloatArray, speed_m_s: float) -> FloatArray:
        plan = self.plan
        left_m = plan.standoff_m - float((center_m - self._touching_m) @ plan.normal)
        if left_m < max(5e-4, plan.passing_m):
            self.end(time_s)
            return np.zeros(3)
        return min(speed_m_s, max((plan.braking_per_s or HELD_GAIN_PER_S) * left_m, 2e-3)) * plan.normal

    def _across(self, center_m: FloatArray, force_n: FloatArray) -> FloatArray:
        """(3,) velocity across the normal [m/s]: back to its line, or with the tangential force where that is free."""
        normal = self.plan.normal
        if self.plan.tangential == "free" and self.pressing:
            wanted = FREE_M_S_N * (force_n - (force_n @ normal) * normal)
        else:
            off = center_m - self._touching_m
            wanted = -HELD_GAIN_PER_S * (off - (off @ normal) * normal)
        size = float(np.linalg.norm(wanted))
        return wanted if size <= ACROSS_M_S else wanted * (ACROSS_M_S / size)

    def _set_n(self) -> float:
        more = self.phase in (Phase.PRESS_MORE, Phase.DWELL_MORE)
        return self.plan.more_force_n if more and self.plan.more_force_n is not None else self.plan.set_force_n

    def _remember(self, time_s: float, depth_m: float, along_n: float) -> None:
        self._recent.append((time_s, depth_m, along_n))
        while self._recent and time_s - self._recent[0][0] > STILL_S:
            self._recent.popleft()

    def _still(self, set_n: float) -> bool:
        """Whether depth and force were constant for STILL_S, at the set force unless at the greatest depth."""
        times, depths_m, forces_n = zip(*self._recent, strict=True)
        if times[-1] - times[0] < STILL_S - 2e-9 * PERIOD_NS:
            return False
        near_n = max(STILL_FORCE * set_n, STILL_FORCE_N, 3.0 * self.plan.noise_n)
        at_force = self.ending is not TouchEnding.SET_FORCE or all(abs(one - set_n) < near_n for one in forces_n)
        quiet = max(forces_n) - min(forces_n) < 2 * near_n
        return at_force and quiet and max(depths_m) - min(depths_m) < STILL_M

    def _enter(self, phase: Phase, time_s: float) -> None:
        self.spans.append(PhaseSpan(self.phase, self._since_s, time_s))
        self.phase, self._since_s = phase, time_s
        self._recent.clear()


def run_touch(
    robot: Robot,
    plan: TouchPlan,
    still_seen: Callable[[], bool] = lambda: True,
    on_phase: Callable[[Phase, int], None] = lambda phase, time_ns: None,
) -> TouchRecord:
    """Travel above the place, take the tare, touch, and come back above it.

    still_seen: whether the observer of the dent (a camera) sees no change; called during the dwell, when the camera
    must be alive too. on_phase: called with each phase when it begins, and the time [ns on the robot's clock]. Never
    raises for faults of the robot: `ending`, `fault` and `reason` report them, and the supervisor's verdict holds until
    a person acknowledges it. Raises RobotStopped if the robot is stopped already, and InputError if no preflight has
    passed."""
    return carried_out(TouchRun(robot, plan, on_phase), robot, still_seen)


def carried_out(run: "TouchRun", robot: Robot, still_seen: Callable[[], bool]) -> TouchRecord:
    """Travel, take the tare and touch; arguments, result and errors as in `run_touch`."""
    try:
        run.travel()
        run.tare()
        run.touch(still_seen)
    except RobotStopped as stopped:
        run.fail(TouchEnding.STOPPED, str(stopped.verdict.reason), stopped.verdict.fault)
    except MotionHeld as held:
        run.fail(TouchEnding.HELD, str(held), Fault.NONE)
    except NotThere as error:
        run.fail(TouchEnding.NOT_REACHED, str(error), Fault.NONE)
    except InputError as error:
        if robot.supervisor.verdict.action is Action.GO_ON:
            raise
        run.fail(TouchEnding.SOFT_STOP, str(error), robot.supervisor.verdict.fault)
    finally:
        robot.camera_needed = False
    return run.record()


class TouchProgress(Protocol):
    """Progress of a touch; attributes as in `TouchRecord`, spans: its phases."""

    contact_m: FloatArray | None
    settled: bool
    ending: TouchEnding
    spans: list[PhaseSpan]

    def end(self, time_s: float) -> None:
        """End the touch in any phase. time_s: now"""


class TouchRun:
    """A touch in progress, with the states and readings of its record."""

    def __init__(self, robot: Robot, plan: TouchPlan, on_phase: Callable[[Phase, int], None]) -> None:
        self._watch: PressWatch | None = None
        if robot.force_alone:
            alone = ForceAlone.of(robot)
            plan, self._watch = plan.slowed_for(alone), PressWatch(alone, plan.contact_force_n, plan.noise_n)
        self._robot, self._plan, self._on_phase = robot, plan, on_phase
        self._reported: Phase | None = None
        if robot.supervisor.verdict.action is not Action.GO_ON:
            raise RobotStopped(robot.supervisor.verdict)
        self._spans: list[PhaseSpan] = []
        self._arms: list[ArmSample] = []
        self._forces: list[tuple[ForceSample, int]] = []
        self._forces_n: list[FloatArray] = []
        self._poses: list[ArmSample] = []
        self._machine: TouchProgress | None = None
        self._loading_s = math.inf
        self._end_s = math.inf
        self._depth_m = 0.0
        self._noise_n: FloatArray = np.full(3, np.nan)
        self._ending, self._reason, self._fault = TouchEnding.NO_CONTACT, "", Fault.NONE

    def travel(self) -> None:
        self._robot.cycle()
        plan, began = self._plan, self._now_s()
        self._tell(Phase.TRAVEL)
        crossing_m, above_m, deepest_m = plan.places_m(self._robot.placement.center_offset_m)
        try:
            to_above(
                self._robot,
                above_m,
                plan.normal,
                height_m=float(crossing_m[2]),
                deepest_m=deepest_m,
                speed_m_s=plan.travel_speed_m_s,
                passing_m=plan.passing_m,
                braking_per_s=plan.braking_per_s,
            )
        finally:
            self._spans.append(PhaseSpan(Phase.TRAVEL, began, self._now_s()))

    def tare(self) -> None:
        began = self._now_s()
        self._tell(Phase.TARE)
        try:
            self._noise_n = take_tare(self._robot)
        finally:
            self._spans.append(PhaseSpan(Phase.TARE, began, self._now_s()))

    def touch(self, still_seen: Callable[[], bool]) -> None:
        robot = self._robot
        self._machine = machine = TouchStateMachine(self._plan, robot.placement.center_offset_m, self._now_s())
        velocity: FloatArray = np.zeros(3)
        self._tell(machine.phase)
        while machine.phase is not Phase.DONE:
            robot.camera_needed = machine.phase in (Phase.DWELL, Phase.DWELL_MORE)
            seen = robot.cycle(TipVelocity(velocity) if np.any(velocity) else None)
            force_n = self._see(seen)
            if robot.supervisor.verdict.action is Action.BACK_OFF:
                self._fault, self._reason = robot.supervisor.verdict.fault, robot.supervisor.verdict.reason
                machine.back_off(self._now_s())
            watched = still_seen() if robot.camera_needed else True
            before = machine.phase
            velocity = machine.step(self._now_s(), robot.center_m, force_n, watched)
            if before in (Phase.PRESS, Phase.PRESS_MORE) and machine.phase is not before:
                self._loading_s = self._now_s()
            if machine.pressing:
                self._depth_m = machine.depth_m(self._robot.center_m)
            elif self._end_s == math.inf and before is not Phase.APPROACH:
                self._end_s = self._now_s()
            self._tell(machine.phase)
            # where the force cannot be right, if nothing else guards the arm
            if self._watch is not None and (machine.pressing or machine.phase is Phase.APPROACH):
                down_m = -float(self._robot.center_m @ machine.plan.normal)
                if why := self._watch.look(down_m, float(force_n @ machine.plan.normal), in_contact=machine.pressing):
                    self._robot.stop_for(Fault.FORCE_ASTRAY, why)
        robot.camera_needed = False
        robot.cycle()
        self._ending = machine.ending

    def _tell(self, phase: Phase) -> None:
        """Call `on_phase` when a phase begins; not for DONE."""
        if phase not in (self._reported, Phase.DONE):
            self._reported = phase
            self._on_phase(phase, self._robot.seen.now_ns)

    def _see(self, seen: RobotObservation) -> FloatArray:
        """Keep a period's states and readings; (3,) its mean force on the tip [N, surface frame], or the last one."""
        robot = self._robot
        self._arms += seen.arms
        good = [sample for sample in seen.forces if sample.usable]
        forces_n = [robot.force_on_tip_n(sample) for sample in good]
        self._forces += [(sample, robot.pose.time_ns) for sample in good]
        self._poses.append(robot.pose)
        self._forces_n += forces_n
        if forces_n:
            return np.asarray(np.mean(forces_n, axis=0))
        return self._forces_n[-1] if self._forces_n else np.zeros(3)

    def fail(self, ending: TouchEnding, reason: str, fault: Fault) -> None:
        verdict = self._robot.supervisor.verdict
        if verdict.action is not Action.GO_ON:
            ending = TouchEnding.STOPPED if verdict.action is Action.STOP else TouchEnding.SOFT_STOP
            reason, fault = verdict.reason, verdict.fault
        self._ending, self._reason, self._fault = ending, reason, fault
        if self._machine is not None:
            self._machine.end(self._now_s())

    def record(self) -> TouchRecord:
        machine = self._machine
        times_s, centers_m = centers_of(self._arms, self._robot.placement)
        stamps = np.array([sample.time_ns for sample, _ in self._forces], dtype=np.int64)
        measured_n = np.concatenate([np.zeros(0), *self._forces_n]).reshape(-1, 3)
        forces_n = forces_at([sample.time_ns for sample in self._arms], stamps, measured_n)
        within = times_s <= self._end_s
        pressed = math.isfinite(self._loading_s) and math.isfinite(self._end_s)
        dwelt = within & (times_s > self._end_s - STILL_S) & pressed
        return TouchRecord(
            plan=self._plan,
            time_s=times_s[within],
            position_m=centers_m[within],
            force_n=forces_n[within],
            loading=int(np.count_nonzero(times_s[within] <= self._loading_s)),
            contact_m=machine.contact_m if machine is not None else None,
            depth_m=self._depth_m,
            center_m=centers_m[dwelt].mean(axis=0) if dwelt.any() else None,
            final_force_n=forces_n[dwelt].mean(axis=0) if dwelt.any() else None,
            peak_force_n=float(np.linalg.norm(measured_n, axis=1).max(initial=0.0)),
            tare_n=self._robot.tare_n.copy(),
            noise_n=self._noise_n,
            phases=(*self._spans, *(machine.spans if machine is not None else ())),
            ending=self._ending,
            reason=self._reason,
            fault=self._fault,
            settled=machine.settled if machine is not None else False,
            arms=tuple(sample for sample, among in zip(self._arms, within, strict=True) if among),
            forces=tuple(self._forces),
            poses=tuple(self._poses),
            back=tuple(sample for sample, among in zip(self._arms, within, strict=True) if not among),
        )

    def _now_s(self) -> float:
        return self._robot.seen.now_ns / 1e9


def centers_of(arms: Sequence[ArmSample], placement: Placement) -> tuple[FloatArray, FloatArray]:
    """Times (n,) [s] of an arm's states, and the tip's centre (n, 3) from the joints [m, surface frame]."""
    poses = np.array([sample.T_base_ee for sample in arms]).reshape(-1, 4, 4)
    return np.array([sample.time_ns for sample in arms], dtype=float) / 1e9, placement.T_surface_center(poses)[:, :3, 3]


def forces_at(states_ns: Sequence[int], stamps: IntArray, forces_n: npt.ArrayLike) -> FloatArray:
    """(n, 3) force at each of the arm's states: mean of the readings around it, between readings where none is.

    stamps (m,), forces_n (m, 3): of the readings, in order of time"""
    states = np.array(states_ns, dtype=np.int64)
    if not len(stamps):
        return np.zeros((len(states), 3))
    measured_n = np.asarray(forces_n)
    sums = np.vstack([np.zeros(3), np.cumsum(measured_n, axis=0)])
    first, last = np.searchsorted(stamps, [states - AVERAGED_NS, states + AVERAGED_NS + 1])
    count = (last - first)[:, None]
    between = np.column_stack([np.interp(states, stamps, measured_n[:, axis]) for axis in range(3)])
    return np.where(count > 0, (sums[last] - sums[first]) / np.maximum(count, 1), between)


TARE_PERIODS = 30
"""Duration of a tare in control periods: 0.3 s, 300 readings at 1 kHz, whose mean has 1/17 of a reading's noise at
best. The tare is part of every touch (0.35 s of 13.4 s, `docs/results/maps.md`); a shorter one would be noisier."""
TARE_STILL_N = 0.05
"""Variation in free air above which there is no tare [N], as `preflight.NOISE_N`. A larger one would zero a changing
load, a smaller one refuses a sensor that has passed the preflight."""
TARE_DRIFT_N = 0.6
"""Change since the last tare that counts as drift [N], as `preflight.ZERO_N`: a larger one would zero a tip in contact,
a smaller one stops while a sensor warms up."""


def take_tare(robot: Robot) -> FloatArray:
    """Set the zero to the load in free air, by 0.3 s of readings at rest; the deviation (3,) of a reading [N].

    Raises NotThere if the readings vary, or differ from the last tare by more than drift, as if the tip touched."""
    taken: list[ForceSample] = []
    for period in range(TARE_PERIODS + 5):
        seen = robot.cycle()
        if period >= 5:  # what still moved has passed the sensor's filter
            taken += [sample for sample in seen.forces if sample.usable]
    forces_n = np.array([sample.force_n for sample in taken]).reshape(-1, 3)
    if len(forces_n) < 20:
        raise NotThere("20 usable forces in 0.3 s", f"{len(forces_n)}", "check the force sensor")
    halves = np.array_split(forces_n, 2)
    varies_n = float(np.max(np.abs(halves[0].mean(axis=0) - halves[1].mean(axis=0))))
    noise_n = forces_n.std(axis=0)
    tool = robot.placement.tool
    still_n, drift_n = max(TARE_STILL_N, 2.5 * tool.force_noise_n), max(TARE_DRIFT_N, 1.5 * tool.contact_n)
    if varies_n > still_n or float(np.max(noise_n)) > still_n:
        came = f"a load that varies by {max(varies_n, float(np.max(noise_n))):.2f} N"
        raise NotThere(f"a load within {still_n:.2g} N in free air", came, "keep the tip free of contact")
    mean_n = forces_n.mean(axis=0)
    if float(np.linalg.norm(mean_n)) > drift_n:
        came = f"{np.linalg.norm(mean_n):.2f} N from the last tare"
        raise NotThere(f"less than {drift_n:.2g} N: a sensor's drift", came, "lift the tip: it seems to touch")
    robot.tare_n = robot.tare_n + mean_n
    return np.asarray(noise_n)
