"""Whatever stops the robot, a person is told what to see to."""

import numpy as np
import pytest

from deformscope.robot.advice import ADVICE, advice, where_it_stands
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import RobotStopped
from deformscope.robot.supervisor import Fault, SafetyDecision
from deformscope.robot.touch import TouchEnding, run_touch
from tests.cases import slow
from tests.robot.quick_touch import quick_scene

FAULTS = [fault for fault in Fault if fault is not Fault.NONE]


@pytest.mark.parametrize("cause", [*FAULTS, TouchEnding.NO_CONTACT, TouchEnding.NOT_REACHED])
def test_every_cause_has_its_advice(cause: Fault | TouchEnding) -> None:
    assert cause in ADVICE
    assert bool(advice(cause)) is (cause is not Fault.ASKED)


@pytest.mark.parametrize("fault", [slow(Fault.ASKED), Fault.FORCE_HARD, slow(Fault.FORCE_SILENT)])
def test_who_is_told_of_a_stop_in_contact_is_told_how_hard_the_tip_presses(fault: Fault) -> None:
    scene = quick_scene(3)
    robot = scene.robot

    def watch(seen: RobotObservation, verdict: SafetyDecision) -> None:
        if scene.lab.contact.force_n[2] > 2.0:
            robot.supervisor.stop(fault, "as asked for", seen.now_ns)

    robot.watch = watch
    assert run_touch(robot, scene.plan).ending is TouchEnding.STOPPED
    words, pressed_n = where_it_stands(fault, robot), float(np.linalg.norm(scene.lab.contact.force_n))
    assert pressed_n > 1.5
    assert "lift it along its approach" in words
    assert words.endswith(advice(fault))
    if fault is Fault.FORCE_SILENT:
        assert "may press with an unknown force" in words
        return
    assert float(words.split("presses with ")[1].split(" N")[0]) == pytest.approx(pressed_n, abs=0.15)


def test_a_stop_in_free_air_says_nothing_of_a_press() -> None:
    robot = quick_scene(3).robot
    robot.cycle()
    robot.ask_to_stop("as asked for")
    with pytest.raises(RobotStopped):
        robot.cycle()
    assert where_it_stands(Fault.ASKED, robot) == ""
    assert where_it_stands(Fault.WORKSPACE, robot) == advice(Fault.WORKSPACE)
