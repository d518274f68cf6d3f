"""What there is to do with a rig before it explores, in order, and what comes next (`deformscope doctor RIG`)."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Literal

from deformscope.rig.rig_file import Rig

FirstDayState = Literal["done", "by hand", "old", "to do"]


@dataclass(frozen=True, slots=True)
class FirstDayStep:
    """what: in a word; state: `by hand` = the value is there without a date; words: what is known; command: does it"""

    what: str
    state: FirstDayState
    words: str
    command: str


def begin(name: str) -> FirstDayStep:
    """The first step of all, for a file without devices. name: of the rig file"""
    return FirstDayStep("devices", "to do", "no device in the file", f"deformscope doctor --example > {name}")


def first_day(rig: Rig, name: str, today: datetime.date | None = None) -> tuple[FirstDayStep, ...]:
    """The steps of a rig that explores, in order; none for one that has no arm, no force sensor or no depth camera.

    name: of its file, for the commands
    """
    kinds = {entry.driver.kind for entry in rig.devices}
    if not {"arm", "wrench", "depth"} <= kinds:
        return ()
    simulated = bool(rig.surface.scene)
    if simulated and rig.surface.hidden is None:
        return (
            FirstDayStep("explore", "to do", "doubles that are where the file says", f"deformscope explore {name}"),
        )
    there = {
        "tip": rig.tool.T_ee_tip is not None,
        "place": rig.surface.T_arm_surface is not None and rig.workspace.low_m is not None,
        "camera": rig.camera.T_arm_camera is not None,
        "force": rig.tool.R_tip_force is not None,
        "arm": rig.tool.compliance_m_per_n is not None,
    }
    ages = rig.calibrated.ages(today)
    steps = []
    for what, done in there.items():
        if what == "arm" and simulated:
            continue
        command = f"deformscope calibrate {what} {name}"
        age = ages.get(what)
        if not done:
            steps.append(FirstDayStep(what, "to do", WHY[what], command))
        elif age is None:
            steps.append(FirstDayStep(what, "by hand", "in the file, without a date", command))
        else:
            state: FirstDayState = "done" if age.young else "old"
            steps.append(FirstDayStep(what, state, f"{age.days} of {age.at_most} days old", command))
    steps.append(FirstDayStep("explore", "to do", "map how soft it is, and where", f"deformscope explore {name}"))
    return tuple(steps)


def next_step(steps: tuple[FirstDayStep, ...]) -> FirstDayStep | None:
    """The first that is still to do, or to do again."""
    return next((one for one in steps if one.state in ("to do", "old")), None)


WHY = {
    "tip": "where the tip is on the arm's end: a cone that holds its ball, and the joystick",
    "place": "where the surface is: the tip on three of its corners",
    "camera": "where the camera stands: a board on the arm's end (--print-board draws it)",
    "force": "how the force sensor sits: a finger that pushes the tip",
    "arm": "how arm and stick yield: a block of steel or stone on the surface",
}
"""What is measured, and what for or with."""
