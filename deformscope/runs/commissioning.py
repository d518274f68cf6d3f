"""The steps that a rig needs before it explores, in order, and the next one (`deformscope doctor RIG`)."""

import datetime
from dataclasses import dataclass
from typing import Literal

from deformscope.rig.rig_file import Rig

RigStepState = Literal["done", "by hand", "old", "to do", "optional"]


@dataclass(frozen=True, slots=True)
class RigStep:
    """what: the step in a word; state: `by hand` = the value exists without a date, `optional` = not needed to explore;
    words: its state; command: command of the step; minutes: estimated time at an arm, from a person's tasks, or with
    doubles; 0 = depends on its findings"""

    what: str
    state: RigStepState
    words: str
    command: str
    minutes: int = 0


def begin(name: str) -> RigStep:
    """The first step, for a file without devices. name: name of the rig file"""
    return RigStep("devices", "to do", "no device in the file", f"deformscope rig new {name}")


def commissioning_steps(rig: Rig, name: str, today: datetime.date | None = None) -> tuple[RigStep, ...]:
    """The steps of a rig that explores, in order; none for one that has no arm, no force sensor or no depth camera, or
    no box where no step measures it. name: name of its file, for the commands"""
    kinds, simulated = {entry.driver.kind for entry in rig.devices}, bool(rig.surface.scene)
    known = simulated and rig.surface.hidden is None
    if not {"arm", "wrench", "depth"} <= kinds or (known and rig.workspace.low_m is None):
        return ()
    if known:
        return (RigStep("explore", "to do", "doubles are at the poses of the file", f"deformscope explore {name}"),)
    there = {
        "tip": rig.tool.T_ee_tip is not None,
        "place": rig.surface.T_arm_surface is not None and rig.workspace.low_m is not None,
        "camera": rig.camera.T_arm_camera is not None,
        "force": rig.tool.R_tip_force is not None,
        "arm": rig.tool.compliance_m_per_n is not None,
        "time": False,
    }
    ages = rig.calibrated.ages(today)
    steps = []
    for what, done in there.items():
        if what == "arm" and simulated:
            continue
        command = f"deformscope calibrate {what} {name}"
        age = ages.get(what)
        state: RigStepState
        if age is not None and (done or what == "time"):
            state, words = "done" if age.young else "old", f"{age.days} of {age.at_most} days old"
        elif done:
            state, words = "by hand", "in the file, without a date"
        else:
            state, words = "optional" if what == "time" else "to do", WHY[what]
        minutes = MINUTES[what] if not simulated else 2 if what == "camera" else 1
        steps.append(RigStep(what, state, words, command, minutes))
    return (*steps, RigStep("explore", "to do", "map the stiffness of the surface", f"deformscope explore {name}"))


def next_step(steps: tuple[RigStep, ...]) -> RigStep | None:
    """The first step that has to be done or repeated."""
    return next((one for one in steps if one.state in ("to do", "old")), None)


WHY = {
    "tip": "position of the tip on the arm's end: its ball in a cone, tilted 8 times by the joystick",
    "place": "pose of the surface: the tip on 3 of its corners, twice each",
    "camera": "pose of the camera: a board on the arm's end (--print-board draws it) in 14 poses",
    "force": "orientation of the force sensor: a finger pushes the tip 10 times",
    "arm": "compliance of arm and stick: a block of steel or stone on the surface",
    "time": "delay of the arm relative to the force sensor: 5 taps on the tip",
}
"""Measured quantities, with their purpose or their tools."""
MINUTES = {"tip": 8, "place": 6, "camera": 15, "force": 5, "arm": 5, "time": 1}
"""Duration of each step: half a minute for a push, a minute for a pose that a person steers to. Estimated: never
measured on a real arm."""
