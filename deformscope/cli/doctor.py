"""`deformscope doctor`: checks whether a rig would work, and names remedies."""

import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from deformscope.cli.common import say, show, write_json
from deformscope.config import DoctorConfig
from deformscope.errors import InputError
from deformscope.lab.rig_members import member_of
from deformscope.rig.rig_file import Rig, RigDevice, load_rig
from deformscope.runs.commissioning import RigStep, begin, commissioning_steps, next_step
from deformscope.runs.opened_devices import setup_of_rig
from deformscope_drivers.arm import Arm
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.health import Health
from deformscope_drivers.pacing import SENDING, may_be_prompt

FREE_BYTES_WANTED = 5 << 30
FIRST_READING_S = 10.0
"""Longest time until a first reading: a camera, or a double on a busy machine, may take seconds to begin."""
TRY = "deformscope devices lists connected devices; double = true runs a simulated one instead"
NOT_HOMED = "not homed since power-on, so it refuses to move | try: deformscope arm home RIG"
CheckStatus = Literal["ok", "look", "FAIL"]


@dataclass(frozen=True, slots=True)
class Finding:
    """A check. what: its name; verdict: `look` = works, but read the remark; told: the finding as text"""

    what: str
    verdict: CheckStatus
    told: str


class Unfit(InputError):
    """The rig would not work with these faults."""


def run(config: DoctorConfig) -> None:
    """Check everything, report all of it, and raise Unfit where something fails."""
    path = Path(config.rig).expanduser()
    if path.is_file() and not path.read_text(encoding="utf-8", errors="replace").strip():
        step = begin(config.rig)
        say(f"{config.rig} is empty. With hardware: {step.command}; without: {step.command} --doubles")
        write_json({"rig": config.rig, "findings": [], "first_day": [step], "next": step.command}, config.json)
        return
    rig = load_rig(config.rig, trusted=config.trust_rig)
    steps = commissioning_steps(rig, config.rig)
    findings = [Finding("rig file", "ok", f"{len(rig.devices)} devices")]
    findings += [] if steps else _sections(rig)  # the list of steps says what is lacking, and which command adds it
    following = next_step(steps)
    measured = following is None or following.what == "explore"
    findings += _found("explore", lambda: _exploring(rig, measured))
    findings += _found("place", lambda: _placing(rig))
    findings += _found("shape", lambda: _shape(rig))
    findings += _found("certificate", lambda: _certificate(rig))
    findings += _found("disk", lambda: _disk(rig))
    findings += _found("real time", lambda: _real_time(rig))
    for entry in rig.devices:
        say(f"listening to {entry.name}")
        name = f"{entry.name} ({entry.driver.name}{', double' if entry.double else ''})"
        findings += _found(name, partial(_device, entry, name, config.seconds))
    width = max(len(finding.what) for finding in findings)
    show("\n".join(f"{f.verdict:<5} {f.what:<{width}}  {f.told}" for f in findings))
    failed = [finding.what for finding in findings if finding.verdict == "FAIL"]
    command = following.command if following is not None else None
    if failed:  # no step can be done with what does not work
        command = f"deformscope doctor {config.rig}"
    if steps:
        after = f"repair {failed[0]} (its line above says how), then " if failed else ""
        show(_list_of(steps, after + (command or "")))
    write_json({"rig": config.rig, "findings": findings, "first_day": steps, "next": command}, config.json)
    if failed:
        hint = f"repair {failed[0]} first: its line says how"
        raise Unfit("a rig that works", f"trouble with {', '.join(failed)}", hint, config.rig)


def _list_of(steps: tuple[RigStep, ...], following: str) -> str:
    """The way to an exploration, step by step, with the next step."""
    width = max(len(step.what) for step in steps)
    lines = [""]
    for step in steps:
        minutes = f" (about {step.minutes} min)" if step.minutes and step.state != "done" else ""
        lines.append(f"{step.state:<8} {step.what:<{width}}  {step.words}{minutes}")
    return "\n".join([*lines, *([f"next: {following}"] if following else [])])


def _found(what: str, look: Callable[[], list[Finding]]) -> list[Finding]:
    """Findings of a check; an error in it is a finding too, and hides none of the others."""
    try:
        return look()
    except (InputError, DeviceError, OSError) as error:
        words = " ".join(str(error).split())
    except Exception as error:
        words = f"unexpected {type(error).__name__}: {' '.join(str(error).split())}"
    return [Finding(what, "FAIL", words if "| try: " in words else f"{words} | try: {TRY}")]


def _sections(rig: Rig) -> list[Finding]:
    """Keys that a robot needs for motion, and the file lacks."""
    kinds = {entry.driver.kind for entry in rig.devices}
    arm, depth, real, camera = "arm" in kinds, "depth" in kinds, not rig.surface.scene, rig.camera
    no_box = "no box: no command moves the arm. Add low_m and high_m to [workspace]"
    no_lens = "no focal_px, center_px: the camera's own values are used, if it has any"
    no_camera_pose = "no T_arm_camera: the arm cannot touch what the camera sees"
    no_surface = "no T_arm_surface: explore needs the pose of the surface"
    no_compliance = "no compliance_m_per_n: explore needs it. deformscope calibrate arm measures it"
    wanted = (
        (arm and rig.workspace.low_m is None, "workspace", no_box),
        (depth and camera.focal_px is None, "camera", no_lens),
        (depth and arm and real and camera.T_arm_camera is None, "camera", no_camera_pose),
        (arm and real and rig.surface.T_arm_surface is None, "surface", no_surface),
        (arm and real and rig.tool.compliance_m_per_n is None, "tool", no_compliance),
    )
    return [Finding(what, "look", words) for lacks, what, words in wanted if lacks]


