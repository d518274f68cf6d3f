"""Devices and recordings of them: `deformscope devices`, `doctor`, `record`, `live`, `explore`, `replay`..."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.options import CommandOptions, Flags, OutputOptions, RecordedOptions, either
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class DevicesConfig(CommandOptions):
    """List what is plugged into this machine: port, serial number, firmware, health. Devices that are known by their
    USB identity, and doubles that run, are opened for a moment and asked: nothing moves, but an OptoForce is set to its
    driver's default rate and filter, and forgets its zero."""

    probe: bool = True
    """Open what is known and ask it; --no-probe lists only what the system knows."""
    json: flags.JsonFlag = None
    """Write the list as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class DoctorConfig(CommandOptions):
    """Try a rig: its file, every device of it for a few seconds, the disk; say what is wrong and what to do, and which
    command comes next on the way to an exploration. Nothing moves."""

    rig: flags.RigFlag = ""
    """A rig file (.toml), or lab:NAME."""
    example: bool = False
    """Print a rig file to start from, and do nothing else."""
    doubles: bool = False
    """With --example: one of doubles over a simulated table, to try everything on."""
    seconds: Annotated[float, flags.one_word("NUMBER", flags.positive)] = 2.0
    """How long every device is listened to [s]."""
    trust_rig: flags.TrustFlag = False
    json: flags.JsonFlag = None
    """Write what was found as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if not self.rig and not self.example:
            raise InputError("a rig file, or lab:NAME", "none", "deformscope doctor --example > rig.toml")


@dataclass(frozen=True, slots=True)
class StageOptions(Flags):
    """Stages that are computed while the devices run, always on the newest frame: those passed over are counted. Images
    are as for `calibrate beta`."""

    stage: Annotated[
        UseAppendAction[tuple[Literal["flow", "beta", "surface", "tactile", "contact"], ...]],
        arg(help_behavior_hint="(repeatable)"),
    ] = ()
    """flow: optical flow between the images used; beta: particles of the first image, which shows the thing at rest,
    followed to the newest, and the fit of that pose with its verdict; surface: a depth camera's surface as a Gaussian
    process, with its deviation; tactile: centre of pressure, contact area and force of each pad; contact: stiffness by
    arm and force sensor, after each approach."""
    camera: str = ""
    """Colour camera of flow and beta; default: the rig's first."""
    roi: flags.RectangleFlag = None
    """Region of its image that holds the thing [px]; default: all of it."""
    grid: flags.GridFlag = None
    """Rows and columns of particles over the region; default: 9 along its longer side."""
    spacing_px: flags.PositiveFlag = None
    """Distance of neighbouring particles [px], instead of --grid."""
    held: flags.HeldFlag = None
    """Particles whose motion is prescribed, out of top, bottom, left, right, border and contact. Default:
    bottom,contact where --contact is given, else top,bottom."""
    contact: flags.RectangleFlag = None
    """Footprint of the tool in the first image [px]; the particles inside are `contact`."""
    cluster_size: flags.ClusterFlag = 3
    """Particles a side of the overlapping clusters."""
    longest_px: Annotated[int, flags.least(32)] = 160
    """The region is reduced until its longer side has so many pixels: twice as many take four times as long [px]."""

    def check(self) -> None:
        either("--grid", "--spacing-px", self.grid, self.spacing_px)
        if ("contact" in self.held_parts()) != (self.contact is not None):
            raise InputError("contact among --held with --contact X,Y,WIDTH,HEIGHT", "one of the two")

    @property
    def names(self) -> tuple[Literal["flow", "beta", "surface", "tactile", "contact"], ...]:
        """Each stage once, in the order asked for."""
        return tuple(dict.fromkeys(self.stage))

    def held_parts(self) -> tuple[flags.HeldPart, ...]:
        """The parts to hold: those asked for, else what stands still and what pushes."""
        return self.held or (("bottom", "contact") if self.contact is not None else ("top", "bottom"))


