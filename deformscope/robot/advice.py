"""Advice for a person after a stop of the robot, before it is started again."""

from deformscope.robot.fingertip_force import FingertipForce
from deformscope.robot.robot import Robot
from deformscope.robot.supervisor import Fault
from deformscope.robot.touch import TouchEnding

SETTLE_S = 0.1
"""Time after a halt until the remaining force is read."""

_SENSOR = "the force sensor's cable and supply: deformscope doctor RIG reads it"
_ARM = "the arm's cable, supply and joystick's red light; move it away by the joystick"
_BUSY = "and the load of this computer: its reader may be late"
_HOME = "whether the arm was homed after power-on: deformscope arm home RIG"
_CAMERA = "the camera's cable, and whether another program uses it"
_STANDS = "the poses of arm and surface relative to each other, and the arm's first pose"
_PLACE = "workspace, rig file and objects on the table"

ADVICE: dict[Fault | TouchEnding, str] = {
    Fault.FORCE_SOFT: "what pushed the tip; the tip has backed away",
    Fault.FORCE_HARD: "what pushed the tip, and the tip itself, before the arm moves again",
    Fault.FORCE_SILENT: f"{_SENSOR}; {_BUSY}",
    Fault.FORCE_FROZEN: _SENSOR,
    Fault.FORCE_INVALID: _SENSOR,
    Fault.FORCE_UNUSABLE: _SENSOR,
    Fault.FORCE_ASTRAY: f"{_SENSOR}; or the sample, if it broke, slid or tipped over under the tip",
    Fault.CHECKSUMS: "the force sensor's cable, its plug, and sources of interference",
    Fault.ARM_SILENT: f"{_ARM}; {_BUSY}",
    Fault.ARM_FROZEN: f"{_HOME}; then {_ARM}",
    Fault.ARM_INVALID: _ARM,
    Fault.ARM_FIFO: "other programs that command the arm, and the load of this computer",
    Fault.ARM_SPEED: "the reason for the arm's motion: a push, or another program",
    Fault.ARM_TURN: "the reason for the arm's rotation: a push, or another program",
    Fault.TILT: (
        "the reason for the tool's rotation: a push, a loose mount, another program, or an arm of another model"
    ),
    Fault.JOINT_LIMIT: f"{_STANDS}: a joint is near the end of its range; move it away by the joystick",
    Fault.SINGULAR: f"{_STANDS}: stretched out or folded it cannot follow a straight way; bend it by the joystick",
    Fault.TABLE: f"{_STANDS}: elbow or wrist come down to the table; bring the arm up by the joystick",
    Fault.ITSELF: f"{_STANDS}: it is folded onto itself; unfold it by the joystick",
    Fault.ARM_BOX: f"{_STANDS}: elbow, wrist or stick leave the box of arm_low_m and arm_high_m",
    Fault.COLLISION: "the obstacle that the arm hit, and its cables; without an obstacle, collision_nm in the rig file",
    Fault.TORQUES: (
        "the arm's torque sensors; with collision_nm = 0 in the rig file it moves without detecting collisions"
    ),
    Fault.WORKSPACE: _PLACE,
    Fault.CAMERA_SILENT: f"{_CAMERA}; {_BUSY}",
    Fault.CAMERA_FROZEN: _CAMERA,
    Fault.LINK: "the cable and supply of the lost device",
    Fault.REFUSED: "the reason, and the load of this computer: a late command stops the arm",
    Fault.ASKED: "",
    TouchEnding.NO_CONTACT: "the surface's height: the camera's pose in the rig file, and the sample's place",
    TouchEnding.NOT_REACHED: _PLACE,
}
"""Advice, by the supervisor's fault or the touch's ending."""

_PADS = "the tactile controller's supply and cable: deformscope doctor RIG reads it"
OF_HAND: dict[Fault | TouchEnding, str] = {
    Fault.FORCE_SOFT: "what pushed the fingers; the hand has backed away",
    Fault.FORCE_HARD: "what pushed the fingers, and the hand itself, before the arm moves again",
    Fault.FORCE_SILENT: f"{_PADS}; {_BUSY}",
    Fault.FORCE_FROZEN: _PADS,
    Fault.FORCE_INVALID: _PADS,
    Fault.FORCE_UNUSABLE: _PADS,
    Fault.CHECKSUMS: f"{_PADS}, and sources of interference",
    Fault.TILT: (
        "the reason for the hand's rotation: a push, a loose mount, another program, or an arm of another model"
    ),
    Fault.ARM_BOX: f"{_STANDS}: elbow, wrist or hand leave the box of arm_low_m and arm_high_m",
}
"""Advice that differs if the arm carries a hand."""


PRESSES_N = 0.6
"""From this force on the tip counts as pressing [N]: less may be a sensor's drift, as `touch.TARE_DRIFT_N`."""
_LIFT = "lift it along its approach, by the arm's joystick or smartPAD, or by hand if you hold the stick"


def where_it_stands(cause: Fault | TouchEnding, robot: Robot) -> str:
    """Advice (as `advice`) after the robot was halted; a tip that still presses, or an unknown force, comes first."""
    robot.stand_by(SETTLE_S)
    pressed_n, hand = robot.pressed_n, isinstance(robot.force, FingertipForce)
    words, tip = advice(cause, hand=hand), "the hand" if hand else "the tip"
    if pressed_n is None:
        press = f"{tip}, which may press with an unknown force: {_LIFT}"
    elif pressed_n > PRESSES_N:
        press = f"{tip}, which still presses with {pressed_n:.1f} N: {_LIFT}"
    else:
        return words
    return f"{press}; {words}" if words else press


def advice(cause: Fault | TouchEnding, *, hand: bool = False) -> str:
    """Advice for a person, by the supervisor's fault or the touch's ending, or empty. hand: the arm carries one"""
    return (ADVICE | OF_HAND if hand else ADVICE).get(cause, "the robot and its surroundings")
