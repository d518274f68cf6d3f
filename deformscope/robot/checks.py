"""A table of checks, each with its requirement and its finding, and the remedy of failed ones."""

from dataclasses import dataclass

HINTS = {
    "arm: fresh": "the arm's cable and supply; state_hz in the rig file",
    "arm: rate": "the arm's cable, and the load of this computer; or a lower state_hz in the rig file",
    "arm: homed": "after power-on, deformscope arm home RIG; or hold its joystick's home button until it rests",
    "arm: link": "the arm's cable into a port of the computer itself: no hub, no virtual machine; less load on it",
    "arm: still": "wait until the arm rests, and let go of its joystick",
    "arm: FIFO": "end the other program that commands the arm",
    "arm: accepts": "the reason, then start again",
    "arm: control period": "end other programs that load this computer",
    "arm: first way": "bring the tip over the surface by the joystick, the stick down",
    "arm: over the table": "bring elbow and wrist up by the joystick; or T_arm_surface in the rig file is wrong",
    "hand": "a longer stick, cables tied higher up; or [shape] and [tool] in the rig file are wrong",
    "arm: box": "bring elbow and wrist in by the joystick; or arm_low_m and arm_high_m of [workspace]",
    "arm: clear of itself": "unfold the arm by the joystick",
    "arm: joint torques": "do not touch the arm; or a higher collision_nm in [workspace]",
    "arm: joints": "turn the joint away from the end of its range by the joystick",
    "arm: reach": "move arm or surface, turn the tool, or bring the arm over the surface by its joystick",
    "force sensor: finger": (
        "press again as requested; then `sensitivity` and R_tip_force in the rig file (deformscope calibrate "
        "force RIG), the force sensor's plug and cable"
    ),
    "tip: force at contact": (
        "rate_hz = 1000 and filter_hz = 150 of the force sensor, a faster cycle of the arm, or a more compliant "
        "stick, with its compliance_m_per_n by deformscope calibrate arm RIG"
    ),
    "calibration: [tool] R_tip_force": "deformscope calibrate force RIG",
    "force sensor: tare": "keep the tip free of contact, and start again",
    "force sensor: noise": "stop vibrations of table or tip; filter_hz in the rig file; no noise means no sensor",
    "force sensor: alive": "rate_hz = 1000 and filter_hz = 150 in the rig file; else the sensor's plug",
    "force sensor": "the force sensor's plug and cable; rate_hz in the rig file; deformscope doctor RIG",
    "fingers: tare": "keep the fingers free of contact, and start again",
    "fingers": "the tactile controller's supply and cable; deformscope doctor RIG",
    "place: start": "start again: the path was planned from an earlier pose of the arm",
    "arm: collisions": "an arm that reports joint torques or motor currents; collision_nm above 0 in [workspace]",
    "camera: alive": "reconnect the camera, and close other programs that use it",
    "camera": "the camera's cable and port (USB 3), other programs that use it; fps in the rig file",
    "calibration": "measure it and write it into the rig file; docs/howto/write-a-rig-file.md",
    "age": "deformscope calibrate, with the name of the row, measures it again",
    "tip: in free air": "lift the tip by the joystick; or T_arm_surface in the rig file is wrong",
    "plan: force": "a smaller target_force_n, or a higher soft_stop_n, in the rig file",
    "workspace: box": "low_m and high_m of [workspace] in the rig file",
    "workspace: plan": "low_m and high_m of [workspace]: from 3.5 cm below the surface to 20 cm above the table",
}
"""Remedy of a failed check, by the begin of its name; the first that fits."""


@dataclass(frozen=True, slots=True)
class Check:
    """A condition for moving. name: the checked item; wanted, came: expectation and finding as text"""

    name: str
    passed: bool
    wanted: str
    came: str

    @property
    def hint(self) -> str:
        """The check's remedy; empty if it has passed."""
        return "" if self.passed else next((hint for name, hint in HINTS.items() if self.name.startswith(name)), "")


@dataclass(frozen=True, slots=True)
class Preflight:
    """The table of checks, in the order in which they were made."""

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether there are checks, and all have passed."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    def table(self) -> str:
        """The checks as lines of text, one each; below them the remedies of failed ones."""
        rows = [("", "check", "wanted", "came")]
        rows += [("ok" if one.passed else "NO", one.name, one.wanted, one.came) for one in self.checks]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        hints = dict.fromkeys(f"{one.name}: {one.hint}" for one in self.checks if one.hint)
        return "\n".join([*lines, *hints])
