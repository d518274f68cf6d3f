"""Whatever stops the robot, a person is told what to see to."""

from __future__ import annotations

import pytest

from deformscope.robot.advice import ADVICE, advice
from deformscope.robot.supervisor import Fault
from deformscope.robot.touch import TouchEnding

FAULTS = [fault for fault in Fault if fault is not Fault.NONE]


@pytest.mark.parametrize("cause", [*FAULTS, TouchEnding.NO_CONTACT, TouchEnding.NOT_REACHED])
def test_every_cause_has_its_advice(cause: Fault | TouchEnding) -> None:
    assert cause in ADVICE
    assert bool(advice(cause)) is (cause is not Fault.ASKED)
