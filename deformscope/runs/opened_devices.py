"""Source of an exploration, by its name on the command line: a simulated scene, the devices of a rig file, or a
recording."""

import contextlib
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from deformscope.errors import InputError
from deformscope.file_io import nearest
from deformscope.terminal import say

if TYPE_CHECKING:
    from deformscope.experiments.explore.options import ExploreOptions
    from deformscope.experiments.explore.recorded_touches import RecordedTouches
    from deformscope.lab.live_lab import LiveLab
    from deformscope.lab.randomized_rig import RandomizedRig
    from deformscope.lab.scenes import Scene
    from deformscope.lab.session_errors import LabErrors
    from deformscope.lab.touch_lab import TouchLab
    from deformscope.rig.rig_file import Rig, Tool
    from deformscope.robot.description import Removal
    from deformscope.robot.setup import RigParts, Setup
    from deformscope.robot.squeeze_setup import SqueezeSetup
    from deformscope_drivers.arm.wrench import ArmWrenchConfig

LAB = "lab:"


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """A setup, and its parts.

    options: how to explore it; settings: for its recording; lab: source of faults, None on a rig; recorded: items of
    another robot, None = a robot is commanded"""

    setup: "Setup"
    options: "ExploreOptions"
    settings: dict[str, Any]
    lab: "TouchLab | None" = None
    recorded: "RecordedTouches | None" = None

    @property
    def faulty_lab(self) -> "TouchLab":
        """Raises InputError for a rig."""
        if self.lab is None:
            raise InputError("--fault with a simulated scene alone", "a rig", "lab:two-60-150")
        return self.lab


def setup_of(
    name: str,
    options: "ExploreOptions",
    set_force_n: float | None,
    *,
    trusted: bool,
    clean: bool = True,
    camera: str = "plain",
    robot: str = "plain",
    removal: "Removal | None" = None,
    tangential: Literal["held", "free"] | None = None,
    scene: "Scene | None" = None,
    errors: "LabErrors | None" = None,
    corrected: bool = False,
    arm: str = "",
    own: "tuple[ArmWrenchConfig, Tool] | None" = None,
) -> Opening:
    """The setup of `lab:NAME`, of a rig file, not opened, or of a recording.

    set_force_n: force of a touch, None = that of the rig file; trusted: as in `deformscope.rig.rig_file.load_rig`;
    clean: no hidden errors in the laboratory; camera: error model of its camera; robot: the robot's model in the
    images;
    removal: how that is taken out of its pictures; tangential: motion of the tip across the normal, None = what the rig
    file has, in the laboratory held; scene: scene of a name that is not built in;
    errors: distributions of the laboratory's hidden errors; corrected: by the rig's certificate; arm: driver of the
    laboratory's arm, empty = its usual one; own: its own force and its deviations, in
    place of the force sensor"""
    if name.startswith(LAB):
        from deformscope.experiments.explore.options import TRAVEL_M_S
        from deformscope.experiments.measured import highest_m
        from deformscope.lab.scene_lab import RobotBody, SceneLab, described_robot
        from deformscope.lab.scenes import built_in
        from deformscope.lab.session_errors import LabErrors
        from deformscope.robot.description import AS_CAPSULES

        scene = scene or built_in(name.removeprefix(LAB), options.seed)
        options = dataclasses.replace(options, thickness_m=scene.thickness_m, tangential=tangential or "held")
        if set_force_n is not None:
            options = dataclasses.replace(options, set_force_n=set_force_n)
        parked_m = highest_m(options)
        if corrected:
            raise InputError("a rig file with a [certificate], for --corrected", name, "deformscope certify RIG --save")
        errors = errors or (LabErrors.none() if clean else LabErrors())
        made = SceneLab(
            scene,
            tip_radius_m=options.tip_radius_m,
            parked_m=parked_m,
            seed=options.seed,
            errors=errors,
            sensor="" if camera == "plain" else camera,
            robot=None if robot == "plain" else RobotBody(options.seed),
            described=AS_CAPSULES if robot == "plain" else described_robot(removal),
            travel_speed_m_s=TRAVEL_M_S[options.pace],
            arm=arm,
            own_wrench=None if own is None else own[0],
            tool=None if own is None else own[1],
        )
        laboratory = {
            "clean": clean,
            "camera": camera,
            "robot": robot,
            "errors": errors.plain(),
            "drawn": made.drawn.plain(),
        } | ({"arm": arm} if arm else {})
        return Opening(made.setup, options, {"scene": scene.name, "laboratory": laboratory}, made.lab)
    from deformscope.recording.target import SUFFIX
    from deformscope.rig.rig_file import load_rig

    if not Path(name).exists() and (near := _nearest_scene(name)):
        raise InputError("a rig file, or lab:NAME", repr(name), near)
    is_recording = name.lower().endswith(SUFFIX)
    rig = recorded_rig(Path(name)) if is_recording else load_rig(name, trusted=trusted)
    if corrected:
        rig = rig.corrected()
    options = dataclasses.replace(
        options,
        set_force_n=rig.workspace.target_force_n if set_force_n is None else set_force_n,
        tip_radius_m=rig.tool.radius_m,
        thickness_m=rig.surface.top_m,
        thickness_stated=rig.surface.thickness_m is not None,
        tangential=tangential or rig.touch.tangential,
    )
    settings: dict[str, Any] = {"rig": rig.text, "rig_name": rig.name, "scene": rig.surface.scene}
    settings |= {"corrected": True} if corrected else {}
    if is_recording:
        from deformscope.experiments.explore.recorded_touches import recorded_setup

        setup, touches = recorded_setup(Path(name), rig, options)
        for one in touches.left_out:
            say(f"left out: {one}")
        options = dataclasses.replace(options, budget=touches.count, go_on=True)
        return Opening(setup, options, settings, recorded=touches)
    return Opening(setup_of_rig(rig, options.seed), options, settings)