def _exploring(rig: Rig, measured: bool) -> list[Finding]:
    """Whether `explore` would begin with this file, if it seems to be meant for it; nothing is opened. measured: no
    step is left before it, or there is no list of steps: missing keys are named here"""
    kinds = {entry.driver.kind for entry in rig.devices}
    if "[surface]" not in rig.text or not {"arm", "wrench", "depth"} <= kinds:
        return []
    try:
        setup = setup_of_rig(rig)
    except InputError as error:
        return [Finding("explore", "look", f"not with this file: {error}")]
    lacks = [name for name, there in setup.calibrated.items() if not there]
    if lacks or rig.workspace.low_m is None:
        if not measured:
            return []
        return [Finding("explore", "look", f"lacks {', '.join(lacks) or 'the box of [workspace]'}")]
    words = "the file has all keys; whether the arm reaches the surface is checked before a touch"
    return [Finding("explore", "ok", words)]


def _placing(rig: Rig) -> list[Finding]:
    """Whether an arm could place the hand with this file, where an arm and a hand are in it; nothing is opened."""
    from deformscope.robot.squeeze_setup import lacks_to_place

    arms = [entry.driver.name for entry in rig.devices if entry.driver.kind == "arm" and entry.driver.chains()]
    if not arms or "hand" not in {entry.driver.kind for entry in rig.devices}:
        return []
    if lacks := lacks_to_place(rig):
        words = f"squeeze --place {arms[0]} lacks {', '.join(lacks)}: a person places the hand"
        return [Finding("place", "look", words)]
    return [Finding("place", "ok", f"squeeze --place {arms[0]} finds all its keys in this file")]


def _shape(rig: Rig) -> list[Finding]:
    """Whether the robot can be taken out of the camera's pictures as in [shape]."""
    from deformscope.robot.setup import description_of, only_device

    known = description_of(rig, only_device(rig, "arm")) if rig.shape != type(rig.shape)() else None
    if known is None:
        return []
    triangles = sum(len(part.solid.triangles) for part in known.parts)
    told = f"{known.removal}: {len(known.parts)} solids of {triangles} triangles, {len(known.cables)} cables"
    return [Finding("shape", "ok", told)]


def _certificate(rig: Rig) -> list[Finding]:
    """Whether the rig's certificate is young and of this tip."""
    if (found := rig.certificate) is None:
        return []
    doubt = "; old" * (found.days > found.oldest_days) + f"; of another tip, a {found.tip}" * (
        found.tip != rig.tip_text
    )
    return [Finding("certificate", "look" if doubt else "ok", f"{found}{doubt}{'; certify again' * bool(doubt)}")]


def _disk(rig: Rig) -> list[Finding]:
    """Whether a long recording has room."""
    folder = Path(rig.record.folder).absolute()
    free = shutil.disk_usage(next(one for one in (folder, *folder.parents) if one.exists())).free
    verdict: CheckStatus = "ok" if free > FREE_BYTES_WANTED else "look"
    return [Finding("disk", verdict, f"{free / 1e9:.1f} GB free for {rig.record.folder}")]


def _real_time(rig: Rig) -> list[Finding]:
    """Whether a robot's threads may preempt other computations of the machine."""
    if not {"arm", "hand"} & {entry.driver.kind for entry in rig.devices}:
        return []
    if may_be_prompt():
        words = "real-time priority: control and device threads preempt other processes"
        return [Finding("real time", "ok", words)]
    words = "a busy machine may delay device data, and the supervisor then stops the robot"
    if not hasattr(os, "sched_setscheduler"):
        return [Finding("real time", "look", f"not on this system: {words}")]
    limits = f'Add "USER - rtprio {SENDING}" to /etc/security/limits.conf and log in again; a container may forbid it'
    return [Finding("real time", "look", f"not allowed to this user: {words}. {limits}")]


def _device(entry: RigDevice, name: str, seconds: float) -> list[Finding]:
    """Open one device and listen to it."""
    with member_of(entry) as member, member.device as device:
        who_is = device.identity()
        device.next(max(seconds, FIRST_READING_S))
        time.sleep(seconds)
        health, remarks, homed = device.health(), device.remarks(), not isinstance(device, Arm) or device.homed
    who = " ".join(part for part in (who_is.model, who_is.serial, who_is.firmware) if part)
    told = f"{health.rate_hz:.4g} readings a second{', ' + who if who else ''}"
    findings = [Finding(name, "ok", told) if homed else Finding(name, "FAIL", f"{told}; {NOT_HOMED}")]
    return findings + [Finding(name, "look", doubt) for doubt in (*_doubts(health), *remarks)]


def _doubts(health: Health) -> list[str]:
    """Deviations from a healthy device."""
    reasons = ", ".join(f"{count} {reason}" for reason, count in health.refused.items()) or "noise"
    doubts = (
        (health.skipped_bytes, f"{health.skipped_bytes} bytes fit no frame ({reasons}): cable, ground, baud rate"),
        (health.lost, f"{health.lost} readings were lost on the way: USB hub, load of this machine"),
        (health.reconnects, f"the link failed and recovered {health.reconnects} times: cable, power"),
        (health.stuck, "the sensor repeats the same reading: is it plugged into its box?"),
    )
    return [words for shows, words in doubts if shows]
