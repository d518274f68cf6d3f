"""Devices and recordings of them, `deformscope devices`, `doctor`, `record`, `live`, `replay`...; and `bench`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.images import ParticleFlags
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions, ViewOptions
from deformscope.errors import InputError

StageWord = Literal["flow", "beta", "surface", "tactile", "contact", "wrench"]
ExportFormat = Literal["csv", "parquet", "mcap", "video", "npz", "images"]


@dataclass(frozen=True, slots=True)
class DevicesConfig(CommandOptions):
    """List the devices connected to this machine: port, serial number, firmware, health. Devices identified by their
    USB identity, and running doubles, are opened for a moment and queried. Nothing moves, but an OptoForce is set to
    its driver's default rate and filter, and loses its zero."""

    probe: bool = True
    """Open identified devices and query them; --no-probe lists only the system's information."""
    json: flags.JsonFlag = None
    """Write the list as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class NewRigConfig(CommandOptions):
    """Write a rig file for what is plugged in: serial ports, CAN, cameras and arms are searched for, and a person at
    the terminal is asked which driver each has. Nothing moves. The file has comments; `deformscope doctor` then names
    the next step. If no device is found, it has an example of each."""

    rig: Annotated[Path, Positional, arg(metavar="RIG.toml"), flags.Writes()]
    """The new file."""
    device: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="NAME=DRIVER:ADDRESS", help_behavior_hint="(repeatable)")
    ] = ()
    """A device with its driver, and its serial port, URL, CAN bus or host; without an address, the only one."""
    doubles: bool = False
    """Doubles over a simulated table instead."""
    yes: bool = False
    """Take all found devices with a known driver, without asking."""


@dataclass(frozen=True, slots=True)
class DoctorConfig(CommandOptions):
    """Check a rig: its file, every device of it for a few seconds, and the disk. Report faults, their remedies, and the
    next command on the way to an exploration. Nothing moves."""

    rig: flags.RigFlag
    """A rig file (.toml), or lab:NAME."""
    seconds: Annotated[float, flags.one_word("NUMBER", flags.positive)] = 2.0
    """Duration for which each device is read [s]."""
    trust_rig: flags.TrustFlag = False
    json: flags.JsonFlag = None
    """Write the findings as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class StageOptions(ParticleFlags):
    """Stages to compute while the devices run, always on the newest frame: skipped frames are counted. Options of
    images are those of `calibrate beta`; without --grid and --spacing-px, 9 particles lie along the region's longer
    side."""

    stage: Annotated[UseAppendAction[tuple[StageWord, ...]], arg(help_behavior_hint="(repeatable)")] = ()
    """flow: optical flow between two images; beta: particles of the body at rest in the first image, tracked to the
    newest image, and the fit of that pose with its verdict; surface: a depth camera's surface as a Gaussian process,
    with its deviation; tactile: centre of pressure, contact area and force of each pad; contact: stiffness by arm and
    force sensor, after each approach. A stage without a result reports the reason immediately."""
    camera: flags.CameraFlag = None
    """Colour camera of flow and beta; default: the rig's first one."""
    cluster_size: flags.ClusterFlag = 3
    """Particles along each side of the overlapping clusters."""
    longest_px: Annotated[int, flags.least(32)] = 160
    """Length of the region's longer side after reduction [px]: twice the length takes four times as long."""

    @property
    def names(self) -> tuple[StageWord, ...]:
        """Each requested stage once, in the given order."""
        return tuple(dict.fromkeys(self.stage))


