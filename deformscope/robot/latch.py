"""Common part of the supervisors of arm and hand: alarms become one verdict, until a person acknowledges it.

The supervisors are pure state machines: each control period calls them with readings and times. They are no safety
function (no Python program is): the arm's emergency stop and a switch for the hand stay within reach."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

FaultT = TypeVar("FaultT", bound=StrEnum)


class Action(StrEnum):
    """Demand on the robot."""

    GO_ON = "go on"
    BACK_OFF = "back off"
    STOP = "stop"


_SEVERITY = {Action.GO_ON: 0, Action.BACK_OFF: 1, Action.STOP: 2}
"""The alarm with the highest severity counts, the first of equal ones."""

Alarm = tuple[Action, FaultT, str]
"""A rule's demand, the fault, and the reason with its numbers and units."""


@dataclass(frozen=True)
class Decision(Generic[FaultT]):
    """Demand, and its reason. fault: the enumeration's NONE without a fault; time_ns: when it was found"""

    action: Action
    fault: FaultT
    reason: str = ""
    time_ns: int = 0


class LatchingSupervisor(Generic[FaultT]):
    """Holds the most severe alarm of its rules; a subclass has the rules, and a `judge`."""

    def __init__(self, none: FaultT, late_ns: int) -> None:
        """none: the fault of a robot without one

        late_ns: a judgement this long after the last one was late: the host was busy, and perhaps the device threads
        too. No silence is held against a device then, once and not twice in a row."""
        self._go_on: Decision[FaultT] = Decision(Action.GO_ON, none)
        self._verdict, self._late_ns = self._go_on, late_ns

    @property
    def verdict(self) -> Decision[FaultT]:
        """The last verdict, or the one that is latched."""
        return self._verdict

    def start(self, now_ns: int) -> None:
        """Count ages from now on, as after a pause without judgements; a latched verdict stays."""
        self._judged_ns, self._excused = now_ns, False

    def acknowledge(self, now_ns: int) -> None:
        """Judge again from now on, after a person has removed the reason."""
        self._verdict = self._go_on
        self.start(now_ns)

    def stop(self, fault: FaultT, reason: str, now_ns: int) -> Decision[FaultT]:
        """Stop for a reason outside the readings: a person's request, or a refused command, as the next fails too."""
        return self._latch([(Action.STOP, fault, reason)], now_ns)

    def _begin(self, now_ns: int) -> None:
        """To be called before the rules look: whether this judgement came late."""
        self._excused = now_ns - self._judged_ns > self._late_ns and not self._excused
        self._judged_ns = now_ns

    def _silent_s(self, newest_ns: int, limit_s: float) -> float:
        """Age of a device's newest reading [s] where it is above a limit; else 0, as at a judgement that came late."""
        age_s = (self._judged_ns - newest_ns) / 1e9
        return age_s if age_s > limit_s and not self._excused else 0.0

    def _latch(self, alarms: Iterable[Alarm[FaultT]], now_ns: int) -> Decision[FaultT]:
        for action, fault, reason in alarms:
            if _SEVERITY[action] > _SEVERITY[self._verdict.action]:
                self._verdict = Decision(action, fault, reason, now_ns)
        return self._verdict