def own_wrench(path: Path) -> "tuple[ArmWrenchConfig, Tool]":
    """How a rig file has the arm's own force read, and its deviations. Raises InputError for one without."""
    from deformscope.rig.rig_file import load_rig
    from deformscope.robot.setup import only_device

    rig = load_rig(path)
    return only_device(rig, "wrench", "whose force is used", driver="arm").config, rig.tool


def recorded_rig(path: Path) -> "Rig":
    """Poses of arm, camera and surface in a recording. Raises InputError for its missing values."""
    from deformscope.recording.items import read_streams
    from deformscope.recording.reader import Replay
    from deformscope.rig.rig_file import parse_rig

    text = Replay(path).settings.get("rig", "")
    rig = parse_rig(text, str(path), others=[one.device for one in read_streams(path, trust=True)])
    camera = rig.camera
    known: list[tuple[str, object]] = [("[surface] T_arm_surface", rig.surface.T_arm_surface)]
    known += [(f"[camera] {name}", getattr(camera, name)) for name in ("T_arm_camera", "focal_px", "center_px")]
    if missing := [name for name, value in known if value is None]:
        raise InputError(f"{missing[0]} among the recorded devices", "none", "in its map; or use replay", path)
    return rig


def setup_of_rig(rig: "Rig", seed: int = 0) -> "Setup":
    """The setup of a rig file, not opened. Raises InputError, which names missing keys."""
    from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
    from deformscope.lab.rig_members import member_of
    from deformscope.robot.setup import RigParts, rig_setup
    from deformscope.runs.skeleton import PersonAtTerminal

    parts = RigParts.of(rig)
    table = table_of(parts, seed)[0]
    if table is None:
        by_hand = not parts.devices[0].driver.chains()
        return rig_setup(parts, member_of, person=PersonAtTerminal() if by_hand else None)
    return rig_setup(parts, member_of, table, (1.0 / ARM_STIFFNESS_N_M, ARM_DOUBT / ARM_STIFFNESS_N_M))


def table_of(parts: "RigParts", seed: int = 0) -> "tuple[LiveLab | None, RandomizedRig | None]":
    """The simulated table of a rig with a scene, not opened, and the true places of its devices if they are hidden."""
    from deformscope.lab import live_lab
    from deformscope.lab.randomized_rig import RandomizedRig
    from deformscope.lab.scenes import built_in

    surface = parts.rig.surface
    if not surface.scene:
        return None, None
    scene = built_in(surface.scene, seed)
    randomized = None
    if surface.hidden is not None:
        randomized = RandomizedRig.draw(surface.hidden, parts.rig.tool, scene.size_m, scene.thickness_m)
    table = live_lab.LiveLab(
        scene,
        parts.placement,
        parts.devices[0],
        T_surface_camera=parts.T_surface_camera,
        randomized=randomized,
        described=parts.described,
    )
    return table, randomized


CONTAINERS = f"{LAB}containers"


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class SqueezeOpening:
    """A setup to squeeze with, not opened; settings: for its recording; content, container: the requested ones or, in
    the laboratory, random ones"""

    setup: "SqueezeSetup"
    settings: dict[str, Any]
    content: str
    container: str


def squeeze_setup_of(
    name: str, content: str, container: str, session: str, seed: int, *, trusted: bool, place: str = "person"
) -> SqueezeOpening:
    """The setup of lab:containers or of a rig file, whose doubles squeeze a simulated container. content, container:
    empty = drawn, where they are simulated; place: who places the hand: person, or the driver of an arm"""
    if name == CONTAINERS:
        from deformscope.lab.container_setup import container_lab

        arm = "" if place == "person" else place
        made = container_lab(content, container, session, seed, arm=arm)
        return SqueezeOpening(made.setup, {"lab": CONTAINERS}, made.content, made.container)
    if name.startswith(LAB):
        raise InputError(CONTAINERS + ", or a rig file", repr(name), CONTAINERS)
    from deformscope.lab.container_setup import rig_container
    from deformscope.lab.rig_members import member_of
    from deformscope.rig.rig_file import load_rig
    from deformscope.robot.squeeze_setup import SqueezeParts, squeeze_setup

    rig = load_rig(name, trusted=trusted)
    settings = {"rig": rig.text, "rig_name": rig.name}
    parts = SqueezeParts.of(rig, seed, place)
    if not parts.simulated:
        return SqueezeOpening(squeeze_setup(parts, member_of, place=place), settings, content, container)
    between = rig_container(parts, content, container, session, seed)
    setup = squeeze_setup(parts, member_of, between.simulated)
    return SqueezeOpening(setup, settings, between.content, between.container)


def _nearest_scene(name: str) -> str:
    """The scene of this name, or of the most similar one; empty = none."""
    from deformscope.lab.scenes import BUILT_IN, BURIED, built_in

    with contextlib.suppress(InputError):
        return f"{LAB}{built_in(name).name}"
    return nearest(name, BUILT_IN | BURIED, LAB)