@dataclass(frozen=True, slots=True)
class RigRunOptions(RecordedOptions):
    """A rig that is recorded or watched until its time is over, or until Ctrl-C."""

    rig: flags.RigFlag
    """A rig file (.toml), or lab:NAME."""
    seconds: flags.PositiveFlag = None
    """How long [s]; default: until Ctrl-C."""
    label: str = ""
    """What is being recorded, in your words; kept in the recording."""
    trust_rig: flags.TrustFlag = False
    keep_last: flags.PositiveFlag = None
    """Hold the last seconds in memory [s], a quarter of the machine's at most: `record` writes those before its end and
    no others; on a page a button writes them, there 30 s in 256 MiB are held without this option."""
    stages: OmitArgPrefixes[StageOptions] = field(default_factory=StageOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.keep_last is not None and self.stages.names:
            raise InputError("one of --keep-last and --stage", "both", "stages are recorded from the first frame on")


@dataclass(frozen=True, slots=True)
class RecordConfig(RigRunOptions):
    """Record all devices of a rig, with every byte of their wires and what was lost. Without --record the file is
    runs/NAME-<stamp>.rrd. Ctrl-C ends it cleanly. No viewer, unless --viewer asks for one. --stage computes while it
    records; `deformscope replay` computes the same again from the recorded frames. --keep-last 30 records the last 30 s
    before the end alone."""


@dataclass(frozen=True, slots=True)
class LiveConfig(RigRunOptions):
    """Watch all devices of a rig in rerun's window, and what --stage computes from them; with --record, record it all
    as well."""

    def check(self) -> None:
        RigRunOptions.check(self)
        if self.keep_last is not None and self.output.viewer != "page":
            raise InputError("--keep-last with --viewer page", self.output.viewer, "record --keep-last needs no page")


@dataclass(frozen=True, slots=True)
class VerifyConfig(CommandOptions):
    """Say whether a recording is whole: its bytes against its ledger, its structure, and what it counted as lost."""

    recording: flags.RecordingFlag
    """The recording."""
    json: flags.JsonFlag = None
    """Write the findings as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class RecoverConfig(CommandOptions):
    """Make a whole recording, with its ledger, of one whose run was killed or that was cut off: all that can be read of
    it. The original is only read."""

    recording: flags.RecordingFlag
    """The unfinished recording (NAME.part.rrd), or one that was cut off."""
    out: flags.NewRecordingFlag = None
    """The new recording; default: NAME.recovered.rrd beside it. An existing file is refused."""
    json: flags.JsonFlag = None
    """Write what there is as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class DiscardRecordingConfig(CommandOptions):
    """Mark a recording, or one of its episodes, as not to be used, with the reason, in its ledger. Nothing is deleted:
    whoever reads it is reminded."""

    recording: flags.RecordingFlag
    """The recording."""
    reason: str
    """Why, in your words."""
    episode: Annotated[int, flags.least(0)] = 0
    """Number of the episode, from 1; 0 = all of the recording."""
    json: flags.JsonFlag = None
    """Write what the recording is, and what of it is discarded, as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if not self.reason.strip():
            raise InputError("a reason", "none", "--reason WORDS")


@dataclass(frozen=True, slots=True)
class ExportConfig(CommandOptions):
    """Write the images of a recording as files, byte for byte as they were recorded: JPEG or PNG, distances as 16 bit
    PNG in the camera's unit. Their names are their places in the camera's stream."""

    recording: flags.RecordingFlag
    """The recording."""
    images: Annotated[Path, arg(metavar="FOLDER")]
    """Where they go; several cameras get a folder each in it."""
    camera: flags.CameraFlag = None
    """Those of this camera alone."""
    overwrite: bool = False
    """Replace the images of an earlier export. Without it, a folder that holds something is refused."""
    json: flags.JsonFlag = None
    """Write what was written as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class DoubleConfig(CommandOptions):
    """Run simulated devices that speak the real bytes at the real pace, until Ctrl-C; prints the rig file that reaches
    them from another terminal."""

    what: Annotated[tuple[str, ...], Positional, arg(metavar="DRIVER|RIG")]
    """Drivers (optoforce, dsa, sdh), or a rig file or lab:NAME whose byte-stream devices are to be doubled."""
    seconds: flags.PositiveFlag = None
    """How long [s]; default: until Ctrl-C."""


@dataclass(frozen=True, slots=True)
class ExploreConfig(RecordedOptions):
    """Map how soft a surface is, and where: look, touch where it adds most to the map, map, again; regions in the end.
    RIG is a rig file with an arm, a force sensor and a depth camera: the arm moves, after a table of checks and a
    question. lab:NAME is a simulated table, explored through the real drivers on byte-exact doubles."""

    rig: flags.SceneFlag = ""
    """A rig file (.toml), or a simulated scene; --list-scenarios names these."""
    list_scenarios: bool = False
    """Name the simulated scenes, what their seeds draw, and what can go wrong in them; do nothing else."""
    touches: flags.SomeFlag = None
    """Touches at most, default 8, with --goal inclusions 30."""
    goal: Literal["regions", "inclusions"] = "regions"
    """What is sought: regions of one stiffness each, or inclusions: lumps below a surface that shows nothing, stiffer
    or softer than the foam around them; touched is until one of --smallest-lump-cm or more is missed with less than
    5 %."""
    smallest_lump_cm: flags.PositiveFlag = None
    """With --goal inclusions: radius of the smallest lump that must not be missed [cm], default 2."""
    planner: Literal["regions", "integrated-variance", "max-variance", "random-above", "thesis"] = "regions"
    """Where to touch next: where the map of regions gains most a second (default), three rules by the field's
    variance, or all of chapter 4 as the thesis has it: its field of beta, from --first (default: a preset place), any
    place above --threshold until none is, and regions along isopleths."""
    threshold: float = 0.06
    """Variance, as a share of that before any touch, below which a place needs no touch (Th of the thesis)."""
    smallest_inclusion: flags.PositiveFlag = None
    """Radius of the smallest lumps that are sought [m], default 0.06: touched is until one that is there unseen is less
    likely than 1 in 20, or --touches are made."""
    set_force: flags.ForceFlag = None
    """Force to press with [N], 5 N at most; default: the rig file's target_force_n, which is 3 N unless it says. Where
    it makes a dent below 2 mm, 5/3 of it (5 N at most) is pressed with."""
    hold: Annotated[float, arg(metavar="S")] = 0.0
    """Hold the force of each touch for so long [s], and report how the foam creeps: stiffness at once and relaxed,
    relaxation time, energy that a touch loses. 8 s tell times of 0.2 to 5 s."""
    feel: Literal["apparent", "relaxed", "loss"] = "apparent"
    """What is mapped: stiffness as each touch comes down, or, with --hold, when all has relaxed; or, with --hold, the
    share of its energy that a touch loses, stiffness beside it."""
    pace: Literal["careful", "quick"] = "careful"
    """quick: once a touch has met the surface where it was seen, the tip crosses it 2 cm above all that it passes, and
    slows down where the surface may be, in the last 5 to 15 mm; it travels at the rig file's travel_speed_m_s, in the
    laboratory at 15 cm/s. careful: 5 cm above it, the last 3 cm slowly, in the laboratory at 5 cm/s."""
    relief: Literal["seen", "stated"] = "seen"
    """Where the surface is uneven, compare touches by how thick and how curved the foam was seen to be at each (its
    table is at z = 0), so that they compare by modulus; or take it for level and as thick as stated."""
    first: flags.PlaceFlag = None
    """Where to touch first, in the surface frame [m]; default: where it says most."""
    dry_run: bool = False
    """Make the first touch 10 cm above the surface, where nothing is met, and end."""
    beta_model: Literal["volume", "thesis", "layers", "none"] | None = None
    """What beta is fitted with: layers below the surface (volume, default), the thesis's sweep with one held particle
    of a single layer (thesis, default of --planner thesis) or of layers, or none."""
    fault: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="KIND@TOUCH", help_behavior_hint="(repeatable)")
    ] = ()
    """Let something go wrong in a simulated touch, counted from 1, such as force-silent@2, at a moment drawn from the
    seed; --list-scenarios names the kinds."""
    clean: bool = False
    """Keep nothing from the estimator in a simulated scene: the arm is as its calibration says, the force exact, and
    foam without scatter. Else these are drawn from the seed, as they would be on a table."""
    camera: Literal["plain", "primesense", "realsense"] = "plain"
    """What the camera of a simulated scene measures by: noise alone, or disparity as a PrimeSense or a RealSense D435
    has it, with its steps, edges that bleed, shadows beside them, and no depth where a surface is seen flat."""
    robot: Literal["plain", "gripper"] = "plain"
    """What the camera of a simulated scene sees of the robot: capsules, or the meshes of an arm whose gripper holds a
    stick, and a cable that hangs."""
    removal: Literal["capsules", "hull", "mesh"] | None = None
    """With --robot gripper: how that is taken out of the pictures, default mesh. A rig file says it in [shape]."""
    picture: flags.PictureFlag = None
    """Draw the maps to a PNG."""
    map: flags.ArraysFlag = None
    """Write the maps as arrays: stiffness [N/mm], its deviation (of its log), regions, their probability, beta."""
    paused: bool = False
    """With --viewer page: begin paused, and touch only where somebody says so on the page."""
    page_timeout: flags.TimeoutFlag = 0.3
    """Stop a touch that was asked for on the page where the page is not heard of for so long [s]; exploring goes on."""
    yes: bool = False
    """Let a real arm move, once the checks have passed, without asking."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.smallest_lump_cm is not None and self.goal != "inclusions":
            raise InputError("--smallest-lump-cm with --goal inclusions", f"--goal {self.goal}", "--goal inclusions")
        if self.smallest_inclusion is not None and self.goal == "inclusions":
            raise InputError(
                "--smallest-lump-cm with --goal inclusions", "--smallest-inclusion", "--smallest-lump-cm 2"
            )
        if self.goal == "inclusions" and self.planner != "regions":
            raise InputError("the planner of --goal inclusions", f"--planner {self.planner}", "leave --planner out")
        if self.paused and self.output.viewer != "page":
            raise InputError("--paused with --viewer page", f"--viewer {self.output.viewer}", "--viewer page")
        if not self.rig and not self.list_scenarios:
            raise InputError("a rig file, or lab:NAME", "none", "deformscope explore --list-scenarios")
        if self.camera != "plain" and not self.rig.startswith("lab:"):
            raise InputError("--camera with a simulated scene alone", f"{self.rig}", "lab:two-60-150")
        if self.robot != "plain" and not self.rig.startswith("lab:"):
            raise InputError("--robot with a simulated scene alone", f"{self.rig}", "[shape] in a rig file")
        if self.removal is not None and self.robot == "plain":
            raise InputError("--removal with --robot gripper", "--robot plain", "--robot gripper")


@dataclass(frozen=True, slots=True)
class ArmConfig(RecordedOptions):
    """Measure the compliance of the arm, by touching something rigid that stands firmly on the surface, and write it
    into the rig file. The arm moves, after a table of checks and a question."""

    rig: flags.SceneFlag
    """A rig file (.toml), or a simulated scene (lab:homogeneous-rigid)."""
    at: flags.PlaceFlag = None
    """Where to touch, in the surface frame [m]; default: the middle."""
    touches: flags.ManyFlag = 3
    """How often."""
    set_force: flags.ForceFlag = None
    """Force to press with [N], 5 N at most, and 5/3 of it (5 N at most) since nothing gives; default: the rig file's
    target_force_n."""
    write: bool = True
    """Write what was found and the date into the rig file; --no-write prints the lines alone."""
    yes: bool = False
    """Let a real arm move, once the checks have passed, without asking."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class DemoConfig(RecordedOptions):
    """The main job on what is built in: a simulated arm maps the stiffness of a table with three materials, by looking
    and touching. Leaves runs/demo-<stamp>.rrd, or what --record names."""

    images: bool = False
    """Measure the images that ship instead: a specimen under tension, filmed."""

    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class ReplayConfig(RecordedOptions):
    """Run the same stages on a recording's inputs, and compare with the numbers that it holds."""

    recording: flags.RecordingFlag
    """The recording."""
    pace: Literal["fast", "real", "step"] = "fast"
    """As fast as possible, as it was recorded, or frame by frame at each Enter."""
    set: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="KEY=VALUE", help_behavior_hint="(repeatable)")] = ()
    """Another setting than the recorded one, of an exploration: what comes of it is printed beside what was recorded,
    and not compared to the bit. Several: --set beta_model=none --set threshold=0.1"""
    beside: flags.BesideFlag = None
    """With --viewer page: what this other recording's devices measured, in the same plots, both from their first
    contact on. Nothing is computed again."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)