@dataclass(frozen=True, slots=True)
class RigRunOptions(RecordedOptions):
    """A rig that is recorded or shown until its time is over, or until Ctrl-C."""

    rig: flags.RigFlag
    """A rig file (.toml), or lab:NAME."""
    seconds: flags.PositiveFlag = None
    """Duration [s]; default: until Ctrl-C."""
    label: str = ""
    """Description of the recorded experiment, in your words; it is stored in the recording."""
    trust_rig: flags.TrustFlag = False
    keep_last: flags.PositiveFlag = None
    """Hold the last seconds in memory [s], using at most a quarter of the machine's memory. `record` writes only the
    seconds before its end. On a page a button writes them; without this option a page holds 30 s in at most 256 MiB."""
    stages: OmitArgPrefixes[StageOptions] = field(default_factory=StageOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.keep_last is not None and self.stages.names:
            raise InputError("one of --keep-last and --stage", "both", "stages are recorded from the first frame on")


@dataclass(frozen=True, slots=True)
class RecordConfig(RigRunOptions):
    """Record all devices of a rig, with every byte of their wires and all losses. Without --record the file is
    runs/NAME-<stamp>.rrd. Ctrl-C ends it cleanly. No viewer opens without --viewer. --stage computes during the
    recording; `deformscope replay` computes the same from the recorded frames. --keep-last 30 records only the last 30
    s before the end."""


@dataclass(frozen=True, slots=True)
class LiveConfig(RigRunOptions):
    """Show all devices of a rig in rerun's window, with the results of --stage; with --record, record all of it as
    well."""

    def check(self) -> None:
        RigRunOptions.check(self)
        if self.keep_last is not None and self.output.viewer != "page":
            raise InputError("--keep-last with --viewer page", self.output.viewer, "record --keep-last needs no page")


@dataclass(frozen=True, slots=True)
class VerifyConfig(CommandOptions):
    """Check whether a recording is complete: its bytes against its ledger, its structure, and its counts of losses."""

    recording: flags.RecordingFlag
    """The recording."""
    stages: bool = False
    """List every stage of computation, by chapter of the thesis: its place in the recording, rows, cost and live
    results. Missing stages are listed too."""
    privacy: bool = False
    """List information on people and machines, such as commands, paths, words and serial numbers, which `export
    --anonymous` leaves out."""
    json: flags.JsonFlag = None
    """Write the findings as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class ReportConfig(CommandOptions):
    """Draw the figures of a recording, from its content alone, as one HTML page. An exploration has map, surface,
    touches and fields (Thesis chapter 4); a squeeze forces, pose, posterior and features over time (chapter 2). A rig
    has its stages, a fit its error and posterior. The page lists the stages that the recording lacks."""

    recording: flags.RecordingFlag
    """The recording."""
    out: flags.ReportFlag = None
    """The page; default: NAME.html in the recording's folder. An existing file is replaced."""
    json: flags.JsonFlag = None
    """Write the list of figures, drawn and missing, as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class RecoverConfig(CommandOptions):
    """Make a complete recording, with its ledger, from a truncated one or from one of a killed run: all its readable
    content. The original file does not change."""

    recording: flags.RecordingFlag
    """The unfinished recording (NAME.part.rrd), or a truncated one."""
    out: flags.NewRecordingFlag = None
    """The new recording; default: NAME.recovered.rrd in the same folder. An existing file is refused."""
    json: flags.JsonFlag = None
    """Write the outcome as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class DiscardRecordingConfig(CommandOptions):
    """Mark a recording, or one of its episodes, as unusable, with the reason, in its ledger. Nothing is deleted:
    commands that read it print the reason."""

    recording: flags.RecordingFlag
    """The recording."""
    reason: str
    """The reason, in your words."""
    episode: Annotated[int, flags.least(0)] = 0
    """Number of the episode, from 1; 0 = all of the recording."""
    json: flags.JsonFlag = None
    """Write the recording's state and its discarded parts as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if not self.reason.strip():
            raise InputError("a reason", "none", "--reason WORDS")


@dataclass(frozen=True, slots=True)
class ExportConfig(CommandOptions):
    """Write a recording in other formats: its streams as CSV, Parquet or NumPy files, all of it as MCAP with ROS 2
    messages. Its images become files (byte for byte as recorded) or videos. Names of columns and their metadata have
    the units; `export.json` lists the written files."""

    recording: flags.RecordingFlag
    """The recording."""
    to: ExportFormat | None = None
    """The format. mcap needs `pip install 'deformscope[mcap]'`."""
    out: flags.NewFolder = None
    """Output folder, new or empty. The folder appears when the export is complete."""
    images: flags.NewFolder = None
    """Short for --to images --out FOLDER, without `export.json`; each of several cameras has its own folder. File names
    are indices in the camera's stream, distances are 16 bit PNG in the camera's unit."""
    only: Annotated[tuple[str, ...], arg(metavar="ENTITY...", help_behavior_hint="")] = ()
    """Entities (wrench/tip), all entities below one (exploration), or devices (tip); default: all."""
    camera: flags.CameraFlag = None
    """Only images of this camera."""
    anonymous: bool = False
    """Leave out information that may identify a person, a machine or a path: commands, notes and other words, serial
    numbers, raw bytes of devices, input files."""
    license: str = ""
    """License of the data, as an SPDX identifier (CC-BY-4.0); it is written into every format."""
    author: Annotated[tuple[str, ...], arg(metavar="NAME...", help_behavior_hint="")] = ()
    """Author of the data; written into every format, also with --anonymous."""
    citation: str = ""
    """Citation of the data; written into every format."""
    overwrite: bool = False
    """Replace the files of an earlier export. Without it, a folder with files is refused."""
    json: flags.JsonFlag = None
    """Write the list of written files as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if (self.to is None) == (self.images is None) or (self.to is None) != (self.out is None):
            raise InputError("a format and a folder", "none, or more than one", "--to parquet --out FOLDER")
        if self.camera is not None and self.format not in ("images", "video"):
            raise InputError("--camera with images or video", self.format, f"--only {self.camera}")

    @property
    def format(self) -> ExportFormat:
        """The format, also if --images requests it."""
        return self.to or "images"

    @property
    def folder(self) -> Path:
        """Output folder."""
        return self.out or self.images or Path()


@dataclass(frozen=True, slots=True)
class ImportConfig(RecordedOptions):
    """Make a recording from data of other robots: bags of ROS 1 and 2, MCAP, CSV and Parquet tables, folders of them,
    and exports of this program. A map assigns each topic to a stream: --inspect proposes one, with `"?"` for values
    that the source lacks. Bags need `pip install 'deformscope[import]'`. --stage computes five times a second of the
    source's time, --stage contact of every approach; `deformscope explore RUN.rrd` maps the recorded touches."""

    source: Annotated[Path, Positional, arg(metavar="SOURCE"), flags.Reads()]
    """A bag, a table, or a folder."""
    map: Annotated[Path | None, flags.one_word("FILE.toml", Path), flags.unset, flags.Reads()] = None
    """The map."""
    inspect: bool = False
    """List topics with types, rates, gaps and clocks, and a map, as TOML; import nothing. Each stream of the map
    (--map, or the proposed one) has its rate, share of valid values, smallest, median and largest, in SI units."""
    picture: flags.PictureFlag = None
    """With --inspect: draw the streams."""
    largest_mb: Annotated[int, flags.least(1)] = 128
    """Most memory for an image, a cloud of points, a compressed part of a bag or a table's columns [MB]: a larger one,
    declared or unpacked, is refused."""
    stages: OmitArgPrefixes[StageOptions] = field(default_factory=StageOptions)
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def check(self) -> None:
        if self.inspect == (self.output.record is not None):
            raise InputError(
                "--record FILE.rrd with --map FILE.toml, or --inspect", "both" if self.inspect else "neither"
            )
        if self.picture is not None and not self.inspect:
            raise InputError("--picture with --inspect", "--picture alone")


@dataclass(frozen=True, slots=True)
class NewDeviceConfig(CommandOptions):
    """Write a package for a device of your own: driver, double, tests and README. It passes its tests, and works
    in a rig file after `pip install`. Replace its example by your device."""

    name: Annotated[str, Positional, arg(metavar="NAME")]
    """Name of the driver in rig files, and of the folder."""
    kind: Literal["force", "camera", "tactile", "arm", "hand"]
    """force: a force sensor over a serial port; camera: a depth camera through its vendor's library; tactile: pads over
    a serial port; arm: an arm that takes joint velocities through its vendor's library; hand: angles of a hand's axes
    over a serial port."""
    out: Annotated[Path, arg(metavar="FOLDER")] = Path()
    """Folder in which the new folder is written."""


@dataclass(frozen=True, slots=True)
class DoubleConfig(CommandOptions):
    """Run simulated devices with the real protocol and timing, until Ctrl-C; print a rig file that connects to them
    from another terminal."""

    what: Annotated[tuple[str, ...], Positional, arg(metavar="DRIVER|RIG")]
    """Drivers (optoforce, your own), or a rig file or lab:NAME whose byte-stream devices are simulated."""
    seconds: flags.PositiveFlag = None
    """Duration [s]; default: until Ctrl-C."""


@dataclass(frozen=True, slots=True)
class ArmConfig(RecordedOptions):
    """Measure the compliance of the arm, by touching something rigid that is fixed to the surface, and write it into
    the rig file. The arm moves, after a table of checks and a question."""

    rig: flags.SceneFlag
    """A rig file (.toml), or a simulated scene (lab:homogeneous-rigid)."""
    at: flags.PlaceFlag = None
    """Place of the touch, in the surface frame [m]; default: the middle."""
    touches: flags.ManyFlag = 3
    """Number of touches."""
    set_force: flags.ForceFlag = None
    """Force of a touch [N], 5 N at most, and 5/3 of it (5 N at most) because the contact is rigid; default: the rig
    file's target_force_n."""
    write: bool = True
    """Write the result and the date into the rig file; --no-write only prints the lines."""
    yes: bool = False
    """Let a real arm move without asking, once the checks have passed."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class WrenchConfig(RecordedOptions):
    """Find what the force is worth that the arm itself reports, for a rig without a force sensor (`driver = "arm"`):
    noise, bias by pose, friction, and poses where it means nothing, by a motion above the surface without contact. The
    arm moves, after a table of checks and a question."""

    rig: flags.SceneFlag
    """A rig file (.toml) with a device of driver = "arm", or a simulated scene, whose lines are printed."""
    arm: Annotated[str, arg(metavar="DRIVER")] = ""
    """The arm of a simulated scene: the double of this driver of a rig file; default: its usual one."""
    places: Annotated[int, flags.least(6)] = 12
    """Number of places over which the arm goes down and up."""
    write: bool = True
    """Write the result and the date into the rig file; --no-write only prints the lines."""
    yes: bool = False
    """Let a real arm move without asking, once the checks have passed."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.arm and not self.rig.startswith("lab:"):
            raise InputError("--arm with a simulated scene", self.rig, "the rig file's own arm")


@dataclass(frozen=True, slots=True)
class CertifyConfig(RecordedOptions):
    """Find a rig's bias on a sample of known modulus, by cause: force gain, depth, tip, compliance, clock. The sample
    is the surface of the rig file. The arm moves, after a table of checks and a question."""

    rig: flags.SceneFlag
    """A rig file (.toml), or a simulated block with hidden errors of the rig (lab:block-162)."""
    sample: str
    """A silicone by name (ecoflex-00-30; an unknown name lists them), or the JSON of `deformscope indent`."""
    touches: flags.ManyFlag = 6
    """Number of touches, each at another place."""
    thickness_m: flags.LengthFlag = None
    """Thickness of the sample [m]; default: as in the JSON, else as in the rig file."""
    sliding: bool = False
    """The sample slides on its ground; default: as in the JSON, else it is fixed."""
    save: bool = False
    """Write [certificate] into the rig file; default: print it."""
    yes: bool = False
    """Let a real arm move without asking, once the checks have passed."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.save and self.rig.startswith("lab:"):
            raise InputError("a rig file, to --save into", self.rig, "deformscope rig new rig.toml --doubles")


@dataclass(frozen=True, slots=True)
class DemoConfig(RecordedOptions):
    """The main task on simulated devices: an arm maps the stiffness of a table with three materials, by looking and
    touching. It writes runs/demo-<stamp>.rrd, or the file of --record."""

    images: bool = False
    """Measure the included images instead: a specimen under tension, filmed."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class ReplayConfig(RecordedOptions):
    """Run the same stages on a recording's inputs, and compare the results with the recorded numbers."""

    recording: flags.RecordingFlag
    """The recording."""
    pace: Literal["fast", "real", "step"] = "fast"
    """Replay as fast as possible, at the recorded rate, or frame by frame at each Enter."""
    set: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="KEY=VALUE", help_behavior_hint="(repeatable)")] = ()
    """Change a setting of an exploration: the new result is printed with the recorded one, and not compared to the bit.
    Several: --set beta_model=none --set threshold=0.1"""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class BenchConfig(CommandOptions):
    """Measure the cost of MSM on this machine. Ctrl-C ends it and prints the measurements so far."""

    quick: bool = False
    """Smaller and fewer cases, in about 20 s."""
    only: flags.CasesFlag = None
    """Measure only these, of step, call and relax."""
    sizes: flags.SizesFlag = None
    """Particles of the cubes that are stepped and relaxed; default: 216 to a million, on a GPU to ten."""
    repeats: flags.SomeFlag = None
    """Rounds of every comparison; default: as many as fit into a few seconds, 9 at most."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    json: flags.JsonFlag = None
    """Write all results as JSON; with -, stdout is the JSON alone. An existing file is replaced."""
